//! `find_board`: the points of a printed board in a picture.

use panoscope_data::calibration::Board;
use panoscope_node::{
    Context, Gray8, Image, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Slot, TableData, Validation,
};

use crate::calibrate::detect::Detector;
use crate::mats::{Threads, failed};

/// Columns of the table.
const COLUMNS: [&str; 5] = ["point", "x_mm", "y_mm", "u_px", "v_px"];

/// Parameters.
#[derive(Params, Clone, PartialEq)]
pub struct FindBoardParams {
    /// Printed pattern, named as for `calibrate_stereo`.
    #[param(default = "chessboard:9x6:25mm", reopen)]
    board: String,
}

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Picture of the board.
    image: Image<'f, Gray8>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// One row per point that was found: its number on the board, its position on the board in mm, and in the picture in px.
    table: Slot<'f, TableData>,
}

/// See the module.
pub struct FindBoard {
    detector: Detector,
    places_mm: Vec<[f64; 2]>,
    threads: Threads,
}

impl Node for FindBoard {
    const INFO: NodeInfo = NodeInfo::blocking(
        "find_board",
        "stereo",
        "Finds the points of a chessboard, circle grid or ChArUco board, such as to measure known lengths with a calibration.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = FindBoardParams;

    fn validate(params: &FindBoardParams, check: &mut Validation<'_>) {
        if let Err(error) = params.board.parse::<Board>() {
            check.error("board", error.to_string(), "");
        }
    }

    fn open(_: &Open<'_>, params: &FindBoardParams) -> Result<Self> {
        let board: Board = params.board.parse().map_err(|error| NodeError::new(format!("{error}")))?;
        let detector = Detector::new(&board, false).map_err(failed)?;
        Ok(Self { detector, places_mm: board.points_mm(), threads: Threads::hold()? })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, _: &FindBoardParams) -> Result<()> {
        self.threads.set(1)?;
        let found = self.detector.find(input.image.view()).map_err(failed)?;
        cx.metric("points", found.len() as f64);
        let mut rows = Vec::with_capacity(found.len() * COLUMNS.len());
        for (index, [u, v]) in found {
            if let Some([x, y]) = self.places_mm.get(index) {
                rows.extend([index as f64, *x, *y, f64::from(u), f64::from(v)]);
            }
        }
        out.table.set_table(&COLUMNS, &rows)
    }
}
