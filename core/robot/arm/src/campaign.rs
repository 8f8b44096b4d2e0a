//! Random and hostile inputs for the interlock, and a checker that sees only set-points and limits.

use nalgebra::Vector3;

use crate::chain::{Chain, JOINTS, JointVector};
use crate::interlock::caps::{self, Caps, STEP_S, share};
use crate::interlock::{Cause, Evidence, Interlock, SetPoint, Settings, TubePose};

/// A small generator (xorshift64*): the same seed gives the same campaign everywhere.
pub struct Random(u64);

impl Random {
    /// A generator with this seed.
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    /// A number from 0 to 1.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / 9_007_199_254_740_992.0
    }

    /// A number below `n`.
    pub fn of(&mut self, n: u64) -> u64 {
        self.bits() % n.max(1)
    }

    /// A number that breaks careless arithmetic: NaN, infinite, huge, tiny.
    pub fn hostile(&mut self) -> f64 {
        match self.of(10) {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => f64::NEG_INFINITY,
            3 => f64::MAX,
            4 => f64::MIN_POSITIVE,
            5 => -0.0,
            6 => f64::from_bits(self.bits()),
            7 => (self.unit() - 0.5) * 1e6,
            _ => (self.unit() - 0.5) * 4.0,
        }
    }
}

/// Result of a campaign.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Number of inputs.
    pub cases: u64,
    /// Number of set-points checked.
    pub set_points: u64,
    /// Number of set-points beyond a limit.
    pub escapes: u64,
    /// Description of the first of them.
    pub first: Option<String>,
    /// Largest share of each limit used: angles (of the half range), speed, acceleration, jerk, camera speed, pivot,
    /// tilt.
    pub most: [f64; 7],
    /// Number of inputs under each cause, by [`Cause::number`].
    pub causes: [u64; Cause::ALL.len() + 1],
    /// Number of inputs with which the arm moved.
    pub moving: u64,
}

impl Outcome {
    /// Adds another outcome to this one.
    pub fn add(&mut self, other: Self) {
        self.cases += other.cases;
        self.set_points += other.set_points;
        self.escapes += other.escapes;
        self.first = self.first.take().or(other.first);
        self.moving += other.moving;
        self.most.iter_mut().zip(other.most).for_each(|(most, other)| *most = most.max(other));
        self.causes.iter_mut().zip(other.causes).for_each(|(count, other)| *count += other);
    }
}

/// Checks set-points alone: speed, acceleration and jerk are differences of positions.
struct Checker {
    caps: Caps,
    chain: Chain,
    home: Vector3<f64>,
    last: [JointVector; 3],
    count: u64,
}

impl Checker {
    fn new(chain: Chain, start: &SetPoint) -> Self {
        let home = chain.stance(&JointVector::zeros()).base_from_tip * Vector3::z();
        Self { caps: Caps::of(&chain), chain, home, last: [start.position; 3], count: 0 }
    }

    fn look(&mut self, point: &SetPoint, out: &mut Outcome) {
        let [p1, p2, p3] = self.last;
        let p = point.position;
        let velocity = (p - p1) / STEP_S;
        let acceleration = (p - p1 * 2.0 + p2) / (STEP_S * STEP_S);
        let jerk = (p - p1 * 3.0 + p2 * 3.0 - p3) / (STEP_S * STEP_S * STEP_S);
        self.last = [p, p1, p2];
        let stance = self.chain.stance(&p);
        let tube = TubePose::of(&self.chain, &stance, &self.home);
        let middle = (self.caps.upper_rad + self.caps.lower_rad) / 2.0;
        let half = (self.caps.upper_rad - self.caps.lower_rad) / 2.0;
        let shares = [
            share(&(p - middle), &half),
            share(&velocity, &self.caps.speed),
            share(&acceleration, &self.caps.acceleration),
            share(&jerk, &self.caps.jerk),
            stance.camera_velocity(&velocity).norm() / caps::CAMERA_MM_S,
            tube.pivot_mm / caps::PIVOT_MM,
            tube.tilt_rad / caps::TILT_RAD,
        ];
        out.set_points += 1;
        self.count += 1;
        // Differences of numbers near 1 leave 1e-16 / h^3 of nothing.
        let within =
            shares.iter().all(|s| *s <= 1.0 + 1e-4) && tube.is_allowed(false) && p.iter().all(|v| v.is_finite());
        if !within {
            out.escapes += 1;
            if out.first.is_none() {
                out.first = Some(format!("set-point {}: shares {shares:?}, {tube:?}", self.count));
            }
        }
        for (most, share) in out.most.iter_mut().zip(shares) {
            *most = most.max(share);
        }
    }
}

