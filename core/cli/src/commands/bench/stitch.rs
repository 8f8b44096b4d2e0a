//! `panoscope bench stitch`: the thesis's Tables 2.1 to 2.3 and 4.1 to 4.3 (registration, seam and blend, whole frame), beside
//! OpenCV's classes in the same run, turn about.
//!
//! The pictures are rendered once and then played from memory, one pair after the other, so that nothing but the stitching is at work.
//! Times are the medians of the nodes' own times, the least of all rounds; stages of one tick follow one another, so they add up.
//! The seam is what a frame that finds one takes beyond a frame that keeps the one before (OpenCV's composite keeps none: beyond one
//! that looks for none). Ours finds one every 15th frame: `seam` is its mean per frame,
//! `seam_found` the time of a frame that finds one, `every_frame` the whole with one in each frame, as the peer has it.
//!
//! The peer is OpenCV through the nodes of the plugin `opencv`, not a program of its own: they call the same functions, and the copies
//! in and out of frames that they add are small beside what those take. `plugins/opencv/tests/reference.cpp` does the same work without
//! us; a test holds the nodes against it. The options are the fastest that do the job:
//! - SIFT. Debian's OpenCV has no SURF. ORB takes a tenth of the time, but registers at most half of the frames of the phantom's liver,
//!   AKAZE none. Brute force one way with the ratio test: matched both ways it takes twice as long and keeps the same inliers.
//! - The graph cut on differences of colour, as OpenCV's own stitcher takes it. Over gradients, the default of the bare class, it takes
//!   two to three times as long.
//! - Features at 0.6 megapixel, gains and seam at 0.1, as OpenCV's own stitcher has it; and, as the thesis has it, all at full size.
//! - Its fastest seam that looks at the picture is the shortest path (`DpSeamFinder`): measured as a third peer.

mod curves;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Result;
use panoscope_engine::Report;

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
    /// Draws the time of each frame at 640x480: registration, seam and the whole.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
}

/// Stands in the thesis's column of GPU times: nothing here has run on one.
const NO_GPU: &str = "no GPU here";
const SIZES: [(u32, u32); 3] = [(640, 480), (1280, 720), (1920, 1080)];
/// Pictures that are rendered and played round and round.
const PICTURES: u64 = 16;
const FULL: &str = "OpenCV SIFT + full graph cut";
const FAIR: &str = "OpenCV SIFT + graph cut at 0.1 MP";
const PATH: &str = "OpenCV SIFT + shortest path at 0.1 MP";

/// When the seam is found in what is timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seam {
    /// As a graph has it without further parameters.
    Default,
    EveryFrame,
    /// In the first frame alone; OpenCV's composite, which keeps none, does without.
    Once,
}

/// A way of stitching.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Roi,
    Conventional,
    Grid,
    OpencvFull,
    OpencvFair,
    OpencvPath,
}

impl Way {
    fn is_opencv(self) -> bool {
        matches!(self, Self::OpencvFull | Self::OpencvFair | Self::OpencvPath)
    }

    /// Whether its default is a seam in each frame.
    fn always_finds(self) -> bool {
        self.is_opencv() || self == Self::Conventional
    }

