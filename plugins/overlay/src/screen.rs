//! `screen`: one large image and smaller ones next to it, for a surgeon's monitor (thesis, chapter 6).

use std::time::Duration;

use panoscope_imaging::composition::{Cell, Composition, Frame, Size, Tile};
use panoscope_imaging::draw;
use panoscope_imaging::fit::Fit;
use panoscope_node::device::{Device, OnDevice};
use panoscope_node::{
    AnyImage, Bgr8, Context, Image, List, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Slot, ViewMut,
};

use crate::fit::{bytes, bytes_size, fitted_size};
use crate::gpu::fit::SmallImages;

/// Input ports of `screen`.
#[derive(Ports)]
pub struct In<'f> {
    /// The large image: bgr8, gray8 or rgba8.
    pub main: AnyImage<'f>,
    /// Smaller images, next to the large one and below it.
    pub side: Option<List<'f, AnyImage<'f>>>,
}

/// Output ports of `screen`.
#[derive(Ports)]
pub struct Out<'f> {
    /// The complete screen, always of the same size.
    pub image: Slot<'f, Bgr8>,
}

/// Parameters of `screen`.
#[derive(Params)]
pub struct Settings {
    /// Width of the screen.
    #[param(default = 1280, range = 64..=7680, unit = "px")]
    pub width: usize,
    /// Height of the screen.
    #[param(default = 720, range = 64..=4320, unit = "px")]
    pub height: usize,
    /// Width of a column with all smaller images, as a share of the screen's width. 0 finds the arrangement that fills the screen: a column next to
    /// the large image, a row below it, or both.
    #[param(default = 0.0, range = 0.0..=0.5, step = 0.01, unit = "ratio")]
    pub side_share: f32,
    /// Margin around images on a screen 720 px high; it grows with the screen.
    #[param(default = 4, range = 0..=64, unit = "px")]
    pub gap_px: usize,
    /// Titles separated by semicolons, the large image's first. Each is in a strip below its image; an image without a title has no strip.
    #[param(default = "")]
    pub titles: String,
    /// Scale of the titles on a screen 720 px high, with which it grows: capital letters are six times as many px high.
    #[param(default = 2.0, range = 0.5..=20.0, step = 0.5)]
    pub text_scale: f32,
    /// Age of its light from which an image is dimmed and framed, with its age in the middle. 0 shows every image as it is.
    #[param(default = 1000, range = 0..=60000, unit = "ms")]
    pub max_age_ms: u64,
    /// What brings images to the size of their places. A GPU does it with bgr8 images that were made there and are larger than their places: only the
    /// small images are read. All other images are placed by the processor, which does everything without a GPU, with a warning.
    #[param(default = "cpu")]
    pub device: Device,
}

/// Remaining brightness of an image that is too old, of 256.
const DIMMED: u16 = 90;
/// Colour of the frame and age of an image that is too old: amber.
const STALE: [u8; 3] = [40, 180, 255];
const BACKGROUND: u8 = 16;
/// Height of a screen at which margins and titles have the size of the parameters.
const USUAL_HEIGHT: f32 = 720.0;
/// Height of the strip for a title, in units of the text scale: letters, descenders and their outline.
const STRIP: f32 = 12.0;
/// Top of the title in its strip, in the same units.
const TITLE_TOP: f32 = 2.5;

/// Composes the screen. A smaller image that has not arrived leaves its cell dark.
#[derive(Default)]
pub struct Screen {
    fit: Fit,
    composition: Composition,
    /// The area that each image covers.
    shown: Vec<Cell>,
    on_device: OnDevice<SmallImages>,
}

impl Screen {
    /// Arranges the images again when the screen or their proportions have changed.
    fn arrange(&mut self, params: &Settings, input: &In<'_>) {
        let frame = Frame {
            width: params.width,
            height: params.height,
            gap: (params.gap_px as f32 * grown(params)).round() as usize,
            side_share: params.side_share,
        };
        let titles = titles(params).chain(std::iter::repeat(""));
        let images = std::iter::once(Some(input.main)).chain(input.side.iter().flat_map(List::iter)).zip(titles);
        let tiles = images.map(|(image, title)| {
            let caption = if title.is_empty() { 0 } else { (STRIP * text_scale(params)).ceil() as usize };
            (image.as_ref().and_then(bytes_size), caption)
        });
        self.composition.update(frame, tiles);
    }
}

/// Scale of margins and text relative to a screen of the usual height.
fn grown(params: &Settings) -> f32 {
    params.height as f32 / USUAL_HEIGHT
}

fn text_scale(params: &Settings) -> f32 {
    params.text_scale * grown(params)
}

fn titles(params: &Settings) -> impl Iterator<Item = &str> {
    params.titles.split(';').map(str::trim)
}

/// Position of an image of this size: in the middle of its cell, above the strip of `caption` px.
fn place(size: Size, cell: Cell, caption: usize) -> Cell {
    let height = cell.height.saturating_sub(caption);
    let (width, shown_height) = fitted_size(size, (cell.width, height));
    let x = cell.x + cell.width.saturating_sub(width) / 2;
    Cell { x, y: cell.y + height.saturating_sub(shown_height) / 2, width, height: shown_height }
}

/// An image that the GPU brings to the size of its place, so that it need not be read whole.
fn shrunk_on_device<'f>(image: &AnyImage<'f>, shown: &Cell) -> Option<Image<'f, Bgr8>> {
    let (width, height) = (image.width(), image.height());
    let shrinks = shown.width <= width && shown.height <= height && (shown.width, shown.height) != (width, height);
    image.as_plane::<Bgr8>().filter(|image| shrinks && image.is_from_device())
}

