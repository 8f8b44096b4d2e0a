//! Kinds of misbehaviour, and when they occur.

use std::time::{Duration, Instant};

use panoscope_node::{AnyFormat, Choice, Context, Gray8, GrayF32, Open, Params, Result, Slot, error, random};

/// Kind of misbehaviour.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Harm {
    /// Nothing.
    Never,
    /// The call returns an error.
    Error,
    /// The call panics.
    Panic,
    /// The call does not return for `hang_ms`.
    Hang,
    /// A chunk of a parallel loop on the host's pool does not return for `hang_ms`.
    HangInLoop,
    /// A chunk of a nested parallel loop does not return for `hang_ms`.
    HangInNestedLoop,
    /// A frame of NaN.
    Nan,
    /// A frame of another size than its input.
    WrongSize,
    /// A frame of another format than its reader accepts.
    WrongFormat,
    /// No frame.
    Nothing,
    /// A frame larger than the maximum.
    TooMuch,
    /// The call takes `slow_ms`.
    Slow,
    /// Every frame is kept forever.
    Leak,
    /// The capture time of the previous tick. Sources only.
    Repeat,
    /// A capture time before that of the previous tick. Sources only.
    Reorder,
    /// Capture times at the limits of the integer. Sources only.
    Extreme,
    /// A frame that is retained once is released twice.
    ReleaseTwice,
    /// The same on a thread of the plugin.
    ReleaseTwiceElsewhere,
    /// The call writes to unmapped memory: the process ends.
    Segv,
    /// A chunk of a parallel loop on the host's pool does so.
    SegvInLoop,
    /// Opening does so, whatever the tick.
    SegvInOpen,
    /// The call aborts the process.
    Abort,
    /// The call recurses until its stack overflows.
    StackOverflow,
    /// The call calls `exit`.
    Exit,
    /// The call calls `_exit`.
    ExitAtOnce,
    /// The call writes to the pixels of its input, which belong to others.
    WildWrite,
    /// The call writes beyond the end of its output, into the frames behind it.
    Overrun,
    /// The call allocates memory until there is none.
    OutOfMemory,
    /// The call writes `file`; it fails if that is not possible.
    NewFile,
    /// The call opens a socket; it fails if that is not possible.
    Socket,
}

/// Which misbehaviour occurs, and when.
#[derive(Params)]
pub struct Plan {
    /// Kind of misbehaviour.
    #[param(default = "never")]
    pub harm: Harm,
    /// First tick with misbehaviour.
    #[param(default = 10, range = 0..=1000000000)]
    pub first: u64,
    /// Number of consecutive ticks with misbehaviour.
    #[param(default = 1, range = 0..=1000000000)]
    pub ticks: u64,
    /// Probability of misbehaviour in each later tick, decided by `seed` and the tick's number.
    #[param(default = 0.0, range = 0.0..=1.0)]
    pub chance: f64,
    /// Seed that selects the later ticks.
    #[param(default = 0, range = 0..=1000000000)]
    pub seed: u64,
    /// Duration of a call that hangs.
    #[param(default = 60000.0, range = 0.0..=1000000000.0, unit = "ms")]
    pub hang_ms: f64,
    /// Duration of a slow call.
    #[param(default = 50.0, range = 0.0..=100000.0, unit = "ms")]
    pub slow_ms: f64,
    /// File to write.
    #[param(default = "")]
    pub file: String,
    /// Duration of opening.
    #[param(default = 0.0, range = 0.0..=1000000000.0, unit = "ms", reopen)]
    pub open_ms: f64,
}

impl Plan {
    /// Misbehaviour at a tick.
    pub fn at(&self, seq: u64) -> Harm {
        let planned = seq >= self.first && seq - self.first < self.ticks;
        let lucky = seq >= self.first && random::unit(random::mix(self.seed) ^ seq) < self.chance;
        if planned || lucky { self.harm } else { Harm::Never }
    }

    /// Misbehaves while a node is opened.
    pub fn open(&self, open: &Open<'_>) {
        if self.harm == Harm::SegvInOpen {
            segv();
        }
        if self.open_ms > 0.0 {
            open.info(&format!("told to open for {} ms", self.open_ms));
            wait(self.open_ms);
        }
    }

    /// Misbehaves in ways that do not depend on the node's output: fails, or takes its time.
    pub fn suffer(&self, cx: &Context<'_>, harm: Harm) -> Result<()> {
        let seq = cx.tick().seq;
        match harm {
            Harm::Error => return Err(error!("told to fail at tick {seq}")),
            Harm::Panic => panic!("told to panic at tick {seq}"),
            Harm::Hang => wait(self.hang_ms),
            Harm::HangInLoop => {
                use panoscope_node::Parallel;
                cx.pool().run(4, &|_| wait(self.hang_ms));
            }
            Harm::HangInNestedLoop => {
                use panoscope_node::Parallel;
                let pool = cx.pool();
                pool.run(2, &|_| pool.run(16, &|_| wait(self.hang_ms)));
            }
            Harm::Slow => wait(self.slow_ms),
            Harm::Segv => segv(),
            Harm::SegvInLoop => {
                use panoscope_node::Parallel;
                cx.pool().run(4, &|_| segv());
            }
            Harm::Abort => std::process::abort(),
            Harm::StackOverflow => {
                std::hint::black_box(deeper(seq));
            }
            Harm::Exit => std::process::exit(3),
            // SAFETY: ends the process, which is what was asked for.
            Harm::ExitAtOnce => unsafe { _exit(0) },
            Harm::NewFile => {
                std::fs::write(&self.file, "new")
                    .map_err(|cause| error!("{} cannot be written: {cause}", self.file))?;
            }
            Harm::Socket => {
                let socket = std::net::UdpSocket::bind("127.0.0.1:0");
                socket.map_err(|cause| error!("a socket cannot be opened: {cause}"))?;
            }
            Harm::OutOfMemory => loop {
                std::mem::forget(std::hint::black_box(Vec::<u8>::with_capacity(16 << 20)));
            },
            _ => {}
        }
        Ok(())
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
            Harm::WrongSize => out.alloc_as::<Gray8>(width / 2 + 1, height + 3)?.row_mut(0).fill(0),
            Harm::Overrun => {
                let mut plane = out.alloc_as::<Gray8>(width, height)?;
                let data = plane.row_mut(0).as_mut_ptr();
                // SAFETY: none: the bytes behind the picture belong to other frames.
                unsafe { data.write_bytes(0xEE, 4 * width * height) };
            }
            Harm::TooMuch => out.alloc_as::<GrayF32>(16384, 16384)?.row_mut(0).fill(0.0),
            Harm::Nothing => {}
            _ => return Ok(false),
        }
        Ok(true)
    }
}

unsafe extern "C" {
    fn _exit(code: std::ffi::c_int) -> !;
}

fn segv() {
    // SAFETY: none, on purpose: nothing is mapped at that address, and the crash is what the test asks for.
    unsafe { std::ptr::without_provenance_mut::<u8>(0xbad).write_volatile(1) };
}

/// Recurses forever; every level needs its own part of the stack.
#[allow(unconditional_recursion, reason = "the stack is to overflow")]
fn deeper(level: u64) -> u64 {
    let piece = std::hint::black_box([level; 64]);
    deeper(piece[7] + 1).wrapping_add(piece[8])
}

/// Blocks for a time.
pub(crate) fn wait(ms: f64) {
    let end = Instant::now() + Duration::from_secs_f64(ms / 1e3);
    while Instant::now() < end {
        std::thread::sleep(Duration::from_millis(1).min(end.saturating_duration_since(Instant::now())));
    }
}
