//! Whether the views are those of the calibration and of one instant: measurements of others are wrong, and seldom look so.

use panoscope_data::calibration::packet::ViewCameras;
use panoscope_imaging::View;
use panoscope_imaging::stereo::{Delay, Order, OrderEvidence, ViewDelay, ViewOrder};
use panoscope_node::Context;
use panoscope_node::abi::Calibration;

/// Time between two checks, ns of capture: with the ticks that a check takes, exchanged views are found within a second.
const PERIOD_NS: i64 = 700_000_000;
/// Maximum number of ticks between two checks, for sources that are faster than their clock.
const PERIOD_TICKS: u32 = 60;

/// A delay of one view from this share of the time between two frames on is no jitter of cameras without a common clock.
const LATE_FRAMES: f64 = 0.6;
/// And this many standard deviations.
const LATE_DEVIATIONS: f64 = 4.0;
/// Longest time between two ticks in which features are followed, s.
const MAX_STEP_S: f64 = 0.2;

/// What may be measured of the views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PairState {
    /// Nothing speaks against them.
    Fits,
    /// One view is late: what moves is measured wrongly.
    Late,
    /// They are exchanged, or seem to be.
    Exchanged,
}

/// What is done in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Step {
    /// Nothing until the next check is due.
    #[default]
    Wait,
    /// The right view's features are found.
    FindRight,
    /// Features are compared.
    Compare,
    /// Features are followed into the next left view.
    Follow,
}

/// Checks the order of the views at intervals. A check is spread over four ticks, because each part takes some ms.
#[derive(Default)]
pub struct OrderWatch {
    order: ViewOrder,
    cameras: Option<ViewCameras>,
    step: Step,
    /// Capture time of the newest check, ns; `None` before the first.
    checked_ns: Option<i64>,
    ticks: u32,
    /// The newest check found exchanged views, which one more must confirm.
    is_suspect: bool,
    is_exchanged: bool,
    /// Both views were one image when the newest check took them.
    are_one_image: bool,
    delay: ViewDelay,
    /// Capture time of the views that are checked, ns.
    taken_ns: i64,
    /// Time from there to the next left view, s; and the shortest such time, which is that between two frames.
    step_s: f64,
    frame_s: Option<f64>,
    /// Checks in a row that found one view late.
    late_checks: u32,
    is_late: bool,
}

impl OrderWatch {
    /// Takes the views of a tick. `is_level`: they are rectified already.
    pub fn look(
        &mut self,
        cx: &Context<'_>,
        views: [View<'_, u8>; 2],
        given: &Calibration,
        is_level: bool,
    ) -> PairState {
        if !self.cameras.as_ref().is_some_and(|cameras| cameras.are_of(given, is_level)) {
            // The node itself refuses a calibration that is impossible.
            self.cameras = ViewCameras::new(given, is_level).ok();
            (self.step, self.checked_ns) = (Step::Wait, None);
            (self.delay, self.late_checks, self.is_late) = (ViewDelay::default(), 0, false);
        }
        let now_ns = cx.tick().capture_ns;
        let pool = cx.pool();
        self.ticks += 1;
        match self.step {
            Step::Wait if self.checked_ns.is_none() || self.is_suspect && !self.is_exchanged => {
                self.take(cx, views);
                self.order.find(0, pool);
                self.order.find(1, pool);
                self.compare(cx, now_ns);
            }
            Step::Wait => {
                let waited_ns = self.checked_ns.map_or(i64::MAX, |checked| now_ns.saturating_sub(checked));
                // The clock of a source that starts again goes back.
                if !(0..PERIOD_NS).contains(&waited_ns) || self.ticks >= PERIOD_TICKS {
                    self.take(cx, views);
                    self.order.find(0, pool);
                    self.taken_ns = now_ns;
                    self.step = Step::FindRight;
                }
            }
            Step::FindRight => {
                self.order.find(1, pool);
                self.order.take_next(views[0], pool);
                self.step_s = now_ns.saturating_sub(self.taken_ns) as f64 * 1e-9;
                self.step = Step::Compare;
            }
            Step::Compare => {
                self.compare(cx, now_ns);
                if !self.is_suspect && self.step_s > 0.0 && self.step_s <= MAX_STEP_S {
                    self.step = Step::Follow;
                }
            }
            Step::Follow => {
                self.follow(cx);
                self.step = Step::Wait;
            }
        }
        match (self.is_suspect, self.is_late) {
            (true, _) => PairState::Exchanged,
            (_, true) => PairState::Late,
            _ => PairState::Fits,
        }
    }

    /// Takes the views for a check. Warns if they are one image, which no two cameras make.
    fn take(&mut self, cx: &Context<'_>, views: [View<'_, u8>; 2]) {
        self.order.take(views, cx.pool());
        let are_one = are_one_image(views);
        if are_one && !self.are_one_image {
            cx.warn("`left` and `right` are the same image, pixel by pixel: nothing has a depth. Check whether one camera or file is given twice");
        }
        self.are_one_image = are_one;
    }

