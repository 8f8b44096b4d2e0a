//! Images on which a graph is evaluated instead of its own.

use std::path::{Path, PathBuf};

use toml::{Table, Value};

use crate::error::Result;
use crate::inputs::wiring::Wiring;
use crate::inputs::{find, level};

/// Names of all cases; the graph's own source first.
pub const CASES: [&str; 4] = ["own", "cut", "hamlyn", "leuven"];

/// Operation whose frames are cut.
const OPERATION: &str = "v05_*.jpg";
/// Width and height of the Hamlyn pairs.
const HAMLYN: (u32, u32) = (640, 480);

/// A case that can be run.
pub struct Case {
    /// Name in figures; empty for the graph's own source.
    pub name: &'static str,
    /// The graph with the case's source.
    pub wiring: Wiring,
    /// Description of the input.
    pub input: String,
    /// Parameters that stop the motion between the views: node, name, value.
    pub still: Vec<(String, &'static str, Value)>,
}

/// A source of images.
#[derive(Clone, Debug)]
pub struct Source {
    /// The source node.
    pub node: Table,
    /// Plugin that it needs.
    pub plugin: &'static str,
    /// Whether it gives true disparities; otherwise correlation finds correspondences.
    pub has_truth: bool,
}

impl Source {
    /// A phantom with these parameters; later ones override earlier ones.
    pub fn phantom<'a>(params: impl IntoIterator<Item = (&'a str, Value)>) -> Self {
        let params: Table = params.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        let mut node = Table::new();
        node.insert("type".to_owned(), "phantom".into());
        node.insert("params".to_owned(), params.into());
        Self { node, plugin: "phantom", has_truth: true }
    }
}

/// Folders in which data sets are searched: the given ones, then the default ones.
pub fn data_folders(given: &[PathBuf]) -> Vec<PathBuf> {
    let usual = ["../shared/data", "../shared/data/stereo", "/usr/share/doc/opencv-doc/examples/data"];
    given.iter().cloned().chain(usual.map(PathBuf::from)).collect()
}

fn node(kind: &str, inputs: &[(&str, &str)], params: &[(&str, Value)]) -> Table {
    let mut node = Table::new();
    node.insert("type".to_owned(), kind.into());
    if !inputs.is_empty() {
        let inputs: Table = inputs.iter().map(|(port, from)| ((*port).to_owned(), Value::from(*from))).collect();
        node.insert("inputs".to_owned(), inputs.into());
    }
    let params: Table = params.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
    node.insert("params".to_owned(), params.into());
    node
}

fn text(path: &Path) -> Value {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    path.to_string_lossy().into_owned().into()
}

/// A source of the Hamlyn pairs of a folder; their calibration is written into `work`.
pub fn hamlyn(folder: &Path, work: &Path) -> Result<Source> {
    let file = work.join("hamlyn.yml");
    panoscope_data::calibration::write(&file, &level::calibration(HAMLYN))?;
    let params = [
        ("left", text(&folder.join("left"))),
        ("right", text(&folder.join("right"))),
        ("calibration", text(&file)),
        ("loop", true.into()),
    ];
    Ok(Source { node: node("capture", &[], &params), plugin: "capture", has_truth: false })
}

/// Folders of the images and of temporary files.
pub struct Places<'a> {
    /// Folders of data sets.
    pub folders: &'a [PathBuf],
    /// A temporary folder.
    pub work: &'a Path,
}

/// A case that is skipped.
pub enum Missing {
    /// The images are missing.
    Pictures(&'static str),
    /// The graph reads an output that this source does not have.
    Port(String),
}

/// Replaces the graph's source by that of a case.
pub fn case(name: &'static str, graph: &Wiring, places: &Places<'_>) -> Result<Result<Case, Missing>> {
    let wired = |made: Result<Wiring>| made.map_err(|error| Missing::Port(error.to_string()));
    match name {
        "cut" => {
            let Some(folder) = find(places.folders, "m2cai16-tool-locations/JPEGImages") else {
                return Ok(Err(Missing::Pictures("m2cai16-tool-locations")));
            };
            let files = [("left", text(&folder.join(OPERATION))), ("loop", true.into())];
            let more = [("cut_files", node("capture", &[], &files))];
            let source = node("cut_views", &[("image", "cut_files.left")], &[]);
            let made = graph.with_source(source, &["left", "right"], &more, &["capture", "stitch"]);
            let still = graph.composites[0].views[0].split('.').next().unwrap_or_default().to_owned();
            Ok(wired(made).map(|wiring| Case {
                name: "cut",
                wiring,
                input: "m2cai16 frames cut in two views, truth: the uncut frame".to_owned(),
                still: vec![(still, "sway_px", 0.0.into())],
            }))
        }
        "hamlyn" => {
            let Some(folder) = find(places.folders, "hamlyn_640x480") else {
                return Ok(Err(Missing::Pictures("hamlyn_640x480")));
            };
            let source = hamlyn(&folder, places.work)?;
            let made = graph.with_source(source.node, &["left", "right", "calibration"], &[], &[source.plugin]);
            Ok(wired(made).map(|wiring| Case {
                name: "hamlyn",
                wiring,
                input: "Hamlyn pairs 640x480 with parallax, residual of correspondences found by correlation"
                    .to_owned(),
                still: Vec::new(),
            }))
        }
        "leuven" => {
            let Some(left) = find(places.folders, "leuvenA.jpg") else {
                return Ok(Err(Missing::Pictures("leuvenA.jpg (Debian package opencv-doc)")));
            };
            let right = left.with_file_name("leuvenB.jpg");
            let params = [("left", text(&left)), ("right", text(&right)), ("loop", true.into())];
            // Without a file that output stays empty.
            let made =
                graph.with_source(node("capture", &[], &params), &["left", "right", "calibration"], &[], &["capture"]);
            Ok(wired(made).map(|wiring| Case {
                name: "leuven",
                wiring,
                input: "leuven, residual of correspondences found by correlation".to_owned(),
                still: Vec::new(),
            }))
        }
        _ => {
            let still = graph.phantom().map_or_else(Vec::new, |phantom| {
                vec![(phantom.clone(), "speed_mm_s", 0.0.into()), (phantom, "breathing_mm", 0.0.into())]
            });
            Ok(Ok(Case { name: "", wiring: graph.clone(), input: graph.name.clone(), still }))
        }
    }
}
