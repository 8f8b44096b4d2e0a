//! `panoscope eval proximity`.

use std::path::PathBuf;

use panoscope_eval::eval::proximity::{self, Options};

/// Arguments of `eval proximity`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Sources of depth and instruments; repeatable. Default: all.
    #[arg(long, value_parser = proximity::CHAINS)]
    chain: Vec<String>,
    /// Scenes to run; repeatable. Default: both.
    #[arg(long, value_parser = proximity::SCENES)]
    scene: Vec<String>,
    /// Length of each run, s of media time.
    #[arg(long, default_value_t = proximity::Options::default().seconds, value_parser = clap::value_parser!(u32).range(1..=3600))]
    seconds: u32,
    /// Width of the phantom's images, px.
    #[arg(long, default_value_t = proximity::Options::default().width, value_parser = clap::value_parser!(u32).range(160..=1920))]
    width: u32,
    /// Mean distance of the tissue, mm: the nearer, the closer to it the instruments work.
    #[arg(long, default_value_t = proximity::Options::default().distance_mm)]
    distance_mm: f64,
    /// Seed of scenes and movements.
    #[arg(long, default_value_t = proximity::Options::default().seed)]
    seed: u64,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

impl Arguments {
    /// Options for the library.
    pub fn options(&self) -> Options {
        let Self { chain, scene, seconds, width, distance_mm, seed, .. } = self;
        Options {
            chains: chain.clone(),
            scenes: scene.clone(),
            seconds: *seconds,
            width: *width,
            distance_mm: *distance_mm,
            seed: *seed,
        }
    }
}
