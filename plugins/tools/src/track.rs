//! Numbers that stay with an object over time: greedy matching by overlap with a constant-velocity guess (after Bewley et al. 2016, SORT).

use panoscope_node::abi::Detection;

use crate::candidates::iou;

struct Track {
    id: i64,
    class_index: u32,
    /// Predicted left, upper, right and lower edge, px.
    corners: [f32; 4],
    /// Velocity of the edges, px/s.
    velocity: [f32; 4],
    /// Time since the object was seen, in s.
    unseen_s: f32,
    /// Ticks since the object was seen.
    missed: u32,
}

/// Assigns a `track_id` to detections.
#[derive(Default)]
pub struct Tracker {
    tracks: Vec<Track>,
    pairs: Vec<(f32, usize, usize)>,
    next_id: i64,
    last_ns: Option<i64>,
}

/// Overlap below which a box is another object.
const MIN_IOU: f32 = 0.2;
/// Longest time for which an unseen object keeps its number, ns ...
const MEMORY_S: f32 = 0.5;
/// ... or ticks, for slower detectors.
const MEMORY_TICKS: u32 = 3;
/// The velocity of an unseen object falls by this share in each 30th of a second.
const FADE: f32 = 0.7;

fn corners_of(d: &Detection) -> [f32; 4] {
    [d.x_px, d.y_px, d.x_px + d.width_px, d.y_px + d.height_px]
}

impl Tracker {
    /// Assigns numbers to the objects of one tick, whose picture was taken at `capture_ns`. Objects move by the time passed, whatever the number of
    /// ticks.
    pub fn follow(&mut self, items: &mut [Detection], capture_ns: i64) {
        let dt_s = self.last_ns.replace(capture_ns).map_or(0.0, |last| capture_ns.saturating_sub(last) as f32 * 1e-9);
        if dt_s < 0.0 {
            // The source begins anew: where things were says nothing about where they are.
            self.tracks.clear();
        }
        let dt_s = dt_s.max(0.0);
        self.pairs.clear();
        for (t, track) in self.tracks.iter_mut().enumerate() {
            (0..4).for_each(|k| track.corners[k] += track.velocity[k] * dt_s);
            for (d, item) in items.iter().enumerate() {
                let overlap = iou(&track.corners, &corners_of(item));
                if item.class_index == track.class_index && overlap >= MIN_IOU {
                    self.pairs.push((overlap, t, d));
                }
            }
        }
        self.pairs.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        items.iter_mut().for_each(|i| i.track_id = -1);
        for track in &mut self.tracks {
            track.missed += 1;
            track.unseen_s += dt_s;
        }
        for &(_, t, d) in &self.pairs {
            let (track, item) = (&mut self.tracks[t], &mut items[d]);
            if track.missed > 0 && item.track_id < 0 {
                let seen = corners_of(item);
                if track.unseen_s > 0.0 {
                    // Half of the surprise becomes velocity.
                    let surprise = |k: usize| 0.5 * (seen[k] - track.corners[k]) / track.unseen_s;
                    track.velocity = std::array::from_fn(|k| track.velocity[k] + surprise(k));
                }
                (track.corners, track.missed, track.unseen_s, item.track_id) = (seen, 0, 0.0, track.id);
            }
        }
        self.tracks.retain(|t| t.unseen_s <= MEMORY_S || t.missed <= MEMORY_TICKS);
        let fade = FADE.powf(dt_s * 30.0);
        self.tracks.iter_mut().filter(|t| t.missed > 0).for_each(|t| t.velocity.iter_mut().for_each(|v| *v *= fade));
        for item in items.iter_mut().filter(|i| i.track_id < 0) {
            item.track_id = self.next_id;
            let (class_index, corners) = (item.class_index, corners_of(item));
            self.tracks.push(Track {
                id: self.next_id,
                class_index,
                corners,
                velocity: [0.0; 4],
                unseen_s: 0.0,
                missed: 0,
            });
            self.next_id += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x_px: f32) -> Detection {
        Detection { x_px, y_px: 10.0, width_px: 20.0, height_px: 20.0, score: 0.9, class_index: 0, track_id: -1 }
    }

    fn step(tracker: &mut Tracker, ms: i64, boxes: &[f32]) -> Vec<i64> {
        let mut items: Vec<Detection> = boxes.iter().map(|x| at(*x)).collect();
        tracker.follow(&mut items, ms * 1_000_000);
        items.iter().map(|i| i.track_id).collect()
    }

    /// 150 px/s: 5 px from one tick to the next at 30 Hz. Ticks are lost on the way, as in a live graph.
    #[test]
    fn a_moving_object_keeps_its_number_over_dropped_ticks() {
        let mut tracker = Tracker::default();
        let place = |ms: i64| ms as f32 * 0.15;
        for tick in 0..20 {
            assert_eq!(step(&mut tracker, tick * 33, &[place(tick * 33)]), [0]);
        }
        // 200 ms later it is 30 px farther, more than its own width: only its velocity in time finds it.
        let ms = 19 * 33 + 200;
        assert_eq!(step(&mut tracker, ms, &[place(ms)]), [0]);
    }

    #[test]
    fn an_object_is_forgotten_after_a_time_not_after_a_count_of_ticks() {
        let mut tracker = Tracker::default();
        step(&mut tracker, 0, &[50.0]);
        // 100 Hz: 40 ticks are 400 ms.
        for tick in 1..=40 {
            step(&mut tracker, tick * 10, &[]);
        }
        assert_eq!(step(&mut tracker, 410, &[50.0]), [0]);
        for tick in 1..=60 {
            step(&mut tracker, 410 + tick * 10, &[]);
        }
        assert_eq!(step(&mut tracker, 1020, &[50.0]), [1]);
        // A detector that looks twice a second forgives one miss.
        let mut slow = Tracker::default();
        step(&mut slow, 0, &[50.0]);
        step(&mut slow, 500, &[]);
        assert_eq!(step(&mut slow, 1000, &[50.0]), [0]);
    }

    #[test]
    fn a_source_that_begins_anew_brings_new_objects() {
        let mut tracker = Tracker::default();
        step(&mut tracker, 5000, &[50.0]);
        assert_eq!(step(&mut tracker, 0, &[50.0]), [1]);
    }
}
