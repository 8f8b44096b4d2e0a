//! Text below an image: plates on a dark bar, so that nothing is written on tissue.

use panoscope_imaging::ViewMut;
use panoscope_imaging::draw::{self, Color};

/// Height of a plate in units of the text scale: capitals, descenders and padding above and below.
const PLATE: f32 = 11.0;
/// Gap between and around plates, in units of the text scale.
const GAP: f32 = 1.5;
/// Padding between a plate's edge and its text, in units of the text scale.
const ROOM: f32 = 2.0;
/// Distance between two dots of a key, in units of the text scale.
const DOT_STEP: f32 = 4.0;
/// Maximum number of dots of a key: more cannot be distinguished at a glance.
pub const MAX_DOTS: usize = 6;

/// Sizes of the text relative to the given one, tried in this order until all plates fit.
const SIZES: [f32; 3] = [1.0, 0.85, 0.7];

/// Maximum growth of a bar's height.
const MAX_GROWTH: f32 = 8.0;

const GROUND: u8 = 16;
const PLATE_COLOR: Color = [44, 42, 40];
const INK: Color = [255; 3];

/// Links a plate to an object in the image: dots in a colour, which are also drawn at the object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// Colour of the object's marks.
    pub color: Color,
    /// Number of dots, 1 to [`MAX_DOTS`].
    pub dots: usize,
}

/// A plate: byte range of its text, and its key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Entry {
    start: usize,
    end: usize,
    key: Option<Key>,
}

/// The plates of one image. The memory is reused from image to image.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bar {
    title: String,
    words: String,
    entries: Vec<Entry>,
}

/// Height of a bar with `lines` lines of text, px.
pub fn height_px(lines: usize, scale: f32) -> usize {
    (scale * (lines as f32 * (PLATE + GAP) + GAP)).ceil() as usize
}

/// Lines and text scale of a bar that is at least `wanted_px` high: the text grows, up to twice its size, then the number of lines.
pub fn filling(lines: usize, scale: f32, wanted_px: f32) -> (usize, f32) {
    let units = |lines: usize| lines as f32 * (PLATE + GAP) + GAP;
    let growth = (wanted_px / (scale * units(lines))).clamp(1.0, MAX_GROWTH);
    let all = lines * (growth / 2.0).ceil() as usize;
    (all, scale.max(scale * growth * units(lines) / units(all)))
}

/// Calls `disc` with middle, radius, colour and opacity of the dots of a key, to the right of `(x, y)`, the centre of the first one.
pub fn dots(mut disc: impl FnMut((f32, f32), f32, Color, f32), (x, y): (f32, f32), key: Key, scale: f32) {
    for k in 0..key.dots.min(MAX_DOTS) {
        let x = x + k as f32 * DOT_STEP * scale;
        // A dark rim, for bright tissue.
        disc((x, y), 2.0 * scale, [0; 3], 0.8);
        disc((x, y), 1.4 * scale, key.color, 1.0);
    }
}

impl Bar {
    /// Empties the bar and sets its title, which comes first, without a plate. It may be empty.
    pub fn begin(&mut self, title: &str) {
        self.title.clear();
        self.title.push_str(title.trim());
        self.words.clear();
        self.entries.clear();
    }

    /// Adds a plate for each line of `words`; empty lines are left out. `key` belongs to the first line.
    pub fn add(&mut self, words: &str, key: Option<Key>) {
        let mut key = key;
        for line in words.lines().map(str::trim).filter(|line| !line.is_empty()) {
            let start = self.words.len();
            self.words.push_str(line);
            self.entries.push(Entry { start, end: self.words.len(), key: key.take() });
        }
    }

    /// The text of all plates, for tests and logs.
    pub fn plates(&self) -> impl Iterator<Item = (&str, Option<Key>)> {
        self.entries.iter().map(|entry| (&self.words[entry.start..entry.end], entry.key))
    }

    /// Draws the plates from the upper left on, line by line. A plate wider than the bar is broken at spaces. The text shrinks to 70 % until all
    /// plates fit; those without room are counted at the end of the last line.
    pub fn draw(&self, out: &mut ViewMut<'_, u8>, lines: usize, scale: f32) {
        (0..out.height).for_each(|y| out.row_mut(y).fill(GROUND));
        let pen = |size: f32| Pen {
            line: 0,
            start: 0.0,
            x: 0.0,
            line_scale: scale,
            scale: size * scale,
            lines,
            width: out.width as f32,
        };
        let fitting = SIZES.into_iter().find(|size| self.lay_out(&mut pen(*size), None));
        let mut pen = pen(fitting.unwrap_or(SIZES[SIZES.len() - 1]));
        self.lay_out(&mut pen, Some(out));
    }

