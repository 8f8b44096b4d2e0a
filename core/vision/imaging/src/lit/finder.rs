//! Finds the lit part of a view from its frames.
//!
//! A rim is dark in all frames, touches the border of the view, and ends in a sharp, smooth, convex line. Dark tissue
//! has none of these properties for long. From each border the finder walks inwards along rows and columns to the first
//! run of pixels that are brighter than the rim, and keeps the nearest such run of all frames. The lit part is the
//! convex hull of these ends. A side whose ends are mostly without a step, or far from the hull, has no rim and is lit
//! up to the border. So a part that was lit once stays lit, and darkness counts as a rim only if it has the shape of
//! one. A frame without light is ignored.

use super::LitPart;
use crate::View;

/// Minimum levels above the rim's of a lit pixel.
const LIT_LEVELS: u32 = 12;
/// Minimum step in levels at the edge of a rim; other darkness changes more slowly.
const STEP_LEVELS: u32 = 16;
/// Maximum level of a rim.
const BRIGHTEST_RIM: u32 = 40;
/// Pixels in a row that must be lit, at a width of 640 px. Artefact lines along a border are narrower.
const RUN_PX: usize = 6;
/// Pixels on each side of an edge whose means are compared, at a width of 640 px.
const REACH_PX: usize = 6;
/// Maximum distance from the hull of ends that agree with it, at a width of 640 px.
const NEAR_PX: usize = 3;
/// Margin of the lit part inside the ends, at a width of 640 px: light rises there, and chroma subsampling tints it.
const MARGIN_PX: usize = 5;
/// Share of the ends of a side that must have a step, and lie near the hull, in percent.
const SIDE_PERCENT: usize = 50;
/// One of this many lines is read in each frame.
const LINE_STEP: usize = 4;
/// Number of first frames in which all lines are read.
const FIRST_FRAMES: u32 = 2;
/// Frames after which old ends are dropped, because a coupler may have been turned or zoomed.
const WINDOW_FRAMES: u32 = 1800;
/// Frames from one computation to the next.
const COMPUTE_FRAMES: u32 = 8;
/// Share of the lines that must have light in a frame that counts, in percent.
const LIGHT_PERCENT: usize = 25;
/// Minimum lit share of a view; below it the result is unknown.
const MIN_SHARE: f64 = 0.1;
/// Distance from the border at which the rim's level is measured: beyond artefact lines of video devices.
const LEVEL_INSET_PX: usize = 4;
/// No light was seen along a line.
const DARK: u32 = u32::MAX;

/// First lit position on a line from the border.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct End {
    /// Pixels from the border, or [`DARK`].
    at: u32,
    /// Whether there is a step.
    is_sharp: bool,
}

const UNKNOWN: End = End { at: DARK, is_sharp: false };

impl End {
    /// Keeps the end that is nearer to the border. Returns whether anything changed.
    fn merge(&mut self, new: End, near: u32) -> bool {
        if new.at == DARK || (self.at != DARK && new.at > self.at.saturating_add(near)) {
            return false;
        }
        let joined = if self.at == DARK || new.at.saturating_add(near) < self.at {
            new
        } else {
            End { at: self.at.min(new.at), is_sharp: self.is_sharp || new.is_sharp }
        };
        std::mem::replace(self, joined) != joined
    }
}

/// Ends of the lines from the left, right, upper and lower border.
type Sides = [Vec<End>; 4];

/// Finds the lit part of one view. Work per frame is a walk over a quarter of the rim.
#[derive(Clone, Debug, Default)]
pub struct LitFinder {
    size: (usize, usize),
    /// Frames with light in the present window.
    frames: u32,
    /// The present window and the one before it.
    windows: [Sides; 2],
    /// This frame's.
    seen: Sides,
    ring: Vec<u8>,
    /// Whether all ends of this frame are at the border and are in the window.
    is_open: bool,
    /// Whether ends have changed since the part was computed.
    is_due: bool,
    part: LitPart,
    raw: LitPart,
    hull: Vec<(u32, u32)>,
}

/// Brightest channel of a pixel.
fn level(view: &View<'_, u8>, x: usize, y: usize) -> u32 {
    let at = y * view.stride + x * view.channels;
    view.data[at..at + view.channels].iter().copied().max().map_or(0, u32::from)
}

