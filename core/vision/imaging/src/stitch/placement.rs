//! Quality of a composite's geometry by ground truth: alignment, breaks along the seam, stretch, ghosts.

use super::evaluate::{Gray, TruePairs};
use super::mesh::Mesh;
use crate::geometry::{Homography, Point};
use crate::{Rect, View};

/// Step of numerical derivatives, px.
const SLOPE_PX: f64 = 8.0;
/// Spacing of the positions at which stretch is measured, px.
const STRETCH_STEP: usize = 16;
/// Steps of the search for the position of a point.
const PLACE_STEPS: usize = 24;

/// Placement of the other view by a composite: by a mesh if there is one, else by a homography.
#[derive(Clone, Debug, PartialEq)]
pub struct Placement {
    left_from_other: Homography,
    other_from_left: Homography,
    mesh: Option<Mesh>,
    /// Mesh of the left view; `None` if it is unchanged.
    reference: Option<Mesh>,
}

impl Placement {
    /// A placement with an unchanged left view. `None` if the homography has no inverse.
    pub fn new(left_from_other: Homography, mesh: Option<Mesh>) -> Option<Self> {
        Some(Self { left_from_other, other_from_left: left_from_other.inverse()?, mesh, reference: None })
    }

    /// Also warps the left view by a mesh.
    pub fn with_reference(self, reference: Option<Mesh>) -> Self {
        Self { reference, ..self }
    }

    /// Point of the left view that the panorama shows at a point of its plane; points outside the mesh are unchanged.
    fn left_of(&self, at: Point) -> Point {
        self.reference.as_ref().and_then(|mesh| mesh.map(at)).unwrap_or(at)
    }

    /// Position in the panorama of a point of the left view.
    fn place_of(&self, left: Point) -> Point {
        let mut at = left;
        if self.reference.is_some() {
            for _ in 0..PLACE_STEPS {
                let shown = self.left_of(at);
                at = [0, 1].map(|k| at[k] + left[k] - shown[k]);
            }
        }
        at
    }

    /// Position in the other view of a point of the left view's plane; `None` outside the mesh.
    pub fn other_of(&self, left: Point) -> Option<Point> {
        match &self.mesh {
            Some(mesh) => mesh.map(left),
            None => Some(self.other_from_left.map(left)),
        }
    }

    /// Derivative of [`other_of`](Self::other_of), columns first.
    fn slope(&self, [x, y]: Point) -> Option<[[f64; 2]; 2]> {
        let along = |dx: f64, dy: f64| -> Option<Point> {
            let (a, b) = (self.other_of([x - dx, y - dy])?, self.other_of([x + dx, y + dy])?);
            Some([(b[0] - a[0]) / (2.0 * SLOPE_PX), (b[1] - a[1]) / (2.0 * SLOPE_PX)])
        };
        Some([along(SLOPE_PX, 0.0)?, along(0.0, SLOPE_PX)?])
    }

    /// Distance in the panorama between the positions at which the composite draws the point `left` and its counterpart
    /// `other`. `None` outside the mesh.
    pub fn error_px(&self, other: Point, left: Point) -> Option<f64> {
        self.apart_px(other, self.place_of(left))
    }

    /// Distance in the panorama between a point of its plane and the position at which the composite draws the point
    /// `other`.
    fn apart_px(&self, other: Point, place: Point) -> Option<f64> {
        if self.mesh.is_none() {
            return Some(self.left_from_other.squared_error(other, place).sqrt());
        }
        let at = self.other_of(place)?;
        let [[a, c], [b, d]] = self.slope(place)?;
        let (dx, dy) = (other[0] - at[0], other[1] - at[1]);
        let determinant = a * d - b * c;
        // Where the mesh folds over, distances of the other view stand in.
        let is_folded = determinant < 0.05;
        Some(if is_folded {
            dx.hypot(dy)
        } else {
            ((d * dx - b * dy) / determinant).hypot((a * dy - c * dx) / determinant)
        })
    }

