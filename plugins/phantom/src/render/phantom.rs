//! The phantom: its state between frames, and how it draws a frame.

use std::sync::Arc;

use panoscope_imaging::{Parallel, SharedMut, ViewMut};

use super::camera_buffers::{CameraBuffers, check_size, equip, station_at};
use super::cast::{Coarse, Field, Station};
use super::effects::{self, Smoke};
use super::lens::Lens;
use super::material::{TEXELS, Texels};
use super::math::{Pose, hash};
use super::motion::Script;
use super::params::{CameraModel, IncidentKind, PhantomError, Rig, SceneParams};
use super::relief::{NODES, Relief};
use super::scratch::TruthScratch;
use super::shade::{self, portable};
use super::shade::{Picture, Sensor, Skin, rows_of};
use super::table::Table;
use super::tools::{self, Tool};

/// Rows drawn per chunk; a multiple of the tile.
const CHUNK_ROWS: usize = 16;
/// Number of sub-frames of an image during the incident `blur`.
const SHAKEN_FRAMES: usize = 12;
/// Movement of the scope during such an image, mm along x, y and z.
const SHAKEN_MM: [f64; 3] = [2.4, 1.2, 0.0];
/// Density of smoke during the incident `smoke`.
const INCIDENT_SMOKE: f32 = 0.95;
/// Colour of tissue that covers a lens, lit from within: B, G, R.
const COVERED: [u8; 3] = [22, 18, 88];

/// What is baked beyond the range that the corners of tiles see: rays between them bend a little, and Newton steps end near the surface.
const MARGIN_MM: f32 = 1.0;
/// Rays that descend less than this per mm of depth can end anywhere.
const LEVEL: f32 = 0.1;

/// A scene and its cameras.
pub struct Phantom {
    pub(super) params: SceneParams,
    pub(super) rig: Rig,
    pub(super) relief: Arc<Relief>,
    texels: Texels,
    script: Script,
    smoke: Option<Smoke>,
    /// Number of sub-frames of an image without an incident.
    subframes: usize,
    pub(super) tools: Vec<Tool>,
    /// Surface of the frame drawn last.
    z_mm: Table<f32>,
    breath_mm: f32,
    pub(super) camera_buffers: Vec<CameraBuffers>,
    pub(super) truth: TruthScratch,
    portable: bool,
}

impl Phantom {
    /// Builds the scene (about 0.1 s on one core) and tabulates the lenses.
    ///
    /// # Errors
    /// A parameter, camera or distortion that cannot be drawn.
    pub fn new(params: SceneParams, rig: Rig, pool: &dyn Parallel) -> Result<Self, PhantomError> {
        params.check()?;
        rig.check()?;
        let subframes = if params.shutter > 0.0 { params.motion_blur as usize } else { 1 };
        let is = |kind: IncidentKind| params.incident.is_some_and(|i| i.kind == kind);
        let most = if is(IncidentKind::Blur) { subframes.max(SHAKEN_FRAMES) } else { subframes };
        let density = if is(IncidentKind::Smoke) { INCIDENT_SMOKE } else { params.smoke };
        let buffers = |(i, model): (usize, &CameraModel)| CameraBuffers::new(*model, i, most);
        let mut camera_buffers = rig.cameras.iter().enumerate().map(buffers).collect::<Result<Vec<_>, _>>()?;
        for (camera, buffers) in camera_buffers.iter_mut().enumerate() {
            buffers.drops = effects::drops(&buffers.lens, params.seed, camera, params.blood_drops);
            if density > 0.0 {
                buffers.smoke = vec![0.0; buffers.lens.grid_padded * buffers.lens.grid_height];
            }
        }
        let smoke = (density > 0.0).then(|| Smoke::new(params.seed, density));
        let relief = Arc::new(Relief::new(&params, pool));
        let texels = Texels::new(&params, &relief, pool);
        let script = Script::new(&params);
        let tools = tools::cast_of(&params);
        let truth = TruthScratch::new(&rig.cameras)?;
        let z_mm = relief.z_mm.clone();
        Ok(Self {
            params,
            rig,
            relief,
            texels,
            script,
            smoke,
            subframes,
            tools,
            z_mm,
            breath_mm: 0.0,
            camera_buffers,
            truth,
            portable: false,
        })
    }

