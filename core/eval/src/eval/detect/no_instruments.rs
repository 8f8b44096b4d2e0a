//! Boxes, outlines and tips that the nodes report in images without instruments.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::find::Node;
use super::phantom::{place, read_lines};
use super::picture;
use super::truth::{Picture, Truth, normal_name, read_found, sizes_of};
use crate::error::{Context, FileAction, OnFile, Result};
use crate::inputs::Folder;
use crate::run::{self, Plan};
use crate::session::{Session, check_cancelled};
use panoscope_imaging::detect::{Find, Shape};

/// Folders of real images without instruments, in the folders of data sets, and the name of each in figures. Only
/// every second image is evaluated: the others are for tuning (`training/know_empty.py`).
pub const FOLDERS: [(&str, &str); 4] = [
    ("stereo/hamlyn_640x480/left", "hamlyn_left"),
    ("stereo/hamlyn_640x480/right", "hamlyn_right"),
    ("stereo/silicone_heart", "silicone_heart"),
    ("stereo/synthetic_liver", "synthetic_liver"),
];
/// Number of rendered scenes, each with separate tissue and light, and of their images, a second apart.
const SCENES: u64 = 16;
const FRAMES: u64 = 6;
/// Odd seeds are evaluated; even ones are for tuning.
const FIRST_SEED: u64 = 3_000_001;
/// Normal quantile of 95 % intervals.
const Z: f64 = 1.96;

/// Finds in images without instruments.
pub struct FalseFinds {
    /// Boxes of the detector; outlines of the segmenter.
    pub boxes: Vec<Vec<Find>>,
    pub masks: Vec<Vec<Find>>,
    /// Number of images with a tip from boxes, and from outlines.
    pub tips: [usize; 2],
}

/// Interval of 95 % of a share (Wilson 1927): `count` of `all`.
pub fn interval(count: usize, all: usize) -> [f64; 2] {
    let (n, p) = (all as f64, count as f64 / all.max(1) as f64);
    let centre = p + Z * Z / (2.0 * n);
    let half = Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    [-1.0, 1.0].map(|sign| ((centre + sign * half) / (1.0 + Z * Z / n)).clamp(0.0, 1.0))
}

/// The images of a folder without those of masks; of a data set (`is_shared`) every second one, from the second on.
pub fn folder(path: &Path, is_shared: bool) -> Result<Truth> {
    let mut pictures = sizes_of(path)?;
    pictures.retain(|picture| !picture.stem().contains("mask"));
    if is_shared && pictures.len() > 2 {
        pictures = pictures.into_iter().skip(1).step_by(2).collect();
    }
    Ok(Truth { classes: Vec::new(), pictures })
}

/// Renders tissue without instruments into `scratch`: three kinds, rough and smooth, near and far, in smoke, with
/// blood on the lens, narrow and wide views.
pub fn rendered(session: &dyn Session, scratch: &Folder) -> Result<Truth> {
    let mut all = Truth::default();
    for index in 0..SCENES {
        let path = scratch.path().join(format!("empty{index:02}"));
        std::fs::create_dir_all(&path).on_file(FileAction::Create, &path)?;
        let of = |values: &[f64], step: u64| values[(index / step) as usize % values.len()];
        let is_wide = index % 4 == 3;
        let text = format!(
            "mode = \"batch\"\nplugins = [\"phantom\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n\
             params = {{ scene = \"{}\", seed = {}, rate_hz = 1.0, distance_mm = {:?}, texture = {:?}, specular = {:?}, \
             smoke = {:?}, blood_drops = {}, light = {:?}, zoom = {:?}, lens = \"{}\" }}\n\
             [nodes.pictures]\ntype = \"write_images\"\ninputs = {{ image = \"scope.left\" }}\nparams = {{ path = \"{{seq}}.png\" }}\n",
            ["liver", "bowel", "cavity"][index as usize % 3],
            FIRST_SEED + 2 * index,
            of(&[30.0, 45.0, 60.0, 80.0], 1),
            of(&[1.0, 0.5, 0.1], 2),
            of(&[1.0, 2.5], 1),
            of(&[0.0, 0.0, 0.3], 1),
            of(&[0.0, 0.0, 0.0, 3.0], 1),
            of(&[1.0, 0.5, 1.0], 3),
            if is_wide { 0.45 } else { 1.0 },
            if is_wide { "equidistant" } else { "pinhole" },
        );
        let file = path.join("eval.toml");
        run::run(session, &Plan { text: &text, path: &file, frames: Some(FRAMES), ..Plan::default() })?;
        all.pictures.extend(folder(&path, false)?.pictures);
        check_cancelled(session)?;
    }
    Ok(all)
}

