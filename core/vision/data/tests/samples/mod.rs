//! Tiny copies of the layouts of public data sets, with pictures of a known shift.
//!
//! The right picture of every rectified pair shows the left one `SHIFT` px to the left, so that the disparity is
//! `SHIFT` everywhere.

// Every test file uses its part.
#![allow(dead_code)]

use std::fs;
use std::path::{Path, PathBuf};

pub const WIDTH: u32 = 64;
pub const HEIGHT: u32 = 48;
pub const SHIFT: u32 = 6;

/// Gray of a texture without repetition.
fn texture(x: u32, y: u32, seed: u32) -> u8 {
    let cell = (x / 2).wrapping_mul(0x9E37_79B1) ^ (y / 2).wrapping_mul(0x85EB_CA6B) ^ seed.wrapping_mul(0xC2B2_AE35);
    40 + (cell.wrapping_mul(0x2545_F491) >> 20) as u8 % 180
}

/// A folder to put layouts in.
pub struct Tree(pub PathBuf);

impl Tree {
    pub fn at(&self, path: &str) -> PathBuf {
        self.0.join(path)
    }

    fn ready(&self, path: &str) -> PathBuf {
        let path = self.at(path);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        path
    }

    pub fn write(&self, path: &str, text: impl AsRef<[u8]>) {
        fs::write(self.ready(path), text).expect("a file");
    }

    /// A textured picture whose scene is moved to the left by `shift` px.
    pub fn picture(&self, path: &str, (width, height): (u32, u32), seed: u32, shift: u32) {
        let picture = image::RgbImage::from_fn(width, height, |x, y| image::Rgb([texture(x + shift, y, seed); 3]));
        picture.save(self.ready(path)).expect("a picture");
    }

    /// A gray mask: 0, and these values in rectangles x, y, width, height.
    pub fn mask(&self, path: &str, (width, height): (u32, u32), parts: &[([u32; 4], u8)]) {
        let value = |px: u32, py: u32| {
            let inside = |[x, y, w, h]: &[u32; 4]| (*x..x + w).contains(&px) && (*y..y + h).contains(&py);
            parts.iter().find(|(part, _)| inside(part)).map_or(0, |(_, value)| *value)
        };
        let mask = image::GrayImage::from_fn(width, height, |x, y| image::Luma([value(x, y)]));
        mask.save(self.ready(path)).expect("a mask");
    }

    /// The same in colours.
    pub fn coloured(&self, path: &str, (width, height): (u32, u32), parts: &[([u32; 4], [u8; 3])]) {
        let value = |px: u32, py: u32| {
            let inside = |[x, y, w, h]: &[u32; 4]| (*x..x + w).contains(&px) && (*y..y + h).contains(&py);
            parts.iter().find(|(part, _)| inside(part)).map_or([0; 3], |(_, value)| *value)
        };
        let mask = image::RgbImage::from_fn(width, height, |x, y| image::Rgb(value(x, y)));
        mask.save(self.ready(path)).expect("a mask");
    }

    /// 16 bits in a PNG.
    pub fn png16(&self, path: &str, value: impl Fn(u32, u32) -> u16) {
        let map =
            image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::from_fn(WIDTH, HEIGHT, |x, y| image::Luma([value(x, y)]));
        map.save(self.ready(path)).expect("a map");
    }

    /// A PFM: rows from below, infinite where unknown.
    pub fn pfm(&self, path: &str, (width, height): (u32, u32), value: impl Fn(u32, u32) -> f32) {
        let mut bytes = format!("Pf\n{width} {height}\n-1\n").into_bytes();
        for y in (0..height).rev() {
            bytes.extend((0..width).flat_map(|x| value(x, y).to_le_bytes()));
        }
        self.write(path, bytes);
    }

    /// A TIFF of x, y, z.
    pub fn points(&self, path: &str, (width, height): (u32, u32), value: impl Fn(u32, u32) -> [f32; 3]) {
        let map = image::Rgb32FImage::from_fn(width, height, |x, y| image::Rgb(value(x, y)));
        image::DynamicImage::ImageRgb32F(map).save(self.ready(path)).expect("points");
    }
}

