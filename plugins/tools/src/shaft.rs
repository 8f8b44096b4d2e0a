//! Finds where an instrument ends: from its mask along the shaft's axis, or from its box alone.

mod axis;
mod mask;
mod moments;

pub use axis::ShaftAxis;
pub use mask::Mask;
pub(crate) use moments::Moments;

use mask::{BORDER_GAP_PX, Contact};

/// An end of an instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct End {
    /// Column, px.
    pub u_px: f64,
    /// Row, px.
    pub v_px: f64,
    /// Unit vector from the instrument's inside towards this end.
    pub direction: [f64; 2],
}

/// A tip in px of the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipPixel {
    /// The tip; between open jaws the middle of both ends.
    pub tip: End,
    /// The ends of open jaws.
    pub jaws: Option<[End; 2]>,
}

/// Length along the axis over which the end is averaged, px, because the outermost pixel alone is noisy.
const END_PX: f64 = 2.0;
/// Final share of the length over which the middle between both sides is computed.
const END_SHARE: f64 = 0.08;
/// Ratio of variances above which a mask's own direction is used if it agrees with its entry; a wider mask points away from its entry.
const LONG: f64 = 6.0;
/// Ratio of variances above which its own direction is always used, as for a shaft along the border.
const VERY_LONG: f64 = 20.0;
/// Maximum number of lines across the axis into which a mask is divided.
const MAX_LINES: f64 = 256.0;
/// Parts of a mask with less than this share of its pixels are not instruments.
const SPECK_SHARE: f64 = 0.1;
/// Parts that begin within this share of a mask's length enter from outside.
const ENTRY_SHARE: f64 = 0.15;
/// Minimum length of the shorter jaw: as a share of the longer one, and in px. Shorter parts are roughness of the outline.
const JAW_SHARE: f64 = 0.35;
const JAW_PX: f64 = 5.0;
/// Minimum cosine between the directions of jaws that enter apart from each other.
const JAWS_AGREE: f64 = 0.5;

/// A run of mask pixels on one line across the axis, in steps.
#[derive(Clone, Copy, Debug)]
struct Run {
    from: u32,
    to: u32,
    line: u32,
    branch: u32,
}

/// A branch from one end of a mask to where it merges into a longer branch.
#[derive(Clone, Copy, Debug)]
struct Branch {
    end_line: u32,
    /// The longer branch into which it merges, or itself.
    owner: u32,
    /// Line where it merges; its own start if it does not.
    fork_line: u32,
    /// Number of steps in its runs.
    size: f64,
}

/// What is known of the last mask.
#[derive(Clone, Copy, Debug)]
struct LastMask {
    lines: Lines,
    /// Line of its end, and the line where its jaws part.
    end_line: u32,
    fork_line: Option<u32>,
}

/// Finds tips; reuses its buffers.
#[derive(Debug, Default)]
pub struct TipFinder {
    runs: Vec<Run>,
    /// Index of the first run of each line.
    starts: Vec<u32>,
    branches: Vec<Branch>,
    last: Option<LastMask>,
    /// Centres of the shaft, and whether they determine its axis; their distances from the axis, px.
    middles: Vec<([f64; 2], bool)>,
    off_px: Vec<f64>,
}

/// The lines across a mask: point `(line, step)` is at `from + line * pitch * axis + step * pitch * across`.
#[derive(Clone, Copy, Debug)]
struct Lines {
    from: [f64; 2],
    axis: [f64; 2],
    pitch: f64,
    lines: usize,
    steps: usize,
}

impl Lines {
    /// Line and step of a point of the image.
    fn locate(&self, [x, y]: [f64; 2]) -> (f64, f64) {
        let ([ax, ay], x, y) = (self.axis, x - self.from[0], y - self.from[1]);
        ((x * ax + y * ay) / self.pitch, (y * ax - x * ay) / self.pitch)
    }

