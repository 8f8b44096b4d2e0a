//! The last stage before set-points: whatever motion is requested, its output stays within the limits.
//!
//! Three watchdogs, each independent of the one before it:
//! 1. `arm_pid` asks for nothing without a fresh tip. It is a node like any other and may be replaced or wrong.
//! 2. This interlock lives in the driver (`arm_sim`, `arm_serial`), after the graph's last wire. It looks at the tip
//!    itself, at the age of the demand, and at every limit, and steps on a clock of the driver's: with real hardware a
//!    thread that continues when the graph, the controller or the host's scheduler does not.
//! 3. The device stops by itself when set-points stop coming (30 ms, see the serial protocol): that holds when the
//!    whole process dies.
//!
//! How it keeps the limits. The state is one [`SetPoint`]; time advances in steps of 1 ms. For each state a stop has
//! been planned ([`Brake`], closed form) and checked against joint limits and workspace before the state is entered. A
//! demand is followed for up to 10 steps at a time, and only if such a stop exists from their end; otherwise the known
//! stop is driven. By induction no sequence of inputs leaves the limits. All changes scale the joints together, so that
//! movements about the trocar stay such.

mod brake;
pub mod caps;
mod cause;
pub mod measured;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use nalgebra::Vector3;

use crate::chain::{Chain, JOINTS, JointVector};

pub use brake::{Brake, SetPoint};
pub use caps::{Caps, TubePose};
pub use cause::{Cause, Event};
pub use measured::Measured;

use caps::{STEP_NS, STEP_S, share};

/// Maximum number of steps planned at once.
const CHUNK_STEPS: u32 = 10;
/// Shares of a demand that are tried in turn.
const SHARES: [f64; 3] = [1.0, 0.5, 0.2];
/// Shorter gaps in the demands (a late tick) are not reported as stops.
const NOTED_AFTER_STEPS: u32 = 31;
/// Maximum number of events that wait to be taken.
const MAX_EVENTS: usize = 32;

/// Settings of the user; the limits in [`caps`] hold in any case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Age up to which a tip is followed, ms; at most 300.
    pub max_age_ms: f64,
    /// Lowest score of a tip that is followed.
    pub min_score: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { max_age_ms: 150.0, min_score: 0.3 }
    }
}

/// Properties of the followed tip that the interlock checks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// Score, 0 to 1; lower while the tip is only predicted.
    pub score: f64,
    /// Whether its position in space is known.
    pub in_space: bool,
}

/// Requested joint velocities.
#[derive(Clone, Copy, Debug)]
struct Demand {
    /// Time of the request, ns.
    made_ns: i64,
    /// Arrival time of the light that they were computed from, ns.
    light_ns: i64,
    /// `None` if they are invalid.
    velocity: Option<JointVector>,
}

/// The interlock of one arm; see the module.
pub struct Interlock {
    chain: Chain,
    caps: Caps,
    home: Vector3<f64>,
    settings: Settings,
    now_ns: i64,
    state: SetPoint,
    /// The stop in progress, and its steps so far.
    braking: Option<(Brake, u32)>,
    /// The planned stop from `state`.
    escape: Brake,
    tip: Option<(i64, Evidence)>,
    demand: Option<Demand>,
    latched: Option<Cause>,
    clock_jumped: bool,
    stop: Option<Cause>,
    stopping_steps: u32,
    noted: Option<Cause>,
    events: VecDeque<Event>,
    stops: u64,
}

impl Interlock {
    /// An arm at rest at `angles_rad`; it moves once a tip and a demand have arrived. Angles outside the limits are
    /// clamped: the caller compares [`Interlock::set_point`] with the arm's angles.
    pub fn new(chain: Chain, angles_rad: JointVector, now_ns: i64) -> Self {
        let caps = Caps::of(&chain);
        let home = chain.stance(&JointVector::zeros()).base_from_tip * Vector3::z();
        let inside = |k: usize| {
            let angle = if angles_rad[k].is_finite() { angles_rad[k] } else { 0.0 };
            angle.clamp(caps.lower_rad[k], caps.upper_rad[k])
        };
        let state = SetPoint::at_rest(JointVector::from_fn(|k, _| inside(k)));
        Self {
            escape: Brake::plan(state, &caps),
            home,
            chain,
            caps,
            settings: Settings::default(),
            now_ns,
            state,
            braking: None,
            tip: None,
            demand: None,
            latched: None,
            clock_jumped: false,
            stop: Some(Cause::NoTip),
            stopping_steps: NOTED_AFTER_STEPS,
            noted: Some(Cause::NoTip),
            events: VecDeque::with_capacity(MAX_EVENTS),
            stops: 0,
        }
    }

