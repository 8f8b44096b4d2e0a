//! Where the views come from, and the graph that looks at them.

use std::path::{Path, PathBuf};

use panoscope_data::calibration::pictures::{image_files, is_pattern};
use panoscope_data::calibration::views::matched;
use panoscope_graph::GraphOptions;
use toml::{Table, Value};

use super::options::Options;
use crate::error::{Context, EvalError, Result, bail, ensure};
use crate::run;
use crate::session::{Session, note};

/// The calibrating node's name in the graph.
pub const NODE: &str = "calibrate";
const SOURCE: &str = "views";
/// Pairs that are looked at where the source has no end of its own.
const LIVE_FRAMES: u64 = 300;
/// Smallest number of views that give a calibration.
const MIN_VIEWS: u64 = 5;
/// Of a stream of views, how far the board must have moved from every view before, in parts of the diagonal.
const MIN_MOVE: f64 = 0.03;

/// Where the views come from.
pub enum Source {
    /// Pictures, pair by pair.
    Images([Vec<PathBuf>; 2]),
    /// Videos, cameras, pipelines.
    Stream,
    /// Ports of a graph: where it stands, its text.
    Graph(PathBuf, String),
}

/// Files of a pattern or folder; none for anything else.
fn images(text: &str) -> Result<Option<Vec<PathBuf>>> {
    let path = std::path::absolute(text).with_context(|| text.to_owned())?;
    if path.is_dir() {
        return image_files(&path.join("*"))
            .map(Some)
            .map_err(|why| EvalError::Input { reason: format!("no picture in {text}: {why}") });
    }
    if path.exists() || !is_pattern(text) || text.contains('!') || text.contains("://") {
        return Ok(None);
    }
    image_files(&path).map(Some).map_err(|why| EvalError::Input { reason: format!("no picture matches {text}: {why}") })
}

/// The absolute form of a path, which starts from the current folder.
fn absolute(path: &Path) -> Result<String> {
    Ok(std::path::absolute(path).with_context(|| path.display().to_string())?.display().to_string())
}

/// Pairs of pictures, and the pictures without a partner.
fn pairs(left: Vec<PathBuf>, right: Vec<PathBuf>) -> ([Vec<PathBuf>; 2], Vec<PathBuf>) {
    let mut found = matched(&[left, right]);
    let lonely = found.lonely.concat();
    let right = found.views.pop().unwrap_or_default();
    let left = found.views.pop().unwrap_or_default();
    ([left, right], lonely)
}

impl Source {
    /// What the options name.
    pub fn of(session: &dyn Session, options: &Options) -> Result<Self> {
        let source = Self::named(session, options)?;
        let count = source.frames(options);
        if let Some(count) = count.filter(|count| *count < MIN_VIEWS) {
            bail!(
                "{count} pairs of views are too few for a calibration: give at least {MIN_VIEWS}, better 15 to 30, with the board tilted and at different distances and places"
            );
        }
        Ok(source)
    }

    fn named(session: &dyn Session, options: &Options) -> Result<Self> {
        if let Some(graph) = &options.graph {
            for port in [&options.left, &options.right] {
                ensure!(port.contains('.'), "with --graph, `{port}` must be a port such as scope.left");
            }
            let text = run::flattened(graph, &GraphOptions::default())?;
            return Ok(Self::Graph(graph.clone(), text));
        }
        match (images(&options.left)?, images(&options.right)?) {
            (Some(left), Some(right)) => {
                let ([left, right], lonely) = pairs(left, right);
                for path in &lonely {
                    note!(session, "warning: {} has no partner on the other side", path.display());
                }
                ensure!(!left.is_empty(), "no picture has a partner on the other side");
                Ok(Self::Images([left, right]))
            }
            (None, None) => Ok(Self::Stream),
            _ => bail!("`{}` and `{}` are of different kinds", options.left, options.right),
        }
    }

    /// Where the graph's paths start.
    pub fn path(&self) -> &Path {
        match self {
            Self::Graph(path, _) => path,
            _ => Path::new("calibrate.toml"),
        }
    }

    /// Pairs that are looked at.
    pub fn frames(&self, options: &Options) -> Option<u64> {
        match self {
            Self::Images([left, _]) => Some(options.frames.unwrap_or(u64::MAX).min(left.len() as u64)),
            _ => Some(options.frames.unwrap_or(LIVE_FRAMES)),
        }
    }

    /// The name of a view for people.
    pub fn name(&self, index: usize) -> String {
        match self {
            Self::Images([left, right]) => {
                let name = |files: &[PathBuf]| {
                    files.get(index).and_then(|f| f.file_name()).map(|n| n.to_string_lossy().into_owned())
                };
                match (name(left), name(right)) {
                    (Some(left), Some(right)) => format!("{left} {right}"),
                    _ => format!("view {index}"),
                }
            }
            _ => format!("view {index}"),
        }
    }

