//! Pairs of the phantom, rendered once and played in a loop, so that timing includes no rendering. The files are
//! uncompressed, so that decoding does not slow down the first pass.

use std::path::{Path, PathBuf};

use toml::{Table, Value};

use crate::error::{Context, FileAction, OnFile, Result};
use crate::inputs::Folder;
use crate::packets;
use crate::run::{self, Plan};
use crate::session::Session;

/// Images and calibration of one rendered scene, in a separate folder.
pub struct Pairs {
    folder: PathBuf,
}

impl Pairs {
    /// Renders `count` pairs with the node `phantom` of a graph. Its inputs are removed, so that the cameras follow
    /// their script instead of the arm.
    pub fn render(session: &dyn Session, place: &Folder, name: &str, phantom: &Value, count: u64) -> Result<Self> {
        let folder = place.path().join(name);
        std::fs::create_dir_all(&folder).on_file(FileAction::Create, &folder)?;
        let mut phantom = phantom.clone();
        if let Some(node) = phantom.as_table_mut() {
            node.remove("inputs");
        }
        let mut nodes = Table::new();
        nodes.insert("scope".to_owned(), phantom);
        for side in ["left", "right"] {
            let path = folder.join(format!("{side}_{{seq:4}}.ppm"));
            let text = format!(
                "type = \"write_raw\"\ninputs = {{ image = \"scope.{side}\" }}\nparams = {{ path = {path:?} }}"
            );
            nodes.insert(side.to_owned(), Value::Table(text.parse()?));
        }
        let mut graph: Table = "mode = \"batch\"\nplugins = [\"phantom\", \"sinks\"]".parse()?;
        graph.insert("nodes".to_owned(), Value::Table(nodes));
        let seen = run::run(
            session,
            &Plan {
                text: &toml::to_string(&graph)?,
                path: Path::new("bench.toml"),
                frames: Some(count),
                ports: &[("scope", "calibration")],
                ..Plan::default()
            },
        )?;
        let packet = seen.packets.into_iter().next().flatten().context("the phantom returned no calibration")?;
        let calibration = packets::calibration(packet.bytes()).context("the phantom's calibration is truncated")?;
        panoscope_data::calibration::write(&folder.join("calibration.yaml"), &calibration)?;
        Ok(Self { folder })
    }

    /// Appends the pairs between the last and the first one in reverse order, so that a loop has no jump, at which a
    /// tracker would lose its instrument. `count` is the number of rendered pairs.
    pub fn and_back(self, count: u64) -> Result<Self> {
        for (step, from) in (1..count.saturating_sub(1)).rev().enumerate() {
            for side in ["left", "right"] {
                let file = |number: u64| self.folder.join(format!("{side}_{number:04}.ppm"));
                let (from, to) = (file(from), file(count + step as u64));
                // A second name costs no space; not every file system has them.
                std::fs::hard_link(&from, &to)
                    .or_else(|_| std::fs::copy(&from, &to).map(drop))
                    .on_file(FileAction::Create, &to)?;
            }
        }
        Ok(self)
    }

    /// As [`Pairs::render`], with the phantom's parameters as the content of a TOML inline table.
    pub fn of(session: &dyn Session, place: &Folder, name: &str, params: &str, count: u64) -> Result<Self> {
        let node: Table = format!("type = \"phantom\"\nparams = {{ {params} }}").parse()?;
        Self::render(session, place, name, &Value::Table(node), count)
    }

    /// Type and parameters of a node that plays them as a camera with `rate_hz` does (`pace` on), or as fast as they
    /// are processed (off).
    pub fn node(&self, pace: &str, rate_hz: u32) -> String {
        format!(
            "type = \"capture\"\nparams = {{ left = {:?}, right = {:?}, calibration = {:?}, loop = true, rate_hz = {rate_hz}.0, pace = {pace:?} }}\n",
            self.folder.join("left_*.ppm"),
            self.folder.join("right_*.ppm"),
            self.folder.join("calibration.yaml"),
        )
    }

    /// Path of the first left image.
    pub fn first(&self) -> PathBuf {
        self.folder.join("left_0000.ppm")
    }
}
