//! `chaos_life` and `chaos_device` forward frames, `chaos_camera` makes them. They hang not in a tick but before and after: while opening, closing,
//! or handing over a state.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use panoscope_node::{
    Choice, Context, Gray8, Image, NoPorts, Node, NodeInfo, Open, Parallel, Params, Ports, Result, Slot, error,
};

use crate::harm::wait;

/// How often a node of each name was opened.
static OPENED: Mutex<Option<HashMap<String, u64>>> = Mutex::new(None);

/// Call that hangs.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hangs {
    /// No call.
    Never,
    /// Opening.
    Open,
    /// A chunk of a loop on the host's pool, while it opens.
    OpenInLoop,
    /// Opening, unless two threads of the host's pool meet in a loop.
    OpenAlone,
    /// Closing.
    Close,
    /// Saving a state.
    Save,
    /// Taking a state over.
    Load,
}

/// Returns when two chunks of a loop ran at the same time, after at most `max_ms` for each.
fn meet(pool: &dyn Parallel, max_ms: f64) {
    let arrived = AtomicU32::new(0);
    let end = Instant::now() + Duration::from_secs_f64(max_ms * 1e-3);
    pool.run(2, &|_| {
        arrived.fetch_add(1, Ordering::AcqRel);
        while arrived.load(Ordering::Acquire) < 2 && Instant::now() < end {
            std::thread::yield_now();
        }
    });
}

/// What hangs or fails, and when.
#[derive(Params)]
pub struct Life {
    /// Call that does not return for `hang_ms`.
    #[param(default = "never", reopen)]
    hangs: Hangs,
    /// Duration of the hang.
    #[param(default = 60000.0, range = 0.0..=1000000000.0, unit = "ms", reopen)]
    hang_ms: f64,
    /// This many openings of nodes of this name in the process return at once.
    #[param(default = 0, range = 0..=1000000000, reopen)]
    quick_opens: u64,
    /// This many openings after these do not return in time; later ones do.
    #[param(default = 1000000000, range = 0..=1000000000, reopen)]
    slow_opens: u64,
    /// Tick that fails, once; 0 for none.
    #[param(default = 0, range = 0..=1000000000, reopen)]
    fails_at: u64,
    /// A change of this number reopens the node.
    #[param(default = 0, range = 0..=1000000000, reopen)]
    #[allow(dead_code, reason = "only its change matters")]
    turn: u64,
}

/// One gray frame.
#[derive(Ports)]
pub struct In<'f> {
    /// The frame to forward.
    image: Image<'f, Gray8>,
}

/// The forwarded frame.
#[derive(Ports)]
pub struct Out<'f> {
    /// The same buffer as the input.
    image: Slot<'f, Gray8>,
}

struct Instance {
    hangs: Hangs,
    hang_ms: f64,
    fails_at: u64,
}

impl Instance {
    fn open(open: &Open<'_>, life: &Life) -> Self {
        let number = {
            let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
            let count = opened.get_or_insert_default().entry(open.node_id().to_owned()).or_default();
            *count += 1;
            *count
        };
        let slow = (life.quick_opens + 1..=life.quick_opens + life.slow_opens).contains(&number);
        match life.hangs {
            Hangs::Open if slow => wait(life.hang_ms),
            Hangs::OpenInLoop if slow => open.pool().run(16, &|_| wait(life.hang_ms)),
            Hangs::OpenAlone if slow => meet(open.pool(), life.hang_ms),
            _ => {}
        }
        Self { hangs: life.hangs, hang_ms: life.hang_ms, fails_at: life.fails_at }
    }

    fn fail(&self, cx: &Context<'_>) -> Result<()> {
        if self.fails_at > 0 && cx.tick().seq == self.fails_at {
            return Err(error!("told to fail at tick {}", self.fails_at));
        }
        Ok(())
    }

    fn process(&mut self, cx: &Context<'_>, input: &In<'_>, out: &mut Out<'_>) -> Result<()> {
        self.fail(cx)?;
        out.image.forward(input.image.frame())
    }

    fn save(&self) -> Option<Vec<u8>> {
        if self.hangs == Hangs::Save {
            wait(self.hang_ms);
        }
        Some(vec![1])
    }

    fn load(&self) {
        if self.hangs == Hangs::Load {
            wait(self.hang_ms);
        }
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if self.hangs == Hangs::Close {
            wait(self.hang_ms);
        }
    }
}

/// A node that may be open together with its replacement.
pub struct ChaosLife(Instance);

impl Node for ChaosLife {
    const INFO: NodeInfo =
        NodeInfo::compute("chaos_life", "flow", "Does not return from opening or closing, on request.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Life;

    fn open(open: &Open<'_>, life: &Life) -> Result<Self> {
        Ok(Self(Instance::open(open, life)))
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, _: &Life) -> Result<()> {
        self.0.process(cx, &input, &mut out)
    }

    fn save_state(&self) -> Option<Vec<u8>> {
        self.0.save()
    }

    fn load_state(&mut self, _: &[u8]) -> Result<()> {
        self.0.load();
        Ok(())
    }
}

/// A node that must be closed before its replacement opens.
pub struct ChaosDevice(Instance);

impl Node for ChaosDevice {
    const INFO: NodeInfo =
        NodeInfo::compute("chaos_device", "flow", "As `chaos_life`, but closed before its successor opens.")
            .exclusive();
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Life;

    fn open(open: &Open<'_>, life: &Life) -> Result<Self> {
        Ok(Self(Instance::open(open, life)))
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, _: &Life) -> Result<()> {
        self.0.process(cx, &input, &mut out)
    }

    fn save_state(&self) -> Option<Vec<u8>> {
        self.0.save()
    }

    fn load_state(&mut self, _: &[u8]) -> Result<()> {
        self.0.load();
        Ok(())
    }
}

/// Output of the source.
#[derive(Ports)]
pub struct Made<'f> {
    /// A black frame.
    image: Slot<'f, Gray8>,
}

/// A source; its position is saved when it fails.
pub struct ChaosCamera(Instance);

impl Node for ChaosCamera {
    const INFO: NodeInfo =
        NodeInfo::compute("chaos_camera", "source", "As `chaos_life`, but a source, 200 frames per second.").source();
    type In<'f> = NoPorts;
    type Out<'f> = Made<'f>;
    type Params = Life;

    fn open(open: &Open<'_>, life: &Life) -> Result<Self> {
        Ok(Self(Instance::open(open, life)))
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Made<'f>, _: &Life) -> Result<()> {
        self.0.fail(cx)?;
        cx.set_capture_ns(cx.tick().seq as i64 * 5_000_000);
        let mut plane = out.image.alloc(16, 8)?;
        for y in 0..plane.height {
            plane.row_mut(y).fill(0);
        }
        Ok(())
    }

    fn save_state(&self) -> Option<Vec<u8>> {
        self.0.save()
    }

    fn load_state(&mut self, _: &[u8]) -> Result<()> {
        self.0.load();
        Ok(())
    }
}
