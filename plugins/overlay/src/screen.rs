//! `screen`: one large picture and smaller ones beside it, as a surgeon looks at them (thesis, chapter 6).

use panoscope_imaging::draw;
use panoscope_node::{
    AnyImage, Bgr8, Context, List, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Slot, ViewMut,
};

use crate::fit::{Fit, bytes, fitted_size};
use crate::layout::{self, Cell, Frame, Size};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// The large picture: bgr8, gray8 or rgba8.
    pub main: AnyImage<'f>,
    /// Smaller pictures, beside the large one and below it.
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
    /// Width of a column with all smaller pictures, as a share of the screen's width. 0 finds the arrangement that fills the screen: a column
    /// beside the large picture, a row below it, or both.
    #[param(default = 0.0, range = 0.0..=0.5, step = 0.01, unit = "ratio")]
    pub side_share: f32,
    /// Margin around pictures.
    #[param(default = 8, range = 0..=64, unit = "px")]
    pub gap_px: usize,
    /// Titles separated by semicolons, the large picture's first. Each stands in a strip above its picture; without titles there are no strips.
    #[param(default = "")]
    pub titles: String,
    /// Size of the titles: capital letters are six times as many px high.
    #[param(default = 2.0, range = 0.5..=20.0, step = 0.5)]
    pub text_scale: f32,
}

const BACKGROUND: u8 = 16;
/// Height of the strip for a title, in units of the scale of text: letters, descenders and their outline.
const STRIP: f32 = 12.0;

/// Proportions of a smaller picture that has not arrived.
const USUAL: Size = (4, 3);
/// A picture whose proportions change less does not move the others.
const LEAST_CHANGE: f64 = 0.03;

/// Composes the screen. A smaller picture that has not arrived leaves its cell dark.
#[derive(Default)]
pub struct Screen {
    fit: Fit,
    /// Frame and proportions for which `cells` were arranged.
    arranged: Option<(Frame, Vec<Size>)>,
    cells: Vec<Cell>,
}

impl Screen {
    /// Arranges the cells anew when frame or pictures have changed.
    fn arrange(&mut self, params: &Settings, input: &In<'_>) {
        let frame = Frame {
            width: params.width,
            height: params.height,
            gap: params.gap_px,
            caption: caption_px(params),
            side_share: params.side_share,
        };
        let sides = input.side.as_ref().map_or(0, List::len);
        let held = self.arranged.take().filter(|(old, sizes)| *old == frame && sizes.len() == sides + 1);
        let (is_new, mut sizes) = match held {
            Some((_, sizes)) => (false, sizes),
            None => (true, vec![USUAL; sides + 1]),
        };
        let mut has_changed = is_new;
        let pictures = std::iter::once(Some(input.main)).chain(input.side.iter().flat_map(List::iter));
        for (size, picture) in sizes.iter_mut().zip(pictures) {
            let Some(new) = picture.as_ref().and_then(bytes).map(|pixels| (pixels.width, pixels.height)) else {
                continue;
            };
            let ratio = (new.0 * size.1) as f64 / (new.1 * size.0).max(1) as f64;
            if (ratio - 1.0).abs() > LEAST_CHANGE {
                (*size, has_changed) = (new, true);
            }
        }
        if has_changed && let Some((main, others)) = sizes.split_first() {
            layout::arrange(&frame, *main, others, &mut self.cells);
        }
        self.arranged = Some((frame, sizes));
    }
}

/// Height of the strips for titles, px.
fn caption_px(params: &Settings) -> usize {
    let has_title = params.titles.split(';').any(|title| !title.trim().is_empty());
    if has_title { (STRIP * params.text_scale).ceil() as usize } else { 0 }
}

/// Draws a picture in the middle of its cell, below the strip of `caption` px; returns the rectangle that it covers.
fn show(
    fit: &mut Fit,
    screen: &mut ViewMut<'_, u8>,
    picture: &AnyImage<'_>,
    cell: Cell,
    caption: usize,
    name: std::fmt::Arguments<'_>,
) -> Result<Cell> {
    let Some(pixels) = bytes(picture) else {
        return Err(NodeError::new(format!("{name} holds no 8-bit picture: put a `colorize` node in front")));
    };
    let (top, height) = (cell.y + caption.min(cell.height), cell.height.saturating_sub(caption));
    let size = fitted_size((pixels.width, pixels.height), (cell.width, height));
    let (x, y) = (cell.x + cell.width.saturating_sub(size.0) / 2, top + height.saturating_sub(size.1) / 2);
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
        self.arrange(params, &input);
        let mut screen = out.image.alloc(params.width, params.height)?;
        (0..params.height).for_each(|y| screen.row_mut(y).fill(BACKGROUND));
        let caption = caption_px(params);
        let mut titles = params.titles.split(';').map(str::trim);
        // Right above the picture, so that no word lies on it.
        let mut title = |screen: &mut ViewMut<'_, u8>, shown: Cell| {
            if let Some(words) = titles.next().filter(|t| !t.is_empty()) {
                let (x, y) = (shown.x as f32 + params.text_scale, shown.y as f32 - (STRIP - 2.0) * params.text_scale);
                draw::text(screen, x, y, words, params.text_scale, [255; 3]);
            }
        };
        let mut cells = self.cells.iter().copied();
        let cell = cells.next().unwrap_or_default();
        let shown = show(&mut self.fit, &mut screen, &input.main, cell, caption, format_args!("`main`"))?;
        title(&mut screen, shown);
        for ((index, picture), cell) in input.side.iter().flat_map(List::iter).enumerate().zip(cells) {
            let shown = match picture {
                Some(picture) => {
                    let name = format_args!("picture {index} of `side`");
                    show(&mut self.fit, &mut screen, &picture, cell, caption, name)?
                }
                None => Cell { y: cell.y + caption, ..cell },
            };
            title(&mut screen, shown);
        }
        Ok(())
    }
}