/// Walks a line of `length` pixels from its start on to the first run of `run` pixels of at least `lit`. Looks at the last
/// pixel of a run first: a dark one excludes all runs across it, so that a rim is crossed in steps of `run`.
fn walk(length: usize, run: usize, reach: usize, lit: u32, level: impl Fn(usize) -> u32) -> End {
    let mut at = 0;
    while at + run <= length {
        if let Some(dark) = (at..at + run).rev().find(|i| level(*i) < lit) {
            at = dark + 1;
            continue;
        }
        let mean = |from: usize, to: usize| (from..to).map(&level).sum::<u32>() / (to - from).max(1) as u32;
        let inside = mean(at + 1, (at + 1 + reach).min(length));
        let outside = mean(at.saturating_sub(reach + 2), at.saturating_sub(2));
        return End { at: at as u32, is_sharp: at > 2 && inside >= outside + STEP_LEVELS };
    }
    UNKNOWN
}

impl LitFinder {
    /// The lit part found so far; empty before the first frame.
    pub fn part(&self) -> &LitPart {
        &self.part
    }

    /// A length that is given for a width of 640 px.
    fn scaled(&self, px: usize) -> usize {
        (px * self.size.0 / 640).max(px.div_ceil(2))
    }

    /// Adds a frame, gray or BGR. Outside `valid` the view is black by construction. Returns whether the lit part has
    /// changed.
    pub fn look(&mut self, view: View<'_, u8>, valid: Option<&LitPart>) -> bool {
        self.look_at((view.width, view.height), |x, y| level(&view, x, y), valid)
    }

    /// As [`LitFinder::look`], for a frame of `size` px whose brightest channels `level` gives, by column and row. It asks
    /// for few of them.
    pub fn look_at(
        &mut self,
        size: (usize, usize),
        level: impl Fn(usize, usize) -> u32,
        valid: Option<&LitPart>,
    ) -> bool {
        let mut is_new = false;
        if size != self.size {
            self.restart(size);
            is_new = true;
        }
        if size.0 < 16 || size.1 < 16 {
            return is_new;
        }
        let rim = self.rim_level(&level);
        let lines = if self.frames < FIRST_FRAMES { 0..LINE_STEP } else { 0..1 };
        let mut changed = is_new;
        if rim > BRIGHTEST_RIM {
            // Lit up to its border.
            if !std::mem::replace(&mut self.is_open, true) {
                self.seen.iter_mut().for_each(|side| side.fill(End { at: 0, is_sharp: false }));
                changed |= self.merge();
            }
        } else {
            self.is_open = false;
            self.seen.iter_mut().for_each(|side| side.fill(UNKNOWN));
            let first = self.frames as usize % LINE_STEP;
            let mut count = [0; 2];
            for line in lines {
                let found = self.walk_lines(&level, (first + line) % LINE_STEP, rim + LIT_LEVELS);
                count = [count[0] + found[0], count[1] + found[1]];
            }
            if count[0] * 100 < count[1] * LIGHT_PERCENT {
                // Nothing is known yet but what the camera covers.
                if is_new {
                    self.compute(valid);
                }
                return is_new;
            }
            changed |= self.merge();
        }
        self.frames += 1;
        if self.frames >= WINDOW_FRAMES {
            self.frames = FIRST_FRAMES;
            self.windows.swap(0, 1);
            self.windows[0].iter_mut().for_each(|side| side.fill(UNKNOWN));
            self.windows[0].clone_from(&self.seen);
            changed = true;
        }
        self.is_due |= changed;
        let is_due = self.is_due && (self.frames <= FIRST_FRAMES || self.frames.is_multiple_of(COMPUTE_FRAMES));
        is_due && self.compute(valid) || is_new
    }

    /// Forgets all frames.
    pub fn forget(&mut self) {
        self.size = (0, 0);
    }

    fn restart(&mut self, size: (usize, usize)) {
        self.size = size;
        (self.frames, self.is_open) = (0, false);
        for sides in self.windows.iter_mut().chain([&mut self.seen]) {
            for (index, side) in sides.iter_mut().enumerate() {
                side.clear();
                side.resize(if index < 2 { size.1 } else { size.0 }, UNKNOWN);
            }
        }
        self.part = LitPart::whole(size.0, size.1);
    }