    fn follow(&mut self, cx: &Context<'_>) {
        let Some(cameras) = &self.cameras else { return };
        let samples = cameras.row_samples(&mut self.order, self.step_s, cx.pool());
        self.delay.add(&samples, self.order.unit_px());
        let frame_s = self.frame_s.map_or(self.step_s, |frame_s| frame_s.min(self.step_s));
        self.frame_s = Some(frame_s);
        let Some(Delay { delay_s, deviation_s }) = self.delay.estimate() else { return };
        let limit_s = LATE_FRAMES * frame_s;
        let is_late = delay_s.abs() > limit_s && delay_s.abs() > LATE_DEVIATIONS * deviation_s;
        self.late_checks = if is_late { self.late_checks.saturating_add(1) } else { 0 };
        if self.late_checks >= 2 && !self.is_late {
            self.is_late = true;
            let [late, other] = if delay_s > 0.0 { ["right", "left"] } else { ["left", "right"] };
            cx.warn(&format!(
                "the views are not of one instant: the {late} one is {:.0} ms ({:.1} frames) behind the {other} one. What is measured while the image moves is wrong, no calibration is handed on until they are. Check what records or sends them",
                delay_s.abs() * 1e3,
                delay_s.abs() / frame_s
            ));
        } else if self.is_late && delay_s.abs() < 0.5 * limit_s && deviation_s < 0.25 * limit_s {
            self.is_late = false;
            cx.info("both views are of one instant again");
        }
        if deviation_s < limit_s {
            cx.metric("view_delay_ms", delay_s * 1e3);
        }
        cx.metric("views_late", f64::from(u8::from(self.is_late)));
    }

    fn compare(&mut self, cx: &Context<'_>, now_ns: i64) {
        (self.step, self.checked_ns, self.ticks) = (Step::Wait, Some(now_ns), 0);
        let Some(cameras) = &self.cameras else { return };
        let OrderEvidence { order, pairs, fitting } = cameras.compare(&mut self.order, cx.pool());
        match order {
            Order::Exchanged if self.is_suspect && !self.is_exchanged => {
                self.is_exchanged = true;
                cx.warn(&format!(
                    "left and right are swapped: of {pairs} features that both views show, {} fit the calibration as the views are given and {} with the views exchanged. Nothing is handed on until the inputs change places",
                    fitting[0], fitting[1]
                ));
            }
            Order::Exchanged => self.is_suspect = true,
            Order::AsCalibrated => {
                if self.is_exchanged {
                    cx.info("left and right are in order again");
                }
                (self.is_suspect, self.is_exchanged) = (false, false);
            }
            // Dark or blurred views say nothing.
            Order::Unknown => self.is_suspect = self.is_exchanged,
        }
        // Neither a first suspicion nor dark views say that the order is right.
        if order != Order::Unknown && self.is_suspect == self.is_exchanged {
            cx.metric("views_swapped", f64::from(u8::from(self.is_exchanged)));
        }
    }
}

/// Whether two views have the same pixels, not all of one value: black views say nothing.
fn are_one_image([left, right]: [View<'_, u8>; 2]) -> bool {
    let rows = || (0..left.height).map(|y| left.row(y));
    (left.width, left.height, left.channels) == (right.width, right.height, right.channels)
        && rows().enumerate().all(|(y, row)| row == right.row(y))
        && rows().flatten().any(|value| *value != left.row(0)[0])
}
