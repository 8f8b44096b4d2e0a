//! Frames whose description does not fit their bytes, as a faulty plugin might make them, give errors and no read
//! outside the buffer.

use panoscope_node::abi::{self, DetectionsHeader, Frame, Roi, TableHeader};
use panoscope_node::input::FromFrame;
use panoscope_node::*;

/// 64 bytes, aligned for every packet.
#[repr(align(16))]
struct Bytes([u8; 64]);

fn frame(bytes: &mut Bytes, spoil: impl FnOnce(&mut Frame)) -> Frame {
    let buffer = abi::BufferId { pool: 1, home: 0, offset: 0 };
    let mut frame = Frame { buffer, data: bytes.0.as_mut_ptr(), len: 64, ..Frame::EMPTY };
    spoil(&mut frame);
    frame
}

fn put<T>(bytes: &mut Bytes, header: T) {
    assert!(size_of::<T>() <= 64 && align_of::<T>() <= 16);
    // SAFETY: size and alignment are asserted above.
    unsafe { bytes.0.as_mut_ptr().cast::<T>().write(header) };
}

#[test]
fn images() {
    let mut bytes = Bytes([0; 64]);
    let mut fits = |width, height, stride_bytes, format| {
        let frame = frame(&mut bytes, |f| {
            (f.width, f.height, f.stride_bytes, f.format) = (width, height, stride_bytes, format);
        });
        match format {
            abi::FORMAT_GRAY16 => Image::<Gray16>::from_frame(&frame).is_ok(),
            _ => Image::<Gray8>::from_frame(&frame).is_ok(),
        }
    };
    assert!(fits(8, 8, 8, abi::FORMAT_GRAY8) && fits(4, 8, 8, abi::FORMAT_GRAY16));
    assert!(fits(4, 8, 8, abi::FORMAT_GRAY8), "the last row needs no padding, but may have it");
    assert!(!fits(9, 8, 8, abi::FORMAT_GRAY8), "rows overlap");
    assert!(!fits(8, 9, 8, abi::FORMAT_GRAY8), "a row too many");
    assert!(!fits(4, 7, 9, abi::FORMAT_GRAY16), "rows begin between two pixels");
    assert!(!fits(u32::MAX, u32::MAX, u32::MAX, abi::FORMAT_GRAY8), "the size overflows");
    let odd = frame(&mut bytes, |f| {
        // SAFETY: stays inside the bytes.
        (f.data, f.len) = (unsafe { f.data.add(1) }, 63);
        (f.width, f.height, f.stride_bytes, f.format) = (2, 2, 4, abi::FORMAT_GRAY16);
    });
    assert!(Image::<Gray16>::from_frame(&odd).is_err(), "misaligned");
}

#[test]
fn plain_data_and_clouds() {
    let mut bytes = Bytes([0; 64]);
    assert!(Value::<Roi>::from_frame(&frame(&mut bytes, |_| ())).is_ok());
    assert!(Value::<Roi>::from_frame(&frame(&mut bytes, |f| f.len = 15)).is_err());
    let cloud = |width, height, format| move |f: &mut Frame| (f.width, f.height, f.format) = (width, height, format);
    assert!(Cloud::from_frame(&frame(&mut bytes, cloud(2, 2, abi::FORMAT_CLOUD))).is_ok());
    assert!(Cloud::from_frame(&frame(&mut bytes, cloud(2, 2, abi::FORMAT_BYTES))).is_err());
    assert!(Cloud::from_frame(&frame(&mut bytes, cloud(5, 1, abi::FORMAT_CLOUD))).is_err());
    assert!(Cloud::from_frame(&frame(&mut bytes, cloud(u32::MAX, u32::MAX, abi::FORMAT_CLOUD))).is_err());
}

#[test]
fn packets_with_counts() {
    let mut bytes = Bytes([0; 64]);
    let mut table = |rows, columns, names_len| {
        put(&mut bytes, TableHeader { rows, columns, names_len, reserved: 0 });
        Table::from_frame(&frame(&mut bytes, |_| ())).is_ok()
    };
    assert!(table(2, 2, 8) && table(0, 0, 0));
    assert!(!table(5, 1, 16) && !table(1, 1, 7) && !table(u32::MAX, u32::MAX, 8) && !table(1, 1, u32::MAX - 7));
    let mut detections = |count, labels_len, image_width, image_height| {
        put(&mut bytes, DetectionsHeader { count, labels_len, image_width, image_height, masks_len: 0 });
        let frame = frame(&mut bytes, |_| ());
        (Detections::from_frame(&frame).is_ok(), Instances::from_frame(&frame).is_ok())
    };
    assert_eq!(detections(1, 4, 8, 4), (true, true));
    assert_eq!(detections(1, 4, 8, 5), (true, false), "the mask is cut off");
    assert_eq!(detections(2, 0, 8, 4), (false, false));
    assert_eq!(detections(1, 9, 0, 0), (false, false));
    assert_eq!(detections(u32::MAX, u32::MAX, u32::MAX, u32::MAX), (false, false));
    assert_eq!(detections(1, 0, u32::MAX, u32::MAX), (true, false));
    let mut text = Bytes([b'a'; 64]);
    assert!(Text::from_frame(&frame(&mut text, |_| ())).is_ok());
    text.0[3] = 0xFF;
    assert!(Text::from_frame(&frame(&mut text, |_| ())).is_err());
}
