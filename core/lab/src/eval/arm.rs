//! `panoscope eval arm`.

use std::path::PathBuf;

use panoscope_eval::eval::arm::{self, Options};

/// Arguments of `eval arm`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Parts to run; repeatable. Default: all.
    #[arg(long, value_parser = arm::PARTS)]
    part: Vec<String>,
    /// Scenarios to run; repeatable. Default: all.
    #[arg(long)]
    scenario: Vec<String>,
    /// Length of each run, s of media time.
    #[arg(long, default_value_t = arm::Options::default().seconds, value_parser = clap::value_parser!(u32).range(8..=3600))]
    seconds: u32,
    /// Width of the phantom's images in the graph's runs, px.
    #[arg(long, default_value_t = arm::Options::default().width, value_parser = clap::value_parser!(u32).range(64..=1920))]
    width: u32,
    /// Inputs of the campaign against the limits.
    #[arg(long, default_value_t = arm::Options::default().hostile_inputs)]
    cases: u64,
    /// Seed of strokes and campaign.
    #[arg(long, default_value_t = arm::Options::default().seed)]
    seed: u64,
    /// Folder for the plots of each scenario.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

impl Arguments {
    /// Options for the library.
    pub fn options(&self) -> Options {
        let Self { part, scenario, seconds, width, cases, seed, pictures, .. } = self;
        Options {
            parts: part.clone(),
            scenarios: scenario.clone(),
            seconds: *seconds,
            width: *width,
            hostile_inputs: *cases,
            seed: *seed,
            pictures: pictures.clone(),
        }
    }
}
