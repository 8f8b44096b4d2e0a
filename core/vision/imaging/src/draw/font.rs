//! The font of [`text`](super::text()): Roboto Medium, rasterized once per size and cached.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;
use std::sync::LazyLock;

use ab_glyph::{Font, FontRef, Glyph, GlyphId, PxScale, ScaleFont, point};

const BYTES: &[u8] = include_bytes!("../../fonts/Roboto-Medium.ttf");
/// Height of capitals as a share of the font's size from its lowest descender to its highest ascender.
const CAPITAL: f32 = 1456.0 / 2400.0;
/// Height of capitals, in units of the scale of text.
pub const CAPITAL_HEIGHT: f32 = 6.0;
/// From one line's base to the next one's, in units of the scale of text.
pub const LINE_HEIGHT: f32 = 10.0;
/// From the top of capitals to the lowest descender, in units of the scale of text.
pub const HEIGHT: f32 = 8.0;
/// Number of sub-pixel positions at which a letter is rasterized.
const PARTS: u32 = 4;
/// Sizes are rounded to this part of a scale of 1.
const SIZE_PARTS: f32 = 16.0;
/// Maximum number of cached letters per thread.
const KEPT: usize = 4096;

static FONT: LazyLock<Option<FontRef<'static>>> = LazyLock::new(|| FontRef::try_from_slice(BYTES).ok());

thread_local! {
    static DRAWN: RefCell<HashMap<Key, Rc<Letter>>> = RefCell::new(HashMap::new());
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Key {
    character: char,
    size: u32,
    part: u32,
}

/// Coverage of pixels, 0 to 255, row by row.
pub struct Letter {
    /// Position of the first pixel from the pen's pixel on the base line: right, down.
    pub at: [i32; 2],
    /// Width and height, px.
    pub size: [usize; 2],
    /// Coverage of the letter itself.
    pub ink: Vec<u8>,
    /// The letter made wider by the outline's width, ink included.
    pub outline: Vec<u8>,
}

fn rounded(scale: f32) -> u32 {
    (scale * SIZE_PARTS).round().clamp(1.0, 64.0 * SIZE_PARTS) as u32
}

fn pixels(size: u32) -> PxScale {
    PxScale::from(size as f32 / SIZE_PARTS * CAPITAL_HEIGHT / CAPITAL)
}

/// Whether the font has a glyph for every character of a text.
pub fn is_drawable(text: &str) -> bool {
    let Some(font) = FONT.as_ref() else { return false };
    text.chars().all(|character| character.is_whitespace() || glyph_of(font, character) != GlyphId(0))
}

/// From a letter's pen to the next one's, px.
pub fn advance(character: char, scale: f32) -> f32 {
    FONT.as_ref().map_or(0.0, |font| font.as_scaled(pixels(rounded(scale))).h_advance(glyph_of(font, character)))
}

fn glyph_of(font: &FontRef<'_>, character: char) -> GlyphId {
    font.glyph_id(character)
}

/// A letter whose pen stands `fraction` (0..1) right of a pixel's edge.
pub fn letter(character: char, scale: f32, fraction: f32) -> Rc<Letter> {
    let key = Key { character, size: rounded(scale), part: ((fraction * PARTS as f32) as u32).min(PARTS - 1) };
    DRAWN.with_borrow_mut(|drawn| {
        if drawn.len() >= KEPT && !drawn.contains_key(&key) {
            drawn.clear();
        }
        Rc::clone(drawn.entry(key).or_insert_with(|| Rc::new(draw(key))))
    })
}

/// Width of the outline, px.
pub fn outline_px(scale: f32) -> f32 {
    (0.75 * scale).clamp(1.2, 4.0)
}

fn draw(key: Key) -> Letter {
    let nothing = Letter { at: [0; 2], size: [0; 2], ink: Vec::new(), outline: Vec::new() };
    let Some(font) = FONT.as_ref() else { return nothing };
    let position = point((key.part as f32 + 0.5) / PARTS as f32, 0.0);
    let glyph = Glyph { id: glyph_of(font, key.character), scale: pixels(key.size), position };
    let Some(shape) = font.outline_glyph(glyph) else { return nothing };
    let bounds = shape.px_bounds();
    let radius = outline_px(key.size as f32 / SIZE_PARTS);
    let room = radius.ceil() as usize + 1;
    let (width, height) = (bounds.width() as usize + 2 * room, bounds.height() as usize + 2 * room);
    let mut ink = vec![0; width * height];
    shape.draw(|x, y, share| {
        if let Some(pixel) = ink.get_mut((y as usize + room) * width + x as usize + room) {
            *pixel = (share.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        }
    });
    let outline = widened(&ink, width, height, radius);
    Letter {
        at: [bounds.min.x as i32 - room as i32, bounds.min.y as i32 - room as i32],
        size: [width, height],
        ink,
        outline,
    }
}

/// Each pixel's largest neighbour within `radius`, its edge smooth.
fn widened(ink: &[u8], width: usize, height: usize, radius: f32) -> Vec<u8> {
    let reach = radius.ceil() as isize;
    let mut near = Vec::new();
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let share = (radius + 0.5 - ((dx * dx + dy * dy) as f32).sqrt()).clamp(0.0, 1.0);
            if share > 0.0 {
                near.push((dx, dy, (share * 256.0) as u32));
            }
        }
    }
    let mut out = vec![0; ink.len()];
    for (index, pixel) in out.iter_mut().enumerate() {
        let (x, y) = ((index % width) as isize, (index / width) as isize);
        let at = |dx: isize, dy: isize| {
            let (x, y) = (x + dx, y + dy);
            let is_inside = x >= 0 && y >= 0 && x < width as isize && y < height as isize;
            if is_inside { u32::from(ink[y as usize * width + x as usize]) } else { 0 }
        };
        *pixel = near.iter().map(|(dx, dy, share)| (at(*dx, *dy) * share) >> 8).max().unwrap_or(0) as u8;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_font_has_every_letter_that_is_written() {
        let font = FONT.as_ref().expect("the embedded font");
        let written = (' '..='~').chain("±µ°×·–…äöüßéèñçÅøŁ≤≥≈".chars());
        for character in written {
            assert_ne!(font.glyph_id(character).0, 0, "{character:?}");
        }
    }

    #[test]
    fn capitals_have_their_height_and_digits_one_width() {
        for scale in [1.0, 2.0, 5.0] {
            let rows = |letter: &Letter| {
                let [width, _] = letter.size;
                letter.ink.chunks(width).filter(|row| row.iter().any(|v| *v > 127)).count() as f32
            };
            let height = rows(&letter('H', scale, 0.0));
            assert!((height - CAPITAL_HEIGHT * scale).abs() <= 1.0, "{height} px at scale {scale}");
            let widths: Vec<f32> = ('0'..='9').map(|c| advance(c, scale)).collect();
            assert!(widths.iter().all(|w| (w - widths[0]).abs() < 1e-3), "numbers do not jump: {widths:?}");
        }
    }

    #[test]
    fn an_outline_contains_its_letter() {
        let a = letter('a', 2.0, 0.5);
        assert!(a.ink.iter().zip(&a.outline).all(|(ink, outline)| outline >= ink));
        assert!(a.outline.iter().filter(|v| **v > 127).count() > 2 * a.ink.iter().filter(|v| **v > 127).count());
        assert!(letter(' ', 2.0, 0.0).ink.is_empty());
    }
}
