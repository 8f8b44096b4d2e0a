// Smooths two planes along rows or columns: (I + strength * A) u = f, where A is the weighted Laplacian of a line. One sweep forward, one back.

// To the next pixel of the line; 0 at its last one.
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read_write> first: array<f32>;
@group(0) @binding(3) var<storage, read_write> second: array<f32>;
@group(0) @binding(4) var<storage, read_write> factors: array<f32>;

@compute @workgroup_size(32)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    var lines = sizes.width;
    var count = sizes.height;
    var step = sizes.width;
    var at = id.x;
    if (IS_ROWS) {
        lines = sizes.height;
        count = sizes.width;
        step = 1u;
        at = id.x * sizes.width;
    }
    if (id.x >= lines) {
        return;
    }
    var before = 0.0;
    var factor = 0.0;
    var f = 0.0;
    var s = 0.0;
    for (var i = 0u; i < count; i++) {
        let next = sizes.strength * weights[at];
        let inverse = 1.0 / (1.0 + next + before - before * factor);
        factor = next * inverse;
        f = (first[at] + before * f) * inverse;
        s = (second[at] + before * s) * inverse;
        factors[at] = factor;
        first[at] = f;
        second[at] = s;
        before = next;
        at += step;
    }
    at -= step;
    for (var i = 1u; i < count; i++) {
        at -= step;
        f = first[at] + factors[at] * f;
        s = second[at] + factors[at] * s;
        first[at] = f;
        second[at] = s;
    }
}
