//! Panoramas drawn on the device are those of the processor, but for rounding of positions.

use crate::support::{Held, device, difference, picture};
use panoscope_imaging::stitch::{
    BlendMethod, BorderMethod, CompositeParams, Compositor, Drawing, DrawnView, GeometryState, IDENTITY, Lattice,
    LazyView, Mesh, PaintError, Painter, Patch, Samples, SeamMethod,
};
use panoscope_imaging::{Parallel, Serial, View, ViewMut};
use panoscope_node::device::Gpu;
use panoscope_stitch::gpu::warp::{SharedFrame, Warper, locked};

const SIZE: (usize, usize) = (322, 241);
const STRIDE: usize = SIZE.0 * 3 + 7;
const MAPS: [[f64; 9]; 2] = [IDENTITY, [1.02, 0.03, 150.0, -0.02, 0.99, 6.0, 4e-5, -3e-5, 1.0]];

fn params(blend: BlendMethod) -> CompositeParams {
    CompositeParams { seam: SeamMethod::DynamicProgramming, blend, blend_px: 24, ..CompositeParams::default() }
}

fn pictures(frame: usize) -> [Vec<u8>; 2] {
    [picture(SIZE.0, SIZE.1, STRIDE, 3), picture(SIZE.0, SIZE.1, STRIDE, 4 + frame as u32)]
}

fn view(pixels: &[u8]) -> View<'_, u8> {
    View::with_stride(pixels, SIZE.0, SIZE.1, 3, STRIDE)
}

fn views(pictures: &[Vec<u8>; 2]) -> [View<'_, u8>; 2] {
    pictures.each_ref().map(|pixels| view(pixels))
}

/// A view that is only on the GPU.
struct Unread;

impl LazyView for Unread {
    fn layout(&self) -> View<'_, u8> {
        View { data: &[], width: SIZE.0, height: SIZE.1, stride: STRIDE, channels: 3 }
    }

    fn pixels(&self) -> View<'_, u8> {
        panic!("a view was read in the host's memory")
    }
}

fn compositor(params: CompositeParams, painter: Option<Box<dyn Painter>>, meshes: [Option<&Mesh>; 2]) -> Compositor {
    let mut compositor = Compositor::new(params);
    compositor.set_painter(painter);
    for (view, mesh) in meshes.iter().enumerate() {
        compositor.set_mesh(view, *mesh);
    }
    compositor
}

/// Draws a frame into the host's memory.
fn composed<V: LazyView>(compositor: &mut Compositor, views: &[V], maps: &[[f64; 9]], state: GeometryState) -> Vec<u8> {
    let canvas = compositor.canvas(views, maps, state).expect("a canvas");
    let mut out = vec![99; canvas.width * canvas.height * 3];
    let mut target = ViewMut::new(&mut out, canvas.width, canvas.height, 3);
    compositor.compose(views, maps, state, &Serial, &mut target, None).expect("composed");
    out
}

/// Frames of the processor.
fn panoramas(params: &CompositeParams, meshes: [Option<&Mesh>; 2], states: &[GeometryState]) -> Vec<Vec<u8>> {
    let mut compositor = compositor(params.clone(), None, meshes);
    let frames = states.iter().enumerate();
    frames.map(|(frame, state)| composed(&mut compositor, &views(&pictures(frame)), &MAPS, *state)).collect()
}

