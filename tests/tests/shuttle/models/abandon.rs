// Model of a running call and the watchdog that abandons it.

use panoscope_abi::Tick;
use shuttle::sync::atomic::Ordering;
use shuttle::sync::{Arc, Mutex};
use shuttle::thread;

use super::busy::{Busy, CallKind};
use super::thread_id;

const CALLS: [CallKind; 5] =
    [CallKind::Process, CallKind::Open, CallKind::Process, CallKind::SaveState, CallKind::Process];

/// Makes the calls from `first` on, each at a different time, as a thread with this number. Returns those that ended.
fn run(busy: &Busy, first: usize, number: u32) -> Vec<usize> {
    thread_id::set(number);
    let mut ended = Vec::new();
    for (n, kind) in CALLS.into_iter().enumerate().skip(first) {
        let since_ns = n as u64 + 1;
        busy.begin_kind(kind, &Tick { source: 3, flags: 0, seq: n as u64, capture_ns: 0 }, since_ns);
        thread::yield_now();
        if !busy.end(since_ns) {
            // Left behind: it touches nothing any more.
            break;
        }
        ended.push(n);
    }
    ended
}

pub fn a_call_ends_or_is_abandoned_and_the_watchdog_knows_what_it_was_for() {
    let busy = Arc::new(Busy::default());
    let mine = Arc::clone(&busy);
    let runner = thread::spawn(move || run(&mine, 0, 7));
    let mut replaced = None;
    for _ in 0..6 {
        // As the watchdog does.
        let since_ns = busy.since_ns.load(Ordering::Acquire);
        let (kind, tick, number) = (busy.kind(), busy.tick(), busy.thread.load(Ordering::Relaxed));
        if since_ns != 0 && busy.abandon(since_ns) {
            let call = since_ns as usize - 1;
            let described = (kind, tick.source, tick.seq, number);
            assert_eq!(described, (CALLS[call], 3, call as u64, 7), "it is another call's");
            busy.clear();
            // Another thread makes the next calls while the abandoned one returns.
            let theirs = Arc::clone(&busy);
            replaced = Some((call, thread::spawn(move || run(&theirs, call + 1, 8))));
            break;
        }
        thread::yield_now();
    }
    let ended = runner.join().expect("no panic");
    let abandoned = replaced.as_ref().map_or(CALLS.len(), |(call, _)| *call);
    assert_eq!(ended, (0..abandoned).collect::<Vec<_>>(), "each call ends once or is abandoned");
    if let Some((call, next)) = replaced {
        let ended = next.join().expect("no panic");
        assert_eq!(ended, (call + 1..CALLS.len()).collect::<Vec<_>>(), "the thread in its place is not disturbed");
    }
    assert_eq!(busy.since_ns.load(Ordering::Acquire), 0, "no call runs");
}