    fn place(&self, line: f64, step: f64) -> [f64; 2] {
        let (along, aside) = (line * self.pitch, step * self.pitch);
        let [ax, ay] = self.axis;
        [self.from[0] + along * ax - aside * ay, self.from[1] + along * ay + aside * ax]
    }
}

fn unit(v: [f64; 2]) -> Option<[f64; 2]> {
    let long = v[0].hypot(v[1]);
    (long > 1e-9).then(|| [v[0] / long, v[1] / long])
}

impl TipFinder {
    /// The tip of a mask.
    ///
    /// The instrument enters where the mask touches the image border most, or, if it does not, on the side nearer to the border. The shaft's axis is
    /// the mask's main direction, or for a wide mask (a bag, open jaws) the line from the entry through the mask's centre. The tip is where the mask
    /// ends on the other side, in the middle of its end; if it forks there into two jaws, the middle of both ends. `None` for an empty mask.
    pub fn of_mask(&mut self, mask: Mask<'_>) -> Option<TipPixel> {
        self.of_mask_towards(mask, None)
    }

    /// As [`Self::of_mask`], for an instrument whose approximate direction is known, whatever its mask touches.
    pub fn of_mask_towards(&mut self, mask: Mask<'_>, towards: Option<[f64; 2]>) -> Option<TipPixel> {
        let (width, height) = (mask.width as f64, mask.height as f64);
        self.last = None;
        let moments = Moments::of(&mask)?;
        let [cx, cy] = moments.centre;
        let main = moments.main;
        let contacts = mask.contacts();
        let from_entry =
            contacts[0].map(|Contact { centre: [x, y], .. }| [cx - x, cy - y]).filter(|v| v[0].hypot(v[1]) > 1.0);
        let axis = match from_entry.and_then(unit) {
            Some(away) => {
                let agrees = (away[0] * main[0] + away[1] * main[1]).abs() > 0.7;
                if moments.is_longer(VERY_LONG) || (moments.is_longer(LONG) && agrees) { main } else { away }
            }
            None => main,
        };
        let enters_low = match towards.or(from_entry) {
            Some(v) => v[0] * axis[0] + v[1] * axis[1] >= 0.0,
            None => {
                let (low, high) = moments.reach(&mask, axis);
                let from_border = |t: f64| {
                    let (x, y) = (cx + t * axis[0], cy + t * axis[1]);
                    x.min(y).min(width - 1.0 - x).min(height - 1.0 - y)
                };
                from_border(low) <= from_border(high)
            }
        };
        let axis = if enters_low { axis } else { [-axis[0], -axis[1]] };
        let mut lines = self.divide(&mask, &moments, axis);
        let both_jaws =
            if let [Some(one), Some(two)] = contacts { self.jaws_from_outside(&lines, [one, two]) } else { None };
        let both_jaws = both_jaws.filter(|axis| towards.is_none_or(|to| to[0] * axis[0] + to[1] * axis[1] >= 0.0));
        if let Some(axis) = both_jaws {
            lines = self.divide(&mask, &moments, axis);
        }
        let Lines { axis, pitch, from, .. } = lines;
        let low = (from[0] - cx) * axis[0] + (from[1] - cy) * axis[1];
        let (longest, fork) = self.fork(&lines, both_jaws.is_some())?;
        let end_line = self.branches[longest as usize].end_line;
        let mut last = LastMask { lines, end_line, fork_line: None };
        self.last = Some(last);
        if let Some((other, fork_line)) = fork {
            let ends = [longest, other].map(|branch| self.end(&lines, branch, fork_line));
            if let [Some(one), Some(two)] = ends {
                last.fork_line = Some(fork_line);
                self.last = Some(last);
                let (u_px, v_px) = ((one.u_px + two.u_px) / 2.0, (one.v_px + two.v_px) / 2.0);
                return Some(TipPixel { tip: End { u_px, v_px, direction: axis }, jaws: Some([one, two]) });
            }
        }
        // Without a fork: the middle of its last part.
        let end = low + f64::from(end_line) * pitch;
        moments.middle_of_end(&mask, axis, (low, end), pitch)
    }