/// Plays `cases` inputs, in runs of a few hundred from fresh interlocks. Most are hostile; some are valid, because
/// otherwise the arm would never move.
pub fn run(chain: &Chain, seed: u64, cases: u64) -> Outcome {
    let mut random = Random::new(seed);
    let mut out = Outcome::default();
    while out.cases < cases {
        one_run(chain, &mut random, (cases - out.cases).min(400), &mut out);
    }
    out
}

fn one_run(chain: &Chain, random: &mut Random, cases: u64, out: &mut Outcome) {
    // Starts inside the workspace, near home: elsewhere nothing may move at all.
    let start = JointVector::zeros();
    let mut now_ns = random.of(1_000_000_000_000) as i64;
    let mut lock = Interlock::new(chain.clone(), start, now_ns);
    let mut checker = Checker::new(chain.clone(), lock.set_point());
    let hostility = random.unit();
    let mut heading = JointVector::zeros();
    for _ in 0..cases {
        let wild = random.unit() < 0.3 * hostility;
        // Time.
        now_ns = match (wild, random.of(12)) {
            (true, 0) => now_ns.saturating_sub(random.of(1_000_000_000) as i64),
            (true, 1) => now_ns.saturating_add(random.of(100_000_000_000) as i64),
            (true, 2) => random.bits() as i64,
            (true, 3) => now_ns,
            (true, 4) => [i64::MIN, i64::MAX, 0][random.of(3) as usize],
            _ => now_ns.saturating_add(random.of(35_000_000) as i64),
        };
        lock.advance(now_ns, &mut |point| checker.look(point, out));
        // Settings.
        if random.of(20) == 0 {
            lock.set(Settings { max_age_ms: random.hostile() * 100.0, min_score: random.hostile() });
        } else if random.of(4) == 0 {
            lock.set(Settings::default());
        }
        // The tip.
        if !(wild && random.of(3) == 0) {
            let score = if wild { random.hostile() } else { 0.5 + random.unit() / 2.0 };
            lock.tip(now_ns, Evidence { score, in_space: !wild || random.of(8) != 0 });
        }
        // The demand: held on, turned around, or anything.
        match random.of(6) {
            0 => heading = JointVector::from_fn(|_, _| (random.unit() - 0.5) * 2.0),
            1 => heading = -heading,
            2 => heading = about_trocar(chain, lock.set_point(), random),
            3 if random.of(4) == 0 => heading = JointVector::zeros(),
            _ => {}
        }
        if wild && random.of(2) == 0 {
            let count = if random.of(4) == 0 { random.of(9) as usize } else { JOINTS };
            let values: Vec<f64> = (0..count).map(|_| random.hostile()).collect();
            lock.demand(now_ns, &values);
        } else if random.of(12) != 0 {
            lock.demand(now_ns, heading.as_slice());
        }
        if wild && random.of(40) == 0 {
            let latching: Vec<Cause> = Cause::ALL.into_iter().filter(|cause| cause.latches()).collect();
            lock.latch(latching[random.of(latching.len() as u64) as usize]);
        }
        if random.of(30) == 0 {
            lock.release();
        }
        while lock.take_event().is_some() {}
        out.cases += 1;
        out.causes[lock.stop().map_or(0, Cause::number)] += 1;
        out.moving += u64::from(!lock.set_point().is_at_rest());
    }
}

/// A demand for rotation about the trocar at full speed, the only kind that moves the arm far.
fn about_trocar(chain: &Chain, at: &SetPoint, random: &mut Random) -> JointVector {
    let stance = chain.stance(&at.position);
    let mut any = || (random.unit() - 0.5) * 400.0;
    let wanted = crate::task::Wanted {
        point_mm: Vector3::new(7.5, 0.0, 65.0),
        velocity_mm_s: Vector3::new(any(), any(), any()),
    };
    let up = chain.stance(&JointVector::zeros()).base_from_camera * -Vector3::y();
    crate::task::solve(chain, &at.position, &stance, &up, &wanted).velocity
}
