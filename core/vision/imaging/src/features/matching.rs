//! Brute-force matching of SURF descriptors with the ratio test.
//!
//! Descriptors are quantised to 16 bits, so that one instruction multiplies 16 elements; squared Euclidean
//! distances come from integer dot products and are the same on every machine.

use super::describe::{DESCRIPTOR_LEN, Descriptor};
use super::surf::Features;
use crate::geometry::Homography;
use crate::{Parallel, SharedMut, Simd};

/// Descriptor elements are stored as integers times this; dot products stay below 2^26.
const QUANTUM: f32 = 8191.0;
const PAIRS: usize = DESCRIPTOR_LEN / 2;
const LANES: usize = 8;
/// Queries compared with a block per step.
const QUERIES: usize = 4;
/// Queries per chunk.
const CHUNK: usize = 32;
/// Score of a missing descriptor.
const NOTHING: i32 = i32::MIN / 2;

/// Parameters of the matching.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchParams {
    /// Largest ratio of the best to the second-best distance (Lowe 2004); 1 or more accepts all.
    pub ratio: f32,
    /// Keeps a pair only when each is the other's best.
    pub mutual: bool,
    /// Compares only keypoints whose Laplacians have the same sign.
    pub same_sign: bool,
}

impl Default for MatchParams {
    fn default() -> Self {
        Self { ratio: 0.75, mutual: true, same_sign: true }
    }
}

/// Compares only keypoints that a predicted map brings near each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// Predicted map of right-frame pixels to left-frame pixels.
    pub left_from_right: Homography,
    /// Largest distance in the left frame, in pixels.
    pub radius_px: f32,
    /// Weights of columns and rows in that distance; 0 does not restrict the direction.
    pub weights: [f64; 2],
}

impl Gate {
    /// A circle around each predicted position.
    pub fn circle(left_from_right: Homography, radius_px: f32) -> Self {
        Self { left_from_right, radius_px, weights: [1.0; 2] }
    }

    /// Maps of left and right keypoints to the plane in which the gate is a circle.
    fn maps(&self) -> (Option<Homography>, Homography) {
        let [x, y] = self.weights;
        if self.weights == [1.0; 2] {
            return (None, self.left_from_right);
        }
        let weigh = Homography([x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, 1.0]);
        (Some(weigh), weigh.compose(&self.left_from_right))
    }
}

/// A pair of keypoints.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Match {
    /// Index in the left features.
    pub left: u32,
    /// Index in the right features.
    pub right: u32,
    /// Euclidean distance of the descriptors, 0..=2.
    pub distance: f32,
    /// That distance divided by the second-best one (0 when there is no second).
    pub ratio: f32,
}

/// Matcher with its work memory, reused from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Matcher {
    simd: Simd,
    left: Side,
    right: Side,
    forward: Vec<Nearest>,
    backward: Vec<Nearest>,
}

