//! `screen`: one large picture and smaller ones beside it, as a surgeon looks at them (thesis, chapter 6).

use panoscope_imaging::draw;
use panoscope_node::{
    AnyImage, Bgr8, Context, List, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Slot, ViewMut,
};

use crate::fit::{Fit, bytes, fitted_size};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// The large picture: bgr8, gray8 or rgba8.
    pub main: AnyImage<'f>,
    /// Smaller pictures, shown one below the other.
    pub side: Option<List<'f, AnyImage<'f>>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// The whole screen, always of the same size.
    pub image: Slot<'f, Bgr8>,
}

/// Parameters.
#[derive(Params)]
pub struct Settings {
    /// Width of the screen.
    #[param(default = 1280, range = 64..=7680, unit = "px")]
    pub width: usize,
    /// Height of the screen.
    #[param(default = 720, range = 64..=4320, unit = "px")]
    pub height: usize,
    /// Width of the smaller pictures, as a share of the screen's width.
    #[param(default = 0.28, range = 0.1..=0.5, step = 0.01, unit = "ratio")]
    pub side_share: f32,
    /// Margin around pictures.
    #[param(default = 8, range = 0..=64, unit = "px")]
    pub gap_px: usize,
    /// Titles separated by semicolons, the large picture's first.
    #[param(default = "")]
    pub titles: String,
    /// Size of the titles: capital letters are six times as many px high.
    #[param(default = 2.0, range = 0.5..=20.0, step = 0.5)]
    pub text_scale: f32,
}

/// A place on the screen, px.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cell {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

impl Settings {
    fn main_cell(&self, side: usize) -> Cell {
        let gap = self.gap_px;
        let used = if side == 0 { 2 * gap } else { self.side_width() + 3 * gap };
        Cell { x: gap, y: gap, width: self.width.saturating_sub(used), height: self.height.saturating_sub(2 * gap) }
    }

    fn side_width(&self) -> usize {
        (self.width as f32 * self.side_share) as usize
    }

    fn side_cell(&self, index: usize, count: usize) -> Cell {
        let (gap, width) = (self.gap_px, self.side_width());
        let height = self.height.saturating_sub(gap) / count;
        Cell {
            x: self.width.saturating_sub(width + gap),
            y: gap + index * height,
            width,
            height: height.saturating_sub(gap),
        }
    }
}

const BACKGROUND: u8 = 16;

/// Composes the screen. A smaller picture that has not arrived leaves its cell dark.
#[derive(Default)]
pub struct Screen {
    fit: Fit,
}

/// Draws a picture in the middle of its cell; returns the rectangle that it covers.
fn show(
    fit: &mut Fit,
    screen: &mut ViewMut<'_, u8>,
    picture: &AnyImage<'_>,
    cell: Cell,
    name: std::fmt::Arguments<'_>,
) -> Result<Cell> {
    let Some(pixels) = bytes(picture) else {
        return Err(NodeError::new(format!("{name} holds no 8-bit picture: put a `colorize` node in front")));
    };
    let size = fitted_size((pixels.width, pixels.height), (cell.width, cell.height));
    let (x, y) = (cell.x + (cell.width - size.0) / 2, cell.y + (cell.height - size.1) / 2);
    fit.place(screen, &pixels, (x, y), size);
    Ok(Cell { x, y, width: size.0, height: size.1 })
}

impl Node for Screen {
    const INFO: NodeInfo =
        NodeInfo::compute("screen", "overlay", "Puts one large picture and smaller ones beside it on a screen.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn open(_: &Open<'_>, _: &Settings) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Settings) -> Result<()> {
        let count = input.side.as_ref().map_or(0, List::len);
        let mut screen = out.image.alloc(params.width, params.height)?;
        (0..params.height).for_each(|y| screen.row_mut(y).fill(BACKGROUND));
        let mut titles = params.titles.split(';').map(str::trim);
        let mut title = |screen: &mut ViewMut<'_, u8>, cell: Cell| {
            if let Some(words) = titles.next().filter(|t| !t.is_empty()) {
                // Upper right: words, insets and rulers of the pictures themselves stand elsewhere.
                let (width, _) = draw::text_size(words, params.text_scale);
                let x = (cell.x + cell.width) as f32 - width - 3.0 * params.text_scale;
                let y = cell.y as f32 + 2.0 * params.text_scale;
                draw::text(screen, x.max(0.0), y, words, params.text_scale, [255; 3]);
            }
        };
        let cell = params.main_cell(count);
        let shown = show(&mut self.fit, &mut screen, &input.main, cell, format_args!("`main`"))?;
        title(&mut screen, shown);
        for (index, picture) in input.side.iter().flat_map(List::iter).enumerate() {
            let cell = params.side_cell(index, count);
            let shown = match picture {
                Some(picture) => {
                    show(&mut self.fit, &mut screen, &picture, cell, format_args!("picture {index} of `side`"))?
                }
                None => cell,
            };
            title(&mut screen, shown);
        }
        Ok(())
    }
}
