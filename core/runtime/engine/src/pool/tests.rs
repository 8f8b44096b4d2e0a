use super::*;
use std::sync::atomic::AtomicU64;
use std::sync::mpsc;
use std::time::Duration;

use crate::sync::lock;

const PATIENCE: Duration = Duration::from_secs(60);

unsafe extern "C" fn add(data: *mut c_void, index: usize) {
    // SAFETY: the test passes a counter.
    unsafe { &*data.cast::<AtomicU64>() }.fetch_add(index as u64 + 1, Ordering::Relaxed);
}

#[test]
fn every_chunk_runs_once() {
    for threads in [1, 2, 8] {
        let pool = Pool::new(threads);
        pool.start(&(Arc::new(|_: u32, _: &mut Scratch| {}) as Task)).expect("threads");
        pool.enter();
        for chunks in [0usize, 1, 2, 7, 1000] {
            let sum = AtomicU64::new(0);
            // SAFETY: `add` takes a counter.
            assert!(unsafe { parallel_for(chunks, Some(add), (&raw const sum).cast_mut().cast()) });
            assert_eq!(sum.load(Ordering::Relaxed), (chunks * (chunks + 1) / 2) as u64);
        }
        assert!(pool.stop(Instant::now() + PATIENCE));
        CURRENT.set(None);
    }
}

unsafe extern "C" fn nested(data: *mut c_void, _: usize) {
    // SAFETY: `add` takes the same counter.
    unsafe { parallel_for(10, Some(add), data) };
}

#[test]
fn urgent_tasks_go_first_and_patient_ones_do_not_starve() {
    let pool = Pool::new(1);
    let (held, hold) = std::sync::mpsc::channel::<()>();
    let (done, seen) = std::sync::mpsc::channel();
    let hold = Mutex::new(hold);
    let task: Task = Arc::new(move |task, _: &mut Scratch| {
        if task == 0 {
            // The one worker is kept until all others wait.
            let _ = lock(&hold).recv();
        }
        let _ = done.send(task);
    });
    pool.start(&task).expect("threads");
    pool.push(0, Urgency::Urgent);
    pool.push(1, Urgency::Patient);
    pool.push(2, Urgency::Urgent);
    pool.push(3, Urgency::Urgent);
    let order = |count: usize| seen.iter().take(count).collect::<Vec<u32>>();
    held.send(()).expect("the worker waits");
    assert_eq!(order(4), [0, 2, 3, 1]);
    assert!(!pool.is_pressed());
    // What has waited too long goes first.
    pool.push(0, Urgency::Urgent);
    pool.push(4, Urgency::Patient);
    std::thread::sleep(std::time::Duration::from_nanos(MAX_PATIENCE_NS * 3 / 2));
    pool.push(5, Urgency::Urgent);
    held.send(()).expect("the worker waits");
    assert_eq!(order(3), [0, 4, 5]);
    assert!(pool.stop(Instant::now() + PATIENCE));
}

#[test]
fn loops_nest() {
    let pool = Pool::new(3);
    pool.start(&(Arc::new(|_: u32, _: &mut Scratch| {}) as Task)).expect("threads");
    pool.enter();
    let sum = AtomicU64::new(0);
    // SAFETY: `nested` takes a counter.
    unsafe { parallel_for(20, Some(nested), (&raw const sum).cast_mut().cast()) };
    assert_eq!(sum.load(Ordering::Relaxed), 20 * 55);
    assert!(pool.stop(Instant::now() + PATIENCE));
    CURRENT.set(None);
}

/// Chunks that wait for a signal of the test.
struct Gate {
    open: Mutex<bool>,
    opened: Condvar,
    /// Tells that a chunk waits.
    inside: mpsc::Sender<()>,
}

impl Gate {
    fn wait(&self) {
        let _ = self.inside.send(());
        let mut open = self.open.lock().expect("no panic");
        while !*open {
            open = self.opened.wait(open).expect("no panic");
        }
    }

    fn open(&self) {
        *self.open.lock().expect("no panic") = true;
        self.opened.notify_all();
    }
}

unsafe extern "C" fn hang(data: *mut c_void, _: usize) {
    // SAFETY: the tests pass a gate.
    unsafe { &*data.cast::<Gate>() }.wait();
}

unsafe extern "C" fn hang_deeper(data: *mut c_void, _: usize) {
    // SAFETY: `hang` takes the same gate.
    unsafe { parallel_for(16, Some(hang), data) };
}

