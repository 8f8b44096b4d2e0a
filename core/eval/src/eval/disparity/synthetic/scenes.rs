//! The conditions of the set, and the scenes that their seeds give.

use panoscope_base::random::SplitMix64;

use super::camera::centre;
use super::disturbance::Disturbance;
use super::relief::{Bar, Cover, Hill, Relief, Wave};
use super::texture::{Material, Texture};

/// Seeds by which parameters may be chosen.
pub const TUNING_SEEDS: [u64; 3] = [1, 2, 3];
/// Seeds that judge only: no parameter was chosen by them.
pub const HELD_OUT_SEEDS: [u64; 3] = [101, 102, 103];

/// Columns and rows of the views of tissue.
pub const SIZE: (usize, usize) = (640, 480);
/// Columns and rows of the views of a street: those of KITTI.
const STREET_SIZE: (usize, usize) = (1242, 375);

/// Shapes of scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shapes {
    /// One smooth surface, about 40 px of range.
    Smooth,
    /// Two steep planes that meet.
    Slanted,
    /// Wires and an instrument before a smooth surface.
    Thin,
    /// A far ground, a hill, a fold and two instruments: 20 to 199 px.
    Range,
    /// A road to far walls, a car 5 to 6 m away (by the baseline of a car's cameras) and one further off: 5 to 80 px.
    Street,
}

/// What is rendered.
#[derive(Clone, Copy, Debug)]
pub struct Condition {
    /// As figures name it.
    pub name: &'static str,
    /// Its shapes.
    pub shapes: Shapes,
    /// Texture of its tissue.
    pub texture: Texture,
    /// What makes it hard.
    pub disturbance: Disturbance,
}

const fn condition(name: &'static str, shapes: Shapes, texture: Texture, disturbance: Disturbance) -> Condition {
    Condition { name, shapes, texture, disturbance }
}

/// All conditions. The disturbances have the scenes of `thin`, so that each can be compared with it.
pub const CONDITIONS: [Condition; 15] = [
    condition("fractal", Shapes::Smooth, Texture::Fractal, Disturbance::None),
    condition("vessels", Shapes::Smooth, Texture::Vessels, Disturbance::None),
    condition("faint", Shapes::Smooth, Texture::Faint, Disturbance::None),
    condition("fibres", Shapes::Smooth, Texture::Fibres, Disturbance::None),
    condition("slanted", Shapes::Slanted, Texture::Tissue, Disturbance::None),
    condition("thin", Shapes::Thin, Texture::Tissue, Disturbance::None),
    condition("range", Shapes::Range, Texture::Tissue, Disturbance::None),
    condition("noise", Shapes::Thin, Texture::Tissue, Disturbance::Noise),
    condition("blur", Shapes::Thin, Texture::Tissue, Disturbance::Blur),
    condition("exposure", Shapes::Thin, Texture::Tissue, Disturbance::Exposure),
    condition("rows", Shapes::Thin, Texture::Tissue, Disturbance::Rows),
    condition("smoke", Shapes::Thin, Texture::Tissue, Disturbance::Smoke),
    condition("blood", Shapes::Thin, Texture::Tissue, Disturbance::Blood),
    condition("highlights", Shapes::Thin, Texture::Tissue, Disturbance::Highlights),
    condition("street", Shapes::Street, Texture::Asphalt, Disturbance::None),
];

/// A surface.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Its disparity.
    pub relief: Relief,
    /// Where it is.
    pub cover: Cover,
    /// How it looks.
    pub material: Material,
}

/// What both cameras see.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Columns and rows of both views.
    pub size: (usize, usize),
    /// Surfaces in any order.
    pub layers: Vec<Layer>,
    /// How far the right camera looks past its rows, px.
    pub right_rows_px: f64,
}

/// Draws numbers of a scene.
struct Draw(SplitMix64);

impl Draw {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn sign(&mut self) -> f64 {
        if self.0.bits() & 1 == 0 { 1.0 } else { -1.0 }
    }

    fn waves(&mut self, count: usize, height_px: (f64, f64), length_px: (f64, f64)) -> Vec<Wave> {
        let mut wave = || {
            let rate = std::f64::consts::TAU / self.between(length_px.0, length_px.1);
            let (sine, cosine) = self.between(0.0, std::f64::consts::TAU).sin_cos();
            let (height_px, phase) = (self.between(height_px.0, height_px.1), self.between(0.0, 6.0));
            Wave { height_px, rate: (rate * cosine, rate * sine), phase }
        };
        (0..count).map(|_| wave()).collect()
    }
}

