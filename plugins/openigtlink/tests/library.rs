//! The OpenIGTLink library (Debian's libopenigtlink) as the peer, as server and as client.

use std::process::Command;

use crate::common::{
    COLUMNS_OF_POINTS, PIXELS, Peer, fill, free_port, library_peer, receive_until, receiver, send_until, sender,
};
use panoscope_node::Bgr8;
use panoscope_node::abi::{Pose, Scalar};

#[test]
fn our_client_reads_what_the_librarys_server_sends() {
    let Some(program) = library_peer() else {
        return panoscope_testing::skipped!("libopenigtlink-dev is not installed");
    };
    let port = free_port();
    let peer = Peer::start(Command::new(program).args(["serve", &port.to_string()]));
    peer.wait_for("listening");
    let mut node = receiver(&format!("role = 'client', port = {port}"));
    let mut seen = std::collections::BTreeSet::new();
    receive_until(&mut node, "one message of each type", |out| {
        if let Ok(picture) = out.plane::<Bgr8>("image") {
            assert_eq!((picture.width, picture.height), (3, 2));
            // The library's bytes are red, green, blue.
            assert_eq!(picture.row(0)[..3], [20, 10, 0]);
            assert_eq!(picture.row(1)[6..], [170, 160, 150]);
            seen.insert("image");
        }
        if let Ok(pose) = out.value::<Pose>("pose") {
            let name = out.text("names").expect("names");
            match name {
                "ToolToTracker" => {
                    let half = std::f64::consts::FRAC_1_SQRT_2;
                    assert!(pose.a_from_b_wxyz.iter().zip([half, 0.0, 0.0, half]).all(|(a, b)| (a - b).abs() < 1e-6));
                    assert_eq!(pose.a_from_b_mm, [10.0, 20.0, 30.0]);
                    assert!(pose.a.starts_with(b"Tracker\0") && pose.b.starts_with(b"Tool\0"));
                    seen.insert("transform");
                }
                "Probe" => {
                    assert!((pose.a_from_b_wxyz[0] - 0.8).abs() < 1e-6 && (pose.a_from_b_wxyz[3] - 0.6).abs() < 1e-6);
                    assert_eq!(pose.a_from_b_mm, [1.0, 2.0, 3.0]);
                    seen.insert("position");
                }
                "Grasper" => {
                    assert_eq!(pose.a_from_b_mm, [10.0, 20.0, 30.0]);
                    seen.insert("tdata");
                }
                other => panic!("a pose of `{other}`"),
            }
        }
        if out.text("names").ok() == Some("Target") {
            let table = out.table("points").expect("points");
            assert!(table.names().eq(COLUMNS_OF_POINTS));
            assert_eq!(table.rows().next(), Some(&[1.5, -2.5, 3.5, 4.0][..]));
            seen.insert("point");
        }
        if let Ok(points) = out.cloud("cloud")
            && !points.is_empty()
        {
            assert_eq!((points.len(), points[1].x_mm, points[2].y_mm, points[0].z_mm), (3, 1.0, 1.0, 50.0));
            seen.insert("polydata");
        }
        match out.text("text") {
            Ok("a text") => drop(seen.insert("string")),
            Ok("calibrating") => {
                let status = out.value::<Scalar>("status").expect("a code");
                assert_eq!(status.value, 6.0);
                seen.insert("status");
            }
            _ => {}
        }
        seen.len() == 8
    });
    for name in ["damaged", "skipped", "refused"] {
        assert_eq!(node.metric(name), Some(0.0), "{name}");
    }
    let latency_ms = node.metric("latency_ms").expect("timestamps");
    assert!((-1000.0..60_000.0).contains(&latency_ms), "{latency_ms} ms");
}

