//! True boxes and outlines: VOC, COCO, labelme, VIA, YOLO. Each target writes its bytes as the only label file of an image of 12 x 9 px.

use std::path::Path;
use std::sync::OnceLock;

use panoscope_eval::Silent;
use panoscope_eval::eval::detect::truth::{Truth, read};

use crate::scratch;

const WIDTH: u32 = 12;
const HEIGHT: u32 = 9;

fn png() -> &'static [u8] {
    static PNG: OnceLock<Vec<u8>> = OnceLock::new();
    PNG.get_or_init(|| {
        let mut bytes = Vec::new();
        let picture = image::RgbImage::new(WIDTH, HEIGHT);
        picture.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png).expect("a PNG");
        bytes
    })
}

/// Writes the image if it does not exist.
fn picture(name: &str) {
    let path = scratch::path(name);
    if !path.exists() {
        scratch::file(name, png());
    }
}

fn judge(path: &Path, bytes: &[u8]) {
    match read(&Silent, path, None, None) {
        Ok(truth) => properties(&truth, bytes.len()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

fn properties(truth: &Truth, len: usize) {
    let mut masks = 0;
    for picture in &truth.pictures {
        assert!(picture.width > 0 && picture.height > 0);
        for object in &picture.objects {
            assert!(object.class < truth.classes.len(), "class {} of {}", object.class, truth.classes.len());
            assert!(object.bbox.iter().all(|px| px.is_finite()), "{:?}", object.bbox);
            if let Some(mask) = &object.mask {
                masks += 1;
                assert_eq!((mask.width, mask.height), (picture.width, picture.height));
                let runs = mask.runs();
                assert_eq!(runs.iter().sum::<u64>(), (mask.width * mask.height) as u64);
                assert_eq!(runs.iter().skip(1).step_by(2).sum::<u64>(), mask.area);
                assert!(mask.area > 0);
            }
        }
    }
    // An object takes some bytes of text.
    assert!(masks <= len && truth.classes.len() <= len);
}

pub fn voc(bytes: &[u8]) {
    picture("voc/JPEGImages/a.png");
    let file = scratch::file("voc/Annotations/a.xml", bytes);
    let home = file.parent().and_then(Path::parent).expect("the folder of the set");
    judge(home, bytes);
}

pub fn coco(bytes: &[u8]) {
    picture("coco/a.png");
    judge(&scratch::file("coco/set.json", bytes), bytes);
    let _ = panoscope_eval::eval::detect::truth::read_found(&scratch::path("coco/set.json"));
}

pub fn via(bytes: &[u8]) {
    picture("via/a.png");
    judge(&scratch::file("via/set.json", bytes), bytes);
}

pub fn labelme(bytes: &[u8]) {
    picture("labelme/a.png");
    let file = scratch::file("labelme/a.json", bytes);
    judge(file.parent().expect("a folder"), bytes);
}

/// Labels, and after a line `#---` the file `data.yaml`.
pub fn yolo(bytes: &[u8]) {
    picture("yolo/images/a.png");
    let mark = b"#---\n";
    let at = bytes.windows(mark.len()).position(|part| part == mark);
    let (labels, names) = at.map_or((bytes, &b""[..]), |at| (&bytes[..at], &bytes[at + mark.len()..]));
    scratch::file("yolo/data.yaml", names);
    let file = scratch::file("yolo/labels/a.txt", labels);
    let home = file.parent().and_then(Path::parent).expect("the folder of the set");
    judge(home, bytes);
}

fn owned(texts: &[&str]) -> Vec<Vec<u8>> {
    texts.iter().map(|text| text.as_bytes().to_vec()).collect()
}

pub fn voc_seeds() -> Vec<Vec<u8>> {
    let object = "<object><name>Hook</name><difficult>1</difficult><bndbox><xmin>4</xmin><ymin>2</ymin><xmax>8</xmax><ymax>6</ymax></bndbox></object>";
    owned(&[
        &format!("<annotation><size><width>24</width><height>18</height></size>{object}{object}</annotation>"),
        &format!("<annotation><size><width>1e-320</width></size>{object}</annotation>"),
        "<annotation><object></object></annotation>",
        "<!DOCTYPE a [<!ENTITY b \"bbbb\"><!ENTITY c \"&b;&b;&b;\">]><a>&c;</a>",
        &"<a>".repeat(3000),
    ])
}

pub fn coco_seeds() -> Vec<Vec<u8>> {
    let whole = |shape: &str, size: (u64, u64)| {
        format!(
            "{{\"images\":[{{\"id\":7,\"file_name\":\"a.png\",\"width\":{},\"height\":{}}}],\"annotations\":[{{\"image_id\":7,\"category_id\":2,\"bbox\":[1,1,2,2],\"segmentation\":{shape}}}],\"categories\":[{{\"id\":2,\"name\":\"Hook\"}}]}}",
            size.0, size.1
        )
    };
    let own = (12, 9);
    owned(&[
        &whole("{\"size\":[9,12],\"counts\":[11,2,95]}", own),
        &whole("{\"size\":[9,12],\"counts\":\";2k5\"}", own),
        &whole("[[1,1,3,1,3,3,1,3]]", own),
        &whole("{\"size\":[4294967296,4294967296],\"counts\":[0]}", own),
        &whole("{\"size\":[1048576,1048576],\"counts\":[1099511627776]}", own),
        &whole(&format!("{{\"size\":[9,12],\"counts\":\"{}\"}}", "ooooooooooo?".repeat(40)), own),
        &whole("[[1,1,3,1,3,3,1,3]]", (16384, 16384)),
        &whole("[[1e300,1,-1e300,1,3,3e200,1,3]]", own),
        &whole("null", own),
        "{\"images\":[]}",
    ])
}

pub fn via_seeds() -> Vec<Vec<u8>> {
    let whole = |shape: &str| {
        format!(
            "{{\"a.png1\":{{\"filename\":\"a.png\",\"size\":1,\"regions\":[{{\"shape_attributes\":{shape},\"region_attributes\":{{\"class\":\"hook\"}}}}]}}}}"
        )
    };
    let of_class = |attributes: &str| {
        let shape = "{\"name\":\"rect\",\"x\":1,\"y\":1,\"width\":4,\"height\":3}";
        whole(shape).replace("{\"class\":\"hook\"}", attributes)
    };
    owned(&[
        &whole("{\"name\":\"polygon\",\"all_points_x\":[1,5,5],\"all_points_y\":[1,1,6]}"),
        &whole("{\"name\":\"rect\",\"x\":1,\"y\":1,\"width\":4,\"height\":3}"),
        &whole("{\"name\":\"circle\",\"cx\":5,\"cy\":5,\"r\":3}"),
        &whole("{\"name\":\"ellipse\",\"cx\":5,\"cy\":5,\"rx\":3,\"ry\":1e308,\"theta\":0.3}"),
        &whole("{\"name\":\"point\",\"cx\":5,\"cy\":5}"),
        "{\"_via_img_metadata\":{\"a\":{\"filename\":\"a.png\",\"regions\":{\"10\":{},\"9\":{}}}}}",
        "{\"a\":{\"filename\":\"a.png\",\"regions\":7}}",
        "{\"a\":{\"filename\":\"a.png\",\"regions\":null}}",
        &of_class("{\"Type\":\"hook\",\"class\":\"grasper\",\"other\":1}"),
        &of_class("{\"a\":\"hook\",\"b\":\"grasper\"}"),
        &of_class("{\"class\":3}"),
        &of_class("{\"class\":{\"hook\":true,\"grasper\":false}}"),
        &of_class("{\"class\":{\"hook\":true,\"grasper\":true}}"),
        &of_class("{\"class\":[]}"),
        &of_class("{\"class\":\" \"}"),
        &of_class("{}"),
    ])
}

pub fn labelme_seeds() -> Vec<Vec<u8>> {
    let whole = |shape: &str| format!("{{\"imagePath\":\"a.png\",\"shapes\":[{shape},{shape}]}}");
    owned(&[
        &whole("{\"label\":\"Hook\",\"points\":[[1,1],[6,1],[6,5]],\"group_id\":3,\"shape_type\":\"polygon\"}"),
        &whole("{\"label\":\"Hook\",\"points\":[[1,1],[6,5]],\"shape_type\":\"rectangle\"}"),
        &whole("{\"label\":\"\",\"points\":[[1e308,-1e308],[6,1e308],[-1e308,5]]}"),
        "{\"shapes\":[]}",
    ])
}

pub fn yolo_seeds() -> Vec<Vec<u8>> {
    owned(&[
        "0 0.5 0.5 0.2 0.2\n1 0.1 0.1 0.4 0.1 0.4 0.6\n#---\nnames: [hook, 'scissors']\n",
        "0 0.5 0.5 0.2 0.2\n#---\nnames:\n  0: hook\n  1: scissors\n",
        "3 0.5 0.5 0.2 1e308\n#---\nnames:\n- a\n- b\n",
        "9999.9 nan 1 1 1\n",
    ])
}
