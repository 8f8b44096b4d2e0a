//! Files in live mode: held, stepped, played at another speed.

use crate::common::{Folder, WIDTH, value, write_video};
use panoscope_capture::capture::Capture;
use panoscope_node::harness::{Harness, Setup};

/// A node in live mode on files that need no wait.
fn live(folder: &Folder, params: &str) -> Harness<Capture> {
    Harness::open(Setup::new(&of(params)).graph_dir(&folder.0)).unwrap()
}

fn of(params: &str) -> String {
    format!("params = {{ {params}, rate_hz = 100.0, pace = \"off\" }}")
}

/// Number of the frame that the next tick shows, whose gray is a multiple of `scale`, and its capture time, ms.
fn shown(node: &mut Harness<Capture>, scale: f64) -> (u64, i64) {
    let out = node.process().unwrap();
    assert!(!out.ended());
    ((f64::from(value(&out, "left")) / scale).round() as u64, out.tick().capture_ns / 1_000_000)
}

#[test]
fn a_paused_file_repeats_its_frame_and_goes_on_where_it_was() {
    let folder = Folder::new("paused");
    for index in 0..9 {
        folder.image(&format!("{index}.png"), index, WIDTH);
    }
    write_video(&folder.0.join("v.avi"), 9);
    for (source, scale) in [("*.png", 1.0), ("v.avi", 20.0)] {
        let params = |rest: &str| of(&format!(r#"left = "{source}"{rest}"#));
        let mut node = live(&folder, &format!(r#"left = "{source}", paused = true"#));
        // The first frame is shown in any case.
        let first = [shown(&mut node, scale), shown(&mut node, scale), shown(&mut node, scale)];
        assert_eq!(first, [(0, 0), (0, 100), (0, 200)], "{source}");
        node.set_params(&params(", paused = true, step = 7")).unwrap();
        assert_eq!([shown(&mut node, scale), shown(&mut node, scale)], [(1, 210), (1, 310)], "one step, {source}");
        assert_eq!(node.metric("frame"), Some(1.0));
        node.set_params(&params("")).unwrap();
        assert_eq!([shown(&mut node, scale), shown(&mut node, scale)], [(2, 320), (3, 330)], "{source}");
        // The instance that replaces this one goes on at the same frame and time.
        let state = node.save_state().unwrap().unwrap();
        let mut next = live(&folder, &format!(r#"left = "{source}""#));
        next.load_state(&state).unwrap();
        assert_eq!(shown(&mut next, scale), (4, 340), "{source}");
    }
}

#[test]
fn speed_and_pause_change_nothing_in_batch_mode() {
    let folder = Folder::new("unpaused");
    for index in 0..4 {
        folder.image(&format!("{index}.png"), index, WIDTH);
    }
    let params = r#"left = "*.png", paused = true, speed = 4.0, rate_hz = 10.0"#;
    let all = crate::common::drain(&mut folder.open(params));
    let found: Vec<_> = all.iter().map(|out| (value(out, "left"), out.tick().capture_ns / 1_000_000)).collect();
    assert_eq!(found, [(0, 0), (1, 100), (2, 200), (3, 300)]);
}

#[test]
fn files_are_played_faster_and_slower() {
    let folder = Folder::new("speed");
    for index in 0..9 {
        folder.image(&format!("{index}.png"), index, WIDTH);
    }
    let mut node = live(&folder, r#"left = "*.png", loop = true, speed = 4.0"#);
    let mut times = Vec::new();
    for tick in 0..12 {
        if tick == 4 {
            node.set_params(&of(r#"left = "*.png", loop = true, speed = 0.25"#)).unwrap();
        }
        let out = node.process().unwrap();
        assert_eq!(value(&out, "left"), tick % 9);
        times.push(out.tick().capture_ns);
    }
    // 10 ms per frame, over the end of a round too.
    let steps: Vec<i64> = times.windows(2).map(|pair| (pair[1] - pair[0]) / 1000).collect();
    assert_eq!(steps, [2500, 2500, 2500, 40_000, 40_000, 40_000, 40_000, 40_000, 40_000, 40_000, 40_000]);
}

#[test]
fn a_paused_file_stays_at_its_last_frame() {
    let folder = Folder::new("last");
    for index in 0..3 {
        folder.image(&format!("{index}.png"), index, WIDTH);
    }
    write_video(&folder.0.join("v.avi"), 3);
    for (source, scale) in [("*.png", 1.0), ("v.avi", 20.0)] {
        let params = |rest: &str| of(&format!(r#"left = "{source}"{rest}"#));
        let mut node = live(&folder, &format!(r#"left = "{source}""#));
        assert_eq!([0; 3].map(|_| shown(&mut node, scale).0), [0, 1, 2], "{source}");
        for step in 1..4 {
            node.set_params(&params(&format!(", paused = true, step = {step}"))).unwrap();
            assert_eq!(shown(&mut node, scale).0, 2, "{source}");
        }
        // An instance that replaces it has no frame to show, and does not end either.
        let state = node.save_state().unwrap().unwrap();
        let mut next = live(&folder, &format!(r#"left = "{source}", paused = true"#));
        next.load_state(&state).unwrap();
        let out = next.process().unwrap();
        assert!(!out.ended() && out.is_empty("left").unwrap(), "{source}");
        next.set_params(&params("")).unwrap();
        assert!(next.process().unwrap().ended(), "{source}: it ends once it plays");
    }
}
