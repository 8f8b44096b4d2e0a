//! A plane through the nearness of cells.

/// Number of independent sums over cells.
const LANES: usize = 4;

/// Position on a plane (1, column, row) and value of each cell; `row` gives the position of a row.
pub(super) fn positions<'a>(
    values: &'a [f32],
    columns: &'a [f64],
    row: impl Fn(usize) -> f64 + 'a,
) -> impl Iterator<Item = ([f64; 3], f32)> + 'a {
    values.chunks_exact(columns.len()).enumerate().flat_map(move |(y, values)| {
        let y = row(y);
        columns.iter().zip(values).map(move |(x, value)| ([1.0, *x, y], *value))
    })
}

/// Sums for a plane through values at (1, column, row).
#[derive(Default)]
pub(super) struct Sums {
    m: [[f64; 3]; 3],
    v: [f64; 3],
}

impl Sums {
    /// Adds the known values of a row at `y` that `is_kept` keeps, given their columns.
    pub(super) fn add_row(&mut self, columns: &[f64], values: &[f32], y: f64, is_kept: impl Fn(f64, f32) -> bool) {
        // Count, columns, their squares, values, and values times columns; in lanes, which are added up side by side.
        let mut lanes = [[0.0_f64; LANES]; 5];
        let mut add = |lane: usize, x: f64, value: f32| {
            let is_kept = value.is_finite() & is_kept(x, value);
            let [one, value] = if is_kept { [1.0, f64::from(value)] } else { [0.0; 2] };
            let terms = [one, one * x, one * x * x, value, value * x];
            lanes.iter_mut().zip(terms).for_each(|(sums, term)| sums[lane] += term);
        };
        let ((xs, x_rest), (parts, rest)) = (columns.as_chunks::<LANES>(), values.as_chunks::<LANES>());
        for (xs, values) in xs.iter().zip(parts) {
            (0..LANES).for_each(|lane| add(lane, xs[lane], values[lane]));
        }
        x_rest.iter().zip(rest).enumerate().for_each(|(lane, (x, value))| add(lane, *x, *value));
        let [n, x, xx, z, zx] = lanes.map(|lanes| lanes.iter().sum::<f64>());
        let terms = [[n, x, n * y], [x, xx, x * y], [n * y, x * y, n * y * y]];
        self.m.iter_mut().flatten().zip(terms.as_flattened()).for_each(|(sum, term)| *sum += term);
        self.v.iter_mut().zip([z, zx, z * y]).for_each(|(sum, term)| *sum += term);
    }

    /// The normal equations: matrix and right side.
    pub(super) fn equations(&self) -> ([[f64; 3]; 3], [f64; 3]) {
        (self.m, self.v)
    }
}

/// Solves three equations by Cramer's rule; `None` if they are singular.
pub(super) fn solve(m: [[f64; 3]; 3], v: [f64; 3]) -> Option<[f64; 3]> {
    let det = |a: [[f64; 3]; 3]| {
        a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1]) - a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0])
            + a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0])
    };
    let whole = det(m);
    let scale = m.iter().flatten().fold(0.0_f64, |most, v| most.max(v.abs()));
    if whole.abs() <= 1e-9 * scale.powi(3) {
        return None;
    }
    Some([0, 1, 2].map(|column| {
        let mut with = m;
        (0..3).for_each(|row| with[row][column] = v[row]);
        det(with) / whole
    }))
}
