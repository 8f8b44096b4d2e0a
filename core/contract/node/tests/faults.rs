//! Errors, panics, retained frames and saved state of a node.

use panoscope_node::abi;
use panoscope_node::harness::{Harness, HarnessError, Level, Setup};
use panoscope_node::*;

type TestResult = std::result::Result<(), HarnessError>;

/// What goes wrong.
#[derive(Choice, Clone, Copy, PartialEq)]
enum Trouble {
    /// Nothing.
    None,
    /// An error with a cause.
    Error,
    /// A panic with an index in it.
    Panic,
    /// A panic in a chunk of a loop.
    ChunkPanic,
    /// A panic whose payload is not text.
    OddPanic,
    /// `open` fails.
    Open,
    /// `open` panics.
    OpenPanic,
    /// More outputs than the memory holds.
    Memory,
    /// `close` panics.
    Close,
    /// `save_state` panics.
    Save,
}

#[derive(Params)]
struct TroubleParams {
    /// What goes wrong.
    #[param(default = "none")]
    trouble: Trouble,
    /// What goes wrong in `open` or `close`.
    #[param(default = "none", reopen)]
    at_open: Trouble,
}

#[derive(Ports)]
struct Out<'f> {
    /// Chunk numbers, each at its index.
    chunks: Slot<'f, Gray16>,
}

struct Troubled {
    trouble: Trouble,
    calls: u64,
}

impl Drop for Troubled {
    fn drop(&mut self) {
        assert!(self.trouble != Trouble::Close, "closing went wrong");
    }
}

impl Node for Troubled {
    const INFO: NodeInfo = NodeInfo::compute("troubled", "filter", "Fails as asked.").source();
    type In<'f> = NoPorts;
    type Out<'f> = Out<'f>;
    type Params = TroubleParams;

    fn open(_: &Open<'_>, params: &TroubleParams) -> Result<Self> {
        match params.at_open {
            Trouble::Open => Err(error!("no device at {}", "/dev/video7")),
            Trouble::OpenPanic => panic!("nobody home"),
            trouble => Ok(Self { trouble, calls: 0 }),
        }
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Out<'f>, params: &TroubleParams) -> Result<()> {
        self.trouble = if self.trouble == Trouble::Close { Trouble::Close } else { params.trouble };
        self.calls += 1;
        match params.trouble {
            Trouble::Error => {
                let digits = "12x".parse::<u32>();
                digits.map_err(|cause| error!("the serial line answered nonsense: {cause}"))?;
            }
            Trouble::Panic => {
                let list = [1, 2, 3];
                let index = cx.tick().seq as usize + 3;
                let _ = list[index];
            }
            Trouble::ChunkPanic => cx.pool().run(100, &|chunk| assert!(chunk % 40 != 20, "chunk {chunk} is bad")),
            Trouble::OddPanic => std::panic::panic_any(17_u8),
            Trouble::Memory => {
                out.chunks.alloc(4, 4)?;
                out.chunks.alloc(8, 8)?;
            }
            _ => {
                let mut made = out.chunks.alloc(100, 1)?;
                let (row, pool) = (std::sync::Mutex::new(made.row_mut(0)), *cx.pool());
                // A nested loop.
                pool.run(10, &|tens| {
                    pool.run(10, &|ones| {
                        let chunk = tens * 10 + ones;
                        row.lock().expect("no panic here")[chunk] = chunk as u16;
                    });
                });
            }
        }
        Ok(())
    }

    fn save_state(&self) -> Option<Vec<u8>> {
        assert!(self.trouble != Trouble::Save, "saving went wrong");
        (self.calls > 0).then(|| self.calls.to_le_bytes().to_vec())
    }

    fn load_state(&mut self, state: &[u8]) -> Result<()> {
        self.calls = u64::from_le_bytes(state.try_into().map_err(|_| error!("8 bytes were expected"))?);
        Ok(())
    }
}

fn fails(toml: &str) -> (Option<abi::Status>, String) {
    let error = match Harness::<Troubled>::open(Setup::new(toml).threads(3)) {
        Ok(mut node) => node.process().err(),
        Err(error) => Some(error),
    };
    error.map_or((None, String::new()), |e| (e.status(), e.to_string()))
}

#[test]
fn errors_carry_their_message() {
    let (status, words) = fails("params.trouble = \"error\"");
    assert_eq!(status, Some(abi::STATUS_ERROR));
    assert_eq!(
        words,
        "process returned STATUS_ERROR: the serial line answered nonsense: invalid digit found in string"
    );
    let (status, words) = fails("params.at_open = \"open\"");
    assert_eq!((status, &*words), (Some(abi::STATUS_ERROR), "open returned STATUS_ERROR: no device at /dev/video7"));
}

#[test]
fn panics_carry_message_and_location() {
    for (trouble, words) in [
        ("trouble = \"panic\"", "index out of bounds: the len is 3 but the index is 3"),
        ("trouble = \"chunk_panic\"", "chunk 20 is bad"),
        ("trouble = \"odd_panic\"", "no message"),
        ("at_open = \"open_panic\"", "nobody home"),
    ] {
        let (status, text) = fails(&format!("params.{trouble}"));
        assert_eq!(status, Some(abi::STATUS_PANIC), "{trouble}");
        assert!(text.contains("panicked at ") && text.contains("faults.rs:"), "{text}");
        assert!(text.ends_with(words), "{text}");
    }
}

