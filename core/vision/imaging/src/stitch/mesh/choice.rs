//! The view that shows each instrument, and a change of the view without a jump.
//!
//! The panorama shows an instrument at its position in the reference view or, displaced by its parallax, at that in the
//! other view. Before the reference view shows it, its image in the other view glides to its position in the reference
//! view; after the other view has begun to show it, its image glides back from there.

use super::instruments::{Arrangement, Instruments, JOINT_PX, MAX_INSTRUMENTS};
use super::kept::Kept;
use super::observe::Observations;
use super::track::{BAND_PX, BANDS, BORDER_PX, MIN_CUT};
use crate::geometry::Point;

/// Distance from the border of the other view, px of a view of 640 columns, below which an instrument that the border of the
/// reference view cuts off glides to the reference view, so that its tip is not cut off as well; thin tips are unmatched.
const START_PX: f64 = 96.0;
/// The same for one that both views show completely.
const START_WHOLE_PX: f64 = 24.0;
/// Distance above which it returns to the other view.
const RETURN_PX: f64 = BAND_PX * BANDS as f64;
/// Frames in which an instrument that does not move glides from one position to the other, and the fastest glide.
const GLIDE_FRAMES: f64 = 16.0;
const MIN_GLIDE_FRAMES: f64 = 8.0;
/// Frames in which the continuation of one that the reference view shows glides back: a shaft looks the same along itself.
const RETURN_FRAMES: f64 = 5.0;
/// Consecutive frames in which the reference view must be better before a glide starts: single wrong matches start none.
const START_FRAMES: u32 = 3;
/// Share of the way from which the reference view is prepared to show it.
const PREPARED: f64 = 0.5;
/// Consecutive frames in which the other view must be better before it shows the instrument.
const SWITCH_FRAMES: u32 = 8;
/// Minimum number of matched cells that determine the parallax of an instrument.
const MIN_MATCHED: f64 = 12.0;
/// Length of an instrument below which its parallax counts as constant, and the maximum change of parallax per length.
const MIN_LENGTH_PX: f64 = 24.0;
const MAX_SLANT: f64 = 0.6;

/// Position and direction of an instrument in the reference view.
#[derive(Clone, Copy, Debug, Default)]
struct Axis {
    /// Number of cells; 0 without an instrument.
    cells: f64,
    /// Centre, px.
    centre: Point,
    /// Unit vector.
    along: Point,
}

impl Instruments {
    /// Chooses the view that shows each instrument: the one that does not cut it off, and else the one that showed it
    /// before.
    pub(super) fn choose(&mut self, observations: &Observations, how: &Arrangement) {
        let axis = how.axis();
        let axes = self.axes();
        let (joints, ends) = (self.joints(observations, how), self.ends(observations, how, &axes));
        let [low, high] = how.shared[axis];
        let middle_px = 0.5 * (low + high + 1) as f64 * self.cell_px as f64;
        for (index, track) in self.tracks.iter_mut().enumerate() {
            track.jumps = false;
            let Axis { cells, centre, along } = axes[index];
            // What was not found in this frame stays as it is.
            if cells == 0.0 || (track.missing_frames > 0 && track.view != Kept::Free) {
                continue;
            }
            track.ends = ends[index].or(track.ends);
            let cut = self.cuts[index];
            let (by_reference, clear_px) = (cut.is_by_reference(), cut.clear_px());
            track.slope = by_reference.then(|| (along[1 - axis] / along[axis]).clamp(-1.5, 1.5));
            let start_px = if by_reference { START_PX } else { START_WHOLE_PX };
            let has_started = track.view == Kept::Reference || (by_reference && track.glide > 0.0);
            let by_other = clear_px < if has_started { RETURN_PX } else { start_px };
            let joint = joints[index].or(track.joint).filter(|_| by_reference && by_other);
            let is_beyond_middle = (centre[axis] > middle_px) == how.is_beyond_end();
            let wanted = match (by_reference, by_other, track.view) {
                _ if joint.is_some() => Kept::Reference,
                (true, false, _) | (true, true, Kept::Free) => Kept::Other,
                (false, true, _) => Kept::Reference,
                (false, false, Kept::Free) if is_beyond_middle => Kept::Other,
                (_, _, Kept::Free) => Kept::Reference,
                (_, _, view) => view,
            };
            let is_pending = track.view != Kept::Free && wanted != track.view;
            track.pending_frames = if is_pending { track.pending_frames + 1 } else { 0 };
            let before = track.view;
            match (before, wanted) {
                (Kept::Other, Kept::Reference) => {
                    if track.pending_frames >= START_FRAMES {
                        let due = (start_px - clear_px) / (start_px - BORDER_PX);
                        let step = (due - track.glide).clamp(1.0 / GLIDE_FRAMES, 1.0 / MIN_GLIDE_FRAMES);
                        track.glide = (track.glide + step).min(1.0);
                    }
                    if track.glide >= 1.0 {
                        (track.view, track.joint) = (wanted, joint);
                    }
                }
                (Kept::Reference, Kept::Other) => {
                    if track.pending_frames > SWITCH_FRAMES {
                        (track.view, track.joint, track.glide, track.jumps) = (wanted, None, 1.0, true);
                        track.matched = None;
                    }
                }
                _ => {
                    let frames = if before == Kept::Reference { RETURN_FRAMES } else { GLIDE_FRAMES };
                    track.glide = (track.glide - 1.0 / frames).max(0.0);
                    track.jumps = joint.is_some() && track.joint.is_none();
                    if track.jumps {
                        track.glide = 0.0;
                    }
                    (track.view, track.joint) = (wanted, joint);
                }
            }
            // While it is displaced by its whole parallax, the rest can change unseen.
            if track.view != before || track.jumps {
                (track.shift, track.pending_frames) = (None, 0);
            }
        }
    }

