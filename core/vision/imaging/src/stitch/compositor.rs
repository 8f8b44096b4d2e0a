//! The compositor: views and homographies in, panorama out.

mod place;

use super::border::{self, Border};
use super::canvas::{Bounds, CanvasHolder};
use super::crop::Crop;
use super::drawing::{LazyView, PaintError, Painter};
use super::lit_spans;
use super::mark;
use super::mesh::Mesh;
use super::paint::Layers;
use super::params::*;
use super::projective::{self, IDENTITY};
use super::segments;
use crate::lit::{LitFinder, LitPart};
use crate::{Parallel, Simd, View, ViewMut};

/// Default time between frames, s.
const USUAL_FRAME_S: f64 = 1.0 / 30.0;

/// Joins views into one panorama. Keeps all state between frames: canvas, seam, gains, last good geometry, work memory.
/// In steady state nothing is allocated.
#[derive(Debug, Default)]
pub struct Compositor {
    pub(super) params: CompositeParams,
    holder: CanvasHolder,
    crop: Crop,
    /// Finders of the lit parts of views without a given one, used while the panorama is cropped.
    finders: [LitFinder; MAX_VIEWS],
    is_lit_given: [bool; MAX_VIEWS],
    /// Canvas of the frame before.
    drawn: Option<Canvas>,
    /// Time from one frame to the next, s.
    frame_s: Option<f64>,
    sizes: Vec<(usize, usize)>,
    good: Option<[[f64; 9]; MAX_VIEWS]>,
    prepared: Option<Prepared>,
    placed: Option<(Canvas, usize, [[f64; 9]; MAX_VIEWS])>,
    /// Whether a mesh has changed since the geometry was placed.
    has_new_mesh: bool,
    /// Whether a lit part has changed since the geometry was placed.
    has_new_part: bool,
    pub(super) layers: Layers,
    border: Border,
    painter: Option<Box<dyn Painter>>,
    painter_fault: Option<String>,
    /// Panorama that the processor drew when the painter failed to draw it on its device.
    spare: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Prepared {
    given: [[f64; 9]; MAX_VIEWS],
    given_state: GeometryState,
    canvas: Canvas,
    used: [[f64; 9]; MAX_VIEWS],
    active: usize,
    state: GeometryState,
    fault: Option<GeometryFault>,
}

impl Compositor {
    /// A compositor without canvas, seam and geometry.
    pub fn new(params: CompositeParams) -> Self {
        let mut new = Self { params, ..Self::default() };
        new.layers.forget_gains();
        new
    }

    /// The parameters in force.
    pub fn params(&self) -> &CompositeParams {
        &self.params
    }

    /// Changes parameters between frames. Canvas, seam and gains are kept where the change allows it.
    pub fn set_params(&mut self, params: CompositeParams) {
        if params.canvas != self.params.canvas {
            self.holder.reset();
        }
        if params.crop != self.params.crop {
            self.crop.forget();
            self.forget_found_parts();
        }
        if params.exposure != self.params.exposure {
            self.layers.forget_gains();
        }
        self.params = params;
        self.placed = None;
        self.prepared = None;
        for step in &mut self.layers.steps {
            step.seam.forget();
        }
    }

    /// Lets `painter` draw the panoramas of one and of two views; the processor finds and blends the seam, and draws all
    /// others. A painter that fails is not used again.
    pub fn set_painter(&mut self, painter: Option<Box<dyn Painter>>) {
        self.painter = painter;
        self.painter_fault = None;
    }

    /// Whether a painter is set that has not failed.
    pub fn has_painter(&self) -> bool {
        self.painter.is_some()
    }

    /// The error of the failed painter; returned once.
    pub fn take_painter_fault(&mut self) -> Option<String> {
        self.painter_fault.take()
    }

    /// Clears canvas, seam, gains and geometry, as after a cut in the video. Work memory stays.
    pub fn reset(&mut self) {
        self.holder.reset();
        self.crop.forget();
        self.forget_found_parts();
        self.good = None;
        self.prepared = None;
        self.placed = None;
        self.layers.forget();
        self.border.forget();
    }

    /// Sets the time between frames, which the crop uses; default 1/30 s, at most 1 s.
    pub fn set_frame_interval(&mut self, interval: std::time::Duration) {
        self.frame_s = Some(interval.as_secs_f64().min(1.0));
    }

