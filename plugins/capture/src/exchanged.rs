//! Checks image files before a graph runs: do the views match the calibration, or are left and right swapped?

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use panoscope_data::calibration::packet::{ViewCameras, same};
use panoscope_imaging::Serial;
use panoscope_imaging::stereo::{Order, OrderEvidence, ViewOrder};
use panoscope_node::abi::Calibration;
use panoscope_node::{Rect, View};

use crate::source::{Picture, read};

/// A view: its file and the region of the image that it shows.
#[derive(Clone, PartialEq)]
pub struct FileView {
    /// Path of the image file.
    pub file: PathBuf,
    /// Region of the image, px.
    pub rect: Rect,
    /// Whether the image is rotated as its metadata says.
    pub is_upright: bool,
}

/// The last comparison. A graph is checked at each edit, and reading two images is slow.
static LAST: Mutex<Option<Compared>> = Mutex::new(None);

struct Compared {
    views: [FileView; 2],
    changed: [Option<SystemTime>; 2],
    calibration: Calibration,
    evidence: Option<OrderEvidence>,
}

/// Evidence that the views are swapped; `None` without such evidence, or where the images are not 8-bit images of the calibration's size.
pub fn exchanged(views: [FileView; 2], calibration: &Calibration) -> Option<OrderEvidence> {
    let changed = views.each_ref().map(|view| view.file.metadata().and_then(|data| data.modified()).ok());
    let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
    let evidence = match &*last {
        Some(last) if last.views == views && last.changed == changed && same(&last.calibration, calibration) => {
            last.evidence
        }
        _ => compare(&views, calibration),
    };
    *last = Some(Compared { views, changed, calibration: *calibration, evidence });
    evidence.filter(|evidence| evidence.order == Order::Exchanged)
}

fn compare(views: &[FileView; 2], calibration: &Calibration) -> Option<OrderEvidence> {
    let cameras = ViewCameras::new(calibration, calibration.is_rectified != 0).ok()?;
    let [left, right] = [&calibration.left, &calibration.right].map(|camera| (camera.width, camera.height));
    let [first, second] = views.each_ref().map(|view| pixels(view, left));
    let (first, second) = (first?, second?);
    if left != right {
        return None;
    }
    let (width, height) = (left.0 as usize, left.1 as usize);
    let mut order = ViewOrder::default();
    order.take([&first, &second].map(|bgr| View::new(&bgr[..], width, height, 3)), &Serial);
    order.find(0, &Serial);
    order.find(1, &Serial);
    Some(cameras.compare(&mut order, &Serial))
}

/// BGR pixels of a view, which must have this size.
fn pixels(view: &FileView, (width, height): (u32, u32)) -> Option<Vec<u8>> {
    let FileView { file, rect, is_upright } = view;
    if (rect.width, rect.height) != (width as usize, height as usize) || rect.is_empty() {
        return None;
    }
    let mut picture: Picture = read(file).ok()?;
    if *is_upright {
        picture.turn_upright();
    }
    let holds = rect.x + rect.width <= picture.width && rect.y + rect.height <= picture.height;
    if !holds || picture.peak().is_some() {
        return None;
    }
    let mut bgr = vec![0; 3 * rect.width * rect.height];
    for (y, row) in bgr.chunks_exact_mut(3 * rect.width).enumerate() {
        picture.write_row(rect.x, rect.y + y, 255.0, row);
    }
    Some(bgr)
}
