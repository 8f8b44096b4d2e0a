//! Shapes of surfaces: disparity over the left view, and the part of the view that a surface covers.

/// A sine wave across the view.
#[derive(Clone, Copy, Debug)]
pub struct Wave {
    /// Amplitude, px of disparity.
    pub height_px: f64,
    /// Radians per column and per row.
    pub rate: (f64, f64),
    /// Phase, radians.
    pub phase: f64,
}

/// A bell-shaped hill.
#[derive(Clone, Copy, Debug)]
pub struct Hill {
    /// Centre, px.
    pub at: (f64, f64),
    /// Height, px of disparity.
    pub height_px: f64,
    /// Standard deviation of the bell, px.
    pub width_px: f64,
}

/// Disparity as a function of the left view's pixel. Its change per column stays below 1, so that each point of the surface is one column of the right view.
#[derive(Clone, Debug, Default)]
pub struct Relief {
    /// Disparity at `origin`, px.
    pub level_px: f64,
    /// Where the level is taken.
    pub origin: (f64, f64),
    /// Change per column and per row.
    pub slope: (f64, f64),
    /// Added waves.
    pub waves: Vec<Wave>,
    /// Added hills.
    pub hills: Vec<Hill>,
    /// Added cross-section of a round bar.
    pub bar: Option<Bar>,
}

/// A straight bar with a rounded front, wide at one end.
#[derive(Clone, Copy, Debug)]
pub struct Bar {
    /// Its end, px.
    pub tip: (f64, f64),
    /// Unit vector from the tip along the bar.
    pub along: (f64, f64),
    /// Half its width at the tip, px.
    pub radius_px: f64,
    /// Growth of the half width per px along the bar.
    pub taper: f64,
    /// Disparity of its middle line over that of its sides, px.
    pub bulge_px: f64,
}

impl Bar {
    /// Position along and across the bar, and half its width there.
    fn place(&self, (x, y): (f64, f64)) -> (f64, f64, f64) {
        let (dx, dy) = (x - self.tip.0, y - self.tip.1);
        let t = dx * self.along.0 + dy * self.along.1;
        let across = dy * self.along.0 - dx * self.along.1;
        (t, across, self.radius_px + self.taper * t.max(0.0))
    }

    fn covers(&self, at: (f64, f64)) -> bool {
        let (t, across, radius) = self.place(at);
        if t >= 0.0 { across.abs() <= radius } else { t.hypot(across) <= radius }
    }
}

/// Disparity at one place.
#[derive(Clone, Copy, Debug)]
pub struct Level {
    /// Px.
    pub d: f64,
    /// Change per column.
    pub dx: f64,
    /// Change per row.
    pub dy: f64,
}

impl Relief {
    /// Disparity and its slope at a place of the left view.
    pub fn at(&self, (x, y): (f64, f64)) -> Level {
        let mut level = Level {
            d: self.level_px + self.slope.0 * (x - self.origin.0) + self.slope.1 * (y - self.origin.1),
            dx: self.slope.0,
            dy: self.slope.1,
        };
        for wave in &self.waves {
            let (sine, cosine) = (wave.rate.0 * x + wave.rate.1 * y + wave.phase).sin_cos();
            level.d += wave.height_px * sine;
            level.dx += wave.height_px * wave.rate.0 * cosine;
            level.dy += wave.height_px * wave.rate.1 * cosine;
        }
        for hill in &self.hills {
            let (dx, dy) = ((x - hill.at.0) / hill.width_px, (y - hill.at.1) / hill.width_px);
            let value = hill.height_px * (-0.5 * (dx * dx + dy * dy)).exp();
            level.d += value;
            level.dx -= value * dx / hill.width_px;
            level.dy -= value * dy / hill.width_px;
        }
        if let Some(bar) = &self.bar {
            let (_, across, radius) = bar.place((x, y));
            let part = (across / radius).clamp(-1.0, 1.0);
            level.d += bar.bulge_px * (1.0 - part * part);
            let fall = -2.0 * bar.bulge_px * part / radius;
            level.dx -= fall * bar.along.1;
            level.dy += fall * bar.along.0;
        }
        level
    }

    /// The left view's column whose point the right view shows at column `x_right` of row `y`. `start` is a guess.
    pub fn column_of_right(&self, x_right: f64, y: f64, start: f64) -> (f64, Level) {
        let mut x = start;
        let mut level = self.at((x, y));
        for _ in 0..24 {
            let off = x - level.d - x_right;
            if off.abs() < 1e-7 {
                break;
            }
            // The slope of `x - d(x)`, kept away from 0 where a bar's side is steep.
            x -= off / (1.0 - level.dx).clamp(0.15, 2.0);
            level = self.at((x, y));
        }
        (x, level)
    }
}

/// The part of the left view that a surface covers.
#[derive(Clone, Copy, Debug)]
pub enum Cover {
    /// All of it.
    All,
    /// A bar.
    Bar(Bar),
    /// The area on one side of a wavy line: `along` is the unit vector into the covered side.
    Side {
        /// A point of the line, px.
        at: (f64, f64),
        /// Into the covered side.
        into: (f64, f64),
        /// Amplitude of the line's wave, px.
        wave_px: f64,
        /// Radians per px along the line.
        rate: f64,
    },
    /// All rows from one on.
    Rows {
        /// The first row, px.
        from: f64,
    },
    /// A rectangle, px.
    Box {
        /// First column.
        left: f64,
        /// First row.
        top: f64,
        /// Last column.
        right: f64,
        /// Last row.
        bottom: f64,
    },
}

impl Cover {
    /// Whether the surface is there.
    pub fn contains(&self, (x, y): (f64, f64)) -> bool {
        match self {
            Self::All => true,
            Self::Bar(bar) => bar.covers((x, y)),
            Self::Side { at, into, wave_px, rate } => {
                let (dx, dy) = (x - at.0, y - at.1);
                let along = dy * into.0 - dx * into.1;
                dx * into.0 + dy * into.1 > wave_px * (rate * along).sin()
            }
            Self::Rows { from } => y >= *from,
            Self::Box { left, top, right, bottom } => (*left..=*right).contains(&x) && (*top..=*bottom).contains(&y),
        }
    }
}