    fn name(self) -> &'static str {
        match self {
            Self::Roi => "roi",
            Self::Conventional => "conventional",
            Self::Grid => "grid",
            Self::OpencvFull => "OpenCV full",
            Self::OpencvFair => "OpenCV 0.1 MP",
            Self::OpencvPath => "OpenCV shortest path",
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
            Self::Grid => "type = \"register_grid\"\ninputs = { disparity = \"match.disparity\", calibration = \"files.calibration\" }\nparams = { ransac_px = 12.0 }".to_owned(),
            Self::OpencvFull | Self::OpencvFair | Self::OpencvPath => {
                let work = if self == Self::OpencvFull { 0.0 } else { 0.6 };
                format!(
                    "type = \"register_opencv\"\ninputs = {{ {views} }}\nparams = {{ threads = {threads}, mutual = false, work_megapixels = {work:?} }}"
                )
            }
        };
        let (kind, mut params) = match self {
            Self::Roi | Self::Grid => ("composite", format!("seam_scale = {scale_of_seam}")),
            // What is left without the seam does not sample the overlap at full size either.
            Self::Conventional if seam == Seam::Once => ("composite", "seam_scale = 10".to_owned()),
            Self::Conventional => ("composite", "seam_scale = 1".to_owned()),
            Self::OpencvFull => ("composite_opencv", format!("threads = {threads}")),
            Self::OpencvFair | Self::OpencvPath => {
                ("composite_opencv", format!("threads = {threads}, seam_megapixels = 0.1"))
            }
        };
        params.push_str(match (self, seam) {
            (Self::OpencvFull | Self::OpencvFair | Self::OpencvPath, Seam::Once) => ", seam = \"none\"",
            (Self::OpencvFull | Self::OpencvFair, _) => "",
            (Self::OpencvPath, _) => ", seam = \"dynamic_programming\"",
            (_, Seam::Once) => ", seam_interval = 10000",
            (Self::Conventional, _) | (_, Seam::EveryFrame) => ", seam_interval = 1",
            (Self::Roi | Self::Grid, Seam::Default) => "",
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
            // Each pair once: how long a cut takes depends on the pair more than on anything else.
            Self::OpencvFull if width > 640 => 2,
            Self::OpencvFull | Self::OpencvFair if quick => PICTURES / 2,
            Self::OpencvFull | Self::OpencvFair | Self::OpencvPath => PICTURES,
        }
    }
}

/// Medians of the nodes of one run, ms.
#[derive(Clone, Copy, Debug)]
struct Stages {
    matching: f64,
    register: f64,
    composite: f64,
    /// Seams found per frame; NaN when the composite does not count them.
    seams: f64,
}

impl Stages {
    const WORST: Self =
        Self { matching: f64::INFINITY, register: f64::INFINITY, composite: f64::INFINITY, seams: f64::NAN };

    fn of(report: &Report) -> Self {
        let p50 = |id: &str| report.nodes.get(id).map_or(0.0, |node| node.p50_ms);
        let seams = report.nodes.get("wide").and_then(|node| {
            let found = node.metrics.get("seams_found")?;
            Some(found / node.count.max(1) as f64)
        });
        Self {
            matching: p50("match"),
            register: p50("register"),
            composite: p50("wide"),
            seams: seams.unwrap_or(f64::NAN),
        }
    }

    /// The faster of two runs of the same graph, stage by stage.
    fn better(self, other: Self) -> Self {
        Self {
            matching: self.matching.min(other.matching),
            register: self.register.min(other.register),
            composite: self.composite.min(other.composite),
            seams: other.seams,
        }
    }
}

/// Times per frame of one way, ms.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Times {
    matching: f64,
    register: f64,
    /// The composite without finding a seam.
    rest: f64,
    /// The seam in a frame that finds one.
    seam_found: f64,
    /// Mean of the seam over all frames.
    seam: f64,
}

impl Times {
    /// `default`: as the graph is; `every`: its composite with a seam in each frame; `kept`: with one in the first alone.
    fn of(default: Stages, every: f64, kept: f64) -> Self {
        // Where seams are rare the median frame of the default finds none either.
        let is_rare = default.seams < 0.5;
        let rest = if is_rare { default.composite.min(kept) } else { kept };
        let seam_found = (every - rest).max(0.0);
        let seam = if is_rare { default.seams * seam_found } else { seam_found };
        Self { matching: default.matching, register: default.register, rest, seam_found, seam }
    }

    fn registration(&self) -> f64 {
        self.matching + self.register
    }

    fn composite(&self) -> f64 {
        self.rest + self.seam
    }

    /// Mean of a frame.
    fn whole(&self) -> f64 {
        self.registration() + self.composite()
    }

