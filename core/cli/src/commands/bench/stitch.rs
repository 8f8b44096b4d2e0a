//! `panoscope bench stitch`: the thesis's Tables 2.1 to 2.3 and 4.1 to 4.3 (registration, seam and blend, whole frame), beside
//! OpenCV's classes in the same run, turn about.
//!
//! The pictures are rendered once and then played from memory, one pair after the other, so that nothing but the stitching is at work.
//! Times are the medians of the nodes' own times, the least of all rounds; stages of one tick follow one another, so they add up.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::Result;
use panoscope_runtime::Report;

use super::folder::Folder;
use super::pairs::Pairs;
use super::record::Figure;
use crate::commands::eval::look::{self, Pace, Plan};
use crate::commands::eval::stitch;
use crate::terminal::{raw, table, tell};

/// Arguments of `bench stitch`.
#[derive(clap::Args)]
#[group(skip)]
pub struct Arguments {
    #[command(flatten)]
    pub common: super::Arguments,
    /// Only pictures of this size; may be given again.
    #[arg(long, value_parser = ["640x480", "1280x720", "1920x1080"])]
    size: Vec<String>,
}

const SIZES: [(u32, u32); 3] = [(640, 480), (1280, 720), (1920, 1080)];
/// Pictures that are rendered and played round and round.
const PICTURES: u64 = 16;
const FULL: &str = "OpenCV SIFT + full graph cut";
const FAIR: &str = "OpenCV SIFT + graph cut at 0.1 MP";

/// Whether the seam is part of what is timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seam {
    Found,
    Spared,
}

/// A way of stitching.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Roi,
    Conventional,
    Grid,
    OpencvFull,
    OpencvFair,
}

impl Way {
    fn name(self) -> &'static str {
        match self {
            Self::Roi => "roi",
            Self::Conventional => "conventional",
            Self::Grid => "grid",
            Self::OpencvFull => "OpenCV full",
            Self::OpencvFair => "OpenCV 0.1 MP",
        }
    }

    /// Nodes `match` (grid only), `register` and `wide`, scaled as the thesis does: a whole frame shrunk to about 320x240.
    fn nodes(self, width: u32, threads: usize, seam: Seam) -> String {
        let (scale, scale_of_seam) = ((width / 320).clamp(1, 8), (width / 64).clamp(2, 64));
        let views = "left = \"files.left\", right = \"files.right\"";
        let register = match self {
            Self::Roi => format!("type = \"register_surf\"\ninputs = {{ {views} }}\nparams = {{ roi = true, scale = {scale} }}"),
            Self::Conventional => format!(
                "type = \"register_surf\"\ninputs = {{ {views} }}\nparams = {{ roi = false, spread = false, second_look = true, max_points = 2000, upright = false, stability_px = 0.0 }}"
            ),
            Self::Grid => "type = \"register_grid\"\ninputs = { disparity = \"match.disparity\", calibration = \"files.calibration\" }".to_owned(),
            Self::OpencvFull | Self::OpencvFair => {
                format!("type = \"register_opencv\"\ninputs = {{ {views} }}\nparams = {{ threads = {threads} }}")
            }
        };
        let (kind, mut params) = match self {
            Self::Roi | Self::Grid => ("composite", format!("seam_scale = {scale_of_seam}")),
            Self::Conventional => ("composite", "seam_scale = 2, seam_interval = 1".to_owned()),
            Self::OpencvFull | Self::OpencvFair => ("composite_opencv", format!("threads = {threads}")),
        };
        params.push_str(match (self, seam) {
            (Self::OpencvFull, Seam::Found) => "",
            (Self::OpencvFair, Seam::Found) => ", seam_megapixels = 0.1",
            // OpenCV's node finds one always: on next to no pixels, here.
            (Self::OpencvFull | Self::OpencvFair, Seam::Spared) => ", seam_megapixels = 0.05",
            (_, Seam::Found) => "",
            (_, Seam::Spared) => ", seam = \"none\"",
        });
        let mut text = format!(
            "[nodes.register]\n{register}\nbudget_ms = 60000\n[nodes.wide]\nbudget_ms = 60000\ntype = \"{kind}\"\ninputs = {{ {views}, homography = \"register.homography\" }}\nparams = {{ {params} }}\n"
        );
        if self == Self::Grid {
            let _ = write!(
                text,
                "[nodes.match]\ntype = \"stereo_bm\"\ninputs = {{ {views}, roi = {{ from = \"register.roi_left\", delay = 1 }} }}\nparams = {{ scale = {scale} }}\n"
            );
        }
        text
    }

    fn frames(self, width: u32, quick: bool) -> u64 {
        let many = if quick { 24 } else { 72 };
        match self {
            Self::Roi => many,
            Self::Grid => many / 2,
            Self::Conventional => many / 6,
            Self::OpencvFull => {
                if width > 640 {
                    2
                } else {
                    4
                }
            }
            Self::OpencvFair => {
                if width > 1280 {
                    3
                } else {
                    6
                }
            }
        }
    }
}