    /// Places the plates, and draws them if there is a picture. Returns whether all have room.
    fn lay_out(&self, pen: &mut Pen, mut out: Option<&mut ViewMut<'_, u8>>) -> bool {
        pen.start = GAP * pen.scale;
        if !self.title.is_empty() {
            if let Some(out) = &mut out {
                draw::text(out, pen.start, pen.top() + 2.5 * pen.scale, &self.title, pen.scale, INK);
            }
            pen.start += draw::text_size(&self.title, pen.scale).0 + 2.0 * ROOM * pen.scale;
        }
        pen.x = pen.start;
        for (index, (words, key)) in self.plates().enumerate() {
            let left_out = self.entries.len() - index;
            match pen.place(out.as_deref_mut(), words, key, left_out - 1) {
                Placed::Whole => {}
                Placed::Cut if out.is_some() => {}
                Placed::Cut => return false,
                Placed::Nowhere => {
                    pen.count(out, left_out);
                    return false;
                }
            }
        }
        true
    }
}

/// What became of a plate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Placed {
    Whole,
    /// A part of it is beyond the edge.
    Cut,
    Nowhere,
}

/// Position of the next plate.
struct Pen {
    line: usize,
    /// Where lines begin, px.
    start: f32,
    x: f32,
    /// Scale of the lines' height, and of the text.
    line_scale: f32,
    scale: f32,
    lines: usize,
    width: f32,
}

impl Pen {
    fn key_px(&self, key: Option<Key>) -> f32 {
        key.map_or(0.0, |key| (key.dots.min(MAX_DOTS) as f32 * DOT_STEP + 1.0) * self.scale)
    }

    /// Width left in the current line, minus the width of the count of `more` plates in the last line.
    fn room(&self, more: usize) -> f32 {
        let is_last = self.line + 1 >= self.lines;
        let kept = if is_last && more > 0 { self.plate_px("+99", None) + GAP * self.scale } else { 0.0 };
        self.width - GAP * self.scale - self.x - kept
    }

    fn plate_px(&self, words: &str, key: Option<Key>) -> f32 {
        draw::text_size(words, self.scale).0 + self.key_px(key) + 2.0 * ROOM * self.scale
    }

    fn next_line(&mut self) -> bool {
        (self.line, self.x) = (self.line + 1, self.start);
        self.line < self.lines
    }

    /// Top of a plate in the current line, px.
    fn top(&self) -> f32 {
        let smaller = (self.line_scale - self.scale) * PLATE / 2.0;
        self.line_scale * (GAP + self.line as f32 * (PLATE + GAP)) + smaller
    }

    /// Places a plate, which `more` others follow.
    fn place(&mut self, mut out: Option<&mut ViewMut<'_, u8>>, words: &str, key: Option<Key>, more: usize) -> Placed {
        if self.line >= self.lines {
            return Placed::Nowhere;
        }
        if self.plate_px(words, key) <= self.room(more) {
            self.plate(out, words, key);
            return Placed::Whole;
        }
        if self.x > self.start {
            return if self.next_line() { self.place(out, words, key, more) } else { Placed::Nowhere };
        }
        // Wider than a line: as many words as fit, the rest below. A word without a space is cut by the edge.
        let fits = |end: &usize| self.plate_px(&words[..*end], key) <= self.room(more);
        match words.match_indices(' ').map(|(at, _)| at).take_while(fits).last() {
            Some(end) if self.line + 1 < self.lines => {
                self.plate(out.as_deref_mut(), &words[..end], key);
                self.next_line();
                self.place(out, words[end..].trim_start(), None, more)
            }
            // Better cut than missing: the beginning says what it is about.
            _ => {
                self.plate(out, words, key);
                Placed::Cut
            }
        }
    }

    fn plate(&mut self, out: Option<&mut ViewMut<'_, u8>>, words: &str, key: Option<Key>) {
        let s = self.scale;
        let (x, y) = (self.x, self.top());
        let width = self.plate_px(words, key);
        self.x += width + GAP * s;
        let Some(out) = out else { return };
        draw::fill_rectangle(out, x as i32, y as i32, width as i32, (PLATE * s) as i32, PLATE_COLOR, 1.0);
        if let Some(key) = key {
            let disc = |(x, y): (f32, f32), radius, color, alpha| draw::fill_circle(out, x, y, radius, color, alpha);
            dots(disc, (x + (ROOM + 1.5) * s, y + PLATE * s / 2.0), key, s);
        }
        draw::text(out, x + ROOM * s + self.key_px(key), y + 2.5 * s, words, s, INK);
    }

