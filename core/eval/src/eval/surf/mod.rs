//! Repeatability and matching precision of SURF compared with OpenCV's SIFT and AKAZE.
//!
//! The images are graf1 and graf3 of the Oxford affine data set from Debian's opencv-doc, with their true homography.
//! Every engine runs as a node of a graph, and each comparison gives both the same number of points. SURF is evaluated
//! with 64 elements and extended to 128, on the same points. Precision is given twice: of all matches, and of those in
//! areas where the photographs confirm the homography ([`plane`]).

mod plane;

use std::path::{Path, PathBuf};

use panoscope_engine::text_table::table;
use panoscope_imaging::View;
use panoscope_imaging::features::{precision, repeatability};
use panoscope_imaging::geometry::Homography;

use self::plane::Plane;
use crate::error::{Context, EvalError, FileAction, OnFile, Result, bail};
use crate::figures::Figure;
use crate::packets::Table;
use crate::run::{self, Plan};
use crate::session::{Session, note};

/// Folders of OpenCV's sample data in Debian and other systems.
const FOLDERS: [&str; 4] = [
    "/usr/share/doc/opencv-doc/examples/data",
    "/usr/share/doc/opencv-doc/examples/cpp/data",
    "/usr/share/opencv4/samples/data",
    "/usr/share/opencv/samples/data",
];
const REPEATABILITY_PX: f64 = 1.5;
const PRECISION_PX: f64 = 3.0;
const RATIO: f64 = 0.8;
/// Low, so that the number of points limits the selection, not the threshold.
const SURF_THRESHOLD: f64 = 1.0;
const AKAZE_THRESHOLD: f64 = 1e-5;
/// More points than an image of half a million pixels has distinct ones: from here on SURF doubles the image and uses a
/// wider window to distinguish small features.
const MANY_POINTS: usize = 1500;

/// Options of [`judge`].
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Folder with graf1.png, graf3.png and H1to3p.xml, when Debian's opencv-doc is not installed.
    #[arg(long, value_name = "FOLDER")]
    pub data: Option<PathBuf>,
    /// Sets a parameter of `features_surf`, to see its effect; repeatable.
    #[arg(long = "set", value_name = "PARAM=VALUE")]
    pub settings: Vec<String>,
}

/// Images and ground truth.
struct Data {
    first: PathBuf,
    second: PathBuf,
    second_from_first: Homography,
}

fn find(data: Option<&Path>) -> Option<Data> {
    let folders = data.map(Path::to_owned).into_iter().chain(FOLDERS.iter().map(PathBuf::from));
    for folder in folders {
        let at = |name: &str| Some(folder.join(name)).filter(|path| path.is_file());
        if let (Some(first), Some(second), Some(truth)) = (at("graf1.png"), at("graf3.png"), at("H1to3p.xml")) {
            let second_from_first = read_truth(&std::fs::read_to_string(truth).ok()?)?;
            return Some(Data { first, second, second_from_first });
        }
    }
    None
}

/// The nine numbers between `<data>` and `</data>`.
fn read_truth(xml: &str) -> Option<Homography> {
    let data = xml.split_once("<data>")?.1.split_once("</data>")?.0;
    let numbers: Vec<f64> = data.split_whitespace().map(|word| word.parse().ok()).collect::<Option<_>>()?;
    Some(Homography(numbers.try_into().ok()?))
}

/// Matches of one detector.
struct Outcome {
    points: (usize, usize),
    matches: usize,
    repeatability: f64,
    precision: f64,
    correct: usize,
    /// Whether each match is correct, the most distinct (smallest ratio) first.
    right: Vec<bool>,
    /// As `right`, for matches that start in areas where the homography holds.
    right_on_plane: Vec<bool>,
}

impl Outcome {
    /// Precision of the `count` most distinct matches.
    fn precision_of(&self, count: usize) -> f64 {
        share(&self.right[..count.min(self.right.len())])
    }

    fn precision_on_plane(&self) -> f64 {
        share(&self.right_on_plane)
    }
}

fn share(right: &[bool]) -> f64 {
    right.iter().filter(|right| **right).count() as f64 / right.len().max(1) as f64
}

