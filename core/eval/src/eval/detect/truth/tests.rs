use std::fs;
use std::path::PathBuf;

use super::*;
use crate::error::chain;
use crate::session::Silent;

/// A separate folder for the test with `pictures`, each 20 x 10 px.
fn folder(name: &str, pictures: &[&str]) -> PathBuf {
    let path = std::env::temp_dir().join(format!("panoscope_truth_{name}_{}", std::process::id()));
    let _ = fs::remove_dir_all(&path);
    for picture in pictures {
        let file = path.join(picture);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        image::RgbImage::new(20, 10).save(file).unwrap();
    }
    path
}

#[test]
fn names_are_one_however_they_are_written() {
    for name in ["SpecimenBag", "Specimen Bag", "specimen-bag", " specimen_bag "] {
        assert_eq!(normal_name(name), "specimen_bag");
    }
    assert_eq!(normal_name("Hook"), "hook");
}

#[test]
fn voc_boxes_follow_the_size_of_the_picture() {
    let home = folder("voc", &["JPEGImages/v01_1.png"]);
    fs::create_dir_all(home.join("Annotations")).unwrap();
    fs::create_dir_all(home.join("ImageSets")).unwrap();
    let object = |difficult| {
        format!(
            "<object><name>Hook</name><difficult>{difficult}</difficult><bndbox><xmin>4</xmin><ymin>2</ymin><xmax>8</xmax><ymax>6</ymax></bndbox></object>"
        )
    };
    let xml =
        format!("<annotation><size><width>40</width><height>20</height></size>{}{}</annotation>", object(0), object(1));
    fs::write(home.join("Annotations/v01_1.xml"), xml).unwrap();
    fs::write(home.join("ImageSets/test.txt"), "v01_1\nv01_2\n").unwrap();
    let truth = read(&Silent, &home, Some("test"), None).unwrap();
    assert_eq!((truth.classes.as_slice(), truth.pictures.len()), (&["hook".to_owned()][..], 1));
    let picture = &truth.pictures[0];
    assert_eq!((picture.operation().as_str(), picture.objects[0].bbox), ("v01", [2.0, 1.0, 2.0, 2.0]));
    assert!(!picture.objects[0].ignored && picture.objects[1].ignored);
    let error = read(&Silent, &home, Some("nothing"), None).unwrap_err().to_string();
    assert!(error.contains("ImageSets/nothing.txt"), "{error}");
    fs::write(home.join("Annotations/v01_1.xml"), "<annotation><object></object></annotation>").unwrap();
    let error = chain(&read(&Silent, &home, None, None).unwrap_err());
    assert!(error.contains("v01_1.xml") && error.contains("<name>"), "{error}");
    fs::remove_dir_all(home).unwrap();
}

#[test]
fn coco_masks_come_as_runs_packed_runs_and_polygons() {
    let home = folder("coco", &["a.png"]);
    let annotation =
        |shape: &str| format!("{{\"image_id\":7,\"category_id\":2,\"bbox\":[1,1,2,2],\"segmentation\":{shape}}}");
    let shapes =
        ["{\"size\":[10,20],\"counts\":[11,2,187]}", "{\"size\":[10,20],\"counts\":\";2k5\"}", "[[1,1,3,1,3,3,1,3]]"];
    let text = |annotations: Vec<String>| {
        format!(
            "{{\"images\":[{{\"id\":7,\"file_name\":\"a.png\",\"width\":20,\"height\":10}}],\"annotations\":[{}],\"categories\":[{{\"id\":2,\"name\":\"Hook\"}}]}}",
            annotations.join(",")
        )
    };
    let file = home.join("train.json");
    fs::write(&file, text(shapes.iter().map(|s| annotation(s)).collect())).unwrap();
    let truth = read(&Silent, &file, None, None).unwrap();
    let areas: Vec<u64> = truth.pictures[0].objects.iter().map(|o| o.mask.as_ref().unwrap().area).collect();
    assert_eq!(areas, [2, 2, 4]);
    fs::write(&file, text(vec![annotation("{\"size\":[5,5],\"counts\":[25]}")])).unwrap();
    let error = chain(&read(&Silent, &file, None, None).unwrap_err());
    assert!(error.contains("5x5") && error.contains("20x10"), "{error}");
    fs::remove_dir_all(home).unwrap();
}

