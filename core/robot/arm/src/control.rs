//! Computes joint velocities from the tip's position (thesis, chapter 6, fig. 6.3).
//!
//! Goal: the tip at the centre of the image that both cameras share (between the cameras, so `baseline / 2` beside
//! the left one) and at a set distance from the left camera. Errors in px, px and mm go through one PID each; the
//! interaction matrix makes a movement of the point of them; the tip's own movement is fed forward; [`task::solve`]
//! computes joint velocities that turn about the trocar.
//!
//! The image is old when the arm receives a command. Errors are therefore predicted: the tip moves at constant
//! velocity, the arm follows the set-points that it has received (a predictor after Smith, 1957, with the arm's
//! kinematics as its model). The integral sums the errors without prediction.

use crate::tracking::kalman::{Kalman, Model, stereo_covariance};
use nalgebra::{Point3, Vector3};

use crate::chain::{Chain, JointVector};
use crate::pid::{Gains, Pid, Sample};
use crate::task::{self, Errors, Wanted};

/// Set-points and gains of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goals {
    /// Distance of the tip from the left camera, mm.
    pub distance_mm: f64,
    /// Gains of the position in the image; the unit E is px.
    pub picture: Gains,
    /// Gains of the distance; the unit E is mm.
    pub distance: Gains,
    /// Share of the tip's own movement that is fed forward.
    pub feed_forward: f64,
    /// Time from the image to the arm's movement that the set-points do not contain, s.
    pub latency_s: f64,
    /// Standard deviation of the tip's unknown acceleration, mm/s^2.
    pub acceleration_mm_s2: f64,
    /// Lowest score of a tip that is followed.
    pub min_score: f64,
}

/// The cameras' parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraGeometry {
    /// Focal lengths of the rectified left view, px.
    pub focal_px: (f64, f64),
    /// Distance of the cameras, mm.
    pub baseline_mm: f64,
}

/// A tip in the left camera's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenTip {
    /// Position, mm.
    pub xyz_mm: Vector3<f64>,
    /// Score, 0 to 1.
    pub score: f64,
    /// Time since the tip was there, s: the age of the light, which the prediction covers.
    pub age_s: f64,
}

/// Result of one tick.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Requested joint velocities, rad/s.
    pub velocity: JointVector,
    /// Errors without prediction: px, px, mm.
    pub errors: Errors,
    /// Distance of the tip from its set-point, mm.
    pub error_mm: f64,
    /// Velocity of the tip in the base's frame, mm/s.
    pub tip_mm_s: Vector3<f64>,
    /// Smallest singular value, see [`task::Solution`].
    pub singular: f64,
    /// Share of the movement that joint limits allow.
    pub share: f64,
}

/// A longer time between ticks resets the controller, s.
const MAX_TICK_S: f64 = 0.25;
/// Standard deviation of a tip in the image and of its disparity, px.
const LATERAL_PX: f64 = 1.0;
const DISPARITY_PX: f64 = 0.5;
/// Range of accepted depths of the tip, mm.
const NEAREST_MM: f64 = 5.0;
const FARTHEST_MM: f64 = 1000.0;
/// Minimum movement that is checked for limiting, rad/s.
const MIN_RAD_S: f64 = 0.01;
const CARRIED: f64 = 0.5;
/// Maximum time over which an old tip is predicted, s; the interlock follows no older tip.
const MAX_AGE_S: f64 = 0.3;
/// Largest joint angle accepted, rad.
const FARTHEST_RAD: f64 = 100.0;

/// The controller of one arm.
pub struct Controller {
    chain: Chain,
    up: Vector3<f64>,
    pids: [Pid; 3],
    tip: Option<Kalman>,
    last_ns: Option<i64>,
    asked: JointVector,
    /// Share of the last movement that the joint limits allowed, and the set-points when it was requested.
    share: f64,
    set_point: Option<JointVector>,
}

/// Set-point of the tip in the left camera's frame, mm.
pub fn goal_mm(distance_mm: f64, baseline_mm: f64) -> Vector3<f64> {
    let x = baseline_mm / 2.0;
    Vector3::new(x, 0.0, (distance_mm * distance_mm - x * x).max(0.0).sqrt())
}

/// Errors of a point: px, px, mm.
pub fn errors(point_mm: &Vector3<f64>, cameras: &CameraGeometry, distance_mm: f64) -> Errors {
    let z = point_mm.z.max(NEAREST_MM);
    Errors::new(
        cameras.focal_px.0 * (point_mm.x - cameras.baseline_mm / 2.0) / z,
        cameras.focal_px.1 * point_mm.y / z,
        point_mm.norm() - distance_mm,
    )
}

impl Controller {
    /// A controller of an arm. The image stays as upright as it is at home.
    pub fn new(chain: Chain) -> Self {
        let home = chain.stance(&JointVector::zeros());
        let up = home.base_from_camera * -Vector3::y();
        Self {
            chain,
            up,
            pids: [Pid::default(); 3],
            tip: None,
            last_ns: None,
            asked: JointVector::zeros(),
            share: 1.0,
            set_point: None,
        }
    }

    /// The arm.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Resets the controller: the next tick is a first one.
    pub fn reset(&mut self) {
        self.pids.iter_mut().for_each(Pid::reset);
        self.tip = None;
        self.last_ns = None;
        self.asked = JointVector::zeros();
        self.share = 1.0;
        self.set_point = None;
    }

