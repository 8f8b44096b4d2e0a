// Block matching of the pixels of one view, the base, against the other view: sums of absolute differences over a square window, winner takes all.
//
// Runs once for the right view, which leaves each pixel's winner for the left-right check, and once for the left view. `IS_LEFT` says for which.
// Lane k of a base pixel compares it with column `x + shift + k` of the other view, so that disparities descend with the lanes for the left view, and
// ascend for the right one. The smaller disparity wins a tie in both: the last lane for the left view, the first for the right one.
//
// A workgroup has a block of 64 columns and 32 rows, and goes through the lanes, four at a time, packed in two words: lanes 0 and 2 in x, 1 and 3 in
// y, 16 bits each. Its threads slide a window down the 64 columns, share the sums, then slide along the rows: the 64 - 2 radius columns that have
// a whole window are matched. Each thread keeps the winners of eight pixels of a row. Sums stay below 65,536: 31 x 31 values of at most 63.

struct Job {
    // Columns of the base view that are matched, from `first` to before `end`.
    first: i32,
    end: i32,
    // Row of the planes where matching begins, and number of rows.
    row: i32,
    rows: i32,
    shift: i32,
    lanes: i32,
    // Columns of the other view that compete, from `low` to before `high`.
    low: i32,
    high: i32,
    // Where in `winners` the right view's part is, its first column, its columns.
    winners: u32,
    winner_first: i32,
    winner_stride: u32,
    // Where in `disparities` the result goes, `NOWHERE` for none, and words from one of its rows to the next.
    output: u32,
    output_stride: u32,
}

struct Call {
    // Columns and rows of the planes' pictures.
    width: i32,
    plane_rows: i32,
    radius: i32,
    // Value of the planes where there is no texture.
    flat_value: u32,
    // Smallest texture; 0 for any.
    texture: u32,
    uniqueness_percent: u32,
    // Largest difference between left and right disparity; 65535 for any.
    apart: i32,
    unused: u32,
    jobs: array<Job>,
}

struct Blocks {
    count: u32,
    unused: u32,
    // Number of the job; column of blocks, and row of blocks times 65536.
    list: array<vec2<u32>>,
}

@group(0) @binding(0) var<storage, read> call: Call;
@group(0) @binding(1) var<storage, read> blocks: Blocks;
// As block_matching_filter.wgsl leaves them.
@group(0) @binding(2) var<storage, read> base: array<u32>;
@group(0) @binding(3) var<storage, read> other: array<u32>;
// Column of the left view that is the best match of a right pixel.
@group(0) @binding(4) var<storage, read_write> winners: array<u32>;
// Bits of f32, because WGSL has no NaN.
@group(0) @binding(5) var<storage, read_write> disparities: array<u32>;

const NOT_A_NUMBER = 0x7fc00000u;
const NOWHERE = 0xffffffffu;
const ANY_APART = 65535;
// Cost of a lane outside the other view.
const BLOCKED = 65535u;
const COLUMNS = 64u;
const ROWS = 32u;
// Pixels of a thread: down a column for the sums of columns, along a row for the winners.
const RUN = 8u;

// What inner loops need of the call, read once: `radius`, words of a row of a plane, last row of the planes.
var<private> radius: i32;
var<private> plane_stride: u32;
var<private> last_row: i32;

// Sums of the window's columns; see `slot`.
var<workgroup> column_sums: array<vec2<u32>, 2048>;

// Columns of a row are permuted so that threads of one column and neighbouring rows use different banks.
fn slot(row: u32, column: u32) -> u32 {
    return row * COLUMNS + ((column ^ row) & (COLUMNS - 1u));
}

// Differences of four bytes below 64, as 16 bits each.
fn difference(a: u32, b: u32) -> vec2<u32> {
    let t = (a | 0x80808080u) - b;
    let is_positive = (t >> 7u) & 0x01010101u;
    // Removes the guard bit; where the difference is negative, the two's complement instead.
    let bytes = (t ^ (0x7f7f7f7fu + is_positive)) + (0x01010101u - is_positive);
    return vec2<u32>(bytes & 0x00ff00ffu, (bytes >> 8u) & 0x00ff00ffu);
}

// Where in a row of a plane this column is.
fn plane_column(x: i32) -> u32 {
    return u32(clamp(x, -3, call.width) + 3);
}

// Differences of a base pixel in four lanes; without texture where `is_flat`.
fn pixel_difference(y: i32, base_column: u32, other_column: u32, is_flat: bool) -> vec2<u32> {
    let row = u32(clamp(y, 0, last_row)) * plane_stride;
    var four = call.flat_value;
    if (!is_flat) {
        four = other[row + other_column];
    }
    return difference((base[row + base_column] & 255u) * 0x01010101u, four);
}

