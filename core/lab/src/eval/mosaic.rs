//! `panoscope eval mosaic`.

use std::path::PathBuf;

use panoscope_eval::eval::mosaic::{self, Options};

/// Arguments of `eval mosaic`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Scenes to run; repeatable. Default: all.
    #[arg(long, value_parser = mosaic::SCENES)]
    scene: Vec<String>,
    /// Model of the maps between keyframes.
    #[arg(long, default_value_t = mosaic::Options::default().model, value_parser = ["homography", "affine", "similarity"])]
    model: String,
    /// Laps of the path; drift is measured over the last one.
    #[arg(long, default_value_t = mosaic::Options::default().laps, value_parser = clap::value_parser!(u32).range(1..=20))]
    laps: u32,
    /// Diameter of the path, mm.
    #[arg(long, default_value_t = mosaic::Options::default().path_mm)]
    path_mm: f64,
    /// Speed of the camera, mm/s.
    #[arg(long, default_value_t = mosaic::Options::default().speed_mm_s)]
    speed_mm_s: f64,
    /// Mean distance of the tissue, mm.
    #[arg(long, default_value_t = mosaic::Options::default().distance_mm)]
    distance_mm: f64,
    /// Width of the camera's images, px.
    #[arg(long, default_value_t = mosaic::Options::default().width, value_parser = clap::value_parser!(u32).range(160..=1920))]
    width: u32,
    /// Seed of the scenes.
    #[arg(long, default_value_t = mosaic::Options::default().seed)]
    seed: u64,
    /// Folder for the mosaics.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Draws drift over time, a chart per scene.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

impl Arguments {
    /// Options for the library.
    pub fn options(&self) -> Options {
        let Self { scene, model, laps, path_mm, speed_mm_s, distance_mm, width, seed, pictures, plot, .. } = self;
        Options {
            scenes: scene.clone(),
            model: model.clone(),
            laps: *laps,
            path_mm: *path_mm,
            speed_mm_s: *speed_mm_s,
            distance_mm: *distance_mm,
            width: *width,
            seed: *seed,
            pictures: pictures.clone(),
            plot: plot.clone(),
        }
    }
}