/// A matrix as OpenCV's `FileStorage` has it.
pub fn matrix(name: &str, rows: usize, columns: usize, data: &[f64]) -> String {
    let data = data.iter().map(|v| format!("{v:.8e}")).collect::<Vec<_>>().join(", ");
    format!("{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: f\n   data: [ {data} ]\n")
}

/// Focal length, principal point, baseline of SCARED's cameras here; the right one is turned by `SCARED_TURN` rad about
/// the vertical axis.
pub const SCARED_FOCAL: f64 = 60.0;
pub const SCARED_CENTRE: [f64; 2] = [31.5, 23.5];
pub const SCARED_TURN: f64 = 0.08;
/// The scene is the plane z = 80 mm of the raw left camera.
pub const SCARED_Z: f64 = 80.0;

fn scared_calibration() -> String {
    let k = [SCARED_FOCAL, 0.0, SCARED_CENTRE[0], 0.0, SCARED_FOCAL, SCARED_CENTRE[1], 0.0, 0.0, 1.0];
    let (sine, cosine) = SCARED_TURN.sin_cos();
    let turn = [cosine, 0.0, sine, 0.0, 1.0, 0.0, -sine, 0.0, cosine];
    [
        "%YAML:1.0\n---\n".to_owned(),
        matrix("M1", 3, 3, &k),
        matrix("D1", 1, 5, &[0.0; 5]),
        matrix("M2", 3, 3, &k),
        matrix("D2", 1, 5, &[0.0; 5]),
        matrix("R", 3, 3, &turn),
        matrix("T", 3, 1, &[-4.2, 0.0, 0.1]),
    ]
    .concat()
}

/// The point of the plane that a raw pixel sees; the lower right corner is unknown.
fn plane(x: u32, y: u32, z: f64) -> [f32; 3] {
    if x > 55 && y > 40 {
        return [f32::NAN; 3];
    }
    let of = |at: u32, centre: f64| ((f64::from(at) - centre) / SCARED_FOCAL * z) as f32;
    [of(x, SCARED_CENTRE[0]), of(y, SCARED_CENTRE[1]), z as f32]
}

/// Keyframe with truth, points of two of the three frames of a video. `video` is called with the path that the video
/// has to get.
pub fn scared(tree: &Tree, video: impl Fn(&Path)) {
    let key = "SCARED/dataset_1/keyframe_1";
    tree.write(&format!("{key}/endoscope_calibration.yaml"), scared_calibration());
    for (name, seed) in [("Left_Image.png", 1), ("Right_Image.png", 2)] {
        tree.picture(&format!("{key}/{name}"), (WIDTH, HEIGHT), seed, 0);
    }
    tree.points(&format!("{key}/left_depth_map.tiff"), (WIDTH, HEIGHT), |x, y| plane(x, y, SCARED_Z));
    for (number, z) in [(0, 80.0), (2, 90.0)] {
        // Below the left view's points stand those of the right one.
        let stacked = |x: u32, y: u32| if y < HEIGHT { plane(x, y, z) } else { [1.0, 2.0, 3.0] };
        tree.points(&format!("{key}/data/scene_points/scene_points{number:06}.tiff"), (WIDTH, 2 * HEIGHT), stacked);
    }
    video(&tree.at(&format!("{key}/data/rgb.mp4")));
    // A test set: packed, without truth.
    let packed = "SCARED/dataset_8/keyframe_0";
    tree.write(&format!("{packed}/endoscope_calibration.yaml"), scared_calibration());
    tree.picture(&format!("{packed}/Left_Image.png"), (WIDTH, HEIGHT), 1, 0);
    tree.picture(&format!("{packed}/Right_Image.png"), (WIDTH, HEIGHT), 2, 0);
    tree.write(&format!("{packed}/data/scene_points.tar.gz"), "packed");
    video(&tree.at(&format!("{packed}/data/rgb.mp4")));
}

