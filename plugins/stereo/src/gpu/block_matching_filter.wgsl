// What block matching compares: a clipped horizontal Sobel response of a gray view, or the gray value itself, 0 to 63.

struct Filter {
    width: i32,
    // Rows of the result; that of the view which the first of them is; rows of the view.
    rows: i32,
    first_row: i32,
    view_rows: i32,
    // Bytes of a row of the view.
    stride: u32,
    // Clip of the response; 0 for the gray value.
    cap: i32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<storage, read> filter_sizes: Filter;
@group(0) @binding(1) var<storage, read> source: array<u32>;
// For each column from -3 to `width`: the values there and in the next three columns, the first one in the lowest byte. Columns outside the view
// repeat its border, so that a reader clamps the column once and may look anywhere.
@group(0) @binding(2) var<storage, read_write> plane: array<u32>;

fn gray(x: i32, y: i32) -> i32 {
    let at = u32(y) * filter_sizes.stride + u32(x);
    return i32((source[at >> 2u] >> ((at & 3u) * 8u)) & 255u);
}

fn value(column: i32, y: i32) -> u32 {
    let last = filter_sizes.width - 1;
    let x = clamp(column, 0, last);
    let cap = filter_sizes.cap;
    if (cap == 0) {
        return u32(gray(x, y)) >> 2u;
    }
    let left = max(x - 1, 0);
    let right = min(x + 1, last);
    let above = max(y - 1, 0);
    let below = min(y + 1, filter_sizes.view_rows - 1);
    let response = gray(right, above) - gray(left, above)
        + 2 * (gray(right, y) - gray(left, y))
        + gray(right, below) - gray(left, below);
    return u32(clamp(response, -cap, cap) + cap);
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let columns = u32(filter_sizes.width) + 4u;
    if (id.x >= columns || id.y >= u32(filter_sizes.rows)) {
        return;
    }
    let x = i32(id.x) - 3;
    let y = i32(id.y) + filter_sizes.first_row;
    plane[id.y * columns + id.x] = value(x, y) | (value(x + 1, y) << 8u) | (value(x + 2, y) << 16u) | (value(x + 3, y) << 24u);
}
