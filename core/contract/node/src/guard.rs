//! Stops panics before they cross the ABI, and records their message and location.

use std::any::Any;
use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

thread_local! {
    /// Number of guards on this thread's stack.
    static DEPTH: Cell<u32> = const { Cell::new(0) };
    /// Location of the last guarded panic of this thread, written by the hook.
    static LOCATION: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// A panic that a guard stopped.
pub(crate) struct Caught {
    payload: Box<dyn Any + Send>,
    location: Option<String>,
}

impl Caught {
    /// Location and message, for the user.
    pub(crate) fn text(&self) -> String {
        let message = self
            .payload
            .downcast_ref::<&str>()
            .copied()
            .or_else(|| self.payload.downcast_ref::<String>().map(String::as_str))
            .unwrap_or("no message");
        match &self.location {
            Some(location) => format!("panicked at {location}: {message}"),
            None => format!("panicked: {message}"),
        }
    }

    /// Continues the panic on this thread. The hook is not called again, so the location is stored for the next guard.
    pub(crate) fn resume(self) -> ! {
        LOCATION.with(|slot| *slot.borrow_mut() = self.location);
        std::panic::resume_unwind(self.payload)
    }

    /// Drops the payload. A panic in its destructor is stopped too.
    pub(crate) fn discard(self) {
        let Self { payload, .. } = self;
        if let Err(second) = catch_unwind(AssertUnwindSafe(move || drop(payload))) {
            std::mem::forget(second);
        }
    }
}

/// One guard on this thread's stack. It stores the counter's address, because a plugin needs a function call for each
/// thread-local access.
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
        // SAFETY: `catch` drops the guard on the thread that created it; that thread's counter needs no drop and lives as long as the thread.
        let depth = unsafe { &*self.0 };
        depth.set(depth.get() - 1);
    }
}

/// Runs `body`; a panic in it is returned as an error and not printed.
#[inline]
pub(crate) fn catch<R>(body: impl FnOnce() -> R) -> Result<R, Caught> {
    let depth = Depth::enter();
    let result = catch_unwind(AssertUnwindSafe(body));
    drop(depth);
    result.map_err(caught)
}

#[cold]
fn caught(payload: Box<dyn Any + Send>) -> Caught {
    Caught { payload, location: LOCATION.with(|slot| slot.borrow_mut().take()) }
}

/// Makes the panic hook record the location of guarded panics instead of printing them: the host reports them. Other
/// panics (in a test, in a thread that the plugin started) go to the previous hook.
pub fn install_panic_hook() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let previous = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if DEPTH.with(Cell::get) == 0 {
                return previous(info);
            }
            let location = info.location().map(|l| format!("{}:{}", l.file(), l.line()));
            LOCATION.with(|slot| *slot.borrow_mut() = location);
        }));
    });
}
