//! The canvas: chosen once and then kept, so that the border of the panorama never jumps.

use super::params::{Canvas, CompositeParams, GeometryFault};

/// Sizes are rounded up to a multiple of this, as encoders prefer.
const ROUND_PX: i64 = 16;

/// Chooses a canvas from the first good geometry and keeps it.
#[derive(Debug, Default)]
pub struct CanvasHolder {
    canvas: Option<Canvas>,
    frames_outside: u32,
    wanted: Option<Bounds>,
}

/// Axis-parallel bounds on the reference plane, pixels, ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest x.
    pub x0: f64,
    /// Smallest y.
    pub y0: f64,
    /// Largest x.
    pub x1: f64,
    /// Largest y.
    pub y1: f64,
}

impl Bounds {
    /// Bounds of the corners of all views.
    pub fn of<'a>(quads: impl Iterator<Item = &'a [(f64, f64); 4]>) -> Self {
        let mut b = Self { x0: f64::MAX, y0: f64::MAX, x1: f64::MIN, y1: f64::MIN };
        for (x, y) in quads.flatten() {
            b = Self { x0: b.x0.min(*x), y0: b.y0.min(*y), x1: b.x1.max(*x), y1: b.y1.max(*y) };
        }
        b
    }

    /// Bounds of both.
    pub fn union(self, o: Self) -> Self {
        Self { x0: self.x0.min(o.x0), y0: self.y0.min(o.y0), x1: self.x1.max(o.x1), y1: self.y1.max(o.y1) }
    }
}

impl CanvasHolder {
    /// The canvas in force, if there was good geometry.
    pub fn current(&self) -> Option<Canvas> {
        self.canvas
    }

    /// Forgets the canvas: the next geometry chooses a new one.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Returns the canvas for the bounds of a good geometry.
    ///
    /// # Errors
    /// When the panorama would exceed the size bound; the canvas in force is kept.
    pub fn update(&mut self, bounds: Bounds, params: &CompositeParams) -> Result<Canvas, GeometryFault> {
        let fresh = choose(bounds, params)?;
        let Some(held) = self.canvas else {
            self.canvas = Some(fresh);
            return Ok(fresh);
        };
        let fits = bounds.x0 >= f64::from(-held.left)
            && bounds.y0 >= f64::from(-held.top)
            && bounds.x1 <= held.width as f64 - 1.0 - f64::from(held.left)
            && bounds.y1 <= held.height as f64 - 1.0 - f64::from(held.top);
        if fits || params.canvas.is_some() {
            self.frames_outside = 0;
            self.wanted = None;
            return Ok(held);
        }
        self.frames_outside += 1;
        let wanted = self.wanted.map_or(bounds, |w| w.union(bounds));
        self.wanted = Some(wanted);
        if params.canvas_grow_after_frames > 0 && self.frames_outside >= params.canvas_grow_after_frames {
            let old = Bounds {
                x0: f64::from(-held.left),
                y0: f64::from(-held.top),
                x1: held.width as f64 - 1.0 - f64::from(held.left),
                y1: held.height as f64 - 1.0 - f64::from(held.top),
            };
            self.frames_outside = 0;
            self.wanted = None;
            let margin = params.canvas_margin_px as f64;
            let grown = Bounds {
                x0: if wanted.x0 < old.x0 { wanted.x0 - margin } else { old.x0 },
                y0: if wanted.y0 < old.y0 { wanted.y0 - margin } else { old.y0 },
                x1: if wanted.x1 > old.x1 { wanted.x1 + margin } else { old.x1 },
                y1: if wanted.y1 > old.y1 { wanted.y1 + margin } else { old.y1 },
            };
            if let Ok(canvas) = around(grown, params) {
                self.canvas = Some(canvas);
                return Ok(canvas);
            }
        }
        Ok(held)
    }
}

fn choose(bounds: Bounds, params: &CompositeParams) -> Result<Canvas, GeometryFault> {
    if let Some((width, height)) = params.canvas {
        let (width, height) = (width.max(1), height.max(1));
        if width > params.max_canvas_side_px || height > params.max_canvas_side_px {
            return Err(GeometryFault::CanvasTooLarge { width, height });
        }
        let left = (width as f64 - 1.0 - bounds.x0 - bounds.x1) / 2.0;
        let top = (height as f64 - 1.0 - bounds.y0 - bounds.y1) / 2.0;
        return Ok(Canvas { width, height, left: left.round() as i32, top: top.round() as i32 });
    }
    let margin = params.canvas_margin_px as f64;
    around(
        Bounds { x0: bounds.x0 - margin, y0: bounds.y0 - margin, x1: bounds.x1 + margin, y1: bounds.y1 + margin },
        params,
    )
}

fn around(bounds: Bounds, params: &CompositeParams) -> Result<Canvas, GeometryFault> {
    let (x0, y0) = (bounds.x0.floor() as i64, bounds.y0.floor() as i64);
    let round = |length: i64| (length + ROUND_PX - 1) / ROUND_PX * ROUND_PX;
    let width = round(bounds.x1.ceil() as i64 - x0 + 1) as usize;
    let height = round(bounds.y1.ceil() as i64 - y0 + 1) as usize;
    if width > params.max_canvas_side_px || height > params.max_canvas_side_px {
        return Err(GeometryFault::CanvasTooLarge { width, height });
    }
    Ok(Canvas { width, height, left: -x0 as i32, top: -y0 as i32 })
}