    /// Divides the mask into branches along an axis that points away from its entry.
    fn divide(&mut self, mask: &Mask<'_>, moments: &Moments, axis: [f64; 2]) -> Lines {
        let [cx, cy] = moments.centre;
        let (low, high) = moments.reach(mask, axis);
        let (left, right) = moments.reach(mask, [-axis[1], axis[0]]);
        let pitch = ((high - low).max(right - left) / MAX_LINES).max(1.0);
        let count = |length: f64| (length / pitch).ceil() as usize + 1;
        let from = [cx + low * axis[0] - left * axis[1], cy + low * axis[1] + left * axis[0]];
        let lines = Lines { from, axis, pitch, lines: count(high - low), steps: count(right - left) };
        self.cut(mask, &lines);
        self.grow();
        lines
    }

    /// The axis between two parts of the mask that enter side by side: jaws whose joint lies outside the image. `None`
    /// if the contacts belong to one part, a part is a speck or lies along the border, or they point apart.
    fn jaws_from_outside(&self, lines: &Lines, contacts: [Contact; 2]) -> Option<[f64; 2]> {
        let parts = contacts.map(|contact| self.part_at(lines, contact.centre));
        let [Some(one), Some(two)] = parts else { return None };
        let all: f64 = self.runs.iter().map(|run| f64::from(run.to - run.from + 1)).sum();
        if one == two || [one, two].iter().any(|part| self.branches[*part as usize].size < SPECK_SHARE * all) {
            return None;
        }
        let inwards = |part: u32, contact: Contact| {
            let [x, y] = self.centre(lines, part)?;
            let away = [x - contact.centre[0], y - contact.centre[1]];
            unit(away).filter(|_| away[0].hypot(away[1]) >= contact.width_px / 2.0)
        };
        let (a, b) = (inwards(one, contacts[0])?, inwards(two, contacts[1])?);
        let agrees = a[0] * b[0] + a[1] * b[1] >= JAWS_AGREE;
        unit([a[0] + b[0], a[1] + b[1]]).filter(|_| agrees)
    }

    /// The part of the mask nearest to a point of the image, within a few lines.
    fn part_at(&self, lines: &Lines, point: [f64; 2]) -> Option<u32> {
        let near = (BORDER_GAP_PX + 1) as f64 / lines.pitch + 1.0;
        let (line, step) = lines.locate(point);
        let distance = |run: &Run| {
            let beside = (f64::from(run.from) - step).max(step - f64::from(run.to)).max(0.0);
            beside.hypot(f64::from(run.line) - line)
        };
        let nearest = self.runs.iter().map(|run| (distance(run), run.branch)).min_by(|a, b| a.0.total_cmp(&b.0))?;
        (nearest.0 <= near).then(|| Self::owner(&self.branches, nearest.1))
    }

    /// The centre of a part.
    fn centre(&self, lines: &Lines, part: u32) -> Option<[f64; 2]> {
        let (mut n, mut line, mut step) = (0.0, 0.0, 0.0);
        for run in self.runs.iter().filter(|run| Self::owner(&self.branches, run.branch) == part) {
            let length = f64::from(run.to - run.from + 1);
            n += length;
            line += length * f64::from(run.line);
            step += length * f64::from(run.from + run.to) / 2.0;
        }
        (n > 0.0).then(|| lines.place(line / n, step / n))
    }

    /// Divides the mask into runs.
    fn cut(&mut self, mask: &Mask<'_>, lines: &Lines) {
        self.runs.clear();
        self.starts.clear();
        for line in 0..lines.lines {
            self.starts.push(self.runs.len() as u32);
            let mut open: Option<u32> = None;
            for step in 0..=lines.steps {
                let [x, y] = lines.place(line as f64, step as f64);
                let (x, y) = (x.round(), y.round());
                let inside = step < lines.steps && x >= 0.0 && y >= 0.0 && mask.contains(x as usize, y as usize);
                match (inside, open) {
                    (true, None) => open = Some(step as u32),
                    (false, Some(from)) => {
                        self.runs.push(Run { from, to: step as u32 - 1, line: line as u32, branch: 0 });
                        open = None;
                    }
                    _ => {}
                }
            }
        }
        self.starts.push(self.runs.len() as u32);
    }

