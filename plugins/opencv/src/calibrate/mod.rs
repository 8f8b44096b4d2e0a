//! `calibrate_stereo`: gathers views of a printed board and solves for both cameras.
//!
//! A view takes part when the board is found in both pictures, stands elsewhere than in the views before, and is explained
//! by the solution as well as the others are: a view whose error is an outlier is excluded and the rest is solved again.

pub mod detect;
mod draw;
mod fisheye;
mod grid;
mod neighbours;
mod order;
mod part;
mod solution;
mod solve;

use panoscope_data::calibration::{Board, ViewState, packet};
use panoscope_node::abi::Calibration;
use panoscope_node::{
    Bgr8, Choice, Context, Gray8, Image, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Slot, TableData,
    Validation, View,
};

use crate::mats::{Threads, failed};
use detect::{Detector, Seen, same_order};
use grid::Points;
use neighbours::keep_fitting;
use part::Part;
use solution::{Pair, Solution};
use solve::{Model, Procedure, solve};

/// Fewest common points of a usable view.
const MIN_POINTS: usize = 8;
/// A view is an outlier when its error is this many times the median of all views.
const STANDS_OUT: f64 = 3.0;
/// Views with a smaller error are never outliers, px.
const FINE_PX: f64 = 0.3;
/// Columns of the table.
const COLUMNS: [&str; 9] = [
    "view",
    "state",
    "points",
    "error_left_px",
    "error_right_px",
    "epipolar_px",
    "area_left_pct",
    "area_right_pct",
    "solved",
];

/// Procedure of the calibration.
#[derive(Choice, Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Each camera, then both together, without outliers.
    Own,
    /// All views, with the steps and flags of OpenCV's sample `stereo_calib`, for comparison.
    Sample,
}

/// Parameters.
#[derive(Params, Clone, PartialEq)]
pub struct CalibrateParams {
    /// Printed pattern: chessboard:9x6:25mm (inner corners), circles:4x11:20mm (asymmetric grid), circle_grid:7x6:10mm,
    /// or charuco:19x26:5mm:4mm:4x4_250 (squares, their side, the markers' side, dictionary).
    #[param(default = "chessboard:9x6:25mm", reopen)]
    board: String,
    /// Model of the distortion.
    #[param(default = "auto", reopen)]
    model: Model,
    /// Procedure of the calibration.
    #[param(default = "own", reopen)]
    method: Method,
    /// Number of ticks after which the calibration is solved once; 0 solves after each accepted view.
    #[param(default = 0, range = 0..=100_000, unit = "frames", reopen)]
    solve_at: u64,
    /// Smallest number of views to solve with.
    #[param(default = 5, range = 3..=100, unit = "frames")]
    min_views: usize,
    /// Largest number of views.
    #[param(default = 60, range = 3..=1000, unit = "frames")]
    max_views: usize,
    /// Smallest mean movement of the points since every earlier view, as a share of the picture's diagonal.
    #[param(default = 0.0, range = 0.0..=0.5, step = 0.005, unit = "ratio")]
    min_move: f64,
    /// Skips views whose error is an outlier.
    #[param(default = true)]
    reject: bool,
}

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view, not rectified.
    left: Image<'f, Gray8>,
    /// Right view of the same instant, same size.
    right: Image<'f, Gray8>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// Calibration with rectification, in each tick in which it was solved.
    calibration: Slot<'f, Calibration>,
    /// One row per view: its number from 0, its state (0 used, otherwise the reason), number of points, errors in px, and the share of each picture
    /// that the board fills.
    table: Slot<'f, TableData>,
    /// Both views side by side with the detected points.
    image: Slot<'f, Bgr8>,
    /// Coverage of each view by points, in each tick in which the calibration was solved.
    coverage: Slot<'f, Bgr8>,
    /// The rectified pair with the largest board, with lines along the rows, in each tick in which the calibration was solved.
    epipolar: Slot<'f, Bgr8>,
}

/// One pair of views.
struct BoardView {
    state: ViewState,
    pair: Pair,
    /// Share of each picture that the board's box fills.
    area: [f64; 2],
    /// Of a view that is seen in part: what each picture shows.
    parts: Option<[Part; 2]>,
}