/// Descriptors of one image: by sign of the Laplacian, in blocks of eight.
#[derive(Clone, Debug, Default)]
struct Side {
    /// Keypoint of each slot; `u32::MAX` for padding.
    index: Vec<u32>,
    /// Descriptors of 64 elements per keypoint: 2 with extended ones.
    parts: usize,
    /// Pairs of 16-bit elements, `parts` arrays for each slot.
    rows: Vec<[i32; PAIRS]>,
    /// The same, eight slots interleaved: `parts` arrays for each block.
    blocks: Vec<[[i32; LANES]; PAIRS]>,
    /// Squared length of each slot's descriptor; very large for padding, which therefore never wins.
    norms: Vec<[i32; LANES]>,
    /// Positions in the left frame, for gating.
    x: Vec<[f32; LANES]>,
    y: Vec<[f32; LANES]>,
    /// First block of the second sign.
    split: usize,
    /// Slot of each keypoint.
    slot: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Nearest {
    slot: u32,
    best: i32,
    second: i32,
}

impl Default for Nearest {
    fn default() -> Self {
        Self { slot: u32::MAX, best: NOTHING, second: NOTHING }
    }
}

impl Side {
    fn fill(&mut self, features: &Features, same_sign: bool, map: Option<&Homography>, sort: bool) {
        let count = features.len().min(features.descriptors.len());
        let parts = features.parts();
        self.parts = parts;
        let keypoints = &features.keypoints;
        for list in [&mut self.index, &mut self.slot] {
            list.clear();
            list.reserve(count + 2 * LANES);
        }
        let negative = |index: &u32| same_sign && keypoints.laplacian[*index as usize] < 0;
        let order =
            |a: &u32, b: &u32| keypoints.y_px[*a as usize].total_cmp(&keypoints.y_px[*b as usize]).then(a.cmp(b));
        self.index.extend((0..count as u32).filter(negative));
        if sort {
            self.index.sort_unstable_by(order);
        }
        self.index.resize(self.index.len().next_multiple_of(LANES), u32::MAX);
        let split = self.index.len();
        self.split = split / LANES;
        self.index.extend((0..count as u32).filter(|index| !negative(index)));
        if sort {
            self.index[split..].sort_unstable_by(order);
        }
        self.index.resize(self.index.len().next_multiple_of(LANES), u32::MAX);

        let blocks = self.index.len() / LANES;
        // Both signs fill up their last block: the most blocks for so many keypoints, whatever their signs.
        let most = count / LANES + 2;
        self.rows.reserve((most * LANES * parts).saturating_sub(self.rows.len()));
        self.blocks.reserve((most * parts).saturating_sub(self.blocks.len()));
        self.norms.reserve(most.saturating_sub(self.norms.len()));
        self.x.reserve(most.saturating_sub(self.x.len()));
        self.y.reserve(most.saturating_sub(self.y.len()));
        self.slot.resize(count, u32::MAX);
        self.rows.resize(blocks * LANES * parts, [0; PAIRS]);
        self.blocks.resize(blocks * parts, [[0; LANES]; PAIRS]);
        self.norms.resize(blocks, [0; LANES]);
        self.x.resize(blocks, [0.0; LANES]);
        self.y.resize(blocks, [0.0; LANES]);
        for (slot, &index) in self.index.iter().enumerate() {
            let (block, lane) = (slot / LANES, slot % LANES);
            let mut norm = 0;
            for part in 0..parts {
                let row = match features.part(index as usize, part) {
                    Some(descriptor) => {
                        let (row, squares) = quantise(descriptor);
                        norm += squares;
                        row
                    }
                    None => [0; PAIRS],
                };
                self.rows[slot * parts + part] = row;
                for (pair, value) in self.blocks[block * parts + part].iter_mut().zip(row) {
                    pair[lane] = value;
                }
            }
            if index as usize >= count {
                self.norms[block][lane] = -NOTHING;
                (self.x[block][lane], self.y[block][lane]) = (f32::NAN, f32::NAN);
                continue;
            }
            self.slot[index as usize] = slot as u32;
            self.norms[block][lane] = norm;
            let place = keypoints.position(index as usize);
            let place = map.map_or(place, |map| map.map(place));
            (self.x[block][lane], self.y[block][lane]) = (place[0] as f32, place[1] as f32);
        }
    }

    /// Blocks that may be compared with the other side's block `block`.
    fn partition(&self, second: bool) -> std::ops::Range<usize> {
        if second { self.split..self.norms.len() } else { 0..self.split }
    }
}

fn quantise(descriptor: &Descriptor) -> ([i32; PAIRS], i32) {
    // Adding this leaves the nearest integer in the low bits of the sum: rounding without a call.
    const MAGIC: f32 = 12_582_912.0;
    let elements = descriptor.0.map(|value| {
        let value = (value * QUANTUM).clamp(-QUANTUM, QUANTUM);
        (value + MAGIC).to_bits() as i32 - MAGIC.to_bits() as i32
    });
    let row = std::array::from_fn(|pair| (elements[2 * pair] & 0xffff) | (elements[2 * pair + 1] << 16));
    (row, elements.iter().map(|value| value * value).sum())
}

impl Matcher {
    /// A matcher on the best instruction set of this machine.
    pub fn new() -> Self {
        Self::default()
    }

    /// A matcher on a chosen instruction set.
    pub fn with_simd(simd: Simd) -> Self {
        Self { simd, ..Self::default() }
    }