    /// Draws view `view` by a mesh instead of its homography, or by its homography again with `None`, from the next
    /// frame on.
    ///
    /// The mesh maps the reference plane to this view. The homography still decides whether the frame is used, and the
    /// canvas covers both. The mesh of the reference view, number 0, moves a part of it on that plane; outside the mesh
    /// it is unchanged. Views beyond [`MAX_VIEWS`] are ignored.
    pub fn set_mesh(&mut self, view: usize, mesh: Option<&Mesh>) {
        if view >= MAX_VIEWS {
            return;
        }
        let held = &mut self.layers.meshes[view];
        self.has_new_mesh |= match mesh {
            Some(mesh) => held.copy_from(mesh),
            None => held.clear(),
        };
        // The canvas may have to cover more.
        if self.has_new_mesh {
            self.prepared = None;
        }
    }

    /// Shows, blends and compares only the lit part of view `view` from the next frame on; all of it with `None`. A
    /// part of another size than the view has no effect.
    ///
    /// In a cropped panorama the lit parts of other views are found automatically.
    pub fn set_lit(&mut self, view: usize, part: Option<&LitPart>) {
        if let Some(given) = self.is_lit_given.get_mut(view) {
            *given = part.is_some();
        }
        if let Some(held) = self.layers.lit.get_mut(view)
            && held.as_ref() != part
        {
            *held = part.cloned();
            self.has_new_part = true;
        }
    }

    /// The canvas that [`compose`](Self::compose) will draw on when called next with the same arguments.
    ///
    /// # Errors
    /// When views and homographies do not fit together; bad homographies give the last good canvas.
    pub fn canvas<V: LazyView>(
        &mut self,
        views: &[V],
        left_from_view: &[[f64; 9]],
        state: GeometryState,
    ) -> Result<Canvas, CompositeError> {
        Ok(self.prepare(views, left_from_view, state)?.canvas)
    }

    /// Whether [`compose`](Self::compose), called next with the same arguments, uses these homographies; `false` when
    /// the last good geometry (or the reference view alone) would be used instead.
    ///
    /// # Errors
    /// When views and homographies do not fit together.
    pub fn accepts<V: LazyView>(
        &mut self,
        views: &[V],
        left_from_view: &[[f64; 9]],
        state: GeometryState,
    ) -> Result<bool, CompositeError> {
        Ok(self.prepare(views, left_from_view, state)?.state != GeometryState::Lost)
    }

    fn prepare<V: LazyView>(
        &mut self,
        views: &[V],
        left_from_view: &[[f64; 9]],
        given_state: GeometryState,
    ) -> Result<Prepared, CompositeError> {
        if views.is_empty() || views.len() > MAX_VIEWS {
            return Err(CompositeError::ViewCount { views: views.len() });
        }
        if left_from_view.len() != views.len() {
            return Err(CompositeError::HomographyCount { views: views.len(), homographies: left_from_view.len() });
        }
        for (view, v) in views.iter().map(LazyView::layout).enumerate() {
            // Offsets are 32 bits and coordinates f32: both hold far beyond any camera.
            let large = v.width > 16384 || v.height > 16384 || v.stride.saturating_mul(v.height) > i32::MAX as usize;
            if v.channels != 3 || v.width < 2 || v.height < 2 || large {
                return Err(CompositeError::View { view, width: v.width, height: v.height, channels: v.channels });
            }
        }
        let sizes = || views.iter().map(|view| (view.layout().width, view.layout().height));
        if !self.sizes.iter().copied().eq(sizes()) {
            self.reset();
            self.sizes.clear();
            self.sizes.extend(sizes());
        }
        let mut given = [IDENTITY; MAX_VIEWS];
        given[..views.len()].copy_from_slice(left_from_view);
        // Compared by bits: a NaN is the same input as itself.
        let bits = |h: &[[f64; 9]; MAX_VIEWS]| h.map(|h| h.map(f64::to_bits));
        if let Some(p) = self.prepared
            && p.given_state == given_state
            && bits(&p.given) == bits(&given)
        {
            return Ok(p);
        }
        let mut fault = None;
        if given_state != GeometryState::Lost {
            match self.accept(views, &given) {
                Ok(canvas) => {
                    self.good = Some(given);
                    let p = Prepared {
                        given,
                        given_state,
                        canvas,
                        used: given,
                        active: views.len(),
                        state: given_state,
                        fault: None,
                    };
                    self.prepared = Some(p);
                    return Ok(p);
                }
                Err(f) => fault = Some(f),
            }
        }
        let state = GeometryState::Lost;
        let held = if self.is_cropped() { self.crop.canvas() } else { self.holder.current() };
        let p = match (self.good, held) {
            (Some(used), Some(canvas)) => {
                Prepared { given, given_state, canvas, used, active: views.len(), state, fault }
            }
            _ => {
                // Nothing good yet: the reference view alone, on a canvas that is not kept.
                let (w, h) = self.sizes[0];
                let (x, y) = ((w - 1) as f64, (h - 1) as f64);
                let bounds = Bounds { x0: 0.0, y0: 0.0, x1: x, y1: y };
                let alone = Canvas { width: w, height: h, left: 0, top: 0 };
                let canvas = if self.is_cropped() {
                    alone
                } else {
                    CanvasHolder::default().update(bounds, &self.params).unwrap_or(alone)
                };
                Prepared { given, given_state, canvas, used: [IDENTITY; MAX_VIEWS], active: 1, state, fault }
            }
        };
        self.prepared = Some(p);
        Ok(p)
    }