/// The same frames of the GPU, and which of them stay there.
fn panoramas_by(
    gpu: Gpu,
    params: &CompositeParams,
    meshes: [Option<&Mesh>; 2],
    states: &[GeometryState],
) -> (Vec<Vec<u8>>, Vec<bool>) {
    let images = SharedFrame::default();
    let warper = Box::new(Warper::new(gpu, images.clone()).expect("a warper"));
    let mut compositor = compositor(params.clone(), Some(warper), meshes);
    let mut stays = Vec::new();
    let made = states.iter().enumerate().map(|(frame, state)| {
        let held = pictures(frame).map(|pixels| Held::of(gpu, &pixels, SIZE.0, SIZE.1, STRIDE));
        locked(&images).views = held.iter().map(|held| held.image).collect();
        let views = [Unread, Unread];
        stays.push(compositor.can_stay_on_device(&views, &MAPS, *state).expect("views that fit"));
        let made = if stays[frame] {
            let canvas = compositor.canvas(&views, &MAPS, *state).expect("a canvas");
            let panorama = Held::new(gpu, canvas.width, canvas.height, 3);
            locked(&images).panorama = Some(panorama.image);
            let (_, drawn) = compositor.compose_on_device(&views, &MAPS, *state, &Serial, None).expect("composed");
            assert!(drawn.is_none());
            panorama.rows(gpu, 3 * canvas.width)
        } else {
            composed(&mut compositor, &views, &MAPS, *state)
        };
        assert_eq!(compositor.take_painter_fault(), None);
        assert!(compositor.has_painter());
        made
    });
    (made.collect(), stays)
}

/// A mesh that moves points by a few pixels.
fn mesh(columns: usize, shift: [f64; 2], bend_px: f64) -> Mesh {
    let lattice = Lattice { cell_px: 20, first: [2, -1], columns, rows: 14 };
    let wave = |x: f64, y: f64| bend_px * ((x / 45.0).sin() + (y / 31.0).cos());
    Mesh::new(lattice, |[x, y]| [x + shift[0] + wave(x, y), y + shift[1] + 0.5 * wave(y, x)]).expect("a mesh")
}

/// Name, parameters, meshes of both views, state of the geometry in each frame and whether that frame stays on the GPU.
type Case<'a> = (&'static str, CompositeParams, [Option<&'a Mesh>; 2], &'a [(GeometryState, bool)]);

#[test]
fn panoramas_are_those_of_the_processor() {
    let Some(gpu) = device() else { return };
    let (right, left) = (mesh(24, [-150.0, -6.0], 3.0), mesh(8, [0.0, 0.0], 1.5));
    let fresh = [(GeometryState::Fresh, true); 3];
    let lost = (GeometryState::Lost, false);
    let feather = || params(BlendMethod::Feather);
    let odd = CompositeParams { canvas: Some((487, 263)), ..feather() };
    let fading = CompositeParams { border: BorderMethod::Fade, ..feather() };
    let wide = CompositeParams { blend_px: 256, seam: SeamMethod::GraphCut, ..params(BlendMethod::MultiBand) };
    let unmarked = CompositeParams { mark_lost: false, ..feather() };
    let cases: [Case<'_>; 10] = [
        ("by homographies", feather(), [None, None], &fresh),
        ("without blending", params(BlendMethod::None), [None, None], &fresh),
        ("by a mesh", feather(), [None, Some(&right)], &fresh),
        ("by two meshes", params(BlendMethod::MultiBand), [Some(&left), Some(&right)], &fresh),
        ("on an odd canvas", odd, [None, Some(&right)], &fresh),
        ("with a wide transition", wide, [None, None], &fresh),
        ("with a border", fading, [None, None], &[(GeometryState::Fresh, false); 2]),
        ("one view", feather(), [None, None], &[lost]),
        ("one view without a mark", unmarked, [None, None], &[(GeometryState::Lost, true)]),
        ("lost later", feather(), [None, Some(&right)], &[fresh[0], lost, fresh[0]]),
    ];
    for (name, params, meshes, frames) in cases {
        let states: Vec<_> = frames.iter().map(|(state, _)| *state).collect();
        let expected = panoramas(&params, meshes, &states);
        let (found, stays) = panoramas_by(gpu, &params, meshes, &states);
        assert!(stays.iter().eq(frames.iter().map(|(_, stays)| stays)), "{name}: {stays:?}");
        for (frame, (expected, found)) in expected.iter().zip(&found).enumerate() {
            let (most, share) = difference(expected, found);
            // A position that falls on another 1/64 px changes a byte by a 64th of the difference of neighbours.
            assert!(most <= 3 && share < 0.02, "{name}, frame {frame}: by {most}, {:.2} % of the bytes", 100.0 * share);
        }
    }
}