    /// Matches `left` with `right`; `out` is replaced, in the order of the left keypoints.
    ///
    /// With a gate only keypoints within its radius compete, also for second best. A lone candidate has no second and
    /// passes the ratio test only inside a gate. Descriptors of different lengths do not match.
    pub fn match_features(
        &mut self,
        left: &Features,
        right: &Features,
        params: &MatchParams,
        gate: Option<&Gate>,
        pool: &dyn Parallel,
        out: &mut Vec<Match>,
    ) {
        out.clear();
        // Sorted by row, whole blocks fall outside a gate.
        let (left_map, right_map) = gate.map_or((None, None), |gate| {
            let (left, right) = gate.maps();
            (left, Some(right))
        });
        self.left.fill(left, params.same_sign, left_map.as_ref(), gate.is_some());
        self.right.fill(right, params.same_sign, right_map.as_ref(), gate.is_some());
        if self.left.parts != self.right.parts {
            return;
        }
        let radius = gate.map(|gate| gate.radius_px.max(0.0));
        let search = if self.left.parts == 1 { nearest::<1> } else { nearest::<2> };
        search(self.simd, &self.left, &self.right, radius, pool, &mut self.forward);
        if params.mutual {
            search(self.simd, &self.right, &self.left, radius, pool, &mut self.backward);
        }
        out.reserve(self.left.slot.len());
        let limit = f64::from(params.ratio.max(0.0)) * f64::from(params.ratio.max(0.0));
        let unit = f64::from(QUANTUM) * f64::from(QUANTUM);
        for (index, &slot) in self.left.slot.iter().enumerate() {
            let Some(found) = self.forward.get(slot as usize).filter(|found| found.best > NOTHING) else {
                continue;
            };
            let norm = self.left.norms[slot as usize / LANES][slot as usize % LANES];
            let best = f64::from((norm - found.best).max(0));
            let has_second = found.second > NOTHING;
            let second = if has_second { f64::from((norm - found.second).max(0)) } else { f64::INFINITY };
            let passes = if has_second {
                params.ratio >= 1.0 || best < limit * second
            } else {
                gate.is_some() || params.ratio >= 1.0
            };
            if !passes || (params.mutual && self.backward[found.slot as usize].slot != slot) {
                continue;
            }
            out.push(Match {
                left: index as u32,
                right: self.right.index[found.slot as usize],
                distance: (best / unit).sqrt() as f32,
                ratio: if second > 0.0 { (best / second).sqrt() as f32 } else { 1.0 },
            });
        }
    }
}

/// For every slot of `queries`, the best and second-best slots of `targets`; both with `PARTS` descriptors per slot.
fn nearest<const PARTS: usize>(
    simd: Simd,
    queries: &Side,
    targets: &Side,
    radius: Option<f32>,
    pool: &dyn Parallel,
    out: &mut Vec<Nearest>,
) {
    let slots = queries.index.len();
    out.resize(slots, Nearest::default());
    let split = queries.split * LANES;
    let shared = SharedMut::new(&mut out[..slots]);
    pool.run(slots.div_ceil(CHUNK), &|chunk| {
        let first = chunk * CHUNK;
        for start in (first..(first + CHUNK).min(slots)).step_by(QUERIES) {
            // Partitions start at whole blocks, so four queries share theirs.
            let range = targets.partition(start >= split);
            // SAFETY: every group of queries belongs to one chunk.
            let out = unsafe { shared.part(start, QUERIES) };
            #[cfg(target_arch = "x86_64")]
            if simd.avx2() {
                // SAFETY: `Simd` allows AVX2 only where the processor has it.
                unsafe { group_avx2::<PARTS>(queries, start, targets, range, radius, out) };
                continue;
            }
            #[cfg(not(target_arch = "x86_64"))]
            let _ = simd;
            group::<PARTS>(queries, start, targets, range, radius, out);
        }
    });
}

/// Best and second best of one query, per lane.
#[derive(Clone, Copy)]
struct Lanes {
    best: [i32; LANES],
    second: [i32; LANES],
    block: [i32; LANES],
}

impl Lanes {
    fn reduce(&self) -> Nearest {
        let mut result = Nearest::default();
        for lane in 0..LANES {
            let (best, slot) = (self.best[lane], self.block[lane] as u32 * LANES as u32 + lane as u32);
            if best > result.best || (best == result.best && best > NOTHING && slot < result.slot) {
                result.second = result.second.max(result.best);
                (result.best, result.slot) = (best, slot);
            } else {
                result.second = result.second.max(best);
            }
            result.second = result.second.max(self.second[lane]);
        }
        result
    }
}

fn group<const PARTS: usize>(
    queries: &Side,
    start: usize,
    targets: &Side,
    range: std::ops::Range<usize>,
    radius: Option<f32>,
    out: &mut [Nearest],
) {
    for (offset, out) in out.iter_mut().enumerate() {
        let slot = start + offset;
        let row = &queries.rows[slot * PARTS..][..PARTS];
        let (x, y) = (queries.x[slot / LANES][slot % LANES], queries.y[slot / LANES][slot % LANES]);
        let mut lanes = Lanes { best: [NOTHING; LANES], second: [NOTHING; LANES], block: [0; LANES] };
        for block in range.clone() {
            for lane in 0..LANES {
                if let Some(radius) = radius {
                    let (dx, dy) = (targets.x[block][lane] - x, targets.y[block][lane] - y);
                    // Padding lies at NaN and is never near.
                    let near = dx * dx + dy * dy <= radius * radius;
                    if !near {
                        continue;
                    }
                }
                let mut dot = 0i32;
                let values = &targets.blocks[block * PARTS..][..PARTS];
                for (pair, query) in values.as_flattened().iter().zip(row.as_flattened()) {
                    let halves = |value: i32| (i32::from(value as i16), value >> 16);
                    let ((a, b), (c, d)) = (halves(pair[lane]), halves(*query));
                    dot += a * c + b * d;
                }
                let score = 2 * dot - targets.norms[block][lane];
                lanes.second[lane] = lanes.second[lane].max(score.min(lanes.best[lane]));
                if score > lanes.best[lane] {
                    lanes.best[lane] = score;
                    lanes.block[lane] = block as i32;
                }
            }
        }
        *out = lanes.reduce();
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn group_avx2<const PARTS: usize>(
    queries: &Side,
    start: usize,
    targets: &Side,
    range: std::ops::Range<usize>,
    radius: Option<f32>,
    out: &mut [Nearest],
) {
    use std::arch::x86_64::*;
    let rows: [&[[i32; PAIRS]; PARTS]; QUERIES] = {
        let (rows, _) = queries.rows[start * PARTS..].as_chunks();
        std::array::from_fn(|query| &rows[query])
    };
    let (blocks, _) = targets.blocks.as_chunks::<PARTS>();
    let place = |query: usize| {
        let slot = start + query;
        (queries.x[slot / LANES][slot % LANES], queries.y[slot / LANES][slot % LANES])
    };
    let nothing = _mm256_set1_epi32(NOTHING);
    let mut best = [nothing; QUERIES];
    let mut second = [nothing; QUERIES];
    let mut chosen = [_mm256_setzero_si256(); QUERIES];
    // SAFETY: each array is eight elements of four bytes.
    let load = |lanes: &[i32; LANES]| unsafe { _mm256_loadu_si256(lanes.as_ptr().cast()) };
    // SAFETY: each array is eight floats of four bytes.
    let load_f32 = |lanes: &[f32; LANES]| unsafe { _mm256_loadu_ps(lanes.as_ptr()) };
    let all = _mm256_set1_epi32(-1);
    for block in range {
        let mut inside = [all; QUERIES];
        if let Some(radius) = radius {
            let (x, y) = (load_f32(&targets.x[block]), load_f32(&targets.y[block]));
            let limit = _mm256_set1_ps(radius * radius);
            let mut any = _mm256_setzero_ps();
            for query in 0..QUERIES {
                let (qx, qy) = place(query);
                let (dx, dy) = (_mm256_sub_ps(x, _mm256_set1_ps(qx)), _mm256_sub_ps(y, _mm256_set1_ps(qy)));
                let squared = _mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy));
                let near = _mm256_cmp_ps::<_CMP_LE_OQ>(squared, limit);
                inside[query] = _mm256_castps_si256(near);
                any = _mm256_or_ps(any, near);
            }
            if _mm256_movemask_ps(any) == 0 {
                continue;
            }
        }
        let mut dots = [_mm256_setzero_si256(); QUERIES];
        for (part, values) in blocks[block].iter().enumerate() {
            let rows: [&[i32; PAIRS]; QUERIES] = std::array::from_fn(|query| &rows[query][part]);
            for pair in 0..PAIRS {
                let target = load(&values[pair]);
                for query in 0..QUERIES {
                    let product = _mm256_madd_epi16(target, _mm256_set1_epi32(rows[query][pair]));
                    dots[query] = _mm256_add_epi32(dots[query], product);
                }
            }
        }
        let norm = load(&targets.norms[block]);
        let number = _mm256_set1_epi32(block as i32);
        for query in 0..QUERIES {
            let twice = _mm256_add_epi32(dots[query], dots[query]);
            let score = _mm256_blendv_epi8(nothing, _mm256_sub_epi32(twice, norm), inside[query]);
            let better = _mm256_cmpgt_epi32(score, best[query]);
            second[query] = _mm256_max_epi32(second[query], _mm256_min_epi32(score, best[query]));
            chosen[query] = _mm256_blendv_epi8(chosen[query], number, better);
            best[query] = _mm256_max_epi32(best[query], score);
        }
    }
    for (query, out) in out.iter_mut().enumerate().take(QUERIES) {
        let mut lanes = Lanes { best: [0; LANES], second: [0; LANES], block: [0; LANES] };
        // SAFETY: each array is eight elements of four bytes.
        unsafe {
            _mm256_storeu_si256(lanes.best.as_mut_ptr().cast(), best[query]);
            _mm256_storeu_si256(lanes.second.as_mut_ptr().cast(), second[query]);
            _mm256_storeu_si256(lanes.block.as_mut_ptr().cast(), chosen[query]);
        }
        *out = lanes.reduce();
    }
}