#[test]
fn labelme_polygons_of_a_group_are_one_object() {
    let home = folder("labelme", &["img_dir/f.png"]);
    fs::create_dir_all(home.join("ann_dir")).unwrap();
    let shape = |label: &str, group: &str, x: u32| {
        format!(
            "{{\"label\":\"{label}\",\"group_id\":{group},\"shape_type\":\"polygon\",\"points\":[[{x},1],[{0},1],[{0},3],[{x},3]]}}",
            x + 2
        )
    };
    let shapes =
        [shape("grasper", "1", 1), shape("grasper", "1", 8), shape("grasper", "2", 12), shape("hook", "1", 16)];
    let text = format!("{{\"imagePath\":\"img_dir/f.png\",\"shapes\":[{}]}}", shapes.join(","));
    fs::write(home.join("ann_dir/f.json"), text).unwrap();
    let truth = read(&Silent, &home, None, None).unwrap();
    let objects = &truth.pictures[0].objects;
    assert_eq!(objects.len(), 3);
    assert_eq!((objects[0].bbox, objects[0].mask.as_ref().unwrap().area), ([1.0, 1.0, 9.0, 2.0], 8));
    fs::remove_dir_all(home).unwrap();
}

#[test]
fn yolo_text_gives_boxes_and_outlines() {
    let home = folder("yolo", &["images/val/p.png", "images/val/q.png"]);
    fs::create_dir_all(home.join("labels/val")).unwrap();
    fs::write(home.join("data.yaml"), "path: .\nnames:\n  0: grasper\n  1: 'hook'\nnc: 2\n").unwrap();
    fs::write(home.join("labels/val/p.txt"), "1 0.5 0.5 0.2 0.4\n0 0 0 0.5 0 0.5 1 0 1\n").unwrap();
    let truth = read(&Silent, &home, Some("val"), None).unwrap();
    assert_eq!(truth.classes, ["grasper", "hook"]);
    let objects = &truth.pictures[0].objects;
    assert_eq!((objects[0].class, objects[0].bbox), (1, [8.0, 3.0, 4.0, 4.0]));
    assert_eq!(objects[1].mask.as_ref().unwrap().area, 100);
    assert!(truth.pictures[1].objects.is_empty());
    fs::write(home.join("labels/val/p.txt"), "1 0.5\n").unwrap();
    let error = read(&Silent, &home, Some("val"), None).unwrap_err().to_string();
    assert!(error.contains("p.txt:1"), "{error}");
    fs::remove_dir_all(home).unwrap();
}

#[test]
fn the_layouts_of_public_tools_are_found() {
    let coco = |picture: &str| {
        format!(
            "{{\"images\":[{{\"id\":1,\"file_name\":\"{picture}\",\"width\":20,\"height\":10}}],\"annotations\":[{{\"image_id\":1,\"category_id\":2,\"bbox\":[1,1,2,2]}}],\"categories\":[{{\"id\":2,\"name\":\"Hook\"}}]}}"
        )
    };
    // File of boxes, its picture, the split.
    for (index, (file, picture, split)) in [
        ("annotations.json", "images/a.png", None),
        ("_annotations.coco.json", "a.png", None),
        ("annotations/instances_default.json", "images/a.png", None),
        ("valid/_annotations.coco.json", "valid/a.png", Some("valid")),
        ("annotations/instances_val2017.json", "val2017/a.png", Some("val2017")),
        ("annotations/instances_val2017.json", "images/val2017/a.png", Some("val2017")),
    ]
    .into_iter()
    .enumerate()
    {
        let home = folder(&format!("layout_{index}"), &[picture]);
        fs::create_dir_all(home.join(file).parent().unwrap()).unwrap();
        fs::write(home.join(file), coco("a.png")).unwrap();
        let truth = read(&Silent, &home, split, None).unwrap();
        assert_eq!((truth.pictures.len(), truth.pictures[0].objects.len(), truth.classes[0].as_str()), (1, 1, "hook"));
        assert_eq!(truth.pictures[0].path, home.join(picture));
        fs::remove_dir_all(home).unwrap();
    }
    // Roboflow's YOLO, with a map of names in one line.
    let home = folder("roboflow", &["valid/images/p.png"]);
    fs::create_dir_all(home.join("valid/labels")).unwrap();
    fs::write(home.join("data.yaml"), "nc: 2\nnames: {0: grasper, 1: hook}\n").unwrap();
    fs::write(home.join("valid/labels/p.txt"), "1 0.5 0.5 0.2 0.4\n").unwrap();
    let truth = read(&Silent, &home, Some("valid"), None).unwrap();
    assert_eq!((truth.classes[truth.pictures[0].objects[0].class].as_str(), truth.pictures.len()), ("hook", 1));
    fs::write(home.join("valid/labels/p.txt"), "2 0.5 0.5 0.2 0.4\n").unwrap();
    let error = read(&Silent, &home, Some("valid"), None).unwrap_err().to_string();
    assert!(error.contains("p.txt:1: class 2") && error.contains("2 classes"), "{error}");
    // Labels that nobody finds are no truth of empty pictures.
    fs::rename(home.join("valid/labels"), home.join("valid/boxes")).unwrap();
    let error = read(&Silent, &home, Some("valid"), None).unwrap_err().to_string();
    assert!(error.contains("no labelled object in 1 images"), "{error}");
    fs::remove_dir_all(home).unwrap();
}

