// Draws one or two views on a canvas: which view each pixel shows is given as runs of columns, where it lies there by a matrix or a mesh.
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
    // Columns that are drawn: the first, and one past the last.
    left: u32,
    right: u32,
    height: u32,
    // Words of a row of what is drawn.
    stride: u32,
    places: array<Place, 2>,
}

@group(0) @binding(0) var<storage, read> canvas: Canvas;
@group(0) @binding(1) var<storage, read> first_view: array<u32>;
@group(0) @binding(2) var<storage, read> second_view: array<u32>;
@group(0) @binding(3) var<storage, read> vertices: array<vec2<f32>>;
// Number of the first run of each row, and one more.
@group(0) @binding(4) var<storage, read> rows: array<u32>;
// End of each run times 4, and the view that it shows: 0 none, 1 the first, 2 the second.
@group(0) @binding(5) var<storage, read> runs: array<u32>;
@group(0) @binding(6) var<storage, read_write> target_words: array<u32>;

// The view that this thread reads: 0 the first, 1 the second.
var<private> shown_view: u32;

fn source_word(at: u32) -> u32 {
    if (shown_view == 0u) {
        return first_view[at];
    }
    return second_view[at];
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

fn round_multiply(a: vec3<i32>, b: vec3<i32>) -> vec3<i32> {
    return (a * b + vec3<i32>(0x4000)) >> vec3<u32>(15u);
}

fn sampled(index: u32, x: i32, y: i32) -> u32 {
    shown_view = index;
    let at = locate(index, x, y);
    let place = &canvas.places[index];
    let last = vec2<i32>((*place).width - 2, (*place).height - 2);
    let whole = min(at >> vec2<u32>(6u, 6u), last);
    let part = at - whole * 64;
    let offset = u32(whole.y) * (*place).stride + u32(whole.x) * 3u;
    let top = two_pixels(offset);
    let bottom = two_pixels(offset + (*place).stride);
    let t = left_pixel(top) * (64 - part.x) + right_pixel(top) * part.x;
    let b = left_pixel(bottom) * (64 - part.x) + right_pixel(bottom) * part.x;
    let value = t + round_multiply((b - t) * 2, vec3<i32>(part.y * 256));
    let gained = (round_multiply(value, (*place).gain.xyz) + vec3<i32>(16)) >> vec3<u32>(5u);
    return joined(clamp(gained, vec3<i32>(0), vec3<i32>(255)));
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = canvas.left + id.x * 4u;
    if (first >= canvas.right || id.y >= canvas.height) {
        return;
    }
    var run = rows[id.y];
    let last = rows[id.y + 1u];
    var pixels: array<u32, 4>;
    for (var i = 0u; i < 4u; i++) {
        let x = first + i;
        while (run + 1u < last && (runs[run] >> 2u) <= x) {
            run++;
        }
        let shows = runs[run] & 3u;
        pixels[i] = 0u;
        if (shows != 0u && x < canvas.right) {
            pixels[i] = sampled(shows - 1u, i32(x), i32(id.y));
        }
    }
    store_four(id.y * canvas.stride + id.x * 3u, pixels);
}
