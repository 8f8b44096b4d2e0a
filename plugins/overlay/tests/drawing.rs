//! What the nodes draw and where, and that they make no unnecessary copies.

use std::path::Path;

use panoscope_node::abi::{Detection, Homography, Roi, STATE_FRESH, STATE_LOST, Scalar, Tip};
use panoscope_node::harness::{Harness, Setup};
use panoscope_node::{Bgr8, Confidence, Depth, Disparity, Gray8, GrayF32, Mask, View, name16, name32};
use panoscope_overlay::colorize::Colorize;
use panoscope_overlay::marks::color_of;
use panoscope_overlay::overlay::Overlay;
use panoscope_overlay::screen::Screen;
use panoscope_overlay::side_by_side::SideBySide;
use panoscope_overlay::trajectory::Trajectory;

const SIZE: (usize, usize) = (320, 240);

fn flat(value: u8) -> Vec<u8> {
    vec![value; SIZE.0 * SIZE.1 * 3]
}

fn overlay(params: &str) -> Harness<Overlay> {
    let mut node = Harness::open(Setup::new(&format!("params = {{ {params} }}"))).unwrap();
    node.input_image::<Bgr8>("image", SIZE.0, SIZE.1, &flat(100));
    node
}

/// Bounds (left, top, right, bottom, all inclusive) of the pixels that differ from the flat image.
fn changed(view: &View<'_, u8>) -> Option<(usize, usize, usize, usize)> {
    let mut bounds: Option<(usize, usize, usize, usize)> = None;
    for y in 0..view.height {
        for (x, pixel) in view.row(y).chunks_exact(3).enumerate() {
            if pixel != [100; 3] {
                let b = bounds.get_or_insert((x, y, x, y));
                *b = (b.0.min(x), b.1.min(y), b.2.max(x), b.3.max(y));
            }
        }
    }
    bounds
}

fn detection(x_px: f32, y_px: f32) -> Detection {
    Detection { x_px, y_px, width_px: 60.0, height_px: 40.0, score: 0.93, class_index: 1, track_id: 4 }
}

#[test]
fn nothing_to_draw_hands_on_the_buffer() {
    let mut node = overlay("show_roi = false");
    node.input_value("roi", Roi { x: 1, y: 2, width: 30, height: 40 });
    node.input_detections("detections", &[], "", SIZE);
    let out = node.process().unwrap();
    assert_eq!(node.allocated_bytes(), 0);
    assert_eq!(out.plane::<Bgr8>("image").unwrap().data, flat(100));
}

#[test]
fn marks_stand_where_their_coordinates_say() {
    let roi = Roi { x: 40, y: 50, width: 100, height: 60 };
    let out = overlay("").input_value("roi", roi).process().unwrap();
    let (left, top, right, bottom) = changed(&out.plane::<Bgr8>("image").unwrap()).unwrap();
    for (found, expected) in [(left, 40), (top, 50), (right, 140), (bottom, 110)] {
        assert!(found.abs_diff(expected) <= 2, "{found} instead of {expected}");
    }
    let out = overlay("offset_px = [20, 10]").input_value("roi", roi).process().unwrap();
    let shifted = changed(&out.plane::<Bgr8>("image").unwrap()).unwrap();
    assert_eq!((shifted.0 - left, shifted.1 - top), (20, 10));

    let tip =
        Tip { u_px: 200.0, v_px: 100.0, xyz_mm: [f64::NAN; 3], score: 0.5, class_index: 0, xyz_valid: 0, track_id: 1 };
    let out = overlay("").input_value("tip", tip).process().unwrap();
    let b = changed(&out.plane::<Bgr8>("image").unwrap()).unwrap();
    assert!((b.0 + b.2).abs_diff(400) <= 2 && (b.1 + b.3).abs_diff(200) <= 2, "{b:?}");
    // Not finite: nothing is drawn and nothing breaks.
    let out = overlay("").input_value("tip", Tip { u_px: f64::NAN, ..tip }).process().unwrap();
    assert!(changed(&out.plane::<Bgr8>("image").unwrap()).is_none());
}

