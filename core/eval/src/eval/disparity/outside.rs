//! The phantom's truth checked from outside, its speed, and the whole range of the scope.
//!
//! Warping the right view by the true disparity must give the left view, up to the sensor's noise, wherever both cameras see the
//! same point.

use panoscope_imaging::stereo::{Rectification, RectifiedCamera, score_disparity, score_surface};
use panoscope_imaging::{Rect, View};

use super::data::Picture;
use super::judge::{Judge, REACH_MM};
use super::picture;
use super::rectified::points;
use crate::error::{Context, Result};
use crate::figures::Figure;
use crate::inputs::scene::{phantom, rectified};
use crate::packets::floats;
use crate::ruler::{BASELINE_MM, FOCAL_PX, SIZE};
use crate::run::{self, Plan};

const SCENES: [&str; 5] = ["liver", "bowel", "cavity", "box", "board"];
/// A difference beyond this is no noise, gray levels.
const LARGE_LEVELS: f32 = 12.0;
/// Distances of the range case, mm.
const RANGE_MM: [f64; 6] = [20.0, 22.0, 25.0, 35.0, 50.0, 70.0];
/// Ticks of the speed measurement.
const FPS_TICKS: u64 = 120;

/// Mean of the three channels of the right view at a place between pixels of one row.
fn sample(view: &Picture, x: f32, y: usize) -> f32 {
    let left = (x.floor().max(0.0) as usize).min(view.width - 1);
    let right = (left + 1).min(view.width - 1);
    let at = |x: usize| -> f32 { view.bgr[3 * (y * view.width + x)..][..3].iter().map(|v| f32::from(*v)).sum() };
    let part = (x - left as f32).clamp(0.0, 1.0);
    (at(left) * (1.0 - part) + at(right) * part) / 3.0
}

/// What warping leaves.
struct Warped {
    /// Mean difference where both cameras see, gray levels.
    seen: f64,
    /// The same where only the left one sees.
    hidden: f64,
    /// Share of the seen pixels with a large difference.
    large: f64,
    /// Share of those that lie within 2 px of an edge of depth or of the visible part.
    large_at_edges: f64,
    map: Vec<f32>,
}

fn warp(left: &Picture, right: &Picture, disparity: &[f32], visible: &[u8]) -> Warped {
    let (width, height) = (left.width, left.height);
    let is_seen = |index: usize| visible[index] > 127 && disparity[index].is_finite();
    let place = |index: usize| (index % width) as f32 - disparity[index];
    let own = |index: usize| left.bgr[3 * index..][..3].iter().map(|v| f32::from(*v)).sum::<f32>() / 3.0;
    // The right camera's exposure and colour differ by a factor; one number for the whole picture takes that out.
    let (mut sums, mut map) = ([0.0f64; 2], vec![f32::NAN; width * height]);
    for index in (0..width * height).filter(|index| is_seen(*index)) {
        sums[0] += f64::from(own(index));
        sums[1] += f64::from(sample(right, place(index), index / width));
    }
    let gain = (sums[0] / sums[1].max(1.0)) as f32;
    let (mut seen, mut hidden) = ((0.0f64, 0usize), (0.0f64, 0usize));
    let (mut large, mut at_edges) = (0usize, 0usize);
    for (index, out) in map.iter_mut().enumerate() {
        let to = place(index);
        if !(to > 0.0 && to < (width - 1) as f32) {
            continue;
        }
        let difference = (own(index) - gain * sample(right, to, index / width)).abs();
        *out = difference;
        let count = if is_seen(index) { &mut seen } else { &mut hidden };
        *count = (count.0 + f64::from(difference), count.1 + 1);
        if is_seen(index) && difference > LARGE_LEVELS {
            large += 1;
            at_edges += usize::from(is_edge(disparity, visible, width, height, index));
        }
    }
    let mean = |(sum, count): (f64, usize)| if count == 0 { f64::NAN } else { sum / count as f64 };
    Warped {
        seen: mean(seen),
        hidden: mean(hidden),
        large: large as f64 / seen.1.max(1) as f64,
        large_at_edges: at_edges as f64 / large.max(1) as f64,
        map,
    }
}

