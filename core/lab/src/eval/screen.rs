//! `panoscope eval screen`.

use std::path::PathBuf;

use panoscope_eval::eval::screen::Options;

use panoscope_cli::given::Given;

/// Arguments of `eval screen`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph with a `screen`.
    graph: PathBuf,
    /// Number of images.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    frames: u64,
    /// Folder for the screen of each image, as PNG.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Sets a parameter; overrides the file; repeatable.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    given: Given,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

impl Arguments {
    /// Options for the library.
    pub fn options(&self) -> Options {
        Options {
            graph: self.graph.clone(),
            given: self.given.options(&self.set),
            frames: self.frames,
            pictures: self.pictures.clone(),
        }
    }
}