/// See the module.
pub struct CalibrateStereo {
    board: Board,
    places_mm: Vec<[f64; 2]>,
    detector: Detector,
    procedure: Procedure,
    /// What `auto` has chosen, and from how many views.
    chosen: Option<(usize, Model)>,
    seen: Vec<BoardView>,
    size: Option<(usize, usize)>,
    /// Index and pictures of the view with the largest board.
    largest: Option<(usize, [Vec<u8>; 2])>,
    solution: Option<(Vec<usize>, Solution)>,
    threads: Threads,
}

impl Node for CalibrateStereo {
    const INFO: NodeInfo = NodeInfo::blocking(
        "calibrate_stereo",
        "stereo",
        "Gathers views of a chessboard, circle grid or ChArUco board and solves for both cameras.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = CalibrateParams;

    fn validate(params: &CalibrateParams, check: &mut Validation<'_>) {
        if let Err(error) = params.board.parse::<Board>() {
            check.error("board", error.to_string(), "");
        }
        let need = params.min_views;
        if params.max_views < need {
            let message = format!("`max_views` is {}, below `min_views`, which is {need}", params.max_views);
            check.error("max_views", message, "it would never be solved: raise `max_views` or lower `min_views`");
        }
        if params.solve_at > 0 && params.solve_at < need as u64 {
            let message = format!("`solve_at` is {}, before {need} views (`min_views`) can have come", params.solve_at);
            check.error("solve_at", message, "it would never be solved: raise `solve_at` or lower `min_views`");
        }
    }

    fn open(_: &Open<'_>, params: &CalibrateParams) -> Result<Self> {
        let board: Board = params.board.parse().map_err(|error| NodeError::new(format!("{error}")))?;
        let (procedure, is_sample) = match params.method {
            Method::Own => (Procedure::Own(params.model), false),
            Method::Sample => (Procedure::Sample, true),
        };
        let detector = Detector::new(&board, is_sample).map_err(failed)?;
        let places_mm = board.points_mm();
        let threads = Threads::hold()?;
        Ok(Self {
            board,
            places_mm,
            detector,
            procedure,
            chosen: None,
            seen: Vec::new(),
            size: None,
            largest: None,
            solution: None,
            threads,
        })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &CalibrateParams,
    ) -> Result<()> {
        let views = [input.left.view(), input.right.view()];
        self.threads.set(1)?;
        let found = self.look(cx, views, params)?;
        if out.image.is_read() && views[0].height == views[1].height && views[0].width == views[1].width {
            let mut image = out.image.alloc(2 * views[0].width, views[0].height)?;
            draw::corners(views, [&found[0], &found[1]], self.places_mm.len(), &mut image);
        }
        let ticks = self.seen.len() as u64;
        let is_due = if params.solve_at > 0 {
            ticks == params.solve_at
        } else {
            self.seen.last().is_some_and(|seen| seen.state == ViewState::Used)
        };
        let solved = is_due && self.solve(cx, params);
        if solved {
            self.show(cx, &mut out)?;
        }
        if out.table.is_read() {
            out.table.set_table(&COLUMNS, &self.rows())?;
        }
        Ok(())
    }
}

impl CalibrateStereo {
    /// Finds the board in both views; keeps the common points.
    fn look(&mut self, cx: &Context<'_>, views: [View<'_, u8>; 2], params: &CalibrateParams) -> Result<[Points; 2]> {
        let size = (views[0].width, views[0].height);
        let is_other_size = (views[1].width, views[1].height) != size || self.size.is_some_and(|known| known != size);
        let mut found = [Points::new(), Points::new()];
        let mut parts = None;
        let mut pair = Pair { board_mm: Vec::new(), px: [Vec::new(), Vec::new()] };
        let used = self.seen.iter().filter(|seen| seen.state == ViewState::Used).count();
        let state = if is_other_size {
            ViewState::OtherSize
        } else if used >= params.max_views {
            ViewState::NotNeeded
        } else {
            let mut seen = [Seen::default(), Seen::default()];
            for side in 0..2 {
                seen[side] = self.detector.look(views[side]).map_err(failed)?;
            }
            parts = self.parts(&seen);
            found = seen.map(|seen| seen.points);
            if let Board::Charuco { square_mm, .. } = self.board {
                found.iter_mut().for_each(|points| keep_fitting(points, &self.places_mm, square_mm));
            }
            let [left, right] = &mut found;
            same_order(&self.board, self.places_mm.len(), left, right);
            for (index, place) in left.iter() {
                if let (Some((_, other)), Some(board)) =
                    (right.iter().find(|(other, _)| other == index), self.places_mm.get(*index))
                {
                    pair.board_mm.push(*board);
                    pair.px[0].push(*place);
                    pair.px[1].push(*other);
                }
            }
            match (left.is_empty(), right.is_empty()) {
                _ if parts.is_some() => ViewState::PartlySeen,
                (true, true) => ViewState::NoBoard,
                (true, false) => ViewState::NoBoardLeft,
                (false, true) => ViewState::NoBoardRight,
                _ if pair.board_mm.len() < MIN_POINTS || is_one_line(&pair.board_mm) => ViewState::FewPoints,
                _ if self.is_alike(&pair, size, params.min_move) => ViewState::Alike,
                _ => ViewState::Used,
            }
        };
        let area = [area(&pair.px[0], size), area(&pair.px[1], size)];
        let index = self.seen.len();
        if state == ViewState::Used {
            self.size = Some(size);
            let before = self.largest.as_ref().map_or(0.0, |(index, _)| self.seen[*index].area[0]);
            if area[0] > before {
                let copy = |view: View<'_, u8>| (0..view.height).flat_map(|y| view.row(y).to_vec()).collect();
                self.largest = Some((index, views.map(copy)));
            }
        } else if !matches!(state, ViewState::Alike | ViewState::NotNeeded) {
            cx.warn(&format!("view {index} is left out: {}", state.words()));
        }
        cx.metric("views_used", (used + usize::from(state == ViewState::Used)) as f64);
        self.seen.push(BoardView { state, pair, area, parts });
        Ok(found)
    }

