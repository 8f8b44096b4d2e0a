// Models of the thread pool: tasks, parallel loops, abandoned workers.

use std::ffi::c_void;
use std::time::{Duration, Instant};

use shuttle::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use shuttle::sync::{Arc, Mutex};
use shuttle::thread;

use super::pool::{Pool, Task, Urgency, parallel_for};
use super::thread_id;
use crate::shim::thread::{begin, join_all};

/// Time never passes in a model: all waits are ended by the threads.
fn later() -> Instant {
    Instant::now() + Duration::from_secs(3600)
}

/// Number of turns of other threads while a model waits. A wait that is longer has failed: the model stops the pool first, so that no worker is cut
/// off.
const TURNS: usize = 2_000;

fn wait_for(condition: impl Fn() -> bool) -> bool {
    (0..TURNS).any(|_| {
        thread::yield_now();
        condition()
    })
}

pub fn every_task_runs_once() {
    begin();
    let runs: Arc<Vec<AtomicUsize>> = Arc::new((0..4).map(|_| AtomicUsize::new(0)).collect());
    let pool = Arc::new(Pool::new(2));
    let counts = Arc::clone(&runs);
    let task: Task = Arc::new(move |n, _| _ = counts[n as usize].fetch_add(1, Ordering::SeqCst));
    pool.start(&task).expect("threads");
    let pushers: Vec<_> = (0..2)
        .map(|k| {
            let pool = Arc::clone(&pool);
            thread::spawn(move || {
                pool.push(2 * k, Urgency::Urgent);
                pool.push(2 * k + 1, Urgency::Patient);
            })
        })
        .collect();
    pushers.into_iter().for_each(|pusher| pusher.join().expect("no panic"));
    // Before the pool stops, because that wakes all workers.
    let all_ran = wait_for(|| runs.iter().all(|runs| runs.load(Ordering::SeqCst) > 0));
    let joined = pool.stop(later());
    join_all();
    assert!(all_ran, "a task waits for ever");
    assert!(joined, "all workers end");
    assert!(runs.iter().all(|runs| runs.load(Ordering::SeqCst) == 1), "a task ran twice");
}

const CHUNKS: usize = 4;

/// The data of a loop.
struct Work {
    runs: [AtomicUsize; CHUNKS],
    is_over: AtomicBool,
    late: AtomicBool,
}

unsafe extern "C" fn chunk(data: *mut c_void, index: usize) {
    // SAFETY: the model passes its data, which outlives all threads.
    let work = unsafe { &*data.cast::<Work>() };
    thread::yield_now();
    work.runs[index].fetch_add(1, Ordering::SeqCst);
    if work.is_over.load(Ordering::SeqCst) {
        work.late.store(true, Ordering::SeqCst);
    }
}

/// Two threads run a loop each on the same workers.
pub fn every_chunk_runs_once_before_its_loop_returns() {
    begin();
    let pool = Arc::new(Pool::new(2));
    let nothing: Task = Arc::new(|_, _| ());
    pool.start(&nothing).expect("threads");
    let work = || Arc::new(Work { runs: Default::default(), is_over: AtomicBool::new(false), late: AtomicBool::new(false) });
    let loops = [work(), work()];
    let callers: Vec<_> = loops
        .iter()
        .map(|work| {
            let (pool, work) = (Arc::clone(&pool), Arc::clone(work));
            thread::spawn(move || {
                thread_id::set(thread_id::next());
                let _visit = pool.visit();
                // SAFETY: `chunk` takes this data, which the model keeps until all threads have ended.
                assert!(unsafe { parallel_for(CHUNKS, Some(chunk), Arc::as_ptr(&work).cast_mut().cast()) });
                work.is_over.store(true, Ordering::SeqCst);
            })
        })
        .collect();
    callers.into_iter().for_each(|caller| caller.join().expect("no panic"));
    let joined = pool.stop(later());
    join_all();
    assert!(joined, "all workers end");
    for work in &loops {
        assert!(work.runs.iter().all(|runs| runs.load(Ordering::SeqCst) == 1), "each chunk once");
        assert!(!work.late.load(Ordering::SeqCst), "a chunk ran after its loop had returned");
    }
}

/// One task hangs until the end; the watchdog abandons its worker.
pub fn an_abandoned_worker_is_replaced_and_takes_no_other_task() {
    begin();
    let (stuck_in, gate) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicBool::new(false)));
    let ran = Arc::new(Mutex::new(Vec::new()));
    let pool = Arc::new(Pool::new(1));
    let (number, opens, list) = (Arc::clone(&stuck_in), Arc::clone(&gate), Arc::clone(&ran));
    let task: Task = Arc::new(move |n, _| {
        if n > 0 {
            list.lock().expect("no panic").push((n, thread_id::current()));
            return;
        }
        number.store(thread_id::current(), Ordering::SeqCst);
        while !opens.load(Ordering::SeqCst) {
            thread::yield_now();
        }
    });
    pool.start(&task).expect("threads");
    pool.push(0, Urgency::Urgent);
    let hangs = wait_for(|| stuck_in.load(Ordering::SeqCst) != 0);
    let stuck = stuck_in.load(Ordering::SeqCst);
    pool.give_up(stuck).expect("threads");
    let opener = {
        let gate = Arc::clone(&gate);
        thread::spawn(move || gate.store(true, Ordering::SeqCst))
    };
    for n in 1..4 {
        pool.push(n, Urgency::Urgent);
        thread::yield_now();
    }
    opener.join().expect("no panic");
    let all_ran = wait_for(|| ran.lock().expect("no panic").len() >= 3);
    let joined = pool.stop(later());
    join_all();
    let mut ran = ran.lock().expect("no panic").clone();
    ran.sort_unstable();
    assert!(hangs && all_ran && joined, "{hangs} {all_ran} {joined}: a task waits for ever");
    assert_eq!(ran.iter().map(|(n, _)| *n).collect::<Vec<_>>(), [1, 2, 3], "each task once");
    assert!(ran.iter().all(|(_, number)| *number != stuck), "the abandoned worker took a task");
}