    fn is_cropped(&self) -> bool {
        self.params.crop != CropMethod::None && self.params.canvas.is_none()
    }

    fn accept<V: LazyView>(&mut self, views: &[V], given: &[[f64; 9]; MAX_VIEWS]) -> Result<Canvas, GeometryFault> {
        let mut quads = [[(0.0, 0.0); 4]; MAX_VIEWS];
        for (view, (w, h)) in self.sizes.iter().enumerate() {
            quads[view] = projective::warped_corners(&given[view], *w, *h, view)?;
        }
        let mut bounds = Bounds::of(quads[..self.sizes.len()].iter());
        // The reference view is moved inside its own bounds, or where another view lies.
        for (mesh, size) in self.layers.meshes.iter().zip(&self.sizes).skip(1) {
            if let Some([[x0, y0], [x1, y1]]) = mesh.given().and_then(|mesh| mesh.footprint(*size)) {
                bounds = bounds.union(Bounds { x0, y0, x1, y1 });
            }
        }
        let canvas = self.holder.update(bounds, &self.params)?;
        if !self.is_cropped() {
            return Ok(canvas);
        }
        if self.crop.is_due() {
            self.look(views, given, bounds);
        }
        Ok(self.crop.canvas().unwrap_or(canvas))
    }

    /// Updates the crop with the area that the drawn views cover on the plane.
    fn look<V: LazyView>(&mut self, views: &[V], given: &[[f64; 9]; MAX_VIEWS], bounds: Bounds) {
        for (index, (finder, view)) in self.finders.iter_mut().zip(views).enumerate() {
            if !self.is_lit_given[index] && finder.look(view.pixels(), None) {
                let part = Some(finder.part()).filter(|part| !part.is_whole());
                self.layers.lit[index] = part.cloned();
                self.has_new_part = true;
            }
        }
        let canvas = self.crop.whole(bounds, self.sizes[0].0);
        self.reserve_views(views.len());
        let avx2 = Simd::detect().avx2();
        for (view, used) in given.iter().enumerate().take(views.len()) {
            self.cover(view, used, canvas, avx2);
        }
        if views.len() == 2 && self.layers.lit[0].is_some() {
            let (base, new) = self.layers.spans.split_at_mut(1);
            self.layers.is_left = lit_spans::reaches_left(&base[0], &new[0], self.layers.is_left);
            lit_spans::cut_beyond(&base[0], &mut new[0], self.layers.is_left);
        }
        // What is drawn is placed again.
        self.placed = None;
        let one_px = (self.sizes[0].0 * self.sizes[0].1) as f64;
        let lit_px = one_px * self.layers.lit[0].as_ref().map_or(1.0, LitPart::share);
        self.crop.update(&self.layers.spans[..views.len()], self.sizes[0], lit_px, &self.params);
    }

    fn forget_found_parts(&mut self) {
        self.finders.iter_mut().for_each(LitFinder::forget);
        for (lit, _) in self.layers.lit.iter_mut().zip(&self.is_lit_given).filter(|(_, is_given)| !**is_given) {
            self.has_new_part |= lit.take().is_some();
        }
    }

