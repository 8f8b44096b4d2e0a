//! The print on the phantom box and the calibration board, with exact positions in mm.
//!
//! Printed coordinates are the scene's x and y, mm, with the origin on the resting left camera's axis.

/// Heights of the raised blocks of the box: centre x, y, half size, height, mm.
pub const BLOCKS_MM: [[f32; 4]; 3] = [[-14.0, 3.0, 4.0, 5.0], [12.0, 3.0, 4.0, 10.0], [34.0, 3.0, 4.0, 15.0]];

/// Printed lengths: start x, start y, end x, end y, mm; small crosses mark both ends. All are on the floor.
pub const LENGTHS_MM: [[f32; 4]; 5] = [
    [-6.0, 0.0, 4.0, 0.0],
    [-10.0, 12.0, 10.0, 12.0],
    [-20.0, -6.5, 10.0, -6.5],
    [20.5, -10.0, 20.5, 10.0],
    [-24.0, -8.0, -24.0, 7.0],
];

/// Rows of the rulers: y of the baseline, mm. Ticks every mm from -60 to 60, longer ones every 5 and 10.
pub const RULERS_Y_MM: [f32; 2] = [-16.0, 15.5];

/// Side of a square of the board, mm; the board has 10 x 7 squares (9 x 6 inner corners).
pub const SQUARE_MM: f32 = 3.0;
/// Centre of the board, mm.
pub const BOARD_CENTRE_MM: [f32; 2] = [7.5, 0.0];

/// Converts a position in periods to mm around 0.
pub fn centred(periods: f32, period_mm: f32) -> f32 {
    (periods - (periods + 0.5).floor()) * period_mm
}

/// Height of the box's surface (negative: nearer), mm: a floor and blocks with 1 mm slopes.
pub fn box_height_mm(x: f32, y: f32) -> f32 {
    let raised = |b: &[f32; 4]| {
        let outside = (x - b[0]).abs().max((y - b[1]).abs()) - b[2];
        b[3] * (1.0 - outside * (1.0 / 3.0)).clamp(0.0, 1.0)
    };
    -BLOCKS_MM.iter().map(raised).fold(0.0, f32::max)
}

/// Ink on the box at `(x, y)`, 0..1, anti-aliased over `texel_mm`.
pub fn box_ink(x: f32, y: f32, texel_mm: f32) -> f32 {
    let mut ink: f32 = 0.0;
    for ruler in RULERS_Y_MM {
        let dy = y - ruler;
        if (-1.0..9.5).contains(&dy) && x.abs() < 61.0 {
            ink = ink.max(line(dy, 0.12, texel_mm));
            let tick = (x + 0.5).floor();
            let whole = tick as i32;
            let length = if whole % 10 == 0 {
                5.0
            } else if whole % 5 == 0 {
                3.5
            } else {
                2.2
            };
            ink = ink.max(line(x - tick, 0.1, texel_mm).min(edge(length - dy, texel_mm)).min(edge(dy, texel_mm)));
            let ten = (x / 10.0 + 0.5).floor() * 10.0;
            ink = ink.max(number(ten.abs() as u32, x - ten, dy - 5.5, 0.4));
        }
    }
    for [x0, y0, x1, y1] in LENGTHS_MM {
        let (dx, dy) = (x1 - x0, y1 - y0);
        let length = (dx * dx + dy * dy).sqrt();
        let (along, across) = (((x - x0) * dx + (y - y0) * dy) / length, ((x - x0) * dy - (y - y0) * dx) / length);
        if across.abs() < 4.5 && along > -2.0 && along < length + 2.0 {
            let end = along.abs().min((along - length).abs());
            let stroke = line(across, 0.1, texel_mm).min(edge(along.min(length - along), texel_mm));
            let bar = line(end, 0.1, texel_mm).min(edge(1.5 - across.abs(), texel_mm));
            ink = ink.max(stroke).max(bar);
            let (mx, my) = ((x0 + x1) * 0.5, (y0 + y1) * 0.5);
            ink = ink.max(number((length + 0.5) as u32, x - mx - if dy != 0.0 { 2.0 } else { 0.0 }, y - my - 0.6, 0.3));
        }
    }
    ink
}

/// Black share of the chessboard at `(x, y)`; `None` off the board.
pub fn board_ink(x: f32, y: f32, texel_mm: f32) -> Option<f32> {
    let (u, v) = ((x - BOARD_CENTRE_MM[0]) / SQUARE_MM, (y - BOARD_CENTRE_MM[1]) / SQUARE_MM);
    if u.abs() > 5.6 || v.abs() > 4.1 {
        return None;
    }
    // Products of two antialiased square waves keep every corner exactly where four squares meet.
    let wave = |t: f32| {
        let cell = t.floor();
        let distance = (t - cell).min(cell + 1.0 - t) * SQUARE_MM / texel_mm;
        let sign = if (cell as i32) & 1 == 0 { 1.0 } else { -1.0 };
        sign * (distance * 2.0).min(1.0)
    };
    let border = edge((5.0 - u.abs()).min(3.5 - v.abs()) * SQUARE_MM, texel_mm);
    Some((0.5 - 0.5 * wave(u) * wave(v + 0.5)) * border)
}

/// Share of a texel on the positive side of an edge.
pub fn edge(distance_mm: f32, texel_mm: f32) -> f32 {
    (distance_mm / texel_mm + 0.5).clamp(0.0, 1.0)
}

/// Share of a texel within `half_mm` of a line.
fn line(distance_mm: f32, half_mm: f32, texel_mm: f32) -> f32 {
    edge(half_mm - distance_mm.abs(), texel_mm)
}

/// Digits as 3 x 5 cells, top row first, three bits a row.
const DIGITS: [u16; 10] = [
    0b111_101_101_101_111,
    0b010_110_010_010_111,
    0b111_001_111_100_111,
    0b111_001_111_001_111,
    0b101_101_111_001_001,
    0b111_100_111_001_111,
    0b111_100_111_101_111,
    0b111_001_010_010_010,
    0b111_101_111_101_111,
    0b111_101_111_001_111,
];

/// Ink of a number of one or two digits, centred on x, its top at y = 0.
fn number(value: u32, x: f32, y: f32, cell_mm: f32) -> f32 {
    let (column, row) = (x / cell_mm, (y / cell_mm).floor() as i32);
    if !(0..5).contains(&row) || value > 99 {
        return 0.0;
    }
    let digits: &[u32] = if value < 10 { &[value] } else { &[value / 10, value % 10] };
    let place = (column + (digits.len() as f32 * 4.0 - 1.0) * 0.5).floor() as i32;
    if place < 0 || place % 4 == 3 || place / 4 >= digits.len() as i32 {
        return 0.0;
    }
    let bits = DIGITS[digits[(place / 4) as usize] as usize];
    f32::from(bits >> (14 - (row * 3 + place % 4)) & 1)
}
