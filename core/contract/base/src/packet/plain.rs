//! Packets of fixed size.

use std::mem::offset_of;

use panoscope_abi as abi;

use super::PacketError;
use super::fields::{Field, Fields};

/// A packet of fixed size.
pub trait Decode: Field {
    /// Packet type in graph files.
    const NAME: &'static str;
}

/// Reads a packet of fixed size from the start of `bytes`.
///
/// # Errors
/// When the bytes are fewer than the packet's.
pub fn decode<T: Decode>(bytes: &[u8]) -> Result<T, PacketError> {
    T::read(&mut Fields::new(T::NAME, bytes), T::NAME)
}

/// A name that the contract stores zero-padded; invalid UTF-8 is replaced.
pub fn name(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

/// Name of a scalar with its unit behind it: `error mm`.
pub fn label(scalar: &abi::Scalar) -> String {
    let (name, unit) = (name(&scalar.name), name(&scalar.unit));
    if unit.is_empty() { name } else { format!("{name} {unit}") }
}

// The fields must stand in the order of the struct and leave no gap: checked below at compile time.
macro_rules! plain {
    ($($name:literal $ty:ident { $($field:ident: $field_ty:ty),* $(,)? })*) => {$(
        impl Field for abi::$ty {
            #[inline]
            fn read(fields: &mut Fields<'_>, _: &'static str) -> Result<Self, PacketError> {
                Ok(Self { $($field: Field::read(fields, stringify!($field))?),* })
            }
        }
        impl Decode for abi::$ty {
            const NAME: &'static str = $name;
        }
        const _: () = {
            let mut at = 0;
            $(
                assert!(offset_of!(abi::$ty, $field) == at);
                at += size_of::<$field_ty>();
            )*
            assert!(at == size_of::<abi::$ty>());
        };
    )*};
}

plain! {
    "homography" Homography { left_from_right: [f64; 9], rms_px: f64, inliers: u32, state: u32 }
    "roi" Roi { x: i32, y: i32, width: i32, height: i32 }
    "calibration" Camera { width: u32, height: u32, fx: f64, fy: f64, cx: f64, cy: f64, distortion: [f64; 14] }
    "calibration" Calibration {
        left: abi::Camera,
        right: abi::Camera,
        right_from_left_rotation: [f64; 9],
        right_from_left_mm: [f64; 3],
        rectified_from_left: [f64; 9],
        rectified_from_right: [f64; 9],
        left_projection: [f64; 12],
        right_projection: [f64; 12],
        baseline_mm: f64,
        rms_px: f64,
        is_rectified: u32,
        stated_error: u32,
    }
    "cloud" CloudPoint { x_mm: f32, y_mm: f32, z_mm: f32, bgr: [u8; 3], filled: u8 }
    "detections" Detection {
        x_px: f32,
        y_px: f32,
        width_px: f32,
        height_px: f32,
        score: f32,
        class_index: u32,
        track_id: i64,
    }
    "detections" DetectionsHeader { count: u32, labels_len: u32, image_width: u32, image_height: u32, masks_len: u64 }
    "tip" Tip {
        u_px: f64,
        v_px: f64,
        xyz_mm: [f64; 3],
        score: f64,
        class_index: u32,
        xyz_valid: u32,
        track_id: i64,
    }
    "pose" Pose { a_from_b_wxyz: [f64; 4], a_from_b_mm: [f64; 3], a: [u8; 16], b: [u8; 16] }
    "joints" Joints {
        position_rad: [f64; abi::MAX_JOINTS],
        velocity_rad_s: [f64; abi::MAX_JOINTS],
        count: u32,
        reserved: u32,
    }
    "scalar" Scalar { value: f64, name: [u8; 32], unit: [u8; 16] }
    "table" TableHeader { rows: u32, columns: u32, names_len: u32, reserved: u32 }
}
