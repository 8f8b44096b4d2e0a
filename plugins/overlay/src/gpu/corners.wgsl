// Points of a cloud at regular distances: each `step`-th one, or the known one nearest to it, in the order of the processor.

struct Call {
    // Points per row and rows of the cloud, and of the result.
    width: u32,
    height: u32,
    columns: u32,
    rows: u32,
    step: u32,
    // Largest distance of a point in place of an unknown one.
    reach: u32,
}

@group(0) @binding(0) var<storage, read> call: Call;
// Four words for each point: bits of its position, and its colour.
@group(0) @binding(1) var<storage, read> cloud: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> corners: array<vec4<u32>>;

const NOT_A_NUMBER = 0x7fc00000u;
const EXPONENT = 0x7f800000u;

fn is_known(point: vec4<u32>) -> bool {
    return all((point.xyz & vec3<u32>(EXPONENT)) != vec3<u32>(EXPONENT));
}

fn corner(x: u32, y: u32) -> vec4<u32> {
    let own = cloud[y * call.width + x];
    if (is_known(own)) {
        return own;
    }
    for (var r = 1u; r <= call.reach; r++) {
        let left = max(x, r) - r;
        let top = max(y, r) - r;
        let right = min(x + r, call.width - 1u);
        let bottom = min(y + r, call.height - 1u);
        var places = array<vec2<u32>, 8>(
            vec2<u32>(x, top), vec2<u32>(left, y), vec2<u32>(right, y), vec2<u32>(x, bottom),
            vec2<u32>(left, top), vec2<u32>(right, top), vec2<u32>(left, bottom), vec2<u32>(right, bottom),
        );
        for (var k = 0u; k < 8u; k++) {
            let point = cloud[places[k].y * call.width + places[k].x];
            if (is_known(point)) {
                return point;
            }
        }
    }
    return vec4<u32>(NOT_A_NUMBER, NOT_A_NUMBER, NOT_A_NUMBER, 0u);
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x < call.columns && id.y < call.rows) {
        corners[id.y * call.columns + id.x] = corner(id.x * call.step, id.y * call.step);
    }
}
