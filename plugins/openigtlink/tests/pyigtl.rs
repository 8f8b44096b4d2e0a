//! pyigtl as the peer, as server and as client.

use crate::common::{PIXELS, Peer, fill, free_port, pyigtl_peer, receive_until, receiver, send_until, sender};
use panoscope_node::Bgr8;
use panoscope_node::abi::Pose;

#[test]
fn our_client_reads_what_pyigtls_server_sends() {
    for version in ["1", "2"] {
        let Some(mut python) = pyigtl_peer() else {
            return panoscope_testing::skipped!("pyigtl is not installed; `cargo xtask test` fetches it");
        };
        let port = free_port();
        let peer = Peer::start(python.args(["serve", &port.to_string(), version]));
        peer.wait_for("listening");
        let mut node = receiver(&format!("role = 'client', port = {port}"));
        let mut seen = std::collections::BTreeSet::new();
        receive_until(&mut node, "one message of each type", |out| {
            if let Ok(picture) = out.plane::<Bgr8>("image") {
                assert_eq!((picture.width, picture.height), (3, 2));
                assert_eq!((&picture.row(0)[..3], &picture.row(1)[6..]), (&[20, 10, 0][..], &[170, 160, 150][..]));
                seen.insert("image");
            }
            if let Ok(pose) = out.value::<Pose>("pose") {
                assert_eq!(pose.a_from_b_mm, [10.0, 20.0, 30.0]);
                assert!(pose.a.starts_with(b"Tracker\0") && pose.b.starts_with(b"Tool\0"));
                seen.insert("transform");
            }
            if out.text("names").ok() == Some("Target") {
                let table = out.table("points").expect("points");
                assert_eq!(table.rows().next(), Some(&[1.5, -2.5, 3.5, 4.0][..]));
                seen.insert("point");
            }
            if out.text("text").ok() == Some("a text") {
                seen.insert("string");
            }
            if out.cloud("cloud").is_ok_and(|points| points.len() == 3 && points[1].x_mm == 1.0) {
                seen.insert("polydata");
            }
            seen.len() == 5
        });
        for name in ["damaged", "skipped", "refused"] {
            assert_eq!(node.metric(name), Some(0.0), "{name} in version {version}");
        }
    }
}

#[test]
fn pyigtls_client_reads_what_our_server_sends() {
    for version in [1, 2] {
        let Some(mut python) = pyigtl_peer() else {
            return panoscope_testing::skipped!("pyigtl is not installed; `cargo xtask test` fetches it");
        };
        let mut node = sender(&format!("port = 0, version = {version}"));
        fill(&mut node);
        node.process().expect("nobody is there yet");
        let port = node.metric("port").expect("a port").to_string();
        let names = ["CameraToBase", "Tip", "Panoscope", "Text", "Detections"];
        let mut peer = Peer::start(python.args(["listen", &port]).args(names));
        let mut printed = Vec::new();
        send_until(&mut node, "the program gets one message of each", |_| {
            printed.extend(peer.printed());
            peer.has_ended()
        });
        printed.extend(peer.end());
        let frames = if version > 1 { " a=Base b=Camera" } else { "" };
        let sum: u32 = PIXELS.iter().map(|byte| u32::from(*byte)).sum();
        let expected = [
            format!("TRANSFORM CameraToBase 0.00 -1.00 0.00 10.00 1.00 0.00 0.00 20.00 0.00 0.00 1.00 30.00{frames}"),
            "TRANSFORM Tip 1.00 0.00 0.00 1.50 0.00 1.00 0.00 -2.50 0.00 0.00 1.00 66.00".to_owned(),
            format!("IMAGE Panoscope (1, 2, 3, 3) uint8 first [20, 10, 0] sum {sum}"),
            "STRING Text a text".to_owned(),
            "POINT Detections Grasper 13.00 24.00 0.00 r 5.00 of Panoscope".to_owned(),
        ];
        for line in expected {
            assert!(printed.contains(&line), "version {version}: `{line}` is not in {printed:#?}");
        }
    }
}