#[test]
fn a_box_has_its_label_above_or_inside() {
    let out =
        overlay("").input_detections("detections", &[detection(100.0, 100.0)], "a\ngrasper", SIZE).process().unwrap();
    let b = changed(&out.plane::<Bgr8>("image").unwrap()).unwrap();
    assert!(b.1 < 92 && b.3.abs_diff(140) <= 2, "{b:?}");
    let out =
        overlay("").input_detections("detections", &[detection(100.0, 1.0)], "a\ngrasper", SIZE).process().unwrap();
    let b = changed(&out.plane::<Bgr8>("image").unwrap()).unwrap();
    assert!(b.3 <= 43, "{b:?}");
}

#[test]
fn boxes_below_the_least_score_are_not_drawn() {
    let unsure = Detection { score: 0.2, ..detection(100.0, 100.0) };
    let sure = Detection { score: 0.6, ..detection(200.0, 150.0) };
    let drawn = |params: &str, boxes: &[Detection]| {
        let out = overlay(params).input_detections("detections", boxes, "a\ngrasper", SIZE).process().unwrap();
        changed(&out.plane::<Bgr8>("image").unwrap())
    };
    assert!(drawn("min_score = 0.3", &[unsure]).is_none());
    assert_eq!(drawn("min_score = 0.3", &[unsure, sure]), drawn("", &[sure]));
    assert!(drawn("", &[unsure]).is_some());
}

#[test]
fn labels_of_two_boxes_and_a_tip_do_not_cover_each_other() {
    let outer = Detection { x_px: 20.0, y_px: 100.0, width_px: 280.0, height_px: 100.0, ..detection(0.0, 0.0) };
    let inner =
        Detection { x_px: 24.0, y_px: 104.0, width_px: 270.0, height_px: 66.0, class_index: 2, ..detection(0.0, 0.0) };
    // Just where the label of the outer box would stand; that of the inner one has room below it, off the outer box's lines.
    let tip = Tip {
        u_px: 130.0,
        v_px: 70.0,
        xyz_mm: [1.5, -2.5, 66.0],
        score: 0.5,
        class_index: 0,
        xyz_valid: 1,
        track_id: 1,
    };
    // Pixels of the outer box with its label, and of the tip with its words.
    let inked = |boxes: &[Detection], with_tip: bool| {
        let mut node = overlay("");
        node.input_detections("detections", boxes, "a\ngrasper\nhook", SIZE);
        if with_tip {
            node.input_value("tip", tip);
        }
        let out = node.process().unwrap();
        let view = out.plane::<Bgr8>("image").unwrap();
        let count = |color: [u8; 3]| {
            (0..SIZE.1).map(|y| view.row(y).chunks_exact(3).filter(|p| *p == color).count()).sum::<usize>()
        };
        (count(color_of(1)), count([60, 220, 255]))
    };
    let (box_alone, _) = inked(&[outer], false);
    let (_, tip_alone) = inked(&[], true);
    assert!(box_alone > 800 && tip_alone > 100, "{box_alone} {tip_alone}");
    assert_eq!(inked(&[outer, inner], false).0, box_alone, "the other label lies on it");
    assert_eq!(inked(&[outer, inner], true), (box_alone, tip_alone), "labels and tip lie on each other");
}

#[test]
fn masks_cover_their_bits_only() {
    let stride = SIZE.0.div_ceil(8);
    let mut bits = vec![0; stride * SIZE.1];
    bits[30 * stride + 2] = 0b0001_1000;
    let mut node = overlay("show_boxes = false, mask_alpha = 1.0");
    let out = node.input_instances("instances", &[detection(0.0, 0.0)], "a\nb", SIZE, &bits).process().unwrap();
    assert_eq!(changed(&out.plane::<Bgr8>("image").unwrap()), Some((19, 30, 20, 30)));
    let mut mask = vec![0; SIZE.0 * SIZE.1];
    mask[70 * SIZE.0 + 5] = 255;
    let out = overlay("").input_image::<Mask>("mask", SIZE.0, SIZE.1, &mask).process().unwrap();
    assert_eq!(changed(&out.plane::<Bgr8>("image").unwrap()), Some((5, 70, 5, 70)));
}

fn shift(tx: f64, state: u32) -> Homography {
    Homography { left_from_right: [1.0, 0.0, tx, 0.0, 1.0, 10.0, 0.0, 0.0, 1.0], rms_px: 0.4, inliers: 88, state }
}