fn measure(session: &dyn Session, data: &Data, plane: &Plane, node: &str) -> Result<Outcome> {
    let text = format!(
        "mode = \"live\"\nplugins = [\"capture\", \"stitch\", \"opencv\"]\n\
         [nodes.files]\ntype = \"capture\"\nparams = {{ left = {:?}, right = {:?}, loop = true, pace = \"off\" }}\n\
         [nodes.features]\nbudget_ms = 60000\ninputs = {{ left = \"files.left\", right = \"files.right\" }}\n{node}\n",
        data.first, data.second
    );
    let ports = [
        ("features", "left_points"),
        ("features", "right_points"),
        ("features", "matches"),
        ("files", "left"),
        ("files", "right"),
    ];
    let plan = Plan { text: &text, ports: &ports, ..Plan::default() };
    let seen = run::run(session, &plan)?;
    let packet = |index: usize| seen.packets[index].as_ref().context("an output is empty");
    let read = |index: usize| Table::read(packet(index)?.bytes()).context("a table is malformed");
    let points = |table: Table| -> Vec<[f64; 2]> { table.rows.iter().map(|row| [row[0], row[1]]).collect() };
    let (first, second) = (points(read(0)?), points(read(1)?));
    let mut rows = read(2)?.rows;
    rows.sort_by(|a, b| a[3].total_cmp(&b[3]));
    let matches: Vec<_> = rows.iter().map(|row| (row[0] as usize, row[1] as usize)).collect();
    let size = |index: usize| packet(index).map(|p| (p.frame().width as usize, p.frame().height as usize));
    let truth = &data.second_from_first;
    let again = repeatability(&first, &second, truth, size(3)?, size(4)?, REPEATABILITY_PX);
    let right = precision(&first, &second, &matches, truth, PRECISION_PX);
    let is_right = |&m: &(usize, usize)| precision(&first, &second, &[m], truth, PRECISION_PX).correct == 1;
    let on_plane = matches.iter().filter(|m| first.get(m.0).is_some_and(|&point| plane.holds(point)));
    Ok(Outcome {
        points: (first.len(), second.len()),
        matches: matches.len(),
        repeatability: again.share,
        precision: right.share,
        correct: right.correct,
        right: matches.iter().map(is_right).collect(),
        right_on_plane: on_plane.map(is_right).collect(),
    })
}

fn surf(points: usize, extended: bool, settings: &[String]) -> String {
    let fine = if points > MANY_POINTS { ", upsample = true, window = 2.0" } else { "" };
    let extended = if extended { ", extended = true" } else { "" };
    let more: String = settings.iter().map(|setting| format!(", {setting}")).collect();
    format!(
        "type = \"features_surf\"\nparams = {{ max_points = {points}, hessian_threshold = {SURF_THRESHOLD:?}, ratio = {RATIO}{fine}{extended}{more} }}"
    )
}

fn peer(detector: &str, points: usize) -> String {
    let threshold = if detector == "akaze" && points > 0 { AKAZE_THRESHOLD } else { 0.0 };
    format!(
        "type = \"features_opencv\"\nparams = {{ detector = \"{detector}\", max_points = {points}, threshold = {threshold:?}, ratio = {RATIO} }}"
    )
}

/// A row of the table: points, repeatability, matches, precision.
fn row(name: String, o: &Outcome) -> Vec<String> {
    let percent = |share: f64| format!("{:.1} %", share * 100.0);
    vec![
        name,
        format!("{}+{}", o.points.0, o.points.1),
        percent(o.repeatability),
        o.matches.to_string(),
        o.correct.to_string(),
        percent(o.precision),
        percent(o.precision_on_plane()),
    ]
}

