//! Maximum camera speed (thesis, section 2.4.3): share of stitched frames and alignment over the speed.
//!
//! The phantom's camera glides along the tissue at a constant speed. Its shutter is open for half of the frame time, as
//! with too little light, so motion blur is `speed x shutter x focal length / distance`, 25 px at 10 cm/s. All methods
//! get the same frames.

use std::path::PathBuf;

use panoscope_engine::text_table::{number, table};
use panoscope_graph::GraphOptions;
use toml::Value;

use super::beside::{self, Method};
use super::sources::Source;
use super::speed_list::SpeedList;
use super::tally::{self, StitchScore};
use crate::error::Result;
use crate::figures::Figure;
use crate::plot::{self, Chart, Series, Style};
use crate::session::{Session, note};
use crate::statistics::rms;

/// Methods swept by default.
const METHODS: [&str; 5] = ["conventional", "ROI", "grid", "chapter 2", "chapter 4"];
/// Scene and seed: the frames of each speed are divided among them, because a slow camera sees little of any one
/// tissue.
const PLACES: [(&str, i64); 4] = [("bowel", 7), ("liver", 7), ("bowel", 12), ("liver", 12)];
const RATE_HZ: f64 = 30.0;
/// Exposure as a share of the frame time.
const SHUTTER: f64 = 0.5;
/// Pixels of the phantom's image per mm of tissue.
const PX_PER_MM: f64 = 750.0 / 50.0;
/// Maximum motion between sub-frames of an image.
const BLUR_STEP_PX: f64 = 2.5;
/// A speed counts as followed if at least this share of the frames is stitched.
const FOLLOWED_PCT: f64 = 95.0;

/// Length of the motion blur, px.
fn blur_px(speed_cm_s: f64) -> f64 {
    speed_cm_s * 10.0 / RATE_HZ * SHUTTER * PX_PER_MM
}

fn source((scene, seed): (&str, i64), speed_cm_s: f64, settings: &[String]) -> Source {
    let subframes = (blur_px(speed_cm_s) / BLUR_STEP_PX).ceil().clamp(1.0, 16.0) as i64;
    let own: [(&str, Value); 7] = [
        ("scene", scene.into()),
        ("seed", seed.into()),
        ("camera_path", "glide".into()),
        ("speed_mm_s", (speed_cm_s * 10.0).into()),
        ("rate_hz", RATE_HZ.into()),
        ("shutter", SHUTTER.into()),
        ("motion_blur", subframes.into()),
    ];
    Source::phantom(own.into_iter().chain(beside::source_params(settings)))
}

/// All methods at one speed.
struct Point {
    speed_cm_s: f64,
    tallies: Vec<StitchScore>,
    /// Alignment error of the best plane, px.
    floor_px: f64,
}

fn point(
    session: &dyn Session,
    methods: &[Method],
    speed_cm_s: f64,
    frames: u64,
    settings: &[String],
) -> Result<Point> {
    let mut tallies = vec![StitchScore::default(); methods.len()];
    let mut all = Vec::new();
    for place in PLACES {
        // Half of the frames that one run of a graph has: two positions of each tissue.
        let tables = beside::judged(session, methods, &source(place, speed_cm_s, settings), frames.div_ceil(2))?;
        let floors = tally::floors(&tables.iter().collect::<Vec<_>>());
        for (tally, rows) in tallies.iter_mut().zip(&tables) {
            *tally = tally.and(&StitchScore::of(rows, &floors, 0)?);
        }
        all.extend(floors);
    }
    Ok(Point { speed_cm_s, tallies, floor_px: rms(&all) })
}

/// The highest speed such that a method follows it and all lower speeds of the sweep; `None` if it does not follow the
/// lowest.
fn followed_cm_s(points: &[Point], method: usize) -> Option<f64> {
    let follows = |point: &&Point| point.tallies[method].stitched_pct() >= FOLLOWED_PCT;
    points.iter().take_while(follows).last().map(|point| point.speed_cm_s)
}

/// Value of a measure in a score.
type Measure = fn(&StitchScore) -> f64;

fn tables(methods: &[Method], points: &[Point]) -> String {
    let measures: [(&str, Measure, usize); 3] = [
        ("stitched, %", StitchScore::stitched_pct, 1),
        ("believed and wrong, %", StitchScore::wrong_pct, 1),
        ("alignment of stitched frames, px", StitchScore::align_px, 2),
    ];
    let mut text = String::new();
    for (name, value, places) in measures {
        let is_alignment = places == 2;
        let mut head = vec![format!("{name}; at cm/s")];
        head.extend(methods.iter().map(|method| method.name.clone()));
        head.extend(is_alignment.then(|| "best plane".to_owned()));
        let mut rows = vec![head];
        for point in points {
            let mut row = vec![format!("{}", point.speed_cm_s)];
            row.extend(point.tallies.iter().map(|tally| number(value(tally), places)));
            row.extend(is_alignment.then(|| number(point.floor_px, places)));
            rows.push(row);
        }
        text += &table(&rows);
        text += "\n";
    }
    text
}

