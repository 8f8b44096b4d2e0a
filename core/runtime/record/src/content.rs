//! Compares packets by their content: tables cell by cell, clouds point by point.

use panoscope_abi::CloudPoint;
use panoscope_base::packet::{Cloud, Table};

/// Whether two numbers are equal: both NaN, or different by at most `tolerance` times the larger one (at least 1).
pub(super) fn is_equal(a: f64, b: f64, tolerance: f64) -> bool {
    (a.is_nan() && b.is_nan()) || a == b || (a - b).abs() <= tolerance * a.abs().max(b.abs()).max(1.0)
}

/// Reads a packet that is a table from its first byte to its last; `None` for all others. Packets do not name their
/// type, but no other type has this exact length.
pub(super) fn table(bytes: &[u8]) -> Option<Table<'_>> {
    Table::parse(bytes).ok().filter(|table| {
        table.columns() > 0 && table.names().count() == table.columns() && table.byte_len() == bytes.len()
    })
}

/// The first difference between two tables.
#[derive(Clone, Debug, PartialEq)]
pub enum FirstCell {
    /// A cell: row from 1, column, both values.
    Value(usize, String, f64, f64),
    /// A column that only one of them has, and whether that is the first one.
    Column(String, bool),
    /// The numbers of rows of both.
    Rows(usize, usize),
}

/// The difference between two packets of the same tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PacketDifference {
    /// Whether something differs by more than the tolerance.
    pub differs: bool,
    /// Whether their rows or columns differ, so that they are compared only in part.
    pub other_shape: bool,
    pub largest: f64,
    pub sum: f64,
    /// Number of values, or points, that were compared.
    pub values: f64,
    pub differing: f64,
    pub first_cell: Option<FirstCell>,
    /// Position of the two points of a cloud with the largest distance: column, row.
    pub farthest: Option<(usize, usize)>,
    /// Number of points that only one of the clouds has.
    pub only_in_one: u64,
    /// Number of points whose colour differs.
    pub recoloured: u64,
}

/// Compares two tables; columns are matched by name.
pub(super) fn tables(a: &Table<'_>, b: &Table<'_>, tolerance: f64) -> PacketDifference {
    let mut difference = PacketDifference::default();
    let alone = |in_a: &Table<'_>, in_b: &Table<'_>, first: bool| {
        let missing = in_a.names().find(|name| in_b.column(name).is_none());
        missing.map(|name| FirstCell::Column(name.to_owned(), first))
    };
    let shared: Vec<(&str, usize, usize)> =
        a.names().enumerate().filter_map(|(at, name)| Some((name, at, b.column(name)?))).collect();
    for row in 0..a.rows().min(b.rows()) {
        for &(name, left, right) in &shared {
            let (Some(x), Some(y)) = (a.value(row, left), b.value(row, right)) else { continue };
            difference.values += 1.0;
            let by = (x - y).abs();
            if by.is_finite() {
                difference.sum += by;
                difference.largest = difference.largest.max(by);
            }
            if !is_equal(x, y, tolerance) {
                difference.differing += 1.0;
                difference.first_cell.get_or_insert_with(|| FirstCell::Value(row + 1, name.to_owned(), x, y));
            }
        }
    }
    let column = alone(a, b, true).or_else(|| alone(b, a, false));
    let rows = (a.rows() != b.rows()).then_some(FirstCell::Rows(a.rows(), b.rows()));
    difference.other_shape = column.is_some() || rows.is_some();
    difference.first_cell = difference.first_cell.or(column).or(rows);
    difference.differs = difference.first_cell.is_some();
    difference
}