    /// The scene's parameters.
    pub fn params(&self) -> &SceneParams {
        &self.params
    }

    /// The cameras.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// `scene_from_camera` of the first camera in a frame of the script.
    pub fn pose(&self, frame: u64) -> Pose {
        self.script.pose(frame as f64)
    }

    /// Draws without AVX2 even if it is available; the bytes stay the same.
    pub fn force_portable(&mut self, portable: bool) {
        self.portable = portable;
    }

    pub(super) fn wide_lanes(&self) -> bool {
        !self.portable && panoscope_base::Simd::detect().avx2()
    }

    /// Draws one frame: `views[i]` (BGR, any stride) receives camera `i`. `pose` (`scene_from_camera` of the first
    /// camera) replaces the script's. Allocates only where a view sees tissue that no earlier one saw: its texels are baked then.
    ///
    /// # Errors
    /// Views of the wrong number or size, a pose that is not finite.
    pub fn render(
        &mut self,
        frame: u64,
        pose: Option<Pose>,
        pool: &dyn Parallel,
        views: &mut [ViewMut<u8>],
    ) -> Result<(), PhantomError> {
        if views.len() != self.camera_buffers.len() {
            return Err(PhantomError::WrongViewCount { got: views.len(), want: self.camera_buffers.len() });
        }
        for (i, (view, buffers)) in views.iter().zip(&self.camera_buffers).enumerate() {
            check_size(i, view, buffers.lens.width, buffers.lens.height, 3)?;
        }
        self.place(frame, pose)?;
        self.breathe(frame, pool);
        let mut camera_buffers = std::mem::take(&mut self.camera_buffers);
        let cameras = camera_buffers.len();
        // The smoke of an incident comes and goes.
        let clear = self.params.incident.is_some_and(|i| i.kind == IncidentKind::Smoke)
            && !self.suffers(IncidentKind::Smoke, frame)
            && self.params.smoke == 0.0;
        for (camera, (buffers, view)) in camera_buffers.iter_mut().zip(views).enumerate() {
            let black = self.params.black.is_some_and(|b| b.camera == camera && (b.first..b.end).contains(&frame));
            if black {
                (0..view.height).for_each(|y| view.row_mut(y).fill(0));
                continue;
            }
            if camera + 1 == cameras && self.suffers(IncidentKind::Covered, frame) {
                (0..view.height).for_each(|y| view.row_mut(y).as_chunks_mut::<3>().0.fill(COVERED));
                continue;
            }
            let used = self.subframes_at(frame);
            for (station, coarse) in &mut buffers.stations[..used] {
                self.coarse(&buffers.lens, station, coarse, pool);
            }
            if let Some(smoke) = self.smoke.as_ref().filter(|_| !clear) {
                let (pose, seconds) = (pose.unwrap_or_else(|| self.pose(frame)), frame as f64 / self.params.fps);
                smoke.fill(&buffers.lens, &pose, buffers.model.offset_mm, seconds, pool, &mut buffers.smoke);
            }
            let words = [self.params.seed as u32, (self.params.seed >> 32) as u32, frame as u32, (frame >> 32) as u32];
            let sensor = Sensor {
                gain: buffers.model.white_balance.map(|w| w * buffers.model.exposure * self.params.light),
                noise: self.params.noise,
                key: hash(&[words[0], words[1], words[2], words[3], camera as u32]),
                smoke: if clear { &[] } else { &buffers.smoke },
                drops: &buffers.drops,
            };
            self.bake(&buffers.lens, &buffers.stations[..used], pool);
            self.draw(&buffers.lens, &buffers.stations[..used], sensor, pool, view);
        }
        self.camera_buffers = camera_buffers;
        Ok(())
    }

