//! Times of messages.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

const NS: u128 = 1_000_000_000;

/// UTC as seconds since 1970 and a fraction in units of 2^-32 s. 0 means that the sender gave no time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Timestamp {
    /// Whole seconds.
    pub seconds: u32,
    /// Units of 2^-32 s.
    pub fraction: u32,
}

impl Timestamp {
    /// The time `ns` after 1970, rounded down to 0.23 ns. Times outside the format (before 1970, after 2106) are
    /// clamped.
    pub fn from_unix_ns(ns: i128) -> Self {
        let ns = ns.max(0) as u128;
        match u32::try_from(ns / NS) {
            Ok(seconds) => Self { seconds, fraction: (((ns % NS) << 32) / NS) as u32 },
            Err(_) => Self { seconds: u32::MAX, fraction: u32::MAX },
        }
    }

    /// Nanoseconds since 1970, rounded to the nearest: inverts [`Self::from_unix_ns`].
    pub fn unix_ns(self) -> i128 {
        let fraction_ns = (u128::from(self.fraction) * NS + (1 << 31)) >> 32;
        (u128::from(self.seconds) * NS + fraction_ns) as i128
    }

    /// The time of the system's clock.
    pub fn of(time: SystemTime) -> Self {
        Self::from_unix_ns(time.duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_nanos() as i128)
    }

    /// Whether the sender gave no time.
    pub fn is_unknown(self) -> bool {
        self == Self::default()
    }

    /// As one number in the message's encoding.
    pub fn to_bits(self) -> u64 {
        u64::from(self.seconds) << 32 | u64::from(self.fraction)
    }

    /// Inverts [`Self::to_bits`].
    pub fn from_bits(bits: u64) -> Self {
        Self { seconds: (bits >> 32) as u32, fraction: bits as u32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nanoseconds_survive() {
        for ns in [0, 1, 2, 499_999_999, 500_000_000, 999_999_999, 1_700_000_000_123_456_789, 4_294_967_295_999_999_999]
        {
            assert_eq!(Timestamp::from_unix_ns(ns).unix_ns(), ns);
        }
        assert_eq!(Timestamp::from_unix_ns(1_500_000_000), Timestamp { seconds: 1, fraction: 1 << 31 });
        assert_eq!(Timestamp::from_unix_ns(-5), Timestamp::default());
        assert_eq!(Timestamp::from_unix_ns(i128::MAX).seconds, u32::MAX);
        assert_eq!(Timestamp::from_bits(0x0123_4567_89AB_CDEF).to_bits(), 0x0123_4567_89AB_CDEF);
    }
}
