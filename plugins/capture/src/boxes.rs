//! Ground-truth boxes of one image, from VOC and YOLO files and from masks.

use std::path::Path;

use panoscope_data::data_sets::MaskFile;
use panoscope_data::truth::labels;
use panoscope_data::truth::masks::MaskPicture;
use panoscope_node::abi::Detection;
use panoscope_node::{LabeledDetections, LabeledInstances, NodeError, Rect, Result, Slot, detections};

/// Minimum size of a part of a mask that counts as an object, px. Smaller parts are specks at the border of an instrument.
const MIN_PIXELS: usize = 16;
/// The same minimum as a share of the image.
const MIN_SHARE: f64 = 1e-4;

/// Boxes of an image; the memory is reused for the next one.
#[derive(Debug, Default)]
pub struct Boxes {
    /// Class names: those that the data set gives first, in its order, then further ones as they occur.
    classes: Vec<String>,
    items: Vec<Detection>,
    /// One bit per pixel for each item that was read from a mask.
    masks: Vec<u8>,
}

/// Whether a file holds YOLO labels.
pub fn is_yolo(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("txt"))
}

impl Boxes {
    /// Starts without boxes. Classes that are not in the list are added when they first occur.
    pub fn new(classes: Vec<String>) -> Self {
        Self { classes, ..Self::default() }
    }

    /// Drops the boxes of the previous image.
    pub fn clear(&mut self) {
        self.items.clear();
        self.masks.clear();
    }

    fn class(&mut self, name: &str) -> u32 {
        let at = self.classes.iter().position(|known| known == name).unwrap_or_else(|| {
            self.classes.push(name.to_owned());
            self.classes.len() - 1
        });
        at as u32
    }

    /// Reads a VOC or YOLO file. `size`: width and height of the image, px.
    ///
    /// # Errors
    /// The file is missing or malformed; names file and line.
    pub fn read(&mut self, file: &Path, size: (usize, usize)) -> Result<()> {
        let (width, height) = (size.0 as f64, size.1 as f64);
        let wrong = |cause: &dyn std::fmt::Display| NodeError::new(format!("{}: {cause}", file.display()));
        let text = std::fs::read_to_string(file).map_err(|error| wrong(&error))?;
        if is_yolo(file) {
            for object in labels::yolo(&text).map_err(|error| match error {
                labels::LabelError::Line { line } | labels::LabelError::NoShare { line, .. } => {
                    wrong(&format!("line {line}: {error}"))
                }
                other => wrong(&other),
            })? {
                let name = self.classes.get(object.class).cloned();
                let class = self.class(&name.unwrap_or_else(|| format!("class {}", object.class)));
                let [x, y, w, h] = object.bounds();
                self.items.push(item([x * width, y * height, w * width, h * height], 1.0, class));
            }
            return Ok(());
        }
        let found = labels::voc(&text).map_err(|error| wrong(&error))?;
        // Boxes are in px of the size that the file names, which need not be the picture's any more.
        let (sx, sy) = (found.size[0].map_or(1.0, |w| width / w), found.size[1].map_or(1.0, |h| height / h));
        for object in found.objects {
            let class = self.class(&object.name.replace('\n', " "));
            let [x0, y0, x1, y1] = object.corners;
            let score = if object.is_difficult { 0.0 } else { 1.0 };
            self.items.push(item([x0 * sx, y0 * sy, (x1 - x0) * sx, (y1 - y0) * sy], score, class));
        }
        Ok(())
    }

    /// Adds the connected parts of a mask inside `part`, the region that the image shows.
    ///
    /// # Errors
    /// The file is missing, damaged or not of the size of the stored image.
    pub fn read_mask(&mut self, file: &MaskFile, stored: (usize, usize), part: Rect) -> Result<()> {
        let mask = MaskPicture::read(&file.path).map_err(|error| NodeError::new(error.to_string()))?;
        let same = (mask.width, mask.height) == stored;
        let cut = same.then(|| mask.cropped([part.x, part.y, part.width, part.height])).flatten();
        let Some(mask) = cut else {
            return Err(NodeError::new(format!(
                "{} is {}x{}, but its image is {}x{}: give masks of the size of the images",
                file.path.display(),
                mask.width,
                mask.height,
                stored.0,
                stored.1
            )));
        };
        let least = MIN_PIXELS.max((MIN_SHARE * (mask.width * mask.height) as f64) as usize);
        let row_len = mask.width.div_ceil(8);
        for layer in file.layers.iter() {
            for part in mask.parts(&layer.code, least) {
                self.items.push(item(part.bounds.map(|v| v as f64), 1.0, layer.class));
                let start = self.masks.len();
                self.masks.resize(start + detections::mask_len(mask.width, mask.height), 0);
                let bits = &mut self.masks[start..];
                for index in part.pixels {
                    let (x, y) = (index as usize % mask.width, index as usize / mask.width);
                    bits[y * row_len + x / 8] |= 0x80 >> (x % 8);
                }
            }
        }
        Ok(())
    }

    /// Writes the boxes to an output.
    ///
    /// # Errors
    /// The host has no frame memory left.
    pub fn write(&self, slot: &mut Slot<'_, LabeledDetections>, size: (usize, usize)) -> Result<()> {
        slot.set_detections(&self.items, &self.classes.join("\n"), size)
    }

    /// Writes boxes and masks to an output. All boxes must come from masks.
    ///
    /// # Errors
    /// The host has no frame memory left.
    pub fn write_instances(&self, slot: &mut Slot<'_, LabeledInstances>, size: (usize, usize)) -> Result<()> {
        slot.set_instances(&self.items, &self.classes.join("\n"), size, &self.masks)
    }
}

/// Makes the item of a box: left, top, width, height in px.
fn item([x, y, w, h]: [f64; 4], score: f32, class_index: u32) -> Detection {
    Detection {
        x_px: x as f32,
        y_px: y as f32,
        width_px: w as f32,
        height_px: h as f32,
        score,
        class_index,
        track_id: -1,
    }
}