    /// What both pictures show of a chessboard, where at least one of them does not show which part it is.
    fn parts(&self, seen: &[Seen; 2]) -> Option<[Part; 2]> {
        let Board::Chessboard { corners: (columns, _), .. } = self.board else { return None };
        if seen.iter().all(|seen| seen.part.is_none()) {
            return None;
        }
        let part = |seen: &Seen| {
            let whole = || part::of_points(&seen.points, columns as usize);
            Some(seen.part.clone().unwrap_or_else(whole)).filter(|part| !part.is_empty())
        };
        Some([part(&seen[0])?, part(&seen[1])?])
    }

    /// Uses the views that are seen in part, where the cameras say which part that is; returns how many. Streams have enough views without them.
    fn use_parts(&mut self, cx: &Context<'_>, params: &CalibrateParams, calibration: &Calibration) -> usize {
        let Board::Chessboard { square_mm, .. } = self.board else { return 0 };
        let (Ok(cameras), Some(size)) = (packet::cameras(calibration), self.size) else { return 0 };
        let mut count = 0;
        if params.min_move > 0.0 {
            return 0;
        }
        for (index, seen) in self.seen.iter_mut().enumerate() {
            let Some([left, right]) = seen.parts.as_ref().filter(|_| seen.state == ViewState::PartlySeen) else {
                continue;
            };
            let pair = match part::pair_of([left, right], square_mm, &cameras) {
                Ok(pair) => pair.filter(|pair| pair.board_mm.len() >= MIN_POINTS && !is_one_line(&pair.board_mm)),
                Err(error) => {
                    cx.warn(&format!("view {index} stays left out: OpenCV: {}", error.message));
                    None
                }
            };
            if let Some(pair) = pair {
                cx.info(&format!("view {index} shows a part of the board, which the other views place: it is used"));
                seen.area = [area(&pair.px[0], size), area(&pair.px[1], size)];
                seen.state = ViewState::Used;
                seen.pair = pair;
                count += 1;
            }
        }
        count
    }

    /// Whether the points are where they were in an earlier view.
    fn is_alike(&self, pair: &Pair, size: (usize, usize), min_move: f64) -> bool {
        let min_px = min_move * (size.0 as f64).hypot(size.1 as f64);
        if min_px <= 0.0 {
            return false;
        }
        self.seen.iter().filter(|seen| seen.state == ViewState::Used).any(|seen| {
            let (mut sum, mut count) = (0.0, 0usize);
            for (board, place) in pair.board_mm.iter().zip(&pair.px[0]) {
                if let Some(at) = seen.pair.board_mm.iter().position(|other| other == board) {
                    let other = seen.pair.px[0][at];
                    sum += f64::from((place[0] - other[0]).hypot(place[1] - other[1]));
                    count += 1;
                }
            }
            // Views that share little of the board differ.
            count * 2 > pair.board_mm.len() && sum / (count as f64) < min_px
        })
    }