#[test]
fn the_outline_of_the_right_view_vanishes_when_lost() {
    let pixel = |state| {
        let out = overlay("").input_value("homography", shift(150.0, state)).process().unwrap();
        let view = out.plane::<Bgr8>("image").unwrap();
        view.row(200)[150 * 3..151 * 3].to_vec()
    };
    assert_ne!(pixel(STATE_FRESH), [100; 3]);
    assert_eq!(pixel(STATE_LOST), [100; 3]);
    // A view seen from behind has no outline.
    let behind =
        Homography { left_from_right: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 1.0], ..shift(0.0, STATE_FRESH) };
    overlay("").input_value("homography", behind).process().unwrap();
}

#[test]
fn without_its_outline_only_a_registration_that_is_not_fresh_is_named() {
    let bounds = |state| {
        let out = overlay("show_outline = false").input_value("homography", shift(150.0, state)).process().unwrap();
        changed(&out.plane::<Bgr8>("image").unwrap())
    };
    assert_eq!(bounds(STATE_FRESH), None);
    let (_, _, right, bottom) = bounds(STATE_LOST).expect("it says that it is lost");
    assert!(right < SIZE.0 / 2 + 40 && bottom < SIZE.1 / 4, "{right} {bottom}");
}

#[test]
fn long_words_leave_the_middle_free() {
    let words = "the arm follows the tip of the instrument at a distance of 66 mm from the camera";
    let out = overlay("text_scale = 1.0").input_text("text", words).process().unwrap();
    let (_, _, right, bottom) = changed(&out.plane::<Bgr8>("image").unwrap()).expect("it writes them");
    assert!(right < SIZE.0 / 2 && bottom > 30, "{right} {bottom}");
    // A word without a space stays whole.
    let out = overlay("text_scale = 1.0").input_text("text", &"m".repeat(60)).process().unwrap();
    assert!(changed(&out.plane::<Bgr8>("image").unwrap()).unwrap().2 > SIZE.0 / 2);
}

#[test]
fn several_texts_stand_one_below_the_other() {
    let drawn = |texts: &[&str]| {
        let mut node = overlay("text_scale = 1.0");
        for text in texts {
            node.input_text("text", text);
        }
        node.process().unwrap().plane::<Bgr8>("image").unwrap().data.to_vec()
    };
    assert_eq!(drawn(&["the arm waits", "+12 %"]), drawn(&["the arm waits\n+12 %"]));
    assert_ne!(drawn(&["the arm waits", "+12 %"]), drawn(&["the arm waits"]));
}

/// Runs everything that can write text, with text below the image.
fn all_words_below(params: &str, text: &str, score: f32, labels: &str) -> Harness<Overlay> {
    let mut node = overlay(&format!("words = \"below\", {params}"));
    let tip = Tip {
        u_px: 200.0,
        v_px: 100.0,
        xyz_mm: [1.5, -2.5, 66.0],
        score: 0.5,
        class_index: 0,
        xyz_valid: 1,
        track_id: 1,
    };
    let names =
        ["track_id", "u_px", "v_px", "tissue_u_px", "tissue_v_px", "tissue_mm", "tissue_state", "tip_mm", "tip_state"];
    node.input_detections("detections", &[Detection { score, ..detection(30.0, 150.0) }], labels, SIZE)
        .input_value("tip", tip)
        .input_value("homography", shift(150.0, STATE_LOST))
        .input_text("text", text)
        .input_table("table", &["distance_mm", "error_mm"], &[26.834, 1.21])
        .input_table("nearness", &names, &[1.0, 100.0, 80.0, 160.0, 80.0, 3.2, 2.0, 6.0, 1.0])
        .input_image::<Depth>("depth", 32, 24, &[50.0; 32 * 24]);
    node
}

#[test]
fn a_bar_grows_until_a_wide_image_is_narrow_enough() {
    let height = |params: &str| {
        let out = overlay(&format!("words = \"below\", bar_lines = 1, {params}")).process().unwrap();
        out.plane::<Bgr8>("image").unwrap().height
    };
    let usual = height("max_aspect = 0");
    assert_eq!(height("max_aspect = 1.3"), usual, "high enough");
    let grown = height("max_aspect = 1.0");
    assert!(grown > usual + 20 && grown.abs_diff(SIZE.0) <= 1, "{grown} px");
}

