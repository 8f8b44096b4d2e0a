//! `panoscope eval calibrate`.

use std::path::PathBuf;

use panoscope_data::calibration::Board;
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
    /// Left images of your own pairs of a board for `held_out` (a folder or a pattern).
    #[arg(long, value_name = "IMAGES", requires_all = ["right", "board"])]
    left: Option<String>,
    /// Right images of these pairs.
    #[arg(long, value_name = "IMAGES", requires = "left")]
    right: Option<String>,
    /// Their printed board, such as chessboard:9x6:25mm.
    #[arg(long, requires = "left")]
    board: Option<Board>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

impl Arguments {
    /// Options for the library.
    pub fn options(&self) -> Options {
        let Self { case, data, pictures, .. } = self;
        let own = self.left.clone().zip(self.right.clone()).zip(self.board);
        let own = own.map(|((left, right), board)| (left, right, board));
        Options { cases: case.clone(), data: data.clone(), pictures: pictures.clone(), own }
    }
}
