//! Work of the nodes on the GPU.

pub mod below;
pub mod colors;
pub mod fit;

use panoscope_imaging::Report;
use panoscope_node::Result;
use panoscope_node::device::{Device, Gpu, given_up};

/// What a node does on the device that its parameter `device` names.
#[derive(Debug)]
pub struct OnDevice<T> {
    device: Device,
    /// `None` for the processor, without a GPU, and after the GPU failed.
    work: Option<T>,
}

impl<T> Default for OnDevice<T> {
    fn default() -> Self {
        Self { device: Device::Cpu, work: None }
    }
}

impl<T> OnDevice<T> {
    /// Opens the device if the parameter has changed; warns if it cannot be opened.
    pub fn choose(&mut self, device: Device, report: &dyn Report, new: impl FnOnce(Gpu) -> Result<T>) {
        if device != self.device {
            self.device = device;
            self.work = device.open(report, new);
        }
    }

    /// What is done on the GPU.
    pub fn get(&self) -> Option<&T> {
        self.work.as_ref()
    }

    /// Whether `job` was done on the GPU. If it fails, warns and leaves all further jobs to the processor.
    pub fn attempt(&mut self, report: &dyn Report, job: impl FnOnce(&mut T) -> Result<()>) -> bool {
        let Some(work) = &mut self.work else { return false };
        let done = job(work);
        if let Err(reason) = &done {
            report.warn(&given_up(reason));
            self.work = None;
        }
        done.is_ok()
    }
}
