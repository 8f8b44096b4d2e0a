//! The phantom: through the real nodes in a graph, beside its exact truth.

use std::path::Path;

use anyhow::{Context, Result};
use panoscope_runtime::memory::FrameRef;

use super::super::look::{self, Plan, Table};
use super::{Judge, Truth};

pub const SIZE: (usize, usize) = (640, 480);
pub const FOCAL_PX: f64 = 750.0;
pub const BASELINE_MM: f64 = 15.0;
/// Distances of the tissue, mm.
const DISTANCES_MM: [f64; 5] = [30.0, 40.0, 50.0, 60.0, 70.0];
const CHAINS: [(&str, &str); 5] = [
    ("bm", "bm.disparity"),
    ("bm_wls", "bm_wls.disparity"),
    ("bm_wls_fbs", "bm_wls_fbs.disparity"),
    ("sgbm", "sgbm.disparity"),
    ("sgbm_wls", "sgbm_wls.disparity"),
];

/// Pairs of pixels whose distance is measured, all inside what both views share.
fn points(distance_mm: f64) -> Vec<[f64; 2]> {
    // The nearest tissue has the largest disparity.
    let from = (FOCAL_PX * BASELINE_MM / (distance_mm * 0.86) + 24.0).min(560.0);
    let at = |i: usize, j: usize| [(from + (616.0 - from) * i as f64 / 2.0).round(), 48.0 + 128.0 * j as f64];
    (0..3).flat_map(|i| (0..4).map(move |j| (i, j))).map(|(i, j)| at(i, j)).collect()
}

fn graph(scene: &str, distance_mm: f64, points: &[[f64; 2]]) -> String {
    let mut pairs = Vec::new();
    for (index, a) in points.iter().enumerate() {
        for b in &points[index + 1..] {
            pairs.extend([a[0], a[1], b[0], b[1]]);
        }
    }
    format!(
        r#"
mode = "batch"
plugins = ["phantom", "stereo"]
[nodes.scope]
type = "phantom"
params = {{ scene = "{scene}", distance_mm = {distance_mm:?} }}
[nodes.rectify]
type = "rectify"
inputs = {{ left = "scope.left", right = "scope.right", calibration = "scope.calibration" }}
[nodes.bm]
type = "stereo_bm"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
[nodes.bm_wls]
type = "disparity_wls"
inputs = {{ image = "rectify.left", disparity = "bm.disparity", disparity_right = "bm.disparity_right" }}
[nodes.bm_wls_fbs]
type = "disparity_fbs"
inputs = {{ image = "rectify.left", disparity = "bm_wls.disparity", confidence = "bm_wls.confidence" }}
[nodes.sgbm]
type = "stereo_sgbm"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
[nodes.sgbm_wls]
type = "disparity_wls"
inputs = {{ image = "rectify.left", disparity = "sgbm.disparity", disparity_right = "sgbm.disparity_right" }}
params = {{ scatter_radius_px = 3, lambda = 100.0 }}
[nodes.points]
type = "reproject"
inputs = {{ image = "rectify.left", disparity = "sgbm_wls.disparity", confidence = "sgbm_wls.confidence", calibration = "rectify.calibration" }}
[nodes.lengths]
type = "measure"
inputs = {{ cloud = "points.cloud", calibration = "rectify.calibration" }}
params = {{ points = {pairs:?} }}
"#
    )
}

pub fn floats(frame: &FrameRef) -> Option<Vec<f32>> {
    let (described, bytes) = (frame.frame(), frame.bytes());
    let (width, height) = (described.width as usize, described.height as usize);
    let stride = described.stride_bytes as usize;
    let mut out = Vec::with_capacity(width * height);
    for y in 0..height {
        let row = bytes.get(y * stride..y * stride + 4 * width)?;
        out.extend(row.as_chunks::<4>().0.iter().map(|value| f32::from_ne_bytes(*value)));
    }
    Some(out)
}

