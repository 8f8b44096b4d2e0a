//! `write_images`: images as PNG or JPEG files.

use std::path::PathBuf;

use panoscope_node::{
    AnyImage, Bgr8, Context, Finish, Image, Mask, NoPorts, Node, NodeError, NodeInfo, Open, Params, Ports, Result,
    Retained, Validation,
};

use crate::picture::pixels_of;
use crate::target::{Pattern, SinkError, Wholes, check_name, check_path, claim_files, make_folder};
use panoscope_data::formats::Pixels;
use panoscope_data::formats::still;

/// Input ports of `write_images`.
#[derive(Ports)]
pub struct In<'f> {
    /// Image to write: bgr8, gray8, rgba8 or gray16.
    pub image: Option<AnyImage<'f>>,
    /// Mask to write, black and white.
    pub mask: Option<Image<'f, Mask>>,
}

/// Parameters of `write_images`.
#[derive(Params)]
pub struct Settings {
    /// File to write, with the extension .png or .jpg. `{seq}` becomes the tick's number, six digits (`{seq:4}` four); without it every image
    /// replaces the previous one.
    #[param(default = "out/image.png", reopen, writes)]
    pub path: PathBuf,
    /// Every n-th image is written.
    #[param(default = 1, range = 1..=100000, unit = "frames")]
    pub every: u64,
    /// Stops writing after this many files; 0 never.
    #[param(default = 0, range = 0..=1000000000, unit = "frames")]
    pub limit: u64,
    /// Writes only the last bgr8 image, when the graph ends; `every` is then the number of ticks between the images considered.
    #[param(default = false)]
    pub at_end: bool,
    /// Quality of JPEG files.
    #[param(default = 92, range = 1..=100, unit = "%")]
    pub jpeg_quality: u8,
}

/// Writes still images.
pub struct WriteImages {
    pattern: Pattern,
    ending: String,
    work: Vec<u8>,
    written: Wholes,
    files: u64,
    last: Option<(Retained<Bgr8>, u64, u8)>,
}

impl WriteImages {
    fn write(&mut self, pixels: &Pixels<'_>, seq: u64, port: &str, both: bool, quality: u8) -> Result<(), SinkError> {
        let path = self.pattern.file(seq, port, both);
        let unfit = |help| SinkError::Unfit { path: path.clone(), what: format!("a {} image", pixels.name()), help };
        match pixels {
            Pixels::F32(_) => return Err(unfit("put a `colorize` node in front, or use `write_raw` for the numbers")),
            Pixels::Gray16(_) if self.ending != "png" => return Err(unfit("use .png, which holds 16 bits")),
            _ => {}
        }
        make_folder(&path)?;
        let (ending, work) = (self.ending.as_str(), &mut self.work);
        self.written.write(&path, |file| {
            still::encode(file, ending, pixels, quality, work).map_err(|error| match error {
                image::ImageError::IoError(source) => SinkError::io(&path, source),
                other => SinkError::Encode { path: path.clone(), reason: other.to_string() },
            })
        })?;
        self.files += 1;
        Ok(())
    }
}

impl WriteImages {
    /// Writes the image that was kept for the end.
    fn write_last(&mut self) -> Result<(), SinkError> {
        match self.last.take() {
            Some((kept, seq, quality)) => self.write(&Pixels::Bgr8(kept.view()), seq, "image", false, quality),
            None => Ok(()),
        }
    }
}

impl Node for WriteImages {
    const INFO: NodeInfo =
        NodeInfo::blocking("write_images", "sink", "Writes images as PNG or JPEG files.").side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        check_path(check, &params.path, "{seq}.png", still::ENDINGS);
        if params.at_end && check.is_connected("image") == Some(false) {
            check.error("at_end", "`at_end` needs input `image`, which is not connected", "connect `image`");
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let ending = check_name(&params.path, "{seq}.png", still::ENDINGS)?;
        let pattern = Pattern::new(&claim_files(open, &params.path)?);
        Ok(Self { pattern, ending, work: Vec::new(), written: Wholes::default(), files: 0, last: None })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, params: &Settings) -> Result<()> {
        if input.image.is_none() && input.mask.is_none() || !self.pattern.is_due(params.every) {
            return Ok(());
        }
        let seq = cx.tick().seq;
        if params.at_end {
            let image = input.image.as_ref().and_then(|image| image.as_plane::<Bgr8>());
            let Some(image) = image else {
                return Err(NodeError::new("`at_end` needs a bgr8 image at input `image`"));
            };
            self.last = Some((image.retain(), seq, params.jpeg_quality));
            return Ok(());
        }
        if params.limit > 0 && self.files >= params.limit {
            return Ok(());
        }
        let both = input.image.is_some() && input.mask.is_some();
        if let Some(image) = &input.image {
            let pixels = pixels_of(image).ok_or_else(|| NodeError::new("the image has an unknown pixel format"))?;
            self.write(&pixels, seq, "image", both, params.jpeg_quality)?;
        }
        if let Some(mask) = &input.mask {
            self.write(&Pixels::Gray8(mask.view()), seq, "mask", both, params.jpeg_quality)?;
        }
        cx.metric("files", self.files as f64);
        Ok(())
    }

    fn finish(&mut self, _: &Finish<'_>) -> Result<()> {
        self.write_last()?;
        Ok(self.written.finish()?)
    }
}

impl Drop for WriteImages {
    fn drop(&mut self) {
        if let Err(error) = self.write_last() {
            // `finish` was not called, and no running call can report the error.
            eprintln!("panoscope: write_images: {error}");
        }
    }
}