    /// Solves with all views in use, with the distortion that they determine where that is to be found. Skips outliers one by one, at most a third of all.
    fn solve(&mut self, cx: &Context<'_>, params: &CalibrateParams) -> bool {
        let Some(size) = self.size else {
            cx.warn("there is no view to calibrate from");
            return false;
        };
        let is_auto = self.procedure == Procedure::Own(Model::Auto);
        let first = match self.chosen {
            Some((_, model)) if is_auto => Procedure::Own(model),
            _ => self.procedure,
        };
        let Some(mut solved) = self.solve_by(cx, params, size, first) else { return false };
        if is_auto
            && let Some(model) = self.choose(cx, &solved.0, size)
            && first != Procedure::Own(model)
        {
            let Some(better) = self.solve_by(cx, params, size, Procedure::Own(model)) else { return false };
            solved = better;
        }
        let procedure = match self.chosen {
            Some((_, model)) if is_auto => Procedure::Own(model),
            _ => self.procedure,
        };
        if self.use_parts(cx, params, &solved.1.calibration) > 0 {
            let Some(more) = self.solve_by(cx, params, size, procedure) else { return false };
            solved = more;
        }
        cx.metric("reproj_px", solved.1.calibration.rms_px);
        self.solution = Some(solved);
        true
    }

    /// Chooses the model of the distortion, once there are clearly more views than at the last choice.
    fn choose(&mut self, cx: &Context<'_>, used: &[usize], size: (usize, usize)) -> Option<Model> {
        if self.chosen.is_some_and(|(views, _)| 4 * used.len() < 5 * views) {
            return None;
        }
        let pairs: Vec<&Pair> = used.iter().map(|index| &self.seen[*index].pair).collect();
        match order::choose(&pairs, size) {
            Ok(choice) => {
                let choice = choice?;
                self.chosen = Some((used.len(), choice.model));
                cx.info(&format!(
                    "distortion `{}`: an error of {:.3} px in views left out, with `standard` {:.3} px",
                    format!("{:?}", choice.model).to_lowercase(),
                    choice.error_px,
                    choice.plain_px
                ));
                Some(choice.model)
            }
            Err(error) => {
                cx.warn(&format!("the distortion stays `standard`: OpenCV: {}", error.message));
                None
            }
        }
    }

    /// Views in use, and the solution by one procedure.
    fn solve_by(
        &mut self,
        cx: &Context<'_>,
        params: &CalibrateParams,
        size: (usize, usize),
        procedure: Procedure,
    ) -> Option<(Vec<usize>, Solution)> {
        // What stood out before may be explained now.
        for seen in self.seen.iter_mut().filter(|seen| seen.state == ViewState::LargeError) {
            seen.state = ViewState::Used;
        }
        let mut used: Vec<usize> =
            (0..self.seen.len()).filter(|index| self.seen[*index].state == ViewState::Used).collect();
        let max_skipped = used.len() / 3;
        let mut skipped = 0;
        loop {
            if used.len() < params.min_views {
                if params.solve_at > 0 {
                    cx.warn(&format!(
                        "{} of {} views are in use, {} are needed: no calibration",
                        used.len(),
                        self.seen.len(),
                        params.min_views
                    ));
                }
                return None;
            }
            let pairs: Vec<&Pair> = used.iter().map(|index| &self.seen[*index].pair).collect();
            let solution = match solve(&pairs, size, procedure) {
                Ok(solution) => solution,
                Err(why) => {
                    cx.warn(&format!("{} views give no calibration: {why}", used.len()));
                    return None;
                }
            };
            let worst = standing_out(&solution.errors_px)
                .filter(|_| params.reject && procedure != Procedure::Sample && skipped < max_skipped);
            let Some(worst) = worst else { return Some((used, solution)) };
            let index = used.remove(worst);
            let [a, b] = solution.errors_px[worst];
            self.seen[index].state = ViewState::LargeError;
            cx.warn(&format!("view {index} is left out: its error of {:.2} px stands out", a.max(b)));
            skipped += 1;
        }
    }

