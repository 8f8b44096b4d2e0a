//! The parameter by which nodes choose between the processor and the GPU.

use std::sync::Arc;

use panoscope_imaging::Report;
use panoscope_node::Choice;

use crate::device::{Gpu, GpuError};

/// Device that computes the images of a node.
#[derive(Choice, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// The processor.
    #[default]
    Cpu,
    /// The GPU, through Vulkan.
    Gpu,
}

impl Device {
    /// Opens the device; `None` for the processor and, after a warning, if there is no GPU.
    pub fn open<T>(self, report: &dyn Report, new: impl FnOnce(Arc<Gpu>) -> Result<T, GpuError>) -> Option<T> {
        if self == Self::Cpu {
            return None;
        }
        let opened = Gpu::shared().and_then(|gpu| {
            let name = gpu.name().to_owned();
            Ok((new(gpu)?, name))
        });
        match opened {
            Ok((kernel, name)) => {
                report.info(&format!("computes on {name}"));
                Some(kernel)
            }
            Err(error) => {
                report.warn(&given_up(&error));
                None
            }
        }
    }
}

/// The warning of a node that continues without the GPU.
pub fn given_up(reason: &dyn std::fmt::Display) -> String {
    format!("the processor computes the images: {reason}")
}
