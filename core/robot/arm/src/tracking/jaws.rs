//! Centre between two jaws when one jaw's end is hidden.
//!
//! The tip of open jaws is the middle between both ends. Where another instrument covers one end, the other end alone
//! is off by half the opening. Jaws open to both sides of the shaft's axis: the middle is the point where the visible
//! end, moved along the opening direction, meets that axis. The lean of that direction along the shaft and in depth is
//! known from the last image that shows both ends; the opening is measured in each image, because jaws open and close
//! while one of them is hidden. Where too little of the shaft is in view for an axis, the last opening is used.

use nalgebra::{Vector2, Vector3};

/// Maximum time for which jaws are known after both ends were seen, ns.
const KNOWN_NS: i64 = 10_000_000_000;
/// Maximum time for which an opening is used without an axis, ns.
const OPENING_NS: i64 = 2_000_000_000;
const LAST_NS: i64 = 200_000_000;
/// Half openings from which their direction is known, and up to which ends belong to one instrument, mm.
const OPEN_MM: f64 = 1.5;
const MAX_HALF_MM: f64 = 12.0;
/// Largest distance of a tip from the shaft's axis at which the jaws are closed, mm.
const CLOSED_MM: f64 = 1.0;
/// Largest lean of the opening's direction: tangent against the direction across the shaft.
const MAX_LEAN: f64 = 1.0;

/// The axis of a shaft in the image, in units of the focal length (x/z, y/z).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// A point of the axis.
    pub from: Vector2<f64>,
    /// Unit vector towards the jaws.
    pub along: Vector2<f64>,
}

impl Axis {
    fn across(&self) -> Vector2<f64> {
        Vector2::new(-self.along.y, self.along.x)
    }
}

/// Result for one visible end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Middle {
    /// Middle between both ends, mm.
    pub middle_mm: Vector3<f64>,
    /// Expected position of the hidden end, mm.
    pub other_mm: Vector3<f64>,
    /// Whether the opening was measured with the axis; otherwise it is the last known one.
    pub is_measured: bool,
}

/// Last observation of both ends.
#[derive(Clone, Copy, Debug)]
struct Both {
    /// From the middle to the end on the side of [`Axis::across`]: across and along the shaft in the image plane, and
    /// in depth, mm.
    half_mm: Vector3<f64>,
    /// Direction of the shaft in that observation.
    along: Vector2<f64>,
    /// Length of the jaws along the shaft, mm.
    length_mm: f64,
    seen_ns: i64,
    /// Time of `half_mm`: updated by one end and the axis too.
    opening_ns: i64,
}

/// The jaws of one instrument over time. Positions in mm, in the frame of the camera.
#[derive(Clone, Copy, Debug, Default)]
pub struct Jaws {
    both: Option<Both>,
    /// The last middle and its time, ns.
    last: Option<(Vector3<f64>, i64)>,
}

/// Whether at most `max_ns` passed since a time.
fn is_recent(at_ns: i64, now_ns: i64, max_ns: i64) -> bool {
    (0..=max_ns).contains(&now_ns.saturating_sub(at_ns))
}

impl Jaws {
    /// Adds both ends in an image that shows them, the direction of the shaft in the image (a unit vector towards the
    /// jaws), and the length of the jaws along it, mm. Ends too far apart for one instrument, and numbers that are not
    /// finite, are ignored.
    pub fn see_both(&mut self, now_ns: i64, ends_mm: [Vector3<f64>; 2], along: Vector2<f64>, length_mm: f64) {
        let half = (ends_mm[0] - ends_mm[1]) / 2.0;
        let is_finite = half.iter().chain(along.iter()).chain([&length_mm]).all(|v| v.is_finite());
        if !is_finite || half.norm() > MAX_HALF_MM {
            return;
        }
        self.last = Some(((ends_mm[0] + ends_mm[1]) / 2.0, now_ns));
        let known = self.both.filter(|both| is_recent(both.seen_ns, now_ns, KNOWN_NS));
        let across = Vector2::new(-along.y, along.x);
        let mut half_mm = Vector3::new(half.xy().dot(&across), half.xy().dot(&along), half.z);
        if half_mm.x < 0.0 {
            half_mm = -half_mm;
        }
        // The more they open, the nearer to their joint they part.
        let length_mm = known.map_or(length_mm, |both| both.length_mm.max(length_mm));
        self.both = Some(Both { half_mm, along, length_mm, seen_ns: now_ns, opening_ns: now_ns });
    }

