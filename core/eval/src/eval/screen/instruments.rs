//! Compares the shape of instruments in a panorama with that in its views.
//!
//! Works on rendered scenes: metal and plastic are gray there, tissue is red, so that outlines can be located by
//! colour, to fractions of a pixel. The outline of each instrument in the panorama is laid on those of either view by a
//! homography, which keeps straight edges straight, as the panorama places views by homographies; the remaining
//! difference is a bent, torn or missing piece. The homography is found by iterative closest points with distances across
//! the outline (Y. Chen, G. Medioni, "Object modelling by registration of multiple range images", 1992): with distances
//! between points a long shaft would hold the outline where it begins along itself.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// An image in blue, green, red without padding.
#[derive(Clone, Debug)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Three bytes per pixel.
    pub pixels: Vec<u8>,
}

/// Differences of a panorama's instruments from the views.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Comparison {
    /// For each instrument the 98 % quantile of the distance between its outline and that of the view that fits best,
    /// px.
    pub deviations_px: Vec<f64>,
    /// View that fits the largest instrument best: 0 left, 1 right.
    pub view: Option<usize>,
    /// Where the centre of the largest instrument is in each view minus where it is in the panorama, px; `None` for a view
    /// that does not show enough of it.
    pub offsets: [Option<Point>; 2],
}

type Point = [f64; 2];

/// Maximum (R - B) / R of a gray pixel: in the middle between metal in a view with a warm cast, 0.13, and pale tissue, 0.27,
/// so that a cast of one view moves no outline.
const MAX_REDNESS: f32 = 0.2;
/// Minimum red value for the division, because of noise in dark pixels.
const DARK: f32 = 36.0;
/// Maximum brightness; brighter pixels are reflections, on tissue or on an instrument.
const MAX_BRIGHTNESS: f32 = 225.0;
/// Minimum size of an instrument as a share of the image's pixels.
const MIN_AREA: f64 = 0.006;
/// Area below which a red patch inside an instrument is noise in its shade, px.
const MAX_NOISE: usize = 64;
/// Distance from an image's border below which outlines belong to the image, px.
const BORDER_PX: f64 = 5.0;
/// Maximum distance of corresponding outlines, px.
const REACH_PX: f64 = 16.0;
/// Length by which coordinates are divided before equations are solved, px.
const CONDITION_PX: f64 = 300.0;
/// Side of a cell in which points of an outline are looked up, px.
const CELL_PX: f64 = 4.0;
const ITERATIONS: usize = 25;
/// Share of an outline that must be inside a view for a comparison.
const MIN_INSIDE: f64 = 0.5;
const QUANTILE: f64 = 0.98;

/// Outlines of the instruments in an image.
struct Outlines {
    width: usize,
    height: usize,
    /// Of each instrument, the largest first.
    instruments: Vec<Vec<Point>>,
    cells: Vec<Vec<Point>>,
    columns: usize,
}

/// The point of outlines nearest to another one.
#[derive(Clone, Copy, Debug)]
struct Nearest {
    point: Point,
    /// Distance to the line through it and its neighbour, px.
    distance_px: f64,
}

/// Compares the instruments of a panorama with those of the left and the right view.
pub fn compare(panorama: &Image, views: [&Image; 2]) -> Comparison {
    let shown = Outlines::of(panorama);
    let views = views.map(Outlines::of);
    let mut found = Comparison::default();
    for outline in &shown.instruments {
        let fits = views.each_ref().map(|view| fit(outline, &shown, view));
        let of_views = fits.iter().enumerate().filter_map(|(view, fit)| Some((view, fit.as_ref()?.deviation_px)));
        let Some((view, deviation_px)) = of_views.min_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
        found.deviations_px.push(deviation_px);
        if found.view.is_none() {
            found.view = Some(view);
            found.offsets = fits.map(|fit| fit.map(|fit| fit.offset));
        }
    }
    found
}

