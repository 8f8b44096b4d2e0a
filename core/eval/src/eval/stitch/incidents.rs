//! Behaviour of a registration during a fault, and its recovery time.

use crate::packets::Table;
use crate::registration::{FRESH, is_right};

/// First affected image, and number of affected images.
pub const WINDOW: (i64, i64) = (20, 10);
/// Ticks of a run, with enough good ones after the bad ones.
pub const TICKS: u64 = (WINDOW.0 + WINDOW.1) as u64 + 10;

/// A fault that the phantom can render.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Incident {
    /// Name in figures.
    pub name: &'static str,
    /// Parameters of the phantom.
    pub params: &'static [(&'static str, &'static str)],
    /// Names of the parameters for its first image and its length.
    pub window: [&'static str; 2],
    /// Whether the affected images show tissue, so that a registration can be correct.
    pub seen: bool,
    /// Whether images after the first affected one are good again.
    pub at_once: bool,
}

const fn incident(
    name: &'static str,
    params: &'static [(&'static str, &'static str)],
    seen: bool,
    at_once: bool,
) -> Incident {
    Incident { name, params, window: ["incident_first", "incident_count"], seen, at_once }
}

/// All incidents.
pub const ALL: [Incident; 5] = [
    Incident {
        name: "black",
        params: &[("black_camera", "right")],
        window: ["black_first", "black_count"],
        seen: false,
        at_once: false,
    },
    incident("covered", &[("incident", "covered")], false, false),
    incident("smoke", &[("incident", "smoke")], true, false),
    incident("blur", &[("incident", "blur")], true, false),
    incident("jump", &[("incident", "jump")], true, true),
];

/// Measured recovery.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recovery {
    /// Good images until a correct registration; 1: the first one has it. NaN if there is none.
    pub frames: f64,
    /// Affected images with a registration reported as fresh that is wrong.
    pub false_fresh: f64,
}

/// Reads the table of an evaluating node.
pub fn recovery(incident: &Incident, rows: &Table) -> Option<Recovery> {
    let (state, align, floor) = (rows.column("state")?, rows.column("align_px")?, rows.column("floor_px")?);
    let fresh = |tick: usize| state.get(tick) == Some(&FRESH);
    let right = |tick: usize| fresh(tick) && is_right(align[tick], floor[tick]);
    let first = WINDOW.0 as usize;
    let end = first + if incident.at_once { 0 } else { WINDOW.1 as usize };
    let back = (end..state.len()).find(|tick| right(*tick));
    let bad = first..if incident.at_once { back.unwrap_or(state.len()) } else { end };
    let wrong = bad.filter(|tick| if incident.seen { fresh(*tick) && !right(*tick) } else { fresh(*tick) });
    Some(Recovery {
        frames: back.map_or(f64::NAN, |tick| (tick - end) as f64 + 1.0),
        false_fresh: wrong.count() as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(state: &[f64], align: &[f64]) -> Table {
        let names = ["state", "align_px", "floor_px"].map(str::to_owned).to_vec();
        Table { names, rows: state.iter().zip(align).map(|(s, a)| vec![*s, *a, 1.0]).collect() }
    }

    #[test]
    fn recovery_counts_good_frames_and_false_ones() {
        let mut states = vec![0.0; 40];
        let (first, end) = (WINDOW.0 as usize, (WINDOW.0 + WINDOW.1) as usize);
        states[first + 1..end + 1].fill(2.0);
        let found = recovery(&ALL[0], &rows(&states, &[1.0; 40])).unwrap();
        assert_eq!((found.frames, found.false_fresh), (2.0, 1.0));
    }

    #[test]
    fn a_wrong_registration_is_none() {
        let mut align = vec![1.0; 40];
        align[20..23].fill(80.0);
        let smoke = ALL.iter().find(|i| i.name == "smoke").unwrap();
        let found = recovery(smoke, &rows(&[0.0; 40], &align)).unwrap();
        assert_eq!((found.frames, found.false_fresh), (1.0, 3.0));
        let jump = ALL.iter().find(|i| i.name == "jump").unwrap();
        let found = recovery(jump, &rows(&[0.0; 40], &align)).unwrap();
        assert_eq!((found.frames, found.false_fresh), (4.0, 3.0));
    }
}