    /// The darkest tenth of the pixels along the border.
    fn rim_level(&mut self, level: &impl Fn(usize, usize) -> u32) -> u32 {
        let (width, height) = self.size;
        self.ring.clear();
        let (right, bottom) = (width - 1 - LEVEL_INSET_PX, height - 1 - LEVEL_INSET_PX);
        for x in (LEVEL_INSET_PX..=right).step_by(4) {
            self.ring.extend([LEVEL_INSET_PX, bottom].map(|y| level(x, y) as u8));
        }
        for y in (LEVEL_INSET_PX..=bottom).step_by(4) {
            self.ring.extend([LEVEL_INSET_PX, right].map(|x| level(x, y) as u8));
        }
        let tenth = self.ring.len() / 10;
        u32::from(*self.ring.select_nth_unstable(tenth).1)
    }

    /// Walks every [`LINE_STEP`]th row and column from both ends. Returns the number of lines with light, and the
    /// number of lines.
    fn walk_lines(&mut self, level: &impl Fn(usize, usize) -> u32, first: usize, lit: u32) -> [usize; 2] {
        let (width, height) = self.size;
        let (run, reach) = (self.scaled(RUN_PX), self.scaled(REACH_PX));
        let mut count = [0; 2];
        for y in (first..height).step_by(LINE_STEP) {
            self.seen[0][y] = walk(width, run, reach, lit, |i| level(i, y));
            if self.seen[0][y] != UNKNOWN {
                self.seen[1][y] = walk(width, run, reach, lit, |i| level(width - 1 - i, y));
                count[0] += 1;
            }
            count[1] += 1;
        }
        for x in (first..width).step_by(LINE_STEP) {
            self.seen[2][x] = walk(height, run, reach, lit, |i| level(x, i));
            if self.seen[2][x] != UNKNOWN {
                self.seen[3][x] = walk(height, run, reach, lit, |i| level(x, height - 1 - i));
                count[0] += 1;
            }
            count[1] += 1;
        }
        count
    }

    /// Adds this frame's ends to the present window. Returns whether any changed.
    fn merge(&mut self) -> bool {
        let near = self.scaled(NEAR_PX) as u32;
        let mut changed = false;
        for (held, seen) in self.windows[0].iter_mut().zip(&self.seen) {
            for (held, seen) in held.iter_mut().zip(seen) {
                changed |= held.merge(*seen, near);
            }
        }
        changed
    }

    /// The end of a line over both windows.
    fn end(&self, side: usize, line: usize) -> End {
        let [now, before] = &self.windows;
        let mut end = before[side][line];
        end.merge(now[side][line], self.scaled(NEAR_PX) as u32);
        end
    }

    /// Computes the lit part from the ends. Returns whether it has changed.
    fn compute(&mut self, valid: Option<&LitPart>) -> bool {
        let (width, height) = self.size;
        self.is_due = false;
        let mut is_rim = [0, 1, 2, 3].map(|side| self.has_steps(side));
        while is_rim.contains(&true) {
            self.take_hull(is_rim);
            let Some(wrong) = (0..4).find(|side| is_rim[*side] && !self.agrees(*side)) else { break };
            is_rim[wrong] = false;
        }
        let mut raw = std::mem::take(&mut self.raw);
        let mut part = LitPart::default();
        if is_rim.contains(&true) && raw.share() >= MIN_SHARE {
            raw.inset(self.scaled(MARGIN_PX), &mut part);
        } else {
            raw = LitPart::whole(width, height);
            part.clone_from(&raw);
        }
        self.raw = raw;
        if let Some(valid) = valid.filter(|valid| valid.size() == self.size) {
            part.intersect(valid);
        }
        let changed = part != self.part;
        self.part = part;
        changed
    }

    /// Whether most ends of a side that are not at the border have a step.
    fn has_steps(&self, side: usize) -> bool {
        let lines = self.windows[0][side].len();
        let ends = (0..lines).map(|line| self.end(side, line)).filter(|end| end.at != DARK && end.at > 2);
        let (count, sharp) = ends.fold((0, 0), |(count, sharp), end| (count + 1, sharp + usize::from(end.is_sharp)));
        count > 0 && sharp * 100 >= count * SIDE_PERCENT
    }

