//! Packets from recordings and other processes.

use panoscope_abi as abi;
use panoscope_base::packet::{Cloud, Detections, Numbers, Table, decode, label, name};

use crate::draw::Draw;

pub fn run(bytes: &[u8]) {
    if let Ok(table) = Table::parse(bytes) {
        assert!(table.byte_len() <= bytes.len());
        assert_eq!(table.values().count(), table.rows() * table.columns());
        assert_eq!(table.cells().len(), table.rows() * table.columns() * 8);
        let names: Vec<&str> = table.names().collect();
        assert!(names.len() == table.columns() || names.is_empty());
        for (column, name) in names.iter().enumerate() {
            assert!(table.column(name).is_some_and(|first| first <= column));
        }
        let last = table.columns().saturating_sub(1);
        assert_eq!(table.column_values(last).count(), if table.columns() == 0 { 0 } else { table.rows() });
        assert_eq!(table.value(table.rows(), 0), None);
        assert_eq!(table.value(0, table.columns()), None);
    }
    for list in [Detections::parse(bytes), Detections::parse_instances(bytes)].into_iter().flatten() {
        assert_eq!(list.items().count(), list.len());
        let classes = list.labels().count();
        for (at, item) in list.items().enumerate() {
            assert_eq!(list.label(item.class_index).is_some(), (item.class_index as usize) < classes);
            assert!(list.mask(at).len() <= bytes.len());
        }
    }
    for packet in ["table", "scalar", "image"] {
        if let Ok(Some(numbers)) = Numbers::read(bytes, packet) {
            assert!(numbers.values.len() * 8 <= bytes.len().max(8));
            assert!(numbers.rows().all(|row| row.len() == numbers.names.len().max(1)));
            assert!(numbers.first_row().is_none_or(|row| row.len() == numbers.names.len()));
        }
    }
    let _ = (decode::<abi::Homography>(bytes), decode::<abi::Roi>(bytes), decode::<abi::Calibration>(bytes));
    let _ = (decode::<abi::Tip>(bytes), decode::<abi::Pose>(bytes), decode::<abi::Joints>(bytes));
    let _ = (decode::<abi::Scalar>(bytes).map(|scalar| label(&scalar)), name(bytes));
    let mut draw = Draw(bytes);
    let (width, height, stride) = (draw.u32() as usize, draw.u32() as usize, draw.u32() as usize);
    let rest = draw.0;
    if let Ok(cloud) = Cloud::parse(rest, width, height, stride) {
        for (column, row) in [(0, 0), (width.wrapping_sub(1), height.wrapping_sub(1))] {
            assert_eq!(cloud.point(column, row).is_some(), width > 0 && height > 0, "{width}x{height}");
        }
        assert!(cloud.point(width, 0).is_none() && cloud.point(0, height).is_none());
    }
}

fn header(numbers: &[u32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_ne_bytes()).collect()
}

pub fn seeds() -> Vec<Vec<u8>> {
    let mut table = header(&[2, 2, 8, 0]);
    table.extend(b"x mm\ny\0\0");
    [1.0f64, -2.0, 3.0, f64::NAN].iter().for_each(|value| table.extend(value.to_ne_bytes()));
    let mut boxes = header(&[1, 4, 20, 3]);
    boxes.extend(9u64.to_ne_bytes());
    [1.0f32, 2.0, 3.0, 4.0, 0.5].iter().for_each(|value| boxes.extend(value.to_ne_bytes()));
    boxes.extend(0u32.to_ne_bytes());
    boxes.extend((-1i64).to_ne_bytes());
    boxes.extend(b"hook");
    boxes.extend([0xff; 9]);
    let mut cloud = header(&[2, 1, 32]);
    cloud.extend([0; 32]);
    vec![table, boxes, cloud, vec![0; 700], header(&[u32::MAX; 4]), header(&[0, u32::MAX, 0, 0])]
}