impl Judge<'_> {
    pub(super) fn phantom(&mut self) -> Result<()> {
        let (mut lengths, mut within, mut measured) = (Vec::new(), 0usize, 0usize);
        for distance_mm in DISTANCES_MM {
            self.scene("bowel", distance_mm, &mut lengths, &mut within, &mut measured)?;
        }
        if lengths.is_empty() {
            return Ok(());
        }
        let input = "phantom bowel 640x480, 30 to 70 mm, sgbm_wls";
        let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
        self.add("length_error_pct/mean".into(), mean, "%", input);
        self.add("length_error_pct/worst".into(), lengths.iter().copied().fold(0.0, f64::max), "%", input);
        self.add("length_within_stated".into(), 100.0 * within as f64 / measured as f64, "%", input);
        self.add("lengths".into(), measured as f64, "1", input);
        Ok(())
    }

    fn scene(
        &mut self,
        scene: &str,
        distance_mm: f64,
        lengths: &mut Vec<f64>,
        within: &mut usize,
        measured: &mut usize,
    ) -> Result<()> {
        let text = graph(scene, distance_mm, &points(distance_mm));
        let mut ports = vec![
            ("scope", "disparity"),
            ("scope", "depth"),
            ("scope", "visible"),
            ("points", "depth"),
            ("lengths", "table"),
        ];
        ports.extend(CHAINS.iter().map(|(chain, _)| (*chain, "disparity")));
        let plan = Plan {
            text: &text,
            path: Path::new("eval.toml"),
            frames: Some(5),
            threads: 0,
            ports: &ports,
            paced: false,
        };
        let seen = look::run(&plan)?;
        let packet =
            |index: usize| seen.packets[index].as_ref().with_context(|| format!("{:?} gave nothing", ports[index]));
        let map = |index: usize| floats(packet(index)?).context("a map is cut off");
        let (disparity, depth) = (map(0)?, map(1)?);
        let visible = packet(2)?.bytes().to_vec();
        let case = format!("phantom_{distance_mm:.0}mm");
        let input = format!("phantom {scene} 640x480 at {distance_mm} mm, where both cameras see");
        let truth = Truth { disparity, mask: Some(visible) };
        for (index, (chain, _)) in CHAINS.iter().enumerate() {
            self.against(&case, chain, SIZE, &map(5 + index)?, &truth, &input)?;
        }
        let found = map(3)?;
        let mut errors: Vec<f32> =
            found.iter().zip(&depth).map(|(a, b)| (a - b).abs()).filter(|error| error.is_finite()).collect();
        errors.sort_by(f32::total_cmp);
        if let Some(middle) = errors.get(errors.len() / 2) {
            self.add(format!("depth_error_mm/{distance_mm:.0}"), f64::from(*middle), "mm", &input);
            self.add(
                format!("depth_error_p95_mm/{distance_mm:.0}"),
                f64::from(errors[errors.len() * 95 / 100]),
                "mm",
                &input,
            );
        }

        let place = |u: f64, v: f64| -> [f64; 3] {
            let z = f64::from(depth[v as usize * SIZE.0 + u as usize]);
            // The phantom's principal point is the picture's middle; see `PhantomNode`.
            let (cx, cy) = ((SIZE.0 as f64 - 1.0) / 2.0, (SIZE.1 as f64 - 1.0) / 2.0);
            [(u - cx) / FOCAL_PX * z, (v - cy) / FOCAL_PX * z, z]
        };
        let table = Table::read(packet(4)?.bytes()).context("the table is cut off")?;
        for row in &table.rows {
            let [u0, v0, u1, v1, length_mm, error_mm] = row[..] else { continue };
            if length_mm.is_nan() {
                continue;
            }
            let (a, b) = (place(u0, v0), place(u1, v1));
            let true_mm = (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
            let off_mm = (length_mm - true_mm).abs();
            *measured += 1;
            *within += usize::from(off_mm <= error_mm);
            lengths.push(100.0 * off_mm / true_mm);
        }
        Ok(())
    }
}
