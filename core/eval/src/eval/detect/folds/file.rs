//! The file of folds, which the training script reads too: which operations each fold keeps out.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::error::{Context, FileAction, OnFile, Result, bail, ensure};
use crate::inputs::shipped_file;

/// Path of the shipped file of folds in the repository.
pub const SHIPPED: &str = "plugins/tools/training/folds.toml";

/// Folds of whole operations.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Folds {
    /// Folder of the data set, name in the data folders.
    pub data: String,
    /// Splits that together contain all frames.
    pub splits: Vec<String>,
    /// Numbers in the names of frames per second of video.
    pub frame_rate_hz: f64,
    /// Maximum gap between two frames of one block, s.
    pub block_s: f64,
    /// Operations that each fold keeps out, by the fold's name.
    pub folds: BTreeMap<String, Vec<String>>,
    #[serde(skip)]
    path: PathBuf,
}

impl Folds {
    /// Whether the shipped file is present; installed packages do not contain the training.
    pub fn ships() -> bool {
        shipped_file(Path::new(SHIPPED)).is_some()
    }

    /// Reads `path`, or the shipped file.
    ///
    /// # Errors
    /// The file is missing or damaged, an operation is in two folds, or there is only one fold.
    pub fn read(path: Option<&Path>) -> Result<Self> {
        let path = match path {
            Some(path) => path.to_owned(),
            None => shipped_file(Path::new(SHIPPED))
                .with_context(|| format!("{SHIPPED} is missing: give a file of folds with --fold-file"))?,
        };
        let text = std::fs::read_to_string(&path).on_file(FileAction::Read, &path)?;
        let mut folds: Self =
            toml::from_str(&text).with_context(|| format!("{} is not a file of folds", path.display()))?;
        folds.path = path;
        folds.check()?;
        Ok(folds)
    }

    fn check(&self) -> Result<()> {
        let file = self.path.display();
        ensure!(self.folds.len() >= 2, "{file}: {} fold; at least two are needed", self.folds.len());
        ensure!(self.frame_rate_hz > 0.0, "{file}: frame_rate_hz is {}; it must be above 0", self.frame_rate_hz);
        ensure!(self.block_s >= 0.0, "{file}: block_s is {}; it must not be negative", self.block_s);
        let mut fold_of: BTreeMap<&str, &str> = BTreeMap::new();
        for (fold, operations) in &self.folds {
            ensure!(!operations.is_empty(), "{file}: fold {fold} has no operation");
            for operation in operations {
                if let Some(other) = fold_of.insert(operation, fold) {
                    bail!("{file}: operation {operation} is in fold {other} and in fold {fold}; remove it from one");
                }
            }
        }
        Ok(())
    }

    /// The file they were read from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The fold that holds an operation out.
    pub fn fold_of(&self, operation: &str) -> Option<&str> {
        self.folds.iter().find(|(_, list)| list.iter().any(|o| o == operation)).map(|(fold, _)| fold.as_str())
    }
}