/// Compares two clouds of the same size, point by point; distances and `tolerance` in mm. A point that is measured in
/// one cloud and filled in the other counts as known to one only.
pub(super) fn clouds(a: &Cloud<'_>, b: &Cloud<'_>, tolerance: f64) -> PacketDifference {
    let mut difference = PacketDifference::default();
    for y in 0..a.height() {
        for x in 0..a.width() {
            let (Some(left), Some(right)) = (a.point(x, y), b.point(x, y)) else { continue };
            let position = |point: &CloudPoint| [point.x_mm, point.y_mm, point.z_mm].map(f64::from);
            let (p, q) = (position(&left), position(&right));
            difference.values += 1.0;
            let known = |p: &[f64; 3]| p.iter().all(|v| v.is_finite());
            let mut differs = false;
            match (known(&p), known(&q)) {
                (true, true) if left.filled == right.filled => {
                    let distance = (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>().sqrt();
                    difference.sum += distance;
                    if distance > difference.largest {
                        (difference.largest, difference.farthest) = (distance, Some((x, y)));
                    }
                    differs = distance > tolerance;
                    if left.bgr != right.bgr {
                        difference.recoloured += 1;
                        differs = true;
                    }
                }
                (false, false) => {}
                _ => {
                    difference.only_in_one += 1;
                    differs = true;
                }
            }
            difference.differing += f64::from(u8::from(differs));
        }
    }
    difference.differs = difference.differing > 0.0;
    difference
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(columns: &[&str], rows: &[&[f64]]) -> Vec<u8> {
        let mut names = columns.join("\n").into_bytes();
        names.resize(names.len().next_multiple_of(8), 0);
        let mut bytes = Vec::new();
        for count in [rows.len() as u32, columns.len() as u32, names.len() as u32, 0] {
            bytes.extend(count.to_le_bytes());
        }
        bytes.extend(names);
        rows.iter().copied().flatten().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes
    }

    fn compare(a: &[u8], b: &[u8], tolerance: f64) -> PacketDifference {
        tables(&super::table(a).expect("a table"), &super::table(b).expect("a table"), tolerance)
    }

    #[test]
    fn tables_differ_by_cell_and_name_the_first() {
        let a = table(&["x_mm", "y_mm"], &[&[1.0, 2.0], &[3.0, f64::NAN]]);
        let near = table(&["x_mm", "y_mm"], &[&[1.0, 2.0], &[3.0 + 1e-9, f64::from_bits(0x7ff8_0000_0000_0001)]]);
        assert!(compare(&a, &near, 0.0).differs, "exactly");
        assert!(!compare(&a, &near, 1e-6).differs, "another kind of unknown is unknown all the same");
        let far = table(&["x_mm", "y_mm"], &[&[1.0, 2.0], &[3.5, 9.0]]);
        let difference = compare(&a, &far, 1e-6);
        assert_eq!(difference.first_cell, Some(FirstCell::Value(2, "x_mm".to_owned(), 3.0, 3.5)));
        assert_eq!((difference.largest, difference.differing, difference.values), (0.5, 2.0, 4.0));
        // Columns are matched by name; what only one has is named.
        let turned = table(&["y_mm", "x_mm"], &[&[2.0, 1.0], &[f64::NAN, 3.0]]);
        assert!(!compare(&a, &turned, 0.0).differs);
        let other = table(&["x_mm", "z_mm"], &[&[1.0, 2.0], &[3.0, 4.0]]);
        assert_eq!(compare(&a, &other, 0.0).first_cell, Some(FirstCell::Column("y_mm".to_owned(), true)));
        let longer = table(&["x_mm", "y_mm"], &[&[1.0, 2.0], &[3.0, f64::NAN], &[5.0, 6.0]]);
        assert_eq!(compare(&a, &longer, 0.0).first_cell, Some(FirstCell::Rows(2, 3)));
        assert!(compare(&a, &longer, 0.0).other_shape);
        // What is not a table is none, wherever it is cut.
        (0..a.len()).for_each(|len| assert_eq!(super::table(&a[..len]), None, "{len}"));
    }

    fn cloud(points: &[[f32; 3]]) -> Vec<u8> {
        let bytes =
            points.iter().map(|p| [p[0].to_le_bytes(), p[1].to_le_bytes(), p[2].to_le_bytes(), [1, 2, 3, 0]].concat());
        bytes.collect::<Vec<_>>().concat()
    }

    #[test]
    fn clouds_differ_by_distance_and_by_missing_points() {
        let unknown = [f32::NAN; 3];
        let a = cloud(&[[0.0, 0.0, 50.0], [1.0, 0.0, 50.0], unknown, [2.0, 0.0, 50.0]]);
        let b = cloud(&[[0.0, 0.0, 50.25], [1.0, 3.0, 54.0], [9.0, 9.0, 9.0], unknown]);
        let clouds = |a: &[u8], b: &[u8], tolerance: f64| {
            let parsed = |bytes| Cloud::parse(bytes, 2, 2, 32).expect("a cloud");
            super::clouds(&parsed(a), &parsed(b), tolerance)
        };
        let difference = clouds(&a, &b, 0.5);
        assert_eq!((difference.largest, difference.farthest), (5.0, Some((1, 0))));
        assert_eq!((difference.only_in_one, difference.differing, difference.recoloured), (2, 3.0, 0));
        assert!(!clouds(&a, &a, 0.0).differs);
        let mut recoloured = a.clone();
        recoloured[12] = 9;
        let difference = clouds(&a, &recoloured, 0.5);
        assert_eq!((difference.recoloured, difference.differs, difference.largest), (1, true, 0.0));
        let mut filled = a.clone();
        filled[15] = 1;
        let difference = clouds(&a, &filled, 0.5);
        assert_eq!((difference.only_in_one, difference.differs), (1, true));
        assert!(!clouds(&filled, &filled, 0.0).differs);
    }
}
