//! What is found in tiny copies of each layout, and what is said about the rest.

use std::path::Path;

use crate::samples::{self, HEIGHT, Tree, WIDTH};
use panoscope_data::data_sets::{DataSetError, Found, Holds, KNOWN, Labels, Pictures, Sequence, Stacked, find};
use panoscope_testing::Folder;

fn no_video(path: &Path) {
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    std::fs::write(path, "a video").expect("a file");
}

/// All layouts in one folder.
fn everything(name: &str) -> (Folder, Found) {
    let folder = Folder::new(name, &[]);
    samples::all(&Tree(folder.path().to_owned()), no_video);
    let found = find(folder.path()).expect("a folder");
    (folder, found)
}

fn of<'f>(found: &'f Found, name: &str) -> &'f Sequence {
    let names: Vec<&str> = found.sequences.iter().map(|s| s.name.as_str()).collect();
    found.sequences.iter().find(|s| s.name == name).unwrap_or_else(|| panic!("no {name} in {names:#?}"))
}

fn baseline_mm(sequence: &Sequence, picture: usize) -> f64 {
    let files = sequence.calibration.as_ref().unwrap_or_else(|| panic!("{} has no calibration", sequence.name));
    let read = files.read(picture).unwrap_or_else(|error| panic!("{error}"));
    read.unwrap_or_else(|| panic!("{} has none for picture {picture}", sequence.name)).baseline_mm
}

#[test]
fn every_layout_is_listed_once() {
    let (_folder, found) = everything("data-sets-all");
    let size = Some((WIDTH, HEIGHT));
    // Name, data set, pictures, size, views, baseline in mm, pictures with truth, pictures with labels.
    type Row = (&'static str, &'static str, Option<usize>, Option<(u32, u32)>, usize, Option<f64>, usize, usize);
    let expected: [Row; 26] = [
        ("CholecSeg8k/video01/video01_00080", "CholecSeg8k", Some(2), size, 1, None, 0, 1),
        ("EndoVis2017/instrument_dataset_1", "EndoVis 2017", Some(1), Some((1920, 1080)), 2, Some(4.35), 0, 1),
        ("EndoVis2017/instrument_dataset_2", "EndoVis 2017", Some(2), size, 2, Some(4.35), 0, 1),
        ("EndoVis2018/miccai_challenge_2018_release_1/seq_1", "EndoVis 2018", Some(1), size, 2, Some(4.35), 0, 1),
        ("KITTI/2011_09_26/2011_09_26_drive_0001_sync/image_02", "KITTI raw", Some(2), size, 2, Some(540.0), 1, 0),
        ("KITTI/data_scene_flow/training/image_2", "KITTI stereo 2015", Some(3), size, 2, Some(540.0), 2, 0),
        ("KITTI/data_stereo_flow/training/colored_0", "KITTI stereo 2012", Some(1), size, 2, Some(540.0), 1, 0),
        ("KITTI/data_stereo_flow/training/image_0", "KITTI stereo 2012", Some(1), size, 2, Some(500.0), 1, 0),
        ("KITTI/dataset/sequences/00/image_0", "KITTI odometry", Some(4), size, 2, Some(500.0), 0, 0),
        ("MiddEval3/testQ/Australia", "Middlebury", Some(1), size, 2, Some(150.0), 0, 0),
        ("MiddEval3/trainingQ/Adirondack", "Middlebury", Some(1), size, 2, Some(150.0), 1, 0),
        ("Middlebury2003/cones", "Middlebury", Some(1), Some((450, 24)), 2, None, 1, 0),
        ("Middlebury2006/Aloe", "Middlebury", Some(1), Some((413, 24)), 2, None, 1, 0),
        ("Middlebury2014/Bicycle1-perfect", "Middlebury", Some(1), size, 2, Some(150.0), 1, 0),
        ("SCARED/dataset_1/keyframe_1", "SCARED", Some(1), size, 2, Some(4.2012), 1, 0),
        ("SCARED/dataset_1/keyframe_1/data", "SCARED", None, None, 2, Some(4.2012), 2, 0),
        ("SCARED/dataset_8/keyframe_0", "SCARED", Some(1), size, 2, Some(4.2012), 0, 0),
        ("SCARED/dataset_8/keyframe_0/data", "SCARED", None, None, 2, Some(4.2012), 0, 0),
        ("StereoMIS_0_0_1/P2_0", "StereoMIS", None, None, 2, Some(4.15), 0, 0),
        ("hamlyn/rectified01/rectified01", "Hamlyn (rectified)", Some(3), size, 2, Some(5.4), 3, 0),
        ("hamlyn_tracking/test1", "Hamlyn (rectified)", Some(1), size, 1, None, 1, 0),
        ("m2cai16-tool-locations", "m2cai16-tool-locations", Some(3), size, 1, None, 0, 2),
        ("m2cai16-tool-locations/test", "m2cai16-tool-locations", Some(2), size, 1, None, 0, 1),
        ("m2cai16-tool-locations/train", "m2cai16-tool-locations", Some(1), size, 1, None, 0, 1),
        ("pairs", "pairs of pictures", Some(2), size, 2, None, 0, 0),
        ("yolo/train", "YOLO", Some(1), size, 1, None, 0, 1),
    ];
    for (name, data_set, count, size, views, baseline, truth, labels) in &expected {
        let sequence = of(&found, name);
        assert_eq!((sequence.data_set, sequence.count(), sequence.size), (*data_set, *count, *size), "{name}");
        assert_eq!(sequence.views(), *views, "{name}");
        assert_eq!(sequence.truth.as_ref().map_or(0, |truth| truth.count()), *truth, "{name}");
        assert_eq!(sequence.labels.as_ref().map_or(0, Labels::count), *labels, "{name}");
        match baseline {
            Some(mm) => assert!((baseline_mm(sequence, 0) - mm).abs() < 1e-3, "{name}: {}", baseline_mm(sequence, 0)),
            None => assert!(sequence.calibration.is_none(), "{name}"),
        }
    }
    let names: Vec<&str> = found.sequences.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names.len(), expected.len(), "{names:#?}");
}

