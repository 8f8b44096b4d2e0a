//! Pseudo-random numbers that are the same on every machine: SplitMix64 (Steele, Lea, Flood, "Fast Splittable
//! Pseudorandom Number Generators", OOPSLA 2014, figure 17).

/// Increment of the state per number.
const GAMMA: u64 = 0x9e37_79b9_7f4a_7c15;

/// Generator with one number of state, initially the seed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SplitMix64(pub u64);

impl SplitMix64 {
    /// The next 64 bits.
    #[inline]
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(GAMMA);
        finish(self.0)
    }

    /// A number in `0..limit`; 0 when `limit` is 0. Uniform up to a bias of `limit` / 2^64.
    #[inline]
    pub fn below(&mut self, limit: usize) -> usize {
        ((u128::from(self.bits()) * limit as u128) >> 64) as usize
    }
}

/// The first number that follows a seed: a hash of it.
#[inline]
pub fn mix(seed: u64) -> u64 {
    SplitMix64(seed).bits()
}

/// The number `index` of the sequence that `seed` starts, counted from 1.
#[inline]
pub fn nth(seed: u64, index: u64) -> u64 {
    finish(seed.wrapping_add(index.wrapping_mul(GAMMA)))
}

/// [`mix`] as a number in `0.0..1.0`.
#[inline]
pub fn unit(seed: u64) -> f64 {
    (mix(seed) >> 11) as f64 / (1u64 << 53) as f64
}

/// White noise on the integer plane: the number in `0.0..1.0` that belongs to `(x, y)`.
pub fn lattice(x: i64, y: i64, seed: u64) -> f64 {
    let mut z = (x as u64).wrapping_mul(GAMMA) ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f) ^ seed;
    z = (z ^ (z >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Mixes the state so that each of its bits affects every bit of the result.
#[inline]
fn finish(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::{SplitMix64, lattice, mix, nth, unit};

    #[test]
    fn it_gives_the_published_numbers() {
        // First numbers of the reference program for the seed 1234567.
        let mut random = SplitMix64(1_234_567);
        let expected = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431];
        for (index, number) in expected.into_iter().enumerate() {
            assert_eq!(random.bits(), number);
            assert_eq!(nth(1_234_567, index as u64 + 1), number);
        }
        assert_eq!(mix(1_234_567), expected[0]);
        assert!((0.0..1.0).contains(&unit(1_234_567)));
    }

    #[test]
    fn the_lattice_is_even_and_neighbours_differ() {
        let values: Vec<f64> = (0..10_000).map(|i| lattice(i % 100 - 50, i / 100 - 50, 7)).collect();
        assert!(values.iter().all(|value| (0.0..1.0).contains(value)));
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
        let below = values.iter().filter(|value| **value < 0.25).count();
        assert!((2300..2700).contains(&below), "{below}");
        assert!(values.windows(2).all(|pair| pair[0] != pair[1]));
        assert_ne!(lattice(1, 2, 0), lattice(1, 2, 1));
    }

    #[test]
    fn every_side_of_a_die_comes_up() {
        let mut random = SplitMix64(1);
        let mut seen = [0; 6];
        (0..6000).for_each(|_| seen[random.below(6)] += 1);
        assert!(seen.iter().all(|n| (850..1150).contains(n)), "{seen:?}");
        assert_eq!(random.below(0), 0);
    }
}
