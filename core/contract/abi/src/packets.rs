//! Plain data that flows between nodes. Camera frames: x right, y down, z forward, mm.

/// The registration was found on this tick.
pub const STATE_FRESH: u32 = 0;
/// The registration of an earlier tick is still in use.
pub const STATE_HELD: u32 = 1;
/// No registration to rely on.
pub const STATE_LOST: u32 = 2;

/// Packet `homography`: maps pixels of the right view to pixels of the left view.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography {
    /// Row-major 3x3.
    pub left_from_right: [f64; 9],
    /// Root mean square distance of the inliers in px.
    pub rms_px: f64,
    /// Correspondences that agree.
    pub inliers: u32,
    /// `STATE_FRESH`, `STATE_HELD` or `STATE_LOST`.
    pub state: u32,
}

/// Packet `roi`: a rectangle in pixels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Roi {
    /// Left edge in px.
    pub x: i32,
    /// Upper edge in px.
    pub y: i32,
    /// Width in px.
    pub width: i32,
    /// Height in px.
    pub height: i32,
}

/// One camera in OpenCV's model.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image width in px.
    pub width: u32,
    /// Image height in px.
    pub height: u32,
    /// Focal length in px, horizontal.
    pub fx: f64,
    /// Focal length in px, vertical.
    pub fy: f64,
    /// Principal point in px, horizontal.
    pub cx: f64,
    /// Principal point in px, vertical.
    pub cy: f64,
    /// k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y. A tau_x of 1e6 marks an equidistant lens (Kannala
    /// and Brandt; OpenCV's `fisheye`), whose k1, k2, k3, k4 come first; all others are 0.
    pub distortion: [f64; 14],
}

/// Packet `calibration`: both cameras and their rectification.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Left camera.
    pub left: Camera,
    /// Right camera.
    pub right: Camera,
    /// Rotation from the left camera's frame to the right one's, row-major 3x3.
    pub right_from_left_rotation: [f64; 9],
    /// Translation from the left camera's frame to the right one's in mm.
    pub right_from_left_mm: [f64; 3],
    /// Rotation from the left camera's frame to the rectified one, row-major 3x3.
    pub rectified_from_left: [f64; 9],
    /// Rotation from the right camera's frame to the rectified one, row-major 3x3.
    pub rectified_from_right: [f64; 9],
    /// Projection of the rectified left view, row-major 3x4.
    pub left_projection: [f64; 12],
    /// Projection of the rectified right view, row-major 3x4.
    pub right_projection: [f64; 12],
    /// Distance of the camera centres in mm.
    pub baseline_mm: f64,
    /// Reprojection error of the calibration in px; NaN when unknown.
    pub rms_px: f64,
    /// 1 when the views that this calibration describes are rectified already.
    pub is_rectified: u32,
    /// What the calibration states of its own error, 0 when it states nothing: four bytes from the lowest on, each 0 or
    /// `0.001 * 2^((byte - 1) / 18)`. Standard deviations: of the offset of all disparities, px; of all lengths at one
    /// depth, percent; of each disparity beside these, px. The fourth is that depth, in m: there the offset of disparities
    /// changes no length. Since `ABI_MINOR` 5.
    pub stated_error: u32,
}

/// One point of a `cloud`, whose frame is `width` x `height` points; NaN coordinates mean unknown.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudPoint {
    /// Right, mm.
    pub x_mm: f32,
    /// Down, mm.
    pub y_mm: f32,
    /// Forward, mm.
    pub z_mm: f32,
    /// Blue, green, red.
    pub bgr: [u8; 3],
    /// 0 where the point was measured, 1 where it was filled in from the points around it: such a point is shown as a
    /// guess, and no length is taken from it. Older plugins and recordings have 0 in all points. Since `ABI_MINOR` 4.
    pub filled: u8,
}

impl CloudPoint {
    /// Whether all coordinates are known, measured or filled in.
    pub fn is_known(&self) -> bool {
        self.x_mm.is_finite() && self.y_mm.is_finite() && self.z_mm.is_finite()
    }

    /// Whether the coordinates are known and were measured.
    pub fn is_measured(&self) -> bool {
        self.is_known() && self.filled == 0
    }
}

/// One entry of `detections`. The packet is [`DetectionsHeader`], the entries, then the label text.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Left edge in px.
    pub x_px: f32,
    /// Upper edge in px.
    pub y_px: f32,
    /// Width in px.
    pub width_px: f32,
    /// Height in px.
    pub height_px: f32,
    /// 0..1.
    pub score: f32,
    /// Index into the label table.
    pub class_index: u32,
    /// Stays with the object over time; -1 when not tracked.
    pub track_id: i64,
}

/// Opens a `detections` or `instances` packet.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DetectionsHeader {
    /// Number of [`Detection`]s that follow.
    pub count: u32,
    /// Bytes of label text (names separated by line feeds) after the entries.
    pub labels_len: u32,
    /// Width in px of the image that was searched.
    pub image_width: u32,
    /// Height in px of the image that was searched.
    pub image_height: u32,
    /// `instances` only: bytes of bit masks after the label text. Per entry a mask of the whole image, rows padded to
    /// whole bytes, most significant bit first.
    pub masks_len: u64,
}

/// Packet `tip`: the tip of one tool.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tip {
    /// Pixel in the left view, horizontal.
    pub u_px: f64,
    /// Pixel in the left view, vertical.
    pub v_px: f64,
    /// Place in the left rectified camera's frame in mm; NaN when unknown.
    pub xyz_mm: [f64; 3],
    /// 0..1.
    pub score: f64,
    /// Index into the label table of the detector.
    pub class_index: u32,
    /// 1 when `xyz_mm` can be relied on.
    pub xyz_valid: u32,
    /// Stays with the tool over time; -1 when not tracked.
    pub track_id: i64,
}

/// Packet `pose`: position and orientation of frame `b` in frame `a`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Rotation as quaternion w, x, y, z.
    pub a_from_b_wxyz: [f64; 4],
    /// Translation in mm.
    pub a_from_b_mm: [f64; 3],
    /// Name of frame `a`, zero-padded.
    pub a: [u8; 16],
    /// Name of frame `b`, zero-padded.
    pub b: [u8; 16],
}

/// Maximum number of joints a [`Joints`] packet holds.
pub const MAX_JOINTS: usize = 8;

/// Packet `joints`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joints {
    /// Angles in rad.
    pub position_rad: [f64; MAX_JOINTS],
    /// Speeds in rad/s.
    pub velocity_rad_s: [f64; MAX_JOINTS],
    /// Joints in use.
    pub count: u32,
    /// Reserved, 0.
    pub reserved: u32,
}

/// Packet `scalar`: one number with its name and unit.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scalar {
    /// The number.
    pub value: f64,
    /// Name of the number, zero-padded.
    pub name: [u8; 32],
    /// Its unit, zero-padded.
    pub unit: [u8; 16],
}

/// Name of the output with the positions of an arm's joints, a table of [`LINK_COLUMNS`].
pub const LINKS: &str = "links";
/// Columns of a table of joint positions: a row per joint from the base to the camera, in the frame of the same node's
/// `pose`.
pub const LINK_COLUMNS: [&str; 3] = ["link_x_mm", "link_y_mm", "link_z_mm"];

/// Opens a `table` packet; then the column text, then `rows * columns` f64 in row order.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TableHeader {
    /// Number of rows.
    pub rows: u32,
    /// Number of columns.
    pub columns: u32,
    /// Bytes of column names (with units, separated by line feeds), zero-padded to a multiple of 8.
    pub names_len: u32,
    /// Reserved, 0.
    pub reserved: u32,
}
