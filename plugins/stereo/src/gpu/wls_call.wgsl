// What the kernels around the weighted-least-squares filter share. Maps are bits of f32, because WGSL has no NaN.

struct Call {
    // Columns and rows of the maps; the rectangle that is filtered.
    width: u32,
    height: u32,
    x: u32,
    y: u32,
    columns: u32,
    rows: u32,
    // Words of a row: of the disparities, of the right view's and of the given confidence, 0 without them.
    stride: u32,
    stride_right: u32,
    stride_given: u32,
    // Words of a row of the results: disparity and confidence.
    stride_out: u32,
    stride_confidence: u32,
    // Bytes of a row of the guide, and of a pixel: 1 or 3; bytes of a row of the mask.
    stride_guide: u32,
    channels: u32,
    stride_mask: u32,
    // Radius of the scatter, px.
    radius: u32,
    // Levels from which and up to which a pixel is not trusted.
    highlight: i32,
    dark: i32,
    left_right_px: f32,
    // Confidence lost per square of a step; inverse of the matched pixels for full confidence; smallest support.
    loss: f32,
    full: f32,
    least: f32,
    // Width of the strip around the mask, px.
    beyond_px: u32,
}

@group(0) @binding(0) var<storage, read> call: Call;

const NOT_A_NUMBER = 0x7fc00000u;
// As KEPT_CONFIDENCE and MAX_STEP_PX of the processor.
const KEPT_CONFIDENCE = 0.5;
const MAX_STEP_PX = 1.0;

fn is_finite(bits: u32) -> bool {
    return (bits & 0x7f800000u) != 0x7f800000u;
}

// Whether two disparities are known and near each other.
fn is_near(a: u32, b: u32, limit: f32) -> bool {
    return is_finite(a) && is_finite(b) && abs(bitcast<f32>(a) - bitcast<f32>(b)) <= limit;
}

// Whether the right view shows what the left one shows in column `x`.
fn is_seen_by_both(x: u32, value: f32) -> bool {
    let other = f32(x) - value;
    return other >= -0.5 && other <= f32(call.width) - 0.5;
}
