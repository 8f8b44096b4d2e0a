//! Models of foreign origin, and the limits of their trial.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::time::Duration;

use panoscope_engine::vet::{Opening, TrialError, TrialFn, TrialLimits, Vet, VetError};
use panoscope_graph::ParamValue;

use crate::loader::depends::weights_of;
use crate::loader::file_name::stem;
use crate::loader::sealed;
use crate::loader::stamp::Stamp;

/// Time limit for opening the smallest model: twenty times its time on an idle machine, for one that is busy and reads
/// ONNX Runtime from a disk.
const BASE_TIME: Duration = Duration::from_secs(10);
const TIME_PER_MB: Duration = Duration::from_millis(250);
/// Maximum time limit, below that of opening in a run, so that the trial's own message is reported.
const MAX_TIME: Duration = Duration::from_secs(25);
/// Memory for the process itself with ONNX Runtime and OpenCV.
const BASE_BYTES: u64 = 1 << 30;
/// Memory per byte of the model and its weights, which are parsed, optimized and laid out for the processor.
const BYTES_PER_BYTE: u64 = 8;

/// Whether a parameter with this value names a neural network. The file's extension is ignored, because a hostile file
/// may have any.
pub fn is_model(name: &str, value: &ParamValue) -> bool {
    let ParamValue::Path(file) = value else { return false };
    let is_named_so = file.extension().is_some_and(|e| e.eq_ignore_ascii_case("onnx"));
    is_named_so || (name == "model" && !file.as_os_str().is_empty())
}

/// A model with the files of its weights.
fn files_of(model: &Path) -> impl Iterator<Item = PathBuf> {
    let folder = model.parent().unwrap_or(Path::new("")).to_owned();
    let weights = weights_of(model).into_iter().map(move |name| folder.join(name));
    std::iter::once(model.to_owned()).chain(weights)
}

/// Limits in proportion to the size of some models.
pub(crate) fn limits(models: &[&Path]) -> TrialLimits {
    let files = models.iter().flat_map(|model| files_of(model));
    let bytes: u64 = files.filter_map(|file| std::fs::metadata(file).ok()).map(|about| about.len()).sum();
    let megabytes = u32::try_from(bytes >> 20).unwrap_or(u32::MAX);
    TrialLimits {
        memory_bytes: BASE_BYTES.saturating_add(bytes.saturating_mul(BYTES_PER_BYTE)),
        time: BASE_TIME.saturating_add(TIME_PER_MB.saturating_mul(megabytes)).min(MAX_TIME),
    }
}

/// Whether a model came with a plugin: it is in the plugin's folder next to the library.
fn is_shipped(model: &Path, plugin_file: &Path) -> bool {
    let shipped = plugin_file.parent().unwrap_or(Path::new("")).join(stem(plugin_file));
    match (model.canonicalize(), shipped.canonicalize()) {
        (Ok(model), Ok(shipped)) => model.starts_with(shipped),
        _ => false,
    }
}

/// Opens models on trial that came neither with their plugin nor under a lock, once per version of their files.
#[derive(Debug, Default)]
struct ForeignModels {
    /// Nodes that opened: their files and values.
    opened: Mutex<BTreeSet<String>>,
}

impl Vet for ForeignModels {
    fn vet(&self, opening: &Opening<'_>, trial: &mut TrialFn<'_>) -> Result<(), VetError> {
        let plugin_file = Path::new(opening.plugin_file);
        let mut models = Vec::new();
        for (name, value) in &opening.params {
            if let ParamValue::Path(file) = value
                && is_model(name, value)
                && !is_shipped(file, plugin_file)
                && !sealed::is_copy(file)
            {
                models.push(file.as_path());
            }
        }
        if models.is_empty() {
            return Ok(());
        }
        let stamps: Vec<(PathBuf, Stamp)> = std::iter::once(plugin_file.to_owned())
            .chain(models.iter().flat_map(|model| files_of(model)))
            .map(|file| (file.clone(), Stamp::of(&file)))
            .collect();
        let key = format!("{stamps:?} {:?}", opening.params);
        if self.opened.lock().unwrap_or_else(PoisonError::into_inner).contains(&key) {
            return Ok(());
        }
        match trial(&limits(&models)) {
            Ok(()) => {
                self.opened.lock().unwrap_or_else(PoisonError::into_inner).insert(key);
                Ok(())
            }
            Err(cause) => Err(about(&models, cause)),
        }
    }
}

/// A refusal that names the models.
fn about(models: &[&Path], cause: TrialError) -> VetError {
    let files: Vec<String> = models.iter().map(|model| model.display().to_string()).collect();
    let message = cause.to_string();
    match files.iter().any(|name| message.contains(name)) {
        true => VetError::Trial(cause),
        false => VetError::Files { files, cause },
    }
}

/// The instance that all runs of this process share.
pub(crate) fn vet() -> Arc<dyn Vet> {
    static VET: LazyLock<Arc<ForeignModels>> = LazyLock::new(Arc::default);
    Arc::clone(&*VET) as _
}
