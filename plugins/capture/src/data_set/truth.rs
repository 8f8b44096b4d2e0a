//! Disparity and depth of the left rectified view, converted from what the data set provides.

use panoscope_data::calibration::packet;
use panoscope_data::data_sets::{Holds, Sequence, Truth};
use panoscope_data::truth::{maps, points};
use panoscope_imaging::stereo::{FloatImage, Rectification};
use panoscope_node::abi::Calibration;
use panoscope_node::{Depth, Disparity, NodeError, Result, Slot, error};

/// Why an output of the ground truth stays empty, as text; `None` when it does not.
pub(super) fn lacks(sequence: &Sequence, output: &str) -> Option<&'static str> {
    if sequence.calibration.is_some() {
        return None;
    }
    match (sequence.truth.as_ref()?.holds, output) {
        (Holds::Disparity, "depth") => {
            Some("a calibration is needed to convert disparity to depth, and the sequence has none")
        }
        (Holds::Depth, "disparity") => {
            Some("a calibration is needed to convert depth to disparity, and the sequence has none")
        }
        (Holds::Points | Holds::StackedPoints, _) => {
            Some("a calibration is needed to project points into the view, and the sequence has none")
        }
        _ => None,
    }
}

/// Maps of one image, and the rectification that they refer to.
#[derive(Default)]
pub(super) struct TruthMaps {
    /// The calibration packet that was read last, with and without its rectification.
    known: Option<(Calibration, Calibration, Rectification)>,
    disparity: Option<FloatImage>,
    depth: Option<FloatImage>,
}

impl TruthMaps {
    /// The packet completed with the rectification that a `rectify` node will use.
    pub fn with_rectification(&mut self, calibration: Calibration) -> Result<Calibration> {
        if let Some((_, stated, _)) = self.known.as_ref().filter(|(known, ..)| packet::same(known, &calibration)) {
            return Ok(*stated);
        }
        let rectification = packet::rectification(&calibration)?;
        let stated = match calibration.is_rectified {
            0 => packet::with_rectification(&calibration, &rectification),
            _ => calibration,
        };
        self.known = Some((calibration, stated, rectification));
        Ok(stated)
    }

    /// Reads the ground truth of an image of `size`. `read`: which of disparity and depth are read by other nodes.
    ///
    /// # Errors
    /// A file is damaged or of another size.
    pub fn prepare(
        &mut self,
        truth: &Truth,
        picture: usize,
        calibration: Option<&Calibration>,
        size: (usize, usize),
        read: [bool; 2],
    ) -> Result<()> {
        (self.disparity, self.depth) = (None, None);
        let Some(Some(file)) = truth.files.get(picture) else { return Ok(()) };
        if read == [false; 2] {
            return Ok(());
        }
        let rectification = calibration.and(self.known.as_ref()).map(|(.., rectification)| rectification);
        let wrong = |error: maps::MapError| NodeError::new(error.to_string());
        let check = |width: usize, height: usize| {
            if (width, height) == size {
                return Ok(());
            }
            Err(error!(
                "{} is {width}x{height}, but its image is {}x{}: give ground truth of the size of the images",
                file.display(),
                size.0,
                size.1
            ))
        };
        if matches!(truth.holds, Holds::Points | Holds::StackedPoints) {
            let Some(rectification) = rectification else { return Ok(()) };
            let points = points::read(file).map_err(wrong)?;
            let points = if truth.holds == Holds::StackedPoints { points.upper_half() } else { points };
            check(points.width, points.height)?;
            let depth = points.rectified_depth(rectification);
            self.disparity = read[0].then(|| points::disparity_of_depth(&depth, rectification));
            self.depth = Some(depth);
            return Ok(());
        }
        let map = maps::read(file).map_err(wrong)?.divided(truth.divisor);
        check(map.width, map.height)?;
        if truth.holds == Holds::Disparity {
            self.depth = rectification.filter(|_| read[1]).map(|r| points::depth_of_disparity(&map, r));
            self.disparity = Some(map);
        } else {
            self.disparity = rectification.filter(|_| read[0]).map(|r| points::disparity_of_depth(&map, r));
            self.depth = Some(map);
        }
        Ok(())
    }

    /// Writes the outputs.
    ///
    /// # Errors
    /// The host has no frame memory left.
    pub fn write(&self, disparity: &mut Slot<'_, Disparity>, depth: &mut Slot<'_, Depth>) -> Result<()> {
        if let Some(map) = self.disparity.as_ref().filter(|_| disparity.is_read()) {
            disparity.alloc(map.width, map.height)?.data.copy_from_slice(&map.data);
        }
        if let Some(map) = self.depth.as_ref().filter(|_| depth.is_read()) {
            depth.alloc(map.width, map.height)?.data.copy_from_slice(&map.data);
        }
        Ok(())
    }
}