    /// Whether the panorama that [`compose`](Self::compose) draws when called next with the same arguments can be drawn by
    /// [`compose_on_device`](Self::compose_on_device): by a painter, without marks and with its border as it is.
    ///
    /// # Errors
    /// When views and homographies do not fit together.
    pub fn can_stay_on_device<V: LazyView>(
        &mut self,
        views: &[V],
        left_from_view: &[[f64; 9]],
        state: GeometryState,
    ) -> Result<bool, CompositeError> {
        let p = self.prepare(views, left_from_view, state)?;
        let is_plain = self.params.border == BorderMethod::AsIs && !mark::has_marks(p.state, &self.params);
        Ok(is_plain && self.painter.is_some() && views.len() <= 2)
    }

    /// As [`compose`](Self::compose), into the image that the painter has on its device; marks and border are not drawn.
    /// Returns the panorama if the painter failed and the processor drew it.
    ///
    /// # Errors
    /// As of [`compose`](Self::compose).
    pub fn compose_on_device<V: LazyView>(
        &mut self,
        views: &[V],
        left_from_view: &[[f64; 9]],
        state: GeometryState,
        pool: &dyn Parallel,
        mask_out: Option<&mut ViewMut<u8>>,
    ) -> Result<(CompositeReport, Option<View<'_, u8>>), CompositeError> {
        let report = self.compose_into(views, left_from_view, state, pool, None, mask_out)?;
        let Canvas { width, height, .. } = report.canvas;
        Ok((report, self.painter.is_none().then(|| View::new(&self.spare, width, height, 3))))
    }

    /// Draws the panorama of `views` on `out`.
    ///
    /// `left_from_view[i]` (row-major 3x3) maps pixels of view `i` to those of the reference view, which comes first
    /// and has the identity. With `state` lost, or with homographies that [`GeometryFault`] names, the last good
    /// geometry is used and the frame is marked; before any good geometry the reference view alone is shown. `out`
    /// (BGR) and `mask_out` (gray, 255 inside a view) must have the size of [`canvas`](Self::canvas).
    ///
    /// # Errors
    /// When views, homographies or outputs do not fit together.
    pub fn compose<V: LazyView>(
        &mut self,
        views: &[V],
        left_from_view: &[[f64; 9]],
        state: GeometryState,
        pool: &dyn Parallel,
        out: &mut ViewMut<u8>,
        mask_out: Option<&mut ViewMut<u8>>,
    ) -> Result<CompositeReport, CompositeError> {
        self.compose_into(views, left_from_view, state, pool, Some(out), mask_out)
    }