#[test]
fn words_below_a_picture_leave_no_letter_on_it() {
    let columns = "columns = \"distance_mm\"";
    let out = all_words_below(columns, "the arm follows the tip", 0.93, "a\ngrasper").process().unwrap();
    let with_words = out.plane::<Bgr8>("image").unwrap();
    let picture = |view: &View<'_, u8>| (0..SIZE.1).flat_map(|y| view.row(y).to_vec()).collect::<Vec<_>>();
    let below = with_words.height - SIZE.1;
    assert_eq!(with_words.width, SIZE.0);
    assert!((20..60).contains(&below), "a bar of {below} px");
    assert!((SIZE.1..with_words.height).any(|y| with_words.row(y).iter().any(|v| *v > 240)), "the bar has words");
    // The same marks with other words: the picture is the same to the last pixel, the bar is not.
    let labelled = format!("{columns}, label = \"other words\"");
    let out = all_words_below(&labelled, "the arm is stopped", 0.41, "a\nscissors").process().unwrap();
    let with_others = out.plane::<Bgr8>("image").unwrap();
    assert_eq!(with_others.height, with_words.height);
    assert!(picture(&with_words) == picture(&with_others), "words lie on the picture");
    assert_ne!(with_words.data, with_others.data);
    // Nothing written is there with words nowhere, and the picture keeps its size.
    let mut none = overlay("words = \"nowhere\"");
    let out = none.input_text("text", "the arm follows").process().unwrap();
    assert_eq!(out.plane::<Bgr8>("image").unwrap().data, flat(100));
    // The bar stays while there is nothing to say: the picture's size does not jump.
    let out = overlay("words = \"below\"").process().unwrap();
    assert_eq!(out.plane::<Bgr8>("image").unwrap().height, with_words.height);
}

#[test]
fn boxes_and_their_plates_have_the_same_dots() {
    let boxes = [
        Detection { track_id: 9, ..detection(30.0, 40.0) },
        Detection { track_id: 4, class_index: 2, ..detection(200.0, 100.0) },
    ];
    let mut node = overlay("words = \"below\", text_scale = 4.0");
    let out = node.input_detections("detections", &boxes, "a\ngrasper\nspecimen_bag", SIZE).process().unwrap();
    let view = out.plane::<Bgr8>("image").unwrap();
    // Pixels of a class's colour that are no lines: the rectangles' lines are horizontal or vertical runs on their edges.
    let inked = |color: [u8; 3], rows: std::ops::Range<usize>, columns: std::ops::Range<usize>| {
        rows.map(|y| columns.clone().filter(|x| view.row(y)[3 * x..3 * x + 3] == color).count()).sum::<usize>()
    };
    // Inside the corners of the boxes, off their lines. The box with the lower track number has one dot, the other two.
    let (one, two) = (inked(color_of(2), 103..116, 203..240), inked(color_of(1), 43..56, 33..70));
    assert!(one > 8 && (two as f32 / one as f32 - 2.0).abs() < 0.5, "{one} and {two} pixels");
    let below = |class| inked(color_of(class), SIZE.1..view.height, 0..SIZE.0);
    assert!((below(1) as f32 / below(2) as f32 - 2.0).abs() < 0.5, "{} and {}", below(1), below(2));
}

#[test]
fn a_distance_is_written_with_its_error() {
    let bar = |values: &[f64], columns: &[&str]| {
        let mut node = overlay("words = \"below\", columns = \"distance_mm\"");
        let out = node.input_table("table", columns, values).process().unwrap();
        let view = out.plane::<Bgr8>("image").unwrap();
        (SIZE.1..view.height).flat_map(|y| view.row(y).to_vec()).collect::<Vec<_>>()
    };
    let text = |words: &str| {
        let out = overlay("words = \"below\"").input_text("text", words).process().unwrap();
        let view = out.plane::<Bgr8>("image").unwrap();
        (SIZE.1..view.height).flat_map(|y| view.row(y).to_vec()).collect::<Vec<_>>()
    };
    let columns = ["distance_mm", "error_mm"];
    assert!(bar(&[26.834, 1.2], &columns) == text("distance 26.8 ± 1.2 mm"));
    assert!(bar(&[26.834, 0.118], &columns) == text("distance 26.83 ± 0.12 mm"));
    assert!(bar(&[26.834, f64::NAN], &columns) == text("distance 26.8 mm, error unknown"));
    assert!(bar(&[f64::NAN, f64::NAN], &columns) == text("distance -"));
    assert!(bar(&[26.834], &["distance_mm"]) == text("distance 26.83 mm"), "no column of errors");
}