#[test]
fn truth_says_what_it_holds() {
    let (_folder, found) = everything("data-sets-truth");
    for (name, holds, divisor) in [
        ("SCARED/dataset_1/keyframe_1", Holds::Points, 1.0),
        ("SCARED/dataset_1/keyframe_1/data", Holds::StackedPoints, 1.0),
        ("hamlyn/rectified01/rectified01", Holds::Depth, 1.0),
        ("KITTI/data_scene_flow/training/image_2", Holds::Disparity, 256.0),
        ("KITTI/2011_09_26/2011_09_26_drive_0001_sync/image_02", Holds::Depth, 0.256),
        ("Middlebury2006/Aloe", Holds::Disparity, 3.0),
        ("Middlebury2003/cones", Holds::Disparity, 4.0),
    ] {
        let truth = of(&found, name).truth.as_ref().expect("truth");
        assert_eq!((truth.holds, truth.divisor), (holds, divisor), "{name}");
    }
    // A frame keeps the number of its file; the second one has none.
    let files = &of(&found, "SCARED/dataset_1/keyframe_1/data").truth.as_ref().expect("truth").files;
    let has: Vec<bool> = files.iter().map(Option::is_some).collect();
    assert_eq!(has, [true, false, true]);
    let video = &of(&found, "StereoMIS_0_0_1/P2_0").pictures;
    assert!(matches!(video, Pictures::Video { stacked: Stacked::TopBottom, .. }));
    assert_eq!(of(&found, "EndoVis2017/instrument_dataset_1").crop, Some([320, 28, 1280, 1024]));
    assert_eq!(of(&found, "EndoVis2017/instrument_dataset_2").crop, None);
}

#[test]
fn calibrations_of_single_pictures_follow_their_numbers() {
    let (_folder, found) = everything("data-sets-calibration");
    let sequence = of(&found, "KITTI/data_scene_flow/training/image_2");
    let files = sequence.calibration.as_ref().expect("a calibration");
    assert!(files.is_per_picture());
    let focal = |picture: usize| files.read(picture).expect("readable").expect("there").left.fx;
    // 000000_10, 000000_11, 000001_10.
    assert_eq!([focal(0), focal(1), focal(2)], [60.0, 60.0, 50.0]);
    assert_eq!(files.read(99).expect("none"), None);
}

#[test]
fn remarks_say_what_is_missing_and_how_to_get_it() {
    let (_folder, found) = everything("data-sets-remarks");
    for (name, words) in [
        ("SCARED/dataset_8/keyframe_0/data", "scene_points.tar.gz is packed: unpack it"),
        ("SCARED/dataset_8/keyframe_0", "there is no left_depth_map.tiff"),
        ("SCARED/dataset_1/keyframe_1/data", "moved by the robot's kinematics"),
        ("CholecSeg8k/video01/video01_00080", "1 frames without labels"),
        ("EndoVis2017/instrument_dataset_1", "the black border is cut off: views of 1280x1024"),
        ("EndoVis2017/instrument_dataset_2", "1 frames without labels"),
        ("hamlyn/rectified01/rectified01", "computed by a program"),
        ("MiddEval3/testQ/Australia", "the test sets come without truth"),
        ("Middlebury2006/Aloe", "no calibration"),
        ("StereoMIS_0_0_1/P2_0", "poses in groundtruth.txt are not read"),
        ("m2cai16-tool-locations", "1 pictures without a file of labels"),
        ("pairs", "1 pictures without a partner"),
    ] {
        let sequence = of(&found, name);
        assert!(sequence.remarks.iter().any(|r| r.contains(words)), "{name}: {:?} lacks {words}", sequence.remarks);
    }
}