impl Outlines {
    fn of(image: &Image) -> Self {
        let (width, height) = (image.width, image.height);
        let redness = redness(image);
        let mut labels = label(&redness, width, height);
        fill_noise(&mut labels, width, height);
        let count = labels.iter().copied().max().unwrap_or(0);
        let mut instruments = vec![Vec::new(); count];
        let mut cross = |a: usize, b: usize, step: Point| {
            // One of the two pixels is an instrument, the other is red. A reflection moves between the views, so it has no
            // outline.
            let (label, other) = match (labels[a], labels[b]) {
                (0, n) if n > 0 => (n, redness[a]),
                (n, 0) if n > 0 => (n, redness[b]),
                _ => return,
            };
            if other > MAX_REDNESS && other.is_finite() {
                let t = f64::from((MAX_REDNESS - redness[a]) / (redness[b] - redness[a]));
                let point = [(a % width) as f64 + t * step[0], (a / width) as f64 + t * step[1]];
                if is_inside(point, width, height) {
                    instruments[label - 1].push(point);
                }
            }
        };
        for at in 0..width * height {
            if at % width + 1 < width {
                cross(at, at + 1, [1.0, 0.0]);
            }
            if at / width + 1 < height {
                cross(at, at + width, [0.0, 1.0]);
            }
        }
        instruments.retain(|points| points.len() >= 16);
        instruments.sort_by_key(|points| std::cmp::Reverse(points.len()));
        let columns = (width as f64 / CELL_PX) as usize + 1;
        let mut cells = vec![Vec::new(); columns * ((height as f64 / CELL_PX) as usize + 1)];
        for point in instruments.iter().flatten() {
            cells[(point[1] / CELL_PX) as usize * columns + (point[0] / CELL_PX) as usize].push(*point);
        }
        Self { width, height, instruments, cells, columns }
    }

    /// The nearest point of all outlines within reach.
    fn nearest(&self, to: Point) -> Option<Nearest> {
        let rows = self.cells.len() / self.columns;
        let reach = (REACH_PX / CELL_PX) as isize;
        let [x, y] = to.map(|v| (v / CELL_PX).floor() as isize);
        let mut best: [Option<(f64, Point)>; 2] = [None; 2];
        for ring in 0..=reach {
            // Two points of the rings before are nearer than any of the next ring.
            if best[1].is_some_and(|(d, _)| d.sqrt() < (ring - 1).max(0) as f64 * CELL_PX) {
                break;
            }
            for cy in y - ring..=y + ring {
                let step = if (cy - y).abs() == ring { 1 } else { (2 * ring).max(1) };
                for cx in (x - ring..=x + ring).step_by(step as usize) {
                    if cx < 0 || cy < 0 || cx as usize >= self.columns || cy as usize >= rows {
                        continue;
                    }
                    for point in &self.cells[cy as usize * self.columns + cx as usize] {
                        let d = square(minus(*point, to));
                        if best[0].is_none_or(|(first, _)| d < first) {
                            best = [Some((d, *point)), best[0]];
                        } else if best[1].is_none_or(|(second, _)| d < second) {
                            best[1] = Some((d, *point));
                        }
                    }
                }
            }
        }
        let (d, near) = best[0]?;
        let distance = match best[1] {
            Some((_, other)) if square(minus(other, near)) > 1e-6 => to_segment(to, near, other),
            _ => d.sqrt(),
        };
        (d.sqrt() <= REACH_PX).then_some(Nearest { point: near, distance_px: distance })
    }