pub fn stereomis(tree: &Tree, video: impl Fn(&Path)) {
    let pose = |r: [f64; 9], t: [f64; 3]| {
        let r: String = r.iter().enumerate().map(|(i, v)| format!("R_{i}={v}\n")).collect();
        r + &t.iter().enumerate().map(|(i, v)| format!("T_{i}={v}\n")).collect::<String>()
    };
    let side = |name: &str, cx: f64, t: f64| {
        let kc: String = (0..8).map(|i| format!("kc_{i}=0\n")).collect();
        let eye = pose([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [t, 0.0, 0.0]);
        format!("[{name}]\nres_x={WIDTH}\nres_y={HEIGHT}\nfc_x=60\nfc_y=60\ncc_x={cx}\ncc_y=23.5\n{kc}{eye}")
    };
    let text = side("StereoLeft", 31.5, 0.0) + &side("StereoRight", 33.5, -4.15);
    tree.write("StereoMIS_0_0_1/P2_0/StereoCalibration.ini", text);
    tree.write("StereoMIS_0_0_1/P2_0/groundtruth.txt", "0 0 0 0 0 0 0 1\n");
    tree.mask("StereoMIS_0_0_1/P2_0/masks/000000l.png", (WIDTH, HEIGHT), &[]);
    video(&tree.at("StereoMIS_0_0_1/P2_0/IFBS_ENDOSCOPE-part0001.mp4"));
}

/// Depth 90 mm but for an unknown column.
pub fn hamlyn(tree: &Tree) {
    for number in 0..3 {
        for (view, shift) in [("image01", 0), ("image02", SHIFT)] {
            let path = format!("hamlyn/rectified01/rectified01/{view}/{number:010}.jpg");
            tree.picture(&path, (WIDTH, HEIGHT), number, shift);
        }
        let depth = format!("hamlyn/rectified01/rectified01/depth01/{number:010}.png");
        tree.png16(&depth, |x, _| if x == 3 { 0 } else { 90 });
    }
    tree.write("hamlyn/calibration/01/intrinsics.txt", "60 0 31.5 0\n0 60 23.5 0\n0 0 1 0\n");
    tree.write("hamlyn/calibration/01/extrinsics.txt", "1 0 0 -5.4\n0 1 0 0\n0 0 1 0\n");
    tree.picture("hamlyn_tracking/test1/color/0000000000.jpg", (WIDTH, HEIGHT), 1, 0);
    tree.png16("hamlyn_tracking/test1/depth/0000000000.png", |_, _| 70);
    tree.write("hamlyn_tracking/test1/intrinsics.txt", "60 0 31.5\n0 60 23.5\n0 0 1\n");
}

fn endovis_calibration((width, height): (u32, u32)) -> String {
    let camera = |n: u8| {
        format!(
            "Camera-{n}-F: 60 60  // focal\nCamera-{n}-C: 31.5 23.5\nCamera-{n}-Alpha: 0.0\nCamera-{n}-K: 0 0 0 0 0\n"
        )
    };
    format!(
        "Width: {width} // columns\nHeight: {height}\n{}{}Extrinsic-Omega: 0.0 0.0 0.0\nExtrinsic-T: -4.35 0.0 0.0\n",
        camera(0),
        camera(1)
    )
}

/// 2017 with its border, and a small copy without; 2018 with labels of a list and without one.
pub fn endovis(tree: &Tree) {
    let stored = "EndoVis2017/instrument_dataset_1";
    tree.write(&format!("{stored}/camera_calibration.txt"), endovis_calibration((1280, 1024)));
    for view in ["left_frames", "right_frames"] {
        tree.picture(&format!("{stored}/{view}/frame000.png"), (1920, 1080), 1, 0);
    }
    let mask = format!("{stored}/ground_truth/Left_Prograsp_Forceps_labels/frame000.png");
    tree.mask(&mask, (1920, 1080), &[([420, 128, 200, 100], 10), ([600, 200, 50, 50], 20)]);
    let small = "EndoVis2017/instrument_dataset_2";
    tree.write(&format!("{small}/camera_calibration.txt"), endovis_calibration((WIDTH, HEIGHT)));
    for number in 0..2 {
        for (view, shift) in [("left_frames", 0), ("right_frames", SHIFT)] {
            tree.picture(&format!("{small}/{view}/frame{number:03}.png"), (WIDTH, HEIGHT), number, shift);
        }
    }
    // The second frame has no labels; a speck and the folder `Other` count as they should.
    let truth = format!("{small}/ground_truth");
    tree.mask(
        &format!("{truth}/Maryland_Bipolar_Forceps_labels/frame000.png"),
        (WIDTH, HEIGHT),
        &[([10, 8, 12, 6], 10), ([40, 40, 2, 2], 10)],
    );
    tree.mask(&format!("{truth}/Other_labels/frame000.png"), (WIDTH, HEIGHT), &[([30, 20, 5, 9], 40)]);
    let seq = "EndoVis2018/miccai_challenge_2018_release_1/seq_1";
    tree.write(&format!("{seq}/camera_calibration.txt"), endovis_calibration((WIDTH, HEIGHT)));
    for (view, shift) in [("left_frames", 0), ("right_frames", SHIFT)] {
        tree.picture(&format!("{seq}/{view}/frame000.png"), (WIDTH, HEIGHT), 5, shift);
    }
    let kidney = [255, 55, 0];
    tree.coloured(
        &format!("{seq}/labels/frame000.png"),
        (WIDTH, HEIGHT),
        &[([4, 4, 20, 5], [0, 255, 0]), ([24, 4, 6, 5], [1, 2, 3]), ([0, 30, 60, 10], kidney)],
    );
    let list = r#"[{"name": "instrument-shaft", "color": [0, 255, 0], "classid": 1}, {"name": "instrument-clasper", "color": [1, 2, 3], "classid": 2}]"#;
    tree.write("EndoVis2018/miccai_challenge_2018_release_1/labels.json", list);
}

fn kitti_projections(focal: f64, metres: [f64; 4]) -> String {
    let p = |(n, m): (usize, &f64)| format!("P{n}: {focal} 0 31.5 {} 0 {focal} 23.5 0 0 0 1 0\n", -focal * m);
    metres.iter().enumerate().map(p).collect()
}

/// Stereo 2015 with calibrations in their own archive, 2012 gray and in colours, odometry, a raw recording with depth.
pub fn kitti(tree: &Tree) {
    let set = "KITTI/data_scene_flow/training";
    for name in ["000000_10", "000000_11", "000001_10"] {
        for (view, shift) in [("image_2", 0), ("image_3", SHIFT)] {
            tree.picture(&format!("{set}/{view}/{name}.png"), (WIDTH, HEIGHT), 3, shift);
        }
        if name.ends_with("_10") {
            // Sparse, as the laser sees it.
            let sparse = |x: u32, y: u32| if y.is_multiple_of(2) && x > SHIFT { (256 * SHIFT) as u16 } else { 0 };
            tree.png16(&format!("{set}/disp_occ_0/{name}.png"), sparse);
        }
    }
    for (number, focal) in [(0, 60.0), (1, 50.0)] {
        let size = format!("S_rect_02: {WIDTH} {HEIGHT}\nS_rect_03: {WIDTH} {HEIGHT}\n");
        let text = kitti_projections(focal, [0.0, 0.54, -0.06, 0.48])
            .replace("P2:", "P_rect_02:")
            .replace("P3:", "P_rect_03:");
        let file = format!("KITTI/data_scene_flow_calib/training/calib_cam_to_cam/{number:06}.txt");
        tree.write(&file, format!("calib_time: 09-Jan-2012 14:00:15\n{size}{text}"));
    }
    let set = "KITTI/data_stereo_flow/training";
    for view in ["colored_0", "image_0"] {
        tree.picture(&format!("{set}/{view}/000000_10.png"), (WIDTH, HEIGHT), 4, 0);
        tree.picture(&format!("{set}/{}/000000_10.png", view.replace('0', "1")), (WIDTH, HEIGHT), 4, SHIFT);
    }
    tree.png16(&format!("{set}/disp_occ/000000_10.png"), |_, _| (256 * SHIFT) as u16);
    tree.write(&format!("{set}/calib/000000.txt"), kitti_projections(60.0, [0.0, 0.5, -0.06, 0.48]));
    let odometry = "KITTI/dataset/sequences/00";
    for number in 0..4 {
        tree.picture(&format!("{odometry}/image_0/{number:06}.png"), (WIDTH, HEIGHT), number, 0);
        tree.picture(&format!("{odometry}/image_1/{number:06}.png"), (WIDTH, HEIGHT), number, SHIFT);
    }
    tree.write(&format!("{odometry}/calib.txt"), kitti_projections(60.0, [0.0, 0.5, -0.06, 0.48]));
    let day = "KITTI/2011_09_26";
    let drive = format!("{day}/2011_09_26_drive_0001_sync");
    for number in 0..2 {
        tree.picture(&format!("{drive}/image_02/data/{number:010}.png"), (WIDTH, HEIGHT), number, 0);
        tree.picture(&format!("{drive}/image_03/data/{number:010}.png"), (WIDTH, HEIGHT), number, SHIFT);
    }
    // 12.5 m, times 256.
    tree.png16(
        &format!("{drive}/proj_depth/groundtruth/image_02/0000000001.png"),
        |x, _| if x == 5 { 0 } else { 3200 },
    );
    let raw = kitti_projections(60.0, [0.0, 0.5, -0.06, 0.48]).replace('P', "P_rect_0");
    tree.write(&format!("{day}/calib_cam_to_cam.txt"), raw);
}

/// Difference of the principal columns of Middlebury's cameras here, px.
pub const DOFFS: f64 = 4.0;
pub const MIDDLEBURY_FOCAL: f64 = 60.0;
pub const MIDDLEBURY_BASELINE: f64 = 150.0;

/// MiddEval3 with a sharp disparity, 2014, a scene of 2006 at third size and one of 2003.
pub fn middlebury(tree: &Tree) {
    let calibration = format!(
        "cam0=[{MIDDLEBURY_FOCAL} 0 30; 0 {MIDDLEBURY_FOCAL} 23.5; 0 0 1]\ncam1=[{MIDDLEBURY_FOCAL} 0 34; 0 {MIDDLEBURY_FOCAL} 23.5; 0 0 1]\n\
         doffs={DOFFS}\nbaseline={MIDDLEBURY_BASELINE}\nwidth={WIDTH}\nheight={HEIGHT}\nndisp=20\n"
    );
    for (scene, truth) in
        [("MiddEval3/trainingQ/Adirondack", "disp0GT.pfm"), ("Middlebury2014/Bicycle1-perfect", "disp0.pfm")]
    {
        tree.picture(&format!("{scene}/im0.png"), (WIDTH, HEIGHT), 7, 0);
        tree.picture(&format!("{scene}/im1.png"), (WIDTH, HEIGHT), 7, SHIFT);
        tree.write(&format!("{scene}/calib.txt"), &calibration);
        tree.pfm(
            &format!("{scene}/{truth}"),
            (WIDTH, HEIGHT),
            |x, _| if x < SHIFT { f32::INFINITY } else { SHIFT as f32 },
        );
    }
    tree.picture("MiddEval3/testQ/Australia/im0.png", (WIDTH, HEIGHT), 8, 0);
    tree.picture("MiddEval3/testQ/Australia/im1.png", (WIDTH, HEIGHT), 8, SHIFT);
    tree.write("MiddEval3/testQ/Australia/calib.txt", &calibration);
    let third = (413, 24);
    tree.picture("Middlebury2006/Aloe/view1.png", third, 9, 0);
    tree.picture("Middlebury2006/Aloe/view5.png", third, 9, SHIFT);
    tree.mask("Middlebury2006/Aloe/disp1.png", third, &[([10, 0, 403, 24], 3 * SHIFT as u8)]);
    let quarter = (450, 24);
    tree.picture("Middlebury2003/cones/im2.png", quarter, 9, 0);
    tree.picture("Middlebury2003/cones/im6.png", quarter, 9, SHIFT);
    tree.mask("Middlebury2003/cones/disp2.png", quarter, &[([10, 0, 440, 24], 4 * SHIFT as u8)]);
}

/// Two frames, the second without a mask.
pub fn cholecseg8k(tree: &Tree) {
    let clip = "CholecSeg8k/video01/video01_00080";
    for number in [80, 100] {
        tree.picture(&format!("{clip}/frame_{number}_endo.png"), (WIDTH, HEIGHT), number, 0);
    }
    let parts = [([5, 6, 10, 4], 31), ([40, 20, 8, 8], 32), ([20, 10, 15, 15], 21), ([50, 2, 3, 3], 31)];
    tree.mask(&format!("{clip}/frame_80_endo_watershed_mask.png"), (WIDTH, HEIGHT), &parts);
    tree.mask(&format!("{clip}/frame_80_endo_color_mask.png"), (WIDTH, HEIGHT), &[]);
    tree.mask(&format!("{clip}/frame_80_endo_mask.png"), (WIDTH, HEIGHT), &[]);
}

fn voc(class: &str, [x0, y0, x1, y1]: [u32; 4]) -> String {
    format!(
        "<annotation><size><width>{}</width><height>{}</height></size><object><name>{class}</name><bndbox><xmin>{x0}</xmin>\
         <ymin>{y0}</ymin><xmax>{x1}</xmax><ymax>{y1}</ymax></bndbox></object></annotation>",
        2 * WIDTH,
        2 * HEIGHT
    )
}

/// m2cai16-tool-locations with lists, and YOLO with splits.
pub fn boxes(tree: &Tree) {
    let set = "m2cai16-tool-locations";
    for (name, class) in [("v01_002075", Some("Hook")), ("v01_002250", Some("Grasper")), ("v02_000100", None)] {
        tree.picture(&format!("{set}/JPEGImages/{name}.jpg"), (WIDTH, HEIGHT), 1, 0);
        if let Some(class) = class {
            tree.write(&format!("{set}/Annotations/{name}.xml"), voc(class, [20, 10, 40, 30]));
        }
    }
    tree.write(&format!("{set}/class_list.txt"), "1 Grasper\n2 Bipolar\n3 Hook\n");
    tree.write(&format!("{set}/ImageSets/train.txt"), "v01_002250\n");
    tree.write(&format!("{set}/ImageSets/test.txt"), "v01_002075\nv02_000100\n");
    tree.picture("yolo/images/train/a.png", (WIDTH, HEIGHT), 1, 0);
    tree.write("yolo/labels/train/a.txt", "1 0.5 0.5 0.25 0.5\n");
    tree.write("yolo/data.yaml", "names: [grasper, hook]\n");
}

/// Folders `left` and `right` without a calibration; one picture has no partner.
pub fn pairs(tree: &Tree) {
    for number in [1, 2, 10] {
        tree.picture(&format!("pairs/left/l_{number}.png"), (WIDTH, HEIGHT), number, 0);
        if number != 2 {
            tree.picture(&format!("pairs/right/r_{number}.png"), (WIDTH, HEIGHT), number, SHIFT);
        }
    }
}

/// All layouts below one folder.
pub fn all(tree: &Tree, video: impl Fn(&Path) + Copy) {
    scared(tree, video);
    stereomis(tree, video);
    hamlyn(tree);
    endovis(tree);
    kitti(tree);
    middlebury(tree);
    cholecseg8k(tree);
    boxes(tree);
    pairs(tree);
}
