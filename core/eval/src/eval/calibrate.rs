//! `panoscope eval calibrate`: `panoscope calibrate` on real pairs compared with OpenCV's own sample, and on the
//! phantom's boards compared with ground truth; and lengths on boards that no calibration was made from.

mod held_out;

use std::path::{Path, PathBuf};

use panoscope_abi::Calibration;
use panoscope_data::calibration::Board;

use crate::calibration::{self, Source, Views};
use crate::error::{EvalError, Result};
use crate::figures::Figure;
use crate::session::{Session, note};

const PEER: &str = "OpenCV's sample stereo_calib";
/// Distance of the phantom's boards, mm, at which both cameras see all of them.
const DISTANCE_MM: f64 = 85.0;
/// Views of each of the phantom's boards.
const PHANTOM_VIEWS: u64 = 30;
/// The phantom's true focal length.
const FOCAL_PX: f64 = 750.0;
const BASELINE_MM: f64 = 15.0;
/// Boards of the phantom and their descriptions as calibration boards.
const PHANTOM_BOARDS: [(&str, &str); 3] = [
    ("chessboard", "chessboard:9x6:3mm"),
    ("circles", "circles:4x11:3mm"),
    ("charuco", "charuco:10x7:3mm:2.25mm:4x4_50"),
];

/// Names of the cases.
pub const CASES: [&str; 4] = ["chessboard", "laparoscope", "phantom", "held_out"];

/// Options of [`judge`].
#[derive(Clone, Debug)]
pub struct Options {
    /// The cases to evaluate; if empty, all.
    pub cases: Vec<String>,
    /// Folders of data sets, searched before the default ones.
    pub data: Vec<PathBuf>,
    /// Folder for the images of each case.
    pub pictures: Option<PathBuf>,
    /// Pairs of your own for `held_out`: left and right images (a folder or a pattern), and the printed board.
    pub own: Option<(String, String, Board)>,
}

/// Calibration and views of one run.
struct Calibrated {
    calibration: Calibration,
    views: Views,
}

fn made(
    session: &dyn Session,
    options: &calibration::Options,
    source: &Source,
    pictures: Option<&Path>,
) -> Result<Calibrated> {
    let calibrated = calibration::calibrate(session, options, source)?;
    if let (Ok(_), Some(folder)) = (&calibrated.calibration, pictures) {
        calibrated.write_pictures(folder)?;
    }
    let calibration = calibrated.calibration.map_err(|reason| EvalError::Input { reason })?;
    Ok(Calibrated { calibration, views: calibrated.views })
}

/// Errors of the calibration in each requested case whose data is available.
///
/// # Errors
/// A run fails, a file cannot be read or written, or the session is cancelled.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let usual = ["../shared/data", "/usr/share/doc/opencv-doc/examples/data"];
    let folders: Vec<PathBuf> = options.data.iter().cloned().chain(usual.map(PathBuf::from)).collect();
    let find = |name: &str| folders.iter().map(|folder| folder.join(name)).find(|path| path.exists());
    let wanted = |case: &str| options.cases.is_empty() || options.cases.iter().any(|c| c == case);
    let pictures = |case: &str| options.pictures.as_ref().map(|folder| folder.join(case));
    let mut figures = Vec::new();
    if wanted("chessboard") {
        match find("left01.jpg") {
            Some(first) => chessboard(session, &first, pictures("chessboard").as_deref(), &mut figures)?,
            None => {
                note!(
                    session,
                    "skipped: chessboard: there is no left01.jpg in the data folders (Debian package opencv-doc)"
                )
            }
        }
    }
    if wanted("laparoscope") {
        match find("calibration/charuco_laparoscope") {
            Some(folder) => laparoscope(session, &folder, pictures("laparoscope").as_deref(), &mut figures)?,
            None => {
                note!(session, "skipped: laparoscope: there is no calibration/charuco_laparoscope in the data folders")
            }
        }
    }
    if wanted("held_out") {
        held_out_boards(session, options, &find, &mut figures)?;
    }
    if wanted("phantom") {
        for (print, board) in PHANTOM_BOARDS {
            phantom(session, print, board.parse()?, pictures(print).as_deref(), &mut figures)?;
        }
    }
    Ok(figures)
}

/// Lengths on held-out pairs of the sets at hand, or of the user's own.
fn held_out_boards(
    session: &dyn Session,
    options: &Options,
    find: &dyn Fn(&str) -> Option<PathBuf>,
    figures: &mut Vec<Figure>,
) -> Result<()> {
    let mut sets = Vec::new();
    if let Some((left, right, board)) = &options.own {
        sets.push(("own", left.clone(), right.clone(), *board));
    } else {
        if let Some(first) = find("left01.jpg") {
            let side = |side: &str| first.with_file_name(format!("{side}??.jpg")).display().to_string();
            sets.push(("chessboard", side("left"), side("right"), board(CHESSBOARD)?));
        }
        if let Some(folder) = find("calibration/charuco_laparoscope") {
            let side = |name: &str| folder.join(name).display().to_string();
            sets.push(("laparoscope", side("ExtractedFrames_L"), side("ExtractedFrames_R"), board(LAPAROSCOPE)?));
        }
    }
    for (name, left, right, board) in sets {
        let options = calibration::Options::new(&left, &right, board);
        match Source::of(session, &options)? {
            Source::Images(files) => {
                figures.extend(held_out::figures(session, &held_out::BoardSet { name, files, board })?);
            }
            _ => note!(session, "skipped: {left} are not images: held_out needs pairs of images"),
        }
    }
    Ok(())
}