    fn owner(branches: &[Branch], mut branch: u32) -> u32 {
        while branches[branch as usize].owner != branch {
            branch = branches[branch as usize].owner;
        }
        branch
    }

    /// Grows branches from the far end; where two meet, the one that reaches farther continues.
    fn grow(&mut self) {
        let Self { runs, starts, branches, .. } = self;
        branches.clear();
        for line in (0..starts.len().saturating_sub(1)).rev() {
            let here = starts[line] as usize..starts[line + 1] as usize;
            let above = match starts.get(line + 2) {
                Some(end) => starts[line + 1] as usize..*end as usize,
                None => 0..0,
            };
            for index in here {
                let run = runs[index];
                let mut mine: Option<u32> = None;
                for next in &runs[above.clone()] {
                    if next.from > run.to + 1 || run.from > next.to + 1 {
                        continue;
                    }
                    let other = Self::owner(branches, next.branch);
                    let Some(own) = mine.filter(|own| *own != other) else {
                        mine = Some(other);
                        continue;
                    };
                    let reach = |branch: u32| branches[branch as usize].end_line;
                    let (wins, loses) = if reach(other) > reach(own) { (other, own) } else { (own, other) };
                    branches[wins as usize].size += branches[loses as usize].size;
                    let lost = &mut branches[loses as usize];
                    (lost.owner, lost.fork_line) = (wins, line as u32);
                    mine = Some(wins);
                }
                let branch = mine.unwrap_or_else(|| {
                    let number = branches.len() as u32;
                    branches.push(Branch { end_line: line as u32, owner: number, fork_line: 0, size: 0.0 });
                    number
                });
                runs[index].branch = branch;
                branches[branch as usize].fork_line = line as u32;
                branches[branch as usize].size += f64::from(run.to - run.from + 1);
            }
        }
    }

    /// The farthest branch that is not a speck, and the jaw next to it with the line where they part. `both_enter`: parts
    /// that do not begin together are jaws too.
    fn fork(&self, lines: &Lines, both_enter: bool) -> Option<(u32, Option<(u32, u32)>)> {
        let whole = |number: &u32| self.branches[*number as usize].owner == *number;
        let numbers = || 0..self.branches.len() as u32;
        let all: f64 = numbers().filter(whole).map(|number| self.branches[number as usize].size).sum();
        let large = numbers().filter(whole).filter(|n| self.branches[*n as usize].size >= SPECK_SHARE * all);
        let longest = large.max_by_key(|n| (self.branches[*n as usize].end_line, u32::MAX - n))?;
        let Branch { end_line: end, fork_line: begin, .. } = self.branches[longest as usize];
        // A jaw of its own is the other one's where the joint lies outside the picture: then both begin side by side.
        let from = |b: &Branch| if b.owner == longest { b.fork_line } else { b.fork_line.max(begin) };
        let length = |b: &Branch| b.end_line.saturating_sub(from(b));
        // A part that another instrument cuts off begins farther inside.
        let enters = |begin: u32| both_enter || f64::from(begin) <= ENTRY_SHARE * lines.lines as f64;
        let is_own =
            |n: &u32, b: &Branch| whole(n) && b.size >= SPECK_SHARE * all && enters(b.fork_line) && enters(begin);
        let is_jaw = |(n, b): &(u32, Branch)| *n != longest && (b.owner == longest || is_own(n, b));
        let jaws = numbers().map(|n| (n, self.branches[n as usize])).filter(is_jaw);
        let jaw = jaws.max_by_key(|(_, b)| length(b)).filter(|(_, b)| {
            let (short, long) = (f64::from(length(b)), f64::from(end - from(b)));
            short * lines.pitch >= JAW_PX && short >= JAW_SHARE * long
        });
        Some((longest, jaw.map(|(number, branch)| (number, from(&branch)))))
    }