    /// Draws the panorama on `out`, or on the painter's device; if that fails, on `spare`.
    fn compose_into<V: LazyView>(
        &mut self,
        views: &[V],
        left_from_view: &[[f64; 9]],
        state: GeometryState,
        pool: &dyn Parallel,
        mut out: Option<&mut ViewMut<u8>>,
        mask_out: Option<&mut ViewMut<u8>>,
    ) -> Result<CompositeReport, CompositeError> {
        let p = self.prepare(views, left_from_view, state)?;
        let Canvas { width, height, .. } = p.canvas;
        let fits = |v: &ViewMut<u8>, channels: usize| (v.width, v.height, v.channels) == (width, height, channels);
        if out.as_ref().is_some_and(|out| !fits(out, 3)) {
            return Err(CompositeError::Output { width, height, channels: 3 });
        }
        if mask_out.as_ref().is_some_and(|m| !fits(m, 1)) {
            return Err(CompositeError::Output { width, height, channels: 1 });
        }
        self.prepared = None;
        self.crop.elapse(self.frame_s.unwrap_or(USUAL_FRAME_S));
        let avx2 = Simd::detect().avx2();
        let key = (p.canvas, p.active, p.used);
        if self.drawn.replace(p.canvas).is_some_and(|drawn| drawn != p.canvas) {
            // Cells of the seam lie on the canvas.
            self.layers.steps.iter_mut().for_each(|step| step.seam.forget());
        }
        let has_new_shape = std::mem::take(&mut self.has_new_mesh) | std::mem::take(&mut self.has_new_part);
        let moved = has_new_shape | (self.placed != Some(key));
        if moved {
            self.place(&p, avx2);
            self.placed = Some(key);
        }
        let views = &views[..p.active];
        let may_learn = p.state != GeometryState::Lost;
        let begun = std::time::Instant::now();
        let sampled = self
            .by_painter(|layers, _, painter| layers.sample_by(painter, &all(views, V::layout)[..p.active], pool, avx2));
        if !sampled {
            self.layers.sample(&all(views, V::pixels)[..p.active], pool, avx2);
        }
        let scale = self.params.cell_px(self.sizes[0].0);
        let (seam_found, seam_cost) = self.layers.plan(&self.params, scale, may_learn, moved, p.canvas, pool);
        let seam_time = begun.elapsed();
        let painted = self.by_painter(|layers, params, painter| {
            let views = &all(views, V::layout)[..p.active];
            layers.paint_by(painter, params, views, p.canvas, pool, out.as_deref_mut(), avx2)
        });
        if !painted {
            let views = &all(views, V::pixels)[..p.active];
            match &mut out {
                Some(out) => self.layers.paint(&self.params, views, p.canvas, pool, out, avx2),
                None => {
                    self.spare.resize(width * height * 3, 0);
                    let out = &mut ViewMut::new(&mut self.spare, width, height, 3);
                    self.layers.paint(&self.params, views, p.canvas, pool, out, avx2);
                }
            }
        }
        if let Some(mask) = mask_out {
            self.layers.paint_mask(mask, pool);
        }
        if let Some(out) = out {
            self.border.draw(&self.params, &self.layers.spans[..p.active], out, pool);
            mark::draw_marks(out, p.canvas, p.state, &self.params);
        }
        let cropped_gain = self.crop.gain_percent().filter(|_| self.is_cropped() && p.active > 1);
        let mut gains = [[1.0; 3]; MAX_VIEWS];
        gains[..p.active].copy_from_slice(&self.layers.gains[..p.active]);
        Ok(CompositeReport {
            state: p.state,
            fault: p.fault,
            canvas: p.canvas,
            seam_found,
            seam_cost,
            seam_time,
            view_gain_percent: cropped_gain.unwrap_or_else(|| {
                let one = self.sizes[0].0 * self.sizes[0].1;
                100.0 * (border::covered_px(&self.layers.spans[..p.active]) as f64 / one as f64 - 1.0)
            }),
            gains,
        })
    }

    /// Lets the painter work if there are one or two views; one that fails is given up. Returns whether it succeeded.
    fn by_painter(
        &mut self,
        work: impl FnOnce(&mut Layers, &CompositeParams, &mut dyn Painter) -> Result<(), PaintError>,
    ) -> bool {
        let Some(painter) = self.painter.as_deref_mut().filter(|_| self.sizes.len() <= 2) else { return false };
        let done = work(&mut self.layers, &self.params, painter);
        if let Err(reason) = &done {
            self.painter = None;
            self.painter_fault = Some(reason.to_string());
        }
        done.is_ok()
    }

    /// Writes the view that each pixel of the last image shows: 0 none, 1 the first, 2 the second and so on.
    ///
    /// # Errors
    /// When `out` is not gray or does not have the size of the last canvas.
    pub fn shown(&self, out: &mut ViewMut<u8>) -> Result<(), CompositeError> {
        let Some((canvas, active, _)) = self.placed else {
            return Err(CompositeError::Output { width: 0, height: 0, channels: 1 });
        };
        if (out.width, out.height, out.channels) != (canvas.width, canvas.height, 1) {
            return Err(CompositeError::Output { width: canvas.width, height: canvas.height, channels: 1 });
        }
        for y in 0..canvas.height {
            let row = out.row_mut(y);
            row.fill(0);
            let first = self.layers.spans[0][y];
            if !first.is_empty() {
                row[first.start as usize..first.end as usize].fill(1);
            }
            for view in 1..active {
                for run in self.layers.steps[view].segments.row(y) {
                    if matches!(run.kind, segments::NEW_SHOWN | segments::NEW_ONLY) {
                        row[run.start as usize..run.end as usize].fill(view as u8 + 1);
                    }
                }
            }
        }
        Ok(())
    }
}

/// The layouts of all views, or their pixels.
fn all<'v, V: LazyView>(views: &'v [V], of: fn(&'v V) -> View<'v, u8>) -> [View<'v, u8>; MAX_VIEWS] {
    std::array::from_fn(|view| views.get(view).map_or(View::new(&[], 0, 0, 3), of))
}