/// A pool whose task 0 hangs in `body` on all workers, and whose other tasks report their number.
fn stuck(
    threads: usize,
    body: unsafe extern "C" fn(*mut c_void, usize),
) -> (Arc<Pool>, Arc<Gate>, mpsc::Receiver<u32>) {
    let (inside, waiting) = mpsc::channel();
    let gate = Arc::new(Gate { open: Mutex::new(false), opened: Condvar::new(), inside });
    let (done, seen) = mpsc::channel();
    let pool = Arc::new(Pool::new(threads));
    let theirs = Arc::clone(&gate);
    let task: Task = Arc::new(move |task, _: &mut Scratch| {
        if task == 0 {
            let _ = done.send(thread_id::current());
            // SAFETY: the gate outlives the pool's threads.
            unsafe { parallel_for(16, Some(body), Arc::as_ptr(&theirs).cast_mut().cast()) };
        } else {
            let _ = done.send(task);
        }
    });
    pool.start(&task).expect("threads");
    pool.push(0, Urgency::Urgent);
    (0..threads).for_each(|_| waiting.recv_timeout(PATIENCE).expect("all workers are stuck"));
    (pool, gate, seen)
}

#[test]
fn helpers_of_helpers_are_stuck_too() {
    let pool = Pool::new(1);
    let mut state = lock(&pool.inner.state);
    state.helping.extend([(4, 3), (3, 2), (2, 1), (6, 5)]);
    assert_eq!(state.stuck_with(1), [1, 2, 3, 4]);
    assert_eq!(state.stuck_with(5), [5, 6]);
    assert_eq!(state.stuck_with(7), [7]);
}

#[test]
fn all_who_are_stuck_in_nested_loops_are_given_up() {
    for body in [hang as unsafe extern "C" fn(*mut c_void, usize), hang_deeper] {
        let (pool, gate, seen) = stuck(4, body);
        let hung = seen.recv_timeout(PATIENCE).expect("task 0 tells who runs it");
        pool.push(1, Urgency::Urgent);
        pool.give_up(hung).expect("threads");
        for task in 1..=20 {
            assert_eq!(seen.recv_timeout(PATIENCE), Ok(task), "new workers do not enter what the old ones hang in");
            pool.push(task + 1, Urgency::Urgent);
        }
        gate.open();
        // The work of an abandoned thread belongs to no other thread.
        let until = Instant::now() + PATIENCE;
        while !lock(&pool.inner.state).given_up.is_empty() {
            assert!(Instant::now() < until, "they leave when they come back");
            std::thread::yield_now();
        }
        assert_eq!(lock(&pool.inner.state).live, 4);
        assert!(pool.stop(Instant::now() + PATIENCE));
    }
}

#[test]
fn tasks_go_on_while_all_workers_are_stuck() {
    let (pool, gate, seen) = stuck(2, hang);
    seen.recv_timeout(PATIENCE).expect("task 0 tells who runs it");
    pool.push(1, Urgency::Urgent);
    let mut now_ns = 1;
    assert!(!pool.relieve(now_ns).expect("threads"), "not at once");
    now_ns += MAX_STALL_NS;
    assert!(pool.relieve(now_ns).expect("threads"));
    assert_eq!(seen.recv_timeout(PATIENCE), Ok(1));
    let until = Instant::now() + PATIENCE;
    while !lock(&pool.inner.state).reliefs.is_empty() {
        assert!(Instant::now() < until, "it leaves when there is nothing to do");
        std::thread::yield_now();
    }
    for _ in 0..100 {
        now_ns += MAX_STALL_NS;
        assert!(!pool.relieve(now_ns).expect("threads"), "nothing waits");
    }
    gate.open();
    assert!(pool.stop(Instant::now() + PATIENCE));
}

#[test]
fn a_worker_that_panics_is_told_of_and_goes_on() {
    let pool = Pool::new(1);
    let (told, words) = mpsc::channel();
    let told = Mutex::new(told);
    pool.on_panic(Box::new(move |name, words| {
        let _ = told.lock().expect("no panic").send(format!("{name}: {words}"));
    }));
    let (done, seen) = mpsc::channel();
    let task: Task = Arc::new(move |task, _: &mut Scratch| {
        assert!(task != 0, "no task {task}");
        let _ = done.send(task);
    });
    pool.start(&task).expect("threads");
    pool.push(0, Urgency::Urgent);
    pool.push(1, Urgency::Urgent);
    let words = words.recv_timeout(PATIENCE).expect("it is told");
    assert!(words.starts_with("pool-") && words.ends_with(": no task 0"), "{words}");
    assert_eq!(seen.recv_timeout(PATIENCE), Ok(1));
    assert!(pool.stop(Instant::now() + PATIENCE));
}
