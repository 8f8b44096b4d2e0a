//! Shapes that are drawn on an image: listed first, so that where they are is known before a pixel is touched.

use std::ops::Range;

use panoscope_imaging::draw::{self, Color};
use panoscope_node::{Rect, ViewMut};

/// Columns and rows of a tile of [`Shapes::areas`].
const TILE: [usize; 2] = [64, 32];

/// A shape, px; see the functions of [`draw`].
#[derive(Clone, Debug)]
enum Shape {
    Line { ends: [(f32, f32); 2], line_px: f32, color: Color },
    Circle { at: (f32, f32), radius: f32, line_px: f32, color: Color },
    Disc { at: (f32, f32), radius: f32, color: Color, alpha: f32 },
    Plate { x: i32, y: i32, width: i32, height: i32, color: Color, alpha: f32 },
    Text { at: (f32, f32), words: Range<usize>, scale: f32, color: Color },
}

/// Shapes in the order in which they are drawn. The memory is reused from image to image.
#[derive(Clone, Debug, Default)]
pub struct Shapes {
    shapes: Vec<Shape>,
    words: String,
}

impl Shapes {
    /// Removes all shapes.
    pub fn clear(&mut self) {
        self.shapes.clear();
        self.words.clear();
    }

    /// Adds a line, see [`draw::line`].
    pub fn line(&mut self, from: (f32, f32), to: (f32, f32), line_px: f32, color: Color) {
        self.shapes.push(Shape::Line { ends: [from, to], line_px, color });
    }

    /// Adds a closed polyline, see [`draw::polygon`].
    pub fn polygon(&mut self, points: &[(f32, f32)], line_px: f32, color: Color) {
        draw::sides(points).for_each(|[from, to]| self.line(from, to, line_px, color));
    }

    /// Adds the outline of a rectangle, see [`draw::rectangle`].
    pub fn rectangle(&mut self, (x, y): (f32, f32), (width, height): (f32, f32), line_px: f32, color: Color) {
        self.polygon(&draw::corners(x, y, width, height), line_px, color);
    }

    /// Adds a circle's outline, see [`draw::circle`].
    pub fn circle(&mut self, at: (f32, f32), radius: f32, line_px: f32, color: Color) {
        self.shapes.push(Shape::Circle { at, radius, line_px, color });
    }

    /// Adds a filled circle, see [`draw::fill_circle`].
    pub fn disc(&mut self, at: (f32, f32), radius: f32, color: Color, alpha: f32) {
        self.shapes.push(Shape::Disc { at, radius, color, alpha });
    }

    /// Adds two crossing strokes, see [`draw::cross`].
    pub fn cross(&mut self, (x, y): (f32, f32), size_px: f32, line_px: f32, color: Color) {
        self.line((x - size_px, y), (x + size_px, y), line_px, color);
        self.line((x, y - size_px), (x, y + size_px), line_px, color);
    }

    /// Adds a filled square of whole pixels, see [`draw::fill_rectangle`].
    pub fn plate(&mut self, (x, y): (i32, i32), side: i32, color: Color, alpha: f32) {
        self.shapes.push(Shape::Plate { x, y, width: side, height: side, color, alpha });
    }

    /// Adds a text, see [`draw::text()`].
    pub fn text(&mut self, at: (f32, f32), words: &str, scale: f32, color: Color) {
        let start = self.words.len();
        self.words.push_str(words);
        self.shapes.push(Shape::Text { at, words: start..self.words.len(), scale, color });
    }

    /// Draws all shapes.
    pub fn draw(&self, out: &mut ViewMut<'_, u8>) {
        for shape in &self.shapes {
            match *shape {
                Shape::Line { ends: [from, to], line_px, color } => draw::line(out, from, to, line_px, color),
                Shape::Circle { at: (x, y), radius, line_px, color } => draw::circle(out, x, y, radius, line_px, color),
                Shape::Disc { at: (x, y), radius, color, alpha } => draw::fill_circle(out, x, y, radius, color, alpha),
                Shape::Plate { x, y, width, height, color, alpha } => {
                    draw::fill_rectangle(out, x, y, width, height, color, alpha);
                }
                Shape::Text { at: (x, y), ref words, scale, color } => {
                    draw::text(out, x, y, &self.words[words.clone()], scale, color);
                }
            }
        }
    }

    /// Columns and rows, from the first to the one after the last, that a shape changes at most. They may be beyond an image.
    fn bounds(&self, shape: &Shape) -> [Range<f32>; 2] {
        let around = |(x, y): (f32, f32), reach: f32| [x - reach..x + reach + 1.0, y - reach..y + reach + 1.0];
        match shape {
            Shape::Line { ends, line_px, .. } => {
                let reach = line_px + 3.0;
                [0, 1].map(|axis| {
                    let [a, b] = ends.map(|end| if axis == 0 { end.0 } else { end.1 });
                    a.min(b) - reach..a.max(b) + reach + 1.0
                })
            }
            Shape::Circle { at, radius, line_px, .. } => around(*at, radius + line_px + 3.0),
            Shape::Disc { at, radius, .. } => around(*at, radius + 3.0),
            Shape::Plate { x, y, width, height, .. } => {
                let range = |from: i32, length: i32| from as f32 - 1.0..from as f32 + length as f32 + 1.0;
                [range(*x, *width), range(*y, *height)]
            }
            Shape::Text { at, words, scale, .. } => {
                let (width, height) = draw::text_size(&self.words[words.clone()], *scale);
                // Outlines, and what letters have beyond their place.
                let room = 4.0 * scale + 4.0;
                [at.0 - room..at.0 + width + room, at.1 - room..at.1 + height + room]
            }
        }
    }