    /// A frame that finds a seam.
    fn every_frame(&self) -> f64 {
        self.registration() + self.rest + self.seam_found
    }
}

fn run(text: &str, frames: u64, threads: usize, pace: Pace) -> Result<Report> {
    let plan = Plan { text, path: Path::new("bench.toml"), frames: Some(frames), threads, ports: &[], pace };
    Ok(look::run(&plan)?.report)
}

/// Graph of one way on rendered pairs.
fn text_of(pairs: &Pairs, width: u32, way: Way, seam: Seam, threads: usize) -> String {
    format!(
        "mode = \"batch\"\nplugins = [\"capture\", \"stereo\", \"stitch\", \"opencv\", \"flow\"]\n[nodes.files]\n{}{}\
         [nodes.sink]\ntype = \"drain\"\ninputs = {{ image = \"wide.panorama\" }}\n",
        pairs.node("off"),
        way.nodes(width, threads, seam)
    )
}

/// Runs one way once. OpenCV brings its own threads: its nodes run on a pool of one.
fn once(pairs: &Pairs, width: u32, way: Way, seam: Seam, threads: usize, quick: bool) -> Result<Stages> {
    let pool = if way.is_opencv() { 1 } else { threads };
    let text = text_of(pairs, width, way, seam, threads);
    Ok(Stages::of(&run(&text, way.frames(width, quick), pool, Pace::Alone)?))
}

