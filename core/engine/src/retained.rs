//! Frames that nodes keep beyond a call: counted per instance, so that a leak has a name and an end, and so that nobody gives back what
//! it does not hold.

use std::cell::Cell;
use std::ffi::c_void;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};

use panoscope_abi::BufferId;

use crate::ending::who::Who;
use crate::memory::memory;

thread_local! {
    /// A frame was kept, or a request refused, on this thread since [`attention`] was last asked.
    static ATTENTION: Cell<bool> = const { Cell::new(false) };
    static KEEPER: Cell<*const Inner> = const { Cell::new(std::ptr::null()) };
}

/// Every instance that ever kept a frame: where a buffer is given back outside the calls of its instance, its owner is looked for here.
static KEEPERS: Mutex<Vec<Weak<Inner>>> = Mutex::new(Vec::new());
/// What plugins keep outside every call, for example on threads of their own.
static OUTSIDE: Mutex<Vec<(Plugin, BufferId)>> = Mutex::new(Vec::new());
/// Requests refused outside every call.
static REFUSED_OUTSIDE: AtomicU64 = AtomicU64::new(0);

/// A plugin: the address where its file is mapped. 0 when it is not known.
pub(crate) type Plugin = usize;

/// The plugin that an address lies in.
pub(crate) fn plugin_of(address: *const c_void) -> Plugin {
    // SAFETY: plain data, filled by the call below.
    let mut info: libc::Dl_info = unsafe { std::mem::zeroed() };
    // SAFETY: any address may be asked for.
    let known = unsafe { libc::dladdr(address, &raw mut info) } != 0;
    if known { info.dli_fbase as usize } else { 0 }
}

#[derive(Default)]
struct Inner {
    count: AtomicUsize,
    ids: Mutex<Vec<BufferId>>,
    /// The node that the instance belongs to.
    who: OnceLock<Arc<Who>>,
    /// An address of the plugin.
    address: usize,
    /// Buffers that it kept or gave back without holding them, since somebody last asked.
    refused: AtomicU32,
    /// It is among the [`KEEPERS`].
    listed: AtomicBool,
}

impl Inner {
    fn ids(&self) -> MutexGuard<'_, Vec<BufferId>> {
        self.ids.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a buffer off the list; `false` when it is not there.
    fn take(&self, id: BufferId) -> bool {
        let mut ids = self.ids();
        let Some(at) = ids.iter().rposition(|known| *known == id) else { return false };
        ids.swap_remove(at);
        self.count.fetch_sub(1, Ordering::Relaxed);
        true
    }

    fn plugin(&self) -> Plugin {
        plugin_of(self.address as *const c_void)
    }
}

/// What one instance keeps.
pub(crate) struct Kept(Arc<Inner>);

/// The instance whose call runs on a thread; for loops that are run by several threads.
#[derive(Clone, Copy)]
pub(crate) struct Scope(*const Inner);

/// Ends what [`Kept::during`] began, even in an unwinding call.
struct Restore(*const Inner);

impl Drop for Restore {
    fn drop(&mut self) {
        KEEPER.with(|k| k.set(self.0));
    }
}

impl Kept {
    /// For an instance of the plugin that `address` lies in.
    pub fn new(address: *const c_void) -> Self {
        Self(Arc::new(Inner { address: address as usize, ..Inner::default() }))
    }

