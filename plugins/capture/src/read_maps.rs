//! `read_maps`: true disparity or depth from files, in step with the images that they belong to.

use panoscope_data::truth::maps;
use panoscope_imaging::stereo::FloatImage;
use panoscope_node::{
    AnyImage, Choice, Context, Depth, Disparity, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Slot, error,
};

use crate::series::Series;

/// What the files hold.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holds {
    /// Disparity in px of the left rectified view.
    Disparity,
    /// Depth along the left rectified camera's axis, mm.
    Depth,
}

/// Input ports of `read_maps`.
#[derive(Ports)]
pub struct In<'f> {
    /// Image of the source, such as `left` of `capture`. The map with its number is read, and must have its size.
    image: AnyImage<'f>,
}

/// Outputs. Empty after the last file.
#[derive(Ports)]
pub struct Out<'f> {
    /// Disparity of the image, if `holds` is `disparity`; NaN where the file has 0, a negative number or none.
    disparity: Slot<'f, Disparity>,
    /// Depth of the image, if `holds` is `depth`; NaN where the file has 0, a negative number or none.
    depth: Slot<'f, Depth>,
}

/// Parameters of `read_maps`.
#[derive(Params)]
pub struct ReadMapsParams {
    /// Folder, pattern (truth/*.pfm or truth/%04d.png) or file: NPY, PFM, TIFF, EXR or PNG; a single file belongs to every image. Of TIFF files with three floats the third one is taken; SCARED's x, y, z are of the raw left
    /// camera, so that z fits no rectified view: `data_set` moves them there.
    #[param(default = "", reopen, file)]
    path: String,
    /// Folder or pattern of the images, as in the source. With it, maps are matched to images by name, else by number, and an image without a map has
    /// no ground truth. Without it, the n-th map by number belongs to the n-th image, and no number may be missing.
    #[param(default = "", reopen, file)]
    pictures: String,
    /// What the files hold.
    #[param(default = "disparity", reopen)]
    holds: Holds,
    /// Divisor that converts the numbers in the files to px or mm. 0: 256 for disparity in 16-bit PNG files, as KITTI writes it, and 1 for everything
    /// else.
    #[param(default = 0.0, range = 0.0..=1000000.0)]
    divisor: f32,
    /// Repeats the files from the first one, as `loop` of `capture`.
    #[param(default = false)]
    r#loop: bool,
}

/// The `read_maps` node.
pub struct ReadMaps {
    series: Series,
    /// The map that was read last, with its index and divisor.
    known: Option<(usize, f32, FloatImage)>,
}

impl Node for ReadMaps {
    const INFO: NodeInfo = NodeInfo::blocking(
        "read_maps",
        "source",
        "Reads true disparity or depth from files (NPY, PFM, TIFF, EXR, PNG), one map for each image.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ReadMapsParams;

    fn open(open: &Open<'_>, params: &ReadMapsParams) -> Result<Self> {
        let is_map = |path: &std::path::Path| {
            let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
            maps::ENDINGS.contains(&ending.as_str())
        };
        let series = Series::open((&params.path, &params.pictures), open.graph_dir(), "map", is_map);
        Ok(Self { series: series.map_err(|error| NodeError::new(error.to_string()))?, known: None })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &ReadMapsParams,
    ) -> Result<()> {
        let Some((index, Some(file))) = self.series.of_tick(cx, params.r#loop) else { return Ok(()) };
        let given = params.divisor;
        if self.known.as_ref().is_none_or(|(known, divisor, _)| (*known, *divisor) != (index, given)) {
            self.known = None;
            let map = maps::read(file).map_err(|error| NodeError::new(error.to_string()))?;
            let usual = if params.holds == Holds::Disparity { map.disparity_divisor() } else { 1.0 };
            self.known = Some((index, given, map.divided(if given > 0.0 { given } else { usual })));
        }
        let Some((_, _, map)) = &self.known else { return Ok(()) };
        let (width, height) = (input.image.width(), input.image.height());
        if (map.width, map.height) != (width, height) {
            return Err(error!(
                "{} is {}x{}, but its image is {width}x{height}: give maps of the size of the images",
                file.display(),
                map.width,
                map.height
            ));
        }
        match params.holds {
            Holds::Disparity => {
                if out.disparity.is_read() {
                    out.disparity.alloc(map.width, map.height)?.data.copy_from_slice(&map.data);
                }
            }
            Holds::Depth => {
                if out.depth.is_read() {
                    out.depth.alloc(map.width, map.height)?.data.copy_from_slice(&map.data);
                }
            }
        }
        Ok(())
    }
}
