// The right view's map that the left one implies, and left pixels that are hidden cleared, as `project_right` of the
// processor. A workgroup has a row.

struct Sizes {
    width: u32,
    height: u32,
    // Words of a row of each map.
    stride: u32,
    stride_right: u32,
    // Largest difference that is kept, px; any below 0.
    max_px: f32,
}

@group(0) @binding(0) var<storage, read> sizes: Sizes;
// Bits of f32, because WGSL has no NaN.
@group(0) @binding(1) var<storage, read_write> left: array<u32>;
@group(0) @binding(2) var<storage, read_write> right: array<atomic<u32>>;

const NOT_A_NUMBER = 0x7fc00000u;
const SAME_SURFACE_PX = 2.0;
const THREADS = 128u;

fn is_unknown(bits: u32) -> bool {
    return (bits & 0x7fffffffu) > 0x7f800000u;
}

// Numbers in the order of the floats; 0, below all of them, is none.
fn rank(bits: u32) -> u32 {
    return select(bits | 0x80000000u, ~bits, bits >= 0x80000000u);
}

fn bits_of(rank: u32) -> u32 {
    return select(~rank, rank & 0x7fffffffu, rank >= 0x80000000u);
}

// Column of the right view where a left pixel lands, or -1.
fn landing(x: u32, bits: u32) -> i32 {
    if (is_unknown(bits)) {
        return -1;
    }
    let to = f32(x) - bitcast<f32>(bits) + 0.5;
    return select(-1, i32(to), to >= 0.0 && to < f32(sizes.width));
}

@compute @workgroup_size(128)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    // The same in all threads, as barriers ask for.
    let y = group.y;
    if (y >= sizes.height) {
        return;
    }
    let row = y * sizes.stride;
    let row_right = y * sizes.stride_right;
    for (var x = thread; x < sizes.width; x += THREADS) {
        atomicStore(&right[row_right + x], 0u);
    }
    storageBarrier();
    for (var x = thread; x < sizes.width; x += THREADS) {
        let to = landing(x, left[row + x]);
        if (to >= 0) {
            atomicMax(&right[row_right + u32(to)], rank(left[row + x]));
        }
    }
    storageBarrier();
    for (var x = thread; x < sizes.width; x += THREADS) {
        let held = atomicLoad(&right[row_right + x]);
        atomicStore(&right[row_right + x], select(NOT_A_NUMBER, bits_of(held), held != 0u));
    }
    storageBarrier();
    // A gap of one pixel has two known neighbours, which no thread changes.
    for (var x = thread + 1u; x + 1u < sizes.width; x += THREADS) {
        let before = atomicLoad(&right[row_right + x - 1u]);
        let after = atomicLoad(&right[row_right + x + 1u]);
        let is_gap = is_unknown(atomicLoad(&right[row_right + x])) && !is_unknown(before) && !is_unknown(after);
        if (is_gap && abs(bitcast<f32>(before) - bitcast<f32>(after)) <= SAME_SURFACE_PX) {
            let middle = 0.5 * (bitcast<f32>(before) + bitcast<f32>(after));
            atomicStore(&right[row_right + x], bitcast<u32>(middle));
        }
    }
    storageBarrier();
    if (sizes.max_px < 0.0) {
        return;
    }
    for (var x = thread; x < sizes.width; x += THREADS) {
        let bits = left[row + x];
        let to = landing(x, bits);
        var agrees = false;
        if (to >= 0) {
            let other = atomicLoad(&right[row_right + u32(to)]);
            agrees = !is_unknown(other) && abs(bitcast<f32>(other) - bitcast<f32>(bits)) <= sizes.max_px;
        }
        if (!agrees) {
            left[row + x] = NOT_A_NUMBER;
        }
    }
}
