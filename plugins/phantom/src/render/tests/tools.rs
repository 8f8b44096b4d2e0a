//! Instruments: their ground truth, and a ray caster compared with a slow search.

use super::super::solid::{Paint, Part, Solid, add, dot};
use super::*;

#[test]
fn instruments_are_where_the_truth_says() {
    let params = SceneParams { tools: 7, ..quiet(SceneKind::Liver) };
    let mut phantom = Phantom::new(params.clone(), even_rig(), &Serial).unwrap();
    let mut bare = Phantom::new(SceneParams { tools: 0, ..params.clone() }, even_rig(), &Serial).unwrap();
    let mut kinds = Vec::new();
    let mut tips_seen = 0;
    for frame in [3, 90, 200] {
        let mut ids = vec![9; WIDTH * HEIGHT];
        let mut tools = Vec::new();
        let mut plane = ViewMut::new(&mut ids, WIDTH, HEIGHT, 1);
        phantom.tools(frame, None, &Serial, &mut plane, &mut tools).unwrap();
        let (with, without) = (draw(&mut phantom, frame, None, &Serial), draw(&mut bare, frame, None, &Serial));
        let (depth, _, visible) = truth(&mut phantom, frame, None);
        let (tissue, ..) = truth(&mut bare, frame, None);
        for (i, &id) in ids.iter().enumerate() {
            let pixels = 3 * i..3 * i + 3;
            if id == 0 {
                assert_eq!(with[0][pixels.clone()], without[0][pixels], "pixel {i} shows tissue");
                assert_eq!(depth[i], tissue[i]);
            } else {
                assert!(depth[i] < tissue[i], "pixel {i} of instrument {id}");
            }
        }
        assert_eq!(tools.len(), 7);
        for tool in &tools {
            let mine: Vec<_> = (0..ids.len()).filter(|&i| ids[i] == tool.id).map(|i| (i % WIDTH, i / WIDTH)).collect();
            assert_eq!(mine.len(), tool.pixels);
            if let Some(left) = mine.iter().map(|p| p.0).min() {
                let (right, top) = (mine.iter().map(|p| p.0).max(), mine.iter().map(|p| p.1).min());
                let bottom = mine.iter().map(|p| p.1).max();
                let [x, y, w, h] = tool.bounds_px;
                assert_eq!((x, Some(x + w - 1), Some(y), Some(y + h - 1)), (left, right, top, bottom));
            }
            if tool.tip_visible {
                tips_seen += 1;
                let place = [0, 1].map(|k| tool.tip_mm[k] / tool.tip_mm[2] * 750.0 + [319.5, 239.5][k]);
                assert!((place[0] - tool.tip_px[0]).abs() < 1e-9 && (place[1] - tool.tip_px[1]).abs() < 1e-9);
            }
            kinds.push(tool.kind);
        }
        assert!(ids.iter().filter(|&&id| id > 0).count() > 5000, "instruments are in view");
        // What the right view shows at the true disparity is the same instrument.
        assert!(ids.iter().zip(&visible).any(|(&id, &seen)| id > 0 && seen == 255));
    }
    assert!(ToolKind::ALL.iter().all(|kind| kinds.contains(kind)) && tips_seen >= 3);
    phantom.force_portable(true);
    let portable = draw(&mut phantom, 90, None, &Threads::new(2));
    phantom.force_portable(false);
    assert_eq!(portable, draw(&mut phantom, 90, None, &Serial));
}

#[test]
fn rays_enter_parts_where_a_slow_search_does() {
    let paint = Paint { albedo: [0.5; 3], metal: 0.0 };
    let n = [0.6, 0.0, 0.8];
    let part =
        Part { a: [-4.0, 1.0, 30.0], radius_a: 3.0, b: [6.0, -2.0, 36.0], radius_b: 1.2, flat: (n, 0.5), paint, id: 1 };
    // Inside: within the ball of some point of the axis, after undoing the squeeze.
    let round = |v: [f64; 3]| add(v, n, dot(v, n));
    let axis = round(add(part.b, part.a, -1.0));
    let inside = |p: [f64; 3]| {
        let p = round(add(p, part.a, -1.0));
        (0..=400).any(|i| {
            let s = f64::from(i) / 400.0;
            let gap = add(p, axis, -s);
            dot(gap, gap).sqrt() < 3.0 + (1.2 - 3.0) * s
        })
    };
    let mut hits = 0;
    for j in -12..=12 {
        for i in -14..=20 {
            let d = [f64::from(i) / 75.0, f64::from(j) / 75.0, 1.0];
            let entry = Solid::new(part).enter(d);
            let slow = (0..2400).map(|k| 24.0 + f64::from(k) * 0.01).find(|&t| inside(d.map(|v| v * t)));
            match (entry, slow) {
                (Some(entry), Some(slow)) => {
                    hits += 1;
                    assert!((entry.t - slow).abs() < 0.03, "{d:?}: {} for {slow}", entry.t);
                    assert!(dot(entry.normal, d) < 1e-6, "the normal looks at the camera");
                    let inv = 1.0 / dot(d, d).sqrt();
                    assert!(part.near(d.map(|v| v * inv), 1e-6));
                }
                (Some(entry), None) => assert!(!inside(d.map(|v| v * (entry.t + 0.3))), "{d:?} grazes only"),
                (None, found) => assert!(found.is_none(), "{d:?} missed"),
            }
        }
    }
    assert!(hits > 60, "{hits} rays met the part");
}

#[test]
fn scripted_instruments_never_hide_their_own_tips() {
    let motions = [ToolMotion::Still, ToolMotion::Step, ToolMotion::Ramp, ToolMotion::Circle, ToolMotion::Strokes];
    for (motion, kind) in motions.into_iter().flat_map(|m| [(m, ToolKind::Hook), (m, ToolKind::Grasper)]) {
        let params = SceneParams {
            distance_mm: 85.0,
            tools: 1,
            tool_kinds: vec![kind],
            tool_motion: motion,
            ..quiet(SceneKind::Bowel)
        };
        let rig = Rig::stereo(160, 120, 15.0);
        let mut phantom = Phantom::new(params, rig, &Serial).unwrap();
        let (mut ids, mut tools) = (vec![0; 160 * 120], Vec::new());
        let rest = Pose { quaternion: [1.0, 0.0, 0.0, 0.0], translation_mm: [0.0; 3] };
        for frame in (0..1200).step_by(15) {
            // The camera stands before the tip, as the arm would have it.
            let mut plane = ViewMut::new(&mut ids, 160, 120, 1);
            phantom.tools(frame, Some(rest), &Serial, &mut plane, &mut tools).unwrap();
            let tip = tools[0].tip_mm;
            let follow = Pose { translation_mm: [tip[0] - 7.5, tip[1], tip[2] - 65.6], ..rest };
            phantom.tools(frame, Some(follow), &Serial, &mut plane, &mut tools).unwrap();
            assert!(tools[0].tip_visible, "{motion:?} {kind:?}, frame {frame}: {:?}", tools[0]);
        }
    }
}
