//! Frames of one instant are paired, by number or by time, and frames without a partner are named.

use crate::common::{Folder, WIDTH, drain, value, warned, write_video_at};

#[test]
fn a_missing_file_shifts_no_pair() {
    let folder = Folder::new("numbers");
    for index in [1, 2, 4, 5] {
        folder.image(&format!("l_{index:04}.png"), index, WIDTH);
    }
    for index in [1, 3, 4, 5] {
        folder.image(&format!("cam1_r{index}.png"), 100 + index, WIDTH);
    }
    for (left, right) in [("l_*.png", "cam1_r*.png"), ("l_%04d.png", "cam1_r%d.png")] {
        let mut node = folder.open(&format!(r#"left = "{left}", right = "{right}""#));
        let pairs: Vec<(u8, u8)> = drain(&mut node).iter().map(|o| (value(o, "left"), value(o, "right"))).collect();
        assert_eq!(pairs, [(1, 101), (4, 104), (5, 105)]);
        assert!(warned(&node, "l_0002.png") && warned(&node, "cam1_r3.png"), "{:?}", node.logs());
    }
    // A list is in the order that was asked for.
    let mut node = folder.open(r#"left = "l_0002.png\nl_0004.png", right = "cam1_r1.png\ncam1_r3.png""#);
    let pairs: Vec<(u8, u8)> = drain(&mut node).iter().map(|o| (value(o, "left"), value(o, "right"))).collect();
    assert_eq!(pairs, [(2, 101), (4, 103)]);
}

#[test]
fn one_folder_is_not_both_views() {
    let folder = Folder::new("one_folder");
    for index in [1, 2] {
        folder.image(&format!("left_{index}.png"), index, WIDTH);
        folder.image(&format!("right_{index}.png"), 100 + index, WIDTH);
    }
    let error = folder.refused(r#"left = ".", right = ".""#);
    assert!(error.contains("views 0 and 1 read the same files") && error.contains("left_*.png"), "{error}");
}

#[test]
fn unequal_counts_are_said() {
    let folder = Folder::new("counts");
    for name in ["a", "b", "c"] {
        folder.image(&format!("left_{name}.png"), name.as_bytes()[0], WIDTH);
    }
    folder.image("right_a.png", 1, WIDTH);
    let mut node = folder.open(r#"left = "left_*.png", right = "right_*.png""#);
    assert_eq!(drain(&mut node).len(), 1);
    assert!(warned(&node, "2 images of `left_*.png`") && warned(&node, "left_b.png"), "{:?}", node.logs());
    assert!(warned(&node, "in the order of their names"));
    write_video_at(&folder.0.join("long.avi"), 20.0, 0..9);
    write_video_at(&folder.0.join("short.avi"), 20.0, 0..4);
    let mut node = folder.open(r#"left = "long.avi", right = "short.avi""#);
    assert_eq!(drain(&mut node).len(), 4);
    assert!(warned(&node, "short.avi has ended") && warned(&node, "long.avi has 5 more"), "{:?}", node.logs());
}

#[test]
fn stills_are_one_pair_unless_they_are_to_be_repeated() {
    let folder = Folder::new("stills");
    folder.image("l.png", 1, WIDTH);
    folder.image("r.png", 2, WIDTH);
    let stills = r#"left = "l.png", right = "r.png""#;
    assert_eq!(drain(&mut folder.open(stills)).len(), 1);
    assert_eq!(drain(&mut folder.open(r#"left = "l.png""#)).len(), 1);
    assert_eq!(drain(&mut folder.open(&format!("{stills}, loop = true, frames = 7"))).len(), 7);
    // On a screen they stay.
    let setup = panoscope_node::harness::Setup::new(&format!("params = {{ {stills}, rate_hz = 1000.0, frames = 5 }}"));
    let mut node = panoscope_node::harness::Harness::open(setup.graph_dir(&folder.0)).unwrap();
    assert_eq!(drain(&mut node).len(), 5);
}

#[test]
fn videos_of_different_rates_are_paired_by_time() {
    let folder = Folder::new("rates");
    // Gray tells the time: 2 per 1/30 s.
    write_video_at(&folder.0.join("l.avi"), 30.0, (0..31).map(|index| 2 * index));
    write_video_at(&folder.0.join("r.avi"), 10.0, (0..11).map(|index| 6 * index));
    for (left, right) in [("l.avi", "r.avi"), ("r.avi", "l.avi")] {
        let mut node = folder.open(&format!(r#"left = "{left}", right = "{right}""#));
        let all = drain(&mut node);
        assert_eq!(all.len(), 11);
        for (index, out) in all.iter().enumerate() {
            let time = index as u8 * 6;
            let (left, right) = (value(out, "left"), value(out, "right"));
            assert!(left.abs_diff(time) <= 2 && right.abs_diff(time) <= 2, "{index}: {left} {right}");
            assert!((out.tick().capture_ns - index as i64 * 100_000_000).abs() < 2_000_000, "{:?}", out.tick());
        }
        assert!(
            warned(&node, "30.000 frames per second") && warned(&node, "10.000 frames per second"),
            "{:?}",
            node.logs()
        );
        assert!(node.metric("skew_ms").is_some_and(|skew| skew < 2.0), "{:?}", node.metric("skew_ms"));
    }
    // 30 and 25 per second: every pair within half a frame of the faster one, and the skew is said.
    write_video_at(&folder.0.join("m.avi"), 25.0, (0..26).map(|index| (index as f64 * 2.4).round() as u8));
    let mut node = folder.open(r#"left = "l.avi", right = "m.avi""#);
    let mut pairs = 0;
    loop {
        let out = node.process().unwrap();
        if out.ended() {
            break;
        }
        pairs += 1;
        let (left, right) = (value(&out, "left"), value(&out, "right"));
        // Half of 1/30 s is one gray; the codec and the rounding add one each.
        assert!(left.abs_diff(right) <= 3, "{left} {right}");
        assert!(node.metric("skew_ms").is_some_and(|skew| skew <= 1000.0 / 60.0 + 1e-6));
    }
    assert!((24..=26).contains(&pairs), "{pairs}");
    // A rate given by the user stands above what the files say: frame by frame.
    let all = drain(&mut folder.open(r#"left = "l.avi", right = "r.avi", rate_hz = 10.0"#));
    assert_eq!(all.len(), 11);
    assert!(value(&all[10], "left").abs_diff(20) <= 2 && value(&all[10], "right").abs_diff(60) <= 2);
}