/// The scene of a condition.
pub fn scene(condition: &Condition, seed: u64) -> Scene {
    let mut draw = Draw(SplitMix64(seed.wrapping_mul(0x1000) ^ condition.shapes as u64));
    let material = Material {
        texture: condition.texture,
        seed: draw.0.bits(),
        blood: condition.disturbance == Disturbance::Blood,
        wet: condition.disturbance == Disturbance::Highlights,
    };
    let metal = Material { texture: Texture::Metal, seed: draw.0.bits(), blood: false, ..material };
    let ground = |relief: Relief| Layer { relief, cover: Cover::All, material };
    let layers = match condition.shapes {
        Shapes::Smooth => vec![ground(smooth(&mut draw))],
        Shapes::Slanted => {
            let side = draw.sign();
            let mut plane = |side: f64| Relief {
                level_px: draw.between(90.0, 105.0),
                origin: centre(SIZE),
                slope: (side * draw.between(0.1, 0.16), draw.between(-0.1, 0.1)),
                ..Relief::default()
            };
            vec![ground(plane(side)), ground(plane(-side))]
        }
        Shapes::Thin => {
            let mut layers = vec![ground(back(&mut draw))];
            layers.extend((0..4).map(|_| wire(&mut draw, metal)));
            layers.push(instrument(&mut draw, (80.0, 92.0), 104.0, metal));
            layers
        }
        Shapes::Range => {
            let mut layers = vec![ground(far(&mut draw)), fold(&mut draw, material)];
            layers.push(instrument(&mut draw, (120.0, 140.0), 198.0, metal));
            layers.push(instrument(&mut draw, (105.0, 125.0), 190.0, metal));
            layers
        }
        Shapes::Street => street(&mut draw, material),
    };
    let size = if condition.shapes == Shapes::Street { STREET_SIZE } else { SIZE };
    Scene { size, layers, right_rows_px: condition.disturbance.right_rows_px() }
}

fn smooth(draw: &mut Draw) -> Relief {
    Relief {
        level_px: draw.between(65.0, 95.0),
        origin: centre(SIZE),
        slope: (draw.between(-0.04, 0.04), draw.between(-0.04, 0.04)),
        waves: draw.waves(3, (2.0, 5.0), (180.0, 350.0)),
        hills: vec![Hill {
            at: (draw.between(250.0, 500.0), draw.between(120.0, 360.0)),
            height_px: draw.between(8.0, 20.0),
            width_px: draw.between(70.0, 110.0),
        }],
        bar: None,
    }
}

fn back(draw: &mut Draw) -> Relief {
    Relief {
        level_px: draw.between(45.0, 55.0),
        origin: centre(SIZE),
        slope: (draw.between(-0.02, 0.02), draw.between(-0.02, 0.02)),
        waves: draw.waves(2, (2.0, 4.0), (180.0, 350.0)),
        hills: vec![Hill {
            at: (draw.between(200.0, 450.0), draw.between(120.0, 360.0)),
            height_px: draw.between(8.0, 16.0),
            width_px: draw.between(70.0, 110.0),
        }],
        bar: None,
    }
}

fn far(draw: &mut Draw) -> Relief {
    Relief {
        level_px: draw.between(36.0, 42.0),
        origin: centre(SIZE),
        slope: (draw.sign() * draw.between(0.012, 0.02), draw.sign() * draw.between(0.02, 0.03)),
        waves: draw.waves(2, (0.5, 2.0), (180.0, 350.0)),
        hills: vec![Hill {
            at: (draw.between(240.0, 330.0), draw.between(160.0, 260.0)),
            height_px: draw.between(60.0, 80.0),
            width_px: draw.between(90.0, 110.0),
        }],
        bar: None,
    }
}

/// Tissue near the lower border, before the ground.
fn fold(draw: &mut Draw, material: Material) -> Layer {
    let turn = draw.between(-0.25, 0.25);
    let into = (turn.sin(), turn.cos());
    let at = (centre(SIZE).0, draw.between(370.0, 410.0));
    let cover = Cover::Side { at, into, wave_px: draw.between(8.0, 16.0), rate: 0.02 };
    let relief = Relief {
        level_px: draw.between(85.0, 100.0),
        origin: at,
        slope: (draw.between(-0.02, 0.02), draw.between(0.08, 0.15)),
        waves: draw.waves(2, (1.0, 3.0), (150.0, 300.0)),
        ..Relief::default()
    };
    Layer { relief, cover, material: Material { seed: material.seed ^ 0xf01d, ..material } }
}

/// Pixels from a place to the border of the view.
fn to_border((x, y): (f64, f64), along: (f64, f64)) -> f64 {
    let reach = |at: f64, step: f64, last: f64| match step {
        step if step > 1e-9 => (last - at) / step,
        step if step < -1e-9 => -at / step,
        _ => f64::INFINITY,
    };
    reach(x, along.0, SIZE.0 as f64 - 1.0).min(reach(y, along.1, SIZE.1 as f64 - 1.0))
}