    /// Motion of the other view's image relative to another placement: root mean square distance on the left view's
    /// plane over a 3 x 3 grid of its points. `None` outside a mesh.
    pub fn motion_px(&self, previous: &Self, (width, height): (usize, usize)) -> Option<f64> {
        let mut squares = 0.0;
        for i in 0..9 {
            let point = [(i % 3) as f64 / 2.0 * (width as f64 - 1.0), (i / 3) as f64 / 2.0 * (height as f64 - 1.0)];
            squares += if self.mesh.is_none() && previous.mesh.is_none() {
                self.left_from_other.squared_error(point, previous.left_from_other.map(point))
            } else {
                let place = self.left_from_other.map(point);
                self.apart_px(previous.other_of(place)?, place)?.powi(2)
            };
        }
        Some((squares / 9.0).sqrt())
    }

    /// As [`TruePairs::alignment`].
    pub fn alignment(&self, pairs: &TruePairs<'_>) -> Option<(f64, usize)> {
        let (mut squares, mut count) = (0.0, 0usize);
        for error in pairs.iter().filter_map(|(other, left)| self.error_px(other, left)) {
            squares += error * error;
            count += 1;
        }
        (count > 0).then(|| ((squares / count as f64).sqrt(), count))
    }

    /// Break of lines that cross the seam: error of the true pairs at the seam, px; median and 95 % quantile.
    ///
    /// `shown`: view of each pixel of the canvas (0: none, 1: the left one, `view`: the other); `left_at`: the left
    /// view's place there. `None` when no true pair lies at the seam.
    pub fn seam_break(
        &self,
        pairs: &TruePairs<'_>,
        shown: View<'_, u8>,
        view: u8,
        left_at: (i32, i32),
    ) -> Option<(f64, f64)> {
        let mut errors = Vec::new();
        for y in 0..shown.height {
            let row = shown.row(y);
            let below = (y + 1 < shown.height).then(|| shown.row(y + 1));
            for x in 0..shown.width {
                let is_change = |other: u8| (row[x] == 1 && other == view) || (row[x] == view && other == 1);
                let at_seam =
                    row.get(x + 1).is_some_and(|next| is_change(*next)) || below.is_some_and(|b| is_change(b[x]));
                if !at_seam {
                    continue;
                }
                let (u, v) = (x as i64 - i64::from(left_at.0), y as i64 - i64::from(left_at.1));
                let (Ok(u), Ok(v)) = (usize::try_from(u), usize::try_from(v)) else { continue };
                let [u, v] = self.left_of([u as f64, v as f64]).map(|at| at.round().max(0.0) as usize);
                let error = pairs.at(u, v).and_then(|(other, left)| self.error_px(other, left));
                errors.extend(error);
            }
        }
        quantiles(&mut errors)
    }

    /// Change of lengths against the homography where only the other view is shown, percent; the 95 % quantile. 0
    /// without a mesh, `None` if there is no such position.
    pub fn stretch_pct(&self, shown: View<'_, u8>, view: u8, left: Rect, left_at: (i32, i32)) -> Option<f64> {
        let mut all = Vec::new();
        for y in (0..shown.height).step_by(STRETCH_STEP) {
            for x in (0..shown.width).step_by(STRETCH_STEP) {
                let at = [f64::from(x as i32 - left_at.0), f64::from(y as i32 - left_at.1)];
                let is_in = |[x, y]: Point| x >= 0.0 && y >= 0.0 && x < left.width as f64 && y < left.height as f64;
                // Seen by the other camera alone, or beside where the left view would lie.
                if shown.row(y)[x] != view || (is_in(at) && is_in(self.left_of(at))) {
                    continue;
                }
                all.extend(self.stretch(at));
            }
        }
        quantiles(&mut all).map(|(_, most)| 100.0 * most)
    }

