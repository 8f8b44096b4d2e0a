//! A source that does not answer never hangs the node, and a lost source is reopened.

use crate::common;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::Command;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Instant;

use crate::common::{Folder, PATIENCE, until, value};
use panoscope_capture::capture::Capture;
use panoscope_node::harness::{Harness, Outputs, Setup};

#[test]
fn an_address_that_accepts_and_says_nothing_is_given_up() {
    let folder = Folder::new("silent");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/scope.mjpg", listener.local_addr().unwrap());
    let message = folder.refused(&format!(r#"left = "{address}", open_limit_s = 0.5"#));
    assert!(message.contains(&address) && message.contains("does not open"), "{message}");
}

#[test]
fn a_file_that_never_answers_is_given_up_and_not_opened_over_and_over() {
    let folder = Folder::new("fifo");
    let path = folder.0.join("scope.avi");
    assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
    for attempt in 0..5 {
        let begin = Instant::now();
        let message = folder.refused(r#"left = "scope.avi", open_limit_s = 0.2"#);
        assert!(begin.elapsed() < PATIENCE, "{attempt}");
        let words = if attempt < 3 { "no answer within 0.2 s" } else { "earlier attempts have not returned" };
        assert!(message.contains("scope.avi") && message.contains(words), "{attempt}: {message}");
    }
    // Whoever waits is let go.
    drop(std::fs::OpenOptions::new().write(true).open(&path).unwrap());
}

#[test]
fn an_element_that_does_not_exist_is_named() {
    let folder = Folder::new("element");
    let message =
        folder.refused(r#"left = "videotestsrk num-buffers=3 ! video/x-raw,width=32 ! appsink", open_limit_s = 20.0"#);
    assert!(message.contains("`videotestsrk`") && message.contains("gst-inspect-1.0"), "{message}");
}

fn jpeg(gray: u8) -> Vec<u8> {
    let picture = image::RgbImage::from_pixel(64, 48, image::Rgb([gray; 3]));
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Jpeg).unwrap();
    bytes.into_inner()
}

/// Serves Motion JPEG: sends `frames` for every text received, then the connection ends and the next one is accepted.
fn serve(listener: &TcpListener, connections: usize, served: &Sender<()>, end: &Receiver<()>) {
    for _ in 0..connections {
        let Ok((mut stream, _)) = listener.accept() else { return };
        let mut request = [0; 4096];
        let _ = stream.read(&mut request);
        let _ = stream.write_all(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=part\r\n\r\n");
        send(&mut stream);
        let _ = served.send(());
        // The connection stands until the test wants it to end.
        if end.recv().is_err() {
            return;
        }
    }
}

fn send(stream: &mut TcpStream) {
    for index in 0..40_u8 {
        let picture = jpeg(100 + index);
        let head = format!("--part\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", picture.len());
        if stream
            .write_all(head.as_bytes())
            .and_then(|()| stream.write_all(&picture))
            .and_then(|()| stream.write_all(b"\r\n"))
            .is_err()
        {
            return;
        }
    }
}

#[test]
fn a_lost_stream_is_a_fault_and_comes_back() {
    let folder = Folder::new("lost");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/scope.mjpg", listener.local_addr().unwrap());
    let (served, is_served) = channel();
    let (end, must_end) = channel();
    let server = std::thread::spawn(move || serve(&listener, 2, &served, &must_end));
    let setup = Setup::new(&format!(r#"params = {{ left = "{address}", open_limit_s = 20.0 }}"#)).graph_dir(&folder.0);
    let mut node = Harness::<Capture>::open(setup).unwrap();
    let is_shown = |out: &Outputs| !out.is_empty("left").unwrap();
    let out = until(&mut node, is_shown).unwrap();
    assert!(value(&out, "left") >= 95);
    is_served.recv_timeout(PATIENCE).unwrap();
    end.send(()).unwrap();
    let out = until(&mut node, |out| out.fault().is_some()).unwrap();
    let words = out.fault().unwrap().to_owned();
    assert!(
        words.contains(&address) && words.contains("disappeared after") && words.contains("retrying every second"),
        "{words}"
    );
    assert!(out.is_empty("left").unwrap());
    assert_eq!(node.metric("lost"), Some(1.0));
    // Empty ticks, each later than the one before, and one fault only.
    let out = until(&mut node, is_shown).unwrap();
    assert!(out.fault().is_none() && value(&out, "left") >= 95);
    assert_eq!((node.metric("lost"), node.metric("reconnects")), (Some(0.0), Some(1.0)));
    drop(node);
    drop(end);
    server.join().unwrap();
}

#[test]
fn a_lost_stream_ends_a_batch_with_its_place() {
    let folder = Folder::new("lost_batch");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/scope.mjpg", listener.local_addr().unwrap());
    let (served, is_served) = channel();
    let (end, must_end) = channel();
    let server = std::thread::spawn(move || serve(&listener, 1, &served, &must_end));
    let mut node = folder.open(&format!(r#"left = "{address}", open_limit_s = 20.0"#));
    node.process().unwrap();
    is_served.recv_timeout(PATIENCE).unwrap();
    end.send(()).unwrap();
    let (all, failure) = common::drain_to_failure(&mut node);
    let message = failure.expect("a lost stream is no regular end");
    assert!(
        message.contains("STATUS_END") && message.contains(&format!("disappeared after {} frames", all.len() + 1)),
        "{message}"
    );
    drop(end);
    server.join().unwrap();
}
