//! Geometry of the views on the canvas: what each covers, and how it is read there.

use super::super::lit_spans;
use super::super::mesh::{Mapping, Mesh, MeshGrid};
use super::super::paint::{Layers, Step, Warp, levels_of};
use super::super::params::Canvas;
use super::super::projective::IDENTITY;
use super::super::taps::{TAPS, Taps};
use super::super::warp::Span;
use super::{Compositor, Prepared};
use crate::Rect;
use crate::geometry::{Homography, Point};

impl Compositor {
    pub(super) fn reserve_views(&mut self, count: usize) {
        while self.layers.warps.len() < count {
            self.layers.warps.push(Warp {
                source_from_canvas: IDENTITY,
                source_from_tap: IDENTITY,
                shift: None,
                moved: None,
                moved_spans: Vec::new(),
                origins: [[0.0; 2]; 2],
                tap_step: 1.0,
                taps: Taps::default(),
            });
            self.layers.spans.push(Vec::new());
            self.layers.steps.push(Step::default());
        }
    }

    /// Finds which columns of each row of a canvas a view covers, and how it is read there.
    pub(super) fn cover(&mut self, view: usize, used: &[f64; 9], canvas: Canvas, avx2: bool) {
        let shift = [1.0, 0.0, -f64::from(canvas.left), 0.0, 1.0, -f64::from(canvas.top), 0.0, 0.0, 1.0];
        let (w, h) = self.sizes[view];
        // `accept` has refused matrices without an inverse.
        let used = Homography(*used);
        let inverse = used.inverse_bounded().unwrap_or_default();
        let Homography(mut m) = inverse.product(&Homography(shift));
        let [x, y] = used.map([w as f64 / 2.0, h as f64 / 2.0]);
        let (x, y) = (x + f64::from(canvas.left), y + f64::from(canvas.top));
        if m[6] * x + m[7] * y + m[8] < 0.0 {
            m = m.map(|v| -v);
        }
        let warp = &mut self.layers.warps[view];
        warp.source_from_canvas = m;
        let n = m.map(|v| v / m[8]);
        let whole = (0..9).all(|i| [2, 5].contains(&i) || (n[i] - IDENTITY[i]).abs() < 1e-12)
            && (n[2] - n[2].round()).abs() < 1e-6
            && (n[5] - n[5].round()).abs() < 1e-6;
        warp.shift = whole.then(|| (n[2].round() as i64, n[5].round() as i64));
        warp.origins[0] = [-canvas.left, -canvas.top].map(|at| at as f32);
        let mesh = self.layers.meshes[view].given();
        let (spans, size) = (&mut self.layers.spans[view], canvas);
        warp.mapping(mesh).coverage((w, h), size.width, size.height, spans);
        warp.moved = None;
        if let Some(mesh) = mesh.filter(|_| view == 0) {
            warp.moved = mesh.moved().and_then(|bounds| on_canvas(bounds, canvas));
            if let Some(moved) = warp.moved {
                let grid = MeshGrid { mesh, origin: warp.origins[0], step: 1.0 };
                grid.moved_spans((size.width, size.height), moved, &mut warp.moved_spans);
            }
            stay_outside(mesh, (w, h), canvas, spans);
        }
        let lit = self.layers.lit[view].as_ref().filter(|part| part.size() == (w, h));
        if let Some(lit) = lit {
            // The mesh of the reference view ends within it; beyond, the view stays where it is.
            let (plane, shaped) = (Mapping::Plane(&warp.source_from_canvas), warp.mapping(mesh));
            if view == 0 {
                lit_spans::cut(plane, lit, 0..size.height, spans, avx2);
            }
            let rows = warp.moved.filter(|_| view == 0).map_or(0..size.height, |moved| moved.y..moved.y + moved.height);
            if view > 0 || mesh.is_some() {
                lit_spans::cut(shaped, lit, rows, spans, avx2);
            }
        }
    }

