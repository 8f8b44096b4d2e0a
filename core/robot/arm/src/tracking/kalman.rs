//! A point that moves in space: Kalman filter of constant velocity with a gate (Bar-Shalom, Li, Kirubarajan,
//! "Estimation with Applications to Tracking and Navigation", 2001, chapters 5 and 6).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

type State = SVector<f64, 6>;
type Covariance = SMatrix<f64, 6, 6>;

/// Parameters of the motion and of the gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Standard deviation of the unknown acceleration, mm/s^2.
    pub acceleration_mm_s2: f64,
    /// Squared Mahalanobis distance beyond which a measurement belongs to another point; 16.3 accepts 99.9 % of valid
    /// ones.
    pub gate: f64,
}

impl Default for Model {
    fn default() -> Self {
        Self { acceleration_mm_s2: 150.0, gate: 16.3 }
    }
}

/// Standard deviation of the speed after one measurement, mm/s.
const FIRST_SPEED_MM_S: f64 = 25.0;
/// Longest time of one prediction, s.
const MAX_S: f64 = 10.0;

/// State and covariance of position and velocity.
#[derive(Clone, Copy, Debug)]
pub struct Kalman {
    state: State,
    covariance: Covariance,
}

/// Covariance in mm^2 of a point seen by two cameras, in their frame: `lateral_px` and `disparity_px` are standard
/// deviations in the image.
pub fn stereo_covariance(
    xyz_mm: &Vector3<f64>,
    focal_px: f64,
    baseline_mm: f64,
    lateral_px: f64,
    disparity_px: f64,
) -> Matrix3<f64> {
    let z = xyz_mm.z.abs().max(1.0);
    let across = z / focal_px.max(1.0) * lateral_px;
    let deep = z * z / (focal_px * baseline_mm).max(1.0) * disparity_px;
    // An error in depth moves the point along its ray.
    let ray = xyz_mm / z;
    ray * ray.transpose() * (deep * deep) + Matrix3::from_diagonal_element(across * across)
}

