//! Frames that nodes retain between calls. They are counted per instance, so that leaks are found and stopped, and no
//! node can release a frame that it does not hold.

use std::cell::Cell;
use std::ffi::c_void;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, Weak};

use panoscope_abi::BufferId;

use crate::current_node::NodeNames;
use crate::memory::memory;
use crate::sync::lock;

thread_local! {
    /// Whether a frame was retained, or a request refused, on this thread since the last call of [`attention`].
    static ATTENTION: Cell<bool> = const { Cell::new(false) };
    static KEEPER: Cell<*const Inner> = const { Cell::new(std::ptr::null()) };
}

/// Every instance that ever retained a frame, to find the owner of a buffer that is released outside its instance's
/// calls.
static KEEPERS: Mutex<Vec<Weak<Inner>>> = Mutex::new(Vec::new());
/// Buffers that plugins retain outside every call, for example on their own threads.
static OUTSIDE: Mutex<Vec<(Plugin, BufferId)>> = Mutex::new(Vec::new());
/// Requests refused outside every call.
static REFUSED_OUTSIDE: AtomicU64 = AtomicU64::new(0);

/// Frames that one instance, or all plugins outside every call, may retain at any moment. The limit between calls is
/// lower and is checked after each call.
const MAX_AT_ONCE: usize = 4096;

/// A plugin: the address where its file is mapped, 0 if unknown.
pub(crate) type Plugin = usize;

/// The plugin that an address lies in.
pub(crate) fn plugin_of(address: *const c_void) -> Plugin {
    // SAFETY: plain data, filled by the call below.
    let mut info: libc::Dl_info = unsafe { std::mem::zeroed() };
    // SAFETY: `dladdr` accepts any address.
    let known = unsafe { libc::dladdr(address, &raw mut info) } != 0;
    if known { info.dli_fbase as usize } else { 0 }
}

#[derive(Default)]
struct Inner {
    count: AtomicUsize,
    ids: Mutex<Vec<BufferId>>,
    /// The node that the instance belongs to.
    who: OnceLock<Arc<NodeNames>>,
    /// Address inside the plugin's mapped file.
    address: usize,
    /// Refused requests since [`RetainedFrames::take_refused`] was called last.
    refused: AtomicU32,
    /// Whether it is in [`KEEPERS`].
    listed: AtomicBool,
}

impl Inner {
    fn ids(&self) -> MutexGuard<'_, Vec<BufferId>> {
        lock(&self.ids)
    }

    /// Removes a buffer from the list; `false` if it is not there.
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

/// The frames that one instance retains.
pub(crate) struct RetainedFrames(Arc<Inner>);

/// The instance whose call runs on a thread, for loops that several threads run.
#[derive(Clone, Copy)]
pub(crate) struct Scope(*const Inner);

/// Ends [`RetainedFrames::during`] on drop, also when the call unwinds.
struct Restore(*const Inner);

impl Drop for Restore {
    fn drop(&mut self) {
        KEEPER.with(|k| k.set(self.0));
    }
}

impl RetainedFrames {
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

    /// Sets the node that the instance belongs to.
    pub fn belongs_to(&self, who: &Arc<NodeNames>) {
        let _ = self.0.who.set(Arc::clone(who));
    }

    /// The node that the instance belongs to.
    pub fn who(&self) -> Arc<NodeNames> {
        self.0.who.get().cloned().unwrap_or_default()
    }

    /// Number of frames retained now.
    #[inline]
    pub fn count(&self) -> usize {
        self.0.count.load(Ordering::Relaxed)
    }

    /// Requests refused since the last call.
    pub fn take_refused(&self) -> u32 {
        self.0.refused.swap(0, Ordering::Relaxed)
    }

    /// Releases the frames that a closed instance still retained.
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

/// Runs a part of a call of `scope` on another thread. Returns whether to check the call, see [`attention`].
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

/// Whether a node retained a frame on this thread, or was refused one, since the last call. Otherwise there is nothing
/// to check.
#[inline]
pub(crate) fn attention() -> bool {
    ATTENTION.replace(false)
}

/// Requests a check of the call on this thread when it ends.
pub(crate) fn set_attention() {
    ATTENTION.set(true);
}

/// Requests refused outside every call since the process started.
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
    // SAFETY: every `Inner` lives in the `Arc` of a `RetainedFrames`, made by `RetainedFrames::new`; the count is raised for the new `Arc`, of which only a
    // `Weak` stays.
    let weak = unsafe {
        Arc::increment_strong_count(inner);
        Arc::downgrade(&Arc::from_raw(inner))
    };
    let mut keepers = lock(&KEEPERS);
    keepers.retain(|k| k.strong_count() > 0);
    keepers.push(weak);
}

