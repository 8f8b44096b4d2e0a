//! The cheapest one-to-one assignment (Kuhn 1955, "The Hungarian method"; by shortest augmenting paths after Jonker and
//! Volgenant 1987), in fixed memory.

/// Maximum number of rows.
pub const ROWS: usize = 8;
/// Maximum number of columns.
pub const COLUMNS: usize = 16;
/// Columns of the solved problem: one more per row, which leaves it unassigned.
const ALL: usize = COLUMNS + ROWS;
/// Cost of leaving a row unassigned: more than any pair, so that as many rows as possible are assigned, and these as
/// cheaply as possible.
const UNASSIGNED: f64 = 1e6;
/// Cost of a forbidden pair.
const FORBIDDEN: f64 = 1e12;

/// Cost of each pair; infinite if the pair is forbidden.
pub type Costs = [[f64; COLUMNS]; ROWS];

/// Assigns the first `rows` rows to the first `columns` columns. Returns the column of each row, `None` if no pair is
/// allowed.
pub fn assign(costs: &Costs, rows: usize, columns: usize) -> [Option<usize>; ROWS] {
    let (rows, columns) = (rows.min(ROWS), columns.min(COLUMNS));
    let cost = |row: usize, column: usize| {
        if column < columns {
            let cost = costs[row][column];
            if cost.is_finite() { cost.clamp(-UNASSIGNED / 2.0, UNASSIGNED / 2.0) } else { FORBIDDEN }
        } else if column - columns == row {
            UNASSIGNED
        } else {
            FORBIDDEN
        }
    };
    // Potentials of rows and columns; index 0 stands for none, as rows and columns count from 1 here.
    let width = columns + rows;
    let (mut of_row, mut of_column) = ([0.0; ROWS + 1], [0.0; ALL + 1]);
    let mut row_at = [0_usize; ALL + 1];
    for row in 1..=rows {
        row_at[0] = row;
        let mut at = 0;
        let (mut least, mut done, mut came_from) = ([f64::INFINITY; ALL + 1], [false; ALL + 1], [0_usize; ALL + 1]);
        // The shortest path to a free column.
        while row_at[at] != 0 {
            done[at] = true;
            let here = row_at[at];
            let (mut step, mut next) = (f64::INFINITY, 0);
            for column in 1..=width {
                if done[column] {
                    continue;
                }
                let reduced = cost(here - 1, column - 1) - of_row[here] - of_column[column];
                if reduced < least[column] {
                    (least[column], came_from[column]) = (reduced, at);
                }
                if least[column] < step {
                    (step, next) = (least[column], column);
                }
            }
            for column in 0..=width {
                if done[column] {
                    of_row[row_at[column]] += step;
                    of_column[column] -= step;
                } else {
                    least[column] -= step;
                }
            }
            at = next;
        }
        // Along it each row moves on to the next column.
        while at != 0 {
            let before = came_from[at];
            row_at[at] = row_at[before];
            at = before;
        }
    }
    let mut out = [None; ROWS];
    for column in 1..=columns {
        let row = row_at[column];
        if row > 0 && costs[row - 1][column - 1].is_finite() {
            out[row - 1] = Some(column - 1);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_base::random::SplitMix64;

    /// Tries all assignments: returns the number of pairs, then their cost.
    fn exhaustive(costs: &Costs, row: usize, rows: usize, columns: usize, taken: u32) -> (usize, f64) {
        if row == rows {
            return (0, 0.0);
        }
        let mut best = exhaustive(costs, row + 1, rows, columns, taken);
        for column in (0..columns).filter(|column| taken & (1 << column) == 0) {
            let cost = costs[row][column];
            if cost.is_finite() {
                let (pairs, rest) = exhaustive(costs, row + 1, rows, columns, taken | 1 << column);
                if pairs + 1 > best.0 || (pairs + 1 == best.0 && rest + cost < best.1) {
                    best = (pairs + 1, rest + cost);
                }
            }
        }
        best
    }

    #[test]
    fn no_other_assignment_is_better() {
        let mut random = SplitMix64(3);
        for _ in 0..400 {
            let (rows, columns) = (random.below(6), random.below(7));
            let mut costs = [[f64::INFINITY; COLUMNS]; ROWS];
            for line in costs.iter_mut().take(rows) {
                for cost in line.iter_mut().take(columns) {
                    if random.below(4) > 0 {
                        *cost = 40.0 * panoscope_base::random::unit(random.bits()) - 10.0;
                    }
                }
            }
            let found = assign(&costs, rows, columns);
            let pairs: Vec<(usize, usize)> = (0..ROWS).filter_map(|row| Some((row, found[row]?))).collect();
            let mut used: Vec<usize> = pairs.iter().map(|p| p.1).collect();
            used.sort_unstable();
            used.dedup();
            assert_eq!(used.len(), pairs.len(), "each column once");
            let cost: f64 = pairs.iter().map(|(row, column)| costs[*row][*column]).sum();
            let (most, least) = exhaustive(&costs, 0, rows, columns, 0);
            assert_eq!(pairs.len(), most);
            assert!((cost - least).abs() < 1e-6, "{cost} where {least} can be had");
        }
    }

    #[test]
    fn empty_and_invalid_costs_assign_nothing() {
        let mut costs = [[f64::INFINITY; COLUMNS]; ROWS];
        assert_eq!(assign(&costs, 0, 0), [None; ROWS]);
        assert_eq!(assign(&costs, ROWS, COLUMNS), [None; ROWS]);
        costs[0][0] = f64::NAN;
        costs[1][1] = f64::NEG_INFINITY;
        costs[2][0] = 3.0;
        let found = assign(&costs, 3, 2);
        assert_eq!((found[0], found[1], found[2]), (None, None, Some(0)));
    }
}
