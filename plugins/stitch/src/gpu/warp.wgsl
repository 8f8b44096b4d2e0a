// Draws one or two views on a canvas: which view each pixel shows is given as runs of columns, where it lies there by a matrix or a mesh. Columns
// around the seam come from a patch that the processor has blended, for which it first gets them of both views.
// Positions are rounded to 1/64 px, as on the processor.

struct Place {
    unused: u32,
    // Bytes of a row of the view.
    stride: u32,
    width: i32,
    height: i32,
    gain: vec4<i32>,
    // Columns and rows to add to a position of the canvas, in x and y; 1 in z where that is all.
    shift: vec4<i32>,
    // Columns and rows of the canvas between which a shifted view lies by its mesh: from x, y to before z, w.
    moved: vec4<i32>,
    // First vertex in `vertices`, vertices per row, rows; 0 rows without a mesh.
    mesh: vec4<i32>,
    // Position of the canvas's first pixel in cells of the mesh, from its first vertex, in x and y; cells per pixel in z.
    grid: vec4<f32>,
    // Rows of the matrix from the canvas, counted from `middle`, to the view.
    row_x: vec4<f32>,
    row_y: vec4<f32>,
    row_w: vec4<f32>,
    middle: vec4<f32>,
}

struct Canvas {
    // Columns and rows that are drawn.
    width: u32,
    height: u32,
    // Words of a row of what is drawn.
    stride: u32,
    // 1 to draw the columns of the patch: of the first view, and below of the second.
    draws_columns: u32,
    // Row of the canvas in which the patch begins, its rows, bytes of a row, and number in `rows` of its first row.
    patch_top: u32,
    patch_height: u32,
    patch_stride: u32,
    patch_rows: u32,
    places: array<Place, 2>,
}

@group(0) @binding(0) var<storage, read> canvas: Canvas;
@group(0) @binding(1) var<storage, read> first_view: array<u32>;
@group(0) @binding(2) var<storage, read> second_view: array<u32>;
@group(0) @binding(3) var<storage, read> vertices: array<vec2<f32>>;
// Number of the first run of each row, and one more; then the first column of each row of the patch, which may stand alone.
@group(0) @binding(4) var<storage, read> rows: array<u32>;
// End of each run times 4, and what it shows: 0 nothing, 1 the first view, 2 the second, 3 the patch.
@group(0) @binding(5) var<storage, read> runs: array<u32>;
// Blended pixels of the patch, three bytes each.
@group(0) @binding(6) var<storage, read> patch_words: array<u32>;
@group(0) @binding(7) var<storage, read_write> target_words: array<u32>;

// What this thread reads: 0 the first view, 1 the second, 2 the patch.
var<private> shown_view: u32;

fn source_word(at: u32) -> u32 {
    if (shown_view == 0u) {
        return first_view[at];
    }
    if (shown_view == 1u) {
        return second_view[at];
    }
    return patch_words[at];
}

// Position in the view, in 1/64 px.
fn locate(index: u32, x: i32, y: i32) -> vec2<i32> {
    let place = &canvas.places[index];
    let shift = (*place).shift;
    let moved = (*place).moved;
    let is_moved = x >= moved.x && y >= moved.y && x < moved.z && y < moved.w;
    let limit = vec2<i32>((*place).width - 1, (*place).height - 1);
    if (shift.z == 1 && !is_moved) {
        return clamp(vec2<i32>(x, y) + shift.xy, vec2<i32>(0, 0), limit) * 64;
    }
    var at: vec2<f32>;
    let mesh = (*place).mesh;
    if (mesh.z > 0) {
        let grid = (*place).grid;
        let g = vec2<f32>(grid.x + grid.z * f32(x), grid.y + grid.z * f32(y));
        let cell = min(vec2<i32>(max(g, vec2<f32>(0.0, 0.0))), vec2<i32>(mesh.y - 2, mesh.z - 2));
        let down = clamp(g.y - f32(cell.y), 0.0, 1.0);
        let across = g.x - f32(cell.x);
        let above = mesh.x + cell.y * mesh.y + cell.x;
        let below = above + mesh.y;
        let left = vertices[above] + down * (vertices[below] - vertices[above]);
        let right = vertices[above + 1] + down * (vertices[below + 1] - vertices[above + 1]);
        at = left + (right - left) * across;
    } else {
        let away = vec2<f32>(f32(x), f32(y)) - (*place).middle.xy;
        let row_x = (*place).row_x;
        let row_y = (*place).row_y;
        let row_w = (*place).row_w;
        let w = row_w.x * away.x + row_w.y * away.y + row_w.z;
        at = vec2<f32>(row_x.x * away.x + row_x.y * away.y + row_x.z, row_y.x * away.x + row_y.y * away.y + row_y.z) / w;
    }
    at = clamp(at, vec2<f32>(0.0, 0.0), vec2<f32>(limit));
    return vec2<i32>(at * 64.0 + vec2<f32>(0.5, 0.5));
}

// Pixel of a view or of the patch at a position of the canvas.
fn shown(index: u32, x: u32, y: u32) -> u32 {
    shown_view = index;
    if (index == 2u) {
        let row = y - canvas.patch_top;
        return joined(left_pixel(two_pixels(row * canvas.patch_stride + 3u * (x - rows[canvas.patch_rows + row]))));
    }
    let at = locate(index, i32(x), i32(y));
    let place = &canvas.places[index];
    let last = vec2<i32>((*place).width - 2, (*place).height - 2);
    let whole = min(at >> vec2<u32>(6u, 6u), last);
    let part = at - whole * 64;
    let offset = u32(whole.y) * (*place).stride + u32(whole.x) * 3u;
    return between(offset, (*place).stride, 64 - part.x, part.x, part.y * 256, (*place).gain.xyz);
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = id.x * 4u;
    if (first >= canvas.width || id.y >= canvas.height) {
        return;
    }
    var pixels: array<u32, 4>;
    if (canvas.draws_columns == 1u) {
        let row = id.y % canvas.patch_height;
        let x = rows[row] + first;
        for (var i = 0u; i < 4u; i++) {
            pixels[i] = shown(id.y / canvas.patch_height, x + i, canvas.patch_top + row);
        }
    } else {
        var run = rows[id.y];
        let last = rows[id.y + 1u];
        for (var i = 0u; i < 4u; i++) {
            let x = first + i;
            while (run + 1u < last && (runs[run] >> 2u) <= x) {
                run++;
            }
            let shows = runs[run] & 3u;
            pixels[i] = 0u;
            if (shows != 0u && x < canvas.width) {
                pixels[i] = shown(shows - 1u, x, id.y);
            }
        }
    }
    store_four(id.y * canvas.stride + id.x * 3u, pixels);
}
