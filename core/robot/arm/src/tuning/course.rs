//! Responses of a controller and the simulated arm to steps and ramps of a tip, without tracker and images.

use nalgebra::{Point3, Vector3};

use super::TuneError;
use super::relay::{Relay, Ultimate};
use crate::campaign::Random;
use crate::chain::{Chain, JointVector};
use crate::control::{CameraGeometry, Controller, Goals, SeenTip, errors, goal_mm};
use crate::dynamics::{Quality, SimArm};
use crate::interlock::{Evidence, Interlock};
use crate::task::{self, Errors, Wanted};

/// The channels that are tuned: both directions in the image share one set of gains, the distance has another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// The tip's position in the image, tested horizontally.
    Picture,
    /// The tip's distance.
    Distance,
}

impl Channel {
    /// Both channels.
    pub const ALL: [Self; 2] = [Self::Picture, Self::Distance];

    /// Prefix of the parameters' names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Picture => "picture",
            Self::Distance => "distance",
        }
    }

    /// The direction in which the tip moves, seen from the left camera.
    fn direction(self) -> Vector3<f64> {
        match self {
            Self::Picture => Vector3::x(),
            Self::Distance => Vector3::z(),
        }
    }
}

/// The arm, the cameras and the clock.
#[derive(Clone, Debug)]
pub struct Course {
    /// The arm.
    pub chain: Chain,
    /// Imperfections of the arm.
    pub quality: Quality,
    /// The cameras.
    pub cameras: CameraGeometry,
    /// Frames per second.
    pub rate_hz: f64,
    /// Standard deviation of a tip in the image and of its disparity, px; 0 for none.
    pub noise_px: f64,
}

/// Movement of the tip, from its set-point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// A jump by this distance, mm.
    Step(f64),
    /// A movement at this speed, mm/s, for [`RAMP_S`], then rest.
    Ramp(f64),
    /// Swings of this amplitude, mm, at [`SWING_HZ`]: accelerates as hands do.
    Swing(f64),
}

/// Rest before a motion, s.
pub const START_S: f64 = 1.0;
/// Length of a ramp, s.
pub const RAMP_S: f64 = 2.0;
/// Frequency of a swing, Hz.
pub const SWING_HZ: f64 = 0.5;
/// Observed time after the start of a motion, s.
pub const WATCHED_S: f64 = 3.5;

impl Motion {
    fn offset_mm(self, at_s: f64) -> f64 {
        let t = at_s - START_S;
        match self {
            Self::Step(way_mm) => {
                if t >= 0.0 {
                    way_mm
                } else {
                    0.0
                }
            }
            Self::Ramp(speed_mm_s) => speed_mm_s * t.clamp(0.0, RAMP_S),
            Self::Swing(way_mm) => way_mm * (std::f64::consts::TAU * SWING_HZ * t.max(0.0)).sin(),
        }
    }
}

impl Motion {
    /// Time since the tip last changed its speed, s.
    fn since_s(self, at_s: f64) -> f64 {
        match self {
            Self::Ramp(_) if at_s >= RAMP_S => at_s - RAMP_S,
            _ => at_s,
        }
    }
}

/// One tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time since the start of the motion, s; below 0 before.
    pub at_s: f64,
    /// Error of the true tip along the channel's direction, mm.
    pub error_mm: f64,
    /// Acceleration of the camera, mm/s^2.
    pub camera_mm_s2: f64,
}

/// Inputs of a controller in a tick.
struct Tick<'a> {
    now_ns: i64,
    /// The tip in the left camera's frame with the noise of detection, mm.
    tip_mm: Vector3<f64>,
    joints: &'a JointVector,
    set_point: &'a JointVector,
}

impl Course {
    /// The default arm with the scope of the thesis.
    pub fn shipped(chain: Chain) -> Self {
        let cameras = CameraGeometry { focal_px: (750.0, 750.0), baseline_mm: 15.0 };
        Self { chain, quality: Quality::default(), cameras, rate_hz: 30.0, noise_px: 0.0 }
    }