#[test]
fn classes_are_put_in_the_models_order() {
    let object = |class| Object { class, bbox: [0.0; 4], mask: None, ignored: false };
    let picture = Picture { path: "a.png".into(), width: 1, height: 1, objects: vec![object(0), object(1)] };
    let truth = Truth { classes: vec!["zebra".into(), "hook".into()], pictures: vec![picture] };
    let truth = truth.ordered(&["Grasper".into(), "Hook".into()]);
    assert_eq!(truth.classes, ["grasper", "hook", "zebra"]);
    assert_eq!(truth.pictures[0].objects.iter().map(|o| o.class).collect::<Vec<_>>(), [2, 1]);
}

#[test]
fn what_is_no_truth_is_named() {
    let home = folder("none", &["a.png"]);
    let error = read(&Silent, &home, None, None).unwrap_err().to_string();
    assert!(error.contains("VOC") && error.contains("COCO") && error.contains("labelme"), "{error}");
    assert!(read(&Silent, &home.join("gone"), None, None).is_err());
    fs::remove_dir_all(home).unwrap();
}

/// A region of VIA.
fn region(shape: &str, attributes: &str) -> String {
    format!("{{\"shape_attributes\":{shape},\"region_attributes\":{attributes}}}")
}

#[test]
fn via_projects_and_exports_of_both_versions_are_one() {
    let home = folder("via", &["f.png", "images/g.png"]);
    let square = "{\"name\":\"polygon\",\"all_points_x\":[1,3,3,1],\"all_points_y\":[1,1,3,3]}";
    let shapes = [
        region(square, "{\"class\":\"SpecimenBag\"}"),
        region(&square.replace("polygon", "polyline"), "{\"instrument\":{\"hook\":true,\"grasper\":false}}"),
        region(
            "{\"name\":\"rect\",\"x\":4,\"y\":2,\"width\":5,\"height\":3}",
            "{\"colour\":\"red\",\"label\":\"hook\"}",
        ),
        region("{\"name\":\"circle\",\"cx\":10,\"cy\":5,\"r\":4}", "{\"class\":\"hook\"}"),
        region(
            "{\"name\":\"ellipse\",\"cx\":10,\"cy\":5,\"rx\":4,\"ry\":1,\"theta\":1.5707963}",
            "{\"class\":\"hook\"}",
        ),
        region("{\"name\":\"point\",\"cx\":10,\"cy\":5}", "{\"class\":\"hook\"}"),
    ];
    let list = format!("[{}]", shapes.join(","));
    let numbered: Vec<String> = shapes.iter().enumerate().map(|(k, shape)| format!("\"{k}\":{shape}")).collect();
    let map = format!("{{{}}}", numbered.join(","));
    let entries = |regions: &str| {
        format!(
            "\"f.png12\":{{\"filename\":\"f.png\",\"size\":12,\"regions\":{regions},\"file_attributes\":{{}}}},\"g.png9\":{{\"filename\":\"g.png\",\"size\":9,\"regions\":[]}}"
        )
    };
    let forms = [
        format!("{{\"_via_settings\":{{}},\"_via_img_metadata\":{{{}}},\"_via_attributes\":{{}}}}", entries(&list)),
        format!("{{{}}}", entries(&list)),
        format!("{{{}}}", entries(&map)),
    ];
    for form in forms {
        let file = home.join("train.json");
        fs::write(&file, &form).unwrap();
        for truth in [read(&Silent, &file, None, None).unwrap(), read(&Silent, &home, Some("train"), None).unwrap()] {
            assert_eq!(truth.classes, ["specimen_bag", "hook"]);
            assert_eq!(truth.pictures.iter().map(Picture::stem).collect::<Vec<_>>(), ["f", "g"]);
            let objects = &truth.pictures[0].objects;
            assert_eq!(objects.iter().map(|o| o.class).collect::<Vec<_>>(), [0, 1, 1, 1, 1], "a point is no object");
            let boxes: Vec<[f64; 4]> = objects.iter().map(|o| o.bbox).collect();
            assert_eq!(boxes[..3], [[1.0, 1.0, 2.0, 2.0], [1.0, 1.0, 2.0, 2.0], [4.0, 2.0, 5.0, 3.0]]);
            // Of its narrow ends no pixel's centre lies in the ellipse.
            assert_eq!((boxes[3], boxes[4]), ([6.0, 1.0, 8.0, 8.0], [9.0, 2.0, 2.0, 6.0]));
            let area = |k: usize| objects[k].mask.as_ref().unwrap().area as f64;
            assert!((area(3) - 50.3).abs() < 3.0 && (area(4) - 12.6).abs() < 3.0, "{} {}", area(3), area(4));
            assert!(truth.pictures[1].objects.is_empty());
        }
    }
    fs::remove_dir_all(home).unwrap();
}

