//! Computes when each frame of a video is shown.

/// In files of a constant rate, a frame is repeated for at most this long when the next one comes later.
const MAX_REPEAT_MS: u64 = 10_000;

/// Converts capture times to times in the file.
#[derive(Debug, Default)]
pub struct Timeline {
    /// Capture time of a frame (ns) and its time in the file (ms); later frames are placed relative to it.
    base: Option<(i64, u64)>,
    last: Option<(i64, u64)>,
    step_ms: u64,
}

impl Timeline {
    /// When the next frame, captured at `at_ns`, is shown, in ms from the first one: always later than the previous one. A source that restarts
    /// continues one step after its last frame.
    pub fn next_ms(&mut self, at_ns: i64) -> u64 {
        let time_ms = self.timed_ms(at_ns);
        let time_ms = self.last.map_or(time_ms, |(_, last_ms)| time_ms.max(last_ms + 1));
        if let Some((_, last_ms)) = self.last {
            self.step_ms = time_ms - last_ms;
        }
        self.last = Some((at_ns, time_ms));
        time_ms
    }

    fn timed_ms(&mut self, at_ns: i64) -> u64 {
        let Some((last_ns, last_ms)) = self.last else {
            self.base = Some((at_ns, 0));
            return 0;
        };
        if at_ns < last_ns {
            self.base = Some((at_ns, last_ms + self.step_ms.max(1)));
        }
        let (base_ns, base_ms) = self.base.unwrap_or((at_ns, 0));
        base_ms + ms(at_ns.saturating_sub(base_ns))
    }
}

fn ms(ns: i64) -> u64 {
    (ns.max(0) as u64 + 500_000) / 1_000_000
}

/// How often frames are written into a file of a constant rate, so that each is shown for as long as it was the newest.
#[derive(Debug)]
pub struct Pacing {
    rate_hz: f64,
    timeline: Timeline,
    /// Number of frames in the file, and the number that the capture times ask for.
    written: u64,
    skipped_ms: u64,
    last_ms: u64,
}

impl Pacing {
    /// A file of `rate_hz` frames per second.
    pub fn new(rate_hz: f64) -> Self {
        Self { rate_hz, timeline: Timeline::default(), written: 0, skipped_ms: 0, last_ms: 0 }
    }

    /// How often the previous frame must be repeated before the one that was captured at `at_ns` is written.
    pub fn repeats(&mut self, at_ns: i64) -> u64 {
        let time_ms = self.timeline.next_ms(at_ns);
        self.skipped_ms += (time_ms - self.last_ms).saturating_sub(MAX_REPEAT_MS);
        self.last_ms = time_ms;
        let place = ((time_ms - self.skipped_ms) as f64 * self.rate_hz / 1000.0).round() as u64;
        let repeats = if self.written == 0 { 0 } else { place.saturating_sub(self.written) };
        self.written += repeats + 1;
        repeats
    }

    /// How far the file lags because frames come faster than its rate, ms.
    pub fn behind_ms(&self) -> f64 {
        let ends_ms = self.written.saturating_sub(1) as f64 * 1000.0 / self.rate_hz;
        ends_ms - (self.last_ms - self.skipped_ms) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn pictures_keep_their_times_and_always_go_on() {
        let mut line = Timeline::default();
        let times: Vec<u64> = [500, 540, 540, 700].map(|ms| line.next_ms(ms * MS)).to_vec();
        assert_eq!(times, [0, 40, 41, 200]);
        // The source was opened again and counts from 0.
        assert_eq!([0, 40, 80].map(|ms| line.next_ms(ms * MS)), [359, 399, 439]);
    }

    #[test]
    fn a_constant_rate_repeats_pictures_that_were_shown_longer() {
        let mut pacing = Pacing::new(30.0);
        // A camera at 30 Hz that falls to 10 Hz.
        let repeats: Vec<u64> = [0, 33, 67, 100, 200, 300].map(|ms| pacing.repeats(ms * MS)).to_vec();
        assert_eq!(repeats, [0, 0, 0, 0, 2, 2]);
        assert_eq!(pacing.repeats(7_200_300 * MS), 299, "two hours without a picture are not filled");
        let mut slow = Pacing::new(10.0);
        assert!((0..60).all(|k| slow.repeats(k * 33 * MS) == 0), "no picture is left out");
        assert!(slow.behind_ms() > 3000.0);
    }
}