/// Medians of the nodes of one run, ms.
#[derive(Clone, Copy, Debug)]
struct Times {
    matching: f64,
    register: f64,
    composite: f64,
    /// Part of `composite` that finding the seam takes; NaN where it was not measured.
    seam: f64,
}

impl Times {
    fn of(report: &Report) -> Self {
        let p50 = |id: &str| report.nodes.get(id).map_or(0.0, |node| node.p50_ms);
        Self { matching: p50("match"), register: p50("register"), composite: p50("wide"), seam: f64::NAN }
    }

    fn registration(&self) -> f64 {
        self.matching + self.register
    }

    fn whole(&self) -> f64 {
        self.registration() + self.composite
    }

    /// The faster of two runs of the same graph.
    fn better(self, other: Option<Self>) -> Self {
        other.filter(|other| other.whole() <= self.whole()).unwrap_or(self)
    }
}

fn run(text: &str, frames: u64, threads: usize, pace: Pace) -> Result<Report> {
    let plan = Plan { text, path: Path::new("bench.toml"), frames: Some(frames), threads, ports: &[], pace };
    Ok(look::run(&plan)?.report)
}

/// Runs one way once. OpenCV brings its own threads: its nodes run on a pool of one.
fn once(pairs: &Pairs, width: u32, way: Way, seam: Seam, threads: usize, quick: bool) -> Result<Times> {
    let pool = if matches!(way, Way::OpencvFull | Way::OpencvFair) { 1 } else { threads };
    let text = format!(
        "mode = \"batch\"\nplugins = [\"capture\", \"stereo\", \"stitch\", \"opencv\", \"flow\"]\n[nodes.files]\n{}{}\
         [nodes.sink]\ntype = \"drain\"\ninputs = {{ image = \"wide.panorama\" }}\n",
        pairs.node("off"),
        way.nodes(width, threads, seam)
    );
    Ok(Times::of(&run(&text, way.frames(width, quick), pool, Pace::Alone)?))
}

/// A way of stitching the phantom's views as they are rendered; `scope` are its further parameters.
fn on_the_phantom(way: Way, scope: &str) -> String {
    let nodes = way.nodes(640, 2, Seam::Found).replace("files.", "scope.");
    let scope = format!("[nodes.scope]\ntype = \"phantom\"\nparams = {{ {scope} }}\n");
    format!("mode = \"live\"\nplugins = [\"phantom\", \"stereo\", \"stitch\", \"flow\"]\n{nodes}{scope}")
}

/// Tables 4.1 and 4.2: share of frames that are stitched and their alignment, SURF beside the grid, on smooth and on rich tissue.
fn quality(quick: bool) -> Result<Vec<Figure>> {
    const SCENES: [(&str, u32); 4] = [("bowel", 7), ("bowel", 12), ("liver", 7), ("liver", 12)];
    let frames = if quick { 20 } else { 60 };
    let head = |what: &str| vec![[what, "conventional", "roi", "grid", "best plane"].map(str::to_owned).to_vec()];
    let (mut shares, mut errors) = (head("scene, stitched %"), head("scene, alignment px"));
    let mut figures = Vec::new();
    for (scene, seed) in SCENES {
        let (mut share, mut error) = (vec![format!("{scene} {seed}")], vec![format!("{scene} {seed}")]);
        let mut floor = f64::NAN;
        for way in [Way::Conventional, Way::Roi, Way::Grid] {
            let text = on_the_phantom(way, &format!("scene = \"{scene}\", seed = {seed}"));
            let marks = stitch::registration_of(&text, frames)?;
            share.push(format!("{:.1}", marks.stitched_pct));
            error.push(format!("{:.2}", marks.align_px));
            floor = marks.floor_px;
            let (case, input) =
                (format!("{}_{scene}_{seed}", way.name()), format!("phantom {scene} 640x480, {frames} frames"));
            figures.push(Figure::new(&format!("stitched_share/{case}"), marks.stitched_pct, "%", &input));
            figures.push(Figure::new(&format!("align_px/{case}"), marks.align_px, "px", &input));
        }
        error.push(format!("{floor:.2}"));
        shares.push(share);
        errors.push(error);
    }
    raw(&format!("Table 4.1: share of frames that are stitched\n{}\n", table(&shares)));
    raw(&format!("Table 4.2: alignment error\n{}\n", table(&errors)));
    Ok(figures)
}