#[test]
fn the_librarys_client_reads_what_our_server_sends() {
    let Some(program) = library_peer() else {
        return panoscope_testing::skipped!("libopenigtlink-dev is not installed");
    };
    let mut node = sender("port = 0, pixel_mm = 0.5, cloud_step = 1, version = 1");
    fill(&mut node);
    node.process().expect("nobody is there yet");
    let port = node.metric("port").expect("a port");
    let peer = Peer::start(Command::new(program).args(["listen", &port.to_string()]));
    send_until(&mut node, "the program connects and gets messages", |node| node.metric("sent").unwrap_or(0.0) > 30.0);
    node.finish().expect("it ends");
    let printed = peer.end();
    let sum: u32 = PIXELS.iter().map(|byte| u32::from(*byte)).sum();
    let expected = [
        "TRANSFORM CameraToBase 0.00 -1.00 0.00 10.00 1.00 0.00 0.00 20.00 0.00 0.00 1.00 30.00",
        "TRANSFORM Tip 1.00 0.00 0.00 1.50 0.00 1.00 0.00 -2.50 0.00 0.00 1.00 66.00",
        &format!("IMAGE Panoscope 3x2x1 3 spacing 0.50 first 20 10 0 sum {sum}"),
        "POINT Detections Grasper/Detection 6.50 12.00 0.00 r 2.50 of Panoscope",
        "POLYDATA Surface 2 points 2 vertices first 1.00 2.00 50.00 attributes 1 RGBA 2 x 4 first 1.00 0.20 0.00",
        "STRING Text a text",
        "STATUS Panoscope 19 the graph has ended",
    ];
    for line in expected {
        assert!(printed.iter().any(|found| found == line), "`{line}` is not in {printed:#?}");
    }
    assert!(!printed.iter().any(|line| line.contains("damaged") || line.contains("skipped")), "{printed:#?}");
}

#[test]
fn positions_and_tracking_reach_the_library() {
    let Some(program) = library_peer() else {
        return panoscope_testing::skipped!("libopenigtlink-dev is not installed");
    };
    for (poses_as, lines) in [
        ("position", &["POSITION CameraToBase 10.00 20.00 30.00  0.00 0.00 0.71 0.71"][..]),
        ("tracking", &["TDATA Tracker CameraToBase/2 10.00 20.00 30.00 Tip/3 1.50 -2.50 66.00"]),
    ] {
        let mut node = sender(&format!("port = 0, poses_as = '{poses_as}'"));
        fill(&mut node);
        node.process().expect("nobody is there yet");
        let port = node.metric("port").expect("a port");
        let peer = Peer::start(Command::new(&program).args(["listen", &port.to_string()]));
        send_until(&mut node, "the program gets messages", |node| node.metric("sent").unwrap_or(0.0) > 30.0);
        node.finish().expect("it ends");
        let printed = peer.end();
        for line in lines {
            assert!(printed.iter().any(|found| found == line), "`{line}` is not in {printed:#?}");
        }
    }
}

#[test]
fn the_librarys_requests_are_answered() {
    let Some(program) = library_peer() else {
        return panoscope_testing::skipped!("libopenigtlink-dev is not installed");
    };
    let mut node = sender("port = 0");
    fill(&mut node);
    node.process().expect("nobody is there yet");
    let port = node.metric("port").expect("a port");
    let mut peer = Peer::start(Command::new(program).args(["ask", &port.to_string()]));
    let mut printed = Vec::new();
    send_until(&mut node, "the requests are answered", |_| {
        printed.extend(peer.printed());
        peer.has_ended()
    });
    printed.extend(peer.end());
    let expected = [
        "CAPABILITY  IMAGE TRANSFORM POSITION POINT POLYDATA TDATA STATUS STRING CAPABILITY",
        "RTS_TDATA Tracker 0",
        "TDATA Tracker CameraToBase/2 10.00 20.00 30.00 Tip/3 1.50 -2.50 66.00",
        "done",
    ];
    for line in expected {
        assert!(printed.iter().any(|found| found == line), "`{line}` is not in {printed:#?}");
    }
    assert!(
        printed.iter().any(|line| line.starts_with("STATUS  1 ") || line.starts_with("STATUS  13 ")),
        "{printed:#?}"
    );
    // Nobody gets tracking data who did not ask for it.
    let first = printed.iter().position(|line| line.starts_with("TDATA")).expect("tracking data");
    let granted = printed.iter().position(|line| line.starts_with("RTS_TDATA")).expect("an answer");
    assert!(granted < first, "{printed:#?}");
}