    /// The end of a branch, seen from where it forks off.
    fn end(&self, lines: &Lines, branch: u32, fork_line: u32) -> Option<End> {
        let end_line = self.branches[branch as usize].end_line;
        let depth = (END_PX / lines.pitch).ceil() as u32;
        let own = || self.runs.iter().filter(|run| run.branch == branch && run.line > fork_line);
        let middle = |from: u32, to: u32| {
            let (mut n, mut line, mut step) = (0.0, 0.0, 0.0);
            for run in own().filter(|run| (from..=to).contains(&run.line)) {
                n += 1.0;
                line += f64::from(run.line);
                step += f64::from(run.from + run.to) / 2.0;
            }
            (n > 0.0).then(|| lines.place(line / n, step / n))
        };
        let [u_px, v_px] = middle(end_line.saturating_sub(depth), end_line)?;
        // The half that is farther from the joint shows where the jaw points.
        let [x, y] = middle(fork_line, end_line.saturating_sub((end_line - fork_line) / 2))?;
        let direction = unit([u_px - x, v_px - y]).unwrap_or(lines.axis);
        Some(End { u_px, v_px, direction })
    }
}

/// Direction of the instrument in a box (left, top, right, bottom): away from the border that the box is nearest to, where its shaft enters.
pub fn direction_of_box(corners: [f32; 4], width: usize, height: usize) -> [f64; 2] {
    let [x0, y0, x1, y1] = corners.map(f64::from);
    let gaps =
        [(x0, [-1.0, 0.0]), (width as f64 - x1, [1.0, 0.0]), (y0, [0.0, -1.0]), (height as f64 - y1, [0.0, 1.0])];
    let touching = gaps.iter().filter(|(gap, _)| *gap <= 2.0).fold([0.0, 0.0], |s, (_, d)| [s[0] + d[0], s[1] + d[1]]);
    let mut towards = touching;
    if towards == [0.0, 0.0] {
        // Towards the nearer vertical and the nearer horizontal border, the nearer one weighing more.
        let weigh = |near: f64, far: f64| if near < far { -1.0 / (near + 1.0) } else { 1.0 / (far + 1.0) };
        towards = [weigh(gaps[0].0, gaps[1].0), weigh(gaps[2].0, gaps[3].0)];
    }
    let norm = towards[0].hypot(towards[1]).max(1e-12);
    [-towards[0] / norm, -towards[1] / norm]
}