/// Heap allocations of the whole process per frame in steady state, with the phantom as the source: decoding files is not counted.
fn allocations(way: Way, quick: bool) -> Result<Option<f64>> {
    let text = on_the_phantom(way, "") + "[nodes.sink]\ntype = \"drain\"\ninputs = { image = \"wide.panorama\" }\n";
    Ok(run(&text, if quick { 80 } else { 200 }, 2, Pace::Free)?.allocations_per_frame)
}

/// SURF beside SIFT on one picture, ms per picture.
fn features(pairs: &Pairs, points: u32, quick: bool) -> Result<(f64, f64)> {
    let picture = pairs.first();
    let text = |node: &str| {
        format!(
            "mode = \"batch\"\nplugins = [\"capture\", \"stitch\", \"opencv\"]\n\
             [nodes.files]\ntype = \"capture\"\nparams = {{ left = {picture:?}, right = {picture:?}, loop = true, pace = \"off\" }}\n\
             [nodes.features]\nbudget_ms = 60000\ninputs = {{ left = \"files.left\" }}\n{node}\n"
        )
    };
    // OpenCV's detectors take their maxima as they are: so does ours here.
    let surf = text(&format!(
        "type = \"features_surf\"\nparams = {{ max_points = {points}, hessian_threshold = 1.0, second_look = false }}"
    ));
    let sift = text(&format!(
        "type = \"features_opencv\"\nparams = {{ detector = \"sift\", max_points = {points}, threads = 2 }}"
    ));
    let (mut ours, mut theirs) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..if quick { 1 } else { 3 } {
        let p50 = |report: &Report| report.nodes.get("features").map_or(f64::NAN, |node| node.p50_ms);
        ours = ours.min(p50(&run(&surf, if quick { 20 } else { 40 }, 2, Pace::Alone)?));
        theirs = theirs.min(p50(&run(&sift, 6, 1, Pace::Alone)?));
    }
    Ok((ours, theirs))
}

fn measured(pairs: &Pairs, size: (u32, u32), threads: usize, quick: bool) -> Result<Vec<(Way, Times)>> {
    let mut ways = vec![Way::Roi, Way::Grid, Way::Conventional, Way::OpencvFair];
    // The cut at full resolution takes minutes on larger pictures.
    if size.0 == 640 || !quick {
        ways.push(Way::OpencvFull);
    }
    let rounds = if quick { 1 } else { 3 };
    let mut best: Vec<(Way, Option<Times>)> = ways.into_iter().map(|way| (way, None)).collect();
    for round in 0..rounds {
        for (way, times) in &mut best {
            if round > 0 && *way == Way::OpencvFull && size.0 > 640 {
                continue;
            }
            *times = Some(once(pairs, size.0, *way, Seam::Found, threads, quick)?.better(*times));
        }
    }
    let mut all = Vec::new();
    for (way, times) in best {
        let Some(mut times) = times else { continue };
        // What the composite takes beyond one that finds no seam.
        let spared = once(pairs, size.0, way, Seam::Spared, threads, quick)?.composite;
        times.seam = (times.composite - spared).max(0.0);
        all.push((way, times));
    }
    Ok(all)
}

