//! A real arm for the driver nodes. The process `panoscope-arm` owns the connection and the interlock; a node sends it requests
//! ([`panoscope_arm_guard`]). `arm_serial` and `arm_ur` differ only in how the arm is reached.

use std::path::{Path, PathBuf};

use panoscope_arm_core::interlock::Event;
use panoscope_arm_core::{Cause, Chain, JointVector};
use panoscope_arm_guard::client::Guard;
use panoscope_arm_guard::clock;
use panoscope_arm_guard::message::{MAX_DEMAND, Request, Status};
use panoscope_arm_guard::target::Target;
use panoscope_node::{Context, Open, Ports, Result, Slot, TableData, TextPacket, Timed, error};

use crate::declared::{In, MotionOut, StopParams};
use crate::guard::{self, age_ns};
use crate::joints::{arm_of, requested};

/// Output ports of the drivers of real arms.
#[derive(Ports)]
pub struct Out<'f> {
    #[ports(flatten)]
    motion: MotionOut<'f>,
    /// One row per tick: whether the arm follows, number of the stop's cause (0 for none), stops so far, largest joint speed, distance of the tube
    /// from the trocar, its depth, age of the arm's last answer.
    table: Slot<'f, TableData>,
    /// State of the arm as text.
    text: Slot<'f, TextPacket>,
}

/// Columns of the table, in order.
pub const COLUMNS: [&str; 7] = ["following", "cause", "stops", "speed_rad_s", "pivot_mm", "depth_mm", "answer_age_ms"];

/// A connection to an arm and the guard process that owns it.
pub struct RealArm {
    guard: Guard,
    target: Target,
    urdf: PathBuf,
    chain: Chain,
    home: nalgebra::Isometry3<f64>,
    reset: Option<u64>,
    has_reported_end: bool,
    words: String,
}

/// Status to report after the guard has ended: `last` with the arm stopped.
fn ended(last: &Status) -> Status {
    let stop = Some(Cause::GuardGone);
    Status { stop, latched: true, set_point: (last.set_point.0, JointVector::zeros()), ..*last }
}

/// Arrival time of a packet's light on the guard's clock, ns.
fn light_ns(cx: &Context<'_>, packet: &impl Timed, now_ns: i64) -> i64 {
    now_ns.saturating_sub(age_ns(cx, packet))
}

impl RealArm {
    /// Starts the guard of the arm that `urdf` describes; an empty path is the shipped arm.
    ///
    /// # Errors
    /// The file describes no arm, or the guard does not reach the arm.
    pub fn open(cx: &Open<'_>, target: Target, urdf: &Path) -> Result<Self> {
        let chain = arm_of(urdf)?;
        let home = chain.stance(&JointVector::zeros()).base_from_camera;
        let urdf = urdf.to_owned();
        let guard = Self::start(&target, &urdf)?;
        cx.info(&format!(
            "arm {} found; it stops by itself {} ms after the last set-point",
            guard.serial(),
            guard.watchdog_ms()
        ));
        if guard.granted() != (true, true) {
            cx.warn("the arm's guard runs without locked memory or real-time priority: `panoscope doctor` says how to allow both");
        }
        Ok(Self { guard, target, urdf, chain, home, reset: None, has_reported_end: false, words: String::new() })
    }

    fn start(target: &Target, urdf: &Path) -> Result<Guard> {
        Guard::start(target, urdf, None).map_err(|error| error!("{error}"))
    }

    /// Newest status. Reports stops, and the end of the guard.
    fn status(&mut self, cx: &Context<'_>) -> Status {
        let log =
            |event: Event| if event.stop.is_some() { cx.warn(&event.to_string()) } else { cx.info(&event.to_string()) };
        if let Some(status) = self.guard.status(log) {
            return status;
        }
        if !std::mem::replace(&mut self.has_reported_end, true) {
            cx.fault("the process that guards the arm has ended; the arm's own watchdog has stopped it. Change `reset` to restart the guard");
        }
        ended(self.guard.last_status())
    }

    /// Restarts a guard that has ended, after a person's reset. It starts with the stop latched; the next reset releases it.
    fn revive(&mut self, cx: &Context<'_>) {
        match Self::start(&self.target, &self.urdf) {
            Ok(guard) => {
                self.guard = guard;
                self.has_reported_end = false;
                cx.info("the arm is guarded again and stopped; change `reset` once more to release it");
            }
            Err(error) => cx.warn(&format!("the arm's guard cannot be restarted: {error}")),
        }
    }

    /// Sends tip and demand to the guard and reports its state.
    ///
    /// # Errors
    /// The host has no frame memory left.
    pub fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: &In<'f>,
        mut out: Out<'f>,
        is_enabled: bool,
        stop: &StopParams,
    ) -> Result<()> {
        let is_reset = self.reset.replace(stop.reset).is_some_and(|old| old != stop.reset);
        let now_ns = clock::now_ns();
        let tip = input.tip.as_ref().map(|tip| (light_ns(cx, tip, now_ns), guard::evidence(tip)));
        let demand = input.joints.as_ref().filter(|_| is_enabled).map(|joints| {
            let (values, mut velocity) = (requested(joints), [0.0; MAX_DEMAND]);
            velocity[..values.len()].copy_from_slice(values);
            (light_ns(cx, joints, now_ns), velocity, values.len() as u32)
        });
        self.guard.request(&Request {
            sent_ns: now_ns,
            tip,
            demand,
            settings: stop.settings(),
            emergency_stop: stop.emergency_stop,
            reset: stop.reset,
        });
        let mut known = self.status(cx);
        if self.has_reported_end && is_reset {
            self.revive(cx);
            known = self.status(cx);
        }
        let stance = self.chain.stance(&known.encoders);
        let (position_rad, velocity_rad_s) = &known.set_point;
        out.motion.set(&stance, &self.home, (&known.encoders, velocity_rad_s), (position_rad, velocity_rad_s))?;
        cx.metric("stops", known.stops as f64);
        if out.text.is_read() {
            guard::words(known.stop, known.latched, &mut self.words);
            out.text.set_text(if is_enabled { &self.words } else { "arm off" })?;
        }
        let row: [f64; COLUMNS.len()] = [
            f64::from(u8::from(known.stop.is_none())),
            known.stop.map_or(0.0, |cause| cause.number() as f64),
            known.stops as f64,
            known.set_point.1.amax(),
            known.pivot_mm,
            known.depth_mm,
            known.answer_age_ms,
        ];
        out.table.set_table(&COLUMNS, &row)
    }
}