    /// Plays a motion against a controller.
    ///
    /// # Errors
    /// [`TuneError::Stopped`] where the interlock stops the arm, [`TuneError::NotFinite`] where the tip is not finite.
    pub fn play(&self, goals: &Goals, channel: Channel, motion: Motion) -> Result<Vec<Sample>, TuneError> {
        let mut controller = Controller::new(self.chain.clone());
        let mut control = |tick: &Tick<'_>| {
            let tip = SeenTip { xyz_mm: tick.tip_mm, score: 1.0, age_s: 0.0 };
            let step = controller.step(tick.now_ns, Some(tip), tick.joints, Some(tick.set_point), &self.cameras, goals);
            step.map(|step| step.velocity)
        };
        let ticks = ((START_S + WATCHED_S) * self.rate_hz) as i64;
        let offset = |at_s: f64| channel.direction() * motion.offset_mm(at_s);
        self.drive(ticks, goals.distance_mm, channel, &offset, &mut control)
    }

    /// Makes the arm oscillate with a relay in place of one channel's PID; weak gains hold the other channels. Without
    /// prediction and feed-forward, so that the limit of stability is that of a plain loop.
    ///
    /// # Errors
    /// See [`Relay::swing`] and [`Course::play`].
    pub fn relay(&self, goals: &Goals, channel: Channel) -> Result<Ultimate, TuneError> {
        const HOLD: f64 = 1.5;
        const SECONDS: f64 = 30.0;
        // In E/s: what moves the tip by about 15 mm/s, a speed that the arm reaches within its limits.
        let (row, amplitude) = match channel {
            Channel::Picture => (0, 15.0 * self.cameras.focal_px.0 / goals.distance_mm),
            Channel::Distance => (2, 15.0),
        };
        let relay = Relay { amplitude, hysteresis: 0.0, step_s: 1.0 / self.rate_hz, max_s: SECONDS };
        let mut loop_ = Loop::new(self, goals.distance_mm);
        let up = self.chain.stance(&JointVector::zeros()).base_from_camera * -Vector3::y();
        let rest = |_: f64| Vector3::zeros();
        let mut stopped = None;
        let mut plant = |output: f64| {
            let velocity = {
                let seen = loop_.look(&rest);
                let now = errors(&seen, &self.cameras, goals.distance_mm);
                let mut rates = Errors::new(-HOLD * now.x, -HOLD * now.y, -HOLD * now.z);
                rates[row] = -output;
                let point = Vector3::new(seen.x, seen.y, seen.z.max(1.0));
                let wanted = task::interaction(&point, self.cameras.focal_px, self.cameras.baseline_mm / 2.0)
                    .try_inverse()
                    .map_or(Vector3::zeros(), |inverse| inverse * rates);
                let stance = self.chain.stance(&loop_.encoders);
                task::solve(
                    &self.chain,
                    &loop_.encoders,
                    &stance,
                    &up,
                    &Wanted { point_mm: point, velocity_mm_s: wanted },
                )
                .velocity
            };
            if let Err(error) = loop_.move_on(Some(velocity)) {
                stopped.get_or_insert(error);
                return f64::NAN;
            }
            errors(&loop_.look(&rest), &self.cameras, goals.distance_mm)[row]
        };
        let found = relay.swing(&mut plant);
        match stopped {
            Some(error) => Err(error),
            None => found,
        }
    }

    fn drive(
        &self,
        ticks: i64,
        distance_mm: f64,
        channel: Channel,
        offset: &dyn Fn(f64) -> Vector3<f64>,
        control: &mut dyn FnMut(&Tick<'_>) -> Option<JointVector>,
    ) -> Result<Vec<Sample>, TuneError> {
        let mut state = Loop::new(self, distance_mm);
        let goal = goal_mm(distance_mm, self.cameras.baseline_mm);
        let mut out = Vec::with_capacity(ticks.max(0) as usize);
        let (mut last, mut speed) = (state.camera.translation.vector, Vector3::zeros());
        for _ in 0..ticks {
            let at_s = state.now_ns as f64 * 1e-9;
            let truth = state.true_tip(offset);
            let tip_mm = state.noisy(truth);
            let velocity = control(&Tick {
                now_ns: state.now_ns,
                tip_mm,
                joints: &state.encoders,
                set_point: &state.lock.set_point().position,
            });
            let error_mm = match channel {
                Channel::Picture => truth.x - goal.x,
                Channel::Distance => truth.norm() - distance_mm,
            };
            if !error_mm.is_finite() {
                return Err(TuneError::NotFinite { at_s });
            }
            let at = state.camera.translation.vector;
            let moved = (at - last) * self.rate_hz;
            out.push(Sample { at_s: at_s - START_S, error_mm, camera_mm_s2: (moved - speed).norm() * self.rate_hz });
            (last, speed) = (at, moved);
            state.move_on(velocity)?;
        }
        Ok(out)
    }
}

