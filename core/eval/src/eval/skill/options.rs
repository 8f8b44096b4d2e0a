//! Options of a report of skill.

use std::path::PathBuf;

use panoscope_arm_core::tracking::skill::Settings;

/// Substrings of names of tools that can grasp.
pub const GRASPING: &str = "grasper,bipolar,clipper,forceps,needle";

/// Options of [`judge`](super::judge) and [`SkillStudy::read`](super::SkillStudy::read).
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Tracks of tips, best one per hand: tables of `tip_track` (or `proximity`, which reports touches too), or tips,
    /// written by `write_table` (.csv, .jsonl). Without files, the measures are compared with motions known in closed
    /// form.
    #[arg(value_name = "TRACK")]
    pub files: Vec<PathBuf>,
    /// Phases of the operation, one per line: start in s of capture time, comma, name. By default the column `phase` or
    /// `text` of the tracks.
    #[arg(long, value_name = "FILE.csv")]
    pub phases: Option<PathBuf>,
    /// Names of the classes by their numbers, separated by commas.
    #[arg(long, default_value = "")]
    pub labels: String,
    /// Words in the names of tools that grasp, separated by commas: only their touches are counted as grasps.
    #[arg(long, default_value = GRASPING)]
    pub grasping: String,
    /// Speed below which a tool rests, mm/s.
    #[arg(long, default_value_t = Self::default().rest_mm_s)]
    pub rest_mm_s: f64,
    /// Maximum time between two tips that is bridged, ms.
    #[arg(long, default_value_t = Self::default().max_gap_ms)]
    pub max_gap_ms: f64,
}

impl Default for Options {
    fn default() -> Self {
        let settings = Settings::default();
        Self {
            files: Vec::new(),
            phases: None,
            labels: String::new(),
            grasping: GRASPING.to_owned(),
            rest_mm_s: settings.rest_mm_s,
            max_gap_ms: 1e3 * settings.max_gap_s,
        }
    }
}

impl Options {
    pub(super) fn settings(&self) -> Settings {
        Settings { rest_mm_s: self.rest_mm_s, max_gap_s: self.max_gap_ms * 1e-3, ..Settings::default() }
    }
}
