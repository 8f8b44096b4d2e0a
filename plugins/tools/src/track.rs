//! Numbers that stay with an object over time: greedy matching by overlap with constant-velocity prediction (after Bewley et al. 2016, SORT).

use panoscope_node::abi::Detection;

use crate::candidates::iou;

/// Votes for the class of a track: the sum of scores of each class, for the four strongest ones.
#[derive(Clone, Copy)]
struct Votes([(u32, f32); 4]);

impl Votes {
    fn new(class_index: u32, score: f32) -> Self {
        let mut votes = [(class_index, 0.0); 4];
        votes[0].1 = score;
        Self(votes)
    }

    /// Multiplies the weight of all votes by `share`.
    fn fade(&mut self, share: f32) {
        self.0.iter_mut().for_each(|(_, weight)| *weight *= share);
    }

    /// Adds a vote.
    fn add(&mut self, class_index: u32, score: f32) {
        match self.0.iter_mut().find(|(class, weight)| *class == class_index && *weight > 0.0) {
            Some((_, weight)) => *weight += score,
            None => {
                let weakest = (0..4).fold(0, |w, k| if self.0[k].1 < self.0[w].1 { k } else { w });
                self.0[weakest] = (class_index, score);
            }
        }
    }

    /// The class with most votes. `present` stays until another one leads by more than `margin`, so that two votes for two classes decide nothing.
    fn winner(&self, present: u32, margin: f32) -> u32 {
        let votes_of = |class: u32| self.0.iter().filter(|vote| vote.0 == class).map(|vote| vote.1).fold(0.0, f32::max);
        let best = self.0.iter().fold(self.0[0], |best, vote| if vote.1 > best.1 { *vote } else { best });
        if best.1 > votes_of(present) + margin { best.0 } else { present }
    }
}

struct Track {
    id: i64,
    /// Class of the object: as last seen, or the one with most votes.
    class_index: u32,
    votes: Votes,
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

/// Minimum overlap of a box with a track.
const MIN_IOU: f32 = 0.2;
/// The same for a box of another class, if classes are voted: stricter, because tools that pass each other overlap too.
const MIN_IOU_OF_OTHER_CLASS: f32 = 0.5;
/// Maximum time for which an unseen object keeps its number, s ...
const MEMORY_S: f32 = 0.5;
/// ... or ticks, for slower detectors.
const MEMORY_TICKS: u32 = 3;
/// Factor by which the velocity of an unseen object decreases in each 30th of a second.
const FADE: f32 = 0.7;

fn corners_of(d: &Detection) -> [f32; 4] {
    [d.x_px, d.y_px, d.x_px + d.width_px, d.y_px + d.height_px]
}

impl Tracker {
    /// Assigns numbers to the objects of one tick, whose image was captured at `capture_ns`. Objects move by the elapsed time, whatever the number of
    /// ticks.
    ///
    /// With `vote_s` above 0 a track also follows a box of another class, and each item gets the class that has most votes on its track, by more than
    /// one vote; votes are weighted by score, and their weight halves after `vote_s`. With 0 a box of another class is another object.
    ///
    /// `unknown` is the class of boxes whose kind the detector does not know: such a box may be any object, and votes for no class.
    pub fn follow(&mut self, items: &mut [Detection], capture_ns: i64, vote_s: f32, unknown: Option<u32>) {
        let is_unknown = |class_index: u32| Some(class_index) == unknown;
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
                    // Above every box of another class.
                    self.pairs.push((1.0 + overlap, t, d));
                } else if vote_s > 0.0 && overlap >= MIN_IOU_OF_OTHER_CLASS
                    || (is_unknown(item.class_index) || is_unknown(track.class_index)) && overlap >= MIN_IOU
                {
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
                if vote_s > 0.0 {
                    track.votes.fade(0.5f32.powf(track.unseen_s / vote_s));
                    if !is_unknown(item.class_index) {
                        track.votes.add(item.class_index, item.score);
                        // The first name wins over none.
                        let margin = if is_unknown(track.class_index) { 0.0 } else { item.score };
                        track.class_index = track.votes.winner(track.class_index, margin);
                    }
                    item.class_index = track.class_index;
                } else if is_unknown(track.class_index) {
                    track.class_index = item.class_index;
                }
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
                votes: Votes::new(class_index, if is_unknown(class_index) { 0.0 } else { item.score }),
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
        tracker.follow(&mut items, ms * 1_000_000, 0.0, None);
        items.iter().map(|i| i.track_id).collect()
    }

