//! `write_cloud`: point clouds as PLY files.

use std::path::PathBuf;

use panoscope_node::abi::Calibration;
use panoscope_node::{Cloud, Context, Finish, NoPorts, Node, NodeInfo, Open, Params, Ports, Result, Validation, Value};

use crate::target::{Pattern, SinkError, Wholes, check_name, check_path, claim_files, make_folder};
use panoscope_data::formats::ply::{self, GradientLimit};

/// Input ports of `write_cloud`.
#[derive(Ports)]
pub struct In<'f> {
    /// Points in mm with colours. Unknown points are skipped; points that were filled in have the property `filled` 1.
    pub cloud: Cloud<'f>,
    /// Calibration of the rectified views, for the baseline. Without it 5 mm is assumed, the baseline of a narrow scope.
    pub calibration: Option<Value<'f, Calibration>>,
}

/// Parameters of `write_cloud`.
#[derive(Params)]
pub struct Settings {
    /// File to write, with the extension .ply. `{seq}` becomes the tick's number; without it each cloud replaces the previous one.
    #[param(default = "out/cloud.ply", reopen, writes)]
    pub path: PathBuf,
    /// Every n-th cloud is written.
    #[param(default = 1, range = 1..=100000, unit = "frames")]
    pub every: u64,
    /// Also writes the surface between neighbouring points as triangles.
    #[param(default = false)]
    pub mesh: bool,
    /// Maximum change of disparity per px of distance between neighbours of one surface; others are not connected.
    #[param(default = 1.5, range = 0.1..=100.0, step = 0.1, unit = "ratio")]
    pub max_gradient: f32,
}

/// Writes point clouds.
pub struct WriteCloud {
    pattern: Pattern,
    files: Wholes,
}

impl Node for WriteCloud {
    const INFO: NodeInfo =
        NodeInfo::blocking("write_cloud", "sink", "Writes point clouds as binary PLY files with colour.")
            .side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        check_path(check, &params.path, "{seq}.ply", "ply");
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        check_name(&params.path, "{seq}.ply", "ply")?;
        Ok(Self { pattern: Pattern::new(&claim_files(open, &params.path)?), files: Wholes::default() })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, params: &Settings) -> Result<()> {
        if !self.pattern.is_due(params.every) {
            return Ok(());
        }
        let path = self.pattern.file(cx.tick().seq, "cloud", false);
        make_folder(&path)?;
        let mut points = 0;
        let baseline_mm =
            input.calibration.as_ref().map_or(GradientLimit::USUAL_BASELINE_MM, |rig| rig.baseline_mm as f32);
        let limit = params.mesh.then_some(GradientLimit { max_gradient: params.max_gradient, baseline_mm });
        self.files.write(&path, |file| {
            points = ply::write(file, input.cloud.points(), input.cloud.width(), limit)
                .map_err(|error| SinkError::io(&path, error))?;
            Ok(())
        })?;
        cx.metric("points", points as f64);
        Ok(())
    }

    fn finish(&mut self, _: &Finish<'_>) -> Result<()> {
        Ok(self.files.finish()?)
    }
}