    /// The graph as text.
    pub fn text(&self, options: &Options) -> Result<String> {
        let mut params = Table::new();
        params.insert("board".into(), options.board.to_string().into());
        params.insert("model".into(), options.model.clone().into());
        params.insert("method".into(), options.method.clone().into());
        params.insert("min_views".into(), (MIN_VIEWS as i64).into());
        params.insert("reject".into(), (!options.keep_all).into());
        let (mut graph, ports) = match self {
            Self::Graph(path, text) => {
                let graph: Table = text.parse().with_context(|| path.display().to_string())?;
                (graph, [options.left.clone(), options.right.clone()])
            }
            Self::Images([left, right]) => {
                (self.files_graph(left, right)?, SIDES.map(|side| format!("{SOURCE}.{side}")))
            }
            Self::Stream => {
                let mut capture = Table::new();
                for (side, text) in SIDES.iter().zip([&options.left, &options.right]) {
                    let is_file = Path::new(text).exists();
                    let text = if is_file { absolute(Path::new(text))? } else { text.clone() };
                    capture.insert((*side).into(), text.into());
                }
                (source_graph(capture), SIDES.map(|side| format!("{SOURCE}.{side}")))
            }
        };
        if let Self::Images([left, _]) = self {
            let frames = options.frames.unwrap_or(u64::MAX).min(left.len() as u64);
            params.insert("solve_at".into(), (frames as i64).into());
        } else {
            params.insert("min_move".into(), MIN_MOVE.into());
        }
        graph.insert("mode".into(), "batch".into());
        add(&mut graph, &ports, params)?;
        Ok(graph.to_string())
    }

    /// The pairs as lists of files: a pattern might find pictures without a partner too.
    fn files_graph(&self, left: &[PathBuf], right: &[PathBuf]) -> Result<Table> {
        let list = |files: &[PathBuf]| -> String {
            files.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join("\n")
        };
        let mut capture = Table::new();
        capture.insert("left".into(), list(left).into());
        capture.insert("right".into(), list(right).into());
        Ok(source_graph(capture))
    }
}

const SIDES: [&str; 2] = ["left", "right"];

fn source_graph(params: Table) -> Table {
    let mut node = Table::new();
    node.insert("type".into(), "capture".into());
    node.insert("params".into(), params.into());
    let mut nodes = Table::new();
    nodes.insert(SOURCE.into(), node.into());
    let mut graph = Table::new();
    graph.insert("plugins".into(), Value::Array(vec!["capture".into()]));
    graph.insert("nodes".into(), nodes.into());
    graph
}

/// Adds the calibrating node behind two ports, and takes every file-writing node away.
fn add(graph: &mut Table, ports: &[String; 2], params: Table) -> Result<()> {
    let plugins = graph.entry("plugins").or_insert_with(|| Value::Array(Vec::new()));
    if let Some(list) = plugins.as_array_mut()
        && !list.iter().any(|plugin| plugin.as_str() == Some("opencv"))
    {
        list.push("opencv".into());
    }
    graph.remove("preset");
    graph.remove("editor");
    let nodes = graph.entry("nodes").or_insert_with(|| Value::Table(Table::new()));
    let Some(nodes) = nodes.as_table_mut() else { bail!("the graph's `nodes` is not a table") };
    nodes.retain(|_, node| {
        let kind = node.get("type").and_then(Value::as_str).unwrap_or_default();
        !kind.rsplit('/').next().is_some_and(|name| name.starts_with("write_") || name == "preview")
    });
    let mut inputs = Table::new();
    for (side, port) in SIDES.iter().zip(ports) {
        inputs.insert((*side).into(), port.clone().into());
    }
    let mut node = Table::new();
    node.insert("type".into(), "calibrate_stereo".into());
    node.insert("inputs".into(), inputs.into());
    node.insert("params".into(), params.into());
    // Solving takes seconds; that is no hang.
    node.insert("budget_ms".into(), 120_000.into());
    nodes.insert(NODE.into(), node.into());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_paired_by_their_numbers() {
        let files = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        let (both, lonely) = pairs(files(&["l01.png", "l02.png", "l04.png"]), files(&["r1.png", "r3.png", "r4.png"]));
        assert_eq!(both, [files(&["l01.png", "l04.png"]), files(&["r1.png", "r4.png"])]);
        assert_eq!(lonely, files(&["l02.png", "r3.png"]));
        let (both, lonely) = pairs(files(&["a.png", "b.png"]), files(&["c.png"]));
        assert_eq!((both, lonely), ([files(&["a.png"]), files(&["c.png"])], files(&["b.png"])));
        let (both, _) = pairs(files(&["l10.png", "l11.png"]), files(&["r20.png", "r21.png"]));
        assert_eq!(both, [files(&["l10.png", "l11.png"]), files(&["r20.png", "r21.png"])]);
    }
}
