//! Messages between a window and a running graph on another machine.

use panoscope_base::format;
use panoscope_graph::{Catalog, GraphText, NodeType, PacketType, Port, check};
use panoscope_host::attach::message::{
    Command, Incoming, Message, Opened, Wanted, read_command, read_incoming, write_command, write_message,
};
use panoscope_host::attach::{rules, tunnel};

pub fn run(bytes: &[u8]) {
    let mut frames = bytes;
    while let Ok(Some(frame)) = tunnel::receive(&mut frames) {
        let mut written = Vec::new();
        tunnel::send(&mut written, &frame).expect("it was not too long");
        assert_eq!(tunnel::receive(&mut &written[..]).ok().flatten(), Some(frame));
    }
    if let Ok(command) = read_command(bytes) {
        assert_eq!(read_command(&write_command(&command)).ok(), Some(command.clone()), "it is read again");
        if let Command::Run { base, text, .. } = command {
            // What no edit changes is allowed.
            if rules::check(&base, &text).is_ok() {
                assert_eq!(rules::check(&text, &text), Ok(()));
            }
        }
    }
    match read_incoming(bytes) {
        Ok(Incoming::Message(Message::Opened(opened))) => {
            let Opened { graph, catalog, .. } = &*opened;
            // A window looks these up without asking.
            graph.edges.iter().for_each(|edge| {
                let _ = &graph.nodes[edge.from_node].node_type(catalog).outputs[edge.from_port];
                let _ = &graph.nodes[edge.to_node].node_type(catalog).inputs[edge.to_port];
            });
            graph.preset.pinned.iter().for_each(|pin| {
                let _ = &graph.nodes[pin.node].node_type(catalog).params[pin.param];
            });
        }
        Ok(Incoming::Message(message)) => assert!(read_incoming(&write_message(&message)).is_ok(), "it is read again"),
        Ok(Incoming::Packet(packet)) => {
            let frame = packet.frame.frame();
            let pixel = format::pixel_bytes(frame.format);
            let (width, height, stride) = (frame.width as usize, frame.height as usize, frame.stride_bytes as usize);
            if pixel > 0 && width > 0 && height > 0 {
                let need = format::image_bytes(width, height, stride, pixel);
                assert_eq!(need, Some(packet.frame.bytes().len()), "its rows are its bytes");
            }
            // LZ4 makes at most 255 bytes of one.
            assert!(packet.frame.bytes().len() <= 256 * (bytes.len() + 1), "in proportion to the bytes");
        }
        Err(_) => {}
    }
}

/// The opening message of a graph of two nodes.
fn opened() -> Message {
    let port = |name: &str| Port {
        name: name.to_owned(),
        packet: PacketType { name: "image".to_owned(), ..PacketType::default() },
        ..Port::default()
    };
    let node_type = |name: &str, inputs: Vec<Port>, outputs: Vec<Port>| NodeType {
        name: name.to_owned(),
        plugin: "p".to_owned(),
        source: inputs.is_empty(),
        side_effects: outputs.is_empty(),
        inputs,
        outputs,
        ..NodeType::default()
    };
    let node_types = vec![node_type("cam", vec![], vec![port("left")]), node_type("end", vec![port("image")], vec![])];
    let catalog = Catalog { plugins: vec!["p".to_owned()], node_types, ..Catalog::default() };
    let text =
        "plugins = [\"p\"]\n[nodes.a]\ntype = \"cam\"\n[nodes.b]\ntype = \"end\"\ninputs = { image = \"a.left\" }\n";
    let (graph, _) = check(&GraphText::parse("g.toml".as_ref(), text), &catalog).into_result().expect("a graph");
    let opened = Opened { text: text.to_owned(), graph, catalog, may_edit: true, changed_by: String::new() };
    Message::Opened(Box::new(opened))
}

/// A packet as a window receives it: a head in JSON, and bytes.
fn packet(format: u32, width: u32, height: u32, len: u64, is_compressed: bool, content: &[u8]) -> Vec<u8> {
    let head = format!(
        "{{\"node\":\"a\",\"port\":\"left\",\"format\":{format},\"width\":{width},\"height\":{height},\"len\":{len},\
         \"is_compressed\":{is_compressed},\"size_px\":[{width},{height}],\"tick\":[1,0,7,9],\"age_ns\":5,\"made_ns\":-3}}"
    );
    let mut bytes = vec![b'P'];
    bytes.extend_from_slice(&(head.len() as u32).to_le_bytes());
    bytes.extend_from_slice(head.as_bytes());
    bytes.extend_from_slice(content);
    bytes
}

pub fn seeds() -> Vec<Vec<u8>> {
    let gray = format::image_named("gray8").expect("a format").id;
    let wanted = Wanted { node: "a".to_owned(), port: "left".to_owned(), max_width: 320, group: 1 };
    let text = "plugins = []\n[nodes.arm]\ntype = \"arm_sim\"\nparams = { emergency_stop = false, reset = 1 }\n";
    let run = |new: String| Command::Run { id: 3, base: text.to_owned(), text: new };
    let mut frames = Vec::new();
    for kind in [tunnel::Kind::Ready, tunnel::Kind::Open, tunnel::Kind::Data, tunnel::Kind::Close] {
        tunnel::send(&mut frames, &tunnel::Frame::words(kind, 2, "desk")).expect("memory takes it");
    }
    let clock = tunnel::ClockFrame { offset_ns: -5, error_ns: 6, round_trip_ns: 7 }.bytes();
    tunnel::send(&mut frames, &tunnel::Frame { kind: tunnel::Kind::Clock, session: 0, bytes: clock })
        .expect("memory takes it");
    vec![
        frames,
        write_command(&Command::Preview { wanted: vec![wanted], interval_ms: 100 }),
        write_command(&Command::Taken { node: "a".to_owned(), port: "left".to_owned() }),
        write_command(&run(text.replace("reset = 1", "reset = 1, gain = 2.5"))),
        write_command(&run(text.replace("false", "true"))),
        write_command(&run("plugin_paths = [\"x\"]".to_owned())),
        write_command(&run("[nodes".to_owned())),
        write_message(&opened()),
        write_message(&Message::Counters([("a".to_owned(), Default::default())].into())),
        write_message(&Message::Faults(Vec::new())),
        write_message(&Message::Values(Default::default())),
        write_message(&Message::Ran { id: 3, result: Ok("1 parameter".to_owned()) }),
        write_message(&Message::Ended { words: "the run is over".to_owned() }),
        packet(gray, 4, 2, 8, false, b"12345678"),
        packet(
            gray,
            64,
            64,
            4096,
            true,
            &[0x1f, 7, 1, 0, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 20, 0],
        ),
        packet(0, 0, 0, 3, false, b"abc"),
        packet(gray, 4, 2, 9, false, b"123456789"),
        packet(gray, u32::MAX, u32::MAX, 8, false, b"12345678"),
        packet(gray, 4, 2, 8, true, b"\xff"),
    ]
}
