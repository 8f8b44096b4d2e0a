//! The thesis's Tables 2.1 to 2.3 and 4.1 to 4.3 (registration, seam and blend, whole frame), compared with OpenCV's
//! classes in the same run, alternating.
//!
//! The images are rendered once and then played from memory, one pair after the other, so that only the stitching runs.
//! Times are the medians of the nodes' own times, the minimum of all rounds; stages of one tick follow one another, so
//! they add up. The time of the seam is the additional time of a frame that finds one over a frame that keeps the
//! previous one (OpenCV's composite keeps none: beyond one that looks for none). Ours finds one every 15th frame:
//! `seam` is its mean per frame, `seam_found` the time of a frame that finds one, `every_frame` the whole with one in
//! each frame, as the peer has it.
//!
//! The peer is OpenCV through the nodes of the plugin `opencv`, not a program of its own: they call the same functions,
//! and the copies in and out of frames that they add are small beside what those take.
//! `plugins/opencv/tests/reference.cpp` does the same work without us; a test holds the nodes against it. The options
//! are the fastest that do the job:
//! - SIFT. Debian's OpenCV has no SURF. ORB takes a tenth of the time, but registers at most half of the frames of the
//!   phantom's liver, AKAZE none. Brute force in one direction with the ratio test: matched in both directions it takes
//!   twice as long and keeps the same inliers.
//! - The graph cut on differences of colour, as OpenCV's own stitcher takes it. Over gradients, the default of the bare
//!   class, it takes two to three times as long.
//! - Features at 0.6 megapixel, gains and seam at 0.1, as OpenCV's own stitcher has it; and, as the thesis has it, all
//!   at full size.
//! - Its fastest seam that looks at the image is the shortest path (`DpSeamFinder`): measured as a third peer.

mod curves;
mod method;
mod times;

use std::path::{Path, PathBuf};

use panoscope_engine::Report;
use panoscope_engine::text_table::table;

use crate::error::Result;
use crate::figures::Figure;
use crate::inputs::Folder;
use crate::inputs::pairs::Pairs;
use crate::registration;
use crate::run::{self, Pace, Plan};
use crate::session::{Session, note};
use method::{Method, PICTURES, Seam, text_of};
use times::{Stages, Times};

/// Options of [`measure`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Fewer frames and rounds: a quick check instead of a measurement.
    pub quick: bool,
    /// Sizes of the images, of [`SIZE_NAMES`]; if empty, the default ones.
    pub sizes: Vec<String>,
    /// PNG file for the time of each frame at 640x480: registration, seam and the whole.
    pub plot: Option<PathBuf>,
}

/// Text in the thesis's column of GPU times, which are not measured.
const NO_GPU: &str = "no GPU here";
/// Names of the sizes of images.
pub const SIZE_NAMES: [&str; 3] = ["640x480", "1280x720", "1920x1080"];
const SIZES: [(u32, u32); 3] = [(640, 480), (1280, 720), (1920, 1080)];
const FULL: &str = "OpenCV SIFT + full graph cut";
const FAIR: &str = "OpenCV SIFT + graph cut at 0.1 MP";
const PATH: &str = "OpenCV SIFT + shortest path at 0.1 MP";

fn run(session: &dyn Session, text: &str, frames: u64, threads: usize, pace: Pace) -> Result<Report> {
    let plan = Plan { text, path: Path::new("bench.toml"), frames: Some(frames), threads, ports: &[], pace };
    Ok(run::run(session, &plan)?.report)
}

/// Runs one method once. OpenCV uses its own threads, so its nodes run on a pool of one.
fn once(
    session: &dyn Session,
    pairs: &Pairs,
    width: u32,
    method: Method,
    seam: Seam,
    threads: usize,
    quick: bool,
) -> Result<Stages> {
    let pool = if method.is_opencv() { 1 } else { threads };
    let text = text_of(pairs, width, method, seam, threads);
    Ok(Stages::of(&run(session, &text, method.frames(width, quick), pool, Pace::Alone)?))
}

/// A method of stitching the phantom's views as they are rendered; `scope` are its further parameters.
fn on_the_phantom(method: Method, scope: &str) -> String {
    let nodes = method.nodes(640, 2, Seam::Default).replace("files.", "scope.");
    let scope = format!("[nodes.scope]\ntype = \"phantom\"\nparams = {{ {scope} }}\n");
    format!("mode = \"live\"\nplugins = [\"phantom\", \"stereo\", \"stitch\", \"flow\"]\n{nodes}{scope}")
}

