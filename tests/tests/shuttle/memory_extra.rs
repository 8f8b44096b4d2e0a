/// The model has only private memory.
mod domain {
    use super::Backing;

    pub struct Domain;
    pub struct DomainError;
    pub struct SharedFrames;
    pub(super) struct Shared;

    impl Shared {
        pub const fn new() -> Self {
            Self
        }

        pub fn with_backing<R>(&self, _: u32, work: impl FnOnce(Backing) -> R) -> Option<R> {
            Some(work(Backing::Private))
        }
    }
}

/// The model has no GPU.
mod device {
    pub struct DeviceMemory;
    pub type OpenDevice = ();
    pub fn device_table() {}
    pub fn open_device_by() {}
}

mod homes {
    pub(crate) fn in_use() -> bool {
        false
    }

    pub(crate) fn lost() -> u64 {
        0
    }
}

impl Memory {
    fn drop_device_copy(&self, _: BufferId) {}

    fn fetch(&self, _: &Frame) -> bool {
        true
    }

    /// A separate memory for every interleaving that is tried.
    pub fn fresh(limit_bytes: i64) -> Self {
        Memory {
            pools: [const { OnceLock::new() }; MAX_POOLS],
            current: AtomicU32::new(PRIVATE),
            shared: Shared::new(),
            in_use_bytes: AtomicI64::new(0),
            limit_bytes: AtomicI64::new(limit_bytes),
        }
    }
}
