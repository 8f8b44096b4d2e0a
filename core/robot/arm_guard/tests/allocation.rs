//! The guard allocates nothing while the arm moves: its loop runs here in a thread whose allocations are counted.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use panoscope_arm_core::Chain;
use panoscope_arm_core::campaign::Random;
use panoscope_arm_core::interlock::{Evidence, Settings};
use panoscope_arm_guard::clock;
use panoscope_arm_guard::link::Connection;
use panoscope_arm_guard::message::{MAX_LEN, Report, Request, Status};
use panoscope_arm_guard::server::{self, Options};
use panoscope_firmware::{Behaviour, Firmware};
use rustix::net::{AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType, recv, send, socketpair};

/// Moving time that is watched.
const TRAFFIC: Duration = Duration::from_secs(10);
/// Limit of the whole test.
const LIMIT: Duration = Duration::from_secs(90);

static COUNT: AtomicU64 = AtomicU64::new(0);

thread_local! {
    static IS_COUNTED: Cell<bool> = const { Cell::new(false) };
}

struct Counting;

impl Counting {
    fn count() {
        // A thread that ends has no such variable any more.
        if IS_COUNTED.try_with(Cell::get).unwrap_or(false) {
            COUNT.fetch_add(1, Ordering::SeqCst);
        }
    }
}

// SAFETY: every call goes to the system's allocator unchanged, which upholds the contract.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        Self::count();
        // SAFETY: the caller's promise about `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the pointer came from `alloc` or `realloc` above, which got it from the system's allocator with this layout.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        Self::count();
        // SAFETY: as for `dealloc`; the caller's promise about `size` is passed on.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Sound, hostile and damaged requests, among them no cause to latch.
fn send_requests(socket: &rustix::fd::OwnedFd, random: &mut Random, reset: u64, buffer: &mut [u8; MAX_LEN]) {
    let now_ns = clock::now_ns();
    let sound = Request {
        sent_ns: now_ns,
        tip: Some((now_ns, Evidence { score: 0.9, in_space: true })),
        // To and fro.
        demand: Some((
            now_ns,
            [0.0, 0.0, 0.0, 0.0, 0.0, if now_ns / 1_000_000_000 % 2 == 0 { 0.1 } else { -0.1 }, 0.0, 0.0],
            6,
        )),
        settings: Settings::default(),
        emergency_stop: false,
        reset,
    };
    // A full socket loses records; the arm stops then.
    let put = |bytes: &[u8]| {
        let _ = send(socket, bytes, SendFlags::DONTWAIT | SendFlags::NOSIGNAL);
    };
    match random.of(20) {
        0 => put(&[0xff; 100]),
        1 => put(Request { sent_ns: now_ns + 1_000_000_000, ..sound }.encode(buffer)),
        2 => {
            put(Request { demand: Some((now_ns, [f64::NAN; 8], u32::MAX)), sent_ns: now_ns - 1, ..sound }
                .encode(buffer))
        }
        _ => {}
    }
    put(sound.encode(buffer));
}

#[test]
fn nothing_is_allocated_while_the_arm_moves() {
    let folder = std::env::temp_dir().join(format!("panoscope-allocation-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    // One byte of 2000 is damaged.
    let behaviour = Behaviour { watchdog_ms: 400, damaged_bytes: 0.0005, ..Behaviour::default() };
    let firmware = Firmware::plug_in("ALLOC-1", behaviour).expect("an arm");
    let connection =
        Connection { path: firmware.path().into(), baud: 921_600, answer_within: Duration::from_millis(240) };
    let (ours, theirs) =
        socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None).expect("a socket pair");
    let options = Options {
        target: (&connection).into(),
        chain: Chain::shipped().expect("the shipped arm"),
        latches: folder.clone(),
    };
    let guard = std::thread::spawn(move || {
        IS_COUNTED.set(true);
        server::serve(theirs, options)
    });
    let (mut random, mut buffer, mut reset) = (Random::new(5), [0; MAX_LEN], 0);
    let mut newest: Option<Box<Status>> = None;
    // Time in which the arm followed, and the count at its start; a stop latches and is released with allocations, at rest.
    let (mut watched, mut since): (Duration, Option<(Instant, u64)>) = (Duration::ZERO, None);
    // When the count was read, and what it was.
    let mut sample: Option<(i64, u64)> = None;
    let (start, mut released, mut refused) = (Instant::now(), Instant::now(), 0);
    while watched < TRAFFIC {
        assert!(start.elapsed() < LIMIT, "the arm moved for {watched:?} only: {newest:?}");
        send_requests(&ours, &mut random, reset, &mut buffer);
        while let Ok((_, length)) = recv(&ours, &mut buffer, RecvFlags::DONTWAIT) {
            match Report::decode(&buffer[..length]) {
                Some(Report::Status(status)) => newest = Some(status),
                Some(Report::Failed(words)) => panic!("{words}"),
                _ => {}
            }
        }
        let Some(status) = &newest else { continue };
        refused = status.refused;
        if status.latched {
            (since, sample) = (None, None);
            if released.elapsed() > Duration::from_millis(1500) {
                (reset, released) = (reset + 1, Instant::now());
            }
        } else if let Some((at, from)) = since {
            // Judged by a later state: when that is not latched, nothing latched before the sample, at rest and with allocations.
            if let Some((sampled_ns, count)) = sample.filter(|(sampled_ns, _)| status.at_ns > *sampled_ns) {
                assert_eq!(count - from, 0, "allocations in {:?} before {sampled_ns} ns", at.elapsed());
                watched += at.elapsed();
                (since, sample) = (Some((Instant::now(), count)), None);
            }
            sample = sample.or_else(|| Some((clock::now_ns(), COUNT.load(Ordering::SeqCst))));
        } else {
            since = Some((Instant::now(), COUNT.load(Ordering::SeqCst)));
        }
        std::thread::sleep(Duration::from_millis(8));
    }
    let log = firmware.log();
    println!("{watched:?} watched, {refused} requests refused, {} lines damaged on their way to the arm", log.damaged);
    assert!(refused > 20 && log.damaged > 5, "the traffic holds what it should");
    assert!(COUNT.load(Ordering::SeqCst) > 0, "the start allocates, so allocations are counted");
    drop(ours);
    guard.join().expect("no panic").expect("it ends");
    let _ = std::fs::remove_dir_all(Path::new(&folder));
}
