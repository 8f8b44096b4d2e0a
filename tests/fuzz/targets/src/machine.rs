//! Messages between a host and another machine.

use panoscope_engine::isolation::{Deny, Pixels};
use panoscope_host::isolate::relay::messages::{
    Coding, FileHash, FrameHead, MAX_FRAME_BYTES, Message, Picture, Turn, read, write,
};

pub fn run(bytes: &[u8]) {
    let mut rest = bytes;
    let Ok(message) = read(&mut rest) else { return };
    let head = bytes.len() - rest.len();
    let written = write(&message);
    assert_eq!(read(&mut &written[..]).ok(), Some(message.clone()), "what was read is written and read again");
    if let Message::Turn(Turn { message, files, frames, .. }) = message {
        assert!(message.len() + 8 * files.len() + 29 * frames.len() <= head, "in proportion to the bytes");
        for FrameHead { len, coding, coded_len, .. } in frames {
            assert!(len <= MAX_FRAME_BYTES && coded_len <= len && (coding != Coding::Raw || coded_len == len));
        }
    }
}

pub fn seeds() -> Vec<Vec<u8>> {
    let frame = |coding, coded_len| FrameHead { pool: 30, offset: 1 << 20, len: 64, coding, coded_len };
    let picture = |width| Coding::H264(Picture { stream: 1, width, height: 2, stride_bytes: 3 * width, begins: true });
    let file = FileHash { path: "/models/a.onnx".to_owned(), sha256: "ab".repeat(32) };
    let turn = |files, frames| Turn { lane: 1, kind: 2, at_ns: 7, message: b"message".to_vec(), files, frames };
    let hello = Message::Hello {
        version: "Panoscope 1, plugin ABI 1.0, messages 3".to_owned(),
        group: "rack".to_owned(),
        threads: 2,
        memory_bytes: 1 << 32,
        deny: Deny { network: false, new_files: true },
        pixels: Pixels::H264,
        timeout_ms: 1000,
    };
    let messages = [
        hello,
        Message::Pool { number: 30, len: 1 << 32, is_own: false },
        Message::Plugin { id: 1, path: "/plugins/libtools.so".to_owned(), sha256: "cd".repeat(32) },
        Message::Lane { id: 1 },
        Message::Turn(turn(vec![file], vec![frame(Coding::Raw, 64), frame(Coding::Lz4, 9)])),
        // A frame that grows, and one that is longer than it says.
        Message::Turn(turn(Vec::new(), vec![frame(Coding::Lz4, 64)])),
        Message::Turn(turn(Vec::new(), vec![frame(Coding::Raw, 65)])),
        Message::Turn(turn(Vec::new(), vec![frame(picture(4), 9)])),
        Message::Turn(turn(Vec::new(), vec![frame(picture(9), 9)])),
        Message::Bye,
        Message::Ready,
        Message::Lost { words: "it crashed".to_owned() },
    ];
    messages.iter().map(write).collect()
}