    /// Unit vector across the outline at one of its points: the direction in which the points around it are spread least.
    fn normal(&self, at: Point) -> Point {
        let rows = self.cells.len() / self.columns;
        let [x, y] = at.map(|v| (v / CELL_PX) as usize);
        let around = (y.saturating_sub(1)..(y + 2).min(rows)).flat_map(|row| {
            (x.saturating_sub(1)..(x + 2).min(self.columns))
                .flat_map(move |column| &self.cells[row * self.columns + column])
        });
        let (mut count, mut sums, mut squares) = (0.0, [0.0; 2], [0.0; 3]);
        for point in around.filter(|point| square(minus(**point, at)) <= CELL_PX * CELL_PX) {
            let [dx, dy] = minus(*point, at);
            count += 1.0;
            (sums[0], sums[1]) = (sums[0] + dx, sums[1] + dy);
            squares = [squares[0] + dx * dx, squares[1] + dx * dy, squares[2] + dy * dy];
        }
        let [xx, xy, yy] = [
            squares[0] - sums[0] * sums[0] / count,
            squares[1] - sums[0] * sums[1] / count,
            squares[2] - sums[1] * sums[1] / count,
        ];
        let along = 0.5 * (2.0 * xy).atan2(xx - yy);
        [-along.sin(), along.cos()]
    }
}

/// Redness of each pixel, averaged over 3 x 3 pixels; infinite in reflections.
fn redness(image: &Image) -> Vec<f32> {
    let (width, height) = (image.width, image.height);
    let pixels = image.pixels.as_chunks::<3>().0;
    let mut out = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let mut sum = [0.0; 3];
            let mut count = 0.0;
            for row in y.saturating_sub(1)..(y + 2).min(height) {
                for pixel in &pixels[row * width + x.saturating_sub(1)..row * width + (x + 2).min(width)] {
                    (0..3).for_each(|k| sum[k] += f32::from(pixel[k]));
                    count += 1.0;
                }
            }
            let [blue, _, red] = sum.map(|v| v / count);
            out.push(if red > MAX_BRIGHTNESS { f32::INFINITY } else { (red - blue) / red.max(DARK) });
        }
    }
    out
}

/// Numbers connected gray areas from 1; 0 for red pixels and areas that are too small.
fn label(redness: &[f32], width: usize, height: usize) -> Vec<usize> {
    const UNKNOWN: usize = usize::MAX;
    let mut labels: Vec<usize> = redness.iter().map(|r| if *r <= MAX_REDNESS { UNKNOWN } else { 0 }).collect();
    let least = (MIN_AREA * (width * height) as f64) as usize;
    let (mut next, mut area) = (1, Vec::new());
    for start in 0..labels.len() {
        if labels[start] != UNKNOWN {
            continue;
        }
        take_area(&mut labels, (width, height), start, next, &mut area);
        if area.len() < least {
            area.iter().for_each(|at| labels[*at] = 0);
        } else {
            next += 1;
        }
    }
    labels
}

/// Gives the connected pixels around `start` that have its number the number `to`; `area` is then all of them. Returns another number that
/// they touch, 0 for none.
fn take_area(
    labels: &mut [usize],
    (width, height): (usize, usize),
    start: usize,
    to: usize,
    area: &mut Vec<usize>,
) -> usize {
    let from = std::mem::replace(&mut labels[start], to);
    area.clear();
    area.push(start);
    let (mut done, mut touched) = (0, 0);
    while let Some(&at) = area.get(done) {
        done += 1;
        let (x, y) = (at % width, at / width);
        let around = [(x > 0, at.wrapping_sub(1)), (x + 1 < width, at + 1)];
        let across = [(y > 0, at.wrapping_sub(width)), (y + 1 < height, at + width)];
        for (_, near) in around.into_iter().chain(across).filter(|(is_inside, _)| *is_inside) {
            if labels[near] == from {
                labels[near] = to;
                area.push(near);
            } else if labels[near] != to {
                touched = labels[near];
            }
        }
    }
    touched
}