    /// Computes the geometry of all views on the canvas.
    pub(super) fn place(&mut self, p: &Prepared, avx2: bool) {
        let scale = self.params.cell_px(self.sizes[0].0);
        let (columns, rows) = (p.canvas.width.div_ceil(scale), p.canvas.height.div_ceil(scale));
        let step = scale as f64 / TAPS as f64;
        let tap = [step, 0.0, step / 2.0 - 0.5, 0.0, step, step / 2.0 - 0.5, 0.0, 0.0, 1.0];
        self.reserve_views(p.active);
        for view in 0..p.active {
            self.cover(view, &p.used[view], p.canvas, avx2);
            let warp = &mut self.layers.warps[view];
            warp.source_from_tap = Homography(warp.source_from_canvas).product(&Homography(tap)).0;
            warp.origins[1] = warp.origins[0].map(|at| at + (step / 2.0 - 0.5) as f32);
            warp.tap_step = step as f32;
            let size = self.sizes[view];
            let (taps, from_tap) = warp.taps(self.layers.meshes[view].given());
            taps.place(columns * TAPS, rows * TAPS, from_tap, size);
            if let Some(lit) = self.layers.lit[view].as_ref().filter(|part| part.size() == size) {
                lit_spans::cut(from_tap, lit, 0..rows * TAPS, &mut taps.spans, avx2);
            }
        }
        self.layers.active = p.active;
        if p.active == 2 && self.layers.lit[0].is_some() {
            self.cut_beyond_first();
        }
        if p.active > 1 {
            self.layers.blender.reserve(p.canvas.width, p.canvas.height, levels_of(&self.params));
            let Layers { steps, cut, .. } = &mut self.layers;
            for step in &mut steps[..p.active] {
                step.ranges.reserve(p.canvas.height);
                step.segments.reserve(p.canvas.height, columns);
                step.seam.reserve(columns, rows, cut);
            }
        }
    }

    /// Removes the part of the second of two views beyond a rim of the first, on the side where it shows less.
    fn cut_beyond_first(&mut self) {
        let Layers { spans, warps, is_left, .. } = &mut self.layers;
        let ([base, new, ..], [first, second, ..]) = (&mut spans[..], &mut warps[..]) else { return };
        *is_left = lit_spans::reaches_left(base, new, *is_left);
        lit_spans::cut_beyond(base, new, *is_left);
        lit_spans::cut_beyond(&first.taps.spans, &mut second.taps.spans, *is_left);
    }
}

/// The canvas pixels inside bounds on the reference plane; `None` without any.
fn on_canvas([low, high]: [Point; 2], canvas: Canvas) -> Option<Rect> {
    let along = |low: f64, high: f64, origin: i32, size: usize| {
        let at = |v: f64| (v + f64::from(origin)).clamp(0.0, size as f64) as usize;
        (at(low.floor()), at(high.ceil() + 1.0))
    };
    let (x0, x1) = along(low[0], high[0], canvas.left, canvas.width);
    let (y0, y1) = along(low[1], high[1], canvas.top, canvas.height);
    (x0 < x1 && y0 < y1).then_some(Rect { x: x0, y: y0, width: x1 - x0, height: y1 - y0 })
}

/// Adds to the columns that the mesh of the reference view covers those outside the mesh, where that view is unchanged.
fn stay_outside(mesh: &Mesh, (width, height): (usize, usize), canvas: Canvas, spans: &mut [Span]) {
    let lattice = mesh.lattice();
    let ([x0, y0], [x1, y1]) = (lattice.position(0, 0), lattice.position(lattice.columns - 1, lattice.rows - 1));
    for (y, span) in spans.iter_mut().enumerate() {
        let row = y as i64 - i64::from(canvas.top);
        if row < 0 || row >= height as i64 {
            continue;
        }
        let start = canvas.left.max(0) as u32;
        let own = Span { start, end: (i64::from(canvas.left) + width as i64).clamp(0, canvas.width as i64) as u32 };
        if (row as f64) < y0 || row as f64 > y1 || span.is_empty() {
            *span = own;
            continue;
        }
        if x0 > 0.0 {
            span.start = own.start;
        }
        if x1 < width as f64 - 1.0 {
            span.end = own.end;
        }
    }
}