#[test]
fn what_is_wrong_in_a_via_file_is_told_with_picture_and_region() {
    let home = folder("via_wrong", &["f.png"]);
    let good = region("{\"name\":\"rect\",\"x\":4,\"y\":2,\"width\":5,\"height\":3}", "{\"class\":\"hook\"}");
    let rect = |more: &str| format!("{{\"name\":\"rect\",\"x\":4,\"y\":2{more}}}");
    let class = "{\"class\":\"hook\"}";
    for (wrong, words) in [
        (region("{\"name\":\"star\"}", class), "`star` is not known"),
        (region("{}", class), "no `name`"),
        (region(&rect(",\"width\":5"), class), "no number `height`"),
        (region(&rect(",\"width\":-5,\"height\":2"), class), "`width` of its rect is -5"),
        (region("{\"name\":\"polygon\",\"all_points_x\":[1,2],\"all_points_y\":[1,2]}", class), "at least three"),
        (
            region("{\"name\":\"polygon\",\"all_points_x\":[1,2,\"a\"],\"all_points_y\":[1,2,3]}", class),
            "`all_points_x`",
        ),
        (region("{\"name\":\"circle\",\"cx\":900,\"cy\":5,\"r\":2}", class), "no pixel inside the image of 20x10"),
        (region(&rect(",\"width\":5,\"height\":2"), "{}"), "no `region_attributes`"),
        (region(&rect(",\"width\":5,\"height\":2"), "{\"class\":\"\"}"), "`class` is empty"),
        (
            region(&rect(",\"width\":5,\"height\":2"), "{\"a\":\"x\",\"b\":\"y\"}"),
            "attributes a, b none is called class",
        ),
        (
            region(&rect(",\"width\":5,\"height\":2"), "{\"tool\":{\"hook\":true,\"grasper\":true}}"),
            "2 boxes of `tool` are ticked",
        ),
        ("7".to_owned(), "no `shape_attributes`"),
    ] {
        let file = home.join("via.json");
        fs::write(&file, format!("{{\"f\":{{\"filename\":\"f.png\",\"regions\":[{good},{wrong}]}}}}")).unwrap();
        let error = chain(&read(&Silent, &file, None, None).unwrap_err());
        for part in ["via.json", "`f.png`", "region 2", words] {
            assert!(error.contains(part), "{error} lacks {part}");
        }
    }
    let file = home.join("via.json");
    fs::write(&file, "{\"f\":{\"filename\":\"other.png\",\"regions\":[]}}").unwrap();
    let error = chain(&read(&Silent, &file, None, None).unwrap_err());
    assert!(error.contains("`other.png`") && error.contains("--images"), "{error}");
    fs::write(&file, "{\"something\": 1}").unwrap();
    let error = chain(&read(&Silent, &file, None, None).unwrap_err());
    assert!(error.contains("neither a COCO nor a VIA file"), "{error}");
    fs::remove_dir_all(home).unwrap();
}