/// Measures all cases.
pub fn measure(arguments: &Arguments) -> Result<Vec<Figure>> {
    crate::interrupt::listen();
    let quick = arguments.common.quick;
    let folder = Folder::new("panoscope-bench")?;
    let wanted = |(width, height): (u32, u32)| match &arguments.size[..] {
        [] => !quick || width == 640,
        sizes => sizes.iter().any(|size| *size == format!("{width}x{height}")),
    };
    let threads: &[usize] = if quick { &[2] } else { &[1, 2] };
    let mut figures = Vec::new();
    let mut rows = vec![
        ["size, threads, way", "disparity", "2.1 registration", "2.2 seam", "rest of composite", "2.3, 4.3 whole ms"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for size in SIZES.into_iter().filter(|size| wanted(*size)) {
        tell!("rendering {PICTURES} pairs of {}x{}", size.0, size.1);
        let scope = format!("width = {}, height = {}", size.0, size.1);
        let pairs = Pairs::of(&folder, &size.0.to_string(), &scope, PICTURES)?;
        for &threads in threads {
            let all = measured(&pairs, size, threads, quick)?;
            for (way, t) in &all {
                let ms = |v: f64| format!("{v:.2}");
                let name = format!("{}x{}, {threads}, {}", size.0, size.1, way.name());
                let rest = t.composite - t.seam;
                rows.push(vec![name, ms(t.matching), ms(t.register), ms(t.seam), ms(rest), ms(t.whole())]);
            }
            figures.extend(figures_of(&all, size, threads));
        }
    }
    raw(&format!("Tables 2.1 to 2.3 and 4.3: time per frame, ms\n{}\n", table(&rows)));
    if !arguments.size.is_empty() && arguments.size.iter().all(|size| size != "640x480") {
        return Ok(figures);
    }
    figures.extend(quality(quick)?);
    for (name, way) in [("stitch_roi", Way::Roi), ("stitch_grid", Way::Grid)] {
        if let Some(count) = allocations(way, quick)? {
            figures.push(Figure::new(
                &format!("allocations_per_frame/{name}"),
                count,
                "1/frame",
                "640x480 phantom, 2 threads",
            ));
        }
    }
    let pairs = Pairs::of(&folder, "features", "", 1)?;
    for points in [500, 1000, 2000] {
        let (ours, theirs) = features(&pairs, points, quick)?;
        let figure = Figure::new(
            &format!("surf_640x480/{points}"),
            ours,
            "ms",
            &format!("640x480 phantom, {points} points, 2 threads"),
        );
        figures.push(figure.beside("OpenCV SIFT", Some(theirs)));
    }
    Ok(figures)
}

fn figures_of(all: &[(Way, Times)], size: (u32, u32), threads: usize) -> Vec<Figure> {
    let of = |way: Way| all.iter().find(|(w, _)| *w == way).map(|(_, times)| *times);
    let whole = |way: Way| of(way).map(|times| times.whole());
    let (full, fair) = (whole(Way::OpencvFull), whole(Way::OpencvFair));
    // The names that others read stand for 640x480 on two threads, and for 1080p.
    let case = match (size.0, threads) {
        (640, 2) => String::new(),
        (1920, 2) => "_1080p".to_owned(),
        _ => format!("/{}x{}_{threads}_threads", size.0, size.1),
    };
    let sub = |part: &str| if case.contains('/') { format!("{case}_{part}") } else { format!("{case}/{part}") };
    let input = format!("{}x{} phantom, {threads} threads", size.0, size.1);
    let mut out = Vec::new();
    for (name, way) in
        [("stitch_roi", Way::Roi), ("stitch_grid", Way::Grid), ("stitch_conventional", Way::Conventional)]
    {
        let Some(times) = of(way) else { continue };
        out.push(Figure::new(&format!("{name}{case}"), times.whole(), "ms", &input).beside(FULL, full));
        out.push(Figure::new(&format!("{name}{}", sub("fair")), times.whole(), "ms", &input).beside(FAIR, fair));
        let peer = of(Way::OpencvFair);
        let parts = [
            ("registration", times.registration(), peer.map(|p| p.register)),
            ("seam", times.seam, peer.map(|p| p.seam)),
            ("composite", times.composite, peer.map(|p| p.composite)),
        ];
        for (part, value, peer) in parts.into_iter().filter(|(_, value, _)| value.is_finite()) {
            out.push(Figure::new(&format!("{name}{}", sub(part)), value, "ms", &input).beside(FAIR, peer));
        }
    }
    out
}
