//! `read_maps` and `read_labels`: the file that belongs to the frame, in every tick.

use std::fs;

use crate::common::Folder;
use panoscope_capture::read_labels::ReadLabels;
use panoscope_capture::read_maps::ReadMaps;
use panoscope_imaging::stereo::{FloatImage, formats};
use panoscope_node::harness::{Harness, HarnessError, Level, Setup};
use panoscope_node::{Depth, Disparity, Gray8};

type TestResult = Result<(), HarnessError>;

fn maps(folder: &Folder, params: &str) -> Result<Harness<ReadMaps>, HarnessError> {
    Harness::open(Setup::new(&format!("params = {{ {params} }}")).graph_dir(&folder.0))
}

fn labels(folder: &Folder, params: &str) -> Result<Harness<ReadLabels>, HarnessError> {
    Harness::open(Setup::new(&format!("params = {{ {params} }}")).graph_dir(&folder.0))
}

fn map(value: f32) -> FloatImage {
    FloatImage { width: 2, height: 1, data: vec![value, 0.0] }
}

#[test]
fn the_map_of_a_picture_has_its_number() -> TestResult {
    let folder = Folder::new("maps");
    for (name, value) in [("d_2.pfm", 2.0), ("d_10.pfm", 10.0), ("d_1.pfm", 1.0)] {
        fs::write(folder.0.join(name), formats::write_pfm(&map(value))).expect("written");
    }
    // Which image each belongs to is not known: numbers are missing.
    let error = maps(&folder, r#"path = "d_*.pfm""#).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("d_2.pfm") && error.contains("d_10.pfm") && error.contains("`pictures`"), "{error}");
    for number in [1, 2, 3, 10] {
        folder.image(&format!("left_{number:03}.png"), 2, 1);
    }
    let mut node = maps(&folder, r#"path = "d_*.pfm", pictures = "left_*.png""#)?;
    for expected in [Some(1.0), Some(2.0), None, Some(10.0)] {
        let out = node.input_image::<Gray8>("image", 2, 1, &[0; 2]).process()?;
        assert_eq!(out.is_empty("disparity")?, expected.is_none());
        if let Some(expected) = expected {
            assert_eq!(out.plane::<Disparity>("disparity")?.data[0], expected);
        }
    }
    let error = maps(&folder, r#"path = "d_*.pfm", pictures = "none_*.png""#).err().map(|e| e.to_string());
    assert!(error.is_some_and(|e| e.contains("none_*.png")));
    folder.image("other_7.png", 2, 1);
    let error = maps(&folder, r#"path = "d_*.pfm", pictures = "other_*.png""#).err().map(|e| e.to_string());
    assert!(error.as_ref().is_some_and(|e| e.contains("name or the number") && e.contains("other_7.png")), "{error:?}");
    fs::rename(folder.0.join("d_10.pfm"), folder.0.join("d_3.pfm")).expect("renamed");
    let mut node = maps(&folder, r#"path = "d_*.pfm""#)?;
    for expected in [1.0, 2.0, 10.0] {
        let out = node.input_image::<Gray8>("image", 2, 1, &[0; 2]).process()?;
        let disparity = out.plane::<Disparity>("disparity")?;
        assert!(disparity.data[0] == expected && disparity.data[1].is_nan(), "{:?}", disparity.data);
        assert!(out.is_empty("depth")?);
    }
    for _ in 0..2 {
        let out = node.input_image::<Gray8>("image", 2, 1, &[0; 2]).process()?;
        assert!(out.is_empty("disparity")?);
    }
    let warnings = node.logs().iter().filter(|line| line.level == Level::Warn && line.message.contains("only 3 exist"));
    assert_eq!(warnings.count(), 1, "{:?}", node.logs());
    // A picture that was dropped takes its map with it; `loop` starts again.
    let mut node = maps(&folder, r#"path = "d_*.pfm", loop = true, holds = "depth", divisor = 2.0"#)?;
    for expected in [0.5, 1.0, 5.0, 0.5] {
        let out = node.input_image::<Gray8>("image", 2, 1, &[0; 2]).process()?;
        assert_eq!(out.plane::<Depth>("depth")?.data[0], expected);
    }
    Ok(())
}

#[test]
fn kitti_files_are_divided_and_wrong_ones_named() -> TestResult {
    let folder = Folder::new("kitti");
    let gray = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(2, 1, vec![640u16, 0]).expect("two values");
    gray.save(folder.0.join("000000_10.png")).expect("written");
    let mut node = maps(&folder, r#"path = "000000_10.png""#)?;
    for _ in 0..2 {
        let out = node.input_image::<Gray8>("image", 2, 1, &[0; 2]).process()?;
        let disparity = out.plane::<Disparity>("disparity")?;
        assert!(disparity.data[0] == 2.5 && disparity.data[1].is_nan());
    }
    let refused = |params: &str| maps(&folder, params).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(refused("").contains("`path` is empty"), "{}", refused(""));
    assert!(refused(r#"path = "no.pfm""#).contains("no.pfm"));
    let none = refused(r#"path = "*.pfm""#);
    assert!(none.contains("no map matches") && none.contains("1 maps, 000000_10.png among them"), "{none}");
    fs::write(folder.0.join("cut.pfm"), b"Pf\n2 1\n-1\n1234").expect("written");
    let mut node = maps(&folder, r#"path = "cut.pfm""#)?;
    let other = maps(&folder, r#"path = "000000_10.png""#)?.input_image::<Gray8>("image", 1, 2, &[0; 2]).process();
    assert!(other.is_err_and(|error| error.to_string().contains("2x1, but its image is 1x2")));
    let error = node.input_image::<Gray8>("image", 2, 1, &[0; 2]).process().err().map(|e| e.to_string());
    assert!(error.as_ref().is_some_and(|e| e.contains("cut.pfm") && e.contains("8 expected")), "{error:?}");
    Ok(())
}

#[test]
fn labels_are_scaled_to_the_picture_and_found_by_its_name() -> TestResult {
    let folder = Folder::new("labels");
    for name in ["a.png", "b.png", "c.png"] {
        folder.image(name, 1, 4);
    }
    let voc = "<annotation><size><width>40</width><height>20</height></size><object><name>hook</name>\
               <bndbox><xmin>4</xmin><ymin>2</ymin><xmax>8</xmax><ymax>12</ymax></bndbox></object></annotation>";
    fs::write(folder.0.join("a.xml"), voc).expect("written");
    fs::write(folder.0.join("c.xml"), voc.replace("</name>", "</name><difficult>1</difficult>")).expect("written");
    let mut node = labels(&folder, r#"path = "*.xml", pictures = "*.png""#)?;
    let picture = [0; 20 * 10];
    let out = node.input_image::<Gray8>("image", 20, 10, &picture).process()?;
    let found = out.detections("detections")?;
    let item = found.items()[0];
    assert_eq!([item.x_px, item.y_px, item.width_px, item.height_px, item.score], [2.0, 1.0, 2.0, 5.0, 1.0]);
    assert_eq!((found.label(0), found.image_size()), ("hook", (20, 10)));
    let out = node.input_image::<Gray8>("image", 20, 10, &picture).process()?;
    assert!(out.detections("detections")?.items().is_empty(), "b.png has no labels");
    let out = node.input_image::<Gray8>("image", 20, 10, &picture).process()?;
    assert_eq!(out.detections("detections")?.items()[0].score, 0.0);
    // YOLO: names beside the labels, places in shares.
    fs::write(folder.0.join("classes.txt"), "grasper\nhook\n").expect("written");
    fs::write(folder.0.join("a.txt"), "1 0.5 0.5 0.2 0.4\n").expect("written");
    let mut node = labels(&folder, r#"path = "*.txt""#)?;
    let out = node.input_image::<Gray8>("image", 20, 10, &picture).process()?;
    let found = out.detections("detections")?;
    let item = found.items()[0];
    assert_eq!([item.x_px, item.y_px, item.width_px, item.height_px], [8.0, 3.0, 4.0, 4.0]);
    assert_eq!(found.label(item.class_index), "hook");
    Ok(())
}