    /// Whether the last movement was not carried out: joint limits reduced it, or the set-points moved by less than
    /// half of it.
    fn is_limited(&self, set_point: Option<&JointVector>, dt_s: f64) -> bool {
        let went = set_point.zip(self.set_point).map(|(now, then)| (now - then) / dt_s.max(1e-6));
        let speed = self.asked.norm();
        let is_behind = went.is_some_and(|went| speed > MIN_RAD_S && went.dot(&self.asked) < CARRIED * speed * speed);
        self.share < 1.0 - 1e-9 || is_behind
    }

    /// Processes one tick: the tip of an image taken at `taken_ns` in real time, the joint angles at that time, and
    /// the newest set-points if they are known. `None` while no tip can be followed.
    pub fn step(
        &mut self,
        taken_ns: i64,
        tip: Option<SeenTip>,
        joints_rad: &JointVector,
        set_point_rad: Option<&JointVector>,
        cameras: &CameraGeometry,
        goals: &Goals,
    ) -> Option<Step> {
        let passed_s = self.last_ns.map(|last| taken_ns.saturating_sub(last) as f64 * 1e-9);
        if passed_s.is_some_and(|s| !(0.0..=MAX_TICK_S).contains(&s)) {
            self.reset();
        }
        let dt_s = self.last_ns.replace(taken_ns).map_or(0.0, |last| taken_ns.saturating_sub(last) as f64 * 1e-9);
        let usable = |tip: &SeenTip| {
            tip.xyz_mm.norm() <= FARTHEST_MM
                && tip.xyz_mm.z >= NEAREST_MM
                && (goals.min_score..=1.0).contains(&tip.score)
        };
        let sound =
            joints_rad.iter().chain(set_point_rad.into_iter().flat_map(|s| s.iter())).all(|v| v.abs() <= FARTHEST_RAD);
        let Some(tip) = tip.filter(usable).filter(|_| sound) else {
            self.reset();
            return None;
        };
        let measured = self.chain.stance(joints_rad);
        let in_room = measured.base_from_camera * Point3::from(tip.xyz_mm);
        let (place, movement) = self.follow(&tip, &in_room.coords, &measured, dt_s, cameras, goals);

        // The arm's angles when this demand takes effect.
        let coming = set_point_rad.map_or(*joints_rad, |set| set + self.asked * dt_s);
        let stance = self.chain.stance(&coming);
        let age_s = if tip.age_s > 0.0 { tip.age_s.min(MAX_AGE_S) } else { 0.0 };
        let ahead = Point3::from(place + movement * (goals.latency_s + dt_s + age_s));
        let point = stance.base_from_camera.inverse_transform_point(&ahead).coords;
        let plain = errors(&tip.xyz_mm, cameras, goals.distance_mm);
        let coming_errors = errors(&point, cameras, goals.distance_mm);
        let mut rates = Errors::zeros();
        let is_limited = self.is_limited(set_point_rad, dt_s);
        for k in 0..3 {
            let gains = if k < 2 { &goals.picture } else { &goals.distance };
            // The set-point in the picture is constant; the requested distance may change.
            let measured = if k < 2 { coming_errors[k] } else { coming_errors[k] + goals.distance_mm };
            let sample = Sample { error: coming_errors[k], slow_error: plain[k], measured, is_limited };
            rates[k] = -self.pids[k].step(gains, &sample, dt_s);
        }
        let point = Vector3::new(point.x, point.y, point.z.max(NEAREST_MM));
        let own = stance.base_from_camera.inverse_transform_vector(&movement);
        let wanted = task::interaction(&point, cameras.focal_px, cameras.baseline_mm / 2.0)
            .try_inverse()
            .map_or(Vector3::zeros(), |inverse| inverse * rates)
            - own * goals.feed_forward;
        let solved =
            task::solve(&self.chain, &coming, &stance, &self.up, &Wanted { point_mm: point, velocity_mm_s: wanted });
        (self.asked, self.share, self.set_point) = (solved.velocity, solved.share, set_point_rad.copied());
        Some(Step {
            velocity: solved.velocity,
            errors: plain,
            error_mm: (tip.xyz_mm - goal_mm(goals.distance_mm, cameras.baseline_mm)).norm(),
            tip_mm_s: movement,
            singular: solved.singular,
            share: solved.share,
        })
    }

    /// Position and velocity of the tip in the base's frame.
    fn follow(
        &mut self,
        tip: &SeenTip,
        in_room: &Vector3<f64>,
        measured: &crate::chain::Stance,
        dt_s: f64,
        cameras: &CameraGeometry,
        goals: &Goals,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let model = Model { acceleration_mm_s2: goals.acceleration_mm_s2, ..Model::default() };
        let turn = measured.base_from_camera.rotation.to_rotation_matrix();
        let seen = stereo_covariance(&tip.xyz_mm, cameras.focal_px.0, cameras.baseline_mm, LATERAL_PX, DISPARITY_PX);
        let covariance = turn.matrix() * seen * turn.matrix().transpose();
        let kept = self.tip.as_mut().is_some_and(|filter| {
            filter.predict(&model, dt_s);
            filter.update(&model, in_room, &covariance)
        });
        if !kept {
            self.tip = Kalman::begin(in_room, &covariance);
        }
        self.tip.map_or((*in_room, Vector3::zeros()), |filter| (filter.position_mm(), filter.velocity_mm_s()))
    }
}
