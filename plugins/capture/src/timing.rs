//! Capture times of the ticks, and pacing of frames.

use std::time::Duration;

use crate::source::Clock;

/// Maximum wait for a frame's time; a larger jump in a file's timestamps is not waited for.
const MAX_PAUSE: Duration = Duration::from_millis(1500);

/// Times of one instance, ns. Times of the host's clock are passed in by the caller.
#[derive(Debug)]
pub struct Timing {
    /// Capture time of the newest tick; -1 before the first.
    pub capture_ns: i64,
    /// Host time, and the capture time at that moment, from which the pace counts.
    pace_from: Option<(i64, i64)>,
    /// The same for devices, whose capture time is the host's.
    device_from: Option<(i64, i64)>,
    /// How media time becomes capture time.
    pub played: Played,
}

impl Default for Timing {
    fn default() -> Self {
        Self { capture_ns: -1, pace_from: None, device_from: None, played: Played::default() }
    }
}

/// How the media time of a file becomes capture time: equal to it until the file is held or played at another speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Played {
    /// Media time of the newest frame, ns.
    pub media_ns: f64,
    /// Media time and capture time of one moment, from which `speed` counts, ns.
    pub from_media_ns: f64,
    pub from_capture_ns: f64,
    /// Media time per capture time.
    pub speed: f64,
}

impl Default for Played {
    fn default() -> Self {
        Self { media_ns: 0.0, from_media_ns: 0.0, from_capture_ns: 0.0, speed: 1.0 }
    }
}

/// Where the time of a frame comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Time {
    /// The source gives it: media time, s.
    Media(f64),
    /// Arrival by the host's clock, ns, for a live source; `None` for a tick without a frame.
    Device(Option<i64>),
    /// The number of the tick and the rate, Hz.
    Rate(u64, f64),
}

impl Timing {
    /// Computes the capture time of a tick, always later than the previous one. `speed`: of files.
    pub fn advance(&mut self, time: Time, speed: f64, clock: Clock<'_>) -> i64 {
        let next_ns = match time {
            Time::Media(media_s) => self.shown_at(media_s * 1e9, speed),
            Time::Device(arrived_ns) => {
                let now_ns = arrived_ns.unwrap_or_else(clock);
                let (start_ns, first_ns) = *self.device_from.get_or_insert((now_ns, self.capture_ns + 1));
                first_ns + now_ns.saturating_sub(start_ns)
            }
            Time::Rate(tick, rate_hz) => self.shown_at(tick as f64 * 1e9 / rate_hz, speed),
        };
        self.capture_ns = next_ns.max(self.capture_ns + 1);
        self.capture_ns
    }

    /// Capture time of a frame of a file, ns.
    fn shown_at(&mut self, media_ns: f64, speed: f64) -> i64 {
        if speed != self.played.speed {
            self.count_from_now();
            self.played.speed = speed;
        }
        let played = &mut self.played;
        played.media_ns = media_ns;
        (played.from_capture_ns + (media_ns - played.from_media_ns) / played.speed).round() as i64
    }

    /// Lets `period_ns` pass without a new frame; returns the capture time.
    pub fn hold(&mut self, period_ns: i64) -> i64 {
        self.capture_ns += period_ns;
        self.count_from_now();
        self.capture_ns
    }

    fn count_from_now(&mut self) {
        self.played.from_media_ns = self.played.media_ns;
        self.played.from_capture_ns = self.capture_ns.max(0) as f64;
    }

    /// Media time of the newest frame, s, in whole ns.
    pub fn media_s(&self) -> f64 {
        self.played.media_ns.max(0.0).round() / 1e9
    }

    /// Resets the pace: the next paced frame is due at once.
    pub fn reset_pace(&mut self) {
        self.pace_from = None;
    }

    /// Sleeps until the newest frame is due. `period` is the time between two frames.
    pub fn wait(&mut self, period: Duration, clock: Clock<'_>) {
        let now_ns = clock();
        let (start_ns, first_ns) = *self.pace_from.get_or_insert((now_ns, self.capture_ns));
        let due_ns = start_ns.saturating_add((self.capture_ns - first_ns).max(0));
        let pause = Duration::from_nanos(u64::try_from(due_ns.saturating_sub(now_ns)).unwrap_or(0));
        std::thread::sleep(pause.min(MAX_PAUSE));
        let late = Duration::from_nanos(u64::try_from(now_ns.saturating_sub(due_ns)).unwrap_or(0));
        // After a long pause the missed pictures are not made up for.
        if late > period || pause > MAX_PAUSE {
            self.pace_from = Some((clock(), self.capture_ns));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn devices_take_the_hosts_time_and_never_repeat_one() {
        let now_ns = Cell::new(7_000);
        let clock = || now_ns.get();
        let mut timing = Timing::default();
        assert_eq!(timing.advance(Time::Device(None), 1.0, &clock), 0);
        assert_eq!(timing.advance(Time::Device(None), 1.0, &clock), 1, "the clock stands still");
        now_ns.set(7_500);
        assert_eq!(timing.advance(Time::Device(None), 1.0, &clock), 500);
        now_ns.set(0);
        assert_eq!(timing.advance(Time::Device(None), 1.0, &clock), 501, "the clock went back");
        assert_eq!(timing.advance(Time::Device(Some(8_000)), 1.0, &clock), 1_000, "the arrival stands for the clock");
    }

    #[test]
    fn media_times_never_go_back() {
        let mut timing = Timing::default();
        let clock = || panic!("media time needs no clock");
        assert_eq!(timing.advance(Time::Media(0.5), 1.0, &clock), 500_000_000);
        assert_eq!(timing.advance(Time::Media(0.4), 1.0, &clock), 500_000_001);
        assert_eq!(timing.advance(Time::Rate(30, 30.0), 1.0, &clock), 1_000_000_000);
    }

    #[test]
    fn capture_times_follow_the_speed_and_go_on_while_a_frame_is_held() {
        let mut timing = Timing::default();
        let clock = || panic!("media time needs no clock");
        assert_eq!(timing.advance(Time::Media(0.0), 2.0, &clock), 0);
        assert_eq!(timing.advance(Time::Media(0.2), 2.0, &clock), 100_000_000);
        assert_eq!(timing.hold(50_000_000), 150_000_000);
        assert_eq!(timing.hold(50_000_000), 200_000_000);
        assert_eq!(timing.advance(Time::Media(0.3), 2.0, &clock), 250_000_000);
        assert_eq!(timing.advance(Time::Media(0.4), 0.5, &clock), 450_000_000);
        assert_eq!(timing.advance(Time::Media(0.5), 1.0, &clock), 550_000_000);
        assert_eq!(timing.media_s(), 0.5);
    }

    #[test]
    fn a_picture_that_is_late_by_more_than_its_period_starts_the_pace_anew() {
        let now_ns = Cell::new(0);
        let clock = || now_ns.get();
        let period = Duration::from_millis(1);
        let mut timing = Timing { capture_ns: 0, ..Timing::default() };
        timing.wait(period, &clock);
        assert_eq!(timing.pace_from, Some((0, 0)));
        (timing.capture_ns, _) = (1_000_000, now_ns.set(1_500_000));
        timing.wait(period, &clock);
        assert_eq!(timing.pace_from, Some((0, 0)), "late by half a period");
        (timing.capture_ns, _) = (2_000_000, now_ns.set(9_000_000));
        timing.wait(period, &clock);
        assert_eq!(timing.pace_from, Some((9_000_000, 2_000_000)));
        timing.reset_pace();
        assert_eq!(timing.pace_from, None);
    }
}