    /// Sets the time before the first step.
    pub fn start_clock(&mut self, now_ns: i64) {
        self.now_ns = now_ns;
        self.tip = None;
        self.demand = None;
    }

    /// The arm.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// The limits.
    pub fn caps(&self) -> &Caps {
        &self.caps
    }

    /// Sets the user's settings, clamped to the limits; NaN counts as the strictest value.
    pub fn set(&mut self, settings: Settings) {
        let oldest = caps::TIP_AGE.as_secs_f64() * 1e3;
        let strict =
            |v: f64, low: f64, high: f64, otherwise: f64| if v.is_nan() { otherwise } else { v.clamp(low, high) };
        self.settings = Settings {
            max_age_ms: strict(settings.max_age_ms, 0.0, oldest, 0.0),
            min_score: strict(settings.min_score, 0.0, 1.0, 1.0),
        };
    }

    /// Sets the newest tip that the arm follows. Its light arrived at `light_ns`.
    pub fn tip(&mut self, light_ns: i64, evidence: Evidence) {
        self.tip = Some((light_ns, evidence));
    }

    /// Corrects the time at which the light of the newest tip arrived, for a caller whose clock is not that of the
    /// tips.
    pub fn correct_tip(&mut self, light_ns: i64) {
        if let Some((at_ns, _)) = &mut self.tip {
            *at_ns = light_ns;
        }
    }

    /// Requests joint velocities, rad/s, computed from light that arrives now. See [`Interlock::demand_of_light`].
    pub fn demand(&mut self, now_ns: i64, velocity_rad_s: &[f64]) {
        self.demand_of_light(now_ns, now_ns, velocity_rad_s);
    }

    /// Requests joint velocities, rad/s, at `made_ns`, computed from light that arrived at `light_ns`. The demand
    /// expires 24 ms after it was made, and is not followed when its light is older than a tip may be. Anything but six
    /// finite numbers is an invalid demand, which stops the arm.
    pub fn demand_of_light(&mut self, made_ns: i64, light_ns: i64, velocity_rad_s: &[f64]) {
        let sound = velocity_rad_s.len() == JOINTS && velocity_rad_s.iter().all(|v| v.is_finite());
        let velocity = sound.then(|| JointVector::from_column_slice(velocity_rad_s));
        self.demand = Some(Demand { made_ns, light_ns, velocity });
    }

    /// Stops the arm and latches the cause.
    pub fn latch(&mut self, cause: Cause) {
        if self.latched.is_none() {
            self.latched = Some(cause);
        }
    }

    /// Releases a latched stop; motion needs a new tip and a new demand.
    pub fn release(&mut self) {
        self.latched = None;
        self.tip = None;
        self.demand = None;
    }

    /// Cause of the latched stop.
    pub fn latched(&self) -> Option<Cause> {
        self.latched
    }

    /// Expiry of the followed demand, ns; `None` while the arm brakes or rests.
    pub fn expires_ns(&self) -> Option<i64> {
        let demand = self.demand.filter(|_| self.stop.is_none())?;
        Some(demand.made_ns.saturating_add(caps::DEMAND_AGE.as_nanos() as i64))
    }

    /// Cause of a stop that has lasted longer than a late tick; `None` while the arm follows.
    pub fn stopped(&self) -> Option<Cause> {
        self.noted
    }

    /// Cause for which the newest set-point brakes; `None` if it follows. A demand expires after 24 ms, so at 30 ticks
    /// per second this is set in the last 9 ms of each tick, in which limited jerk changes a speed by 1.2 mrad/s at
    /// most: see [`Interlock::stopped`].
    pub fn stop(&self) -> Option<Cause> {
        self.stop
    }

    /// Number of stops.
    pub fn stops(&self) -> u64 {
        self.stops
    }

    /// Continues to count stops from a number.
    pub fn count_stops_from(&mut self, stops: u64) {
        self.stops = stops;
    }