/// Fills the area that no image covers.
fn fill_around(screen: &mut ViewMut<'_, u8>, pictures: &[Cell]) {
    let width = screen.width;
    for y in 0..screen.height {
        let row = screen.row_mut(y);
        let mut x = 0;
        loop {
            // The next picture of this row that begins or goes on at `x` or to its right.
            let beside =
                pictures.iter().filter(|cell| (cell.y..cell.y + cell.height).contains(&y) && cell.x + cell.width > x);
            let Some(next) = beside.min_by_key(|cell| cell.x) else { break };
            row[3 * x..3 * next.x.clamp(x, width)].fill(BACKGROUND);
            x = (next.x + next.width).min(width);
            if x == width {
                break;
            }
        }
        row[3 * x..].fill(BACKGROUND);
    }
}

/// Dims an image, frames it and writes the age of its light in its middle.
fn mark_stale(screen: &mut ViewMut<'_, u8>, cell: Cell, age: Duration, scale: f32) {
    for y in cell.y..cell.y + cell.height {
        for value in &mut screen.row_mut(y)[3 * cell.x..3 * (cell.x + cell.width)] {
            *value = ((u16::from(*value) * DIMMED) >> 8) as u8;
        }
    }
    let [x, y, width, height] = [cell.x, cell.y, cell.width, cell.height].map(|v| v as f32);
    let thickness = scale.max(2.0);
    draw::rectangle(screen, x + 1.0, y + 1.0, width - 2.0, height - 2.0, thickness, STALE);
    let text = match age {
        Duration::MAX => "not live".to_owned(),
        _ => format!("{:.1} s old", age.as_secs_f64()),
    };
    let (text_width, text_height) = draw::text_size(&text, scale);
    draw::text(screen, x + (width - text_width) / 2.0, y + (height - text_height) / 2.0, &text, scale, STALE);
}

impl Node for Screen {
    const INFO: NodeInfo =
        NodeInfo::compute("screen", "overlay", "Puts one large image and smaller ones next to it on a screen.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let mut screen = Self::default();
        screen.on_device.choose(params.device, open, SmallImages::new);
        Ok(screen)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Settings) -> Result<()> {
        self.on_device.choose(params.device, cx, SmallImages::new);
        self.arrange(params, &input);
        let (cells, tiles) = (self.composition.cells(), self.composition.tiles());
        let pictures = || std::iter::once(Some(input.main)).chain(input.side.iter().flat_map(List::iter));
        self.shown.clear();
        for (index, ((picture, cell), tile)) in pictures().zip(cells).zip(tiles).enumerate() {
            let Some(picture) = picture else {
                self.shown.push(Cell { height: 0, ..*cell });
                continue;
            };
            let Some(size) = bytes_size(&picture) else {
                let name = if index == 0 { "`main`".to_owned() } else { format!("image {} of `side`", index - 1) };
                return Err(NodeError::new(format!("{name} is not an 8-bit image: put a `colorize` node in front")));
            };
            self.shown.push(place(size, *cell, tile.caption));
        }
        let area = |cell: &Cell| (cell.width * cell.height) as f64;
        let whole = (params.width * params.height) as f64;
        cx.metric("main_pct", 100.0 * self.shown.first().map_or(0.0, area) / whole);
        let titled = |(cell, tile): (&Cell, &Tile)| (cell.width * tile.caption) as f64;
        let used = self.shown.iter().map(area).sum::<f64>() + cells.iter().zip(tiles).map(titled).sum::<f64>();
        cx.metric("dead_pct", 100.0 - 100.0 * used / whole);
        let mut screen = out.image.alloc(params.width, params.height)?;
        fill_around(&mut screen, &self.shown);
        let large = pictures().zip(&self.shown).enumerate().filter_map(|(number, (picture, shown))| {
            Some((number, shrunk_on_device(&picture?, shown)?, (shown.width, shown.height)))
        });
        self.on_device.attempt(cx, |small| small.make(large))?;
        for (number, (picture, shown)) in pictures().zip(&self.shown).enumerate() {
            let small = self.on_device.get().and_then(|small| small.get(number));
            if let Some(pixels) = small.or_else(|| picture.as_ref().and_then(bytes)) {
                self.fit.place(&mut screen, &pixels, (shown.x, shown.y), (shown.width, shown.height));
            }
        }
        for (picture, shown) in pictures().zip(&self.shown) {
            let Some(age) = picture.as_ref().map(|picture| cx.age(picture)) else { continue };
            if params.max_age_ms > 0 && age.as_millis() > u128::from(params.max_age_ms) {
                mark_stale(&mut screen, *shown, age, 1.5 * text_scale(params));
            }
        }
        // Right below the pictures, so that no word lies on one.
        let scale = text_scale(params);
        let titled = |((_, cell), tile): &((&str, &Cell), &Tile)| (1..=cell.height).contains(&tile.caption);
        for ((words, cell), tile) in titles(params).zip(cells).zip(tiles).filter(titled) {
            let y = (cell.y + cell.height).saturating_sub(tile.caption) as f32;
            draw::text(&mut screen, cell.x as f32 + scale, y + TITLE_TOP * scale, words, scale, [255; 3]);
        }
        Ok(())
    }
}