/// The arm between two ticks.
struct Loop<'a> {
    course: &'a Course,
    lock: Interlock,
    arm: SimArm,
    random: Random,
    /// Left camera, in the frame of the left camera at home.
    camera: nalgebra::Isometry3<f64>,
    base_from_home: nalgebra::Isometry3<f64>,
    encoders: JointVector,
    /// Resting position of the tip in the frame of the camera at home, mm.
    home_mm: Vector3<f64>,
    now_ns: i64,
    tick: i64,
}

impl<'a> Loop<'a> {
    fn new(course: &'a Course, distance_mm: f64) -> Self {
        let base_from_home = course.chain.stance(&JointVector::zeros()).base_from_camera;
        Self {
            lock: Interlock::new(course.chain.clone(), JointVector::zeros(), 0),
            arm: SimArm::new(course.quality, JointVector::zeros()),
            random: Random::new(5),
            camera: nalgebra::Isometry3::identity(),
            base_from_home,
            encoders: JointVector::zeros(),
            home_mm: goal_mm(distance_mm, course.cameras.baseline_mm),
            now_ns: 0,
            tick: 0,
            course,
        }
    }

    fn true_tip(&self, offset: &dyn Fn(f64) -> Vector3<f64>) -> Vector3<f64> {
        let at = self.home_mm + offset(self.now_ns as f64 * 1e-9);
        self.camera.inverse_transform_point(&Point3::from(at)).coords
    }

    /// The tip with the noise of two cameras.
    fn noisy(&mut self, p: Vector3<f64>) -> Vector3<f64> {
        let Course { cameras, noise_px, .. } = self.course;
        let mut bell = || ((0..6).map(|_| self.random.unit()).sum::<f64>() - 3.0) * 1.414 * noise_px;
        let inverse = p.z.recip() * (1.0 + bell() * p.z / (cameras.focal_px.0 * cameras.baseline_mm));
        let (x, y, z) =
            (p.x / p.z + bell() / cameras.focal_px.0, p.y / p.z + bell() / cameras.focal_px.1, 1.0 / inverse);
        Vector3::new(x * z, y * z, z)
    }

    fn look(&mut self, offset: &dyn Fn(f64) -> Vector3<f64>) -> Vector3<f64> {
        let truth = self.true_tip(offset);
        self.noisy(truth)
    }

    /// Passes the demand to the interlock and advances by one tick.
    fn move_on(&mut self, velocity: Option<JointVector>) -> Result<(), TuneError> {
        self.lock.tip(self.now_ns, Evidence { score: 1.0, in_space: true });
        if let Some(velocity) = velocity {
            self.lock.demand(self.now_ns, velocity.as_slice());
        }
        self.tick += 1;
        let next_ns = (self.tick as f64 * 1e9 / self.course.rate_hz) as i64;
        let arm = &mut self.arm;
        self.lock.advance(next_ns, &mut |point| arm.step(point));
        self.now_ns = next_ns;
        self.camera = self.base_from_home.inverse() * self.course.chain.stance(self.arm.links()).base_from_camera;
        let random = &mut self.random;
        self.encoders = self.arm.encoders(|| random.bits());
        // The first ticks have no demand yet.
        match self.lock.latched() {
            Some(cause) => Err(TuneError::Stopped { at_s: self.now_ns as f64 * 1e-9, cause: cause.to_string() }),
            None => Ok(()),
        }
    }
}

