//! Poses of all keyframes at once: least squares over the pairs of points that they share.
//!
//! Errors are measured in the pixels of the keyframes, never in those of the mosaic: shrinking the mosaic would reduce
//! the latter without correcting them, and the scale would drift. The oldest keyframe is fixed.

use super::graph::{Edge, Graph};
use super::keyframe::{Keyframe, index_of};
use super::outline::Outline;
use super::params::MosaicModel;
use super::skyline::Skyline;
use crate::geometry::Homography;

/// Largest number of parameters of a keyframe.
const MAX_DEGREES: usize = 8;
/// Scale of the Cauchy loss, in pixels: a wrong edge must not bend the mosaic, but one that closes a long loop must act
/// until its error is spread.
const LOSS_PX: f64 = 10.0;
/// Weight of the perspective of each keyframe relative to the pairs of its edges: curved tissue resembles a growing
/// perspective from keyframe to keyframe, which overlaps hardly contradict and which would bend the mosaic.
const PERSPECTIVE: f64 = 0.3;
/// Largest number of steps.
const ITERATIONS: usize = 20;
/// Weight that fixes keyframes without a path to the oldest one.
const ANCHOR: f64 = 1e-9;

/// The adjustment with its work memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Adjust {
    normal: Skyline,
    damped: Skyline,
    gradient: Vec<f64>,
    step: Vec<f64>,
    first: Vec<usize>,
    poses: Vec<Homography>,
    trial: Vec<Homography>,
}

/// Entries of a 3x3 matrix that a parameter changes: row, column, factor.
type Generator = &'static [(usize, usize, f64)];

fn generators(model: MosaicModel) -> &'static [Generator] {
    const HOMOGRAPHY: [Generator; 8] = [
        &[(0, 2, 1.0)],
        &[(1, 2, 1.0)],
        &[(0, 0, 1.0)],
        &[(0, 1, 1.0)],
        &[(1, 0, 1.0)],
        &[(1, 1, 1.0)],
        &[(2, 0, 1.0)],
        &[(2, 1, 1.0)],
    ];
    const SIMILARITY: [Generator; 4] =
        [&[(0, 2, 1.0)], &[(1, 2, 1.0)], &[(0, 0, 1.0), (1, 1, 1.0)], &[(0, 1, -1.0), (1, 0, 1.0)]];
    match model {
        MosaicModel::Homography => &HOMOGRAPHY,
        MosaicModel::Affine => &HOMOGRAPHY[..6],
        MosaicModel::Similarity => &SIMILARITY,
    }
}

/// Coordinates from about -1 to 1 across a frame, so that one damping suits all parameters.
#[derive(Clone, Copy, Debug)]
struct Unit {
    centre: [f64; 2],
    scale: f64,
}

impl Unit {
    fn of(size: (usize, usize)) -> Self {
        let half = |side: usize| (side as f64 - 1.0) / 2.0;
        Self { centre: [half(size.0), half(size.1)], scale: half(size.0.max(size.1)) }
    }

    fn matrix(&self) -> Homography {
        let s = 1.0 / self.scale;
        Homography([s, 0.0, -s * self.centre[0], 0.0, s, -s * self.centre[1], 0.0, 0.0, 1.0])
    }

    fn inverse(&self) -> Homography {
        let s = self.scale;
        Homography([s, 0.0, self.centre[0], 0.0, s, self.centre[1], 0.0, 0.0, 1.0])
    }
}

/// Displacement of the middle of a frame's sides by the perspective of a pose, in pixels.
fn perspective_px(pose: &Homography, unit: Unit) -> [f64; 2] {
    let h = pose.0;
    [h[6] / h[8] * unit.scale, h[7] / h[8] * unit.scale]
}

fn cauchy(squared_px: f64) -> f64 {
    let c = LOSS_PX * LOSS_PX;
    c * (squared_px / c).ln_1p()
}

impl Adjust {
    /// Reserves memory for this many keyframes on a chain; denser graphs grow it once more.
    pub fn reserve(&mut self, keyframes: usize) {
        self.gradient.reserve(keyframes * MAX_DEGREES);
        self.step.reserve(keyframes * MAX_DEGREES);
        self.first.reserve(keyframes);
        self.poses.reserve(keyframes);
        self.trial.reserve(keyframes);
    }