    /// Columns of a row between the ends of the given sides, above and below included.
    fn open_row(&self, y: usize, is_rim: [bool; 4]) -> Option<(u32, u32)> {
        let (width, height) = self.size;
        let at = |side: usize, line: usize| match self.end(side, line).at {
            DARK => None,
            _ if !is_rim[side] => Some(0),
            at => Some(at as usize),
        };
        let (mut start, mut end) = (at(0, y)?, width - at(1, y)?);
        // Lines that video devices make along a border are bright along rows or along columns alone.
        let is_open = |x: usize| at(2, x).is_some_and(|top| y >= top) && at(3, x).is_some_and(|low| y + low < height);
        while start < end && !is_open(start) {
            start += 1;
        }
        while start < end && !is_open(end - 1) {
            end -= 1;
        }
        (start < end).then_some((start as u32, end as u32))
    }

    /// Sets `raw` to the convex hull of what lies between the ends.
    fn take_hull(&mut self, is_rim: [bool; 4]) {
        let (width, height) = self.size;
        let open: Vec<Option<(u32, u32)>> = (0..height).map(|y| self.open_row(y, is_rim)).collect();
        self.raw = LitPart::whole(width, height);
        let bounds = |from: &dyn Fn((u32, u32)) -> u32, hull: &mut Vec<(u32, u32)>| -> Vec<u32> {
            hull.clear();
            for (y, row) in open.iter().enumerate() {
                let Some(row) = row else { continue };
                let point = (y as u32, from(*row));
                // The last point goes when it lies on or above the line from the one before to the new one.
                while let [.., a, b] = hull[..] {
                    let slope = |p: (u32, u32)| (i64::from(p.0) - i64::from(a.0), i64::from(p.1) - i64::from(a.1));
                    let ((by, bx), (cy, cx)) = (slope(b), slope(point));
                    if bx * cy < cx * by {
                        break;
                    }
                    hull.pop();
                }
                hull.push(point);
            }
            let mut out = vec![DARK; height];
            for pair in hull.windows(2) {
                let [(ya, xa), (yb, xb)] = [pair[0], pair[1]];
                for y in ya..=yb {
                    let share = f64::from(y - ya) / f64::from(yb - ya);
                    out[y as usize] = (f64::from(xa) + share * (f64::from(xb) - f64::from(xa))).ceil() as u32;
                }
            }
            out
        };
        let width = width as u32;
        let mut hull = std::mem::take(&mut self.hull);
        let starts = bounds(&|(start, _)| start, &mut hull);
        let ends = bounds(&|(_, end)| width - end, &mut hull);
        self.hull = hull;
        for (y, (start, end)) in starts.into_iter().zip(ends).enumerate() {
            let columns = if start == DARK { 0..0 } else { start as usize..(width - end) as usize };
            self.raw.set_row(y, columns);
        }
    }

    /// Whether most ends of a side lie near the hull.
    fn agrees(&self, side: usize) -> bool {
        let (width, height) = self.size;
        let near = self.scaled(NEAR_PX) as i64;
        let (mut count, mut good) = (0, 0);
        let mut check = |line: usize, hull: Option<usize>| {
            let end = self.end(side, line);
            if end.at != DARK && end.at > 2 {
                count += 1;
                good += usize::from(hull.is_some_and(|hull| (hull as i64 - i64::from(end.at)).abs() <= near));
            }
        };
        if side < 2 {
            for y in 0..height {
                let row = self.raw.row(y);
                let hull = if side == 0 { row.start } else { width - row.end };
                check(y, (!row.is_empty()).then_some(hull));
            }
        } else {
            // The rows that the hull covers so far are one run of columns.
            let mut covered = 0..0;
            let mut hull = vec![None; width];
            for line in 0..height {
                let row = self.raw.row(if side == 2 { line } else { height - 1 - line });
                if row.is_empty() {
                    continue;
                }
                if covered.is_empty() {
                    covered = row.start..row.start;
                }
                hull[row.start.min(covered.start)..covered.start].fill(Some(line));
                hull[covered.end..row.end.max(covered.end)].fill(Some(line));
                covered = row.start.min(covered.start)..row.end.max(covered.end);
            }
            (0..width).for_each(|x| check(x, hull[x]));
        }
        good * 100 >= count * SIDE_PERCENT
    }
}

#[cfg(test)]
mod tests;
