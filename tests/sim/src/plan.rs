//! Parameters of a simulated node: how it misbehaves, and when.

use std::time::Duration;

use crate::world::thread;
use panoscope_node::{AnyFormat, Choice, Context, Gray8, GrayF32, Image, Parallel, Params, Result, Slot, error};

use crate::harm::Harm;
use crate::observe::{Seen, observe};

/// Parameters of a simulated node.
#[derive(Params)]
pub struct Plan {
    /// Number of the values that change between two ticks.
    #[param(default = 0, range = 0..=65535)]
    pub live: u64,
    /// Number of the values that reopen the node.
    #[param(default = 0, range = 0..=65535, reopen)]
    pub reopened: u64,
    /// Kind of misbehaviour.
    #[param(default = "never")]
    pub harm: Harm,
    /// First tick with misbehaviour.
    #[param(default = 10, range = 0..=1000000000)]
    pub first: u64,
    /// Number of consecutive ticks with misbehaviour.
    #[param(default = 1, range = 0..=1000000000)]
    pub ticks: u64,
    /// Duration of a call that hangs.
    #[param(default = 60000.0, range = 0.0..=1000000000.0, unit = "ms")]
    pub hang_ms: f64,
    /// Duration of a call.
    #[param(default = 0.0, range = 0.0..=100000.0, unit = "ms")]
    pub cost_ms: f64,
    /// Duration of opening.
    #[param(default = 0.0, range = 0.0..=1000000000.0, unit = "ms", reopen)]
    pub open_ms: f64,
    /// Whether opening fails.
    #[param(default = false, reopen)]
    pub refuses: bool,
    /// Nesting depth of the parallel loops that write a frame: 0, 1 or 2.
    #[param(default = 0, range = 0..=2)]
    pub loops: u64,
    /// Time between two ticks of a source.
    #[param(default = 10.0, range = 0.001..=100000.0, unit = "ms")]
    pub period_ms: f64,
    /// Width of a source's frames.
    #[param(default = 20, range = 1..=1000, unit = "px")]
    pub width_px: u64,
    /// Height of a source's frames.
    #[param(default = 16, range = 1..=1000, unit = "px")]
    pub height_px: u64,
    /// Capture time of a source's first tick.
    #[param(default = "zero")]
    pub begin: Begin,
}

/// Capture time of a source's first tick.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// 0.
    Zero,
    /// The minimum that is accepted.
    Lowest,
    /// Slightly below the maximum that is accepted.
    Highest,
}

/// Blocks for a time.
pub fn wait_ms(ms: f64) {
    thread::sleep(Duration::from_secs_f64(ms / 1e3));
}

impl Plan {
    /// Number that identifies the values in a frame.
    pub fn values(&self) -> u32 {
        (self.reopened as u32) << 16 | self.live as u32
    }

    /// Misbehaviour at a tick; records it.
    pub fn begin_harm(&self, node: &str, seq: u64) -> Harm {
        let harm = if seq >= self.first && seq - self.first < self.ticks { self.harm } else { Harm::Never };
        if harm != Harm::Never {
            observe(Seen::Harmed { node: node.to_owned(), seq: Some(seq), harm });
        }
        harm
    }

    /// Misbehaves in ways that do not depend on the node's output.
    pub fn suffer(&self, cx: &Context<'_>, harm: Harm) -> Result<()> {
        let (seq, pool) = (cx.tick().seq, cx.pool());
        match harm {
            // What follows from opening, closing and states begins with a fault.
            Harm::Error | Harm::RefuseOpen | Harm::HangInOpen | Harm::HangInClose => {
                return Err(error!("told to fail at tick {seq}"));
            }
            Harm::Panic => panic!("told to panic at tick {seq}"),
            Harm::Hang => wait_ms(self.hang_ms),
            Harm::HangInLoop => pool.run(4, &|_| wait_ms(self.hang_ms)),
            Harm::HangInNestedLoop => pool.run(2, &|_| pool.run(8, &|_| wait_ms(self.hang_ms))),
            Harm::Slow => wait_ms(self.hang_ms),
            _ => {}
        }
        Ok(())
    }

    /// Misuses the frames of others.
    pub fn mishandle(&self, harm: Harm, image: &Image<'_, Gray8>) {
        match harm {
            Harm::Leak => std::mem::forget(image.retain()),
            Harm::ReleaseTwice => {
                let kept = image.retain();
                // SAFETY: none: this is the misuse that the host has to survive.
                let twin = unsafe { std::ptr::read(&raw const kept) };
                drop((kept, twin));
            }
            _ => {}
        }
    }

    /// Makes a bad frame; returns `false` when this misbehaviour does not concern the frame.
    pub fn spoil(&self, harm: Harm, out: &mut Slot<'_, AnyFormat>, width: usize, height: usize) -> Result<bool> {
        match harm {
            Harm::Nan | Harm::WrongFormat => {
                let value = if harm == Harm::Nan { f32::NAN } else { 0.5 };
                let mut plane = out.alloc_as::<GrayF32>(width, height)?;
                for y in 0..height {
                    plane.row_mut(y).fill(value);
                }
            }
            Harm::TooMuch => out.alloc_as::<GrayF32>(16384, 16384)?.row_mut(0).fill(0.0),
            Harm::Nothing => {}
            _ => return Ok(false),
        }
        Ok(true)
    }
}
