//! Parts of the runtime under a scheduler that explores thousands of interleavings (`shuttle`, after Burckhardt et al., "A randomized scheduler with
//! probabilistic guarantees of finding bugs", 2010): frame pool, parameter snapshot, region, abandoned calls, join, thread pool, threads that leave,
//! live changes. `build.rs` prepares their sources with the scheduler's locks, atomics and threads; nothing else in them is changed. It also prepares
//! variants with one defect each, which a model of that part must find.
#![allow(dead_code, missing_docs, unreachable_pub, unused_imports, private_interfaces)]
#![allow(clippy::undocumented_unsafe_blocks, clippy::duplicate_mod, clippy::module_inception)]

mod shim;
mod stubs;

include!(concat!(env!("OUT_DIR"), "/subjects.rs"));

use std::panic::{AssertUnwindSafe, catch_unwind};

use shuttle::scheduler::PctScheduler;
use shuttle::{Config, FailurePersistence, Runner};

/// Number of interleavings that are tried; takes half a second to some seconds each.
const ORDERS: usize = 2_000;
/// Maximum number of interleavings in which a defect must be found.
const MAX_ORDERS: usize = 20_000;
/// Number of preemptions that an interleaving may need to show a defect.
const DEPTH: usize = 3;

/// Checks that a model holds in every interleaving that is tried.
fn holds(model: fn()) {
    shuttle::check_pct(model, ORDERS, DEPTH);
}

/// Whether a model fails in one of the interleavings.
fn fails(model: fn()) -> bool {
    let mut config = Config::new();
    config.failure_persistence = FailurePersistence::None;
    let run = move || _ = Runner::new(PctScheduler::new(DEPTH, MAX_ORDERS), config).run(model);
    // On a thread of its own: what an order that failed leaves in thread-locals goes with it.
    std::thread::spawn(move || catch_unwind(AssertUnwindSafe(run)).is_err()).join().unwrap_or(true)
}

macro_rules! models {
    ($($subject:ident :: $model:ident),* $(,)?) => {
        $(#[test] fn $model() { holds($subject::models::$model); })*
    };
}

models! {
    frames::no_buffer_has_two_owners,
    frames::the_last_of_several_releases_frees,
    frames::a_buffer_that_is_gone_cannot_be_kept,
    params::readers_end_with_the_snapshot_that_stays,
    region::every_tick_is_delivered_once_or_dropped_whatever_the_pause,
    region::a_tick_admitted_alone_has_the_region_to_itself,
    abandon::a_call_ends_or_is_abandoned_and_the_watchdog_knows_what_it_was_for,
    join::a_node_runs_each_tick_once_and_on_one_thread,
    join::a_node_that_was_taken_out_is_not_fired_again,
    pool::every_task_runs_once,
    pool::every_chunk_runs_once_before_its_loop_returns,
    pool::an_abandoned_worker_is_replaced_and_takes_no_other_task,
    leave::a_change_that_is_undone_leaves_the_node_with_one_thread,
    leave::no_wake_is_lost,
    apply::every_tick_runs_once_or_is_dropped_whatever_changes,
    apply::a_rewired_node_keeps_what_waits,
}

macro_rules! mutations {
    ($($mutation:ident => $model:ident),* $(,)?) => {
        &[$((stringify!($mutation), $mutation::models::$model as fn())),*]
    };
}

/// Each mutation, and the model that must find it.
const CAUGHT: &[(&str, fn())] = mutations! {
    a_gone_buffer_is_retained => a_buffer_that_is_gone_cannot_be_kept,
    a_release_frees_before_the_last => the_last_of_several_releases_frees,
    the_version_is_set_outside_the_lock => readers_end_with_the_snapshot_that_stays,
    a_tick_is_admitted_beside_another => a_tick_admitted_alone_has_the_region_to_itself,
    a_tick_overtakes_those_that_waited => every_tick_is_delivered_once_or_dropped_whatever_the_pause,
    a_left_call_ends_another => a_call_ends_or_is_abandoned_and_the_watchdog_knows_what_it_was_for,
    a_call_begins_before_it_is_described => a_call_ends_or_is_abandoned_and_the_watchdog_knows_what_it_was_for,
    a_running_node_is_fired => a_node_runs_each_tick_once_and_on_one_thread,
    a_finished_node_is_fired => a_node_that_was_taken_out_is_not_fired_again,
    a_sleeping_worker_is_not_woken => every_task_runs_once,
    two_threads_take_one_chunk => every_chunk_runs_once_before_its_loop_returns,
    an_abandoned_worker_continues => an_abandoned_worker_is_replaced_and_takes_no_other_task,
    a_withdrawn_request_is_accepted => a_change_that_is_undone_leaves_the_node_with_one_thread,
    a_wake_is_lost => no_wake_is_lost,
    two_changes_at_once => every_tick_runs_once_or_is_dropped_whatever_changes,
    a_pause_admits_ticks => every_tick_runs_once_or_is_dropped_whatever_changes,
    a_rewired_node_loses_its_packets => a_rewired_node_keeps_what_waits,
};

#[test]
fn each_mutation_is_caught() {
    let names: Vec<&str> = CAUGHT.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, MUTATIONS, "every mutation of build.rs has a model");
    let missed: Vec<&str> = CAUGHT.iter().filter(|(_, model)| !fails(*model)).map(|(name, _)| *name).collect();
    assert!(missed.is_empty(), "not found: {}", missed.join(", "));
}
