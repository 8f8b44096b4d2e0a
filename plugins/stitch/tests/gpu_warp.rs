//! Panoramas drawn on the device are those of the processor, but for rounding of positions.

use crate::support::{Held, device, difference, picture};
use panoscope_imaging::stitch::{
    BlendMethod, CompositeParams, Compositor, Drawing, GeometryState, IDENTITY, Lattice, Mesh, PaintError, Painter,
    SeamMethod,
};
use panoscope_imaging::{Parallel, Serial, View, ViewMut};
use panoscope_node::device::Gpu;
use panoscope_stitch::gpu::warp::{Sources, Warper};

const SIZE: (usize, usize) = (322, 240);

fn params(blend: BlendMethod) -> CompositeParams {
    CompositeParams { seam: SeamMethod::DynamicProgramming, blend, blend_px: 24, ..CompositeParams::default() }
}

/// Frames of a compositor with these meshes, by the processor or by `painter`.
fn panoramas(
    params: CompositeParams,
    meshes: [Option<&Mesh>; 2],
    states: &[GeometryState],
    gpu: Option<Gpu>,
) -> Vec<Vec<u8>> {
    let sources = Sources::default();
    let mut compositor = Compositor::new(params);
    compositor
        .set_painter(gpu.map(|gpu| Box::new(Warper::new(gpu, sources.clone()).expect("a warper")) as Box<dyn Painter>));
    let stride = SIZE.0 * 3 + 7;
    let mut made = Vec::new();
    for (frame, state) in states.iter().enumerate() {
        let pictures = [picture(SIZE.0, SIZE.1, stride, 3), picture(SIZE.0, SIZE.1, stride, 4 + frame as u32)];
        let views = pictures.each_ref().map(|p| View::with_stride(&p[..], SIZE.0, SIZE.1, 3, stride));
        let maps = [IDENTITY, [1.02, 0.03, 150.0, -0.02, 0.99, 6.0, 4e-5, -3e-5, 1.0]];
        for (view, mesh) in meshes.iter().enumerate() {
            compositor.set_mesh(view, *mesh);
        }
        let held = gpu.map(|gpu| pictures.each_ref().map(|p| Held::of(gpu, p, SIZE.0, SIZE.1, stride)));
        *sources.lock().expect("no panic") = held.iter().flatten().map(|held| held.image).collect();
        let canvas = compositor.canvas(&views, &maps, *state).expect("a canvas");
        let mut out = vec![99; canvas.width * canvas.height * 3];
        let mut target = ViewMut::new(&mut out, canvas.width, canvas.height, 3);
        compositor.compose(&views, &maps, *state, &Serial, &mut target, None).expect("composed");
        assert_eq!(compositor.take_painter_fault(), None);
        assert_eq!(compositor.has_painter(), gpu.is_some());
        made.push(out);
    }
    made
}

/// A mesh that moves points by a few pixels.
fn mesh(columns: usize, shift: [f64; 2], bend_px: f64) -> Mesh {
    let lattice = Lattice { cell_px: 20, first: [2, -1], columns, rows: 14 };
    let wave = |x: f64, y: f64| bend_px * ((x / 45.0).sin() + (y / 31.0).cos());
    Mesh::new(lattice, |[x, y]| [x + shift[0] + wave(x, y), y + shift[1] + 0.5 * wave(y, x)]).expect("a mesh")
}

/// Name, blending, meshes of both views, state of the geometry in each frame.
type Case<'a> = (&'static str, BlendMethod, [Option<&'a Mesh>; 2], &'a [GeometryState]);

#[test]
fn panoramas_are_those_of_the_processor() {
    let Some(gpu) = device() else { return };
    let (right, left) = (mesh(24, [-150.0, -6.0], 3.0), mesh(8, [0.0, 0.0], 1.5));
    let fresh = [GeometryState::Fresh; 3];
    let cases: [Case<'_>; 6] = [
        ("by homographies", BlendMethod::Feather, [None, None], &fresh),
        ("without blending", BlendMethod::None, [None, None], &fresh),
        ("by a mesh", BlendMethod::Feather, [None, Some(&right)], &fresh),
        ("by two meshes", BlendMethod::MultiBand, [Some(&left), Some(&right)], &fresh),
        ("one view", BlendMethod::Feather, [None, None], &[GeometryState::Lost]),
        ("lost later", BlendMethod::Feather, [None, Some(&right)], &[GeometryState::Fresh, GeometryState::Lost]),
    ];
    for (name, blend, meshes, states) in cases {
        let expected = panoramas(params(blend), meshes, states, None);
        let found = panoramas(params(blend), meshes, states, Some(gpu));
        for (frame, (expected, found)) in expected.iter().zip(&found).enumerate() {
            let (most, share) = difference(expected, found);
            // A position that falls on another 1/64 px changes a byte by a 64th of the difference of neighbours.
            assert!(most <= 3 && share < 0.02, "{name}, frame {frame}: by {most}, {:.2} % of the bytes", 100.0 * share);
        }
    }
}

#[derive(Debug)]
struct Broken;

impl Painter for Broken {
    fn paint(&mut self, _: &Drawing<'_>, out: &mut ViewMut<'_, u8>, _: &dyn Parallel) -> Result<(), PaintError> {
        out.data.fill(1);
        Err("the device was lost".into())
    }
}

#[test]
fn the_processor_draws_what_a_device_fails_to_draw() {
    let expected = panoramas(params(BlendMethod::Feather), [None, None], &[GeometryState::Fresh], None);
    let mut compositor = Compositor::new(params(BlendMethod::Feather));
    compositor.set_painter(Some(Box::new(Broken)));
    let stride = SIZE.0 * 3 + 7;
    let pictures = [picture(SIZE.0, SIZE.1, stride, 3), picture(SIZE.0, SIZE.1, stride, 4)];
    let views = pictures.each_ref().map(|p| View::with_stride(&p[..], SIZE.0, SIZE.1, 3, stride));
    let maps = [IDENTITY, [1.02, 0.03, 150.0, -0.02, 0.99, 6.0, 4e-5, -3e-5, 1.0]];
    let canvas = compositor.canvas(&views, &maps, GeometryState::Fresh).expect("a canvas");
    let mut out = vec![99; canvas.width * canvas.height * 3];
    let mut target = ViewMut::new(&mut out, canvas.width, canvas.height, 3);
    compositor.compose(&views, &maps, GeometryState::Fresh, &Serial, &mut target, None).expect("composed");
    assert!(out == expected[0]);
    assert_eq!(compositor.take_painter_fault().as_deref(), Some("the device was lost"));
    assert!(!compositor.has_painter() && compositor.take_painter_fault().is_none());
}
