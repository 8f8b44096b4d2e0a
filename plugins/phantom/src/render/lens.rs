//! Ray directions of a camera's pixels, tabulated once.

use super::lanes::LANES;
use super::params::{CameraModel, PhantomError};

/// Columns (and rows) between two corners of the coarse grid, px; equal to one packet of lanes.
pub const TILE: usize = LANES;

/// Rays `(x, y, 1)` of every pixel, and of the corners of 8x8 tiles.
#[derive(Clone, Debug)]
pub struct Lens {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Columns rounded up to whole packets.
    pub padded: usize,
    /// Number of corner columns, at 0, 8, 16.. up to at least `padded`.
    pub grid_width: usize,
    /// Number of corner rows.
    pub grid_height: usize,
    /// Corners across, rounded up to whole packets.
    pub grid_padded: usize,
    /// x of each padded column, or of each pixel when distorted.
    pub x: Vec<f32>,
    /// y of each row, or of each pixel when distorted.
    pub y: Vec<f32>,
    /// Whether the tables hold one entry for each pixel.
    pub distorted: bool,
    /// x and y of the corners, rows of `grid_padded`.
    pub corner_x: Vec<f32>,
    /// See [`Self::corner_x`].
    pub corner_y: Vec<f32>,
}

impl Lens {
    /// Tabulates the rays; distorted ones are found by Newton steps to 1e-12.
    ///
    /// # Errors
    /// [`PhantomError::BadDistortion`] where no ray leads to a pixel (`camera` names it).
    pub fn new(model: &CameraModel, camera: usize) -> Result<Self, PhantomError> {
        let (width, height) = (model.width, model.height);
        let padded = width.div_ceil(TILE) * TILE;
        let (grid_width, grid_height) = (padded / TILE + 1, height.div_ceil(TILE) + 1);
        let grid_padded = grid_width.div_ceil(LANES) * LANES;
        let distorted = !model.is_pinhole();
        let ray = |u: usize, v: usize| {
            // Padding may lie beyond the fold of a strong lens; inside the picture it is an error.
            match ray(model, u, v) {
                Some(ray) => Ok(ray.map(|v| v as f32)),
                None if u < width && v < height => Err(PhantomError::BadDistortion { camera, u, v }),
                None => Ok([(u as f64 - model.cx) / model.fx, (v as f64 - model.cy) / model.fy].map(|v| v as f32)),
            }
        };
        let mut lens = Self {
            width,
            height,
            padded,
            grid_width,
            grid_height,
            grid_padded,
            distorted,
            x: Vec::new(),
            y: Vec::new(),
            corner_x: Vec::new(),
            corner_y: Vec::new(),
        };
        if distorted {
            for v in 0..height {
                for u in 0..padded {
                    let [x, y] = ray(u, v)?;
                    lens.x.push(x);
                    lens.y.push(y);
                }
            }
        } else {
            lens.x = (0..padded).map(|u| ((u as f64 - model.cx) / model.fx) as f32).collect();
            lens.y = (0..height).map(|v| ((v as f64 - model.cy) / model.fy) as f32).collect();
        }
        for row in 0..grid_height {
            for column in 0..grid_padded {
                let [x, y] = ray(column.min(grid_width - 1) * TILE, row * TILE)?;
                lens.corner_x.push(x);
                lens.corner_y.push(y);
            }
        }
        Ok(lens)
    }

    /// Whether a ray leads to each corner of the image, where a lens folds first; much faster than [`Lens::new`].
    ///
    /// # Errors
    /// As [`Lens::new`].
    pub fn check(model: &CameraModel, camera: usize) -> Result<(), PhantomError> {
        for (u, v) in [(0, 0), (model.width - 1, 0), (0, model.height - 1), (model.width - 1, model.height - 1)] {
            ray(model, u, v).ok_or(PhantomError::BadDistortion { camera, u, v })?;
        }
        Ok(())
    }

    /// The ray of one pixel, `(x, y, 1)`.
    pub fn ray(&self, u: usize, v: usize) -> [f32; 2] {
        if self.distorted { [self.x[v * self.padded + u], self.y[v * self.padded + u]] } else { [self.x[u], self.y[v]] }
    }

    /// Index of the tile that contains a pixel.
    pub fn tile(&self, u: usize, v: usize) -> usize {
        (v / TILE).min(self.grid_height - 2) * (self.grid_width - 1) + (u / TILE).min(self.grid_width - 2)
    }
}

/// OpenCV's lens model: image position of the ray `(x, y, 1)`, and its Jacobian.
pub fn distort(k: &[f64; 5], [x, y]: [f64; 2]) -> ([f64; 2], [[f64; 2]; 2]) {
    let [k1, k2, p1, p2, k3] = *k;
    let r2 = x * x + y * y;
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
    let place = [
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    ];
    let cross = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
    let jacobian = [
        [radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x, cross],
        [cross, radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x],
    ];
    (place, jacobian)
}

/// The ray that appears at `place`; `None` beyond the fold of the model.
pub fn undistort(k: &[f64; 5], place: [f64; 2]) -> Option<[f64; 2]> {
    let mut ray = place;
    for _ in 0..60 {
        let (seen, j) = distort(k, ray);
        let (ex, ey) = (place[0] - seen[0], place[1] - seen[1]);
        let det = j[0][0] * j[1][1] - j[0][1] * j[1][0];
        if det < 1e-3 || !ray[0].is_finite() || !ray[1].is_finite() {
            return None;
        }
        if ex.abs() < 1e-12 && ey.abs() < 1e-12 {
            return Some(ray);
        }
        ray = [ray[0] + (j[1][1] * ex - j[0][1] * ey) / det, ray[1] + (j[0][0] * ey - j[1][0] * ex) / det];
    }
    None
}

/// The ray `(x, y, 1)` that a pixel of a camera sees; `None` where its lens has none.
fn ray(camera: &CameraModel, u: usize, v: usize) -> Option<[f64; 2]> {
    let [x, y] = [(u as f64 - camera.cx) / camera.fx, (v as f64 - camera.cy) / camera.fy];
    match camera.equidistant {
        Some(lens) => lens.undistort(x, y).map(|(x, y)| [x, y]),
        None => undistort(&camera.distortion, [x, y]),
    }
}
