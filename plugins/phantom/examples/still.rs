//! Writes stills of the phantom: `still OUT_DIR [SCENE|all] [DISTANCE_MM] [FRAME] [SMOKE] [DROPS] [MOTION_BLUR]
//! [TOOLS]`.

use panoscope_imaging::{Serial, ViewMut};
use panoscope_phantom::render::{Phantom, Rig, SceneKind, SceneParams};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = std::path::PathBuf::from(arguments.next().unwrap_or_else(|| ".".to_owned()));
    let scenes = match arguments.next() {
        Some(name) if name != "all" => vec![name.parse()?],
        _ => SceneKind::ALL.to_vec(),
    };
    let distance_mm = arguments.next().map_or(Ok(50.0), |v| v.parse())?;
    let frame = arguments.next().map_or(Ok(0), |v| v.parse())?;
    let smoke = arguments.next().map_or(Ok(0.0), |v| v.parse())?;
    let blood_drops = arguments.next().map_or(Ok(0), |v| v.parse())?;
    let motion_blur = arguments.next().map_or(Ok(1), |v| v.parse())?;
    let tools = arguments.next().map_or(Ok(0), |v| v.parse())?;
    for scene in scenes {
        let start = std::time::Instant::now();
        let params =
            SceneParams { scene, distance_mm, smoke, blood_drops, motion_blur, tools, ..SceneParams::default() };
        let mut phantom = Phantom::new(params, Rig::stereo(640, 480, 15.0), &Serial)?;
        let baked = start.elapsed();
        let mut pictures = [vec![0; 640 * 480 * 3], vec![0; 640 * 480 * 3]];
        let mut best = f64::MAX;
        for _ in 0..5 {
            let [left, right] = &mut pictures;
            let mut views = [ViewMut::new(left, 640, 480, 3), ViewMut::new(right, 640, 480, 3)];
            let start = std::time::Instant::now();
            phantom.render(frame, None, &Serial, &mut views)?;
            best = best.min(start.elapsed().as_secs_f64() * 1e3);
        }
        println!(
            "{}: baked in {:.0} ms, a pair in {best:.1} ms on one thread",
            scene.name(),
            baked.as_secs_f64() * 1e3
        );
        for (picture, side) in pictures.iter_mut().zip(["left", "right"]) {
            picture.as_chunks_mut::<3>().0.iter_mut().for_each(|p| p.swap(0, 2));
            let path = folder.join(format!("{}_{side}.png", scene.name()));
            image::save_buffer(path, picture, 640, 480, image::ColorType::Rgb8)?;
        }
    }
    Ok(())
}