/// Fails from a step of a frame on: 0 samples, 1 columns, 2 the panorama.
#[derive(Debug)]
struct Broken {
    step: usize,
    warper: Option<Warper>,
}

impl Broken {
    fn at(&mut self, step: usize) -> Result<&mut Warper, PaintError> {
        self.warper.as_mut().filter(|_| step < self.step).ok_or_else(|| "the device was lost".into())
    }
}

impl Painter for Broken {
    fn sample(&mut self, samples: &mut [Samples<'_>]) -> Result<(), PaintError> {
        samples.iter_mut().for_each(|samples| samples.values.fill([1; 4]));
        self.at(0)?.sample(samples)
    }

    fn draw_columns(&mut self, views: &[DrawnView<'_>; 2], patch: &mut Patch) -> Result<(), PaintError> {
        patch.pixels.fill(1);
        self.at(1)?.draw_columns(views, patch)
    }

    fn paint(
        &mut self,
        _: &Drawing<'_>,
        out: Option<&mut ViewMut<'_, u8>>,
        _: &dyn Parallel,
    ) -> Result<(), PaintError> {
        out.into_iter().for_each(|out| out.data.fill(1));
        Err(self.at(2).err().unwrap_or_else(|| "the device was lost".into()))
    }
}

#[test]
fn the_processor_draws_what_a_device_fails_to_draw() {
    let expected = panoramas(&params(BlendMethod::Feather), [None, None], &[GeometryState::Fresh]);
    let gpu = device();
    let pictures = pictures(0);
    // Without a device only the first step can fail.
    for (step, stays) in (0..=gpu.map_or(0, |_| 2)).flat_map(|step| [(step, false), (step, true)]) {
        let images = SharedFrame::default();
        let held = gpu.map(|gpu| pictures.each_ref().map(|p| Held::of(gpu, p, SIZE.0, SIZE.1, STRIDE)));
        locked(&images).views = held.iter().flatten().map(|held| held.image).collect();
        let warper = gpu.map(|gpu| Warper::new(gpu, images.clone()).expect("a warper"));
        let painter = Box::new(Broken { step, warper });
        let mut compositor = compositor(params(BlendMethod::Feather), Some(painter), [None, None]);
        let views = views(&pictures);
        let out = if stays {
            let made = compositor.compose_on_device(&views, &MAPS, GeometryState::Fresh, &Serial, None);
            made.expect("composed").1.expect("a panorama of the processor").data.to_vec()
        } else {
            composed(&mut compositor, &views, &MAPS, GeometryState::Fresh)
        };
        assert!(out == expected[0], "step {step}, on the device: {stays}");
        assert_eq!(compositor.take_painter_fault().as_deref(), Some("the device was lost"));
        assert!(!compositor.has_painter() && compositor.take_painter_fault().is_none());
    }
}

#[test]
fn the_processor_draws_more_than_two_views() {
    let pictures = pictures(0);
    let views = [&pictures[0], &pictures[1], &pictures[0]].map(|pixels| view(pixels));
    let maps = [IDENTITY, MAPS[1], [1.0, 0.0, 0.0, 0.0, 1.0, 120.0, 0.0, 0.0, 1.0]];
    // Before any good geometry the first view alone is shown.
    for state in [GeometryState::Lost, GeometryState::Fresh] {
        let made = [false, true].map(|has_painter| {
            let painter = has_painter.then(|| Box::new(Broken { step: 0, warper: None }) as Box<dyn Painter>);
            let mut compositor = compositor(params(BlendMethod::Feather), painter, [None, None]);
            assert!(!compositor.can_stay_on_device(&views, &maps, state).expect("views that fit"));
            let out = composed(&mut compositor, &views, &maps, state);
            assert_eq!(compositor.has_painter(), has_painter);
            out
        });
        assert!(made[0] == made[1], "{state:?}");
    }
}