fn charts(methods: &[Method], points: &[Point]) -> Vec<Chart> {
    let line = |name: &str, color: usize, value: &dyn Fn(&Point) -> f64| {
        let at = |point: &Point| (point.speed_cm_s, value(point));
        Series::new(name, Style::Line, color, points.iter().map(at).collect())
    };
    let all = |value: Measure| -> Vec<Series> {
        methods.iter().enumerate().map(|(i, m)| line(&m.name, i, &|point| value(&point.tallies[i]))).collect()
    };
    let x_label = "camera speed, cm/s".to_owned();
    let share = Chart {
        title: "Stitched frames over camera speed".to_owned(),
        x_label: x_label.clone(),
        y_label: "stitched, %".to_owned(),
        series: all(StitchScore::stitched_pct),
        from_zero: true,
        ..Chart::default()
    };
    let mut series = all(StitchScore::align_px);
    series.push(line("best plane", methods.len(), &|point| point.floor_px));
    let align = Chart {
        title: "Alignment of stitched frames".to_owned(),
        x_label,
        y_label: "RMS, px".to_owned(),
        series,
        from_zero: true,
        ..Chart::default()
    };
    vec![share, align]
}

/// Options of [`judge`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Graph files; default: the five built-in graphs.
    pub graphs: Vec<PathBuf>,
    /// Camera speeds.
    pub speeds: SpeedList,
    /// Ticks per speed and tissue.
    pub frames: u64,
    /// `NODE.PARAM=VALUE`; node `scope` is the phantom that all graphs share.
    pub settings: Vec<String>,
    /// Overlays of the graphs, and values of their arguments.
    pub given: GraphOptions,
    /// Image file (PNG) for a plot of both measures over the speed.
    pub plot: Option<PathBuf>,
}

/// Share of stitched frames and alignment of each graph at each camera speed.
///
/// # Errors
/// A graph or a setting cannot be used, a run fails, or the plot cannot be written.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let methods = beside::methods(&options.graphs, &METHODS, &options.given, &options.settings)?;
    let mut points = Vec::new();
    for speed_cm_s in &options.speeds.0 {
        points.push(point(session, &methods, *speed_cm_s, options.frames, &options.settings)?);
        note!(session, "camera at {speed_cm_s} cm/s: pictures drawn out by {:.1} px", blur_px(*speed_cm_s));
    }
    session.table(&format!("{}\n\n{}", tally::rule(), tables(&methods, &points)));
    let mut figures = Vec::new();
    for (index, method) in methods.iter().enumerate() {
        let name = method.name.replace(' ', "_");
        for point in &points {
            let tally = &point.tallies[index];
            let input = format!(
                "phantom bowel and liver 640x480, camera at {} cm/s, {} frames",
                point.speed_cm_s, tally.frames
            );
            let case = format!("{name}_{}_cm_s", point.speed_cm_s);
            figures.push(Figure::new(&format!("stitched_share/{case}"), tally.stitched_pct(), "%", &input));
            if tally.align_px().is_finite() {
                figures.push(Figure::new(&format!("align_px/{case}"), tally.align_px(), "px", &input));
            }
        }
        let input =
            format!("at least {FOLLOWED_PCT} % of the frames stitched at this and each slower speed of the sweep");
        match followed_cm_s(&points, index) {
            Some(speed) => figures.push(Figure::new(&format!("followed_cm_s/{name}"), speed, "cm/s", &input)),
            None => {
                note!(
                    session,
                    "{}: less than {FOLLOWED_PCT} % of the frames are stitched at the slowest speed",
                    method.name
                )
            }
        }
    }
    if let Some(path) = &options.plot {
        plot::save(path, &charts(&methods, &points))?;
    }
    Ok(figures)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tally(stitched: usize, wrong: usize) -> StitchScore {
        StitchScore { frames: 100, stitched, wrong, ..StitchScore::default() }
    }

    fn points() -> Vec<Point> {
        let of = |speed_cm_s, tallies| Point { speed_cm_s, tallies, floor_px: 1.5 };
        vec![
            of(1.0, vec![tally(100, 0), tally(80, 0)]),
            of(2.5, vec![tally(95, 5), tally(100, 0)]),
            of(5.0, vec![tally(94, 0), tally(100, 0)]),
            of(10.0, vec![tally(100, 0), tally(100, 0)]),
        ]
    }

    #[test]
    fn a_speed_is_followed_when_each_slower_one_is() {
        assert_eq!((followed_cm_s(&points(), 0), followed_cm_s(&points(), 1)), (Some(2.5), None));
    }

    #[test]
    fn tables_have_a_row_for_each_speed_and_the_best_plane_beside_the_alignment() {
        let methods = beside::built_in(&["ROI", "grid"]).unwrap();
        let text = tables(&methods, &points());
        let lines: Vec<&str> = text.lines().collect();
        let row = |at: usize| lines[at].split_whitespace().collect::<Vec<_>>();
        let start = |what: &str| lines.iter().position(|line| line.contains(what)).unwrap_or_else(|| panic!("{text}"));
        assert_eq!(row(start("stitched, %;") + 2), ["2.5", "95.0", "100.0"]);
        assert_eq!(row(start("wrong, %;") + 2), ["2.5", "5.0", "0.0"]);
        let align = start("alignment");
        assert!(lines[align].contains("best plane"), "{text}");
        assert_eq!(row(align + 1), ["1", "-", "-", "1.50"]);
    }

    #[test]
    fn faster_cameras_have_more_blur_and_more_sub_frames() {
        assert!((blur_px(10.0) - 25.0).abs() < 1e-9);
        let of = |speed| source(PLACES[0], speed, &["scope.noise=3".to_owned()]).node["params"].clone();
        assert_eq!((of(0.0)["motion_blur"].as_integer(), of(10.0)["motion_blur"].as_integer()), (Some(1), Some(10)));
        assert_eq!((of(10.0)["speed_mm_s"].as_float(), of(0.5)["noise"].as_integer()), (Some(100.0), Some(3)));
    }
}