    /// Largest relative change of a length at a point of the left view's plane.
    fn stretch(&self, [x, y]: Point) -> Option<f64> {
        if self.mesh.is_none() {
            return Some(0.0);
        }
        let drawn = |dx: f64, dy: f64| Some(self.left_from_other.map(self.other_of([x + dx, y + dy])?));
        let along = |dx: f64, dy: f64| -> Option<Point> {
            let (a, b) = (drawn(-dx, -dy)?, drawn(dx, dy)?);
            Some([(b[0] - a[0]) / (2.0 * SLOPE_PX), (b[1] - a[1]) / (2.0 * SLOPE_PX)])
        };
        let ([a, c], [b, d]) = (along(SLOPE_PX, 0.0)?, along(0.0, SLOPE_PX)?);
        // Singular values of a 2 x 2 matrix.
        let (sum, difference) = ((a + d).hypot(b - c), (a - d).hypot(b + c));
        let (large, small) = ((sum + difference) / 2.0, (sum - difference) / 2.0);
        Some((large - 1.0).abs().max((1.0 - small).abs()))
    }
}

/// Median and 95 % quantile.
fn quantiles(values: &mut [f64]) -> Option<(f64, f64)> {
    values.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| values.get(((values.len() as f64 - 1.0) * share).round() as usize).copied();
    (!values.is_empty()).then_some(())?;
    Some((at(0.5)?, at(0.95)?))
}

/// Share of the pixels of `region` whose content is not nearby in the ground truth, percent: more than `levels` outside
/// the range of the ground truth within `reach` px. `None` when the region is empty. All have one size; one gain
/// between the images is removed.
pub fn ghost_pct(picture: &Gray, truth: &Gray, region: &[bool], reach: usize, levels: f32) -> Option<f64> {
    let (mut cross, mut square) = (0.0f64, 0.0f64);
    for ((p, t), _) in picture.data.iter().zip(&truth.data).zip(region).filter(|(_, inside)| **inside) {
        cross += f64::from(*p) * f64::from(*t);
        square += f64::from(*p) * f64::from(*p);
    }
    let gain = if square > 0.0 { (cross / square) as f32 } else { 1.0 };
    let (mut ghosts, mut count) = (0usize, 0usize);
    let (width, height) = (picture.width, picture.height);
    for y in 0..height {
        for x in (0..width).filter(|x| region[y * width + x]) {
            let (mut low, mut high) = (f32::MAX, f32::MIN);
            for v in y.saturating_sub(reach)..(y + reach + 1).min(height) {
                for t in &truth.data[v * width + x.saturating_sub(reach)..v * width + (x + reach + 1).min(width)] {
                    (low, high) = (low.min(*t), high.max(*t));
                }
            }
            let value = picture.data[y * width + x] * gain;
            ghosts += usize::from(value < low - levels || value > high + levels);
            count += 1;
        }
    }
    (count > 0).then(|| 100.0 * ghosts as f64 / count as f64)
}

#[cfg(test)]
mod tests {
    use super::super::mesh::Lattice;
    use super::*;

    const LATTICE: Lattice = Lattice { cell_px: 20, first: [-2, -2], columns: 16, rows: 12 };

    fn placed(shift: f64, mesh: impl Fn(Point) -> Point) -> Placement {
        Placement::new(Homography::translation(shift, 0.0), Mesh::new(LATTICE, mesh)).unwrap()
    }

