//! Detectors on operations left out, scored from small made-up predictions whose AP is known by hand.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use serde_json::{Value, json};

use panoscope_eval::eval::detect::folds::{Options, judge};
use panoscope_eval::figures::Figure;
use panoscope_eval::inputs::Folder;
use panoscope_eval::{Silent, chain};

/// Gap that still belongs to a block: 250 frames.
const FOLDS: &str = "data = \"made_up\"\nsplits = [\"first\", \"second\"]\nframe_rate_hz = 25.0\nblock_s = 10.0\n\
                     [folds]\n1 = [\"a\", \"b\"]\n2 = [\"c\"]\n";

/// A data set of four frames with one hook each and a grasper in the last, and predictions that find all of them.
struct Case {
    folder: Folder,
    /// Per fold the content of its file.
    files: BTreeMap<&'static str, Value>,
}

static CASES: AtomicUsize = AtomicUsize::new(0);

const FRAMES: [(&str, &str); 4] =
    [("first", "a_000100"), ("first", "b_000100"), ("second", "c_000100"), ("second", "c_000350")];

fn find(class: u32, score: f64, left: f64) -> Value {
    json!([class, score, left, 10.0, left + 20.0, 30.0])
}

impl Case {
    fn new() -> Self {
        // Tests are threads of one process, whose number alone would name one folder for all.
        let number = CASES.fetch_add(1, Ordering::Relaxed);
        let folder = Folder::new(&format!("panoscope-folds-{number}")).expect("a folder");
        let root = folder.path();
        let data = root.join("made_up");
        std::fs::create_dir(&data).expect("data");
        std::fs::write(root.join("folds.toml"), FOLDS).expect("folds");
        for split in ["first", "second"] {
            let names: Vec<&str> = FRAMES.iter().filter(|(s, _)| *s == split).map(|(_, n)| *n).collect();
            let images: Vec<Value> = names
                .iter()
                .enumerate()
                .map(|(id, n)| json!({"id": id, "file_name": format!("{n}.jpg"), "width": 100, "height": 80}))
                .collect();
            let hook = |id: usize| json!({"image_id": id, "category_id": 7, "bbox": [10.0, 10.0, 20.0, 20.0]});
            let mut annotations: Vec<Value> = (0..names.len()).map(hook).collect();
            if split == "second" {
                annotations.push(json!({"image_id": 1, "category_id": 3, "bbox": [60.0, 10.0, 20.0, 20.0]}));
            }
            // The classes are listed in another order in each split.
            let mut categories = vec![json!({"id": 7, "name": "Hook"}), json!({"id": 3, "name": "Grasper"})];
            if split == "second" {
                categories.reverse();
            }
            let truth = json!({"images": images, "annotations": annotations, "categories": categories});
            std::fs::write(data.join(format!("{split}.json")), truth.to_string()).expect("truth");
            names.iter().for_each(|n| std::fs::write(data.join(format!("{n}.jpg")), "").expect("picture"));
        }
        let file = |fold: &str, held_out: &[&str], trained_on: &[&str], frames: Value| {
            json!({"format": "panoscope-predictions-1", "fold": fold, "held_out": held_out, "trained_on": trained_on,
                   "classes": ["grasper", "hook"], "network": {}, "frames": frames})
        };
        let one = json!({"a_000100": [find(1, 0.9, 10.0)], "b_000100": [find(1, 0.8, 10.0)]});
        let two = json!({"c_000100": [find(1, 0.9, 10.0)], "c_000350": [find(1, 0.8, 10.0), find(0, 0.7, 60.0)]});
        let files =
            BTreeMap::from([("1", file("1", &["a", "b"], &["c"], one)), ("2", file("2", &["c"], &["a", "b"], two))]);
        Self { folder, files }
    }

    fn root(&self) -> &Path {
        self.folder.path()
    }

    fn write(&self, folder: &str) -> PathBuf {
        let folder = self.root().join(folder);
        std::fs::create_dir_all(&folder).expect("a folder");
        for (fold, file) in &self.files {
            std::fs::write(folder.join(format!("fold{fold}.json")), file.to_string()).expect("predictions");
        }
        folder
    }

    fn options(&self) -> Options {
        Options {
            predictions: self.write("run"),
            fold_file: Some(self.root().join("folds.toml")),
            data: vec![self.root().to_owned()],
            ..Options::default()
        }
    }

    fn set(&mut self, fold: &str, frame: &str, rows: &[Value]) {
        self.files.get_mut(fold).expect("a fold")["frames"][frame] = json!(rows);
    }

