//! Middlebury's `calib.txt`, of the stereo sets of 2014 and 2021 and of the third evaluation: rectified views, lengths in mm.
//!
//! `cam0` and `cam1` are camera matrices in MATLAB's words, `doffs` is the difference of their principal columns: Z = baseline f / (d + doffs)
//! (Scharstein et al., "High-resolution stereo datasets with subpixel-accurate ground truth", 2014; vision.middlebury.edu/stereo).

use panoscope_abi::Calibration;

use crate::calibration::entries::Entries;
use crate::calibration::error::Mistake;
use crate::calibration::rectified::{self, View};

/// Largest difference between `doffs` and that of the principal columns, px: files round to thousandths.
const DOFFS_PX: f64 = 0.02;

/// Whether a text is such a file.
pub(crate) fn is(text: &str) -> bool {
    Entries::parse(text, '=', "#").get("cam0").is_some()
}

/// The packet of a file.
pub(crate) fn packet(text: &str) -> Result<Calibration, Mistake> {
    let entries = Entries::parse(text, '=', "#");
    let size = (entries.needed("width")?.pixels()?, entries.needed("height")?.pixels()?);
    let view = |name: &str| -> Result<View, Mistake> {
        let m: [f64; 9] = entries.needed(name)?.exactly()?;
        Ok(View { size, focal: (m[0], m[4]), centre: (m[2], m[5]) })
    };
    let (left, right) = (view("cam0")?, view("cam1")?);
    if let Some(entry) = entries.get("doffs") {
        let (stated, computed) = (entry.number()?, right.centre.0 - left.centre.0);
        if (stated - computed).abs() > DOFFS_PX {
            return Err(entry.mistake(format!(
                "`doffs` is {stated} px, the principal columns of `cam1` and `cam0` differ by {computed:.3} px: the lines belong to different files"
            )));
        }
    }
    let baseline_mm = entries.needed("baseline")?.number()?;
    Ok(rectified::packet(left, right, baseline_mm))
}
