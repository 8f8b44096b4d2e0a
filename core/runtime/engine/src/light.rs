//! Age of the light in a packet.
//!
//! The light of a tick arrives with its source. A packet carries its tick, and in [`Tick::flags`] how much older than
//! that its oldest and its newest light are. What a node makes inherits both from its inputs that are not empty,
//! whatever their alignment:
//!
//! - An input counts with the time by which its light is older than that of the tick.
//! - A `delay` input on a loop is the state of the tick before. Its one step is not counted: it counts with the time by
//!   which its packet is older than the reader's previous tick. The lag that the packet has itself fades with the time
//!   since, so no age grows round a loop.
//! - What shows no light does not count: an input that only says where to look (`guide = true` on its edge), a
//!   `calibration`, and the packets of a source that owns no device and ended after a single tick, such as a reader of
//!   one file.
//! - What a source makes has the capture time of its own tick, whatever its inputs are.
//!
//! In `batch` and in a replay the capture time takes the place of the arrival, so that no result depends on the wall
//! clock.

use panoscope_abi::Tick;

/// Unit of a lag, ns.
const UNIT_NS: u64 = 10_000;
/// Bits of the newest lag in [`Tick::flags`]; the oldest has those above.
const NEWEST_BITS: u32 = 12;
const EXPONENT_BITS: u32 = 5;
const NEWEST: u32 = (1 << NEWEST_BITS) - 1;

/// Lag of a packet's light behind its tick, ns, not negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Lag {
    pub oldest_ns: i64,
    pub newest_ns: i64,
}

impl Lag {
    /// Light of one time.
    pub fn of(lag_ns: i64) -> Self {
        let lag_ns = lag_ns.max(0);
        Self { oldest_ns: lag_ns, newest_ns: lag_ns }
    }

    /// The lag that a packet carries.
    #[inline]
    pub fn carried(tick: &Tick) -> Self {
        if tick.flags == 0 {
            return Self::default();
        }
        let oldest_ns = decode(tick.flags >> NEWEST_BITS, 32 - NEWEST_BITS);
        // The newest has fewer digits and is rounded up further.
        Self { oldest_ns, newest_ns: decode(tick.flags & NEWEST, NEWEST_BITS).min(oldest_ns) }
    }

    /// [`Tick::flags`], rounded up: nothing looks younger than it is.
    pub fn flags(self) -> u32 {
        encode(self.oldest_ns, 32 - NEWEST_BITS) << NEWEST_BITS | encode(self.newest_ns, NEWEST_BITS)
    }

    /// Lag of data made from both.
    fn with(self, other: Self) -> Self {
        Self { oldest_ns: self.oldest_ns.max(other.oldest_ns), newest_ns: self.newest_ns.min(other.newest_ns) }
    }
}

/// The later of both lags, oldest and newest each, as [`Tick::flags`].
#[inline]
pub(crate) fn later(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { (a & !NEWEST).max(b & !NEWEST) | (a & NEWEST).max(b & NEWEST) }
}

/// A number of `bits` bits, of which [`EXPONENT_BITS`] are the exponent: exact while it is small, rounded up from there
/// on.
fn encode(lag_ns: i64, bits: u32) -> u32 {
    let digits = bits - EXPONENT_BITS;
    let units = lag_ns.max(0).unsigned_abs().div_ceil(UNIT_NS);
    let mut shift = (u64::BITS - units.leading_zeros()).saturating_sub(digits + 1);
    let mut digits_up = units.div_ceil(1 << shift);
    if digits_up >> (digits + 1) != 0 {
        (shift, digits_up) = (shift + 1, digits_up >> 1);
    }
    let code = (u64::from(shift) << digits) + digits_up;
    u32::try_from(code).unwrap_or(u32::MAX).min((1 << bits) - 1)
}

/// The inverse of [`encode`], ns.
fn decode(code: u32, bits: u32) -> i64 {
    let digits = bits - EXPONENT_BITS;
    let shift = (code >> digits).saturating_sub(1);
    let units = u64::from(code - (shift << digits)) << shift;
    i64::try_from(units.saturating_mul(UNIT_NS)).unwrap_or(i64::MAX)
}

/// The sources of a running graph.
pub(crate) trait Sources {
    /// When the light of a tick arrived, in ns of the host's clock; negative for light from before its start. `None`
    /// where it is unknown.
    fn arrived_ns(&self, tick: &Tick) -> Option<i64>;

    /// Whether the packets of a tick show no light, because its source owns no device and ended after this one tick.
    fn is_constant(&self, tick: &Tick) -> bool;

    /// Whether a tick is so old that its arrival time was discarded; [`Self::arrived_ns`] is then too late.
    fn is_forgotten(&self, tick: &Tick) -> bool;

