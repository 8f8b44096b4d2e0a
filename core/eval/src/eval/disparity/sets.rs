//! Public pairs: OpenCV's Aloe, Middlebury's Motorcycle, the silicone heart, the Hamlyn sequence.

use std::path::Path;

use super::data::{self, Picture};
use super::judge::{Judge, Truth};
use super::rectified::Rectified;
use crate::error::{Result, ensure};

/// Pairs of the Hamlyn sequence that are judged.
const HAMLYN: [&str; 5] = ["1", "251", "501", "751", "1001"];

impl Judge<'_> {
    pub fn aloe(&mut self) -> Result<()> {
        let Some(left) = self.file("aloe", "aloeL.jpg", "Debian package opencv-doc") else { return Ok(()) };
        let Some(truth) = self.file("aloe", "aloeGT.png", "Debian package opencv-doc") else { return Ok(()) };
        let views = [Picture::read(&left)?, Picture::read(&left.with_file_name("aloeR.jpg"))?];
        let known = |d: u8| if d == 0 { f32::NAN } else { f32::from(d) };
        let disparity = data::gray(&truth)?.into_iter().map(known).collect();
        self.pair("aloe", [&views[0], &views[1]], 0, 256, &Truth { disparity, mask: None })
    }

    pub fn motorcycle(&mut self) -> Result<()> {
        let Some(truth) = self.file("motorcycle", "motorcycle/motorcycle_disp.npz", "cargo xtask data") else {
            return Ok(());
        };
        let read = |name: &str| Picture::read(&truth.with_file_name(name));
        let views = [read("motorcycle_left.png")?, read("motorcycle_right.png")?];
        let truth = data::npz(&truth)?;
        ensure!((truth.width, truth.height) == (views[0].width, views[0].height), "motorcycle: sizes differ");
        let known = |d: f32| if d > 0.0 { d } else { f32::NAN };
        let disparity = truth.data.into_iter().map(known).collect();
        self.pair("motorcycle", [&views[0], &views[1]], 0, 96, &Truth { disparity, mask: None })
    }

    pub fn heart(&mut self) -> Result<()> {
        let Some(left) = self.file("silicone_heart", "silicone_heart/f7_dynamic_deint_L_0100.png", "give --data")
        else {
            return Ok(());
        };
        let views = [Picture::read(&left)?, Picture::read(&left.with_file_name("f7_dynamic_deint_R_0100.png"))?];
        let folder = left.parent().unwrap_or(Path::new("."));
        let cameras = data::cameras(folder, (views[0].width, views[0].height))?;
        let rectified = Rectified::new(&cameras, views)?;
        self.consistency("silicone_heart", "silicone_heart", &rectified.views, 0, 64)
    }

    pub fn hamlyn(&mut self) -> Result<()> {
        let Some(first) = self.file("hamlyn", "hamlyn_640x480/left/1.png", "give --data") else { return Ok(()) };
        let Some(folder) = first.parent().and_then(Path::parent) else { return Ok(()) };
        for name in HAMLYN {
            let read = |side: &str| Picture::read(&folder.join(side).join(format!("{name}.png")));
            self.consistency(&format!("hamlyn_{name}"), "hamlyn", &[read("left")?, read("right")?], 0, 128)?;
        }
        Ok(())
    }
}