/// A round shaft that comes in from the right, nearest at the border with a disparity of `nearest_px`.
fn instrument(draw: &mut Draw, tip_px: (f64, f64), nearest_px: f64, material: Material) -> Layer {
    let tip = (draw.between(300.0, 460.0), draw.between(110.0, 370.0));
    let (sine, cosine) = draw.between(-0.9, 0.9).sin_cos();
    let bulge_px = 3.0;
    let bar = Bar {
        tip,
        along: (cosine, sine),
        radius_px: draw.between(14.0, 20.0),
        taper: draw.between(0.0, 0.03),
        bulge_px,
    };
    let level_px = draw.between(tip_px.0, tip_px.1);
    // The far corner of a shaft reaches a little beyond its middle line.
    let growth = (nearest_px - bulge_px - level_px) / (to_border(tip, bar.along) + 2.0 * bar.radius_px);
    let relief =
        Relief { level_px, origin: tip, slope: (growth * cosine, growth * sine), bar: Some(bar), ..Relief::default() };
    Layer { relief, cover: Cover::Bar(bar), material }
}

/// A wire of 2 to 5 px across the view.
fn wire(draw: &mut Draw, material: Material) -> Layer {
    let tip = (draw.between(150.0, 450.0), draw.between(40.0, 440.0));
    let (sine, cosine) = draw.between(0.0, std::f64::consts::TAU).sin_cos();
    let bar = Bar { tip, along: (cosine, sine), radius_px: draw.between(1.0, 2.5), taper: 0.0, bulge_px: 0.0 };
    let slope = draw.between(-0.03, 0.03);
    let relief = Relief {
        level_px: draw.between(68.0, 85.0),
        origin: tip,
        slope: (slope * cosine, slope * sine),
        bar: Some(bar),
        ..Relief::default()
    };
    Layer { relief, cover: Cover::Bar(bar), material }
}

/// The road's disparity where it ends at the walls, its row there, and its growth per row.
const ROAD: (f64, f64, f64) = (5.0, 172.0, 0.37);

/// A road, walls behind it, and two cars of smooth paint with dark glass.
fn street(draw: &mut Draw, road: Material) -> Vec<Layer> {
    let mut material = |texture: Texture| Material { texture, seed: draw.0.bits(), ..road };
    let [wall, dark, bright, glass] =
        [Texture::Fractal, Texture::DarkPaint, Texture::BrightPaint, Texture::Glass].map(&mut material);
    let flat = |level_px: f64| Relief { level_px, ..Relief::default() };
    let slope = Relief { level_px: ROAD.0, origin: (0.0, ROAD.1), slope: (0.0, ROAD.2), ..Relief::default() };
    let mut layers = vec![
        Layer { relief: flat(ROAD.0), cover: Cover::All, material: wall },
        Layer { relief: slope, cover: Cover::Rows { from: ROAD.1 }, material: road },
    ];
    let near = (draw.between(550.0, 850.0), draw.between(64.0, 72.0));
    car(near, dark, glass, &mut layers);
    let far = (draw.between(300.0, 400.0), draw.between(22.0, 28.0));
    car(far, bright, glass, &mut layers);
    layers
}

/// A car seen from behind and from its left: `at` is the column of its left rear edge and the disparity of its rear.
fn car((column, d): (f64, f64), paint: Material, glass: Material, layers: &mut Vec<Layer>) {
    // Sizes are those of a car for a baseline of 0.54 m: 1.75 m wide, 1.45 m high, 3.8 m long.
    let metre = d / 0.54;
    let (width, height) = (1.75 * metre, 1.45 * metre);
    let bottom = ROAD.1 + (d - ROAD.0) / ROAD.2;
    let (top, end) = (bottom - height, 0.6 * d);
    let side = 0.4 * metre;
    let rear = Relief { level_px: d, ..Relief::default() };
    // The side ends further away.
    let side_relief =
        Relief { level_px: d, origin: (column, 0.0), slope: ((d - end) / side, 0.0), ..Relief::default() };
    let boxed = |left: f64, top: f64, right: f64, bottom: f64| Cover::Box { left, top, right, bottom };
    // Glass lies before the paint by less than anything can show.
    let before = |relief: &Relief| Relief { level_px: relief.level_px + 0.02, ..relief.clone() };
    let sill = top + 0.42 * height;
    layers.push(Layer { relief: rear.clone(), cover: boxed(column, top, column + width, bottom), material: paint });
    layers.push(Layer {
        relief: before(&rear),
        cover: boxed(column + 0.1 * width, top + 0.08 * height, column + 0.9 * width, sill),
        material: glass,
    });
    layers.push(Layer {
        relief: side_relief.clone(),
        cover: boxed(column - side, top + 0.1 * height, column, bottom),
        material: Material { seed: paint.seed ^ 1, ..paint },
    });
    layers.push(Layer {
        relief: before(&side_relief),
        cover: boxed(column - 0.85 * side, top + 0.15 * height, column - 0.1 * side, sill),
        material: glass,
    });
}
