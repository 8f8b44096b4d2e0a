//! `panoscope eval calibrate`.

use std::path::PathBuf;

use panoscope_eval::eval::calibrate::{self, Options};

/// Arguments of `eval calibrate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Only these cases; may be given again. Without it all.
    #[arg(long, value_parser = calibrate::CASES)]
    case: Vec<String>,
    /// Folder of data sets, searched before the usual ones. May be given again.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    /// Folder for the pictures of each case.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

impl Arguments {
    /// What the library judges.
    pub fn options(&self) -> Options {
        let Self { case, data, pictures, .. } = self;
        Options { cases: case.clone(), data: data.clone(), pictures: pictures.clone() }
    }
}