    /// The newest set-point.
    pub fn set_point(&self) -> &SetPoint {
        &self.state
    }

    /// Pose of the tube relative to the trocar at the newest set-point.
    pub fn tube(&self) -> TubePose {
        TubePose::of(&self.chain, &self.chain.stance(&self.state.position), &self.home)
    }

    /// The next event for the log.
    pub fn take_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Advances to `now_ns` and calls `each` with every set-point (one per ms). Time that goes backwards makes no step,
    /// a jump at most 250 steps.
    pub fn advance(&mut self, now_ns: i64, each: &mut dyn FnMut(&SetPoint)) {
        let max_ns = caps::MAX_CALL.as_nanos() as i64;
        let passed_ns = now_ns.saturating_sub(self.now_ns);
        if passed_ns < 0 || passed_ns > max_ns {
            // Tips and demands are of another time.
            self.clock_jumped = true;
            self.tip = None;
            self.demand = None;
            self.now_ns = now_ns.saturating_sub(passed_ns.clamp(0, max_ns));
        }
        let mut steps = (now_ns.saturating_sub(self.now_ns) / STEP_NS).max(0) as u32;
        while steps > 0 {
            let chunk = self.chunk(steps.min(CHUNK_STEPS), each);
            steps -= chunk;
        }
    }

    /// Whether a stop from this state stays within the limits.
    fn is_safe(&self, brake: &Brake) -> bool {
        let (release, end) = (brake.release_steps(), brake.steps());
        // A speed that is not a number has no share; the camera's limit refuses it below.
        if share(&brake.at(release).velocity, &self.caps.speed) > 1.0 {
            return false;
        }
        let mut last = None;
        checked_steps(release, end).iter().all(|&step| {
            if last == Some(step) {
                return true;
            }
            last = Some(step);
            let point = brake.at(step);
            if !self.caps.angles_allowed(&point.position, true) {
                return false;
            }
            let stance = self.chain.stance(&point.position);
            TubePose::of(&self.chain, &stance, &self.home).is_allowed(true)
                && self.caps.camera_allowed(stance.camera_velocity(&point.velocity).norm())
        })
    }

    /// Time of the followed demand, ns, and its velocities; otherwise the cause of the stop.
    fn followed(&self) -> Result<(i64, JointVector), Cause> {
        if let Some(cause) = self.latched {
            return Err(cause);
        }
        // A tip from the future is as invalid as an old one.
        let age = |at_ns: i64| self.now_ns.saturating_sub(at_ns).saturating_abs();
        let is_old = |age_ns: i64| age_ns as f64 > self.settings.max_age_ms * 1e6;
        match self.tip {
            None if self.clock_jumped => return Err(Cause::Clock),
            None => return Err(Cause::NoTip),
            Some((light_ns, _)) if is_old(age(light_ns)) => return Err(Cause::OldTip),
            // Written so that a NaN score stops the arm.
            Some((_, tip)) if !(tip.score >= self.settings.min_score && tip.score > 0.0 && tip.score <= 1.0) => {
                return Err(Cause::DoubtfulTip);
            }
            Some((_, tip)) if !tip.in_space => return Err(Cause::FlatTip),
            Some(_) => {}
        }
        match self.demand {
            None => Err(Cause::NoDemand),
            // Its light was old when it was made: it was never followed, however old it is meanwhile.
            Some(demand) if is_old(demand.made_ns.min(self.now_ns).saturating_sub(demand.light_ns)) => {
                Err(Cause::OldTip)
            }
            Some(demand) if age(demand.made_ns) >= caps::DEMAND_AGE.as_nanos() as i64 => Err(Cause::LoopStalled),
            Some(Demand { velocity: None, .. }) => Err(Cause::BadDemand),
            Some(demand) if is_old(age(demand.light_ns)) => Err(Cause::OldTip),
            Some(Demand { made_ns, velocity: Some(velocity), .. }) => Ok((made_ns, velocity)),
        }
    }

