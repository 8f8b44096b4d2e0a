//! Lengths and depths measured on the phantom, compared with ground truth.

use std::path::Path;

use panoscope_engine::memory::FrameRef;
use panoscope_engine::text_table::table;

use crate::error::{Context, Result};
use crate::figures::Figure;
use crate::inputs::scene;
use crate::packets::{Table, floats};
use crate::plot::{self, Chart, Series, Style};
use crate::run::{self, Plan};
use crate::session::Session;
use crate::statistics::percentile;

/// Size of the phantom's images, px.
pub const SIZE: (usize, usize) = (640, 480);
/// Focal length of the phantom's cameras, px.
pub const FOCAL_PX: f64 = 750.0;
/// Distance between the phantom's cameras, mm.
pub const BASELINE_MM: f64 = 15.0;
/// Distances of the tissue, mm.
pub const DISTANCES_MM: [f64; 5] = [30.0, 40.0, 50.0, 60.0, 70.0];

/// Pairs of pixels whose distance is measured, all inside the overlap of both views.
pub(crate) fn points(distance_mm: f64) -> Vec<[f64; 2]> {
    // The nearest tissue has the largest disparity.
    let from = (FOCAL_PX * BASELINE_MM / (distance_mm * 0.86) + 24.0).min(560.0);
    let at = |i: usize, j: usize| [(from + (616.0 - from) * i as f64 / 2.0).round(), 48.0 + 128.0 * j as f64];
    (0..3).flat_map(|i| (0..4).map(move |j| (i, j))).map(|(i, j)| at(i, j)).collect()
}

pub(crate) fn graph(tissue: &str, distance_mm: f64, points: &[[f64; 2]]) -> String {
    let mut pairs = Vec::new();
    for (index, a) in points.iter().enumerate() {
        for b in &points[index + 1..] {
            pairs.extend([a[0], a[1], b[0], b[1]]);
        }
    }
    let single: Vec<f64> = points.iter().flatten().copied().collect();
    let scope = format!("scene = \"{tissue}\", distance_mm = {distance_mm:?}");
    scene::depth("batch", &scene::phantom(&scope))
        + &format!(
            r#"
[nodes.bm]
type = "stereo_bm"
inputs = {{ left = "depth.left", right = "depth.right" }}
params = {{ uniqueness = 5 }}
[nodes.bm_wls]
type = "disparity_wls"
inputs = {{ image = "depth.left", disparity = "bm.disparity", disparity_right = "bm.disparity_right" }}
[nodes.bm_wls_fbs]
type = "disparity_fbs"
inputs = {{ image = "depth.left", disparity = "bm_wls.disparity", confidence = "bm_wls.confidence" }}
[nodes.lengths]
type = "measure"
inputs = {{ cloud = "depth.cloud", calibration = "depth.calibration", confidence = "depth.confidence" }}
params = {{ points = {pairs:?} }}
[nodes.depths]
type = "measure"
inputs = {{ cloud = "depth.cloud", calibration = "depth.calibration", confidence = "depth.confidence" }}
params = {{ kind = "depth", points = {single:?} }}
"#
        )
}

/// A measured length or depth with its true value.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Distance of the tissue, mm.
    pub distance_mm: f64,
    /// Letters of the measured points.
    pub points: String,
    /// True value, mm.
    pub true_mm: f64,
    /// Measured value, mm.
    pub found_mm: f64,
    /// Error estimate of the measurement, mm.
    pub stated_mm: f64,
}

impl Measured {
    /// Difference from the true value, mm.
    pub fn off_mm(&self) -> f64 {
        (self.found_mm - self.true_mm).abs()
    }
}

/// All lengths and depths measured on the phantom (thesis, figs 3.14 and 3.15).
#[derive(Clone, Debug, Default)]
pub struct Ruler {
    /// Lengths between all pairs of points.
    pub lengths: Vec<Measured>,
    /// Depth of each point.
    pub depths: Vec<Measured>,
}

fn letter(index: usize) -> char {
    char::from(b'A' + (index % 26) as u8)
}

impl Ruler {
    /// Measures lengths and depths on the rendered bowel at all distances.
    pub fn measure(session: &dyn Session) -> Result<Self> {
        let mut ruler = Self::default();
        for distance_mm in DISTANCES_MM {
            let points = points(distance_mm);
            let text = graph("bowel", distance_mm, &points);
            let ports = [("scope", "depth"), ("lengths", "table"), ("depths", "table")];
            let seen = run::run(session, &plan(&text, &ports))?;
            let packet =
                |i: usize| seen.packets[i].as_ref().with_context(|| format!("{:?} returned no packet", ports[i]));
            let depth = floats(packet(0)?).context("a map is truncated")?;
            ruler.add(distance_mm, &points, &depth, packet(1)?, packet(2)?)?;
        }
        Ok(ruler)
    }