/// Measures repeatability and precision of SURF at four numbers of points, compared with each of OpenCV's detectors.
///
/// # Errors
/// The images are missing, a run fails, no keypoint was found, or the session is cancelled.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let Some(data) = find(options.data.as_deref()) else {
        let given = options.data.as_ref().map_or_else(String::new, |folder| format!(" in {} or", folder.display()));
        let reason = format!(
            "graf1.png, graf3.png and H1to3p.xml are not there; looked{given} in {}\n  help: install Debian's package opencv-doc, or give their folder: --data FOLDER",
            FOLDERS.join(", ")
        );
        return Err(EvalError::Options { reason });
    };
    let mut rows =
        vec![["case", "points", "repeated", "matches", "right", "precision", "on plane"].map(str::to_owned).to_vec()];
    let mut figures = Vec::new();
    let gray =
        |path: &Path| -> Result<image::GrayImage> { Ok(image::open(path).on_file(FileAction::Read, path)?.to_luma8()) };
    let (first, second) = (gray(&data.first)?, gray(&data.second)?);
    let view = |image| -> View<'_, u8> {
        let image: &image::GrayImage = image;
        View::new(image.as_raw(), image.width() as usize, image.height() as usize, 1)
    };
    let plane = Plane::find(view(&first), view(&second), &data.second_from_first);
    note!(
        session,
        "matches of every engine: each the other's nearest, less than {RATIO} of the distance to the second nearest"
    );
    note!(
        session,
        "  SURF: Euclidean distances, among points of the same sign of the Laplacian; SIFT: Euclidean distances"
    );
    note!(
        session,
        "  AKAZE: Hamming distances, which are squares of Euclidean ones, so that the same ratio lets more through"
    );
    note!(session, "the homography holds on {:.0} % of the first picture", plane.share() * 100.0);
    for detector in ["sift", "akaze"] {
        for wanted in [0, 500, 1000, 2000] {
            let theirs = measure(session, &data, &plane, &peer(detector, wanted))?;
            let equal = if wanted == 0 { (theirs.points.0 + theirs.points.1).div_ceil(2) } else { wanted };
            let ours = measure(session, &data, &plane, &surf(equal, false, &options.settings))?;
            let extended = measure(session, &data, &plane, &surf(equal, true, &options.settings))?;
            if ours.points.0 == 0 || theirs.points.0 == 0 {
                bail!("no keypoints were found in {}", data.first.display());
            }
            let case = if wanted == 0 { "default".to_owned() } else { wanted.to_string() };
            rows.push(row(format!("SURF beside {detector}, {case}"), &ours));
            rows.push(row(format!("SURF extended, {case}"), &extended));
            rows.push(row(format!("OpenCV {detector}, {case}"), &theirs));
            let input = format!("graf1/graf3, {equal} points");
            let named = detector.to_uppercase();
            let mut figure_in = |unit: &'static str, name: &str, value: f64, peer_value: f64| {
                let mut figure = Figure::new(&format!("{name}/{detector}_{case}"), value, unit, &input);
                figure.peer = Some(format!("OpenCV {named}"));
                figure.peer_value = Some(peer_value);
                figure.ratio = (peer_value > 0.0).then(|| value / peer_value);
                figures.push(figure);
            };
            let mut figure = |name: &str, value: f64, peer_value: f64| figure_in("1", name, value, peer_value);
            // Both describe the same points.
            figure("surf_repeatability", ours.repeatability, theirs.repeatability);
            for (name, ours) in [("surf", &ours), ("surf_extended", &extended)] {
                figure(&format!("{name}_precision"), ours.precision, theirs.precision);
                figure(&format!("{name}_precision_on_plane"), ours.precision_on_plane(), theirs.precision_on_plane());
                // A ratio of distances means something else for each descriptor: also the same number of matches, best first.
                let equal_matches = ours.matches.min(theirs.matches);
                figure(
                    &format!("{name}_precision_equal_matches"),
                    ours.precision_of(equal_matches),
                    theirs.precision_of(equal_matches),
                );
            }
            for (name, ours) in [("surf", &ours), ("surf_extended", &extended)] {
                figure_in("matches", &format!("{name}_right_matches"), ours.correct as f64, theirs.correct as f64);
            }
        }
    }
    session.table(&table(&rows));
    Ok(figures)
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_truth_is_read_from_opencvs_xml() {
        let xml = "<?xml version=\"1.0\"?><a><rows>3</rows><data>\n 1 0 2.5e+01\n 0 1 -3 0 0 1</data></a>";
        let map = super::read_truth(xml).unwrap();
        assert_eq!(map.map([1.0, 1.0]), [26.0, -2.0]);
        assert!(super::read_truth("<data>1 2 3</data>").is_none());
    }
}