/// Runs detector, segmenter and `tool_tip` with their default parameters, changed by `settings`, over the images of
/// `truth`, whose order changes; adds the classes that they name to it. Images are a second apart, so that each is
/// seen for itself.
pub fn run(
    session: &dyn Session,
    truth: &mut Truth,
    [detector, segmenter]: [Option<&Path>; 2],
    settings: &[String],
) -> Result<FalseFinds> {
    truth.pictures.sort_by_key(|picture| (picture.width, picture.height));
    let mut all = FalseFinds { boxes: Vec::new(), masks: Vec::new(), tips: [0; 2] };
    let sized = truth.pictures.chunk_by(|a, b| (a.width, a.height) == (b.width, b.height));
    for pictures in sized.map(<[Picture]>::to_vec).collect::<Vec<_>>() {
        let part = Truth { classes: Vec::new(), pictures };
        for (index, (node, model)) in [(Node::Yolo, detector), (Node::MaskRcnn, segmenter)].into_iter().enumerate() {
            let Some(model) = model else { continue };
            let (finds, tips) = one(session, &part, truth, node, model, settings)?;
            [&mut all.boxes, &mut all.masks][index].extend(finds);
            all.tips[index] += tips;
        }
    }
    Ok(all)
}

/// Finds of one node in images of one size, and the number of images with a tip.
fn one(
    session: &dyn Session,
    part: &Truth,
    truth: &mut Truth,
    node: Node,
    model: &Path,
    settings: &[String],
) -> Result<(Vec<Vec<Find>>, usize)> {
    let scratch = Folder::new("panoscope-empty-run")?;
    let text = format!(
        "mode = \"batch\"\nplugins = [\"capture\", \"tools\", \"sinks\"]\n\
         [nodes.files]\ntype = \"capture\"\nparams = {{ left = {}, pace = \"off\", rate_hz = 1.0 }}\n{}\
         [nodes.tip]\ntype = \"tool_tip\"\ninputs = {{ {} }}\n\
         [nodes.tips]\ntype = \"write_table\"\ninputs = {{ tip = \"tip.tip\" }}\nparams = {{ path = \"tips.jsonl\" }}\n\
         [nodes.out]\ntype = \"write_table\"\ninputs = {{ {port} = \"find.{port}\" }}\nparams = {{ path = \"found.json\" }}\n",
        toml::Value::String(part.file_list()),
        node.text_with("files.left", model, settings),
        node.tip_inputs("files.left"),
        port = node.port(),
    );
    let path = scratch.path().join("eval.toml");
    let frames = Some(part.pictures.len() as u64);
    run::run(session, &Plan { text: &text, path: &path, frames, ..Plan::default() })?;
    let tips = read_lines(&scratch.path().join("tips.jsonl"))?.iter().filter_map(place).count();
    let found = read_found(&scratch.path().join("found.json"))?;
    let mut finds = Vec::new();
    for (picture, annotations) in part.pictures.iter().zip(found.by_image.values()) {
        let mut list = Vec::new();
        for a in annotations {
            let name = normal_name(found.names.get(&a.category_id).map_or("", String::as_str));
            let class = truth.classes.iter().position(|known| *known == name).unwrap_or_else(|| {
                truth.classes.push(name);
                truth.classes.len() - 1
            });
            let mask = a.segmentation.as_ref().map(|s| s.mask(picture.width, picture.height)).transpose();
            let mask = mask.with_context(|| picture.path.display().to_string())?;
            list.push(Find { class, bbox: a.bbox, mask, score: a.score });
        }
        finds.push(list);
    }
    Ok((finds, tips))
}

/// The number of finds of each class as text, and the number of images with any.
pub fn counts(truth: &Truth, finds: &[Vec<Find>]) -> (usize, usize, String) {
    let mut of_class: BTreeMap<&str, usize> = BTreeMap::new();
    finds.iter().flatten().for_each(|find| *of_class.entry(&truth.classes[find.class]).or_default() += 1);
    let text: Vec<String> = of_class.iter().map(|(name, count)| format!("{count} {name}")).collect();
    (finds.iter().flatten().count(), finds.iter().filter(|list| !list.is_empty()).count(), text.join(", "))
}

/// Contact sheets of the images with false finds, `NAME_boxes.png` and `NAME_masks.png`, in `folder`.
pub fn draw(folder: &Path, name: &str, truth: &Truth, found: &FalseFinds) -> Result<()> {
    for (what, finds, shape) in [("boxes", &found.boxes, Shape::Box), ("masks", &found.masks, Shape::Mask)] {
        if finds.iter().any(|list| !list.is_empty()) {
            let path: PathBuf = folder.join(format!("no_instruments_{name}_{what}.png"));
            picture::sheet(&path, truth, finds, shape, false)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_contain_the_share_and_narrow_with_the_number() {
        // Wilson's for 0 of 46 and 2 of 100, by hand.
        let [low, high] = interval(0, 46);
        assert!(low.abs() < 1e-9 && (high - 0.0771).abs() < 5e-4, "{low} {high}");
        let [low, high] = interval(2, 100);
        assert!((low - 0.0055).abs() < 5e-4 && (high - 0.0700).abs() < 5e-4, "{low} {high}");
    }

    #[test]
    fn of_a_shared_folder_every_second_image_is_evaluated() {
        let scratch = Folder::new("panoscope-empty-test").expect("a folder");
        for name in ["a", "b", "c", "d", "e_mask"] {
            let file = scratch.path().join(format!("{name}.png"));
            image::RgbImage::new(4, 3).save(file).expect("an image");
        }
        let names = |is_shared| {
            let truth = folder(scratch.path(), is_shared).expect("a folder of images");
            truth.pictures.iter().map(Picture::stem).collect::<Vec<_>>()
        };
        assert_eq!(names(true), ["b", "d"]);
        assert_eq!(names(false), ["a", "b", "c", "d"]);
    }
}