    /// Moves the keyframes so that their edges are shortest. Returns the root mean square length of all edges' pairs
    /// afterwards, in pixels; `None` without edges. If a keyframe would fold, none is moved.
    pub fn adjust(
        &mut self,
        keyframes: &mut [Keyframe],
        graph: &Graph,
        size: (usize, usize),
        model: MosaicModel,
    ) -> Option<f64> {
        if graph.edges().is_empty() || keyframes.len() < 2 {
            return None;
        }
        let unit = Unit::of(size);
        let (to_unit, from_unit) = (unit.matrix(), unit.inverse());
        self.poses.clear();
        self.poses.extend(keyframes.iter().map(|k| to_unit.compose(&k.mosaic_from_frame).compose(&from_unit)));
        let ends = |edge: &Edge| Some((index_of(keyframes, edge.from)?, index_of(keyframes, edge.to)?));
        let degrees = model.degrees();
        // Row 0 of the system belongs to keyframe 1: keyframe 0 stays.
        self.first.clear();
        self.first.extend(0..keyframes.len());
        for (a, b) in graph.edges().iter().filter_map(ends) {
            let (low, high) = (a.min(b), a.max(b));
            self.first[high] = self.first[high].min(low.max(1));
        }
        let rows = (keyframes.len() - 1) * degrees;
        let prior = if model == MosaicModel::Homography { PERSPECTIVE } else { 0.0 };
        let cost = |poses: &[Homography]| -> Option<f64> {
            let mut sum = 0.0;
            for edge in graph.edges() {
                let Some((a, b)) = ends(edge) else { continue };
                let map = from_unit.compose(&poses[b].inverse()?).compose(&poses[a]).compose(&to_unit);
                let part: f64 = edge.pairs().iter().map(|(p, q)| cauchy(map.squared_error(*p, *q))).sum();
                sum += part * edge.weight;
            }
            sum += poses[1..]
                .iter()
                .map(|pose| perspective_px(pose, unit).map(|v| v * v).iter().sum::<f64>())
                .sum::<f64>()
                * prior;
            sum.is_finite().then_some(sum)
        };
        let mut best = cost(&self.poses)?;
        let mut damping = 1e-4;
        for _ in 0..ITERATIONS {
            self.linearise_all(keyframes, graph, unit, model, prior);
            let mut improved = false;
            for _ in 0..5 {
                self.damped.copy_from(&self.normal);
                for row in 0..rows {
                    self.damped.add(row, row, damping * self.normal.diagonal(row) + ANCHOR);
                }
                self.step.clone_from(&self.gradient);
                if !self.damped.solve(&mut self.step) {
                    damping *= 10.0;
                    continue;
                }
                self.try_step(model);
                match cost(&self.trial) {
                    Some(value) if value < best => {
                        improved = best - value > best * 1e-5;
                        best = value;
                        std::mem::swap(&mut self.poses, &mut self.trial);
                        damping *= 0.1;
                        break;
                    }
                    _ => damping *= 10.0,
                }
            }
            if !improved {
                break;
            }
        }
        self.settle(keyframes, graph, unit, size)
    }

    /// Sets the system of equations at the present poses, with the weight `prior` of poses without perspective.
    fn linearise_all(&mut self, keyframes: &[Keyframe], graph: &Graph, unit: Unit, model: MosaicModel, prior: f64) {
        let (degrees, first) = (model.degrees(), &self.first);
        let rows = (self.poses.len() - 1) * degrees;
        self.normal.reset(rows, |row| (first[row / degrees + 1] - 1) * degrees);
        self.gradient.clear();
        self.gradient.resize(rows, 0.0);
        for edge in graph.edges() {
            if let Some(ends) = index_of(keyframes, edge.from).zip(index_of(keyframes, edge.to)) {
                linearise(edge, ends, &self.poses, unit, model, &mut self.normal, &mut self.gradient);
            }
        }
        if prior > 0.0 {
            for (index, pose) in self.poses[1..].iter().enumerate() {
                // The last two parameters of a pose are its perspective.
                for (k, value) in perspective_px(pose, unit).into_iter().enumerate() {
                    let row = index * degrees + degrees - 2 + k;
                    self.normal.add(row, row, prior * unit.scale * unit.scale);
                    self.gradient[row] -= prior * unit.scale * value;
                }
            }
        }
    }

