//! The interlock's rules, one by one: with the campaign, every branch of its code runs, and nearly every change of it
//! makes one of these fail.

mod brake;
mod following;
mod limits;
mod reasons;

use super::*;

pub const MS: i64 = 1_000_000;
pub const SEEN: Evidence = Evidence { score: 0.9, in_space: true };

pub fn shipped() -> Chain {
    Chain::shipped().expect("the shipped arm")
}

/// The shipped arm with parts of its text replaced; each of them occurs.
pub fn changed(replaced: &[(&str, &str)]) -> Chain {
    let mut text = crate::chain::SHIPPED_URDF.to_owned();
    for (old, new) in replaced {
        assert!(text.contains(old), "{old}");
        text = text.replace(old, new);
    }
    Chain::from_urdf(&text).expect("an arm")
}

/// An arm whose fifth joint turns about the trocar: the tube tilts, with its pivot at rest and 100 mm behind the
/// trocar.
pub fn about_trocar() -> Chain {
    changed(&[("0.42 0 0.21", "0.42 0 0.48"), ("0 0 -0.3\"", "0 0 -0.02\"")])
}

/// An arm whose tube ends at home `depth_mm` behind the trocar.
pub fn deep(depth_mm: f64) -> Chain {
    changed(&[("0.42 0 0.21", &format!("0.42 0 {}", 0.1 + depth_mm * 1e-3))])
}

/// One joint at an angle or speed, the others at 0.
pub fn joint(index: usize, value: f64) -> JointVector {
    JointVector::from_fn(|k, _| if k == index { value } else { 0.0 })
}

pub fn lock() -> Interlock {
    Interlock::new(shipped(), JointVector::zeros(), 0)
}

/// A tip and a demand for the last joint, both of now.
pub fn ask(lock: &mut Interlock, now_ns: i64, rad_s: f64) {
    lock.tip(now_ns, SEEN);
    lock.demand(now_ns, joint(5, rad_s).as_slice());
}

/// Asks every 10 ms, from and to a time in ms. Returns the set-points.
pub fn drive(lock: &mut Interlock, from_ms: i64, until_ms: i64, rad_s: f64) -> Vec<SetPoint> {
    let mut points = Vec::new();
    for ms in (from_ms..until_ms).step_by(10) {
        lock.advance(ms * MS, &mut |point| points.push(*point));
        ask(lock, ms * MS, rad_s);
    }
    lock.advance(until_ms * MS, &mut |point| points.push(*point));
    points
}

pub fn events(lock: &mut Interlock) -> Vec<Option<Cause>> {
    std::iter::from_fn(|| lock.take_event()).map(|event| event.stop).collect()
}
