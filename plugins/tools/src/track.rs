//! Numbers that stay with an object over time: greedy matching by overlap with a constant-velocity guess (after Bewley et al. 2016, SORT).

use panoscope_node::abi::Detection;

use crate::candidates::iou;

struct Track {
    id: i64,
    class_index: u32,
    corners: [f32; 4],
    velocity: [f32; 4],
    missed: u32,
}

/// Gives detections their `track_id`.
#[derive(Default)]
pub struct Tracker {
    tracks: Vec<Track>,
    pairs: Vec<(f32, usize, usize)>,
    next_id: i64,
}

/// Overlap under which a box is another object.
const MIN_IOU: f32 = 0.2;
/// Ticks for which an unseen object is remembered.
const MEMORY_TICKS: u32 = 15;

fn corners_of(d: &Detection) -> [f32; 4] {
    [d.x_px, d.y_px, d.x_px + d.width_px, d.y_px + d.height_px]
}

impl Tracker {
    /// Names the objects of one tick.
    pub fn follow(&mut self, items: &mut [Detection]) {
        self.pairs.clear();
        for (t, track) in self.tracks.iter_mut().enumerate() {
            (0..4).for_each(|k| track.corners[k] += track.velocity[k]);
            for (d, item) in items.iter().enumerate() {
                let overlap = iou(&track.corners, &corners_of(item));
                if item.class_index == track.class_index && overlap >= MIN_IOU {
                    self.pairs.push((overlap, t, d));
                }
            }
        }
        self.pairs.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        items.iter_mut().for_each(|i| i.track_id = -1);
        self.tracks.iter_mut().for_each(|t| t.missed += 1);
        for &(_, t, d) in &self.pairs {
            let (track, item) = (&mut self.tracks[t], &mut items[d]);
            if track.missed > 0 && item.track_id < 0 {
                let seen = corners_of(item);
                // Half of the surprise becomes velocity.
                (0..4).for_each(|k| track.velocity[k] += 0.5 * (seen[k] - track.corners[k]) / track.missed as f32);
                (track.corners, track.missed, item.track_id) = (seen, 0, track.id);
            }
        }
        self.tracks.retain(|t| t.missed <= MEMORY_TICKS);
        self.tracks.iter_mut().filter(|t| t.missed > 0).for_each(|t| t.velocity.iter_mut().for_each(|v| *v *= 0.7));
        for item in items.iter_mut().filter(|i| i.track_id < 0) {
            item.track_id = self.next_id;
            let (class_index, corners) = (item.class_index, corners_of(item));
            self.tracks.push(Track { id: self.next_id, class_index, corners, velocity: [0.0; 4], missed: 0 });
            self.next_id += 1;
        }
    }
}