    fn suffers(&self, kind: IncidentKind, frame: u64) -> bool {
        self.params.incident.is_some_and(|incident| incident.at(kind, frame))
    }

    /// Number of sub-frames from which a frame's images are averaged.
    fn subframes_at(&self, frame: u64) -> usize {
        if self.suffers(IncidentKind::Blur, frame) { self.subframes.max(SHAKEN_FRAMES) } else { self.subframes }
    }

    /// Computes the camera positions of all sub-frames.
    fn place(&mut self, frame: u64, pose: Option<Pose>) -> Result<(), PhantomError> {
        if pose.is_some_and(|p| !p.is_finite()) {
            return Err(PhantomError::BadPose);
        }
        let (count, shaken) = (self.subframes_at(frame), self.suffers(IncidentKind::Blur, frame));
        let (params, script, rig, period) = (&self.params, &self.script, &self.rig, f64::from(self.relief.period_mm));
        for buffers in &mut self.camera_buffers {
            for (k, (station, coarse)) in buffers.stations[..count].iter_mut().enumerate() {
                let share = (k as f64 + 0.5) / count as f64 - 0.5;
                let part = share * params.shutter * if count > 1 { 1.0 } else { 0.0 };
                let mut pose = pose.unwrap_or_else(|| script.pose(frame as f64 + part));
                if shaken {
                    pose.translation_mm.iter_mut().zip(SHAKEN_MM).for_each(|(place, shift)| *place += share * shift);
                }
                *station = station_at(&pose, buffers.model.offset_mm, rig.light_mm, period);
                let seconds = (frame as f64 + part) / params.fps;
                equip(&self.tools, seconds, &pose, buffers.model.offset_mm, rig.light_mm, &buffers.lens, coarse);
            }
        }
        Ok(())
    }

    /// Animates the surface to frame `frame`.
    pub(super) fn breathe(&mut self, frame: u64, pool: &dyn Parallel) {
        let breath = self.script.breath_mm(frame as f64) as f32;
        if breath == self.breath_mm {
            return;
        }
        self.breath_mm = breath;
        const ROWS: usize = 32;
        let (rest, swell) = (&self.relief.z_mm, &self.relief.breath);
        let z = SharedMut::new(&mut self.z_mm);
        pool.run(NODES / ROWS, &|chunk| {
            let at = chunk * ROWS * NODES;
            // SAFETY: each chunk takes its own rows.
            let z = unsafe { z.part(at, ROWS * NODES) };
            for ((z, rest), swell) in z.iter_mut().zip(&rest[at..]).zip(&swell[at..]) {
                *z = rest + breath * swell;
            }
        });
    }