    /// When the oldest light of a packet arrived.
    fn light_ns(&self, tick: &Tick) -> Option<i64> {
        Some(self.arrived_ns(tick)?.saturating_sub(Lag::carried(tick).oldest_ns))
    }
}

/// The ages of packets at one moment.
pub(crate) struct Lights<'a> {
    pub sources: &'a dyn Sources,
    /// Whether ages are differences of capture times.
    pub by_capture: bool,
    /// The moment, ns of the host's clock.
    pub now_ns: u64,
}

impl Lights<'_> {
    /// When the light of a tick arrived.
    fn arrived_ns(&self, tick: &Tick) -> Option<i64> {
        if self.by_capture { Some(tick.capture_ns) } else { self.sources.arrived_ns(tick) }
    }

    /// Lag of the light of `packet` behind that of `tick`; `None` where it is unknown and for packets without light.
    pub fn lag(&self, tick: &Tick, packet: &Tick) -> Option<Lag> {
        let lag = Lag::carried(packet);
        if is_same(tick, packet) {
            return Some(lag);
        }
        if self.sources.is_constant(packet) {
            return None;
        }
        let behind_ns = self.arrived_ns(tick)?.saturating_sub(self.arrived_ns(packet)?);
        let lag_ns = |own_ns: i64| behind_ns.saturating_add(own_ns).max(0);
        Some(Lag { oldest_ns: lag_ns(lag.oldest_ns), newest_ns: lag_ns(lag.newest_ns) })
    }

    /// As [`Self::lag`], for a state that a loop feeds back; `previous` is the reader's previous tick.
    pub fn lag_of_state(&self, tick: &Tick, packet: &Tick, previous: Option<Tick>) -> Option<Lag> {
        let newest_ns = self.lag(tick, packet)?.newest_ns;
        let (tick_ns, packet_ns) = (self.arrived_ns(tick)?, self.arrived_ns(packet)?);
        let held_ns =
            previous.and_then(|previous| self.arrived_ns(&previous)).unwrap_or(tick_ns).saturating_sub(packet_ns);
        let faded_ns = Lag::carried(packet).oldest_ns.saturating_sub(tick_ns.saturating_sub(packet_ns));
        let oldest_ns = held_ns.max(faded_ns).max(0);
        Some(Lag { oldest_ns, newest_ns: newest_ns.min(oldest_ns) })
    }

    /// Age of the oldest light of a packet that is taken for `tick`: now, or at the tick's capture time; `None` as for
    /// [`Self::lag`], and `i64::MAX` for a packet of a tick so old that its age is unknown.
    pub fn age_ns(&self, tick: &Tick, packet: &Tick) -> Option<i64> {
        if self.by_capture {
            return Some(self.lag(tick, packet)?.oldest_ns);
        }
        if self.sources.is_constant(packet) {
            return None;
        }
        if self.sources.is_forgotten(packet) {
            return Some(i64::MAX);
        }
        Some(i64::try_from(self.now_ns).unwrap_or(i64::MAX).saturating_sub(self.sources.light_ns(packet)?))
    }
}

/// Lag of data made from packets with these lags, as [`Tick::flags`].
pub(crate) fn inherited(lags: impl Iterator<Item = Lag>) -> u32 {
    lags.reduce(Lag::with).map_or(0, Lag::flags)
}

