//! Exposure, gain and white balance of a V4L2 device.

use std::fs::{File, OpenOptions};
use std::os::fd::AsRawFd;
use std::path::Path;

use super::demands::Lock;

/// Layout of `struct v4l2_control`.
#[repr(C)]
struct Control {
    id: u32,
    value: i32,
}

/// `VIDIOC_G_CTRL` and `VIDIOC_S_CTRL`: read and write, 8 bytes, type `V`, numbers 27 and 28.
const GET: libc::c_ulong = 0xC008_561B;
const SET: libc::c_ulong = 0xC008_561C;

const AUTO_WHITE_BALANCE: u32 = 0x0098_090C;
const GAIN: u32 = 0x0098_0913;
const WHITE_BALANCE_TEMPERATURE: u32 = 0x0098_091A;
const EXPOSURE_AUTO: u32 = 0x009A_0901;
const EXPOSURE_ABSOLUTE: u32 = 0x009A_0902;
/// `V4L2_EXPOSURE_MANUAL`.
const MANUAL: i32 = 1;

/// The controls of a device. Another program or stream may have the device open.
pub struct Controls(File);

impl Controls {
    /// Opens the device; `None` when it is gone.
    pub fn open(device: &Path) -> Option<Self> {
        OpenOptions::new().read(true).write(true).open(device).ok().map(Self)
    }

    fn call(&self, request: libc::c_ulong, control: &mut Control) -> bool {
        // SAFETY: the descriptor is open as long as `self`; both requests take one `v4l2_control`, which `control` is.
        unsafe { libc::ioctl(self.0.as_raw_fd(), request, std::ptr::from_mut(control)) == 0 }
    }

    fn get(&self, id: u32) -> Option<f64> {
        let mut control = Control { id, value: 0 };
        (self.call(GET, &mut control) && control.value > 0).then(|| f64::from(control.value))
    }

    fn set(&self, id: u32, value: i32) -> bool {
        self.call(SET, &mut Control { id, value })
    }

    /// Values that the automatic controls have chosen.
    pub fn automatic_values(&self) -> Lock {
        let gain = self.get(GAIN).unwrap_or(0.0);
        Lock {
            exposure: self.get(EXPOSURE_ABSOLUTE).map(|exposure| (exposure, gain)),
            white_balance_k: self.get(WHITE_BALANCE_TEMPERATURE),
        }
    }

    /// Switches the automatic controls off and sets `lock`. Returns whether the driver accepted all values.
    pub fn apply(&self, lock: Lock) -> bool {
        let mut is_accepted = true;
        if let Some((exposure, gain)) = lock.exposure {
            is_accepted &= self.set(EXPOSURE_AUTO, MANUAL);
            is_accepted &= self.set(EXPOSURE_ABSOLUTE, exposure as i32);
            if gain > 0.0 {
                is_accepted &= self.set(GAIN, gain as i32);
            }
        }
        if let Some(temperature) = lock.white_balance_k {
            is_accepted &= self.set(AUTO_WHITE_BALANCE, 0);
            is_accepted &= self.set(WHITE_BALANCE_TEMPERATURE, temperature as i32);
        }
        is_accepted
    }
}