    /// Areas of an image that hold all that is drawn. They do not overlap; each begins at a column that is a multiple of four, and ends there or at the
    /// image's edge.
    pub fn areas(&self, (width, height): (usize, usize)) -> Vec<Rect> {
        let (columns, rows) = (width.div_ceil(TILE[0]), height.div_ceil(TILE[1]));
        let mut is_touched = vec![false; columns * rows];
        for shape in &self.shapes {
            let [x, y] = self.bounds(shape);
            // What is not finite is not drawn, and gives no range.
            let tiles = |range: Range<f32>, tile: usize, all: usize| {
                let first = (range.start.max(0.0) as usize / tile).min(all);
                let end = if range.end > 0.0 { (range.end as usize / tile + 1).min(all) } else { 0 };
                first..end
            };
            let (x, y) = (tiles(x, TILE[0], columns), tiles(y, TILE[1], rows));
            for row in y {
                is_touched[row * columns..][..columns][x.start.min(x.end)..x.end].fill(true);
            }
        }
        joined(&is_touched, columns)
            .into_iter()
            .map(|tiles| {
                let (x, y) = (tiles.x * TILE[0], tiles.y * TILE[1]);
                Rect::new(x, y, tiles.width * TILE[0], tiles.height * TILE[1]).clamped(width, height)
            })
            .collect()
    }
}

/// Rectangles that cover the marked tiles: runs of a row, continued where the next row has the same run.
fn joined(is_touched: &[bool], columns: usize) -> Vec<Rect> {
    let mut areas: Vec<Rect> = Vec::new();
    for (y, row) in is_touched.chunks_exact(columns.max(1)).enumerate() {
        let mut x = 0;
        for run in row.chunk_by(|a, b| a == b) {
            if run[0] {
                let same = |area: &&mut Rect| (area.x, area.width, area.y + area.height) == (x, run.len(), y);
                match areas.iter_mut().find(same) {
                    Some(area) => area.height += 1,
                    None => areas.push(Rect::new(x, y, run.len(), 1)),
                }
            }
            x += run.len();
        }
    }
    areas
}

#[cfg(test)]
mod tests {
    use panoscope_node::random;

    use super::*;

    const COLOR: Color = [255; 3];

    /// Tests that nothing outside the areas changes; returns the number of their pixels.
    fn check(shapes: &Shapes, (width, height): (usize, usize)) -> usize {
        let mut data = vec![7; 3 * width * height];
        shapes.draw(&mut ViewMut::new(&mut data, width, height, 3));
        let areas = shapes.areas((width, height));
        let is_in = |x: usize, y: usize| {
            areas.iter().filter(|a| (a.x..a.x + a.width).contains(&x) && (a.y..a.y + a.height).contains(&y)).count()
        };
        for at in 0..width * height {
            let (x, y) = (at % width, at / width);
            let (is_drawn, count) = (data[3 * at..3 * at + 3] != [7; 3], is_in(x, y));
            assert!(count <= 1 && (!is_drawn || count == 1), "{x}, {y}: {shapes:?}");
        }
        for area in &areas {
            let end = area.x + area.width;
            assert!(area.x % 4 == 0 && (end % 4 == 0 || end == width), "{area:?}");
        }
        areas.iter().map(Rect::area).sum()
    }

    #[test]
    fn areas_hold_all_that_is_drawn() {
        let mut drawn = 0;
        for size in [(301, 143), (64, 32), (63, 97), (3, 2)] {
            for _ in 0..60 {
                let mut next = |low: f32, high: f32| {
                    drawn += 1;
                    low + (high - low) * random::unit(drawn) as f32
                };
                let [a, b, c] = [0; 3].map(|_| (next(-80.0, 380.0), next(-80.0, 220.0)));
                let (radius, line_px, scale) = (next(0.0, 40.0), next(0.5, 12.0), next(0.5, 5.0));
                let mut shapes = Shapes::default();
                shapes.line(a, b, line_px, COLOR);
                check(&shapes, size);
                shapes.clear();
                shapes.circle(b, radius, line_px, COLOR);
                check(&shapes, size);
                shapes.clear();
                shapes.disc(c, radius, COLOR, 0.7);
                check(&shapes, size);
                shapes.clear();
                shapes.text(a, "Wg|jy\nÄ 12 mm", scale, COLOR);
                check(&shapes, size);
                shapes.plate((b.0 as i32, b.1 as i32), radius as i32, COLOR, 0.5);
                shapes.cross(c, radius, line_px, COLOR);
                shapes.rectangle(b, (radius, 2.0 * radius), line_px, COLOR);
                check(&shapes, size);
            }
        }
    }

    #[test]
    fn lines_have_small_areas_and_what_is_not_finite_has_none() {
        let mut shapes = Shapes::default();
        assert_eq!(check(&shapes, (1000, 800)), 0);
        for odd in [f32::NAN, f32::INFINITY, -f32::INFINITY] {
            shapes.circle((odd, 3.0), 9.0, 1.0, COLOR);
        }
        shapes.rectangle((100.0, 100.0), (700.0, 500.0), 2.0, COLOR);
        let area = check(&shapes, (1000, 800));
        assert!((1..1000 * 800 / 3).contains(&area), "{area}");
    }
}
