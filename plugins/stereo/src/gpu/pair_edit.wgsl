// Clears and fills pixels of a disparity map by limits of its rows.

// As `RowEdit` of the processor.
struct Row {
    start: u32,
    end: u32,
    first: f32,
    last: f32,
    filled: u32,
    value: u32,
    overwrites: u32,
}

struct Edit {
    width: u32,
    height: u32,
    // Words of a row of the map.
    stride: u32,
    // Whether the map is the right view's.
    is_right: u32,
    // 1 for an edit for each row, 0 for one for all.
    step: u32,
    unused: array<u32, 3>,
    rows: array<Row>,
}

@group(0) @binding(0) var<storage, read> call: Edit;
// Bits of f32, because WGSL has no NaN.
@group(0) @binding(1) var<storage, read_write> map: array<u32>;

const NOT_A_NUMBER = 0x7fc00000u;
// Limits of counterparts that may lie anywhere.
const ANYWHERE = 3.4e38;

fn is_unknown(bits: u32) -> bool {
    return (bits & 0x7fffffffu) > 0x7f800000u;
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= call.width || id.y >= call.height) {
        return;
    }
    let row = call.rows[id.y * call.step];
    let at = id.y * call.stride + id.x;
    if (id.x < row.start || id.x >= row.end) {
        map[at] = NOT_A_NUMBER;
    } else if (row.last < ANYWHERE && !is_unknown(map[at])) {
        let value = bitcast<f32>(map[at]);
        let there = f32(id.x) + select(-value, value, call.is_right == 1u);
        if (there < row.first || there > row.last) {
            map[at] = NOT_A_NUMBER;
        }
    }
    if (id.x >= row.filled && (row.overwrites == 1u || is_unknown(map[at]))) {
        map[at] = row.value;
    }
}