/// Whether depth or visibility changes within 2 px.
fn is_edge(disparity: &[f32], visible: &[u8], width: usize, height: usize, index: usize) -> bool {
    let (x, y) = (index % width, index / width);
    (y.saturating_sub(2)..(y + 3).min(height)).any(|row| {
        (x.saturating_sub(2)..(x + 3).min(width)).any(|column| {
            let at = row * width + column;
            // NaN is an edge too.
            let is_level = (disparity[at] - disparity[index]).abs() < 2.0;
            visible[at] != visible[index] || !is_level
        })
    })
}

impl Judge<'_> {
    pub fn outside(&mut self) -> Result<()> {
        for scene in SCENES {
            for (kind, noise) in [("noise", 1.0), ("no_noise", 0.0)] {
                self.warped(scene, kind, noise)?;
            }
        }
        for scene in ["liver", "bowel", "cavity"] {
            self.speed(scene)?;
        }
        Ok(())
    }

    fn warped(&mut self, scene: &str, kind: &str, noise: f64) -> Result<()> {
        // Highlights move with the camera: they are no part of the surface.
        let text = format!(
            "mode = \"batch\"\nplugins = [\"phantom\"]\n[nodes.scope]\ntype = \"phantom\"\nparams = {{ scene = \"{scene}\", specular = 0.0, noise = {noise:?}, right_exposure = 1.0, speed_mm_s = 0.0 }}\n"
        );
        let ports = [("scope", "left"), ("scope", "right"), ("scope", "disparity"), ("scope", "visible")];
        let plan = Plan { text: &text, frames: Some(6), ports: &ports, ..Plan::default() };
        let seen = run::run(self.session, &plan)?;
        let packet = |index: usize| seen.packets[index].as_ref().context("the phantom gave nothing");
        let disparity = floats(packet(2)?).context("a map is cut off")?;
        let visible = packet(3)?.bytes().to_vec();
        let warped = warp(&Picture::of(packet(0)?)?, &Picture::of(packet(1)?)?, &disparity, &visible);
        let case = format!("{scene}/{kind}");
        let input = format!("phantom {scene} 640x480 at 50 mm, no highlights, right view warped by the true disparity");
        self.add(format!("warp_difference/{case}"), warped.seen, "levels", &input);
        if warped.hidden.is_finite() {
            self.add(format!("warp_difference_hidden/{case}"), warped.hidden, "levels", &input);
        }
        self.add(format!("warp_large/{case}"), 100.0 * warped.large, "%", &input);
        if warped.large > 0.0 {
            self.add(format!("warp_large_at_edges/{case}"), 100.0 * warped.large_at_edges, "%", &input);
        }
        if let Some(folder) = self.pictures {
            picture::map(&folder.join(format!("warp_{scene}_{kind}.png")), SIZE, &warped.map)?;
        }
        Ok(())
    }

    fn speed(&mut self, scene: &str) -> Result<()> {
        let text = format!(
            "mode = \"batch\"\nplugins = [\"phantom\"]\n[nodes.scope]\ntype = \"phantom\"\nparams = {{ scene = \"{scene}\" }}\n"
        );
        let ports = [("scope", "left")];
        let plan = Plan { text: &text, frames: Some(FPS_TICKS), threads: 2, ports: &ports, ..Plan::default() };
        // The best of three: whatever else the machine does only takes away.
        let mut best = 0.0f64;
        for _ in 0..3 {
            let report = run::run(self.session, &plan)?.report;
            let node = report.nodes.get("scope").context("the phantom is not in the report")?;
            best = best.max(1000.0 / node.p50_ms.max(1e-3));
        }
        let name = if scene == "bowel" { "phantom_fps".to_owned() } else { format!("phantom_fps/{scene}") };
        self.add(name, best, "Hz", &format!("phantom {scene}, stereo 640x480 with noise, 2 threads, median tick"));
        Ok(())
    }

    /// The thesis's scope from 20 to 70 mm: the search beside one from 0 that knows of no offset.
    pub fn range(&mut self) -> Result<()> {
        for distance_mm in RANGE_MM {
            // What the geometry says of the farthest tissue.
            let expected_px = (FOCAL_PX * BASELINE_MM / (1.25 * distance_mm)) as i32;
            let scene = format!("scene = \"bowel\", distance_mm = {distance_mm:?}");
            let text = rectified("batch", &[], &phantom(&scene))
                + &format!(
                    r#"
[nodes.found]
type = "stereo_bm"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
params = {{ search_px = 256 }}
[nodes.told]
type = "stereo_bm"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
params = {{ auto_offset = false, search_px = 256, min_disparity_px = {expected_px} }}
[nodes.plain]
type = "stereo_bm"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
params = {{ auto_offset = false, search_px = 64 }}
"#
                );
            let ports = [
                ("found", "disparity"),
                ("plain", "disparity"),
                ("scope", "disparity"),
                ("scope", "visible"),
                ("scope", "depth"),
                ("told", "disparity"),
            ];
            let plan = Plan { text: &text, frames: Some(8), ports: &ports, ..Plan::default() };
            let seen = run::run(self.session, &plan)?;
            let map = |index: usize| -> Result<Vec<f32>> {
                let packet = seen.packets[index].as_ref().context("a node gave nothing")?;
                floats(packet).context("a map is cut off")
            };
            let (found, plain, truth, depth, expected_map) = (map(0)?, map(1)?, map(2)?, map(4)?, map(5)?);
            let visible = seen.packets[3].as_ref().context("the phantom gave nothing")?.bytes().to_vec();
            let plane = |data| View::new(data, SIZE.0, SIZE.1, 1);
            let mask = || Some(View::new(&visible[..], SIZE.0, SIZE.1, 1));
            let own = score_disparity(plane(&found), plane(&truth), mask())?;
            let expected = score_disparity(plane(&expected_map), plane(&truth), mask())?;
            let other = score_disparity(plane(&plain), plane(&truth), mask())?;
            let right = |score: &panoscope_imaging::stereo::DisparityScore| 100.0 * (1.0 - score.bad[1]);
            let input = format!("phantom bowel 640x480 at {distance_mm} mm, pixels that both cameras see, within 2 px");
            let name = format!("range_right/{distance_mm:.0}mm");
            let mut figure = Figure::new(&name, right(&own), "%", &input).beside("search 0..64", Some(right(&other)));
            figure.ratio = None;
            self.figures.push(figure);
            self.add(
                format!("range_right_told/{distance_mm:.0}mm"),
                right(&expected),
                "%",
                &format!("{input}, search from {expected_px} px"),
            );
            self.surface(distance_mm, &found, &depth, &visible)?;
        }
        Ok(())
    }

    /// Distance of the measured points from the true surface.
    fn surface(&mut self, distance_mm: f64, found: &[f32], depth: &[f32], visible: &[u8]) -> Result<()> {
        let (width, height) = SIZE;
        let camera =
            RectifiedCamera { focal_px: FOCAL_PX, cx: (width as f64 - 1.0) / 2.0, cy: (height as f64 - 1.0) / 2.0 };
        let eye = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let geometry = Rectification {
            width,
            height,
            rotation_left: eye,
            rotation_right: eye,
            left: camera,
            right: camera,
            baseline_mm: BASELINE_MM,
            valid_left: Rect::whole(width, height),
            valid_right: Rect::whole(width, height),
        };
        let points = points(&geometry, found)?;
        let measured: Vec<[f32; 3]> =
            points.iter().zip(visible).step_by(7).filter(|(_, seen)| **seen > 127).map(|(point, _)| *point).collect();
        let truth = |index: usize| -> [f32; 3] {
            let z = depth[index];
            let (x, y) = ((index % width) as f64 - camera.cx, (index / width) as f64 - camera.cy);
            [(x / FOCAL_PX) as f32 * z, (y / FOCAL_PX) as f32 * z, z]
        };
        let surface: Vec<[f32; 3]> = (0..width * height).map(truth).collect();
        let score = score_surface(&measured, &surface, REACH_MM)?;
        let input = format!("phantom bowel 640x480 at {distance_mm} mm, block matching, nearest true point");
        self.add(format!("surface_mm/phantom_{distance_mm:.0}mm"), score.median_mm, "mm", &input);
        self.add(format!("surface_p95_mm/phantom_{distance_mm:.0}mm"), score.p95_mm, "mm", &input);
        Ok(())
    }
}
