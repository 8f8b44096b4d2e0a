//! Tests with valid, truncated and malformed packets.

use panoscope_abi as abi;

use super::*;
use crate::random::SplitMix64;

fn table(rows: u32, columns: u32, names: &str, values: &[f64]) -> Vec<u8> {
    let mut names = names.as_bytes().to_vec();
    names.resize(names.len().next_multiple_of(8), 0);
    let mut bytes: Vec<u8> = [rows, columns, names.len() as u32, 0].iter().flat_map(|n| n.to_ne_bytes()).collect();
    bytes.extend(names);
    values.iter().for_each(|value| bytes.extend(value.to_ne_bytes()));
    bytes
}

fn detections(masks: bool) -> Vec<u8> {
    let mut bytes: Vec<u8> = [2u32, 13, 20, 3].iter().flat_map(|n| n.to_ne_bytes()).collect();
    bytes.extend(if masks { 18u64 } else { 0 }.to_ne_bytes());
    for (class, score) in [(1u32, 0.5f32), (0, 0.25)] {
        for number in [1.0, 2.0, 3.0, 4.0, score] {
            bytes.extend(number.to_ne_bytes());
        }
        bytes.extend(class.to_ne_bytes());
        bytes.extend((-1i64).to_ne_bytes());
    }
    bytes.extend(b"hook\nscissors");
    bytes.extend((0..if masks { 18 } else { 0 }).map(|n| n as u8));
    bytes
}

/// Reads every field of a packet, so that hostile sizes are used.
fn read_all(bytes: &[u8]) {
    if let Ok(table) = Table::parse(bytes) {
        assert!(table.names().count() == table.columns() || table.names().next().is_none());
        assert_eq!(table.values().count(), table.rows() * table.columns());
        assert!(table.byte_len() <= bytes.len());
        for (column, name) in table.names().enumerate() {
            let same_name = table.column(name).expect("the column exists");
            assert!(same_name <= column);
            assert_eq!(table.column_values(column).count(), table.rows());
        }
    }
    for list in [Detections::parse(bytes), Detections::parse_instances(bytes)].into_iter().flatten() {
        assert_eq!(list.items().count(), list.len());
        for (at, item) in list.items().enumerate() {
            let _ = (list.label(item.class_index), list.mask(at));
        }
    }
    let _ = (decode::<abi::Homography>(bytes), decode::<abi::Roi>(bytes), decode::<abi::Calibration>(bytes));
    let _ = (decode::<abi::Tip>(bytes), decode::<abi::Pose>(bytes), decode::<abi::Joints>(bytes));
    let _ = decode::<abi::Scalar>(bytes).map(|scalar| label(&scalar));
}

#[test]
fn a_table_has_columns_by_name() {
    let bytes = table(2, 2, "x mm\ny_px", &[1.0, -2.0, 3.0, f64::INFINITY]);
    let table = Table::parse(&bytes).unwrap();
    assert_eq!((table.rows(), table.columns(), table.byte_len()), (2, 2, bytes.len()));
    assert_eq!(table.names().collect::<Vec<_>>(), ["x mm", "y_px"]);
    assert_eq!((table.column("y_px"), table.column("y")), (Some(1), None));
    assert_eq!(table.column_values(1).collect::<Vec<_>>(), [-2.0, f64::INFINITY]);
    assert_eq!(table.column_values(2).count(), 0);
    assert_eq!((table.value(1, 0), table.value(2, 0), table.value(0, 2)), (Some(3.0), None, None));
    assert_eq!(table.values().collect::<Vec<_>>(), [1.0, -2.0, 3.0, f64::INFINITY]);
    let longer = [&bytes[..], &[7; 5]].concat();
    assert_eq!(Table::parse(&longer).unwrap().byte_len(), bytes.len());
}

#[test]
fn tables_without_rows_or_columns_are_tables() {
    let empty = Table::parse(&[0; 16]).unwrap();
    assert_eq!((empty.rows(), empty.columns(), empty.names().count()), (0, 0, 0));
    let bytes = table(0, 1, "a\n", &[]);
    assert_eq!(Table::parse(&bytes).unwrap().names().collect::<Vec<_>>(), ["a"], "a closing line feed is no name");
    let bytes = table(1, 2, "", &[1.0, 2.0]);
    let nameless = Table::parse(&bytes).unwrap();
    assert_eq!((nameless.columns(), nameless.names().count(), nameless.value(0, 1)), (2, 0, Some(2.0)));
    // No rows of many nameless columns fit few bytes: nothing may count them one by one.
    let bytes = table(0, u32::MAX, "", &[]);
    assert_eq!(Table::parse(&bytes).unwrap().names().count(), 0);
}

