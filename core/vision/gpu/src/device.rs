//! Finds and opens a device.

use std::sync::{Arc, Mutex, PoisonError};

use crate::items::Items;
use crate::staging::Staging;
use wgpu::{Adapter, Backends, Device, DeviceDescriptor, DeviceType, Instance, InstanceDescriptor, MemoryHints, Queue};

/// Environment variable that chooses a device: a part of its name, or `software` for a software device (for tests).
pub const CHOICE: &str = "PANOSCOPE_GPU";

/// Work that the GPU cannot do.
#[derive(Clone, Debug, thiserror::Error)]
pub enum GpuError {
    /// No device was found.
    #[error(
        "no GPU was found through Vulkan ({found}): install its driver and the Vulkan loader, or set PANOSCOPE_GPU to a part of a device's name"
    )]
    NotFound {
        /// The devices found and why they are not used.
        found: String,
    },
    /// The driver refused to open the device.
    #[error("{name} could not be opened: {reason}")]
    Refused {
        /// The device.
        name: String,
        /// Message of the driver.
        reason: String,
    },
    /// A buffer is too large for the device.
    #[error(
        "{name} takes buffers of at most {limit_bytes} bytes, but {bytes} are needed: use smaller images, or the processor"
    )]
    TooLarge {
        /// The device.
        name: String,
        /// Bytes that are needed.
        bytes: u64,
        /// Bytes that a buffer may have.
        limit_bytes: u64,
    },
    /// A number that names no kernel or buffer, or a step that does not fit it.
    #[error("a step for {name} is wrong: {reason}")]
    Step {
        /// The device.
        name: String,
        /// What is wrong.
        reason: String,
    },
    /// The device failed while it worked.
    #[error("{name} failed: {reason}")]
    Failed {
        /// The device.
        name: String,
        /// Message of the driver.
        reason: String,
    },
}

/// An open device.
#[derive(Debug)]
pub struct Gpu {
    pub(crate) device: Device,
    pub(crate) queue: Queue,
    name: String,
    fault: Arc<Mutex<Option<String>>>,
    pub(crate) items: Items,
    pub(crate) staging: Staging,
}

impl Gpu {
    /// Opens a device. `choice` as in [`CHOICE`]; without one a discrete GPU goes before an integrated one, and a
    /// software device is not used.
    ///
    /// # Errors
    /// [`GpuError::NotFound`] and [`GpuError::Refused`].
    pub fn open(choice: Option<&str>) -> Result<Self, GpuError> {
        let instance = Instance::new(InstanceDescriptor {
            backends: Backends::VULKAN,
            ..InstanceDescriptor::new_without_display_handle()
        });
        let adapters = pollster::block_on(instance.enumerate_adapters(Backends::VULKAN));
        let names: Vec<String> = adapters.iter().map(|adapter| adapter.get_info().name).collect();
        let best =
            adapters.into_iter().filter_map(|adapter| Some((rank(&adapter, choice)?, adapter))).min_by_key(|a| a.0);
        let Some((_, adapter)) = best else {
            let found = match &names[..] {
                [] => "there is none".into(),
                names => format!("{} not taken", names.join(", ")),
            };
            return Err(GpuError::NotFound { found });
        };
        let name = adapter.get_info().name;
        let asked = DeviceDescriptor {
            label: Some("panoscope"),
            required_limits: adapter.limits(),
            memory_hints: MemoryHints::Performance,
            ..DeviceDescriptor::default()
        };
        let refused = |e: wgpu::RequestDeviceError| GpuError::Refused { name: name.clone(), reason: e.to_string() };
        let (device, queue) = pollster::block_on(adapter.request_device(&asked)).map_err(refused)?;
        let fault = Arc::new(Mutex::new(None));
        let note = |fault: &Arc<Mutex<Option<String>>>, reason: String| {
            fault.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(reason);
        };
        let seen = fault.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&seen, error.to_string())));
        let seen = fault.clone();
        device.set_device_lost_callback(move |_, reason| note(&seen, format!("the device was lost: {reason}")));
        Ok(Self { device, queue, name, fault, items: Items::default(), staging: Staging::default() })
    }

    /// Name of the device, as its driver gives it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the failure since the last call, if there was one.
    pub(crate) fn check(&self) -> Result<(), GpuError> {
        match self.fault.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(reason) => Err(self.failed(reason)),
            None => Ok(()),
        }
    }

    /// The error of a failure of the device.
    pub(crate) fn failed(&self, reason: impl std::fmt::Display) -> GpuError {
        GpuError::Failed { name: self.name.clone(), reason: reason.to_string() }
    }

    /// Maximum number of bytes of a buffer that a kernel uses.
    pub(crate) fn max_buffer_bytes(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_buffer_size.min(limits.max_storage_buffer_binding_size)
    }

    /// Checks that a buffer of this size can be used by a kernel.
    pub(crate) fn check_size(&self, bytes: u64) -> Result<(), GpuError> {
        let limit_bytes = self.max_buffer_bytes();
        if bytes > limit_bytes {
            return Err(GpuError::TooLarge { name: self.name.clone(), bytes, limit_bytes });
        }
        Ok(())
    }
}

/// Preference of a device; `None` if it is not usable.
fn rank(adapter: &Adapter, choice: Option<&str>) -> Option<u8> {
    let info = adapter.get_info();
    match choice.map(str::trim).filter(|choice| !choice.is_empty()) {
        Some("software") => (info.device_type == DeviceType::Cpu).then_some(0),
        Some(part) => info.name.to_lowercase().contains(&part.to_lowercase()).then_some(0),
        None => match info.device_type {
            DeviceType::DiscreteGpu => Some(0),
            DeviceType::IntegratedGpu => Some(1),
            DeviceType::VirtualGpu => Some(2),
            DeviceType::Other => Some(3),
            DeviceType::Cpu => None,
        },
    }
}
