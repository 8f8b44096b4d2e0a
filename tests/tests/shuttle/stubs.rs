//! Stubs of the neighbours of the sources under test.

/// Clock that does not advance.
pub mod clock {
    pub fn now_ns() -> u64 {
        1
    }
}

/// Reports no crash.
pub mod current_node {
    #[derive(Clone, Copy)]
    pub struct CurrentWork;

    pub fn current_work() -> CurrentWork {
        CurrentWork
    }

    pub fn help<R>(_: CurrentWork, work: impl FnOnce() -> R) -> R {
        work()
    }
}

/// Replays nothing.
pub mod decide {
    use panoscope_abi::Tick;

    pub struct Wanted {
        pub tick: Tick,
        pub inputs: Vec<Option<(u32, u64)>>,
    }
}

pub mod outbox {
    pub use panoscope_engine::panic_words;
}

/// Retains no frame.
pub mod retained {
    #[derive(Clone, Copy)]
    pub struct Scope;

    pub fn scope() -> Scope {
        Scope
    }

    /// # Safety
    /// None is needed: it keeps nothing.
    pub unsafe fn within(_: Scope, work: impl FnOnce()) -> bool {
        work();
        false
    }

    pub fn set_attention() {}
}

pub mod scratch {
    #[derive(Default)]
    pub struct Scratch(());
}