/// Tables 4.1 and 4.2: share of frames that are stitched and their alignment, SURF compared with the grid, on smooth
/// and on rich tissue.
fn quality(session: &dyn Session, quick: bool) -> Result<Vec<Figure>> {
    const SCENES: [(&str, u32); 4] = [("bowel", 7), ("bowel", 12), ("liver", 7), ("liver", 12)];
    let frames = if quick { 20 } else { 60 };
    let head = |what: &str| vec![[what, "conventional", "roi", "grid", "best plane"].map(str::to_owned).to_vec()];
    let (mut shares, mut errors) = (head("scene, stitched %"), head("scene, alignment px"));
    let mut figures = Vec::new();
    for (scene, seed) in SCENES {
        let (mut share, mut error) = (vec![format!("{scene} {seed}")], vec![format!("{scene} {seed}")]);
        let mut floor = f64::NAN;
        for method in [Method::Conventional, Method::Roi, Method::Grid] {
            let text = on_the_phantom(method, &format!("scene = \"{scene}\", seed = {seed}"));
            let marks = registration::registration_of(session, &text, frames)?;
            share.push(format!("{:.1}", marks.stitched_pct));
            error.push(format!("{:.2}", marks.align_px));
            floor = marks.floor_px;
            let (case, input) =
                (format!("{}_{scene}_{seed}", method.name()), format!("phantom {scene} 640x480, {frames} frames"));
            figures.push(Figure::new(&format!("stitched_share/{case}"), marks.stitched_pct, "%", &input));
            figures.push(Figure::new(&format!("align_px/{case}"), marks.align_px, "px", &input));
        }
        error.push(format!("{floor:.2}"));
        shares.push(share);
        errors.push(error);
    }
    session.table(&format!("Table 4.1: share of frames that are stitched\n{}\n", table(&shares)));
    session.table(&format!("Table 4.2: alignment error\n{}\n", table(&errors)));
    Ok(figures)
}

/// Heap allocations of the whole process per frame in steady state, with the phantom as the source: decoding files is
/// not counted.
fn allocations(session: &dyn Session, method: Method, quick: bool) -> Result<Option<f64>> {
    let text = on_the_phantom(method, "") + "[nodes.sink]\ntype = \"drain\"\ninputs = { image = \"wide.panorama\" }\n";
    Ok(run(session, &text, if quick { 80 } else { 200 }, 2, Pace::Free)?.allocations_per_frame)
}

/// SURF compared with SIFT on one image, ms per image.
fn features(session: &dyn Session, pairs: &Pairs, points: u32, quick: bool) -> Result<(f64, f64)> {
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
        ours = ours.min(p50(&run(session, &surf, if quick { 20 } else { 40 }, 2, Pace::Alone)?));
        theirs = theirs.min(p50(&run(session, &sift, 6, 1, Pace::Alone)?));
    }
    Ok((ours, theirs))
}

fn measured(
    session: &dyn Session,
    pairs: &Pairs,
    size: (u32, u32),
    threads: usize,
    quick: bool,
) -> Result<Vec<(Method, Times)>> {
    let mut methods =
        vec![Method::Roi, Method::Grid, Method::Mesh, Method::Conventional, Method::OpencvTenth, Method::OpencvPath];
    // The cut at full resolution takes minutes on larger pictures.
    if size.0 == 640 || !quick {
        methods.push(Method::OpencvFull);
    }
    let rounds = if quick { 1 } else { 3 };
    // Of each method: its stages, its composite with a seam in each frame, and with one in the first alone.
    let mut best: Vec<_> =
        methods.into_iter().map(|method| (method, Stages::WORST, f64::INFINITY, f64::INFINITY)).collect();
    for round in 0..rounds {
        for (method, default, every, kept) in &mut best {
            if round > 0 && *method == Method::OpencvFull && size.0 > 640 {
                continue;
            }
            let run = |seam| once(session, pairs, size.0, *method, seam, threads, quick);
            *default = default.better(run(Seam::Default)?);
            let each = if method.always_finds() { default.composite } else { run(Seam::EveryFrame)?.composite };
            *every = every.min(each);
            *kept = kept.min(run(Seam::Once)?.composite);
        }
    }
    Ok(best.into_iter().map(|(method, default, every, kept)| (method, Times::of(default, every, kept))).collect())
}