/// Gives small red patches inside an instrument its number.
fn fill_noise(labels: &mut [usize], width: usize, height: usize) {
    const SEEN: usize = usize::MAX;
    let mut area = Vec::new();
    for start in 0..labels.len() {
        if labels[start] == 0 {
            let around = take_area(labels, (width, height), start, SEEN, &mut area);
            if area.len() <= MAX_NOISE && around != 0 {
                area.iter().for_each(|at| labels[*at] = around);
            }
        }
    }
    labels.iter_mut().filter(|label| **label == SEEN).for_each(|label| *label = 0);
}

/// A map that keeps straight lines straight: the quotients of the product with `[x, y, 1]`.
#[derive(Clone, Copy, Debug)]
struct Projective(Matrix3<f64>);

/// Weight of the distance along an outline against that across it; only determines what a straight outline does not.
const SLIDE_WEIGHT: f64 = 1e-3;
/// Weight of the perspective terms against one point of the outline; only keeps them small where an outline does not
/// determine them.
const PERSPECTIVE_WEIGHT: f64 = 0.1;

impl Projective {
    fn shift(dx: f64, dy: f64) -> Self {
        Self(Matrix3::new(1.0, 0.0, dx, 0.0, 1.0, dy, 0.0, 0.0, 1.0))
    }

    fn map(&self, [x, y]: Point) -> Point {
        let to = self.0 * Vector3::new(x, y, 1.0);
        [to.x / to.z, to.y / to.z]
    }

    /// Whether lengths around a point change by less than a third and angles little: a map that presses an outline flat fits
    /// any straight edge.
    fn keeps_shape(&self, at: Point) -> bool {
        let [here, right, below] = [at, [at[0] + 1.0, at[1]], [at[0], at[1] + 1.0]].map(|p| self.map(p));
        let ([a, c], [b, d]) = (minus(right, here), minus(below, here));
        let usual = 0.66..1.5;
        usual.contains(&a.hypot(c)) && usual.contains(&b.hypot(d)) && usual.contains(&(a * d - b * c))
    }

    fn inverse(&self) -> Option<Self> {
        self.0.try_inverse().map(Self)
    }

    /// The least-squares map from points to the outline through other points with these normals; an affine one unless
    /// `has_perspective`. A point may slide along the outline: only [`SLIDE_WEIGHT`] holds it there.
    fn of(pairs: &[(Point, Point, Point)], has_perspective: bool) -> Option<Self> {
        let (mut normal, mut right) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
        for (from, to, across) in pairs {
            let ([x, y], to) = (from.map(|v| v / CONDITION_PX), to.map(|v| v / CONDITION_PX));
            for (direction, weight) in [(*across, 1.0), ([-across[1], across[0]], SLIDE_WEIGHT)] {
                let value = direction[0] * to[0] + direction[1] * to[1];
                let mut row = SVector::<f64, 8>::zeros();
                for (k, share) in direction.into_iter().enumerate() {
                    for (term, factor) in [x, y, 1.0].into_iter().enumerate() {
                        row[3 * k + term] = share * factor;
                    }
                }
                if has_perspective {
                    (row[6], row[7]) = (-x * value, -y * value);
                }
                normal += weight * row * row.transpose();
                right += weight * row * value;
            }
        }
        normal[(6, 6)] += PERSPECTIVE_WEIGHT;
        normal[(7, 7)] += PERSPECTIVE_WEIGHT;
        let m = normal.try_inverse()? * right;
        let scaled = Matrix3::new(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], 1.0);
        let condition = Matrix3::from_diagonal(&Vector3::new(1.0 / CONDITION_PX, 1.0 / CONDITION_PX, 1.0));
        Some(Self(condition.try_inverse()? * scaled * condition))
    }
}

struct Fit {
    deviation_px: f64,
    offset: Point,
}