    /// Sets the trial to the poses after the solved step.
    fn try_step(&mut self, model: MosaicModel) {
        self.trial.clone_from(&self.poses);
        for (pose, step) in self.trial[1..].iter_mut().zip(self.step.chunks_exact(model.degrees())) {
            let mut change = Homography::identity();
            for (generator, value) in generators(model).iter().zip(step) {
                generator.iter().for_each(|(row, column, factor)| change.0[row * 3 + column] += factor * value);
            }
            *pose = pose.compose(&change);
        }
    }

    /// Applies the poses unless they would fold a frame.
    fn settle(&self, keyframes: &mut [Keyframe], graph: &Graph, unit: Unit, size: (usize, usize)) -> Option<f64> {
        let back = |pose: &Homography| unit.inverse().compose(pose).compose(&unit.matrix());
        if self.poses.iter().all(|pose| Outline::of(&back(pose), size).is_some()) {
            for (keyframe, pose) in keyframes.iter_mut().zip(&self.poses).skip(1) {
                keyframe.mosaic_from_frame = back(pose);
                if let Some(outline) = Outline::of(&keyframe.mosaic_from_frame, size) {
                    keyframe.outline = outline;
                }
            }
        }
        let (mut squares, mut count) = (0.0, 0usize);
        for edge in graph.edges() {
            let (Some(a), Some(b)) = (index_of(keyframes, edge.from), index_of(keyframes, edge.to)) else { continue };
            if let Some(error) = edge.error_px(&keyframes[a], &keyframes[b]) {
                squares += error * error * edge.count as f64;
                count += edge.count;
            }
        }
        (count > 0).then(|| (squares / count as f64).sqrt())
    }
}

/// Adds an edge's pairs to the normal equations. The parameters are small maps applied before the poses: `pose (I +
/// change)`.
fn linearise(
    edge: &Edge,
    (a, b): (usize, usize),
    poses: &[Homography],
    unit: Unit,
    model: MosaicModel,
    normal: &mut Skyline,
    gradient: &mut [f64],
) {
    let Some(inverse) = poses[b].inverse() else { return };
    let map = inverse.compose(&poses[a]).0;
    let degrees = model.degrees();
    let normalise = |p: [f64; 2]| [(p[0] - unit.centre[0]) / unit.scale, (p[1] - unit.centre[1]) / unit.scale];
    for (p, q) in edge.pairs() {
        let ([px, py], [qx, qy]) = (normalise(*p), normalise(*q));
        let p = [px, py, 1.0];
        let v: [f64; 3] = std::array::from_fn(|row| (0..3).map(|k| map[row * 3 + k] * p[k]).sum());
        let (x, y) = (v[0] / v[2], v[1] / v[2]);
        // Derivatives of the projection, in pixels.
        let s = unit.scale / v[2];
        let project = [[s, 0.0, -s * x], [0.0, s, -s * y]];
        let residual = [(qx - x) * unit.scale, (qy - y) * unit.scale];
        let squared = residual[0] * residual[0] + residual[1] * residual[1];
        let weight = edge.weight / (1.0 + squared / (LOSS_PX * LOSS_PX));
        if !weight.is_finite() {
            continue;
        }
        let mut jacobian = [[[0.0f64; MAX_DEGREES]; 2]; 2];
        for (index, generator) in generators(model).iter().enumerate() {
            for (row, column, factor) in generator.iter() {
                for axis in 0..2 {
                    // d(map (I + change) p) = map change p;  d((I + change)^-1 v) = -change v.
                    let through: f64 = (0..3).map(|k| project[axis][k] * map[k * 3 + row]).sum();
                    jacobian[0][axis][index] += factor * through * p[*column];
                    jacobian[1][axis][index] -= factor * project[axis][*row] * v[*column];
                }
            }
        }
        let ends = [a, b];
        for (side, end) in ends.iter().enumerate().filter(|(_, end)| **end > 0) {
            let base = (end - 1) * degrees;
            for i in 0..degrees {
                let row = base + i;
                for axis in 0..2 {
                    gradient[row] += weight * jacobian[side][axis][i] * residual[axis];
                }
                for (other, end) in ends.iter().enumerate().filter(|(_, end)| **end > 0) {
                    let base = (end - 1) * degrees;
                    for j in (0..degrees).filter(|j| base + j <= row) {
                        let product: f64 = (0..2).map(|axis| jacobian[side][axis][i] * jacobian[other][axis][j]).sum();
                        normal.add(row, base + j, weight * product);
                    }
                }
            }
        }
    }
}