/// The tip of a box (left, top, right, bottom). Detectors box the working end; the tip is where the line from its centre in [`direction_of_box`]
/// leaves the box. Inaccurate: the error may be half the box's width.
pub fn tip_of_box(corners: [f32; 4], width: usize, height: usize) -> TipPixel {
    let [x0, y0, x1, y1] = corners.map(f64::from);
    let (cx, cy) = ((x0 + x1) / 2.0, (y0 + y1) / 2.0);
    let direction = direction_of_box(corners, width, height);
    let reach = |d: f64, half: f64| if d.abs() > 1e-9 { half / d.abs() } else { f64::INFINITY };
    let t = reach(direction[0], (x1 - x0) / 2.0).min(reach(direction[1], (y1 - y0) / 2.0));
    let t = if t.is_finite() { t } else { 0.0 };
    let tip = End { u_px: cx + t * direction[0], v_px: cy + t * direction[1], direction };
    TipPixel { tip, jaws: None }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn bits_of(width: usize, height: usize, inside: impl Fn(f64, f64) -> bool) -> Vec<u8> {
        let row = width.div_ceil(8);
        let mut bits = vec![0; row * height];
        for y in 0..height {
            for x in (0..width).filter(|&x| inside(x as f64, y as f64)) {
                bits[y * row + x / 8] |= 0x80 >> (x % 8);
            }
        }
        bits
    }

    fn tip(width: usize, height: usize, inside: impl Fn(f64, f64) -> bool) -> Option<TipPixel> {
        TipFinder::default().of_mask(Mask::new(&bits_of(width, height, inside), width, height))
    }

    /// Whether a point is on a bar of a given width between two points.
    pub(super) fn on_bar([x, y]: [f64; 2], [ax, ay]: [f64; 2], [bx, by]: [f64; 2], width: f64) -> bool {
        let length = (bx - ax).hypot(by - ay);
        let (t, s) = (
            ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length,
            ((y - ay) * (bx - ax) - (x - ax) * (by - ay)) / length,
        );
        (0.0..=length).contains(&t) && s.abs() <= width / 2.0
    }

    #[test]
    fn a_shaft_from_the_right_ends_on_the_left() {
        // A bar of 8 px from the right border to a tip at (30, 60).
        let found =
            tip(101, 80, |x, y| on_bar([x, y], [30.0, 60.0], [110.0, 37.0], 8.0)).expect("the mask is not empty");
        assert!((found.tip.u_px - 31.0).abs() < 1.5 && (found.tip.v_px - 60.0).abs() < 1.5, "{found:?}");
        assert!(found.tip.direction[0] < -0.9 && found.jaws.is_none());
    }

    #[test]
    fn a_wide_bag_ends_opposite_to_its_entry() {
        // Half an ellipse at the right border, taller than wide.
        let bag = |x: f64, y: f64| ((x - 100.0) / 30.0).powi(2) + ((y - 60.0) / 45.0).powi(2) <= 1.0;
        let found = tip(100, 120, bag).expect("the mask is not empty");
        assert!((found.tip.u_px - 71.0).abs() < 2.0 && (found.tip.v_px - 60.0).abs() < 1.0, "{found:?}");
    }

    #[test]
    fn the_tip_of_open_jaws_lies_between_them() {
        // Two jaws from the joint at (60, 50), 15 px to either side at x = 10, on a shaft from the right border.
        let found = tip(101, 100, |x, y| {
            let jaw = (x - 60.0).abs() <= 50.0 && x <= 60.0 && ((y - 50.0).abs() - 0.3 * (60.0 - x)).abs() <= 3.0;
            jaw || (x > 60.0 && (y - 50.0).abs() <= 5.0)
        });
        let found = found.expect("the mask is not empty");
        assert!((found.tip.u_px - 11.0).abs() < 2.0 && (found.tip.v_px - 50.0).abs() < 1.5, "{found:?}");
    }

    #[test]
    fn jaws_wide_open_and_seen_askew_end_in_the_middle_of_both_ends() {
        // One jaw is seen longer than the other; the wider they open, the more one of them would be taken for the tip.
        for (joint, one, two) in [
            ([300.0, 200.0], [180.0, 110.0], [200.0, 250.0]),
            ([260.0, 240.0], [120.0, 260.0], [190.0, 130.0]),
            ([330.0, 150.0], [230.0, 60.0], [210.0, 190.0]),
        ] {
            let found = tip(400, 300, |x, y| {
                on_bar([x, y], [420.0, 210.0], joint, 26.0)
                    || on_bar([x, y], joint, one, 14.0)
                    || on_bar([x, y], joint, two, 14.0)
            });
            let found = found.expect("the mask is not empty");
            let middle = [(one[0] + two[0]) / 2.0, (one[1] + two[1]) / 2.0];
            let off = (found.tip.u_px - middle[0]).hypot(found.tip.v_px - middle[1]);
            assert!(off < 6.0 && found.jaws.is_some(), "{off} px from {middle:?}: {found:?}");
        }
    }

    #[test]
    fn a_jaw_that_leaves_the_picture_is_no_entry() {
        // The shaft comes from the right; one jaw ends at the left border, where it is narrower than the shaft.
        let found = tip(200, 160, |x, y| {
            on_bar([x, y], [220.0, 80.0], [100.0, 80.0], 20.0)
                || on_bar([x, y], [104.0, 80.0], [-20.0, 40.0], 8.0)
                || on_bar([x, y], [104.0, 80.0], [20.0, 130.0], 8.0)
        });
        let found = found.expect("the mask is not empty");
        assert!(found.tip.direction[0] < -0.9 && (found.tip.v_px - 90.0).abs() < 8.0, "{found:?}");
    }

    #[test]
    fn jaws_whose_joint_lies_outside_the_picture_are_one_instrument() {
        let found = tip(200, 160, |x, y| {
            on_bar([x, y], [240.0, 80.0], [120.0, 40.0], 12.0) || on_bar([x, y], [240.0, 80.0], [110.0, 110.0], 12.0)
        });
        let found = found.expect("the mask is not empty");
        assert!((found.tip.u_px - 115.0).hypot(found.tip.v_px - 75.0) < 5.0 && found.jaws.is_some(), "{found:?}");
        // Seen askew, so that one jaw begins farther inside along the line between them.
        let (one, two) = ([150.0, 30.0], [120.0, 120.0]);
        let found =
            tip(200, 160, |x, y| on_bar([x, y], [230.0, 90.0], one, 10.0) || on_bar([x, y], [230.0, 115.0], two, 10.0));
        let found = found.expect("the mask is not empty");
        assert!((found.tip.u_px - 135.0).hypot(found.tip.v_px - 75.0) < 5.0 && found.jaws.is_some(), "{found:?}");
        // Another instrument across it cuts a shaft in two: the part behind is no jaw.
        let found =
            tip(200, 160, |x, y| on_bar([x, y], [220.0, 80.0], [40.0, 80.0], 12.0) && !(90.0..110.0).contains(&x));
        let found = found.expect("the mask is not empty");
        assert!((found.tip.u_px - 41.0).abs() < 2.0 && found.jaws.is_none(), "{found:?}");
    }

    #[test]
    fn specks_and_rough_edges_are_no_ends() {
        let bar = |x: f64, y: f64| on_bar([x, y], [60.0, 80.0], [220.0, 80.0], 16.0);
        let clean = tip(200, 160, bar).expect("the mask is not empty");
        // A speck beyond the tip, and a notch of 3 px in its end.
        let rough = |x: f64, y: f64| {
            (bar(x, y) && !((60.0..63.0).contains(&x) && (78.0..82.0).contains(&y))) || (x - 20.0).hypot(y - 90.0) < 4.0
        };
        let found = tip(200, 160, rough).expect("the mask is not empty");
        let off = (found.tip.u_px - clean.tip.u_px).hypot(found.tip.v_px - clean.tip.v_px);
        assert!(off < 2.0 && found.jaws.is_none(), "{found:?} for {clean:?}");
    }

    #[test]
    fn an_empty_mask_has_no_tip() {
        let mut finder = TipFinder::default();
        assert_eq!(finder.of_mask(Mask::new(&[0; 20], 16, 10)), None);
        assert_eq!(finder.of_mask(Mask::new(&[], 0, 0)), None);
        assert_eq!(finder.of_mask(Mask::new(&[], 16, 10)), None);
    }

    #[test]
    fn a_full_mask_and_single_pixels_are_borne() {
        let mut finder = TipFinder::default();
        assert!(finder.of_mask(Mask::new(&[0xff; 20], 16, 10)).is_some());
        assert!(finder.of_mask(Mask::new(&[0x80], 1, 1)).is_some());
        assert!(tip(9, 9, |x, y| x == 4.0 && y == 4.0).is_some());
    }

    #[test]
    fn a_box_at_the_right_border_ends_on_its_left_side() {
        let TipPixel { tip, .. } = tip_of_box([80.0, 30.0, 100.0, 40.0], 100, 80);
        assert!((tip.u_px - 80.0).abs() < 1e-6 && (tip.v_px - 35.0).abs() < 1e-6, "{tip:?}");
    }
}
