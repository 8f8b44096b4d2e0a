//! `panoscope eval calibrate`.

use std::path::PathBuf;

use panoscope_eval::eval::calibrate::{self, Options};

/// Arguments of `eval calibrate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Cases to run; repeatable. Default: all.
    #[arg(long, value_parser = calibrate::CASES)]
    case: Vec<String>,
    /// Folder of data sets, searched before the default ones; repeatable.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    /// Folder for the images of each case.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

impl Arguments {
    /// Options for the library.
    pub fn options(&self) -> Options {
        let Self { case, data, pictures, .. } = self;
        Options { cases: case.clone(), data: data.clone(), pictures: pictures.clone() }
    }
}