/// Whether two packets are of one tick.
pub(crate) fn is_same(a: &Tick, b: &Tick) -> bool {
    (a.seq, a.source) == (b.seq, b.source)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each tick arrives at its capture time; source 9 made one tick and ended.
    struct ByCapture;

    impl Sources for ByCapture {
        fn arrived_ns(&self, tick: &Tick) -> Option<i64> {
            Some(tick.capture_ns)
        }

        fn is_constant(&self, tick: &Tick) -> bool {
            tick.source == 9
        }

        fn is_forgotten(&self, tick: &Tick) -> bool {
            tick.source == 8
        }
    }

    const MS: i64 = 1_000_000;
    const PERIOD_NS: i64 = 20 * MS;

    fn tick(seq: u64, lag: Lag) -> Tick {
        Tick { source: 1, flags: lag.flags(), seq, capture_ns: seq as i64 * PERIOD_NS }
    }

    fn lights(now_ns: u64) -> Lights<'static> {
        Lights { sources: &ByCapture, by_capture: false, now_ns }
    }

    #[test]
    fn a_lag_is_exact_while_it_is_short_and_rounded_up_by_little() {
        for ns in [0, 10_000, 20_000, 1_000_000, 30_000_000, 300_000_000] {
            let carried = Lag::carried(&Tick { flags: Lag::of(ns).flags(), ..Tick::default() });
            assert_eq!(carried.oldest_ns, ns);
            assert!((ns..=ns + ns / 64 + 1).contains(&carried.newest_ns), "{ns}: {carried:?}");
        }
        let carried = |lag: Lag| Lag::carried(&Tick { flags: lag.flags(), ..Tick::default() });
        assert_eq!((carried(Lag::of(-5)).oldest_ns, carried(Lag::of(1)).oldest_ns), (0, 10_000));
        let mut last = 0;
        for shift in 0..62 {
            for ns in [(1_i64 << shift) - 1, 1 << shift, (1 << shift) + (1 << shift >> 1)] {
                let lag = carried(Lag { oldest_ns: ns, newest_ns: 0 });
                let max_ns = ns.saturating_add(ns / 20_000).saturating_add(10_000);
                // 22 years are the end of the scale.
                assert!(lag.oldest_ns >= ns.min(1 << 59) && lag.oldest_ns <= max_ns, "{ns}: {lag:?}");
                assert!(lag.oldest_ns >= last && lag.newest_ns == 0, "{ns}: {lag:?} after {last}");
                last = lag.oldest_ns;
            }
        }
    }

    #[test]
    fn what_is_made_has_the_oldest_and_the_newest_light_of_its_inputs() {
        let lights = lights(0);
        let own = tick(100, Lag::default());
        let old = tick(40, Lag { oldest_ns: 500 * MS, newest_ns: 3 * MS });
        let lag = lights.lag(&own, &old).expect("known");
        assert_eq!(lag.oldest_ns, 60 * PERIOD_NS + 500 * MS);
        let made = Tick { flags: inherited([Lag::carried(&own), lag].into_iter()), ..own };
        assert_eq!(Lag::carried(&made), Lag { oldest_ns: 60 * PERIOD_NS + 500 * MS, newest_ns: 0 });
        assert_eq!(later(old.flags, 0), old.flags);
        assert_eq!(inherited(std::iter::empty()), 0);
        // A packet that is newer than the tick is not older than it.
        assert_eq!(lights.lag(&old, &own), Some(Lag::default()));
    }

    #[test]
    fn a_constant_has_no_age() {
        let constant = Tick { source: 9, ..Tick::default() };
        let lights = lights(u64::MAX / 4);
        assert_eq!(lights.lag(&tick(100, Lag::default()), &constant), None);
        assert_eq!(lights.age_ns(&tick(100, Lag::default()), &constant), None);
        assert!(lights.age_ns(&tick(100, Lag::default()), &tick(99, Lag::default())).is_some_and(|age| age > MS));
        let forgotten = Tick { source: 8, ..constant };
        assert_eq!(lights.age_ns(&tick(100, Lag::default()), &forgotten), Some(i64::MAX), "older than any limit");
    }

    #[test]
    fn no_age_grows_round_a_loop() {
        let lights = lights(0);
        // The producer makes a packet at every `every`-th tick, from the state before and from an input that was 5 s old once.
        for every in [1, 3, 7] {
            let (mut state, mut max_ns) = (None::<Tick>, 0);
            for seq in 0..2_000_u64 {
                let own = tick(seq, Lag::default());
                let previous = seq.checked_sub(1).map(|seq| tick(seq, Lag::default()));
                let old = if seq == 10 { Lag { oldest_ns: 5_000 * MS, newest_ns: 0 } } else { Lag::default() };
                let fed_back = state.and_then(|state| lights.lag_of_state(&own, &state, previous));
                let flags = inherited([old].into_iter().chain(fed_back));
                if seq >= 500 {
                    max_ns = max_ns.max(Lag::carried(&Tick { flags, ..own }).oldest_ns);
                } else if every == 1 && seq == 11 {
                    let lag_ns = Lag::carried(&Tick { flags, ..own }).oldest_ns;
                    assert!(lag_ns >= 4_900 * MS, "the state still rests on the old light: {lag_ns}");
                }
                if seq % every == 0 {
                    state = Some(Tick { flags, ..own });
                }
            }
            assert!(max_ns <= (every as i64 - 1) * PERIOD_NS, "{every}: {max_ns}");
        }
    }

    #[test]
    fn a_state_that_is_held_is_as_old_as_it_is() {
        let lights = lights(0);
        let (own, previous) = (tick(100, Lag::default()), Some(tick(99, Lag::default())));
        let lag_ns = |seq| lights.lag_of_state(&own, &tick(seq, Lag::default()), previous).map(|lag| lag.oldest_ns);
        assert_eq!((lag_ns(99), lag_ns(49)), (Some(0), Some(50 * PERIOD_NS)));
    }
}