/// Measures all cases.
pub fn measure(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let quick = options.quick;
    let folder = Folder::new("panoscope-bench")?;
    let wanted = |(width, height): (u32, u32)| match &options.sizes[..] {
        [] => !quick || width == 640,
        sizes => sizes.iter().any(|size| *size == format!("{width}x{height}")),
    };
    let threads: &[usize] = if quick { &[2] } else { &[1, 2] };
    let mut figures = Vec::new();
    let mut rows = vec![
        [
            "size, threads, method",
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
        note!(session, "rendering {PICTURES} pairs of {}x{}", size.0, size.1);
        let scope = format!("width = {}, height = {}", size.0, size.1);
        let pairs = Pairs::of(session, &folder, &size.0.to_string(), &scope, PICTURES)?;
        for &threads in threads {
            let all = measured(session, &pairs, size, threads, quick)?;
            for (method, t) in &all {
                let ms = |v: f64| format!("{v:.2}");
                let name = format!("{}x{}, {threads}, {}", size.0, size.1, method.name());
                let stages = [t.matching, t.register, t.seam_found, t.seam, t.rest, t.whole(), t.every_frame()];
                let gpu = std::iter::once(NO_GPU.to_owned());
                rows.push(std::iter::once(name).chain(stages.map(ms)).chain(gpu).collect());
            }
            figures.extend(figures_of(&all, size, threads));
        }
    }
    session.table(&format!("Tables 2.1 to 2.3 and 4.3: time per frame, ms\n{}\n", table(&rows)));
    if !options.sizes.is_empty() && options.sizes.iter().all(|size| size != "640x480") {
        return Ok(figures);
    }
    figures.extend(quality(session, quick)?);
    for (name, method) in [("stitch_roi", Method::Roi), ("stitch_grid", Method::Grid), ("stitch_mesh", Method::Mesh)] {
        if let Some(count) = allocations(session, method, quick)? {
            figures.push(Figure::new(
                &format!("allocations_per_frame/{name}"),
                count,
                "1/frame",
                "640x480 phantom, 2 threads",
            ));
        }
    }
    if let Some(path) = &options.plot {
        curves::plot(session, &folder, quick, path)?;
    }
    let pairs = Pairs::of(session, &folder, "features", "", 1)?;
    for points in [500, 1000, 2000] {
        let (ours, theirs) = features(session, &pairs, points, quick)?;
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

fn figures_of(all: &[(Method, Times)], size: (u32, u32), threads: usize) -> Vec<Figure> {
    let of = |method: Method| all.iter().find(|(w, _)| *w == method).map(|(_, times)| *times);
    let whole = |method: Method| of(method).map(|times| times.whole());
    let (full, fair, path) = (whole(Method::OpencvFull), whole(Method::OpencvTenth), whole(Method::OpencvPath));
    // The names that others read stand for 640x480 on two threads, and for 1080p.
    let case = match (size.0, threads) {
        (640, 2) => String::new(),
        (1920, 2) => "_1080p".to_owned(),
        _ => format!("/{}x{}_{threads}_threads", size.0, size.1),
    };
    let sub = |part: &str| if case.contains('/') { format!("{case}_{part}") } else { format!("{case}/{part}") };
    let input = format!("{}x{} phantom, {threads} threads", size.0, size.1);
    let mut out = Vec::new();
    for (name, method) in [
        ("stitch_roi", Method::Roi),
        ("stitch_grid", Method::Grid),
        ("stitch_mesh", Method::Mesh),
        ("stitch_conventional", Method::Conventional),
    ] {
        let Some(times) = of(method) else { continue };
        let mut figure = |name: &str, value: f64, peer: &str, peer_value: Option<f64>| {
            out.push(Figure::new(name, value, "ms", &input).beside(peer, peer_value));
        };
        figure(&format!("{name}{case}"), times.whole(), FULL, full);
        figure(&format!("{name}{}", sub("fair")), times.whole(), FAIR, fair);
        figure(&format!("{name}{}", sub("shortest_path")), times.whole(), PATH, path);
        if !method.always_finds() {
            figure(&format!("{name}{}", sub("every_frame")), times.every_frame(), FAIR, fair);
            figure(&format!("{name}{}", sub("every_frame_full")), times.every_frame(), FULL, full);
        }
        let peer = of(Method::OpencvTenth);
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
    use super::{FAIR, FULL, Method, PATH, Stages, Times, figures_of};

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
            (Method::Roi, times(2.0, 0.25)),
            (Method::Conventional, times(8.0, 8.0)),
            (Method::OpencvFull, times(98.0, 98.0)),
            (Method::OpencvTenth, times(38.0, 38.0)),
            (Method::OpencvPath, times(6.0, 6.0)),
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