    /// Drives up to `most` steps; returns their number.
    fn chunk(&mut self, most: u32, each: &mut dyn FnMut(&SetPoint)) -> u32 {
        let mut steps = most;
        let cause = match self.followed() {
            Ok((made_ns, wanted)) => {
                // Not beyond the time at which the demand expires.
                let left_ns = caps::DEMAND_AGE.as_nanos() as i64 - self.now_ns.saturating_sub(made_ns);
                steps = steps.min((left_ns / STEP_NS).clamp(1, i64::from(CHUNK_STEPS)) as u32);
                let wanted = self.tamed(&wanted);
                if SHARES.iter().any(|part| self.try_follow(&(wanted * *part), steps, each)) {
                    self.braking = None;
                    self.clock_jumped = false;
                    self.passed(steps, None);
                    return steps;
                }
                Cause::Limit
            }
            Err(cause) => cause,
        };
        let (brake, done) = self.braking.unwrap_or((self.escape, 0));
        for k in 1..=steps {
            self.state = brake.at(done.saturating_add(k));
            each(&self.state);
        }
        self.braking = Some((brake, done.saturating_add(steps)));
        self.passed(steps, Some(cause));
        steps
    }

    /// A demand scaled to the speed limits of joints and camera, with its direction kept.
    fn tamed(&self, wanted: &JointVector) -> JointVector {
        let camera =
            self.chain.stance(&self.state.position).camera_velocity(wanted).norm() / (0.85 * caps::CAMERA_MM_S);
        let most = (share(wanted, &self.caps.speed) / 0.95).max(camera);
        if most > 1.0 { wanted / most } else { *wanted }
    }

    /// Follows a velocity for some steps if a safe stop exists from their end; otherwise does nothing.
    fn try_follow(&mut self, wanted: &JointVector, steps: u32, each: &mut dyn FnMut(&SetPoint)) -> bool {
        let mut points = [self.state; CHUNK_STEPS as usize];
        let mut at = self.state;
        for point in points.iter_mut().take(steps as usize) {
            let missing = wanted - at.velocity;
            let share_of = |limits: &JointVector| share(&missing, limits).max(1e-30);
            // The acceleration with which the requested speed is reached just as it falls to 0.
            let stretch = (0.98 / share_of(&self.caps.acceleration))
                .min(0.9 * (2.0 / share_of(&self.caps.jerk)).sqrt())
                .min(0.2 / STEP_S);
            let change = missing * stretch - at.acceleration;
            let part = (0.999 * STEP_S / share(&change, &self.caps.jerk).max(1e-30)).min(1.0);
            at.acceleration += change * part;
            at.velocity += at.acceleration * STEP_S;
            at.position += at.velocity * STEP_S;
            if share(&at.velocity, &self.caps.speed) > 1.0 || share(&at.acceleration, &self.caps.acceleration) > 1.0 {
                return false;
            }
            *point = at;
        }
        let escape = Brake::plan(at, &self.caps);
        if !self.is_safe(&escape) {
            return false;
        }
        points.iter().take(steps as usize).for_each(each);
        self.state = at;
        self.escape = escape;
        true
    }

    /// Records passed steps and the cause of a stop.
    fn passed(&mut self, steps: u32, stop: Option<Cause>) {
        self.now_ns = self.now_ns.saturating_add(i64::from(steps) * STEP_NS);
        self.stop = stop;
        let Some(cause) = stop else {
            self.stopping_steps = 0;
            if self.noted.take().is_some() {
                self.note(None);
            }
            return;
        };
        self.stopping_steps = self.stopping_steps.saturating_add(steps);
        let is_due = cause.latches() || self.stopping_steps >= NOTED_AFTER_STEPS;
        if is_due && self.noted != Some(cause) {
            // A stop whose cause changes while the arm stands is still the same stop, unless it latches now.
            if self.noted.is_none() || cause.latches() {
                self.stops += 1;
                self.note(Some(cause));
            }
            self.noted = Some(cause);
        }
    }

    fn note(&mut self, stop: Option<Cause>) {
        if self.events.len() == MAX_EVENTS {
            self.events.pop_front();
        }
        let speed_rad_s = self.state.velocity.amax();
        self.events.push_back(Event { at_ns: self.now_ns, stop, speed_rad_s });
    }
}

/// Steps of a stop at which its position is checked: thirds of the time until the joints' accelerations are released,
/// and quarters of the rest.
fn checked_steps(release: u32, end: u32) -> [u32; 8] {
    let rest = end - release;
    let after = |quarters: u32| release + quarters * rest / 4;
    [0, release / 3, 2 * release / 3, release, after(1), after(2), after(3), end]
}