    pub(crate) fn add(
        &mut self,
        distance_mm: f64,
        points: &[[f64; 2]],
        depth: &[f32],
        lengths: &FrameRef,
        depths: &FrameRef,
    ) -> Result<()> {
        let place = |[u, v]: [f64; 2]| -> [f64; 3] {
            let z = f64::from(depth[v as usize * SIZE.0 + u as usize]);
            // The phantom's principal point is the picture's middle; see `PhantomNode`.
            let (cx, cy) = ((SIZE.0 as f64 - 1.0) / 2.0, (SIZE.1 as f64 - 1.0) / 2.0);
            [(u - cx) / FOCAL_PX * z, (v - cy) / FOCAL_PX * z, z]
        };
        let name = |at: [f64; 2]| points.iter().position(|p| *p == at).map_or('?', letter);
        for row in &Table::read(lengths.bytes()).context("the table is truncated")?.rows {
            let [u0, v0, u1, v1, found_mm, stated_mm] = row[..] else { continue };
            let (a, b) = (place([u0, v0]), place([u1, v1]));
            let true_mm = (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
            if found_mm.is_finite() {
                let points = [name([u0, v0]), name([u1, v1])].iter().collect();
                self.lengths.push(Measured { distance_mm, points, true_mm, found_mm, stated_mm });
            }
        }
        for row in &Table::read(depths.bytes()).context("the table is truncated")?.rows {
            let [u, v, found_mm, stated_mm] = row[..] else { continue };
            if found_mm.is_finite() {
                let (points, true_mm) = (name([u, v]).to_string(), place([u, v])[2]);
                self.depths.push(Measured { distance_mm, points, true_mm, found_mm, stated_mm });
            }
        }
        Ok(())
    }

    /// Errors as figures.
    pub fn figures(&self) -> Vec<Figure> {
        let mut out = Vec::new();
        if self.lengths.is_empty() {
            return out;
        }
        let input = "phantom bowel 640x480, 30 to 70 mm, the depth preset, points inside the overlap";
        let mut add = |name: &str, value: f64, unit| out.push(Figure::new(name, value, unit, input));
        let within = |all: &[Measured]| {
            100.0 * all.iter().filter(|m| m.off_mm() <= m.stated_mm).count() as f64 / all.len().max(1) as f64
        };
        let percent: Vec<f64> = self.lengths.iter().map(|m| 100.0 * m.off_mm() / m.true_mm).collect();
        add("length_error_pct/mean", percent.iter().sum::<f64>() / percent.len() as f64, "%");
        add("length_error_pct/worst", percent.iter().copied().fold(0.0, f64::max), "%");
        add("length_within_stated", within(&self.lengths), "%");
        add("lengths", self.lengths.len() as f64, "1");
        for distance_mm in DISTANCES_MM {
            let here = self.depths.iter().filter(|m| m.distance_mm == distance_mm);
            add(
                &format!("point_depth_error_mm/{distance_mm:.0}"),
                percentile(&here.map(Measured::off_mm).collect::<Vec<_>>(), 0.5),
                "mm",
            );
        }
        add("point_depth_within_stated", within(&self.depths), "%");
        out
    }

    /// Tables of lengths from the first point and of depths, at one distance.
    pub fn tables(&self, distance_mm: f64) -> String {
        let rows = |all: &[Measured], head: &str, wanted: &dyn Fn(&Measured) -> bool| {
            let mut rows =
                vec![[head, "true mm", "measured mm", "stated +-", "error mm", "error %"].map(str::to_owned).to_vec()];
            for m in all.iter().filter(|m| m.distance_mm == distance_mm && wanted(m)) {
                let off = m.found_mm - m.true_mm;
                let mm = |v: f64| format!("{v:.2}");
                let percent = format!("{:.2}", 100.0 * off.abs() / m.true_mm);
                rows.push(vec![m.points.clone(), mm(m.true_mm), mm(m.found_mm), mm(m.stated_mm), mm(off), percent]);
            }
            table(&rows)
        };
        let lengths = rows(&self.lengths, &format!("length at {distance_mm:.0} mm"), &|m| m.points.starts_with('A'));
        lengths + "\n" + &rows(&self.depths, "depth of", &|_| true)
    }

    /// Plots measured over true values, and errors with their estimates.
    pub fn plot(&self, path: &Path) -> Result<()> {
        let pair = |title: &str, all: &[Measured]| {
            let sides = all.iter().map(|m| (m.true_mm, m.true_mm)).collect();
            let line = Series::new("true", Style::Line, 2, sides);
            let bars =
                all.iter().flat_map(|m| [(m.true_mm, m.found_mm - m.stated_mm), (m.true_mm, m.found_mm + m.stated_mm)]);
            let dots = all.iter().map(|m| (m.true_mm, m.found_mm)).collect();
            let values = Chart {
                title: format!("{title}: measured against true"),
                x_label: "true, mm".to_owned(),
                y_label: "measured, mm".to_owned(),
                series: vec![
                    line,
                    Series::new("", Style::Bars, 0, bars.collect()),
                    Series::new("measured, with its stated error", Style::Dots, 0, dots),
                ],
                ..Chart::default()
            };
            let errors = all.iter().map(|m| (m.true_mm, m.found_mm - m.true_mm)).collect();
            let stated = |sign: f64| all.iter().map(|m| (m.true_mm, sign * m.stated_mm)).collect::<Vec<_>>();
            let off = Chart {
                title: format!("{title}: error"),
                x_label: "true, mm".to_owned(),
                y_label: "measured - true, mm".to_owned(),
                series: vec![
                    Series::new("stated", Style::Dots, 1, [stated(1.0), stated(-1.0)].concat()),
                    Series::new("true error", Style::Dots, 0, errors),
                ],
                from_zero: true,
                ..Chart::default()
            };
            [values, off]
        };
        let charts = [pair("Lengths", &self.lengths), pair("Depths", &self.depths)].concat();
        plot::save(path, &charts)
    }
}

pub(crate) fn plan<'a>(text: &'a str, ports: &'a [(&'a str, &'a str)]) -> Plan<'a> {
    Plan { text, frames: Some(5), ports, ..Plan::default() }
}
