//! What goes wrong, and when.

use std::time::{Duration, Instant};

use panoscope_node::{AnyFormat, Choice, Context, Gray8, GrayF32, Open, Params, Result, Slot, error, random};

/// What goes wrong.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Harm {
    /// Nothing.
    Never,
    /// The call answers with an error.
    Error,
    /// The call panics.
    Panic,
    /// The call does not return for `hang_ms`.
    Hang,
    /// A chunk of a loop on the host's pool does not return for `hang_ms`.
    HangInLoop,
    /// A chunk of a loop in a chunk of a loop does not return for `hang_ms`.
    HangInNestedLoop,
    /// A picture of NaN.
    Nan,
    /// A picture of another size than its input.
    WrongSize,
    /// A picture of another format than its reader takes.
    WrongFormat,
    /// No picture.
    Nothing,
    /// A picture larger than any may be.
    TooMuch,
    /// The call takes `slow_ms`.
    Slow,
    /// Every picture is kept for ever.
    Leak,
    /// The capture time of the tick before. Sources only.
    Repeat,
    /// A capture time before that of the tick before. Sources only.
    Reorder,
    /// Capture times at the ends of what the number holds. Sources only.
    Extreme,
    /// A picture that is kept once is given back twice.
    ReleaseTwice,
    /// The same on a thread of the plugin's own.
    ReleaseTwiceElsewhere,
    /// The call writes to memory that is not there: the process ends.
    Segv,
    /// A chunk of a loop on the host's pool does so.
    SegvInLoop,
    /// Opening does so, whatever the tick.
    SegvInOpen,
    /// The call aborts the process.
    Abort,
    /// The call calls itself until its stack overflows.
    StackOverflow,
    /// The call calls `exit`.
    Exit,
    /// The call calls `_exit`.
    ExitAtOnce,
    /// The call writes to the pixels of its input, which belong to others.
    WildWrite,
    /// The call writes beyond the end of its output, into the frames behind it.
    Overrun,
    /// The call takes memory until there is none.
    OutOfMemory,
    /// The call writes `file`; if it cannot, it fails.
    NewFile,
    /// The call opens a socket; if it cannot, it fails.
    Socket,
}

/// When it goes wrong.
#[derive(Params)]
pub struct Plan {
    /// What goes wrong.
    #[param(default = "never")]
    pub harm: Harm,
    /// First tick that goes wrong.
    #[param(default = 10, range = 0..=1000000000)]
    pub first: u64,
    /// How many ticks in a row go wrong.
    #[param(default = 1, range = 0..=1000000000)]
    pub ticks: u64,
    /// Any later tick goes wrong with this chance too, decided by `seed` and the tick's number.
    #[param(default = 0.0, range = 0.0..=1.0)]
    pub chance: f64,
    /// Another seed, other ticks.
    #[param(default = 0, range = 0..=1000000000)]
    pub seed: u64,
    /// How long a call that hangs does not return.
    #[param(default = 60000.0, range = 0.0..=1000000000.0, unit = "ms")]
    pub hang_ms: f64,
    /// How long a slow call takes.
    #[param(default = 50.0, range = 0.0..=100000.0, unit = "ms")]
    pub slow_ms: f64,
    /// The file that is written.
    #[param(default = "")]
    pub file: String,
    /// How long opening takes.
    #[param(default = 0.0, range = 0.0..=1000000000.0, unit = "ms", reopen)]
    pub open_ms: f64,
}

impl Plan {
    /// What happens at a tick.
    pub fn at(&self, seq: u64) -> Harm {
        let planned = seq >= self.first && seq - self.first < self.ticks;
        let lucky = seq >= self.first && random::unit(random::mix(self.seed) ^ seq) < self.chance;
        if planned || lucky { self.harm } else { Harm::Never }
    }

    /// What goes wrong while a node is opened.
    pub fn open(&self, open: &Open<'_>) {
        if self.harm == Harm::SegvInOpen {
            segv();
        }
        if self.open_ms > 0.0 {
            open.info(&format!("told to open for {} ms", self.open_ms));
            wait(self.open_ms);
        }
    }

    /// Harm that does not depend on what the node makes: it fails, or it takes its time.
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

    /// A picture gone wrong; `false` when this harm is none of the picture.
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

/// Calls itself for ever; every level needs its own piece of the stack.
#[allow(unconditional_recursion, reason = "the stack is to overflow")]
fn deeper(level: u64) -> u64 {
    let piece = std::hint::black_box([level; 64]);
    deeper(piece[7] + 1).wrapping_add(piece[8])
}

/// Does not return for a time.
pub(crate) fn wait(ms: f64) {
    let end = Instant::now() + Duration::from_secs_f64(ms / 1e3);
    while Instant::now() < end {
        std::thread::sleep(Duration::from_millis(1).min(end.saturating_duration_since(Instant::now())));
    }
}
