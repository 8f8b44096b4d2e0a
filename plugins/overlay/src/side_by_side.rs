//! `side_by_side`: combines several images into one.

use panoscope_imaging::draw;
use panoscope_imaging::fit::Fit;
use panoscope_node::{AnyImage, Bgr8, Context, List, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Slot};

use crate::fit::{bytes, fitted_size};

/// Input ports of `side_by_side`.
#[derive(Ports)]
pub struct In<'f> {
    /// Images, row after row: bgr8, gray8 or rgba8.
    pub views: List<'f, AnyImage<'f>>,
}

/// Output ports of `side_by_side`.
#[derive(Ports)]
pub struct Out<'f> {
    /// All images in a grid.
    pub image: Slot<'f, Bgr8>,
}

/// Parameters of `side_by_side`.
#[derive(Params)]
pub struct Settings {
    /// Images per row; 0 makes the grid about as wide as it is high.
    #[param(default = 0, range = 0..=64)]
    pub columns: usize,
    /// Width of a cell; 0 takes the first image's.
    #[param(default = 0, range = 0..=8192, unit = "px")]
    pub cell_width: usize,
    /// Height of a cell; 0 takes the first image's.
    #[param(default = 0, range = 0..=8192, unit = "px")]
    pub cell_height: usize,
    /// Gap between images.
    #[param(default = 4, range = 0..=256, unit = "px")]
    pub gap_px: usize,
    /// Titles in the order of the images, separated by semicolons. Each is in a strip below its image; without titles there are no strips.
    #[param(default = "")]
    pub titles: String,
    /// Scale of the titles: capital letters are six times as many px high.
    #[param(default = 2.0, range = 0.5..=20.0, step = 0.5)]
    pub text_scale: f32,
}

/// Height of the strip for a title, in units of the text scale: letters, descenders and their outline.
const STRIP: f32 = 12.0;

/// Composes images in a grid. An image that is missing in a tick leaves its cell dark.
#[derive(Default)]
pub struct SideBySide {
    cell: Option<(usize, usize)>,
    fit: Fit,
}

impl Node for SideBySide {
    const INFO: NodeInfo = NodeInfo::compute("side_by_side", "overlay", "Puts several images with titles into one.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn open(_: &Open<'_>, _: &Settings) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Settings) -> Result<()> {
        let count = input.views.len();
        let Some(first) = input.views.iter().flatten().next() else { return Ok(()) };
        // The grid keeps its size when pictures come and go.
        let own = *self.cell.get_or_insert((first.width(), first.height()));
        let cell = (
            if params.cell_width > 0 { params.cell_width } else { own.0 },
            if params.cell_height > 0 { params.cell_height } else { own.1 },
        );
        let columns = match params.columns {
            0 => (1..=count).find(|c| c * c >= count).unwrap_or(1),
            columns => columns.min(count),
        };
        let rows = count.div_ceil(columns);
        let gap = params.gap_px;
        let has_title = params.titles.split(';').any(|title| !title.trim().is_empty());
        let strip = if has_title { (STRIP * params.text_scale).ceil() as usize } else { 0 };
        let width = columns * cell.0 + (columns - 1) * gap;
        let height = rows * (cell.1 + strip) + (rows - 1) * gap;
        let mut picture = out.image.alloc(width, height)?;
        (0..height).for_each(|y| picture.row_mut(y).fill(24));
        let mut titles = params.titles.split(';');
        for (index, view) in input.views.iter().enumerate() {
            let (x, y) = (index % columns * (cell.0 + gap), index / columns * (cell.1 + strip + gap));
            if let Some(view) = view {
                let Some(pixels) = bytes(&view) else {
                    return Err(NodeError::new(format!(
                        "view {index} is not an 8-bit image: put a `colorize` node in front"
                    )));
                };
                let size = fitted_size((pixels.width, pixels.height), cell);
                let (left, top) = (x + (cell.0 - size.0) / 2, y + (cell.1 - size.1) / 2);
                self.fit.place(&mut picture, &pixels, (left, top), size);
            }
            if let Some(title) = titles.next().map(str::trim).filter(|t| !t.is_empty()) {
                let (x, y) = (x as f32 + params.text_scale, (y + cell.1) as f32 + 2.0 * params.text_scale);
                draw::text(&mut picture, x, y, title, params.text_scale, [255, 255, 255]);
            }
        }
        Ok(())
    }
}