    /// Writes how many plates are left out.
    fn count(&mut self, out: Option<&mut ViewMut<'_, u8>>, left_out: usize) {
        self.line = self.lines.saturating_sub(1);
        let words = format!("+{left_out}");
        self.x = self.width - GAP * self.scale - self.plate_px(&words, None);
        self.plate(out, &words, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: Key = Key { color: [60, 170, 255], dots: 2 };

    fn drawn(bar: &Bar, width: usize, lines: usize, scale: f32) -> (Vec<u8>, usize) {
        let height = height_px(lines, scale);
        let mut data = vec![7; width * height * 3];
        bar.draw(&mut ViewMut::new(&mut data, width, height, 3), lines, scale);
        (data, height)
    }

    /// Rows of the bar that hold bright ink.
    fn inked_rows(data: &[u8], width: usize) -> Vec<usize> {
        let rows = data.chunks_exact(width * 3).enumerate();
        rows.filter(|(_, row)| row.as_chunks::<3>().0.iter().any(|p| p.iter().all(|v| *v > 200))).map(|r| r.0).collect()
    }

    #[test]
    fn plates_stand_beside_each_other_then_below() {
        let mut bar = Bar::default();
        bar.add("grasper 93 %", Some(KEY));
        bar.add("hook 71 %", None);
        let (data, _) = drawn(&bar, 480, 2, 2.0);
        assert!(inked_rows(&data, 480).iter().all(|y| *y < 26), "both in the first line");
        bar.add("the arm follows the tip at a distance of 66 mm", None);
        let (data, height) = drawn(&bar, 480, 2, 2.0);
        assert!(inked_rows(&data, 480).iter().any(|y| *y > 28) && height == 53, "{height}");
        assert!(data.as_chunks::<3>().0.contains(&KEY.color), "the key has its colour");
    }

    #[test]
    fn words_that_are_too_long_are_broken_and_what_is_too_much_is_counted() {
        let mut bar = Bar::default();
        bar.add("one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen", None);
        let (data, _) = drawn(&bar, 320, 3, 2.0);
        assert!(inked_rows(&data, 320).iter().any(|y| *y > 53), "it takes three lines");
        bar.begin("");
        (0..12).for_each(|k| bar.add(&format!("instrument {k}"), None));
        let (few, _) = drawn(&bar, 320, 1, 2.0);
        bar.begin("");
        (0..2).for_each(|k| bar.add(&format!("instrument {k}"), None));
        assert_ne!(few, drawn(&bar, 320, 1, 2.0).0, "the first is followed by a count");
        // One line for two plates: the first, and `+1`.
        let right = |data: &[u8]| data.chunks_exact(960).any(|row| row[900..].iter().any(|v| *v > 200));
        assert!(right(&few));
    }

    #[test]
    fn the_text_shrinks_before_a_plate_is_left_out() {
        let mut bar = Bar::default();
        (0..3).for_each(|k| bar.add(&format!("instrument {k}"), None));
        let pen = |size: f32, width: f32| {
            let mut pen = Pen { line: 0, start: 0.0, x: 0.0, line_scale: 2.0, scale: 2.0 * size, lines: 1, width };
            (bar.lay_out(&mut pen, None), pen.x)
        };
        let needed = pen(1.0, 1e6).1 + 1.0;
        assert!(pen(1.0, needed).0 && !pen(1.0, 0.8 * needed).0 && pen(0.7, 0.8 * needed).0);
        let rows = |share: f32| {
            inked_rows(&drawn(&bar, (share * needed) as usize + 1, 1, 2.0).0, (share * needed) as usize + 1)
        };
        let (full, small) = (rows(1.0), rows(0.75));
        assert!(small.len() < full.len() && small[0] > full[0], "{full:?} {small:?}");
    }

    #[test]
    fn a_bar_without_words_is_dark_and_lines_are_plates_of_their_own() {
        let mut bar = Bar::default();
        let (data, _) = drawn(&bar, 100, 1, 2.0);
        assert!(data.iter().all(|v| *v == GROUND));
        bar.add("a\n\n b \n", Some(KEY));
        assert_eq!(bar.plates().collect::<Vec<_>>(), [("a", Some(KEY)), ("b", None)]);
    }

    #[test]
    fn a_bar_fills_the_height_that_is_wanted() {
        assert_eq!(filling(1, 1.75, 10.0), (1, 1.75), "never smaller");
        for (wanted_px, lines) in [(40.0, 1), (80.0, 2), (120.0, 3)] {
            let (found, scale) = filling(1, 1.75, wanted_px);
            assert!(found == lines && (1.75..=3.5).contains(&scale), "{wanted_px}: {found} lines, scale {scale}");
            assert!(
                (height_px(found, scale) as f32 - wanted_px).abs() <= 1.0,
                "{wanted_px}: {}",
                height_px(found, scale)
            );
        }
    }

    #[test]
    fn a_title_stands_first_without_a_plate() {
        let mut bar = Bar::default();
        bar.begin("depth");
        let (data, _) = drawn(&bar, 200, 1, 2.0);
        assert!(!inked_rows(&data, 200).is_empty());
        assert!(!data.as_chunks::<3>().0.contains(&PLATE_COLOR));
        bar.add("12 mm", None);
        let (both, _) = drawn(&bar, 200, 1, 2.0);
        let first = |data: &[u8]| data.chunks_exact(600).flat_map(|row| row[..60].to_vec()).collect::<Vec<u8>>();
        assert_eq!(first(&data), first(&both), "the title stays where it is");
        assert!(both.as_chunks::<3>().0.contains(&PLATE_COLOR));
    }
}