/// Measures of a response.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Response {
    /// Rise time from 10 to 90 % of the step, s; NaN if it never rises.
    pub rise_s: f64,
    /// Overshoot, % of the step.
    pub overshoot_pct: f64,
    /// Settling time, from the step until the error stays within [`BAND`] of it, s; NaN if it does not.
    pub settling_s: f64,
    /// Mean size of the error over the last half second, mm.
    pub steady_mm: f64,
    /// Integral of time times absolute error, mm s^2. Time restarts when a ramp ends, because the sum of the ramp
    /// decays then.
    pub itae: f64,
    /// Root mean square acceleration of the camera, mm/s^2.
    pub shake_mm_s2: f64,
}

/// Band of settling as a share of the step: above the dead zone of the controller.
pub const BAND: f64 = 0.1;

/// Measures a response to a step; for other motions only `itae`, `steady_mm` and `shake_mm_s2` are meaningful.
pub fn measure(samples: &[Sample], motion: Motion) -> Response {
    let way_mm = match motion {
        Motion::Step(way_mm) => way_mm,
        Motion::Ramp(speed_mm_s) => speed_mm_s * RAMP_S,
        Motion::Swing(way_mm) => way_mm,
    };
    let after: Vec<&Sample> = samples.iter().filter(|s| s.at_s >= -1e-9).collect();
    let step_s = after.windows(2).map(|two| two[1].at_s - two[0].at_s).next().unwrap_or(0.0);
    let done = |s: &Sample| 1.0 - s.error_mm / way_mm;
    let reaches = |share: f64| after.iter().find(|s| done(s) >= share).map_or(f64::NAN, |s| s.at_s);
    let is_off = |s: &&&Sample| s.error_mm.abs() > BAND * way_mm.abs();
    let last_off = after.iter().rfind(is_off).map_or(0.0, |s| s.at_s + step_s);
    let end_s = after.last().map_or(0.0, |s| s.at_s);
    let tail = || after.iter().filter(|s| s.at_s > end_s - 0.5);
    let shake = after.iter().map(|s| s.camera_mm_s2 * s.camera_mm_s2).sum::<f64>() / after.len().max(1) as f64;
    Response {
        rise_s: reaches(0.9) - reaches(0.1),
        overshoot_pct: 100.0 * after.iter().map(|s| done(s) - 1.0).fold(0.0, f64::max),
        settling_s: if last_off > end_s { f64::NAN } else { last_off },
        steady_mm: tail().map(|s| s.error_mm.abs()).sum::<f64>() / tail().count().max(1) as f64,
        itae: after.iter().map(|s| motion.since_s(s.at_s) * s.error_mm.abs() * step_s).sum(),
        shake_mm_s2: shake.sqrt(),
    }
}

/// Root mean square error in the second half of a ramp, mm.
pub fn ramp_error_mm(samples: &[Sample]) -> f64 {
    let part: Vec<f64> =
        samples.iter().filter(|s| (RAMP_S / 2.0..=RAMP_S).contains(&s.at_s)).map(|s| s.error_mm).collect();
    (part.iter().map(|e| e * e).sum::<f64>() / part.len().max(1) as f64).sqrt()
}

/// Root mean square error of a swing from its second quarter on, mm.
pub fn swing_error_mm(samples: &[Sample]) -> f64 {
    let part: Vec<f64> = samples.iter().filter(|s| s.at_s >= 0.25 / SWING_HZ).map(|s| s.error_mm).collect();
    (part.iter().map(|e| e * e).sum::<f64>() / part.len().max(1) as f64).sqrt()
}