impl Kalman {
    /// Starts at a first measurement; `None` when a number is not finite.
    pub fn begin(at_mm: &Vector3<f64>, covariance_mm2: &Matrix3<f64>) -> Option<Self> {
        if !at_mm.iter().chain(covariance_mm2.iter()).all(|v| v.is_finite()) {
            return None;
        }
        let mut filter = Self { state: State::zeros(), covariance: Covariance::zeros() };
        filter.state.fixed_rows_mut::<3>(0).copy_from(at_mm);
        filter.covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(covariance_mm2);
        let speed = Matrix3::from_diagonal_element(FIRST_SPEED_MM_S * FIRST_SPEED_MM_S);
        filter.covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&speed);
        Some(filter)
    }

    /// Position, mm.
    pub fn position_mm(&self) -> Vector3<f64> {
        self.state.fixed_rows::<3>(0).into_owned()
    }

    /// Velocity, mm/s.
    pub fn velocity_mm_s(&self) -> Vector3<f64> {
        self.state.fixed_rows::<3>(3).into_owned()
    }

    /// Standard deviation of the position, mm.
    pub fn deviation_mm(&self) -> f64 {
        self.covariance.fixed_view::<3, 3>(0, 0).trace().max(0.0).sqrt()
    }

    /// Advances the state by `dt_s`. A time that is not above 0 changes nothing.
    pub fn predict(&mut self, model: &Model, dt_s: f64) {
        if dt_s.is_nan() || dt_s <= 0.0 {
            return;
        }
        let dt = dt_s.min(MAX_S);
        let mut step = Covariance::identity();
        (0..3).for_each(|k| step[(k, k + 3)] = dt);
        self.state = step * self.state;
        self.covariance = step * self.covariance * step.transpose();
        // White acceleration, constant over the step.
        let q = model.acceleration_mm_s2 * model.acceleration_mm_s2;
        for k in 0..3 {
            self.covariance[(k, k)] += q * dt.powi(4) / 4.0;
            self.covariance[(k, k + 3)] += q * dt.powi(3) / 2.0;
            self.covariance[(k + 3, k)] += q * dt.powi(3) / 2.0;
            self.covariance[(k + 3, k + 3)] += q * dt * dt;
        }
    }

    /// Improbability of a measurement: its squared Mahalanobis distance, and that plus the logarithm of the determinant
    /// of the covariance (mm^6), which compares filters of unequal certainty. `None` when the result is not finite.
    pub fn unlikelihood(&self, at_mm: &Vector3<f64>, covariance_mm2: &Matrix3<f64>) -> Option<(f64, f64)> {
        let off = at_mm - self.position_mm();
        let seen: Matrix3<f64> = self.covariance.fixed_view::<3, 3>(0, 0) + covariance_mm2;
        let distance = off.dot(&(seen.try_inverse()? * off));
        let unlikely = distance + seen.determinant().max(1e-30).ln();
        unlikely.is_finite().then_some((distance, unlikely))
    }

    /// Updates the state with a measurement if it lies within the gate. Returns whether it did.
    pub fn update(&mut self, model: &Model, at_mm: &Vector3<f64>, covariance_mm2: &Matrix3<f64>) -> bool {
        let innovation = at_mm - self.position_mm();
        let seen: Matrix3<f64> = self.covariance.fixed_view::<3, 3>(0, 0) + covariance_mm2;
        let Some(inverse) = seen.try_inverse() else { return false };
        let distance = innovation.dot(&(inverse * innovation));
        if distance.is_nan() || distance > model.gate {
            return false;
        }
        let gain: SMatrix<f64, 6, 3> = self.covariance.fixed_view::<6, 3>(0, 0) * inverse;
        self.state += gain * innovation;
        let mut retained = Covariance::identity();
        for row in 0..6 {
            for column in 0..3 {
                retained[(row, column)] -= gain[(row, column)];
            }
        }
        // Joseph's form stays symmetric and positive.
        self.covariance = retained * self.covariance * retained.transpose() + gain * covariance_mm2 * gain.transpose();
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn covariance() -> Matrix3<f64> {
        Matrix3::from_diagonal_element(0.04)
    }

    #[test]
    fn a_steady_movement_is_followed_without_lag() {
        let model = Model::default();
        let at = |t: f64| Vector3::new(3.0 + 20.0 * t, -5.0 * t, 60.0);
        let mut filter = Kalman::begin(&at(0.0), &covariance()).expect("finite");
        for k in 1..90 {
            filter.predict(&model, 1.0 / 30.0);
            assert!(filter.update(&model, &at(f64::from(k) / 30.0), &covariance()), "tick {k}");
        }
        assert!((filter.position_mm() - at(89.0 / 30.0)).norm() < 0.01);
        assert!((filter.velocity_mm_s() - Vector3::new(20.0, -5.0, 0.0)).norm() < 0.1);
        // Half a second unseen.
        filter.predict(&model, 0.5);
        assert!((filter.position_mm() - at(89.0 / 30.0 + 0.5)).norm() < 0.1);
    }

    #[test]
    fn another_tool_stays_out_of_the_gate() {
        let model = Model::default();
        let mut filter = Kalman::begin(&Vector3::new(0.0, 0.0, 60.0), &covariance()).expect("finite");
        for _ in 0..30 {
            filter.predict(&model, 1.0 / 30.0);
            assert!(filter.update(&model, &Vector3::new(0.0, 0.0, 60.0), &covariance()));
        }
        for other in
            [Vector3::new(15.0, 0.0, 60.0), Vector3::new(f64::NAN, 0.0, 60.0), Vector3::new(0.0, f64::INFINITY, 0.0)]
        {
            filter.predict(&model, 1.0 / 30.0);
            assert!(!filter.update(&model, &other, &covariance()), "{other}");
        }
        assert!(filter.position_mm().iter().all(|v| v.is_finite()));
    }

    #[test]
    fn hostile_times_change_nothing() {
        let model = Model::default();
        let mut filter = Kalman::begin(&Vector3::zeros(), &covariance()).expect("finite");
        let before = filter.state;
        for dt in [f64::NAN, -1.0, 0.0, f64::NEG_INFINITY] {
            filter.predict(&model, dt);
            assert_eq!(filter.state, before);
        }
        filter.predict(&model, f64::INFINITY);
        assert!(filter.deviation_mm().is_finite());
        assert!(Kalman::begin(&Vector3::new(f64::NAN, 0.0, 0.0), &covariance()).is_none());
    }
}