/// A node, or a thread of `plugin`, retains a buffer. Refused if no one holds the buffer, because it may get another
/// owner, and beyond [`MAX_AT_ONCE`], because a node could otherwise exhaust memory and overflow the buffer's count.
pub(crate) fn retain(plugin: Plugin, id: BufferId) {
    let inner = keeper();
    let held = inner.map_or_else(|| lock(&OUTSIDE).len(), |inner| inner.count.load(Ordering::Relaxed));
    if held >= MAX_AT_ONCE || !memory().retain_held(id) {
        return refuse();
    }
    let Some(inner) = inner else {
        return lock(&OUTSIDE).push((plugin, id));
    };
    if !inner.listed.swap(true, Ordering::Relaxed) {
        list(inner);
    }
    inner.ids().push(id);
    inner.count.fetch_add(1, Ordering::Relaxed);
    set_attention();
}

/// A node, or a thread of `plugin`, releases a buffer: its own, or one that another instance of the same plugin
/// retains. Other buffers are refused.
pub(crate) fn release(plugin: Plugin, id: BufferId) {
    let inner = keeper();
    if inner.is_some_and(|inner| inner.take(id)) || take_elsewhere(inner.map_or(plugin, Inner::plugin), id) {
        memory().release(id);
    } else {
        refuse();
    }
}

/// Removes a buffer from the list of an instance of a plugin, or from what the plugin retains outside every call;
/// `false` if it is in none. An unknown plugin matches all.
#[cold]
fn take_elsewhere(plugin: Plugin, id: BufferId) -> bool {
    let same = |other: Plugin| plugin == 0 || other == 0 || plugin == other;
    let mut outside = lock(&OUTSIDE);
    if let Some(at) = outside.iter().rposition(|(owner, known)| same(*owner) && *known == id) {
        outside.swap_remove(at);
        return true;
    }
    drop(outside);
    let keepers = lock(&KEEPERS);
    let keepers: Vec<_> = keepers.iter().filter_map(Weak::upgrade).collect();
    keepers.iter().any(|keeper| same(keeper.plugin()) && keeper.take(id))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::memory::FrameRef;
    use panoscope_abi::Frame;

    /// Addresses of two "plugins": this program and the C library, by a function that no sanitizer replaces.
    fn plugins() -> [*const c_void; 2] {
        [plugins as *const c_void, libc::gnu_get_libc_version as *const c_void]
    }

    /// A buffer that the host holds.
    fn frame() -> (FrameRef, BufferId) {
        let (buffer, data) = memory().allocate(64).expect("memory");
        // SAFETY: the one reference of a new buffer.
        (unsafe { FrameRef::adopt(Frame { buffer, data, len: 64, ..Frame::EMPTY }) }, buffer)
    }

    #[test]
    fn no_call_retains_without_end() {
        let (held, id) = frame();
        let ours = RetainedFrames::new(plugins()[0]);
        ours.during(|| (0..MAX_AT_ONCE + 10).for_each(|_| retain(0, id)));
        assert_eq!((ours.count(), ours.take_refused()), (MAX_AT_ONCE, 10));
        assert_eq!(memory().references(id), MAX_AT_ONCE as u32 + 1);
        ours.reclaim();
        assert_eq!(memory().references(id), 1);
        drop(held);
    }

    #[test]
    fn what_was_never_kept_is_not_given_back() {
        let (held, id) = frame();
        let [ours, theirs] = plugins().map(RetainedFrames::new);
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
        assert_eq!(
            (memory().references(id), ours.take_refused()),
            (0, 1),
            "a buffer that nobody holds cannot be retained"
        );
    }

    #[test]
    fn a_release_outside_every_call_takes_nothing_twice() {
        let (held, id) = frame();
        let plugin = plugin_of(plugins()[0]);
        let [ours, theirs] = plugins().map(RetainedFrames::new);
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
        assert_eq!(memory().references(id), 2, "it was released already");
        theirs.reclaim();
        assert_eq!(memory().references(id), 1, "frames of a closed instance are released");
        retain(plugin, id);
        release(plugin, id);
        assert_eq!(memory().references(id), 1, "retained and released by a thread of the plugin");
        drop(held);
    }
}
