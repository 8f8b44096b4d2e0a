//! In batch mode the number of threads never changes a byte.

use panoscope_tests::{files, panorama, run, scratch};

#[test]
fn one_two_and_eight_threads_give_the_same_bytes() {
    let mut first: Option<Vec<(String, Vec<u8>)>> = None;
    for threads in [1, 2, 8] {
        let folder = scratch(&format!("determinism-{threads}"));
        let done = run(&folder.join("graph.toml"), &panorama(&folder, ""), 20, threads);
        assert_eq!(done.report.frames, 20);
        assert!(done.report.nodes.values().all(|n| n.faults == 0 && n.dropped == 0), "{:?}", done.log);
        let made = files(&folder);
        assert_eq!(made.len(), 21, "20 pictures and a table: {:?}", made.iter().map(|m| &m.0).collect::<Vec<_>>());
        match &first {
            None => first = Some(made),
            Some(first) => {
                for (a, b) in first.iter().zip(&made) {
                    assert_eq!(a.0, b.0);
                    assert!(a.1 == b.1, "{} differs between 1 and {threads} threads", a.0);
                }
            }
        }
        let _ = std::fs::remove_dir_all(&folder);
    }
}
