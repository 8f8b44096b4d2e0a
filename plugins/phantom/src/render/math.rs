//! Hashes, a polynomial sine, poses. Only `+ - * / sqrt` and integers, so that the same seed gives the
//! same bits on every machine.

/// Mixes 32 bits (the two-multiply finaliser family of Wellons' hash search).
#[inline(always)]
pub fn mix32(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Hash of a list of words, in order.
pub fn hash(words: &[u32]) -> u32 {
    words.iter().fold(0x9e37_79b9, |state, &word| mix32(state.rotate_left(5) ^ word).wrapping_add(0x85eb_ca6b))
}

/// Converts a hash to a number in `0..1`.
#[inline(always)]
pub fn unit(hash: u32) -> f32 {
    (hash >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Random number in `0..1` for a frame; depends only on seed, purpose and frame.
pub fn chance(seed: u64, purpose: u32, frame: u64) -> f32 {
    unit(hash(&[seed as u32, (seed >> 32) as u32, 600 + purpose, frame as u32, (frame >> 32) as u32]))
}

/// A seeded stream of random numbers for building scenes.
#[derive(Clone, Debug)]
pub struct Stream(u32, u32);

impl Stream {
    /// A separate stream for every `(seed, purpose)`.
    pub fn new(seed: u64, purpose: u32) -> Self {
        Self(hash(&[seed as u32, (seed >> 32) as u32, purpose]), 0)
    }
    /// The next 32 bits.
    pub fn bits(&mut self) -> u32 {
        self.1 = self.1.wrapping_add(0x9e37_79b9);
        mix32(self.0 ^ mix32(self.1))
    }
    /// The next number in `low..high`.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * unit(self.bits())
    }
}

/// Sine of an angle in turns (1 = a full circle); absolute error below 1e-8.
pub fn sin_turns(turns: f64) -> f64 {
    let mut x = turns - (turns + 0.5).floor();
    if x > 0.25 {
        x = 0.5 - x;
    } else if x < -0.25 {
        x = -0.5 - x;
    }
    let a = x * std::f64::consts::TAU;
    let s = a * a;
    let tail = 1.0 / 362_880.0 - s * (1.0 / 39_916_800.0 - s * (1.0 / 6_227_020_800.0));
    a * (1.0 - s * (1.0 / 6.0 - s * (1.0 / 120.0 - s * (1.0 / 5040.0 - s * tail))))
}

/// Cosine of an angle in turns.
pub fn cos_turns(turns: f64) -> f64 {
    sin_turns(turns + 0.25)
}

/// Rises smoothly from 0 at `low` to 1 at `high` (3x^2 - 2x^3).
#[inline(always)]
pub fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    // With constant edges the division is done by the compiler.
    let t = ((x - low) * (1.0 / (high - low))).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A rigid pose `a_from_b`: a unit quaternion and a translation in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Rotation as `w, x, y, z`.
    pub quaternion: [f64; 4],
    /// Position of the origin of b in a, mm.
    pub translation_mm: [f64; 3],
}

impl Pose {
    /// No rotation and no translation.
    pub const IDENTITY: Self = Self { quaternion: [1.0, 0.0, 0.0, 0.0], translation_mm: [0.0; 3] };

    /// Rotation matrix, row by row; the quaternion is normalised first (a zero one counts as identity).
    pub fn rotation(&self) -> [[f64; 3]; 3] {
        let q = self.quaternion;
        let norm = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
        let [w, x, y, z] = if norm > 0.0 { q.map(|v| v / norm) } else { Self::IDENTITY.quaternion };
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    }

    /// Transforms the point `p` from b to a.
    pub fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        let r = self.rotation();
        std::array::from_fn(|i| r[i][0] * p[0] + r[i][1] * p[1] + r[i][2] * p[2] + self.translation_mm[i])
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.quaternion.iter().chain(&self.translation_mm).all(|v| v.is_finite())
    }
}
