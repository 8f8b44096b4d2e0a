//! `device`: owns something that can be had once, as a camera can.

use std::sync::{Mutex, PoisonError};

use panoscope_node::{Context, Node, NodeInfo, Open, Params, Result, error};

use crate::ports::{In, Out};

/// Devices that are open.
static TAKEN: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Which device.
#[derive(Params)]
pub struct Choice {
    /// Its name; `broken` never opens.
    #[param(default = "device", reopen)]
    name: String,
    /// Hands nothing on while it is true, as the driver of an arm would.
    #[param(default = false)]
    emergency_stop: bool,
}

/// Hands pictures on while it holds its device.
pub struct Device(String);

impl Node for Device {
    const INFO: NodeInfo =
        NodeInfo::compute("device", "flow", "Hands pictures on while it holds a device that can be had once.")
            .exclusive();
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Choice;

    fn open(_: &Open<'_>, params: &Choice) -> Result<Self> {
        let mut taken = TAKEN.lock().unwrap_or_else(PoisonError::into_inner);
        if params.name == "broken" {
            return Err(error!("device `broken` does not answer"));
        }
        if taken.contains(&params.name) {
            return Err(error!("device `{}` is in use", params.name));
        }
        taken.push(params.name.clone());
        Ok(Self(params.name.clone()))
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Choice) -> Result<()> {
        if params.emergency_stop {
            return Ok(());
        }
        out.image.forward(input.image.frame())
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        TAKEN.lock().unwrap_or_else(PoisonError::into_inner).retain(|name| *name != self.0);
    }
}