/// A way of stitching the phantom's views as they are rendered; `scope` are its further parameters.
fn on_the_phantom(way: Way, scope: &str) -> String {
    let nodes = way.nodes(640, 2, Seam::Default).replace("files.", "scope.");
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
    let mut ways = vec![Way::Roi, Way::Grid, Way::Conventional, Way::OpencvFair, Way::OpencvPath];
    // The cut at full resolution takes minutes on larger pictures.
    if size.0 == 640 || !quick {
        ways.push(Way::OpencvFull);
    }
    let rounds = if quick { 1 } else { 3 };
    // Of each way: its stages, its composite with a seam in each frame, and with one in the first alone.
    let mut best: Vec<_> = ways.into_iter().map(|way| (way, Stages::WORST, f64::INFINITY, f64::INFINITY)).collect();
    for round in 0..rounds {
        for (way, default, every, kept) in &mut best {
            if round > 0 && *way == Way::OpencvFull && size.0 > 640 {
                continue;
            }
            let run = |seam| once(pairs, size.0, *way, seam, threads, quick);
            *default = default.better(run(Seam::Default)?);
            let each = if way.always_finds() { default.composite } else { run(Seam::EveryFrame)?.composite };
            *every = every.min(each);
            *kept = kept.min(run(Seam::Once)?.composite);
        }
    }
    Ok(best.into_iter().map(|(way, default, every, kept)| (way, Times::of(default, every, kept))).collect())
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
        [
            "size, threads, way",
            "disparity",
            "2.1 registration",
            "2.2 seam when found",
            "mean of all frames",
            "rest of composite",
            "2.3, 4.3 whole ms",
            "seam in each frame",
            "GPU",
        ]
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
                let stages = [t.matching, t.register, t.seam_found, t.seam, t.rest, t.whole(), t.every_frame()];
                let gpu = std::iter::once(NO_GPU.to_owned());
                rows.push(std::iter::once(name).chain(stages.map(ms)).chain(gpu).collect());
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
    if let Some(path) = &arguments.plot {
        curves::plot(&folder, quick, path)?;
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
    let (full, fair, path) = (whole(Way::OpencvFull), whole(Way::OpencvFair), whole(Way::OpencvPath));
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
        let mut figure = |name: &str, value: f64, peer: &str, peer_value: Option<f64>| {
            out.push(Figure::new(name, value, "ms", &input).beside(peer, peer_value));
        };
        figure(&format!("{name}{case}"), times.whole(), FULL, full);
        figure(&format!("{name}{}", sub("fair")), times.whole(), FAIR, fair);
        figure(&format!("{name}{}", sub("shortest_path")), times.whole(), PATH, path);
        if !way.always_finds() {
            figure(&format!("{name}{}", sub("every_frame")), times.every_frame(), FAIR, fair);
            figure(&format!("{name}{}", sub("every_frame_full")), times.every_frame(), FULL, full);
        }
        let peer = of(Way::OpencvFair);
        let parts = [
            ("registration", times.registration(), peer.map(|p| p.register)),
            ("seam", times.seam, peer.map(|p| p.seam)),
            ("seam_found", times.seam_found, peer.map(|p| p.seam_found)),
            ("composite", times.composite(), peer.map(|p| p.composite())),
        ];
        for (part, value, peer) in parts {
            figure(&format!("{name}{}", sub(part)), value, FAIR, peer);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{FAIR, FULL, PATH, Stages, Times, Way, figures_of};

    #[test]
    fn a_seam_in_some_frames_counts_as_many_times_as_it_was_found() {
        // 1.2 ms with the seam of the frame before, 3 ms with a new one, which every tenth frame finds.
        let default = Stages { matching: 0.0, register: 1.0, composite: 1.2, seams: 0.1 };
        let times = Times::of(default, 3.0, 1.25);
        assert!((times.seam_found - 1.8).abs() < 1e-12 && (times.seam - 0.18).abs() < 1e-12, "{times:?}");
        assert!((times.whole() - 2.38).abs() < 1e-12 && (times.every_frame() - 4.0).abs() < 1e-12, "{times:?}");
        // In each frame: the mean is the seam itself. The peer does not count its seams, and finds one in each.
        for seams in [1.0, f64::NAN] {
            let times = Times::of(Stages { composite: 3.0, seams, ..default }, 3.0, 1.0);
            assert_eq!((times.seam, times.seam_found), (2.0, 2.0));
            assert_eq!(times.whole(), times.every_frame());
        }
    }

    #[test]
    fn every_frame_stands_beside_the_peer_that_finds_a_seam_in_every_frame() {
        let times = |seam_found: f64, seam: f64| Times { matching: 0.0, register: 1.0, rest: 1.0, seam_found, seam };
        let all = [
            (Way::Roi, times(2.0, 0.25)),
            (Way::Conventional, times(8.0, 8.0)),
            (Way::OpencvFull, times(98.0, 98.0)),
            (Way::OpencvFair, times(38.0, 38.0)),
            (Way::OpencvPath, times(6.0, 6.0)),
        ];
        let figures = figures_of(&all, (640, 480), 2);
        let seen = |name: &str| {
            let figure = figures.iter().find(|f| f.name == name).unwrap_or_else(|| panic!("no {name}"));
            (figure.value, figure.peer.as_deref().unwrap_or_default(), figure.peer_value.unwrap_or_default())
        };
        assert_eq!(seen("stitch_roi"), (2.25, FULL, 100.0));
        assert_eq!(seen("stitch_roi/fair"), (2.25, FAIR, 40.0));
        assert_eq!(seen("stitch_roi/shortest_path"), (2.25, PATH, 8.0));
        assert_eq!(seen("stitch_roi/every_frame"), (4.0, FAIR, 40.0));
        assert_eq!(seen("stitch_roi/every_frame_full"), (4.0, FULL, 100.0));
        assert_eq!(seen("stitch_roi/seam"), (0.25, FAIR, 38.0));
        assert_eq!(seen("stitch_roi/seam_found"), (2.0, FAIR, 38.0));
        assert_eq!(seen("stitch_conventional"), (10.0, FULL, 100.0));
        assert!(!figures.iter().any(|f| f.name == "stitch_conventional/every_frame"), "its default finds one in each");
        let large = figures_of(&all, (1920, 1080), 2);
        assert!(large.iter().any(|f| f.name == "stitch_roi_1080p/every_frame"));
        let one = figures_of(&all, (640, 480), 1);
        assert!(one.iter().any(|f| f.name == "stitch_roi/640x480_1_threads_every_frame"));
    }
}