#[test]
fn a_node_that_failed_can_go_on() -> TestResult {
    let mut node = Harness::<Troubled>::from_toml("params.trouble = \"panic\"")?;
    assert!(node.process().is_err());
    node.set_params("")?;
    assert_eq!(node.process()?.plane::<Gray16>("chunks")?.data[99], 99);
    node.reopen()?;
    assert!(node.save_state()?.is_none(), "a new instance has no calls behind it");
    Ok(())
}

#[test]
fn exhausted_memory_has_its_own_status() -> TestResult {
    let mut node = Harness::<Troubled>::from_toml("params.trouble = \"memory\"")?;
    assert!(node.process().is_ok(), "a second alloc replaces the first");
    let error = node.limit_buffers(1).process().err();
    assert_eq!(error.as_ref().and_then(HarnessError::status), Some(abi::STATUS_EXHAUSTED));
    let words = error.map(|e| e.to_string()).unwrap_or_default();
    assert_eq!(words, "process returned STATUS_EXHAUSTED: the host's frame memory is exhausted (128 bytes requested)");
    Ok(())
}

#[test]
fn a_panic_in_close_stays_inside() -> TestResult {
    drop(Harness::<Troubled>::from_toml("params.at_open = \"close\"")?);
    Ok(())
}

#[test]
fn chunks_are_the_same_for_any_number_of_threads() -> TestResult {
    let expected: Vec<u16> = (0..100).collect();
    for threads in [1, 2, 8] {
        let mut node = Harness::<Troubled>::open(Setup::new("").threads(threads))?;
        assert_eq!(node.process()?.plane::<Gray16>("chunks")?.data, expected);
    }
    Ok(())
}

#[test]
fn state_is_handed_over() -> TestResult {
    let mut old = Harness::<Troubled>::from_toml("")?;
    assert_eq!(old.save_state()?, None);
    old.process()?;
    old.process()?;
    let state = old.save_state()?.unwrap_or_default();
    assert_eq!(state, 2_u64.to_le_bytes());
    let mut new = Harness::<Troubled>::from_toml("")?;
    new.load_state(&state)?;
    new.process()?;
    assert_eq!(new.save_state()?, Some(3_u64.to_le_bytes().to_vec()));
    assert_eq!(new.load_state(&[1]).unwrap_err().status(), Some(abi::STATUS_ERROR));
    new.set_params("params.trouble = \"save\"")?;
    new.process()?;
    assert_eq!(new.save_state().unwrap_err().status(), Some(abi::STATUS_PANIC));
    Ok(())
}

#[derive(Ports)]
struct KeepIn<'f> {
    /// Picture.
    image: Image<'f, Gray8>,
}

#[derive(Ports)]
struct KeepOut<'f> {
    /// The picture of the tick before.
    before: Slot<'f, Gray8>,
}

#[derive(Params)]
struct KeepParams {
    /// Whether the retained frame is leaked instead of released.
    #[param(default = false)]
    forget: bool,
}

struct Keep {
    before: Option<Retained<Gray8>>,
}

impl Node for Keep {
    const INFO: NodeInfo = NodeInfo::compute("keep", "filter", "One tick late.");
    type In<'f> = KeepIn<'f>;
    type Out<'f> = KeepOut<'f>;
    type Params = KeepParams;

    fn open(_: &Open<'_>, _: &KeepParams) -> Result<Self> {
        Ok(Self { before: None })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: KeepIn<'f>, mut out: KeepOut<'f>, p: &KeepParams) -> Result<()> {
        if let Some(before) = self.before.replace(input.image.retain()) {
            cx.metric("mean", f64::from(before.view().data[0]));
            out.before.forward(before.frame())?;
            if p.forget {
                cx.warn("forgetting");
                std::mem::forget(before);
            }
        }
        Ok(())
    }
}

#[test]
fn a_frame_can_be_retained_beyond_the_call() -> TestResult {
    let mut node = Harness::<Keep>::from_toml("")?;
    assert!(node.input_image::<Gray8>("image", 1, 1, &[10]).process()?.is_empty("before")?);
    assert_eq!(node.kept_buffers(), 1);
    for last in 11..15 {
        let out = node.input_image::<Gray8>("image", 1, 1, &[last]).process()?;
        assert_eq!(out.plane::<Gray8>("before")?.data, [last - 1]);
        assert_eq!(node.metric("mean"), Some(f64::from(last - 1)));
    }
    assert_eq!((node.kept_buffers(), node.copies(), node.allocated_bytes()), (1, 0, 0));
    Ok(())
}

#[test]
#[should_panic(expected = "still holds 1 frames: every `retain` needs a `release`")]
fn a_leaked_frame_fails_the_test() {
    let mut node = Harness::<Keep>::from_toml("params.forget = true").expect("opens");
    for gray in 0..2 {
        node.input_image::<Gray8>("image", 1, 1, &[gray]).process().expect("runs");
    }
    assert_eq!(node.logs()[0].level, Level::Warn);
}
