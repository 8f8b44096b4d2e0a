//! Data set by a change of the graph and read by the running call: policy, parameter values, a new instance.
//!
//! The fields are private: every writer advances the [`ConfigEpoch`] of the node, so that a running call cannot miss a
//! change.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use panoscope_graph::OnFault;

use crate::instance::Instance;
use crate::params::{InForce, Snapshot};
use crate::rate;
use crate::sync::lock;

/// Maximum budget: 100 days, which does not overflow a clock in ns.
pub(crate) const MAX_BUDGET_NS: u64 = 100 * 24 * 3600 * 1_000_000_000;

/// Incremented when parameters, instance or policy change. A call that sees the same epoch skips all three checks.
pub(crate) struct ConfigEpoch(AtomicU64);

impl ConfigEpoch {
    /// A new `Exec` has epoch 0, so its first call reads everything.
    pub fn new() -> Self {
        Self(AtomicU64::new(1))
    }

    #[inline]
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Acquire)
    }

    fn advance(&self) {
        self.0.fetch_add(1, Ordering::Release);
    }
}

/// An instance that waits for the next call, and the values it was opened with if they are new.
type Replacement = (Instance, Option<Arc<Snapshot>>);

/// Policy, values and new instance of a node; see the module.
pub(crate) struct Config {
    on_fault: AtomicU8,
    /// Time budget of a call, ns; 0 for none.
    budget_ns: AtomicU64,
    /// Minimum capture time between two calls, ns; 0 for none.
    period_ns: AtomicI64,
    values: InForce,
    replacement: Mutex<Option<Replacement>>,
    has_replacement: AtomicBool,
}

impl Config {
    pub fn new(snapshot: Arc<Snapshot>) -> Self {
        Self {
            on_fault: AtomicU8::new(0),
            budget_ns: AtomicU64::new(0),
            period_ns: AtomicI64::new(0),
            values: InForce::new(snapshot),
            replacement: Mutex::new(None),
            has_replacement: AtomicBool::new(false),
        }
    }

    /// Sets what the host does about faults, slow calls and frequent ticks; in force from the next tick on.
    pub fn set_policy(&self, epoch: &ConfigEpoch, on_fault: OnFault, budget_ms: Option<f64>, max_rate_hz: Option<f64>) {
        self.on_fault.store(on_fault as u8, Ordering::Relaxed);
        let budget_ns = budget_ms.map_or(0, |ms| ((ms * 1e6).max(1.0) as u64).min(MAX_BUDGET_NS));
        self.budget_ns.store(budget_ns, Ordering::Relaxed);
        self.period_ns.store(max_rate_hz.map_or(0, rate::period_ns), Ordering::Relaxed);
        epoch.advance();
    }

    pub fn on_fault(&self) -> OnFault {
        let number = self.on_fault.load(Ordering::Relaxed);
        [OnFault::Restart, OnFault::Bypass, OnFault::Stop].into_iter().find(|o| *o as u8 == number).unwrap_or_default()
    }

    /// Time budget of a call in ns, 0 for none.
    pub fn budget_ns(&self) -> u64 {
        self.budget_ns.load(Ordering::Relaxed)
    }

    /// Minimum capture time between two calls in ns, 0 for none.
    pub fn period_ns(&self) -> i64 {
        self.period_ns.load(Ordering::Relaxed)
    }

    /// The values in force.
    pub fn values(&self) -> Arc<Snapshot> {
        self.values.get()
    }

    /// The values in force, if they are not `known`.
    pub fn newer_values(&self, known: &Snapshot) -> Option<Arc<Snapshot>> {
        self.values.newer(known)
    }

    /// The values to change: those of the instance that waits, else those in force.
    pub fn newest_values(&self) -> Arc<Snapshot> {
        match &*lock(&self.replacement) {
            Some((_, Some(values))) => Arc::clone(values),
            _ => self.values.get(),
        }
    }

    /// Puts new values in force from the next tick on, also for an instance that waits.
    pub fn set_values(&self, epoch: &ConfigEpoch, snapshot: Arc<Snapshot>) {
        let mut replacement = lock(&self.replacement);
        if let Some((_, Some(values))) = &mut *replacement {
            *values = Arc::clone(&snapshot);
        }
        self.values.set(snapshot);
        drop(replacement);
        epoch.advance();
    }

    /// Hands over an instance that was opened next to the running one. Returns one that still waited; the caller closes
    /// it.
    pub fn put_replacement(&self, epoch: &ConfigEpoch, replacement: Replacement) -> Option<Instance> {
        let old = self.put(lock(&self.replacement), replacement);
        epoch.advance();
        old
    }

    /// As [`Self::put_replacement`] for an instance that was reopened with the values in force. Returns that instance
    /// if it is outdated, or if one with newer values waits.
    pub fn put_restarted(
        &self,
        epoch: &ConfigEpoch,
        instance: Instance,
        is_outdated: impl FnOnce() -> bool,
    ) -> Option<Instance> {
        let replacement = lock(&self.replacement);
        if matches!(&*replacement, Some((_, Some(_)))) || is_outdated() {
            return Some(instance);
        }
        let old = self.put(replacement, (instance, None));
        epoch.advance();
        old
    }

    fn put(&self, mut place: MutexGuard<'_, Option<Replacement>>, replacement: Replacement) -> Option<Instance> {
        let old = place.replace(replacement);
        self.has_replacement.store(true, Ordering::Relaxed);
        old.map(|(instance, _)| instance)
    }

    /// Whether an instance waits. A call checks this when the epoch changed.
    pub fn has_replacement(&self) -> bool {
        self.has_replacement.load(Ordering::Relaxed)
    }

    /// The instance that waits. Its values are in force from here on, whatever becomes of the instance.
    pub fn take_replacement(&self) -> Option<Replacement> {
        let mut place = lock(&self.replacement);
        self.has_replacement.store(false, Ordering::Relaxed);
        let replacement = place.take()?;
        if let (_, Some(values)) = &replacement {
            self.values.set(Arc::clone(values));
        }
        Some(replacement)
    }
}