#[test]
fn errors_name_the_field() {
    let error = |bytes: &[u8]| Table::parse(bytes).unwrap_err().to_string();
    let good = table(2, 2, "a\nb", &[0.0; 4]);
    assert_eq!(error(&[]), "packet `table` is truncated: field `rows` ends at byte 4, but 0 bytes arrived");
    assert_eq!(error(&good[..6]), "packet `table` is truncated: field `columns` ends at byte 8, but 6 bytes arrived");
    assert_eq!(error(&good[..20]), "packet `table` is truncated: field `names` ends at byte 24, but 20 bytes arrived");
    assert_eq!(error(&good[..55]), "packet `table` is truncated: field `values` ends at byte 56, but 55 bytes arrived");
    assert_eq!(error(&table(1, 3, "a\nb", &[0.0; 3])), "packet `table`: field `names` has 2 names for 3 columns");
    let mut padding = good.clone();
    padding[8] = 3;
    assert_eq!(error(&padding), "packet `table`: field `names_len` is 3, which is not a multiple of 8");
    let mut text = good.clone();
    text[16] = 0xff;
    assert_eq!(error(&text), "packet `table`: field `names` is not UTF-8 text");
    let huge = table(u32::MAX, 2, "a\nb", &[]);
    assert!(error(&huge).contains("field `values`"));

    let list = detections(true);
    let error = |end: usize| Detections::parse_instances(&list[..end]).unwrap_err().to_string();
    assert_eq!(error(23), "packet `instances` is truncated: field `masks_len` ends at byte 24, but 23 bytes arrived");
    assert_eq!(error(87), "packet `instances` is truncated: field `entries` ends at byte 88, but 87 bytes arrived");
    assert!(error(100).contains("field `labels`"));
    assert!(error(118).contains("field `masks` ends at byte 119"));
    let error = decode::<abi::Scalar>(&[0; 41]).unwrap_err().to_string();
    assert_eq!(error, "packet `scalar` is truncated: field `unit` ends at byte 56, but 41 bytes arrived");
    let error = decode::<abi::Calibration>(&[0; 300]).unwrap_err().to_string();
    assert_eq!(error, "packet `calibration` is truncated: field `distortion` ends at byte 304, but 300 bytes arrived");
}

#[test]
fn boxes_have_labels_and_masks() {
    let bytes = detections(true);
    let list = Detections::parse_instances(&bytes).unwrap();
    assert_eq!((list.len(), list.image_size()), (2, (20, 3)));
    let items: Vec<_> = list.items().collect();
    assert_eq!((items[0].x_px, items[0].height_px, items[0].class_index), (1.0, 4.0, 1));
    assert_eq!((items[1].score, items[1].track_id), (0.25, -1));
    assert_eq!((list.label(1), list.label(2)), (Some("scissors"), None));
    assert_eq!(list.mask(1), (9..18).collect::<Vec<u8>>());
    assert_eq!((list.mask(2), list.mask(usize::MAX)), (&[][..], &[][..]));
    let bytes = detections(false);
    let list = Detections::parse(&bytes).unwrap();
    assert_eq!((list.len(), list.mask(0)), (2, &[][..]));
}

#[test]
fn a_scalar_has_a_label() {
    let mut bytes = 7.5f64.to_ne_bytes().to_vec();
    bytes.extend(b"error");
    bytes.resize(8 + 32, 0);
    bytes.extend(b"mm");
    bytes.resize(8 + 32 + 16, 0);
    let scalar: abi::Scalar = decode(&bytes).unwrap();
    assert_eq!((scalar.value, label(&scalar).as_str()), (7.5, "error mm"));
    assert_eq!(name(b"ab\0cd\0"), "ab");
    assert_eq!(name(b"ab"), "ab");
}

#[test]
fn a_cloud_has_points_and_its_rows_may_be_padded() {
    let mut bytes = vec![0; 3 * 40];
    for (at, value) in [(40 + 16, 1.5f32), (40 + 20, -2.0), (40 + 24, 50.0)] {
        bytes[at..at + 4].copy_from_slice(&value.to_ne_bytes());
    }
    bytes[40 + 28..40 + 32].copy_from_slice(&[1, 2, 3, 9]);
    let cloud = Cloud::parse(&bytes, 2, 3, 40).unwrap();
    let point = abi::CloudPoint { x_mm: 1.5, y_mm: -2.0, z_mm: 50.0, bgr: [1, 2, 3], filled: 9 };
    assert_eq!((cloud.width(), cloud.height(), cloud.point(1, 1)), (2, 3, Some(point)));
    assert_eq!((cloud.point(2, 0), cloud.point(0, 3)), (None, None));
    assert!(Cloud::parse(&bytes[..112], 2, 3, 40).is_ok(), "the last row needs no padding");
    let error = Cloud::parse(&bytes[..111], 2, 3, 40).unwrap_err().to_string();
    assert_eq!(error, "packet `cloud`: 2x3 with 40 bytes per row does not match 111 bytes");
    assert!(Cloud::parse(&bytes, 2, 3, 31).is_err(), "rows overlap");
    assert!(Cloud::parse(&bytes, usize::MAX, usize::MAX, usize::MAX).is_err());
}

#[test]
fn hostile_bytes_are_errors() {
    let whole = [table(2, 2, "a\nb", &[1.0; 4]), detections(false), detections(true)];
    for bytes in &whole {
        (0..bytes.len()).for_each(|end| read_all(&bytes[..end]));
    }
    (0..whole[0].len()).for_each(|end| assert!(Table::parse(&whole[0][..end]).is_err(), "{end}"));
    (0..whole[1].len()).for_each(|end| assert!(Detections::parse(&whole[1][..end]).is_err(), "{end}"));
    (0..whole[2].len()).for_each(|end| assert!(Detections::parse_instances(&whole[2][..end]).is_err(), "{end}"));
    let mut random = SplitMix64(11);
    for _ in 0..20_000 {
        // Random bytes, mostly small so that sizes are now and then plausible; or a packet with a few bytes changed.
        let mut bytes: Vec<u8> = match random.below(4) {
            0 => (0..random.below(200)).map(|_| random.bits() as u8).collect(),
            1 => {
                (0..random.below(200)).map(|_| if random.below(6) == 0 { random.below(12) as u8 } else { 0 }).collect()
            }
            _ => whole[random.below(whole.len())].clone(),
        };
        for _ in 0..random.below(4) {
            let at = random.below(bytes.len());
            if let Some(byte) = bytes.get_mut(at) {
                *byte = random.bits() as u8;
            }
        }
        read_all(&bytes);
    }
}
