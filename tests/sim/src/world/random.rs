//! Decisions derived from a seed.

use panoscope_base::random::SplitMix64;

/// A generator of decisions.
#[derive(Clone, Debug)]
pub struct Dice(SplitMix64);

impl Dice {
    /// A generator that gives the same decisions for the same seed.
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64(seed))
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// A number in `0..limit`; 0 when `limit` is 0.
    pub fn below(&mut self, limit: usize) -> usize {
        self.0.below(limit)
    }

    /// A number in `from..=to`.
    pub fn within(&mut self, from: u64, to: u64) -> u64 {
        from + self.0.below((to - from + 1) as usize) as u64
    }

    /// True once in `n` times; never for 0.
    pub fn one_in(&mut self, n: u32) -> bool {
        n > 0 && self.0.below(n as usize) == 0
    }

    /// Picks one element.
    pub fn pick<'a, T>(&mut self, of: &'a [T]) -> &'a T {
        &of[self.0.below(of.len())]
    }

    /// A separate generator for a part of the work, so that one part does not change the decisions of another.
    pub fn split(&mut self) -> Self {
        Self::new(self.bits())
    }
}