// Sums of `RUN` windows' columns, from plane row `y` and row `row` of the block on.
fn sum_column(column: u32, row: u32, y: i32, base_column: u32, other_column: u32, is_flat: bool) {
    var sum = vec2<u32>(0u);
    for (var dy = -radius; dy <= radius; dy++) {
        sum += pixel_difference(y + dy, base_column, other_column, is_flat);
    }
    column_sums[slot(row, column)] = sum;
    for (var i = 1; i < i32(RUN); i++) {
        sum += pixel_difference(y + i + radius, base_column, other_column, is_flat);
        sum -= pixel_difference(y + i - radius - 1, base_column, other_column, is_flat);
        column_sums[slot(row + u32(i), column)] = sum;
    }
}

// The window moved along by one, to the one that begins in `column`.
fn moved(sum: vec2<u32>, row: u32, column: u32) -> vec2<u32> {
    return sum + column_sums[slot(row, column + 2u * u32(radius))] - column_sums[slot(row, column - 1u)];
}

// The cheapest lanes of four pixels.
struct Winners {
    cost: vec4<u32>,
    lane: vec4<u32>,
    // Costs of the lanes before and after the cheapest.
    before: vec4<u32>,
    after: vec4<u32>,
    // Smallest cost of the other lanes, left view only.
    rival: vec4<u32>,
    // Cost of the lane that was taken last.
    last: vec4<u32>,
}

fn no_winners() -> Winners {
    let none = vec4<u32>(BLOCKED);
    return Winners(none, vec4<u32>(0xffff0000u), none, none, none, none);
}

// Takes the costs of the next lane.
fn take(held: ptr<function, Winners>, cost: vec4<u32>, lane: u32) {
    let was = *held;
    let is_next = was.lane == vec4<u32>(lane - 1u);
    var is_better = cost < was.cost;
    if (IS_LEFT) {
        is_better = cost <= was.cost;
        // A rival is neither the winner nor next to it. Where this lane wins, the one before it is no rival any more; the cheapest of the lanes
        // before that is the old winner, unless that is the lane which drops out.
        let passed = select(cost, vec4<u32>(BLOCKED), is_next);
        let beaten = select(was.cost, was.before, is_next);
        (*held).rival = min(was.rival, select(passed, beaten, is_better));
    }
    (*held).after = select(was.after, cost, is_next);
    (*held).before = select(was.before, was.last, is_better);
    (*held).lane = select(was.lane, vec4<u32>(lane), is_better);
    (*held).cost = min(was.cost, cost);
    (*held).last = cost;
}

// The cost, or that of a blocked lane in the columns of the other view that do not compete.
fn competing(cost: vec4<u32>, columns: vec4<i32>, job: u32) -> vec4<u32> {
    let is_open = (columns >= vec4<i32>(call.jobs[job].low)) & (columns < vec4<i32>(call.jobs[job].high));
    return select(vec4<u32>(BLOCKED), cost, is_open);
}

// Takes four lanes of four pixels; the first lane compares the first pixel with `column` of the other view.
fn take_four(held: ptr<function, Winners>, even: vec4<u32>, odd: vec4<u32>, lane: u32, job: u32, column: i32, is_open: bool) {
    var c0 = even & vec4<u32>(0xffffu);
    var c1 = odd & vec4<u32>(0xffffu);
    var c2 = even >> vec4<u32>(16u);
    var c3 = odd >> vec4<u32>(16u);
    if (!is_open) {
        let columns = vec4<i32>(column) + vec4<i32>(0, 1, 2, 3);
        c0 = competing(c0, columns, job);
        c1 = competing(c1, columns + 1, job);
        c2 = competing(c2, columns + 2, job);
        c3 = competing(c3, columns + 3, job);
    }
    take(held, c0, lane);
    take(held, c1, lane + 1u);
    take(held, c2, lane + 2u);
    take(held, c3, lane + 3u);
}

// Whether a lane, not next to the cheapest, is as cheap to within the limit.
fn is_ambiguous(cost: u32, rival: u32) -> bool {
    let percent = call.uniqueness_percent;
    return percent > 0u && rival <= min(cost + cost * percent / 100u, BLOCKED - 1u);
}

// Writes the result of column `x`, row `y` of the job, if it is before column `end`.
fn finish(index: u32, x: i32, end: i32, y: u32, cost: u32, lane: u32, before: u32, after: u32, is_rejected: bool) {
    if (x >= end) {
        return;
    }
    let job = call.jobs[index];
    let column = x + job.shift + i32(lane);
    let winner = job.winners + y * job.winner_stride;
    var is_kept = !is_rejected;
    var disparity = x - column;
    var change = i32(after) - i32(before);
    if (IS_LEFT) {
        if (is_kept && call.apart != ANY_APART) {
            let back = i32(winners[winner + u32(column - job.winner_first)]);
            is_kept = abs(back - x) <= call.apart;
        }
    } else {
        winners[winner + u32(x - job.winner_first)] = u32(column);
        disparity = -disparity;
        change = -change;
    }
    if (job.output == NOWHERE) {
        return;
    }
    // An equiangular fit, where both neighbours compete.
    var offset = 0.0;
    if (lane > 0u && i32(lane) + 1 < job.lanes && column > job.low && column + 1 < job.high) {
        let rise = i32(max(before, after)) - i32(cost);
        offset = clamp(f32(change) / f32(2 * max(rise, 1)), -0.5, 0.5);
    }
    let value = bitcast<u32>(f32(disparity) + offset);
    disparities[job.output + y * job.output_stride + u32(x - job.first)] = select(NOT_A_NUMBER, value, is_kept);
}