#[test]
fn a_sequence_can_be_the_folder_itself() {
    let folder = Folder::new("data-sets-own", &[]);
    let tree = Tree(folder.path().to_owned());
    samples::middlebury(&tree);
    samples::scared(&tree, no_video);
    for (inside, name) in
        [("MiddEval3/trainingQ/Adirondack", "Adirondack"), ("SCARED/dataset_1/keyframe_1", "keyframe_1")]
    {
        let found = find(&folder.at(inside)).expect("a folder");
        assert_eq!(found.sequences[0].name, name);
        assert_eq!(found.sequence(&folder.at(inside), "").expect("the first one").name, name);
    }
    let found = find(&folder.at("SCARED/dataset_1/keyframe_1")).expect("a folder");
    assert_eq!(found.sequences[1].name, "keyframe_1/data");
    assert_eq!(found.sequence(folder.path(), "/keyframe_1/data/").expect("by name").name, "keyframe_1/data");
}

#[test]
fn what_is_not_there_is_named() {
    let folder = Folder::new("data-sets-none", &[("notes/readme.txt", "nothing"), ("scared.zip", "packed")]);
    let error = find(&folder.at("nowhere")).expect_err("no folder").to_string();
    assert!(error.contains("there is no folder") && error.contains("nowhere"), "{error}");
    let found = find(folder.path()).expect("a folder");
    assert!(found.sequences.is_empty() && found.folders == 2, "{found:?}");
    assert_eq!(found.remarks, ["packed files are not read, unpack them: scared.zip"]);
    let error = found.sequence(folder.path(), "").expect_err("nothing").to_string();
    for words in ["SCARED", "KITTI", "unpack them: scared.zip", "panoscope import"] {
        assert!(error.contains(words), "{error} lacks {words}");
    }
    samples::pairs(&Tree(folder.path().to_owned()));
    let found = find(folder.path()).expect("a folder");
    let error = found.sequence(folder.path(), "pears").expect_err("no such name");
    assert!(
        matches!(error, DataSetError::NoSequence { .. })
            && error.to_string().contains("has no sequence `pears`: it has pairs")
    );
    assert!(KNOWN.iter().all(|known| !known.holds.is_empty()));
}

#[test]
fn damaged_calibrations_are_named_when_they_are_read() {
    let folder = Folder::new("data-sets-damaged", &[]);
    let tree = Tree(folder.path().to_owned());
    samples::middlebury(&tree);
    tree.write("MiddEval3/trainingQ/Adirondack/calib.txt", "cam0=[60 0 30; 0 60");
    let found = find(folder.path()).expect("a folder");
    let files = of(&found, "MiddEval3/trainingQ/Adirondack").calibration.clone().expect("files");
    let error = files.read(0).expect_err("cut off").to_string();
    assert!(error.contains("Adirondack/calib.txt") && error.contains("is missing"), "{error}");
}

#[test]
fn pairs_of_equal_numbers_belong_together() {
    let (_folder, found) = everything("data-sets-pairs");
    let Pictures::Files { left, right } = &of(&found, "pairs").pictures else { panic!("files") };
    let name = |path: &Path| path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let pairs: Vec<(String, String)> = left.iter().zip(right).map(|(l, r)| (name(l), name(r))).collect();
    assert_eq!(pairs, [("l_1.png".into(), "r_1.png".into()), ("l_10.png".into(), "r_10.png".to_owned())]);
}

/// The data of this machine, where it is.
#[test]
fn real_folders_are_recognised() {
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/data");
    if !shared.is_dir() {
        return panoscope_testing::skipped!("there is no {}", shared.display());
    }
    let found = find(&shared).expect("a folder");
    let tools = of(&found, "m2cai16-tool-locations");
    assert_eq!((tools.count(), tools.size), (Some(2635), Some((596, 334))));
    assert_eq!(tools.labels.as_ref().map(Labels::count), Some(2635));
    assert_eq!(tools.labels.as_ref().map(|labels| labels.classes().len()), Some(7));
    let test = of(&found, "m2cai16-tool-locations/test").count().expect("files");
    let trainval = of(&found, "m2cai16-tool-locations/trainval").count().expect("files");
    assert!(test > 100 && trainval > test, "{test} and {trainval}");
    let pairs = of(&found, "stereo/hamlyn_640x480");
    assert_eq!((pairs.count(), pairs.size, pairs.views()), (Some(25), Some((640, 480)), 2));
}