/// Fits an outline to those of a view. `None` if the view does not show enough of it.
fn fit(outline: &[Point], shown: &Outlines, view: &Outlines) -> Option<Fit> {
    let starts = view.instruments.iter().flat_map(|other| starts(outline, other));
    // The mean distance inside the view: what is beyond its border says nothing.
    let near = |start: &Projective| {
        let sample = outline.iter().step_by((outline.len() / 64).max(1)).map(|p| start.map(*p));
        let (inside, outside): (Vec<Point>, Vec<Point>) = sample.partition(|p| is_inside(*p, view.width, view.height));
        if (inside.len() as f64) < MIN_INSIDE * (inside.len() + outside.len()) as f64 {
            return REACH_PX;
        }
        inside.iter().map(|p| view.nearest(*p).map_or(REACH_PX, |near| near.distance_px)).sum::<f64>()
            / inside.len() as f64
    };
    let mut at = starts.min_by(|a, b| near(a).total_cmp(&near(b)))?;
    for step in 0..ITERATIONS {
        // Pieces that do not fit must not draw the rest away.
        let reach = match step {
            0..5 => REACH_PX,
            5..15 => 3.0,
            _ => 1.5,
        };
        let pairs: Vec<(Point, Point, Point)> = outline
            .iter()
            .filter(|p| is_inside(at.map(**p), view.width, view.height))
            .filter_map(|p| Some((*p, view.nearest(at.map(*p)).filter(|near| near.distance_px < reach)?.point)))
            .map(|(p, q)| (p, q, view.normal(q)))
            .collect();
        at = Projective::of(&pairs, step >= 15)?;
    }
    let centre = outline.iter().fold([0.0; 2], |s, p| [s[0] + p[0], s[1] + p[1]]).map(|v| v / outline.len() as f64);
    if !at.keeps_shape(centre) {
        return None;
    }
    let inside: Vec<Point> =
        outline.iter().map(|p| at.map(*p)).filter(|p| is_inside(*p, view.width, view.height)).collect();
    if (inside.len() as f64) < MIN_INSIDE * outline.len() as f64 {
        return None;
    }
    let far = |outlines: &Outlines, p: Point| outlines.nearest(p).map_or(REACH_PX, |near| near.distance_px);
    let there = quantile(inside.iter().map(|p| far(view, *p)).collect());
    // And back, so that no piece is missing: of the instrument of the view that has most of the points.
    let near = |other: &Vec<Point>| {
        let mut count = 0;
        for p in inside.iter().step_by(8) {
            count += usize::from(other.iter().any(|q| square(minus(*p, *q)) < 9.0));
        }
        count
    };
    let same = view.instruments.iter().max_by_key(|other| near(other))?;
    let back = at.inverse()?;
    let returned = same.iter().map(|p| back.map(*p)).filter(|p| is_inside(*p, shown.width, shown.height));
    let back = quantile(returned.map(|p| far(shown, p)).collect());
    Some(Fit { deviation_px: there.max(back), offset: minus(at.map(centre), centre) })
}

/// Translations that align corners of the bounds, or the centres, of two outlines.
fn starts(outline: &[Point], other: &[Point]) -> Vec<Projective> {
    let bounds = |points: &[Point]| {
        let all = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        points.iter().fold(all, |b, p| [b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])])
    };
    let (a, b) = (bounds(outline), bounds(other));
    let mut all = vec![Projective::shift((b[0] + b[2] - a[0] - a[2]) / 2.0, (b[1] + b[3] - a[1] - a[3]) / 2.0)];
    for x in [0, 2] {
        all.extend([1, 3].map(|y| Projective::shift(b[x] - a[x], b[y] - a[y])));
    }
    all
}

fn is_inside([x, y]: Point, width: usize, height: usize) -> bool {
    (BORDER_PX..width as f64 - BORDER_PX).contains(&x) && (BORDER_PX..height as f64 - BORDER_PX).contains(&y)
}

fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

fn square([x, y]: Point) -> f64 {
    x * x + y * y
}

fn to_segment(p: Point, a: Point, b: Point) -> f64 {
    let (along, off) = (minus(b, a), minus(p, a));
    let t = ((off[0] * along[0] + off[1] * along[1]) / square(along)).clamp(-1.0, 1.0);
    square([off[0] - t * along[0], off[1] - t * along[1]]).sqrt()
}