fn finish_four(index: u32, x: i32, end: i32, y: u32, held: Winners, is_flat: vec4<bool>) {
    var all = held;
    var flat_pixels = is_flat;
    for (var i = 0u; i < 4u; i++) {
        let cost = all.cost[i];
        let is_rejected = IS_LEFT && (flat_pixels[i] || is_ambiguous(cost, all.rival[i]));
        finish(index, x + i32(i), end, y, cost, all.lane[i], all.before[i], all.after[i], is_rejected);
    }
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let number = group.y * groups.x + group.x;
    if (number >= blocks.count) {
        return;
    }
    let block = blocks.list[number];
    let index = block.x;
    radius = call.radius;
    plane_stride = u32(call.width + 4);
    last_row = call.plane_rows - 1;
    // Not from `radius`: barriers ask for values that are the same in all threads, which private ones are not known to be.
    let matched = i32(COLUMNS) - 2 * call.radius;
    let left = call.jobs[index].first + i32(block.y & 0xffffu) * matched;
    let right = min(left + matched, call.jobs[index].end);
    let top = (block.y >> 16u) * ROWS;
    let rows = u32(call.jobs[index].rows);
    let shift = call.jobs[index].shift;

    // This thread's part of the columns.
    let column = thread % COLUMNS;
    let column_row = thread / COLUMNS * RUN;
    let x = left - radius + i32(column);
    let y = call.jobs[index].row + i32(top + column_row);
    let is_summing = top + column_row < rows && x < right + radius;
    // And of the rows.
    let row = thread % ROWS;
    let start = thread / ROWS * RUN;
    let is_matching = top + row < rows && left + i32(start) < right;

    var winners_a = no_winners();
    var winners_b = no_winners();
    var flat_a = vec4<bool>(false);
    var flat_b = vec4<bool>(false);
    // The first round, before lane 0, compares with no texture.
    for (var lane = select(0, -4, IS_LEFT && call.texture > 0u); lane < call.jobs[index].lanes; lane += 4) {
        let is_texture = lane < 0;
        let first_other = left + shift + lane;
        let end_other = right + shift + lane + 3;
        if (!is_texture && (first_other >= call.jobs[index].high || end_other <= call.jobs[index].low)) {
            continue;
        }
        if (is_summing) {
            sum_column(column, column_row, y, plane_column(x), plane_column(x + shift + lane), is_texture);
        }
        workgroupBarrier();
        if (is_matching) {
            var w0 = vec2<u32>(0u);
            for (var i = 0u; i <= 2u * u32(radius); i++) {
                w0 += column_sums[slot(row, start + i)];
            }
            let w1 = moved(w0, row, start + 1u);
            let w2 = moved(w1, row, start + 2u);
            let w3 = moved(w2, row, start + 3u);
            let w4 = moved(w3, row, start + 4u);
            let w5 = moved(w4, row, start + 5u);
            let w6 = moved(w5, row, start + 6u);
            let w7 = moved(w6, row, start + 7u);
            let even_a = vec4<u32>(w0.x, w1.x, w2.x, w3.x);
            let even_b = vec4<u32>(w4.x, w5.x, w6.x, w7.x);
            if (is_texture) {
                flat_a = (even_a & vec4<u32>(0xffffu)) < vec4<u32>(call.texture);
                flat_b = (even_b & vec4<u32>(0xffffu)) < vec4<u32>(call.texture);
            } else {
                let odd_a = vec4<u32>(w0.y, w1.y, w2.y, w3.y);
                let odd_b = vec4<u32>(w4.y, w5.y, w6.y, w7.y);
                let is_open = first_other >= call.jobs[index].low && end_other <= call.jobs[index].high;
                let first = first_other + i32(start);
                take_four(&winners_a, even_a, odd_a, u32(lane), index, first, is_open);
                take_four(&winners_b, even_b, odd_b, u32(lane), index, first + 4, is_open);
            }
        }
        workgroupBarrier();
    }
    if (is_matching) {
        finish_four(index, left + i32(start), right, top + row, winners_a, flat_a);
        finish_four(index, left + i32(start) + 4, right, top + row, winners_b, flat_b);
    }
}
