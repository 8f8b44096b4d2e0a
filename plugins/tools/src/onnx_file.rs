//! Checks an ONNX file before ONNX Runtime opens it: which other files it reads, how deeply it nests, how much work it is.
//!
//! An ONNX file may name other files for its weights. Only files in the model's own folder are accepted, or those that a host appended to the model
//! itself ([`panoscope_base::onnx::bundle_header`]).

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use panoscope_base::onnx;
use panoscope_base::onnx::work::{self, TooMuch};

/// Maximum size of a file in this format, bytes.
const MAX_BYTES: u64 = 2 << 30;

/// Why a model file is refused.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum OnnxFileError {
    /// The file cannot be read.
    #[error("cannot read the model {path}: {source}; name an .onnx file with `model`", path = path.display())]
    Read { path: PathBuf, source: std::io::Error },
    /// The file is too large for the format.
    #[error("{path} has {bytes} bytes, which exceed the limit of {MAX_BYTES} for an ONNX file", path = path.display())]
    TooLarge { path: PathBuf, bytes: u64 },
    /// The file is not ONNX, or is truncated.
    #[error("{path} is malformed or truncated: {reason} at byte {offset}; copy or export it again", path = path.display())]
    Malformed { path: PathBuf, reason: &'static str, offset: usize },
    /// Opening it would take too long.
    #[error("{path} would keep ONNX Runtime busy: {reason}; export it again, simplified (onnxsim), or use another model", path = path.display())]
    TooMuch { path: PathBuf, reason: TooMuch },
    /// Weights are outside the model's folder.
    #[error("{path} reads its weights from `{location}`, which is outside its folder: put the weights into the folder of the model", path = path.display())]
    Outside { path: PathBuf, location: String },
    /// A file of weights is missing.
    #[error("{path} reads its weights from `{location}`, which does not exist: copy both files", path = path.display())]
    MissingWeights { path: PathBuf, location: String },
}

/// A checked model file.
#[derive(Debug)]
pub struct OnnxFile {
    /// Bytes of the model itself.
    pub bytes: Vec<u8>,
    /// Name and bytes of the weight files that were appended to it.
    pub weights: Vec<(String, Arc<[u8]>)>,
    /// Whether part of its weights is in files next to it.
    pub has_weights_beside: bool,
}

/// Reads and checks the file.
///
/// # Errors
/// See [`OnnxFileError`]: also when the file names files outside its folder.
pub fn read(path: &Path) -> Result<OnnxFile, OnnxFileError> {
    let failed = |source| OnnxFileError::Read { path: path.to_owned(), source };
    let about = std::fs::metadata(path).map_err(failed)?;
    // A device or a pipe has no length, and reading it need not end.
    if !about.is_file() {
        return Err(failed(std::io::Error::other("it is not a regular file")));
    }
    let bytes = about.len();
    if bytes > MAX_BYTES {
        return Err(OnnxFileError::TooLarge { path: path.to_owned(), bytes });
    }
    let mut data = std::fs::read(path).map_err(failed)?;
    let malformed =
        |onnx::Malformed { reason, offset }| OnnxFileError::Malformed { path: path.to_owned(), reason, offset };
    let bundle = onnx::unbundle(&data).map_err(malformed)?;
    let locations = onnx::weight_files(&data[..bundle.model_len]).map_err(malformed)?;
    work::check(&data[..bundle.model_len]).map_err(|reason| match reason {
        TooMuch::Malformed(reason) => malformed(reason),
        reason => OnnxFileError::TooMuch { path: path.to_owned(), reason },
    })?;
    let weights: Vec<(String, Arc<[u8]>)> =
        bundle.weights.into_iter().map(|(name, range)| (name, Arc::from(&data[range]))).collect();
    data.truncate(bundle.model_len);
    let mut has_weights_beside = false;
    for location in locations {
        if weights.iter().any(|(name, _)| *name == location) {
            continue;
        }
        has_weights_beside = true;
        let folder = path.parent().unwrap_or(Path::new(""));
        let inside =
            !location.is_empty() && Path::new(&location).components().all(|c| matches!(c, Component::Normal(_)));
        if !inside {
            return Err(OnnxFileError::Outside { path: path.to_owned(), location });
        }
        // Links count by where they lead.
        let (Ok(real), Ok(home)) = (folder.join(&location).canonicalize(), path.canonicalize()) else {
            return Err(OnnxFileError::MissingWeights { path: path.to_owned(), location });
        };
        if !home.parent().is_some_and(|home| real.starts_with(home)) {
            return Err(OnnxFileError::Outside { path: path.to_owned(), location });
        }
    }
    Ok(OnnxFile { bytes: data, weights, has_weights_beside })
}
