//! Frames that nodes keep beyond a call: counted per instance, so that a leak has a name and an end.

use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use panoscope_abi::BufferId;

use crate::ending::who::Who;
use crate::memory::memory;

thread_local! {
    /// A frame was kept on this thread since [`kept_more`] was last asked.
    static KEPT_MORE: Cell<bool> = const { Cell::new(false) };
    static KEEPER: Cell<*const Inner> = const { Cell::new(std::ptr::null()) };
}

/// A buffer was given back outside every call: whose it was cannot be told.
static STRAY_RELEASE: AtomicBool = AtomicBool::new(false);

#[derive(Default)]
struct Inner {
    count: AtomicUsize,
    ids: Mutex<Vec<BufferId>>,
    /// The node that the instance belongs to.
    who: OnceLock<Arc<Who>>,
}

/// What one instance keeps.
#[derive(Default)]
pub(crate) struct Kept(Box<Inner>);

/// Ends what [`Kept::enter`] began.
pub(crate) struct Keeper {
    before: *const Inner,
}

impl Drop for Keeper {
    fn drop(&mut self) {
        KEEPER.with(|k| k.set(self.before));
    }
}

impl Kept {
    /// From now on retained and released frames of this thread are this instance's. The guard must not outlive `self`.
    #[inline]
    pub fn enter(&self) -> Keeper {
        Keeper { before: KEEPER.with(|k| k.replace(&raw const *self.0)) }
    }

    /// Says whose instance this is.
    pub fn belongs_to(&self, who: &Arc<Who>) {
        let _ = self.0.who.set(Arc::clone(who));
    }

    /// The node that the instance belongs to.
    pub fn who(&self) -> Arc<Who> {
        self.0.who.get().cloned().unwrap_or_default()
    }

    /// Frames kept now.
    #[inline]
    pub fn count(&self) -> usize {
        self.0.count.load(Ordering::Relaxed)
    }

    /// Gives back what a closed instance left behind.
    pub fn reclaim(&self) {
        let ids = std::mem::take(&mut *self.0.ids.lock().unwrap_or_else(PoisonError::into_inner));
        self.0.count.store(0, Ordering::Relaxed);
        // A stray release may have been one of these: releasing it again would take a frame from somebody else.
        if !STRAY_RELEASE.load(Ordering::Relaxed) {
            for id in ids {
                memory().release(id);
            }
        }
    }
}

/// Whether a node kept a frame on this thread since the last question: only then may it keep too many.
#[inline]
pub(crate) fn kept_more() -> bool {
    KEPT_MORE.replace(false)
}

fn with_keeper(act: impl FnOnce(&Inner)) -> bool {
    let inner = KEEPER.with(Cell::get);
    // SAFETY: set by `enter`, whose guard does not outlive the instance.
    match unsafe { inner.as_ref() } {
        Some(inner) => {
            act(inner);
            true
        }
        None => false,
    }
}

/// A node keeps a buffer.
pub(crate) fn retain(id: BufferId) {
    memory().retain(id);
    with_keeper(|kept| {
        kept.ids.lock().unwrap_or_else(PoisonError::into_inner).push(id);
        kept.count.fetch_add(1, Ordering::Relaxed);
        KEPT_MORE.set(true);
    });
}

/// A node gives a buffer back.
pub(crate) fn release(id: BufferId) {
    let known = with_keeper(|kept| {
        let mut ids = kept.ids.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = ids.iter().rposition(|known| *known == id) {
            ids.swap_remove(at);
            kept.count.fetch_sub(1, Ordering::Relaxed);
        }
    });
    if !known {
        STRAY_RELEASE.store(true, Ordering::Relaxed);
    }
    memory().release(id);
}