    pub(super) fn field(&self) -> Field<'_> {
        Field {
            z_mm: &self.z_mm,
            per_mm: 1.0 / self.relief.cell_mm(),
            max_slope: self.relief.max_slope,
            block_slope: &self.relief.block_slope,
            nearest_mm: self.relief.z_range_mm[0],
        }
    }

    /// Runs the coarse pass: depths of the corners and the kind of each tile.
    pub(super) fn coarse(&self, lens: &Lens, station: &Station, coarse: &mut Coarse, pool: &dyn Parallel) {
        let field = self.field();
        let wide = self.wide_lanes();
        let depth = SharedMut::new(&mut coarse.depth_mm);
        pool.run(lens.grid_height, &|row| {
            // SAFETY: each chunk takes its own row.
            let out = unsafe { depth.part(row * lens.grid_padded, lens.grid_padded) };
            #[cfg(target_arch = "x86_64")]
            if wide {
                // SAFETY: `wide_lanes` found AVX2.
                return unsafe { shade::avx2::corners(&field, station, lens, row, out) };
            }
            let _ = wide;
            portable::corners(&field, station, lens, row, out);
        });
        let width = lens.grid_width - 1;
        let (depth_mm, tiles) = (&coarse.depth_mm, SharedMut::new(&mut coarse.tiles));
        pool.run(lens.grid_height - 1, &|row| {
            // SAFETY: each chunk takes its own row.
            let out = unsafe { tiles.part(row * width, width) };
            #[cfg(target_arch = "x86_64")]
            if wide {
                // SAFETY: `wide_lanes` found AVX2.
                return unsafe { shade::avx2::classify(&field, station, lens, depth_mm, row, out) };
            }
            portable::classify(&field, station, lens, depth_mm, row, out);
        });
    }

    /// Bakes the texels that views from `stations` can see: those between the planes in front of the relief and behind it, in all directions of the
    /// lens.
    pub(super) fn bake(&mut self, lens: &Lens, stations: &[(Station, Coarse)], pool: &dyn Parallel) {
        if self.texels.is_whole() {
            return;
        }
        for (station, _) in stations {
            let [from_mm, to_mm] = seen_mm(lens, station, self.relief.z_range_mm);
            self.texels.bake(from_mm - MARGIN_MM, to_mm + MARGIN_MM, pool);
        }
    }

    /// Bakes all texels.
    #[cfg(test)]
    pub(super) fn bake_all(&mut self, pool: &dyn Parallel) {
        self.texels.bake(f32::NEG_INFINITY, f32::INFINITY, pool);
    }

    /// Whether all texels are baked.
    #[cfg(test)]
    pub(super) fn is_baked(&self) -> bool {
        self.texels.is_whole()
    }

    /// Draws an image after its coarse pass and [`Self::bake`].
    pub(super) fn draw(
        &self,
        lens: &Lens,
        stations: &[(Station, Coarse)],
        sensor: Sensor,
        pool: &dyn Parallel,
        view: &mut ViewMut<u8>,
    ) {
        let distance = self.params.distance_mm as f32;
        let skin = Skin {
            texels: self.texels.map(),
            per_mm: TEXELS as f32 / self.relief.period_mm,
            specular: self.params.specular,
            power: 1.25 * distance * distance,
            breath: &self.relief.breath,
            breath_mm: self.breath_mm,
            nodes_per_mm: 1.0 / self.relief.cell_mm(),
        };
        let picture = Picture { lens, stations, field: self.field(), skin, sensor };
        let wide = self.wide_lanes();
        let (stride, width, height) = (view.stride, view.width, view.height);
        let shared = SharedMut::new(view.data);
        pool.run(height.div_ceil(CHUNK_ROWS), &|chunk| {
            let first = chunk * CHUNK_ROWS;
            // SAFETY: each chunk takes its own rows.
            let mut out = unsafe { rows_of(&shared, stride, width, first, CHUNK_ROWS.min(height - first)) };
            #[cfg(target_arch = "x86_64")]
            if wide {
                // SAFETY: `wide_lanes` found AVX2.
                return unsafe { shade::avx2::colour(&picture, first, &mut out) };
            }
            let _ = wide;
            portable::colour(&picture, first, &mut out);
        });
    }
}

/// Range of y in which a view can see the relief, mm; infinite where a ray runs almost level.
fn seen_mm(lens: &Lens, station: &Station, z_range_mm: [f32; 2]) -> [f32; 2] {
    let depths = [z_range_mm[0] - MARGIN_MM, z_range_mm[1] + MARGIN_MM].map(|z| (z - station.centre[2]).max(0.0));
    let [_, down, along] = station.rotation;
    let mut range = [f32::INFINITY, f32::NEG_INFINITY];
    for (x, y) in lens.corner_x.iter().zip(&lens.corner_y) {
        let part = |row: [f32; 3]| row[0] * x + row[1] * y + row[2];
        if part(along) < LEVEL {
            return [f32::NEG_INFINITY, f32::INFINITY];
        }
        for depth in depths {
            let place = station.centre[1] + depth * part(down) / part(along);
            range = [range[0].min(place), range[1].max(place)];
        }
    }
    range
}
