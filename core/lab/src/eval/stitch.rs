//! `panoscope eval stitch`.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use panoscope_eval::Session;
use panoscope_eval::eval::stitch::{self, SpeedList};
use panoscope_eval::figures::Figure;

use panoscope_cli::given::Given;

/// Arguments of `eval stitch`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph with a composite of two or more views.
    #[arg(required_unless_present_any = ["speeds", "cases"])]
    graph: Option<PathBuf>,
    /// Source of images: `own`, the graph's; `cut`, real frames cut into two views; `hamlyn`, real stereo pairs;
    /// `leuven`, two photographs. Repeatable. Default: `own`.
    #[arg(long, value_parser = stitch::CASES)]
    case: Vec<String>,
    /// Folder of data sets, searched before the default ones; repeatable.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Draws alignment and likeness over time.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
    /// Writes a row for every tick as CSV, one file per evaluation: FILE becomes FILE-composite.csv.
    #[arg(long, value_name = "FILE")]
    rows: Option<PathBuf>,
    /// Ticks of each run.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(12..))]
    frames: u64,
    /// Sets a parameter; overrides the file; repeatable.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    given: Given,
    /// Skips the peers of the graph: OpenCV's conventional pipeline and as-projective-as-possible warps.
    #[arg(long)]
    no_peer: bool,
    /// Skips the runs with still views and with incidents, which take most of the time.
    #[arg(long, conflicts_with_all = ["fov", "speeds", "cases"])]
    brief: bool,
    /// Writes the last panorama of each case, with those of its peers below it, into this folder.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["fov", "speeds", "cases"])]
    pictures: Option<PathBuf>,
    #[command(flatten)]
    fov: Fov,
    #[command(flatten)]
    sweeps: Sweeps,
}

/// Graphs side by side on the same images of the phantom; `--set scope.PARAM=VALUE` sets a parameter of the phantom.
#[derive(clap::Args)]
struct Sweeps {
    /// Sweeps the speed of the cameras, cm/s, as `1,2.5,10` or `0.5..10` or `0.5..10:0.5`: share of stitched frames and
    /// alignment of each graph; of our conventional, ROI and grid and the thesis's chapters 2 and 4 when no graph is
    /// given.
    #[arg(long, value_name = "LIST", conflicts_with_all = ["case", "rows"])]
    speeds: Option<SpeedList>,
    /// Evaluates each graph on hard images (few features, smoke, blur, low light, real pairs): share of stitched
    /// frames, alignment, time, jitter; the thesis's chapters 2 and 4 and our ROI and grid when no graph is given.
    #[arg(long, conflicts_with_all = ["case", "rows", "speeds"])]
    cases: bool,
    /// With `--cases`: only these; repeatable.
    #[arg(long, value_name = "CASE", requires = "cases", value_parser = clap::builder::PossibleValuesParser::new(stitch::cases::known()))]
    only: Vec<String>,
    /// With `--fov`, `--speeds` or `--cases`: further graphs.
    #[arg(value_name = "GRAPHS")]
    more: Vec<PathBuf>,
}

/// Arguments of `eval stitch --fov`.
#[derive(clap::Args)]
struct Fov {
    /// Field of view: the area of the panorama over that of one view, on the phantom's bowel and liver at each of
    /// `--distances`, compared with the true union of the cameras' views.
    #[arg(long, conflicts_with_all = ["speeds", "cases"])]
    fov: bool,
    /// Distances from the scope to the tissue, mm.
    #[arg(long, value_name = "MM", value_delimiter = ',', requires = "fov", default_values_t = stitch::fov::DISTANCES_MM)]
    distances: Vec<f64>,
}

/// Evaluates as requested by the arguments.
pub fn judge(session: &dyn Session, arguments: &Arguments) -> Result<Vec<Figure>> {
    let Sweeps { speeds, cases, only, more } = &arguments.sweeps;
    let Arguments { set: settings, frames, data, plot, .. } = arguments;
    let (settings, frames, data, plot) = (settings.clone(), *frames, data.clone(), plot.clone());
    let given = arguments.given.options(&[]);
    let graphs: Vec<PathBuf> = arguments.graph.iter().chain(more).cloned().collect();
    Ok(match speeds {
        _ if arguments.fov.fov => {
            let distances_mm = arguments.fov.distances.clone();
            stitch::fov::judge(session, &stitch::fov::Options { graphs, settings, given, frames, distances_mm })?
        }
        Some(speeds) => {
            let options = stitch::speeds::Options { graphs, speeds: speeds.clone(), frames, settings, given, plot };
            stitch::speeds::judge(session, &options)?
        }
        None if *cases => {
            let options = stitch::cases::Options { graphs, only: only.clone(), frames, settings, given, data, plot };
            stitch::cases::judge(session, &options)?
        }
        None if !more.is_empty() => {
            bail!("give one graph, or --fov, --speeds or --cases to evaluate several")
        }
        None => {
            let options = stitch::Options {
                graph: arguments.graph.clone().context("no graph is given")?,
                cases: arguments.case.clone(),
                data,
                plot,
                rows: arguments.rows.clone(),
                frames,
                settings,
                given,
                with_peer: !arguments.no_peer,
                is_brief: arguments.brief,
                pictures: arguments.pictures.clone(),
            };
            stitch::judge(session, &options)?
        }
    })
}