    /// Whether the mesh of the reference view must be rigid at an instrument.
    pub(super) fn is_for_reference(&self, number: usize) -> bool {
        let track = self.track(number);
        track.view == Kept::Reference || (track.view == Kept::Other && track.glide > PREPARED)
    }

    /// Position and direction of each instrument.
    fn axes(&self) -> [Axis; MAX_INSTRUMENTS] {
        // Count, first and second moments.
        let mut sums = [[0.0f64; 6]; MAX_INSTRUMENTS];
        for (cell, label) in self.own.iter().enumerate().filter(|(_, label)| **label != 0) {
            let (x, y) = ((cell % self.columns) as f64, (cell / self.columns) as f64);
            let terms = [1.0, x, y, x * x, x * y, y * y];
            sums[*label as usize - 1].iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        }
        sums.map(|[cells, x, y, xx, xy, yy]| {
            if cells == 0.0 {
                return Axis::default();
            }
            let turn = 0.5 * (2.0 * (xy - x * y / cells)).atan2(xx - x * x / cells - (yy - y * y / cells));
            let centre = [x, y].map(|sum| (sum / cells + 0.5) * self.cell_px as f64);
            Axis { cells, centre, along: [turn.cos(), turn.sin()] }
        })
    }

    /// Two places on the axis of each instrument, px, and the same in the other view, by the linear change of its
    /// displacement along the axis; `None` if too little of it is matched.
    fn ends(
        &self,
        observations: &Observations,
        how: &Arrangement,
        axes: &[Axis; MAX_INSTRUMENTS],
    ) -> [Option<[[Point; 2]; 2]>; MAX_INSTRUMENTS] {
        // Count, position along the axis, its square, displacement, and its product with the position.
        let mut sums = [[0.0f64; 7]; MAX_INSTRUMENTS];
        for (cell, label) in self.sure.iter().enumerate().filter(|(_, label)| **label != 0) {
            let seen = &observations.cells[cell];
            if seen.weight != 0.0 {
                let index = *label as usize - 1;
                let Axis { centre, along, .. } = axes[index];
                let t = along[0] * (seen.at[0] - centre[0]) + along[1] * (seen.at[1] - centre[1]);
                let [dx, dy] = [0, 1].map(|k| seen.source[k] - seen.at[k]);
                let terms = [1.0, t, t * t, dx, dy, t * dx, t * dy];
                sums[index].iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
            }
        }
        std::array::from_fn(|index| {
            let [count, t, tt, dx, dy, tdx, tdy] = sums[index];
            let Axis { centre, along, .. } = axes[index];
            if count < MIN_MATCHED {
                return None;
            }
            let (middle, spread) = (t / count, tt / count - (t / count).powi(2));
            let held = spread + (MIN_LENGTH_PX * how.scale).powi(2);
            let slant = [(dx, tdx), (dy, tdy)]
                .map(|(d, td)| ((td / count - middle * d / count) / held).clamp(-MAX_SLANT, MAX_SLANT));
            let place = |off: f64| {
                let here = [0, 1].map(|k| centre[k] + along[k] * (middle + off));
                [here, [0, 1].map(|k| here[k] + [dx, dy][k] / count + slant[k] * off)]
            };
            Some([-held.sqrt(), held.sqrt()].map(place))
        })
    }

    /// Mean positions in both views, px, of what is matched of each instrument next to the border of the reference view; `None` where nothing is.
    fn joints(&self, observations: &Observations, how: &Arrangement) -> [Option<[Point; 2]>; MAX_INSTRUMENTS] {
        let reach = (JOINT_PX * how.scale / self.cell_px as f64) as usize + 1;
        let mut sums = [([[0.0f64; 2]; 2], 0usize); MAX_INSTRUMENTS];
        for (cell, label) in self.sure.iter().enumerate().filter(|(_, label)| **label != 0) {
            let seen = &observations.cells[cell];
            let place = [cell % self.columns, cell / self.columns];
            if seen.weight != 0.0 && self.is_near_border(place, reach, how) {
                let (sum, count) = &mut sums[*label as usize - 1];
                sum.iter_mut().flatten().zip(seen.at.into_iter().chain(seen.source)).for_each(|(sum, v)| *sum += v);
                *count += 1;
            }
        }
        sums.map(|(sum, count)| (count >= MIN_CUT).then(|| sum.map(|point| point.map(|v| v / count as f64))))
    }
}
