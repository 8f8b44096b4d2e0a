//! `panoscope eval surf`.

use std::path::PathBuf;

use panoscope_eval::eval::surf::Options;

/// Arguments of `eval surf`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Folder with graf1.png, graf3.png and H1to3p.xml, when Debian's opencv-doc is not installed.
    #[arg(long, value_name = "FOLDER")]
    data: Option<PathBuf>,
    /// Sets a parameter of `features_surf`, to see its effect; repeatable.
    #[arg(long, value_name = "PARAM=VALUE")]
    set: Vec<String>,
}

impl Arguments {
    /// Options for the library.
    pub fn options(&self) -> Options {
        let Self { data, set, .. } = self;
        Options { data: data.clone(), settings: set.clone() }
    }
}