    fn figures(&self) -> Vec<Figure> {
        judge(&Silent, &self.options()).unwrap_or_else(|e| panic!("{}", chain(&e)))
    }

    fn error(&self) -> String {
        chain(&judge(&Silent, &self.options()).expect_err("refused"))
    }
}

fn value(figures: &[Figure], name: &str) -> f64 {
    let names = || figures.iter().map(|f| f.name.as_str()).collect::<Vec<_>>().join(", ");
    figures.iter().find(|f| f.name == name).unwrap_or_else(|| panic!("no {name} in {}", names())).value
}

fn near(figures: &[Figure], name: &str, want: f64) {
    let got = value(figures, name);
    assert!((got - want).abs() < 1e-9, "{name} is {got}, not {want}");
}

#[test]
fn all_found_scores_one_with_no_room_for_chance() {
    let figures = Case::new().figures();
    for name in ["fold1", "fold2", "mean", "worst", "mean_low", "worst_low", "mean_high"] {
        near(&figures, &format!("map50_left_out/{name}"), 1.0);
    }
    near(&figures, "ap50_left_out/fold2/grasper", 1.0);
    near(&figures, "ap50_left_out/mean/grasper", 1.0);
    assert!(!figures.iter().any(|f| f.name == "ap50_left_out/fold1/grasper"), "fold 1 has no grasper");
    assert_eq!(figures[0].input, "run, 4 frames in 3 blocks");
}

#[test]
fn folds_count_alike_and_the_worst_is_named() {
    let mut case = Case::new();
    // Before the true hooks of fold 1 one false find: precision 1/2, then 2/3 at both recalls, whose envelope is 2/3 everywhere.
    case.set("1", "a_000100", &[find(1, 0.95, 70.0), find(1, 0.9, 10.0)]);
    // Of fold 2 the grasper is called a hook with the lowest score: AP 1 for the hook, 0 for the grasper.
    case.set("2", "c_000350", &[find(1, 0.8, 10.0), find(1, 0.1, 60.0)]);
    let figures = case.figures();
    near(&figures, "map50_left_out/fold1", 2.0 / 3.0);
    near(&figures, "ap50_left_out/fold2/hook", 1.0);
    near(&figures, "ap50_left_out/fold2/grasper", 0.0);
    near(&figures, "map50_left_out/fold2", 0.5);
    near(&figures, "map50_left_out/mean", (2.0 / 3.0 + 0.5) / 2.0);
    near(&figures, "map50_left_out/worst", 0.5);
    near(&figures, "ap50_left_out/mean/hook", (2.0 / 3.0 + 1.0) / 2.0);
    near(&figures, "map50_voc_left_out/fold1", 2.0 / 3.0);
}

#[test]
fn frames_within_ten_seconds_are_drawn_together() {
    // Of operation c one hook of two is found: 51 of 101 recalls. 250 frames apart both are one block: every draw is the same.
    let mut case = Case::new();
    case.set("2", "c_000350", &[find(0, 0.7, 60.0)]);
    let figures = case.figures();
    for bound in ["", "_low", "_high"] {
        near(&figures, &format!("ap50_left_out/fold2/hook{bound}"), 51.0 / 101.0);
    }
    // With blocks of 9 s they are drawn on their own: twice the one that was found, both, or twice the one that was missed.
    std::fs::write(case.root().join("folds.toml"), FOLDS.replace("10.0", "9.0")).expect("folds");
    let figures = case.figures();
    near(&figures, "ap50_left_out/fold2/hook", 51.0 / 101.0);
    near(&figures, "ap50_left_out/fold2/hook_low", 0.0);
    near(&figures, "ap50_left_out/fold2/hook_high", 1.0);
    // Each operation keeps its share: the two of fold 1 have one frame each, so that every draw has both.
    near(&figures, "map50_left_out/fold1_low", 1.0);
}

#[test]
fn a_second_run_is_compared_on_the_same_draws() {
    let mut case = Case::new();
    std::fs::write(case.root().join("folds.toml"), FOLDS.replace("10.0", "9.0")).expect("folds");
    case.set("2", "c_000350", &[find(0, 0.7, 60.0)]);
    let beside = Some(case.write("beside"));
    let same = judge(&Silent, &Options { beside: beside.clone(), ..case.options() }).expect("scored");
    for name in ["fold1", "fold2", "mean", "mean_low", "mean_high"] {
        near(&same, &format!("map50_left_out_gain/{name}"), 0.0);
    }
    case.set("2", "c_000350", &[find(1, 0.8, 10.0), find(0, 0.7, 60.0)]);
    let better = judge(&Silent, &Options { beside, ..case.options() }).expect("scored");
    // The hook goes from 51/101 to 1, the grasper stays: half of that in fold 2, a quarter in the mean of two folds.
    near(&better, "map50_left_out_gain/fold2", (1.0 - 51.0 / 101.0) / 2.0);
    near(&better, "map50_left_out_gain/mean", (1.0 - 51.0 / 101.0) / 4.0);
    assert!(value(&better, "map50_left_out_gain/mean_low") >= 0.0);
}

