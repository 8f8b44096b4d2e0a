//! Turns distances into warnings.

/// Thresholds of a warning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// A warning begins at this distance, mm.
    pub on_mm: f64,
    /// It ends beyond this distance, mm; not less than `on_mm`.
    pub off_mm: f64,
    /// Minimum time on one side of a threshold before the warning changes, s.
    pub min_s: f64,
}

/// A warning that is on or off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hysteresis {
    is_on: bool,
    /// Time since which the distance is on the other side of the threshold, s.
    since_s: Option<f64>,
}

impl Hysteresis {
    /// Whether the warning is on.
    pub fn is_on(&self) -> bool {
        self.is_on
    }

    /// Time since which distances are on the other side of the threshold, s; `None` if they are not.
    pub fn leans_since_s(&self) -> Option<f64> {
        self.since_s
    }

    /// Adds the distance at a time; returns whether the warning is on. An unknown distance changes nothing.
    pub fn step(&mut self, now_s: f64, distance_mm: f64, rule: &Rule) -> bool {
        if distance_mm.is_nan() {
            return self.is_on;
        }
        let wants = if self.is_on { distance_mm <= rule.off_mm.max(rule.on_mm) } else { distance_mm <= rule.on_mm };
        if wants == self.is_on {
            self.since_s = None;
        } else if now_s - *self.since_s.get_or_insert(now_s) >= rule.min_s - 1e-9 {
            (self.is_on, self.since_s) = (wants, None);
        }
        self.is_on
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warning_needs_its_time_and_ends_beyond_the_farther_threshold() {
        let rule = Rule { on_mm: 5.0, off_mm: 7.0, min_s: 0.1 };
        let mut warning = Hysteresis::default();
        let mut run = |distances: &[(f64, f64)]| -> Vec<bool> {
            distances.iter().map(|(at, d)| warning.step(*at, *d, &rule)).collect()
        };
        // A flicker of 0.05 s is none; 0.1 s is one.
        assert_eq!(
            run(&[(0.0, 9.0), (0.05, 4.0), (0.1, 9.0), (0.15, 4.9), (0.2, 4.9), (0.25, 4.9)]),
            [false, false, false, false, false, true]
        );
        // Between both thresholds it stays, unknown distances too; beyond it ends after the same time.
        assert_eq!(
            run(&[(0.3, 6.9), (0.35, f64::NAN), (0.4, 7.1), (0.45, 6.0), (0.5, 7.5), (0.61, 8.0)]),
            [true, true, true, true, true, false]
        );
    }
}