    /// Frames retained and released on this thread within `call` are this instance's.
    #[inline]
    pub fn during<R>(&self, call: impl FnOnce() -> R) -> R {
        let _restore = Restore(KEEPER.with(|k| k.replace(Arc::as_ptr(&self.0))));
        call()
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

    /// How often the instance kept or gave back what it did not hold, since the last call.
    pub fn take_refused(&self) -> u32 {
        self.0.refused.swap(0, Ordering::Relaxed)
    }

    /// Gives back what a closed instance left behind.
    pub fn reclaim(&self) {
        let ids = std::mem::take(&mut *self.0.ids());
        self.0.count.store(0, Ordering::Relaxed);
        for id in ids {
            memory().release(id);
        }
    }
}

/// The instance whose call runs on this thread.
pub(crate) fn scope() -> Scope {
    Scope(KEEPER.with(Cell::get))
}

/// Runs a part of a call of `scope` on another thread than its own; answers whether the call is to be looked at, see [`attention`].
///
/// # Safety
/// The instance that `scope` stands for lives until this returns.
pub(crate) unsafe fn within(scope: Scope, part: impl FnOnce()) -> bool {
    let before = ATTENTION.replace(false);
    let restore = Restore(KEEPER.with(|k| k.replace(scope.0)));
    part();
    drop(restore);
    ATTENTION.replace(before)
}

/// Whether a node kept a frame on this thread, or was refused something, since the last call: only then is there anything to look at.
#[inline]
pub(crate) fn attention() -> bool {
    ATTENTION.replace(false)
}

/// Has the call on this thread looked at when it ends.
pub(crate) fn set_attention() {
    ATTENTION.set(true);
}

/// How many requests were refused outside every call, since the process began.
pub(crate) fn refused_outside() -> u64 {
    REFUSED_OUTSIDE.load(Ordering::Relaxed)
}

fn keeper<'a>() -> Option<&'a Inner> {
    // SAFETY: set by `during` and `within`, for no longer than the instance lives.
    unsafe { KEEPER.with(Cell::get).as_ref() }
}

#[cold]
fn refuse() {
    match keeper() {
        Some(inner) => {
            inner.refused.fetch_add(1, Ordering::Relaxed);
            set_attention();
        }
        None => _ = REFUSED_OUTSIDE.fetch_add(1, Ordering::Relaxed),
    }
}

#[cold]
fn list(inner: &Inner) {
    // SAFETY: every `Inner` lives in the `Arc` of a `Kept`, made by `Kept::new`; the count is raised for the new `Arc`, of which only a
    // `Weak` stays.
    let weak = unsafe {
        Arc::increment_strong_count(inner);
        Arc::downgrade(&Arc::from_raw(inner))
    };
    let mut keepers = KEEPERS.lock().unwrap_or_else(PoisonError::into_inner);
    keepers.retain(|k| k.strong_count() > 0);
    keepers.push(weak);
}

/// A node, or a thread of `plugin`, keeps a buffer. One that nobody holds is not kept: it may be somebody else's by the next call.
pub(crate) fn retain(plugin: Plugin, id: BufferId) {
    if !memory().retain_held(id) {
        return refuse();
    }
    let Some(inner) = keeper() else {
        return OUTSIDE.lock().unwrap_or_else(PoisonError::into_inner).push((plugin, id));
    };
    if !inner.listed.swap(true, Ordering::Relaxed) {
        list(inner);
    }
    inner.ids().push(id);
    inner.count.fetch_add(1, Ordering::Relaxed);
    set_attention();
}

/// A node, or a thread of `plugin`, gives a buffer back: its own, or one that another instance of the same plugin keeps. Any other is not
/// touched.
pub(crate) fn release(plugin: Plugin, id: BufferId) {
    let inner = keeper();
    if inner.is_some_and(|inner| inner.take(id)) || take_elsewhere(inner.map_or(plugin, Inner::plugin), id) {
        memory().release(id);
    } else {
        refuse();
    }
}

/// Takes a buffer off the list of an instance of a plugin, or of what the plugin keeps outside every call; `false` when it keeps none. A
/// plugin that is not known may be any.
#[cold]
fn take_elsewhere(plugin: Plugin, id: BufferId) -> bool {
    let same = |other: Plugin| plugin == 0 || other == 0 || plugin == other;
    let mut outside = OUTSIDE.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(at) = outside.iter().rposition(|(owner, known)| same(*owner) && *known == id) {
        outside.swap_remove(at);
        return true;
    }
    drop(outside);
    let keepers = KEEPERS.lock().unwrap_or_else(PoisonError::into_inner);
    let keepers: Vec<_> = keepers.iter().filter_map(Weak::upgrade).collect();
    keepers.iter().any(|keeper| same(keeper.plugin()) && keeper.take(id))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::memory::FrameRef;
    use panoscope_abi::Frame;

    /// Two plugins, as far as addresses go: this program and the C library.
    fn plugins() -> [*const c_void; 2] {
        [plugins as *const c_void, libc::malloc as *const c_void]
    }

    /// A buffer that the host holds.
    fn frame() -> (FrameRef, BufferId) {
        let (buffer, data) = memory().allocate(64).expect("memory");
        // SAFETY: the one reference of a new buffer.
        (unsafe { FrameRef::adopt(Frame { buffer, data, len: 64, ..Frame::EMPTY }) }, buffer)
    }

    #[test]
    fn what_was_never_kept_is_not_given_back() {
        let (held, id) = frame();
        let [ours, theirs] = plugins().map(Kept::new);
        ours.during(|| release(0, id));
        assert_eq!((memory().references(id), ours.take_refused()), (1, 1), "the host's own reference stays");
        assert!(attention(), "the call is looked at");
        ours.during(|| retain(0, id));
        theirs.during(|| release(0, id));
        assert_eq!((memory().references(id), theirs.take_refused()), (2, 1), "another plugin's is not touched");
        ours.during(|| release(0, id));
        ours.during(|| release(0, id));
        assert_eq!((memory().references(id), ours.take_refused()), (1, 1), "once is enough");
        drop(held);
        ours.during(|| retain(0, id));
        assert_eq!((memory().references(id), ours.take_refused()), (0, 1), "what nobody holds cannot be kept");
    }

    #[test]
    fn a_release_outside_every_call_takes_nothing_twice() {
        let (held, id) = frame();
        let plugin = plugin_of(plugins()[0]);
        let [ours, theirs] = plugins().map(Kept::new);
        for kept in [&ours, &theirs] {
            kept.during(|| retain(0, id));
        }
        release(plugin, id);
        assert_eq!((memory().references(id), ours.count(), theirs.count()), (2, 0, 1), "that of the same plugin");
        let before = refused_outside();
        release(plugin, id);
        assert_eq!(memory().references(id), 2);
        assert!(refused_outside() > before);
        ours.reclaim();
        assert_eq!(memory().references(id), 2, "it was given back already");
        theirs.reclaim();
        assert_eq!(memory().references(id), 1, "what others leave behind is taken back as before");
        retain(plugin, id);
        release(plugin, id);
        assert_eq!(memory().references(id), 1, "kept and given back by a thread of the plugin");
        drop(held);
    }
}