#[test]
fn one_fold_can_be_scored_before_the_others_are_trained() {
    let mut case = Case::new();
    case.files.remove("1");
    let error = case.error();
    for part in ["fold1.json is missing", "--fold 1 --out", "--only-fold"] {
        assert!(error.contains(part), "{error}");
    }
    let figures = judge(&Silent, &Options { only: vec!["2".to_owned()], ..case.options() }).expect("scored");
    near(&figures, "map50_left_out/fold2", 1.0);
    assert!(!figures.iter().any(|f| f.name.contains("mean") || f.name.contains("worst")), "{figures:?}");
    let error = judge(&Silent, &Options { only: vec!["3".to_owned()], ..case.options() }).expect_err("refused");
    assert!(chain(&error).contains("has no fold 3; it has 1, 2"), "{}", chain(&error));
}

#[test]
fn scores_are_judged_and_a_calibration_is_written() {
    let mut case = Case::new();
    // Boxes of 0.9 and 0.8 are all right: scores are too low by 0.1 and 0.2. A grasper of 0.7 with an objectness of 0.9 is right too.
    let row = |class: u32, score: f64, left: f64, objectness: f64| {
        json!([class, score, left, 10.0, left + 20.0, 30.0, objectness])
    };
    case.set("1", "a_000100", &[row(1, 0.9, 10.0, 0.95)]);
    case.set("1", "b_000100", &[row(1, 0.8, 10.0, 0.9), row(0, 0.6, 70.0, 0.7)]);
    case.set("2", "c_000100", &[row(1, 0.9, 10.0, 0.95), row(0, 0.03, 10.0, 0.95)]);
    // The hook of the second is taken for a grasper: wrong, and on an instrument.
    case.set("2", "c_000350", &[row(0, 0.5, 10.0, 0.9), row(0, 0.7, 60.0, 0.9)]);
    let file = case.root().join("calibration.json");
    let options = Options { calibration: Some(file.clone()), precision: 0.6, ..case.options() };
    let figures = judge(&Silent, &options).unwrap_or_else(|e| panic!("{}", chain(&e)));
    // Hooks: 0.9 twice and 0.8, all right: two bins of 0.8 to 0.9 and 0.9 to 1.
    near(&figures, "calibration_error/hook", (2.0 * 0.1 + 0.2) / 3.0);
    // Graspers: 0.5 wrong, 0.6 wrong, 0.7 right, each in a bin of its own.
    near(&figures, "calibration_error/grasper", (0.5 + 0.6 + 0.3) / 3.0);
    near(&figures, "unknown_below_0.00/right", 4.0);
    let stored: Value = serde_json::from_str(&std::fs::read_to_string(&file).expect("written")).expect("JSON");
    assert_eq!(stored["format"], "panoscope-calibration-1");
    let classes: Vec<&str> = stored["classes"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
    assert_eq!(classes, ["hook", "grasper"]);
    assert_eq!(stored["limits"].as_array().map(Vec::len), Some(2));
    for curve in ["score", "objectness"] {
        assert!(stored[curve]["temperature"].as_f64().expect("a number") > 0.0, "{stored}");
    }
    // Without objectness there is no curve of it.
    let case = Case::new();
    let figures = judge(&Silent, &Options { calibration: Some(file.clone()), ..case.options() }).expect("scored");
    assert!(!figures.iter().any(|f| f.name.starts_with("unknown_below")));
    let stored: Value = serde_json::from_str(&std::fs::read_to_string(&file).expect("written")).expect("JSON");
    assert!(stored["objectness"].is_null());
}

#[test]
fn curves_confusions_and_misses_of_each_fold_are_drawn() {
    let mut case = Case::new();
    case.set("2", "c_000350", &[find(1, 0.8, 10.0), find(1, 0.7, 60.0)]);
    for (_, name) in FRAMES {
        let picture = image::RgbImage::from_pixel(100, 80, image::Rgb([90, 30, 30]));
        picture.save(case.root().join("made_up").join(format!("{name}.jpg"))).expect("a picture");
    }
    let pictures = case.root().join("pictures");
    judge(&Silent, &Options { pictures: Some(pictures.clone()), ..case.options() })
        .unwrap_or_else(|e| panic!("{}", chain(&e)));
    for fold in ["1", "2"] {
        for what in ["curves", "confusion", "misses"] {
            let (width, height) =
                image::image_dimensions(pictures.join(format!("fold{fold}_{what}.png"))).expect("drawn");
            assert!(width > 300 && height > 200, "{fold} {what}: {width}x{height}");
        }
    }
    let (width, height) = image::image_dimensions(pictures.join("reliability.png")).expect("drawn");
    assert!(width > 600 && height > 300, "{width}x{height}");
}

/// A change of the predictions of fold 1.
type Change = fn(&mut Value);

#[test]
fn wrong_predictions_are_refused_with_file_and_remedy() {
    let changes: [(Change, &[&str]); 14] = [
        (|f| f["frames"]["c_000100"] = json!([]), &["c_000100", "operation c", "learned from", "a, b"]),
        (|f| f["frames"]["a_999999"] = json!([]), &["no frame a_999999", "other data"]),
        (|f| f["frames"] = json!({"a_000100": []}), &["1 of 2 frames are missing", "b_000100", "--resume"]),
        (|f| f["classes"] = json!(["grasper", "needle"]), &["no class `needle`", "hook, grasper", "train with these"]),
        (|f| f["fold"] = json!("2"), &["predictions of fold 2"]),
        (|f| f["held_out"] = json!(["a"]), &["kept out a,", "keeps out a, b", "train it again"]),
        (|f| f["trained_on"] = json!(["b", "c"]), &["learned from operation b", "train it again"]),
        (|f| f["format"] = json!("other"), &["`other`", "`panoscope-predictions-1`"]),
        (|f| f["frames"]["a_000100"] = json!([find(2, 0.5, 0.0)]), &["a_000100", "row 1", "class 2 of 2"]),
        (|f| f["frames"]["a_000100"] = json!([find(0, 1.5, 0.0)]), &["a_000100", "row 1", "score 1.5"]),
        (|f| f["frames"]["a_000100"] = json!([[0, 0.5, 9.0, 9.0, 3.0, 12.0]]), &["upper left corner comes first"]),
        (
            |f| f["frames"]["a_000100"] = json!([[0, 0.5, 9.0]]),
            &["a_000100", "row 1", "expected 6 or 7 numbers, got 3"],
        ),
        (
            |f| f["frames"]["a_000100"] = json!([[0, 0.5, 9.0, 9.0, 10.0, 12.0, 1.5]]),
            &["a_000100", "row 1", "objectness 1.5"],
        ),
        (|f| f["frames"] = json!(3), &["has no predictions of a fold"]),
    ];
    for (change, parts) in changes {
        let mut case = Case::new();
        change(case.files.get_mut("1").expect("fold 1"));
        let error = case.error();
        for part in parts.iter().chain(&["fold1.json"]) {
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
    }
}

#[test]
fn wrong_files_of_folds_are_refused() {
    let case = Case::new();
    for (from, to, part) in [
        ("2 = [\"c\"]", "2 = [\"c\", \"a\"]", "operation a is in fold 1 and in fold 2"),
        ("2 = [\"c\"]", "", "1 fold; at least two are needed"),
        ("2 = [\"c\"]", "2 = []", "fold 2 has no operation"),
        ("1 = [\"a\", \"b\"]", "1 = [\"a\"]", "operation b of"),
        ("25.0", "0.0", "frame_rate_hz is 0"),
        ("data =", "dat =", "is not a file of folds"),
        ("made_up", "elsewhere", "there is no elsewhere in"),
    ] {
        std::fs::write(case.root().join("folds.toml"), FOLDS.replace(from, to)).expect("folds");
        let error = case.error();
        assert!(error.contains(part), "`{part}` is not in: {error}");
    }
}

#[test]
fn the_folds_that_ship_keep_every_operation_out_once() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../plugins/tools/training/folds.toml");
    let text = std::fs::read_to_string(path).expect("it is in the repository");
    let table: toml::Table = toml::from_str(&text).expect("it is TOML");
    let folds = table["folds"].as_table().expect("folds");
    let lists: Vec<&Vec<toml::Value>> = folds.values().map(|f| f.as_array().expect("operations")).collect();
    assert!(lists.len() == 3 && lists.iter().all(|f| f.len() == 3), "{folds}");
    let mut all: Vec<&str> = lists.iter().flat_map(|f| f.iter()).filter_map(toml::Value::as_str).collect();
    all.sort_unstable();
    assert_eq!(all, ["v01", "v02", "v03", "v04", "v05", "v06", "v08", "v09", "v10"]);
}
