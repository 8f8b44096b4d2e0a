//! `write_raw`: planes in full precision.

use std::path::PathBuf;

use panoscope_node::{
    AnyImage, Confidence, Context, Depth, Disparity, Finish, Image, Mask, NoPorts, Node, NodeError, NodeInfo, Open,
    Params, Ports, Result, Validation,
};

use crate::picture::pixels_of;
use crate::target::{Pattern, SinkError, Wholes, check_name, check_path, claim_files, make_folder};
use panoscope_data::formats::Pixels;
use panoscope_data::formats::array::{self, ArrayFormat};

/// Input ports of `write_raw`.
#[derive(Ports)]
pub struct In<'f> {
    /// Any image.
    pub image: Option<AnyImage<'f>>,
    /// Disparity map in px, NaN where unmatched.
    pub disparity: Option<Image<'f, Disparity>>,
    /// Depth map in mm, NaN where unknown.
    pub depth: Option<Image<'f, Depth>>,
    /// Confidence, 0 to 1.
    pub confidence: Option<Image<'f, Confidence>>,
    /// Mask, 0 or 255.
    pub mask: Option<Image<'f, Mask>>,
}

/// Parameters of `write_raw`.
#[derive(Params)]
pub struct Settings {
    /// File to write. Its extension selects the format: .pfm (floats), .npy, .tif, .pgm or .ppm, .raw (bare rows). `{seq}` becomes the tick's number,
    /// `{port}` the input's name; with several inputs the name is added if `{port}` is missing.
    #[param(default = "out/plane.pfm", reopen, writes)]
    pub path: PathBuf,
    /// Every n-th tick is written.
    #[param(default = 1, range = 1..=100000, unit = "frames")]
    pub every: u64,
    /// Number of ticks after which writing stops; 0 never stops.
    #[param(default = 0, range = 0..=1000000000, unit = "frames")]
    pub limit: u64,
}

/// Writes planes for use by other programs.
pub struct WriteRaw {
    pattern: Pattern,
    files: Wholes,
    format: ArrayFormat,
    ticks: u64,
    bare_reported: bool,
}

impl Node for WriteRaw {
    const INFO: NodeInfo =
        NodeInfo::blocking("write_raw", "sink", "Writes planes with their full precision: PFM, NPY, TIFF, PGM, raw.")
            .side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        check_path(check, &params.path, "{seq}_{port}.pfm", ArrayFormat::ENDINGS);
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let ending = check_name(&params.path, "{seq}_{port}.pfm", ArrayFormat::ENDINGS)?;
        let format = ArrayFormat::from_ending(&ending).ok_or_else(|| NodeError::new("the extension has no format"))?;
        let pattern = Pattern::new(&claim_files(open, &params.path)?);
        Ok(Self { pattern, files: Wholes::default(), format, ticks: 0, bare_reported: false })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, params: &Settings) -> Result<()> {
        let planes = [
            ("image", input.image.as_ref().and_then(pixels_of)),
            ("disparity", input.disparity.map(|plane| Pixels::F32(plane.view()))),
            ("depth", input.depth.map(|plane| Pixels::F32(plane.view()))),
            ("confidence", input.confidence.map(|plane| Pixels::F32(plane.view()))),
            ("mask", input.mask.map(|plane| Pixels::Gray8(plane.view()))),
        ];
        let count = planes.iter().filter(|(_, plane)| plane.is_some()).count();
        if count == 0 || !self.pattern.is_due(params.every) || params.limit > 0 && self.ticks >= params.limit {
            return Ok(());
        }
        self.ticks += 1;
        for (port, pixels) in planes {
            let Some(pixels) = pixels else { continue };
            let path = self.pattern.file(cx.tick().seq, port, count > 1);
            if let Some(help) = self.format.refuses(&pixels) {
                let what = format!("{} pixels of input `{port}`", pixels.name());
                return Err(SinkError::Unfit { path, what, help }.into());
            }
            make_folder(&path)?;
            self.files.write(&path, |file| {
                array::write(file, self.format, &pixels).map_err(|error| SinkError::io(&path, error))
            })?;
            if self.format == ArrayFormat::Bare && !self.bare_reported {
                self.bare_reported = true;
                let (width, height) = pixels.size();
                cx.info(&format!("{} contains {width}x{height} {} without a header", path.display(), pixels.name()));
            }
        }
        cx.metric("ticks", self.ticks as f64);
        Ok(())
    }

    fn finish(&mut self, _: &Finish<'_>) -> Result<()> {
        Ok(self.files.finish()?)
    }
}