    #[test]
    fn a_break_is_what_the_mesh_leaves_of_the_parallax() {
        // Two depths: no homography fits both, the mesh does.
        let truth = |x: f64| if x < 100.0 { 40.0 } else { 50.0 };
        let disparity: Vec<f32> = (0..200 * 100).map(|i| truth((i % 200) as f64) as f32).collect();
        let pairs =
            TruePairs { disparity: View::new(&disparity, 200, 100, 1), visible: None, along: [1.0, 0.0], step: 4 };
        // The seam runs down column 150, where the disparity is 50.
        let shown: Vec<u8> = (0..260 * 120).map(|i| if i % 260 < 160 { 1 } else { 2 }).collect();
        let shown = View::new(&shown, 260, 120, 1);
        let plane = Placement::new(Homography::translation(40.0, 3.0), None).unwrap();
        let (median, most) = plane.seam_break(&pairs, shown, 2, (10, 10)).unwrap();
        assert!((median - 109f64.sqrt()).abs() < 1e-9 && (most - median).abs() < 1e-9, "{median} {most}");
        let mesh = placed(40.0, |[x, y]| [x - truth(x), y + 0.25]);
        let (median, _) = mesh.seam_break(&pairs, shown, 2, (10, 10)).unwrap();
        assert!((median - 0.25).abs() < 1e-6, "{median}");
        // Two columns of cells hold the step.
        let (rms, count) = mesh.alignment(&pairs).unwrap();
        assert!(rms < 4.0 && count > 700, "{rms} {count}");
        assert!(plane.alignment(&pairs).unwrap().0 > 7.0);
        // A seam outside the left view has no pairs.
        assert_eq!(plane.seam_break(&pairs, shown, 2, (-400, 0)), None);
    }

    #[test]
    fn an_error_is_measured_on_the_left_plane() {
        // The mesh halves widths: a pixel of the other view is two of the left one.
        let mesh = placed(0.0, |[x, y]| [0.5 * x, y]);
        let error = mesh.error_px([21.0, 30.0], [40.0, 30.0]).unwrap();
        assert!((error - 2.0).abs() < 1e-6, "{error}");
        assert_eq!(mesh.error_px([21.0, 30.0], [4000.0, 30.0]), None);
    }

    #[test]
    fn stretch_is_measured_where_only_the_other_view_is_shown() {
        let shown = vec![2u8; 200 * 100];
        let shown = View::new(&shown, 200, 100, 1);
        let left = Rect::whole(100, 100);
        let wide = placed(40.0, |[x, y]| [1.03 * x - 40.0, y]);
        let stretch = wide.stretch_pct(shown, 2, left, (0, 0)).unwrap();
        assert!((stretch - 3.0).abs() < 0.01, "{stretch}");
        let turned = placed(40.0, |[x, y]| [0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y]);
        assert!(turned.stretch_pct(shown, 2, left, (0, 0)).unwrap() < 0.01, "a turn changes no length");
        let plane = Placement::new(Homography::translation(40.0, 0.0), None).unwrap();
        assert_eq!(plane.stretch_pct(shown, 2, left, (0, 0)), Some(0.0));
        assert_eq!(plane.stretch_pct(shown, 2, Rect::whole(200, 100), (0, 0)), None);
    }

    #[test]
    fn a_doubled_line_is_a_ghost_and_a_brighter_picture_is_none() {
        let line = |at: usize| -> Vec<f32> { (0..80 * 40).map(|i| if i % 80 == at { 40.0 } else { 160.0 }).collect() };
        let gray = |data: Vec<f32>| Gray { data, width: 80, height: 40 };
        let (truth, all) = (gray(line(30)), vec![true; 80 * 40]);
        let brighter = gray(truth.data.iter().map(|v| v * 1.2).collect());
        assert_eq!(ghost_pct(&brighter, &truth, &all, 2, 16.0), Some(0.0));
        assert_eq!(ghost_pct(&gray(line(31)), &truth, &all, 2, 16.0), Some(0.0), "a line moved by a pixel");
        let both = truth.data.iter().zip(line(44)).map(|(a, b)| 0.5 * (a + b)).collect();
        let share = ghost_pct(&gray(both), &truth, &all, 2, 16.0).unwrap();
        assert!((share - 100.0 / 80.0).abs() < 1e-9, "{share}");
        assert_eq!(ghost_pct(&brighter, &truth, &vec![false; 80 * 40], 2, 16.0), None);
    }
}
