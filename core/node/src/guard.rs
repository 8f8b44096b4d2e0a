//! Keeps panics on this side of the contract, with their words and place.

use std::any::Any;
use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

thread_local! {
    /// How many guards stand on this thread's stack.
    static DEPTH: Cell<u32> = const { Cell::new(0) };
    /// Where the last guarded panic of this thread happened, left by the hook.
    static PLACE: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// A panic that a guard stopped.
pub(crate) struct Caught {
    payload: Box<dyn Any + Send>,
    place: Option<String>,
}

impl Caught {
    /// Place and words, for the user.
    pub(crate) fn text(&self) -> String {
        let words = self
            .payload
            .downcast_ref::<&str>()
            .copied()
            .or_else(|| self.payload.downcast_ref::<String>().map(String::as_str))
            .unwrap_or("no message");
        match &self.place {
            Some(place) => format!("panicked at {place}: {words}"),
            None => format!("panicked: {words}"),
        }
    }

    /// Continues the panic on this thread. The hook is not called again: the place travels along.
    pub(crate) fn resume(self) -> ! {
        PLACE.with(|slot| *slot.borrow_mut() = self.place);
        std::panic::resume_unwind(self.payload)
    }

    /// Drops the payload; one whose drop panics must not cross the boundary.
    pub(crate) fn discard(self) {
        let Self { payload, .. } = self;
        if let Err(second) = catch_unwind(AssertUnwindSafe(move || drop(payload))) {
            std::mem::forget(second);
        }
    }
}

/// One guard on this thread's stack. It remembers where the count is: a plugin looks its thread-locals up by a call.
struct Depth(*const Cell<u32>);

impl Depth {
    #[inline]
    fn enter() -> Self {
        DEPTH.with(|depth| {
            depth.set(depth.get() + 1);
            Self(depth)
        })
    }
}

impl Drop for Depth {
    #[inline]
    fn drop(&mut self) {
        // SAFETY: a guard is dropped by the thread that made it, whose count needs no drop and lives as long as the thread.
        let depth = unsafe { &*self.0 };
        depth.set(depth.get() - 1);
    }
}

/// Runs `body`; a panic in it is stopped here and not printed.
#[inline]
pub(crate) fn catch<R>(body: impl FnOnce() -> R) -> Result<R, Caught> {
    let depth = Depth::enter();
    let result = catch_unwind(AssertUnwindSafe(body));
    drop(depth);
    result.map_err(caught)
}

#[cold]
fn caught(payload: Box<dyn Any + Send>) -> Caught {
    Caught { payload, place: PLACE.with(|slot| slot.borrow_mut().take()) }
}

/// Makes the panic hook remember the place of guarded panics instead of printing them: the host tells the user. Panics elsewhere
/// (in a test, in a thread of the plugin's own) go to the hook that stood before.
pub fn install_panic_hook() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if DEPTH.with(Cell::get) == 0 {
                return before(info);
            }
            let place = info.location().map(|l| format!("{}:{}", l.file(), l.line()));
            PLACE.with(|slot| *slot.borrow_mut() = place);
        }));
    });
}
