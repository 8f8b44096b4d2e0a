// Model of the parameter snapshot in force.

use panoscope_graph::ParamValue;
use shuttle::sync::Arc;
use shuttle::thread;

use super::params::{InForce, Snapshot};

pub fn readers_end_with_the_snapshot_that_stays() {
    let snapshot = |n: i64| Snapshot::new(vec![ParamValue::Int(n), ParamValue::Int(-n)]);
    let values = Arc::new(InForce::new(snapshot(0)));
    let writers: Vec<_> = [1, 2]
        .map(|first| {
            let values = Arc::clone(&values);
            thread::spawn(move || (0..3).for_each(|n| values.set(snapshot(first * 10 + n))))
        })
        .into_iter()
        .collect();
    let reads = Arc::clone(&values);
    let reader = thread::spawn(move || {
        let mut known = reads.get();
        for _ in 0..6 {
            if let Some(newer) = reads.newer(&known) {
                known = newer;
            }
            let [ParamValue::Int(a), ParamValue::Int(b)] = known.owned() else { panic!("two numbers") };
            assert_eq!(*a, -*b, "never a mixture");
        }
        known
    });
    writers.into_iter().for_each(|w| w.join().expect("no panic"));
    let known = reader.join().expect("no panic");
    let last = values.newer(&known).unwrap_or(known);
    assert_eq!(last.version(), values.get().version());
    assert!(values.newer(&last).is_none(), "the number is that of the snapshot that stays");
}
