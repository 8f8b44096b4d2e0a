//! Fills unknown cells from known cells around them.

/// Sweeps of the relaxation.
const SWEEPS: usize = 60;
/// Over-relaxation (Young 1954).
const OMEGA: f32 = 1.75;

/// Reusable buffers of the filling.
#[derive(Clone, Debug, Default)]
pub struct Fill {
    /// Steps from the nearest known cell; 0 for known ones, `u16::MAX` beyond reach.
    steps: Vec<u16>,
    /// Cells to fill, nearest to known cells first.
    holes: Vec<u32>,
}

/// Neighbours of a cell: left, right, above, below.
fn beside(at: usize, columns: usize, rows: usize) -> [Option<usize>; 4] {
    let (x, y) = (at % columns, at / columns);
    [
        (x > 0).then(|| at - 1),
        (x + 1 < columns).then(|| at + 1),
        (y > 0).then(|| at - columns),
        (y + 1 < rows).then(|| at + columns),
    ]
}

impl Fill {
    /// Whether a cell was filled in.
    pub fn is_filled(&self, at: usize) -> bool {
        self.steps.get(at).is_some_and(|steps| (1..u16::MAX).contains(steps))
    }

    /// Fills NaN cells within `reach` cells of known ones by a membrane: each is the mean of its neighbours, so that
    /// filled values stay within the range of the known ones around them. Others stay NaN.
    pub fn fill(&mut self, values: &mut [f32], columns: usize, rows: usize, reach: u16) {
        self.steps.clear();
        self.steps.extend(values.iter().map(|v| if v.is_finite() { 0 } else { u16::MAX }));
        self.holes.clear();
        let (steps, holes) = (&mut self.steps, &mut self.holes);
        for at in (0..values.len()).filter(|at| values[*at].is_finite()) {
            for hole in beside(at, columns, rows).into_iter().flatten().filter(|n| values[*n].is_nan()) {
                if steps[hole] == u16::MAX {
                    steps[hole] = 1;
                    holes.push(hole as u32);
                }
            }
        }
        // Rings of holes around what is known, each filled from the rings before.
        let mut from = 0;
        for ring in 1..=reach {
            let end = holes.len();
            for k in from..end {
                let at = holes[k] as usize;
                let known = beside(at, columns, rows).into_iter().flatten().filter(|n| steps[*n] < ring);
                let (sum, count) = known.fold((0.0, 0.0), |(sum, count), n| (sum + values[n], count + 1.0));
                values[at] = sum / count;
                for hole in beside(at, columns, rows).into_iter().flatten() {
                    if steps[hole] == u16::MAX && ring < reach {
                        steps[hole] = ring + 1;
                        holes.push(hole as u32);
                    }
                }
            }
            from = end;
        }
        for _ in 0..SWEEPS {
            for hole in &self.holes {
                let at = *hole as usize;
                let near = beside(at, columns, rows).into_iter().flatten().filter(|n| self.steps[*n] != u16::MAX);
                let (sum, count) = near.fold((0.0, 0.0), |(sum, count), n| (sum + values[n], count + 1.0));
                values[at] += OMEGA * (sum / count - values[at]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_in_a_slope_becomes_the_slope_and_what_is_far_stays_unknown() {
        let (columns, rows) = (120, 60);
        let slope = |at: usize| 50.0 + 0.1 * (at % columns) as f32 - 0.05 * (at / columns) as f32;
        let is_hole = |at: usize| {
            let (x, y) = (at % columns, at / columns);
            ((20..35).contains(&x) && y >= 20) || x >= 80
        };
        let mut values: Vec<f32> =
            (0..columns * rows).map(|at| if is_hole(at) { f32::NAN } else { slope(at) }).collect();
        let mut fill = Fill::default();
        fill.fill(&mut values, columns, rows, 28);
        for y in 20..rows {
            for x in 20..35 {
                let at = y * columns + x;
                assert!(fill.is_filled(at));
                // The picture's lower border has nothing beyond it.
                let allowed = if y < 50 { 0.1 } else { 0.4 };
                assert!((values[at] - slope(at)).abs() < allowed, "{x} {y}: {} {}", values[at], slope(at));
            }
        }
        assert!(values[30 * columns + 80 + 28 - 1].is_finite());
        assert!(values[30 * columns + 80 + 28].is_nan() && !fill.is_filled(0));
        let mut nothing = vec![f32::NAN; 12];
        fill.fill(&mut nothing, 4, 3, 28);
        assert!(nothing.iter().all(|v| v.is_nan()));
    }
}
