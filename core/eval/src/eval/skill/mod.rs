//! A report of surgical skill from tracks of tips, and the measures compared with motions known in closed form.

mod options;
mod page;
mod study;
mod trace;
mod tracks;

use panoscope_arm_core::tracking::skill::motions::{self, Timing};

use crate::error::{Context, Result};
use crate::figures::Figure;

pub use options::{GRASPING, Options};
pub use page::page;
pub use study::SkillStudy;

/// Compares the measures with motions known in closed form, sampled evenly, unevenly, and with lost images.
pub fn judge(options: &Options) -> Result<Vec<Figure>> {
    let settings = options.settings();
    let mut figures = Vec::new();
    let mut worst: f64 = 0.0;
    for motion in motions::all(&settings) {
        let runs = Timing::ALL.map(|timing| motions::check(&motion, timing, &settings));
        for (index, (measure, known)) in motion.known.iter().enumerate() {
            let of = runs.iter().map(|run| run[index]);
            let far = of.max_by(|a, b| a.error().total_cmp(&b.error())).context("no timing")?;
            worst = worst.max(100.0 * far.error());
            let input = "motion in closed form at 30 Hz: even times, uneven times, every seventh picture lost; the worst of the three";
            let mut figure = Figure::new(&format!("{measure}/{}", motion.name), far.measured, "", input);
            (figure.peer, figure.peer_value) = (Some("closed form".to_owned()), Some(*known));
            figures.push(figure);
        }
    }
    let input = "of all measures of all motions at all timings; of a known zero the value itself";
    figures.push(Figure::new("worst_error_pct", worst, "%", input));
    Ok(figures)
}