    /// 150 px/s: 5 px from one tick to the next at 30 Hz. Some ticks are dropped, as in a live graph.
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

    /// Class and number of one box per tick at 30 Hz, whose class the detector gives as `classes`; votes halve in a second.
    fn voted(tracker: &mut Tracker, first_tick: i64, classes: &[u32], vote_s: f32) -> Vec<(u32, i64)> {
        let one = |(tick, class_index): (usize, &u32)| {
            let tick = first_tick + tick as i64;
            let mut items = [Detection { class_index: *class_index, ..at(tick as f32) }];
            tracker.follow(&mut items, tick * 33_000_000, vote_s, Some(7));
            (items[0].class_index, items[0].track_id)
        };
        classes.iter().enumerate().map(one).collect()
    }

    #[test]
    fn a_class_that_flickers_is_voted_down_and_the_number_stays() {
        let classes: Vec<u32> = (0..60).map(|tick| if tick % 3 == 1 { 3 } else { 0 }).collect();
        let seen = voted(&mut Tracker::default(), 0, &classes, 1.0);
        assert!(seen.iter().all(|s| *s == (0, 0)), "{seen:?}");
        // Without votes they are two objects.
        let seen = voted(&mut Tracker::default(), 0, &classes, 0.0);
        assert!(seen[1].0 == 3 && seen[1].1 != seen[0].1, "{seen:?}");
    }

    #[test]
    fn a_class_that_stays_changed_wins_after_the_time_of_the_votes() {
        let mut tracker = Tracker::default();
        voted(&mut tracker, 0, &[0; 300], 1.0);
        // Old votes are worth as much as those of one time constant; they halve while new ones come in: a second until both are alike.
        let seen = voted(&mut tracker, 300, &[3; 60], 1.0);
        let change = seen.iter().position(|s| s.0 == 3).expect("it changes");
        assert!((27..=34).contains(&change), "after {change} ticks");
        assert!(seen[change..].iter().all(|s| *s == (3, 0)), "{seen:?}");
    }

    #[test]
    fn a_box_of_unknown_class_keeps_the_number_and_votes_for_no_class() {
        // 7 is unknown. With votes it gets the track's name; without, it stays unknown, and the object is the same.
        let seen = voted(&mut Tracker::default(), 0, &[3, 3, 7, 7, 7, 7, 3], 1.0);
        assert!(seen.iter().all(|s| *s == (3, 0)), "{seen:?}");
        let seen = voted(&mut Tracker::default(), 0, &[3, 7, 3], 0.0);
        assert_eq!(seen, [(3, 0), (7, 0), (3, 0)]);
        // Any number of unknown boxes weighs nothing against two votes.
        let seen = voted(&mut Tracker::default(), 0, &[7, 7, 7, 7, 7, 7, 7, 7, 2, 7, 2], 1.0);
        assert_eq!((seen[7], seen[8], seen[9], seen[10]), ((7, 0), (2, 0), (2, 0), (2, 0)), "{seen:?}");
        // An object first seen as unknown takes its first name without votes too.
        assert_eq!(voted(&mut Tracker::default(), 0, &[7, 2, 2], 0.0), [(7, 0), (2, 0), (2, 0)]);
    }

    #[test]
    fn a_fifth_class_takes_the_place_of_the_weakest() {
        let seen = voted(&mut Tracker::default(), 0, &[9, 9, 9, 1, 2, 3, 4, 9, 4, 4, 4, 4, 4], 100.0);
        assert!(seen[..8].iter().all(|s| s.0 == 9), "{seen:?}");
        assert_eq!(seen[12], (4, 0), "{seen:?}");
    }

    #[test]
    fn tools_of_two_classes_that_pass_each_other_keep_theirs() {
        let mut tracker = Tracker::default();
        for tick in 0..40i64 {
            let (left, right) = (at(tick as f32), Detection { class_index: 3, ..at(40.0 - tick as f32) });
            let mut items = [left, right];
            tracker.follow(&mut items, tick * 33_000_000, 1.0, None);
            let got = items.map(|i| (i.class_index, i.track_id));
            assert_eq!(got, [(0, 0), (3, 1)], "tick {tick}");
        }
    }
}