/// Printed boards of the sets at hand.
const CHESSBOARD: &str = "chessboard:9x6:25mm";
const LAPAROSCOPE: &str = "charuco:19x26:5mm:4mm:4x4_250";

fn board(name: &str) -> Result<Board> {
    Ok(name.parse()?)
}

/// The 13 pairs of OpenCV's documentation: our steps and the sample's, on the same images.
fn chessboard(session: &dyn Session, first: &Path, pictures: Option<&Path>, figures: &mut Vec<Figure>) -> Result<()> {
    let pattern = |side: &str| first.with_file_name(format!("{side}??.jpg")).display().to_string();
    let mut options = calibration::Options::new(&pattern("left"), &pattern("right"), board(CHESSBOARD)?);
    let source = Source::of(session, &options)?;
    let own = made(session, &options, &source, pictures)?;
    options.keep_all = true;
    let all = made(session, &options, &source, None)?;
    options.method = "sample".into();
    let sample = made(session, &options, &source, None)?;
    let input = format!("{} pairs 640x480 of opencv-doc", own.views.len());
    let mut add = |name: &str, made: &Calibrated, unit, of: &dyn Fn(&Calibrated) -> f64| {
        figures.push(Figure::new(name, of(made), unit, &input).beside(PEER, Some(of(&sample))));
    };
    add("reproj_px/chessboard", &own, "px", &|made| made.calibration.rms_px);
    add("reproj_px/chessboard_all_views", &all, "px", &|made| made.calibration.rms_px);
    add("epipolar_px/chessboard", &own, "px", &|made| made.views.epipolar_px());
    add("epipolar_px/chessboard_all_views", &all, "px", &|made| made.views.epipolar_px());
    for (name, value, peer) in [
        ("focal_px/chessboard", own.calibration.left.fx, sample.calibration.left.fx),
        ("baseline_mm/chessboard", own.calibration.baseline_mm, sample.calibration.baseline_mm),
    ] {
        let unit = if name.starts_with("focal") { "px" } else { "mm" };
        let mut figure = Figure::new(name, value, unit, &input).beside(PEER, Some(peer));
        // Neither more nor less is better.
        figure.ratio = None;
        figures.push(figure);
    }
    figures.push(Figure::new("views_used/chessboard", own.views.solved() as f64, "frames", &input));
    Ok(())
}

fn laparoscope(session: &dyn Session, folder: &Path, pictures: Option<&Path>, figures: &mut Vec<Figure>) -> Result<()> {
    let side = |name: &str| folder.join(name).display().to_string();
    let board = board(LAPAROSCOPE)?;
    let options = calibration::Options::new(&side("ExtractedFrames_L"), &side("ExtractedFrames_R"), board);
    let source = Source::of(session, &options)?;
    let made = made(session, &options, &source, pictures)?;
    made.views.skipped().iter().for_each(|line| session.note(line));
    let input = format!("{} pairs 720x576 of a laparoscope, ChArUco", made.views.len());
    for (name, value, unit) in [
        ("reproj_px/laparoscope", made.calibration.rms_px, "px"),
        ("epipolar_px/laparoscope", made.views.epipolar_px(), "px"),
        ("baseline_mm/laparoscope", made.calibration.baseline_mm, "mm"),
        ("views_used/laparoscope", made.views.solved() as f64, "frames"),
    ] {
        figures.push(Figure::new(name, value, unit, &input));
    }
    Ok(())
}

/// A board of the phantom, whose cameras are known exactly.
fn phantom(
    session: &dyn Session,
    print: &str,
    board: Board,
    pictures: Option<&Path>,
    figures: &mut Vec<Figure>,
) -> Result<()> {
    let text = format!(
        "mode = \"batch\"\nplugins = [\"phantom\"]\n[nodes.scope]\ntype = \"phantom\"\nparams = {{ scene = \"board\", board = \"{print}\", distance_mm = {DISTANCE_MM:?} }}\n"
    );
    let source = Source::Graph("eval.toml".into(), text);
    let mut options = calibration::Options::new("scope.left", "scope.right", board);
    // The phantom's lenses are perfect: what is solved for beyond that only follows the noise.
    options.model = "radial".into();
    options.frames = Some(PHANTOM_VIEWS);
    let made = made(session, &options, &source, pictures)?;
    let input = format!("{board}, {} views of the phantom 640x480 with its sensor's noise", made.views.solved());
    let c = &made.calibration;
    let focal = [c.left.fx, c.left.fy, c.right.fx, c.right.fy];
    let focal_error = focal.iter().map(|f| 100.0 * (f - FOCAL_PX).abs() / FOCAL_PX).fold(0.0, f64::max);
    for (name, value, unit) in [
        ("reproj_px", c.rms_px, "px"),
        ("focal_error_pct", focal_error, "%"),
        ("baseline_error_mm", (c.baseline_mm - BASELINE_MM).abs(), "mm"),
    ] {
        figures.push(Figure::new(&format!("{name}/phantom_{print}"), value, unit, &input));
    }
    Ok(())
}
