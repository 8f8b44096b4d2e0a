//! What runs a network: the processor, or an execution provider of ONNX Runtime for a GPU or another accelerator.

use std::path::Path;

use ort::ep;
use ort::session::builder::SessionBuilder;
use panoscope_node::{Choice, Open};

/// Execution providers by name. If ONNX Runtime cannot use one here, the processor runs the network.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Provider {
    /// The processor.
    Cpu,
    /// CUDA, on NVIDIA GPUs.
    Cuda,
    /// TensorRT, on NVIDIA GPUs: builds an engine when the model opens, which takes minutes.
    Tensorrt,
    /// OpenVINO, on processors and GPUs of Intel.
    Openvino,
    /// ROCm, on AMD GPUs.
    Rocm,
    /// MIGraphX, on AMD GPUs: builds an engine when the model opens.
    Migraphx,
}

impl Provider {
    /// Name in ONNX Runtime's documentation.
    pub fn title(self) -> &'static str {
        match self {
            Self::Cpu => "the processor",
            Self::Cuda => "CUDA",
            Self::Tensorrt => "TensorRT",
            Self::Openvino => "OpenVINO",
            Self::Rocm => "ROCm",
            Self::Migraphx => "MIGraphX",
        }
    }

    /// Warns that the processor runs the network at `path`, if there is a `reason`.
    pub fn warn_if_refused(self, open: &Open<'_>, path: &Path, reason: Option<&str>) {
        if let Some(reason) = reason {
            open.warn(&format!(
                "{} cannot run {} ({reason}); using the processor. Name an ONNX Runtime with that provider in ORT_DYLIB_PATH, or set `provider = \"cpu\"`",
                self.title(),
                path.display()
            ));
        }
    }

    /// Adds the provider to a session that is being built.
    ///
    /// # Errors
    /// ONNX Runtime's library has no such provider, or finds no device for it.
    pub fn register(self, builder: &mut SessionBuilder) -> ort::Result<()> {
        let chosen = match self {
            Self::Cpu => return Ok(()),
            Self::Cuda => ep::CUDA::default().build(),
            Self::Tensorrt => ep::TensorRT::default().build(),
            Self::Openvino => ep::OpenVINO::default().build(),
            Self::Rocm => ep::ROCm::default().build(),
            Self::Migraphx => ep::MIGraphX::default().build(),
        };
        chosen.register(builder)
    }
}