#[test]
fn titles_of_a_screen_stand_below_its_pictures() {
    // No gray, which the rims of letters have.
    const MAIN: [u8; 3] = [200, 30, 90];
    const SIDE: [u8; 3] = [20, 130, 10];
    let pixels = |titles: &str| {
        let params = format!(r#"params = {{ width = 320, height = 200, gap_px = 4, titles = "{titles}" }}"#);
        let mut node = Harness::<Screen>::from_toml(&params).unwrap();
        node.input_image::<Bgr8>("main", 160, 120, &MAIN.repeat(160 * 120));
        let out = node.input_image::<Bgr8>("side", 160, 120, &SIDE.repeat(160 * 120)).process().unwrap();
        out.plane::<Bgr8>("image").unwrap().data.to_vec()
    };
    let (a, b) = (pixels("panorama; depth"), pixels("wide; mm"));
    assert_ne!(a, b);
    for (one, two) in a.as_chunks::<3>().0.iter().zip(b.as_chunks::<3>().0) {
        // Where a picture is in one, it is in the other, untouched.
        assert_eq!([MAIN, SIDE].contains(one), [MAIN, SIDE].contains(two), "{one:?} {two:?}");
    }
    let shown = a.as_chunks::<3>().0.iter().filter(|p| **p == MAIN).count();
    assert!(shown > 15_000, "the main picture is large: {shown} px");
}

#[test]
fn a_bar_of_a_small_picture_is_written_at_the_size_of_the_screen() {
    let written = |width: usize, height: usize, wanted: usize| {
        let params = format!("params = {{ label = \"panorama\", words = \"below\", wanted_width = {wanted} }}");
        let mut node = Harness::<Overlay>::from_toml(&params).unwrap();
        let out = node.input_image::<Bgr8>("image", width, height, &[90; 3].repeat(width * height)).process().unwrap();
        let view = out.plane::<Bgr8>("image").unwrap();
        let bar: Vec<u8> = (0..view.height).flat_map(|y| view.row(y).to_vec()).collect();
        (view.width, view.height, bar)
    };
    let (width, height, small) = written(320, 240, 640);
    let (large_width, large_height, large) = written(640, 480, 640);
    assert_eq!((width, height), (large_width, large_height));
    let from = 3 * width * 480;
    assert!(small[from..] == large[from..], "letters have the same sharpness");
    assert!(small[..from].iter().all(|value| *value == 90), "the picture is enlarged");
    assert_eq!(written(600, 450, 640).0, 600, "nearly as large");
    assert_eq!(written(320, 240, 0).0, 320, "0 keeps the size");
}

#[test]
fn a_trajectory_writes_on_the_picture_only_where_nobody_else_does() {
    let run = |read: &[&str], show_box: bool| {
        let setup = Setup::new(&format!("params = {{ show_box = {show_box}, text_scale = 3.0 }}")).read_only(read);
        let mut node = Harness::<Trajectory>::open(setup).unwrap();
        let tip = |x_mm: f64| Tip {
            u_px: 10.0,
            v_px: 10.0,
            xyz_mm: [x_mm, 0.0, 60.0],
            score: 0.9,
            class_index: 0,
            xyz_valid: 1,
            track_id: 1,
        };
        node.input_image::<Bgr8>("image", SIZE.0, SIZE.1, &flat(100)).input_value("tip", tip(0.0)).process().unwrap();
        node.input_image::<Bgr8>("image", SIZE.0, SIZE.1, &flat(100)).input_value("tip", tip(12.0));
        let out = node.process().unwrap();
        let words = (!out.is_empty("text").unwrap()).then(|| out.text("text").unwrap().to_owned());
        let view = out.plane::<Bgr8>("image").unwrap();
        (view.data.as_chunks::<3>().0.iter().filter(|p| **p == [220; 3]).count(), view.data != flat(100), words)
    };
    let (inked, has_box, words) = run(&["image", "text"], true);
    assert_eq!((inked, has_box, words.as_deref()), (0, true, Some("box 20 mm")));
    let (inked, has_box, words) = run(&["image"], true);
    assert!(inked > 20 && has_box && words.is_none(), "{inked}");
    assert_eq!(run(&["image", "text"], false), (0, false, Some(String::new())));
}

#[test]
fn words_stand_in_their_corner() {
    let scalar = Scalar { value: 12.5, name: name32("distance"), unit: name16("mm") };
    for (corner, right, bottom) in [
        ("top_left", false, false),
        ("top_right", true, false),
        ("bottom_left", false, true),
        ("bottom_right", true, true),
    ] {
        let out = overlay(&format!(r#"label = "L", label_corner = "{corner}", text_scale = 1.0"#))
            .input_value("scalar", scalar)
            .input_table("table", &["fps"], &[30.0])
            .input_text("text", "hello")
            .process()
            .unwrap();
        let b = changed(&out.plane::<Bgr8>("image").unwrap()).unwrap();
        assert_eq!((b.0 > 100, b.1 > 100), (right, bottom), "{corner} {b:?}");
    }
}

#[test]
fn maps_get_colours_and_unknown_places_are_gray() {
    let mut map: Vec<f32> = (0..64 * 48).map(|i| (i % 64) as f32).collect();
    map[0] = f32::NAN;
    let mut node =
        Harness::<Colorize>::from_toml(r#"params = { low = 0.0, high = 63.0, colors = "gray", scale_bar = false }"#)
            .unwrap();
    let out = node.input_image::<Depth>("depth", 64, 48, &map).process().unwrap();
    let view = out.plane::<Bgr8>("image").unwrap();
    assert_eq!((view.row(0)[0], view.row(1)[0], view.row(1)[63 * 3]), (48, 0, 255));
    let mut node = Harness::<Colorize>::from_toml("").unwrap();
    let out = node.input_image::<Confidence>("confidence", 64, 48, &[0.5; 64 * 48]).process().unwrap();
    assert_eq!(out.plane::<Bgr8>("image").unwrap().width, 64);
    node.input_image::<Depth>("depth", 64, 48, &map).input_image::<Disparity>("disparity", 64, 48, &map);
    assert!(node.process().err().unwrap().to_string().contains("more than one map is connected"));
    // The scale beside the map leaves the map as it is.
    let picture = |params: &str| {
        let mut node =
            Harness::<Colorize>::from_toml(&format!("params = {{ low = 0.0, high = 63.0, {params} }}")).unwrap();
        let out = node.input_image::<Depth>("depth", 64, 48, &map).process().unwrap();
        let view = out.plane::<Bgr8>("image").unwrap();
        let rows = (0..48).flat_map(|y| view.row(y)[..64 * 3].to_vec()).collect::<Vec<_>>();
        (view.width, rows)
    };
    let (plain, beside) = (picture("scale_bar = false"), picture("scale_beside = true"));
    assert!(plain.0 == 64 && beside.0 > 70 && plain.1 == beside.1, "{} and {}", plain.0, beside.0);
    assert_ne!(picture("").1, plain.1, "on the map it covers some of it");
    // A map that is enlarged first has the same colours, and its scale is as large next to it.
    let mut node =
        Harness::<Colorize>::from_toml("params = { low = 0.0, high = 63.0, scale_beside = true, wanted_width = 200 }")
            .unwrap();
    let out = node.input_image::<Depth>("depth", 64, 48, &map).process().unwrap();
    let view = out.plane::<Bgr8>("image").unwrap();
    assert_eq!(view.height, 144);
    assert!(view.width.abs_diff(3 * beside.0) <= 3, "{} and {}", view.width, beside.0);
    let (x, y) = (40, 20);
    let same = (0..3).all(|k| view.row(3 * y + 1)[3 * (3 * x + 1) + k].abs_diff(beside.1[3 * (64 * y + x) + k]) <= 2);
    assert!(same, "{:?}", &view.row(3 * y + 1)[9 * x..9 * x + 9]);
    let mut node = Harness::<Colorize>::from_toml("").unwrap();
    // Nothing known at all.
    let out = node.input_image::<Disparity>("disparity", 2, 2, &[f32::NAN; 4]).process().unwrap();
    assert!(!out.is_empty("image").unwrap());
}

#[test]
fn a_grid_keeps_its_size() {
    let mut node = Harness::<SideBySide>::from_toml(r#"params = { gap_px = 2, titles = "one;two" }"#).unwrap();
    node.input_image::<Bgr8>("views", 40, 30, &[10; 3600]).input_image::<Gray8>("views", 40, 60, &[200; 2400]);
    node.input_image::<Gray8>("views", 4, 3, &[77; 12]);
    let out = node.process().unwrap();
    let view = out.plane::<Bgr8>("image").unwrap();
    // Two rows of 30 px, each with a strip of 24 px for its titles, and a gap.
    assert_eq!((view.width, view.height), (82, 110));
    // The narrow one stands in the middle of its cell, the small one is enlarged.
    assert_eq!((view.row(28)[43 * 3], view.row(28)[62 * 3], view.row(72)[20 * 3]), (24, 200, 77));
    node.input_empty("views").input_image::<Gray8>("views", 40, 60, &[200; 2400]).input_empty("views");
    let out = node.process().unwrap();
    assert_eq!(out.plane::<Bgr8>("image").unwrap().width, 82);
    node.input_image::<GrayF32>("views", 1, 1, &[0.5]);
    assert!(node.process().err().unwrap().to_string().contains("colorize"));
}

#[test]
fn a_screen_keeps_its_size_and_its_main_picture_large() {
    // A margin of 4 px on a screen so low.
    let params = r#"params = { width = 200, height = 100, side_share = 0.25, gap_px = 29, titles = "" }"#;
    let mut node = Harness::<Screen>::from_toml(params).unwrap();
    node.input_image::<Bgr8>("main", 138, 92, &[90; 138 * 92 * 3]);
    node.input_image::<Gray8>("side", 50, 44, &[200; 2200]).input_empty("side");
    let out = node.process().unwrap();
    let view = out.plane::<Bgr8>("image").unwrap();
    assert_eq!((view.width, view.height), (200, 100));
    // Main at (4, 4), the first small one at (146, 7), the place of the second dark.
    assert_eq!((view.row(4)[4 * 3], view.row(95)[141 * 3], view.row(3)[4 * 3]), (90, 90, 16));
    assert_eq!((view.row(8)[146 * 3], view.row(40)[195 * 3], view.row(80)[170 * 3]), (200, 200, 16));
    // Alone, the main picture takes the whole width.
    let mut node = Harness::<Screen>::from_toml(params).unwrap();
    let out = node.input_image::<Gray8>("main", 192, 92, &[70; 192 * 92]).process().unwrap();
    assert_eq!(out.plane::<Bgr8>("image").unwrap().row(50)[195 * 3], 70);
    node.input_image::<GrayF32>("main", 1, 1, &[0.5]);
    assert!(node.process().err().unwrap().to_string().contains("`main` is not an 8-bit image"));
}

#[test]
fn a_picture_that_is_too_old_is_dimmed_and_framed() {
    let shown = |params: &str, age_ms: u64| {
        let params = format!("params = {{ width = 320, height = 200, gap_px = 0 {params} }}");
        let mut node = Harness::<Screen>::from_toml(&params).unwrap();
        node.input_image::<Gray8>("main", 160, 120, &[200; 160 * 120]);
        node.input_image::<Gray8>("side", 160, 120, &[100; 160 * 120]);
        node.input_age("side", std::time::Duration::from_millis(age_ms));
        let out = node.process().unwrap();
        let view = out.plane::<Bgr8>("image").unwrap();
        let pixels = view.data.as_chunks::<3>().0;
        let count = |value: [u8; 3]| pixels.iter().filter(|pixel| **pixel == value).count();
        assert!(count([200; 3]) > 15_000, "the living picture stays as it is");
        (count([100; 3]), count([40, 180, 255]))
    };
    let (bright, amber) = shown("", 900);
    assert!(bright > 1000 && amber == 0, "{bright} {amber}");
    let (bright, amber) = shown("", 1200);
    assert!(bright == 0 && amber > 100, "{bright} {amber}");
    let (bright, amber) = shown(", max_age_ms = 0", 1200);
    assert!(bright > 1000 && amber == 0, "{bright} {amber}");
}

/// Everything at once on a real image, for visual inspection: `PANOSCOPE_SHOW=folder cargo test -p panoscope-overlay`.
#[test]
fn a_full_picture() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data/m2cai16-tool-locations/JPEGImages/v08_012900.jpg");
    let Ok(photo) = image::open(&file) else {
        panoscope_testing::skipped!("../shared/data/m2cai16-tool-locations is not there");
        return;
    };
    let photo = photo.into_rgb8();
    let (width, height) = (photo.width() as usize, photo.height() as usize);
    let bgr: Vec<u8> = photo.as_raw().chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]).collect();
    let map: Vec<f32> = (0..width * height).map(|i| 20.0 + 50.0 * (i % width) as f32 / width as f32).collect();
    let mut bits = vec![0; width.div_ceil(8) * height];
    for y in height / 3..height / 2 {
        bits[y * width.div_ceil(8) + 20..y * width.div_ceil(8) + 30].fill(255);
    }
    let tip = Tip {
        u_px: 330.0,
        v_px: 240.0,
        xyz_mm: [3.1, -2.0, 48.2],
        score: 0.9,
        class_index: 0,
        xyz_valid: 1,
        track_id: 1,
    };
    let mut node = Harness::<Overlay>::from_toml(r#"params = { label = "Panoscope" }"#).unwrap();
    let out = node
        .input_image::<Bgr8>("image", width, height, &bgr)
        .input_instances("instances", &[detection(160.0, 190.0)], "a\nGrasper", (width, height), &bits)
        .input_value("homography", shift(90.0, STATE_FRESH))
        .input_value("tip", tip)
        .input_table("table", &["distance_mm"], &[12.34])
        .input_image::<Depth>("depth", width, height, &map)
        .process()
        .unwrap();
    let drawn = out.plane::<Bgr8>("image").unwrap();
    assert_ne!(drawn.data, bgr);
    let mut color = Harness::<Colorize>::from_toml("").unwrap();
    let colored = color.input_image::<Depth>("depth", width, height, &map).process().unwrap();
    let mut grid = Harness::<SideBySide>::from_toml(r#"params = { titles = "Overlay; Depth; Camera" }"#).unwrap();
    let all = grid
        .input_image::<Bgr8>("views", width, height, drawn.data)
        .input_image::<Bgr8>("views", width, height, colored.plane::<Bgr8>("image").unwrap().data)
        .input_image::<Bgr8>("views", width, height, &bgr)
        .process()
        .unwrap();
    let view = all.plane::<Bgr8>("image").unwrap();
    assert_eq!((view.width, view.height), (2 * width + 4, 2 * (height + 24) + 4));
    if let Some(folder) = std::env::var_os("PANOSCOPE_SHOW") {
        let rgb: Vec<u8> = view.data.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]).collect();
        let path = Path::new(&folder).join("overlay.png");
        image::save_buffer(path, &rgb, view.width as u32, view.height as u32, image::ExtendedColorType::Rgb8).unwrap();
    }
}

#[test]
fn a_near_tip_has_a_ring_a_line_to_the_tissue_and_a_colour_that_says_how_near() {
    let names =
        ["track_id", "u_px", "v_px", "tissue_u_px", "tissue_v_px", "tissue_mm", "tissue_state", "tip_mm", "tip_state"];
    let pixel = |params: &str, state: f64, tip_state: f64, at: (usize, usize)| -> [u8; 3] {
        let mut node = overlay(params);
        node.input_table("nearness", &names, &[1.0, 100.0, 80.0, 160.0, 80.0, 3.2, state, 6.0, tip_state]);
        let out = node.process().unwrap();
        let view = out.plane::<Bgr8>("image").unwrap();
        std::array::from_fn(|k| view.row(at.1)[at.0 * 3 + k])
    };
    // On the line between tip and tissue: green, amber, red; gray where nothing is known. Blue, green, red.
    let line = (140, 80);
    for (state, is_color) in [
        (0.0, (|[b, g, r]| g > r && g > b) as fn([u8; 3]) -> bool),
        (1.0, |[b, g, r]| r > 200 && g > 120 && b < 60),
        (2.0, |[b, g, r]| r > 200 && g < 90 && b < 90),
        (-1.0, |[b, g, r]| r == g && g == b && b > 130),
    ] {
        let found = pixel("line_px = 3.0", state, 0.0, line);
        assert!(is_color(found), "state {state}: {found:?}");
    }
    assert_eq!(pixel("show_tip = false", 1.0, 0.0, line), [100; 3]);
    // A second ring where tips are near each other.
    let ring = |tip_state| (84..125).filter(|y| pixel("", 0.0, tip_state, (100, *y)) == [0, 190, 255]).count();
    assert!(ring(0.0) == 0 && ring(1.0) >= 2, "{} {}", ring(0.0), ring(1.0));
    let mut node = overlay("");
    node.input_table("nearness", &["u_px"], &[100.0]);
    assert_eq!(node.process().unwrap().plane::<Bgr8>("image").unwrap().data, flat(100), "another table");
}