    /// Adds the tip of an isolated instrument whose end is not open. If the tip is on the shaft's axis, the jaws are
    /// closed or absent. Bent instruments are ignored.
    pub fn see_closed(&mut self, now_ns: i64, tip_mm: Vector3<f64>, axis: Axis, length_mm: f64) {
        let aside_mm = (tip_mm.xy() / tip_mm.z - axis.from).dot(&axis.across()) * tip_mm.z;
        if aside_mm.abs() <= CLOSED_MM && tip_mm.z > 0.0 && length_mm.is_finite() {
            let (half_mm, along) = (Vector3::zeros(), axis.along);
            let length_mm = self.length_mm(now_ns).map_or(length_mm, |known| known.max(length_mm));
            self.both = Some(Both { half_mm, along, length_mm, seen_ns: now_ns, opening_ns: now_ns });
        }
        self.see_tip(now_ns, tip_mm);
    }

    /// Adds the tip in an image that does not show two jaws.
    pub fn see_tip(&mut self, now_ns: i64, tip_mm: Vector3<f64>) {
        self.last = Some((tip_mm, now_ns)).filter(|_| tip_mm.iter().all(|v| v.is_finite()));
    }

    /// Length of the jaws along the shaft, mm, if both ends were seen recently.
    pub fn length_mm(&self, now_ns: i64) -> Option<f64> {
        self.both.filter(|both| is_recent(both.seen_ns, now_ns, KNOWN_NS)).map(|both| both.length_mm)
    }

    /// Direction of the shaft in the last image that showed both ends.
    pub fn along(&self, now_ns: i64) -> Option<Vector2<f64>> {
        self.both.filter(|both| is_recent(both.seen_ns, now_ns, KNOWN_NS)).map(|both| both.along)
    }

    /// The middle between both ends, from one end and the shaft's axis. `None` if both ends were not seen recently or
    /// the end is too far from the axis to be a jaw's.
    pub fn of_one(&self, now_ns: i64, end_mm: Vector3<f64>, axis: Option<Axis>) -> Option<Middle> {
        let both = self.both.filter(|both| is_recent(both.seen_ns, now_ns, KNOWN_NS))?;
        if !end_mm.iter().all(|v| v.is_finite()) || end_mm.z <= 0.0 {
            return None;
        }
        let half = both.half_mm;
        let lean = if half.x >= OPEN_MM { half.yz() / half.x } else { Vector2::zeros() };
        let lean = lean.map(|v| v.clamp(-MAX_LEAN, MAX_LEAN));
        let measured = axis.map(|axis| {
            let aside_mm = (end_mm.xy() / end_mm.z - axis.from).dot(&axis.across()) * end_mm.z;
            in_camera(Vector3::new(1.0, lean.x, lean.y) * aside_mm, axis.along)
        });
        let is_new = is_recent(both.opening_ns, now_ns, OPENING_NS);
        let last = self.last.filter(|(_, at_ns)| is_new && is_recent(*at_ns, now_ns, LAST_NS));
        let kept = last.map(|(last, _)| {
            let half = in_camera(half, both.along);
            let off = |half: Vector3<f64>| (end_mm - half - last).norm();
            if off(half) <= off(-half) { half } else { -half }
        });
        let (offset, is_measured) = match (measured, kept) {
            (Some(measured), _) => (measured, true),
            (None, kept) => (kept?, false),
        };
        let middle = Middle { middle_mm: end_mm - offset, other_mm: end_mm - offset * 2.0, is_measured };
        (offset.norm() <= MAX_HALF_MM && middle.other_mm.z > 0.0).then_some(middle)
    }