fn quantile(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (QUANTILE * values.len() as f64) as usize;
    values.get(index.min(values.len().saturating_sub(1))).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gray bar of 22 px from the right border to (60, 130), `bent` px lower left of column 150, displaced by `dx`.
    fn scene(width: usize, dx: f64, bent: f64) -> Image {
        let height = 240;
        let mut pixels = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let (x, y) = (x as f64 - dx, y as f64);
                let middle = 130.0 - 0.25 * (x - 60.0) + if x < 150.0 { bent } else { 0.0 };
                let inside = (11.5 - (y - middle).abs()).clamp(0.0, 1.0) * (x - 60.0).clamp(0.0, 1.0);
                let mix = |gray: f64, tissue: f64| (gray * inside + tissue * (1.0 - inside)) as u8;
                pixels.extend([mix(80.0, 60.0), mix(80.0, 90.0), mix(80.0, 180.0)]);
            }
        }
        Image { width, height, pixels }
    }

    #[test]
    fn an_instrument_of_one_view_deviates_by_less_than_half_a_pixel() {
        let views = [scene(320, 0.0, 0.0), scene(320, -21.3, 0.0)];
        for dx in [0.0, 7.4, -21.3] {
            let found = compare(&scene(360, dx, 0.0), [&views[0], &views[1]]);
            assert_eq!(found.deviations_px.len(), 1);
            assert!(found.deviations_px[0] < 0.5, "{dx}: {found:?}");
            for (offset, wanted) in found.offsets.into_iter().zip([-dx, -21.3 - dx]) {
                let offset = offset.unwrap();
                assert!((offset[0] - wanted).abs() < 1.0 && offset[1].abs() < 1.0, "{dx}: {found:?}");
            }
        }
    }

    #[test]
    fn noise_in_the_shade_of_an_instrument_is_not_an_outline() {
        let noisy = |dx: f64| {
            let mut image = scene(320, dx, 0.0);
            for x in (90..260).step_by(6) {
                let y = (130.0 - 0.25 * (x as f64 - dx - 60.0)) as usize;
                image.pixels[3 * (y * 320 + x)..][..9].copy_from_slice(&[60, 90, 180].repeat(3));
            }
            image
        };
        let views = [noisy(0.0), noisy(-21.3)];
        let found = compare(&scene(360, 0.0, 0.0), [&views[0], &views[1]]);
        assert!(found.deviations_px[0] < 0.5, "{found:?}");
    }

    #[test]
    fn a_reflection_on_an_instrument_is_not_an_outline() {
        let lit = |width, dx: f64, glint: f64| {
            let mut image = scene(width, dx, 0.0);
            for (i, pixel) in image.pixels.chunks_exact_mut(3).enumerate() {
                let (x, y) = ((i % width) as f64 - dx, (i / width) as f64);
                if (x - glint).abs() < 20.0 && (y - 130.0 + 0.25 * (x - 60.0)).abs() < 6.0 {
                    pixel.fill(250);
                }
            }
            image
        };
        let views = [lit(320, 0.0, 180.0), lit(320, -21.3, 192.0)];
        let found = compare(&lit(360, 7.4, 186.0), [&views[0], &views[1]]);
        assert!(found.deviations_px.len() == 1 && found.deviations_px[0] < 0.5, "{found:?}");
    }

    #[test]
    fn a_torn_instrument_deviates_by_its_step() {
        let view = scene(320, 0.0, 0.0);
        for bent in [3.0, 6.0] {
            let found = compare(&scene(320, 0.0, bent), [&view, &view]);
            assert!((0.5 * bent..1.6 * bent).contains(&found.deviations_px[0]), "{bent}: {found:?}");
        }
    }

    #[test]
    fn a_view_drawn_by_a_homography_does_not_deviate() {
        let view = scene(320, 0.0, 0.0);
        let mut drawn = view.clone();
        // Nearest pixel of a map that makes the right side 4 % larger than the left.
        for (i, pixel) in drawn.pixels.chunks_exact_mut(3).enumerate() {
            let (x, y) = ((i % 320) as f64, (i / 320) as f64);
            let w = 1.0 + 0.04 * (x - 160.0) / 160.0;
            let (u, v) = ((x - 160.0) / w + 160.0, (y - 120.0) / w + 120.0);
            let at = |v: f64, size: usize| (v.round().max(0.0) as usize).min(size - 1);
            let from = 3 * (at(v, 240) * 320 + at(u, 320));
            pixel.copy_from_slice(&view.pixels[from..from + 3]);
        }
        let found = compare(&drawn, [&view, &view]);
        assert!(found.deviations_px[0] < 0.7, "{found:?}");
    }

    /// Jaws on a shaft twice as wide, from the right border, whose pixel at a point is that of the map of the point. `gray`: blue,
    /// green, red of the metal.
    fn jaws(gray: [f64; 3], map: impl Fn(Point) -> Point) -> Image {
        let (width, height) = (480, 240);
        let mut pixels = Vec::new();
        for i in 0..width * height {
            let [x, y] = map([(i % width) as f64, (i / width) as f64]);
            let half = if x < 330.0 { 9.0 } else { 18.0 };
            let inside = (half - (y - 150.0 + 0.2 * (x - 80.0)).abs()).clamp(0.0, 1.0) * (x - 80.0).clamp(0.0, 1.0);
            pixels.extend([0, 1, 2].map(|k| (gray[k] * inside + [60.0, 90.0, 180.0][k] * (1.0 - inside)) as u8));
        }
        Image { width, height, pixels }
    }

    #[test]
    fn a_long_shaft_does_not_hold_an_outline_where_it_begins() {
        let metal = [80.0; 3];
        let view = jaws(metal, |at| at);
        // Larger by a few percent, and displaced, as a nearer instrument is in the panorama.
        for (scale, dx) in [(0.975, 4.0), (1.03, -9.0)] {
            let shown = jaws(metal, |[x, y]| [scale * (x - dx), 120.0 + scale * (y - 120.0)]);
            let found = compare(&shown, [&view, &view]);
            assert!(found.deviations_px[0] < 0.5, "{scale}, {dx}: {found:?}");
        }
    }

    #[test]
    fn an_outline_is_not_pressed_flat_onto_an_edge() {
        let metal = [80.0; 3];
        let (shown, view) = (jaws(metal, |at| at), jaws(metal, |[x, y]| [x + 60.0, y]));
        // Of the other view only a straight edge is left.
        let mut edge = view.clone();
        edge.pixels.chunks_exact_mut(3).enumerate().filter(|(i, _)| i / 480 > 110).for_each(|(_, p)| p.fill(80));
        let found = compare(&shown, [&view, &edge]);
        assert!(found.view == Some(0) && found.deviations_px[0] < 0.5, "{found:?}");
        let found = compare(&shown, [&edge, &edge]);
        assert!(found.deviations_px.iter().all(|px| *px > 2.0), "{found:?}");
    }

    #[test]
    fn a_warm_view_has_the_same_outlines() {
        let (plain, warm) = (jaws([80.0; 3], |at| at), jaws([80.0, 84.0, 92.0], |at| at));
        for (shown, view) in [(&plain, &warm), (&warm, &plain)] {
            let found = compare(shown, [view, view]);
            assert!(found.deviations_px[0] < 0.5, "{found:?}");
        }
    }

    #[test]
    fn tissue_alone_has_no_instruments() {
        let tissue = Image { width: 64, height: 48, pixels: [60, 90, 180].repeat(64 * 48) };
        assert_eq!(compare(&tissue, [&tissue, &tissue]), Comparison::default());
    }
}
