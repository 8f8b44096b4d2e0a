// Model of a node's own thread that a change of the graph asks to leave, and the change that may be undone.

use shuttle::sync::Arc;
use shuttle::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use shuttle::thread;

use super::runner::Runner;

/// A node with a thread, and its work.
struct Node {
    runner: Runner,
    inside: AtomicBool,
    wanted: AtomicUsize,
    done: AtomicUsize,
    is_over: AtomicBool,
}

/// The thread of the node: works when woken, leaves on request.
fn run(node: &Node) {
    node.runner.register_thread();
    assert!(!node.inside.swap(true, Ordering::SeqCst), "two threads run the node");
    loop {
        if node.runner.leave.accept() || node.is_over.load(Ordering::SeqCst) {
            break;
        }
        if node.done.load(Ordering::SeqCst) < node.wanted.load(Ordering::SeqCst) {
            node.done.fetch_add(1, Ordering::SeqCst);
            continue;
        }
        node.runner.park();
    }
    node.inside.store(false, Ordering::SeqCst);
    node.runner.thread_ended();
}

fn start(node: &Arc<Node>) -> thread::JoinHandle<()> {
    node.runner.thread_starts();
    let node = Arc::clone(node);
    thread::spawn(move || run(&node))
}

pub fn a_change_that_is_undone_leaves_the_node_with_one_thread() {
    let node = Arc::new(Node {
        runner: Runner::new(),
        inside: AtomicBool::new(false),
        wanted: AtomicUsize::new(0),
        done: AtomicUsize::new(0),
        is_over: AtomicBool::new(false),
    });
    let mut threads = vec![start(&node)];
    let feeder = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            for _ in 0..3 {
                node.wanted.fetch_add(1, Ordering::SeqCst);
                node.runner.wake();
            }
        })
    };
    for _ in 0..2 {
        // The change asks the thread to leave, then fails, as `Engine::hold` and `Engine::let_go` do.
        node.runner.leave.request();
        node.runner.wake();
        thread::yield_now();
        if node.runner.leave.withdraw() {
            continue;
        }
        while node.runner.has_thread() {
            thread::yield_now();
        }
        node.runner.leave.reset();
        threads.push(start(&node));
    }
    feeder.join().expect("no panic");
    // Whatever came before: the thread that the node has now does what is left.
    node.runner.wake();
    let is_done = || node.done.load(Ordering::SeqCst) == 3;
    let all_done = (0..2_000).any(|_| {
        thread::yield_now();
        is_done()
    });
    let has_thread = node.runner.has_thread();
    node.is_over.store(true, Ordering::SeqCst);
    node.runner.wake();
    threads.into_iter().for_each(|thread| thread.join().expect("no panic"));
    assert!(has_thread && all_done, "the node has no thread that works");
}

/// Work arrives while the thread goes to sleep, and nothing wakes it later.
pub fn no_wake_is_lost() {
    let node = Arc::new(Node {
        runner: Runner::new(),
        inside: AtomicBool::new(false),
        wanted: AtomicUsize::new(0),
        done: AtomicUsize::new(0),
        is_over: AtomicBool::new(false),
    });
    let thread = start(&node);
    for _ in 0..2 {
        node.wanted.fetch_add(1, Ordering::SeqCst);
        node.runner.wake();
    }
    // Deadlocks if the thread sleeps on.
    node.is_over.store(true, Ordering::SeqCst);
    node.runner.wake();
    thread.join().expect("no panic");
}