    fn show(&self, cx: &Context<'_>, out: &mut Out<'_>) -> Result<()> {
        let (Some((used, solution)), Some(size)) = (&self.solution, self.size) else { return Ok(()) };
        out.calibration.set(solution.calibration)?;
        let pairs: Vec<&Pair> = used.iter().map(|index| &self.seen[*index].pair).collect();
        for (side, name) in ["covered_left", "covered_right"].into_iter().enumerate() {
            cx.metric(name, draw::covered(&pairs, side, size));
        }
        if out.coverage.is_read() {
            draw::coverage(&pairs, size, &mut out.coverage.alloc(2 * size.0, size.1)?);
        }
        if out.epipolar.is_read()
            && let Some((index, pictures)) = &self.largest
        {
            let views = [&pictures[0], &pictures[1]].map(|picture| View::new(&picture[..], size.0, size.1, 1));
            let at = used.iter().position(|used| used == index);
            let error_px = at.map(|at| solution.epipolar_px[at]);
            let mut target = out.epipolar.alloc(2 * size.0, size.1)?;
            let pair = &self.seen[*index].pair;
            draw::epipolar(&solution.calibration, views, pair, error_px, cx.pool(), &mut target)?;
        }
        Ok(())
    }

    fn rows(&self) -> Vec<f64> {
        let mut rows = Vec::with_capacity(self.seen.len() * COLUMNS.len());
        for (index, seen) in self.seen.iter().enumerate() {
            let solved = self.solution.as_ref().and_then(|(used, solution)| {
                let at = used.iter().position(|used| *used == index)?;
                Some((solution.errors_px[at], solution.epipolar_px[at]))
            });
            let ([left, right], epipolar) = solved.unwrap_or(([f64::NAN; 2], f64::NAN));
            let points = seen.pair.board_mm.len() as f64;
            let [area_left, area_right] = seen.area.map(|area| 100.0 * area);
            let is_solved = f64::from(u8::from(solved.is_some()));
            rows.extend([
                index as f64,
                seen.state.code(),
                points,
                left,
                right,
                epipolar,
                area_left,
                area_right,
                is_solved,
            ]);
        }
        rows
    }
}

/// Index of the worst outlier.
fn standing_out(errors_px: &[[f64; 2]]) -> Option<usize> {
    let worst: Vec<f64> = errors_px.iter().map(|[a, b]| a.max(*b)).collect();
    let mut sorted = worst.clone();
    sorted.sort_by(f64::total_cmp);
    let limit = (STANDS_OUT * sorted.get(sorted.len() / 2)?).max(FINE_PX);
    let (index, error) = worst.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    (*error > limit).then_some(index)
}

/// Share of the picture that the box around the points fills.
fn area(points: &[[f32; 2]], size: (usize, usize)) -> f64 {
    let range = |axis: usize| {
        let all = points.iter().map(|p| p[axis]);
        let (low, high) = all.fold((f32::MAX, f32::MIN), |(low, high), v| (low.min(v), high.max(v)));
        f64::from((high - low).max(0.0))
    };
    if points.is_empty() { 0.0 } else { range(0) * range(1) / (size.0 * size.1) as f64 }
}

/// Whether all points are in one row or column of the board, which does not determine a camera.
fn is_one_line(board_mm: &[[f64; 2]]) -> bool {
    (0..2).any(|axis| board_mm.iter().all(|p| p[axis] == board_mm[0][axis]))
}

#[cfg(test)]
mod tests {
    use super::standing_out;

    #[test]
    fn a_view_stands_out_only_beside_good_ones() {
        let good = [[0.2, 0.2], [0.21, 0.25], [0.2, 0.22]];
        assert_eq!(standing_out(&good), None);
        assert_eq!(standing_out(&[good[0], [0.3, 1.2], good[1], good[2]]), Some(1));
        // Of small errors none is worth a view.
        assert_eq!(standing_out(&[[0.02, 0.02], [0.02, 0.03], [0.2, 0.2]]), None);
        assert_eq!(standing_out(&[]), None);
    }
}