    /// Adds the middle that [`Jaws::of_one`] returned for an end as the tip in this image.
    pub fn see_one(&mut self, now_ns: i64, end_mm: Vector3<f64>, middle: &Middle, axis: Option<Axis>) {
        self.last = Some((middle.middle_mm, now_ns));
        if let (Some(both), Some(axis)) = (&mut self.both, axis.filter(|_| middle.is_measured)) {
            let offset = end_mm - middle.middle_mm;
            let aside = Vector3::new(offset.xy().dot(&axis.across()), offset.xy().dot(&axis.along), offset.z);
            let aside = if aside.x < 0.0 { -aside } else { aside };
            if aside.x >= OPEN_MM {
                (both.half_mm, both.along, both.opening_ns) = (aside, axis.along, now_ns);
            }
        }
    }
}

/// A vector across the shaft, along it and in depth, in the camera's frame.
fn in_camera(v: Vector3<f64>, along: Vector2<f64>) -> Vector3<f64> {
    Vector3::new(-along.y * v.x + along.x * v.y, along.x * v.x + along.y * v.y, v.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Jaws of 17 mm at 66 mm on a shaft from the right that rises towards the camera, held with a roll; half the angle
    /// between them as given.
    struct Grasper {
        middle: Vector3<f64>,
        shaft: Vector3<f64>,
        roll: f64,
    }

    impl Grasper {
        fn new(roll: f64) -> Self {
            let shaft = -Vector3::new(110.0, 27.0, -42.0).normalize();
            Self { middle: Vector3::new(7.5, 1.0, 66.0), shaft, roll }
        }

        fn ends(&self, half_angle: f64) -> [Vector3<f64>; 2] {
            let x = Vector3::z().cross(&self.shaft).normalize();
            let open = x * self.roll.cos() + self.shaft.cross(&x) * self.roll.sin();
            [1.0, -1.0].map(|side| self.middle + open * (side * 17.0 * half_angle.sin()))
        }

        fn axis(&self) -> Axis {
            let at = |mm: f64| {
                let p = self.middle + self.shaft * mm;
                p.xy() / p.z
            };
            Axis { from: at(-30.0), along: (at(-20.0) - at(-30.0)).normalize() }
        }
    }

    const TICK_NS: i64 = 33_333_333;

    #[test]
    fn the_middle_stays_while_one_end_is_hidden_and_the_jaws_close_and_open() {
        for (roll, hidden, limit_mm) in [(0.0, 0, 0.4), (0.0, 1, 0.4), (0.3, 0, 0.6), (-0.3, 1, 0.6)] {
            let grasper = Grasper::new(roll);
            let mut jaws = Jaws::default();
            let (mut worst, mut alone) = (0.0_f64, 0.0_f64);
            for tick in 0..180_i64 {
                let now_ns = tick * TICK_NS;
                let half_angle = 0.35 + 0.2 * (tick as f64 / 20.0).sin();
                let ends = grasper.ends(half_angle);
                if tick < 30 {
                    jaws.see_both(now_ns, ends, grasper.axis().along, 14.0);
                    continue;
                }
                let end = ends[1 - hidden];
                let found = jaws.of_one(now_ns, end, Some(grasper.axis())).expect("both ends were seen");
                jaws.see_one(now_ns, end, &found, Some(grasper.axis()));
                worst = worst.max((found.middle_mm - grasper.middle).norm());
                alone = alone.max((end - grasper.middle).norm());
                assert!((found.other_mm - ends[hidden]).norm() < 2.0 * limit_mm, "tick {tick}: {found:?}");
            }
            assert!(worst < limit_mm && alone > 8.0, "roll {roll}: {worst} mm, the end alone {alone} mm");
        }
    }

    #[test]
    fn without_an_axis_the_last_opening_is_used_for_a_while() {
        let grasper = Grasper::new(0.1);
        let mut jaws = Jaws::default();
        let ends = grasper.ends(0.3);
        // The order in which ends are given says nothing.
        jaws.see_both(0, [ends[1], ends[0]], grasper.axis().along, 14.0);
        for tick in 1..90 {
            let now_ns = tick * TICK_NS;
            for end in ends {
                match jaws.of_one(now_ns, end, None) {
                    Some(found) => assert!((found.middle_mm - grasper.middle).norm() < 0.1, "tick {tick}: {found:?}"),
                    None => assert!(tick * TICK_NS > OPENING_NS, "tick {tick}"),
                }
            }
            if let Some(found) = jaws.of_one(now_ns, ends[0], None) {
                jaws.see_one(now_ns, ends[0], &found, None);
            }
        }
        assert!(jaws.of_one(89 * TICK_NS, ends[0], None).is_none(), "the opening is old");
        // The axis still tells it.
        assert!(jaws.of_one(89 * TICK_NS, ends[0], Some(grasper.axis())).is_some());
    }

    #[test]
    fn jaws_that_open_while_one_is_hidden_were_closed_before() {
        let grasper = Grasper::new(0.0);
        let mut jaws = Jaws::default();
        jaws.see_closed(0, grasper.middle, grasper.axis(), 14.0);
        for tick in 1..60 {
            let end = grasper.ends(0.006 * tick as f64)[0];
            let found = jaws.of_one(tick * TICK_NS, end, Some(grasper.axis())).expect("closed jaws were seen");
            jaws.see_one(tick * TICK_NS, end, &found, Some(grasper.axis()));
            assert!((found.middle_mm - grasper.middle).norm() < 0.4, "tick {tick}: {found:?}");
        }
        // The end of a hook is not on the axis.
        let mut jaws = Jaws::default();
        jaws.see_closed(0, grasper.ends(0.2)[0], grasper.axis(), 14.0);
        assert!(jaws.of_one(1, grasper.ends(0.2)[0], Some(grasper.axis())).is_none());
    }

    #[test]
    fn jaws_that_were_never_seen_or_are_impossible_say_nothing() {
        let grasper = Grasper::new(0.0);
        let (axis, ends) = (grasper.axis(), grasper.ends(0.3));
        let mut jaws = Jaws::default();
        assert!(jaws.of_one(0, ends[0], Some(axis)).is_none());
        jaws.see_tip(0, ends[0]);
        assert!(jaws.of_one(0, ends[0], Some(axis)).is_none(), "a tip is no pair of jaws");
        jaws.see_both(0, [ends[0], ends[0] + Vector3::new(30.0, 0.0, 0.0)], axis.along, 14.0);
        jaws.see_both(0, [ends[0], Vector3::new(f64::NAN, 0.0, 60.0)], axis.along, 14.0);
        assert!(jaws.of_one(0, ends[0], Some(axis)).is_none(), "these are two instruments");
        jaws.see_both(0, ends, axis.along, 14.0);
        assert!(jaws.of_one(1, ends[0] + Vector3::new(0.0, 24.0, 0.0), Some(axis)).is_none(), "too far from the axis");
        assert!(jaws.of_one(1, Vector3::new(0.0, f64::INFINITY, 60.0), Some(axis)).is_none());
        assert!(jaws.of_one(1, -ends[0], Some(axis)).is_none());
        assert!(jaws.of_one(-1, ends[0], Some(axis)).is_none(), "time went back");
        assert!(jaws.of_one(KNOWN_NS + 1, ends[0], Some(axis)).is_none(), "long ago");
        assert_eq!((jaws.length_mm(1), jaws.length_mm(KNOWN_NS + 1)), (Some(14.0), None));
    }
}
