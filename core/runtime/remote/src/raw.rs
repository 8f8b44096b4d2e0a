//! zenoh alone, as the peer of benches: the same session settings, and payloads of one size.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use zenoh::Wait;
use zenoh::bytes::ZBytes;

use crate::network::{self, Address, NetworkError};

/// Maximum wait for the sent messages.
const PATIENCE: Duration = Duration::from_secs(30);

/// Time in which `count` messages of `bytes` arrive, sent as fast as zenoh takes them from one session to another over
/// TCP of this machine. Each is copied once on its way in and once on its way out, as a frame of a pool has to be.
///
/// # Errors
/// zenoh reports an error, or messages do not arrive.
pub fn publish(port: u16, bytes: usize, count: u64) -> Result<Duration, NetworkError> {
    let address = Address::parse(&format!("tcp/127.0.0.1:{port}"), false)?;
    let there = network::listen("raw", &address, None, &[])?;
    let here = network::connect(&address, None)?;
    let zenoh = |error: zenoh::Error| NetworkError::Zenoh(error.to_string());
    let arrived = Arc::new(AtomicU64::new(0));
    let counter = Arc::clone(&arrived);
    let (deliver, delivered) = std::sync::mpsc::channel::<ZBytes>();
    let receiver = std::thread::spawn(move || {
        let mut frame = vec![0_u8; bytes];
        while let Ok(payload) = delivered.recv() {
            let _ = std::io::Read::read_exact(&mut payload.reader(), &mut frame);
            counter.fetch_add(1, Ordering::Release);
        }
    });
    let subscriber = there
        .declare_subscriber("panoscope/raw")
        .callback(move |sample| _ = deliver.send(sample.payload().clone()))
        .wait()
        .map_err(zenoh)?;
    let publisher = network::publisher(&here, "panoscope/raw".to_owned(), false)?;
    let end = Instant::now() + PATIENCE;
    while !publisher.matching_status().wait().map_err(zenoh)?.matching() && Instant::now() < end {
        std::thread::sleep(Duration::from_millis(1));
    }
    let frame = vec![0x5a_u8; bytes];
    let mut begin = Instant::now();
    // The first is not counted: buffers grow with it.
    for sent in 0..=count {
        publisher.put(ZBytes::from(frame.as_slice())).wait().map_err(zenoh)?;
        if sent == 0 {
            while arrived.load(Ordering::Acquire) == 0 && Instant::now() < end {
                std::thread::sleep(Duration::from_micros(100));
            }
            begin = Instant::now();
        }
    }
    while arrived.load(Ordering::Acquire) <= count && Instant::now() < end {
        std::thread::sleep(Duration::from_micros(50));
    }
    let taken = begin.elapsed();
    let all = arrived.load(Ordering::Acquire) > count;
    drop(subscriber);
    let _ = (here.close().wait(), there.close().wait());
    let _ = receiver.join();
    if all { Ok(taken) } else { Err(NetworkError::Zenoh("messages did not arrive".to_owned())) }
}
