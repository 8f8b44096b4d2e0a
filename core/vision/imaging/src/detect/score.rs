//! Average precision as computed by COCO's and by VOC's tools (Lin et al. 2014; Everingham et al. 2010).
//!
//! COCO: at most 100 finds per image and class, best first; each takes the free true object that it overlaps most;
//! precision is read at 101 recalls; thresholds 0.50 to 0.95. Steps and ties follow `pycocotools`, so that both give
//! the same numbers. VOC: at an overlap of
//! 0.5, a find belongs to the true object that it overlaps most, free or not; area under the whole curve.

use super::mask::Mask;

/// Overlap thresholds of COCO.
pub const THRESHOLDS: [f64; 10] = [0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95];
/// Maximum number of finds of a class in an image.
const MAX_FINDS: usize = 100;

/// A true object.
#[derive(Clone, Debug)]
pub struct Object {
    /// Class number.
    pub class: usize,
    /// Left, top, width, height in px.
    pub bbox: [f64; 4],
    /// Outline, if the ground truth has one.
    pub mask: Option<Mask>,
    /// Whether it is a crowd or marked as difficult: it counts neither as found nor as missed.
    pub ignored: bool,
}

/// A detection.
#[derive(Clone, Debug)]
pub struct Find {
    /// Class number.
    pub class: usize,
    /// Left, top, width, height in px.
    pub bbox: [f64; 4],
    /// Outline, if the network gives one.
    pub mask: Option<Mask>,
    /// 0..1.
    pub score: f64,
}

/// Shapes on which overlaps are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Boxes.
    Box,
    /// Masks.
    Mask,
}

/// Intersection over union; divided by the find's area alone if the true object is a crowd.
pub fn overlap(find: &Find, truth: &Object, shape: Shape) -> f64 {
    let (both, a, b) = match shape {
        Shape::Box => {
            let ([x, y, w, h], [u, v, s, t]) = (find.bbox, truth.bbox);
            let width = (x + w).min(u + s) - x.max(u);
            let height = (y + h).min(v + t) - y.max(v);
            if width <= 0.0 || height <= 0.0 {
                return 0.0;
            }
            (width * height, w * h, s * t)
        }
        Shape::Mask => {
            let (Some(found), Some(real)) = (&find.mask, &truth.mask) else { return 0.0 };
            (found.common(real) as f64, found.area as f64, real.area as f64)
        }
    };
    let union = if truth.ignored { a } else { a + b - both };
    if union > 0.0 { both / union } else { 0.0 }
}

/// One class.
#[derive(Clone, Debug, Default)]
pub struct ClassScore {
    /// True objects that count.
    pub truths: usize,
    /// Finds that count, at the threshold 0.5.
    pub finds: usize,
    /// COCO's AP at each threshold; NaN without ground truth.
    pub ap: [f64; 10],
    /// VOC's AP at 0.5; NaN without ground truth.
    pub voc: f64,
    /// Recall and precision after each find, best first, at 0.5.
    pub curve: Vec<(f64, f64)>,
    /// Maximum F1 over scores, and the score at which it is reached.
    pub best_f1: (f64, f64),
}

impl ClassScore {
    /// COCO's AP averaged over the thresholds.
    pub fn mean_ap(&self) -> f64 {
        self.ap.iter().sum::<f64>() / 10.0
    }
}

/// All classes.
#[derive(Clone, Debug)]
pub struct Scores {
    /// Class by class.
    pub classes: Vec<ClassScore>,
}

/// Mean of the values without NaN; NaN if there are none.
pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.filter(|v| !v.is_nan()).fold((0.0, 0usize), |(s, n), v| (s + v, n + 1));
    if count == 0 { f64::NAN } else { sum / count as f64 }
}

impl Scores {
    /// COCO's AP over 0.50 to 0.95, mean of the classes in the ground truth.
    pub fn ap(&self) -> f64 {
        mean(self.classes.iter().flat_map(|c| c.ap))
    }

    /// COCO's AP at one threshold (index into [`THRESHOLDS`]).
    pub fn ap_at(&self, threshold: usize) -> f64 {
        mean(self.classes.iter().map(|c| c.ap[threshold]))
    }

    /// VOC's AP at 0.5.
    pub fn voc(&self) -> f64 {
        mean(self.classes.iter().map(|c| c.voc))
    }
}

/// Finds of a class in an image, best first, with their matches at each threshold.
pub(super) struct MatchedDetections {
    pub scores: Vec<f64>,
    /// Per threshold and detection: matched, ignored.
    pub hits: [Vec<(bool, bool)>; 10],
    /// The same by VOC's rule.
    voc: Vec<(bool, bool)>,
    pub truths: usize,
}

pub(super) fn meet(finds: &[&Find], truths: &[&Object], shape: Shape) -> MatchedDetections {
    let mut order: Vec<usize> = (0..finds.len()).collect();
    order.sort_by(|&a, &b| finds[b].score.total_cmp(&finds[a].score));
    order.truncate(MAX_FINDS);
    // What counts first.
    let mut real: Vec<&Object> = truths.to_vec();
    real.sort_by_key(|t| t.ignored);
    let overlaps: Vec<Vec<f64>> =
        order.iter().map(|&f| real.iter().map(|t| overlap(finds[f], t, shape)).collect()).collect();
    let hits = THRESHOLDS.map(|threshold| {
        let mut taken = vec![false; real.len()];
        let one = |row: &Vec<f64>| {
            let (mut best, mut chosen) = (threshold.min(1.0 - 1e-10), None::<usize>);
            for (t, truth) in real.iter().enumerate() {
                if taken[t] && !truth.ignored {
                    continue;
                }
                if chosen.is_some_and(|c| !real[c].ignored && truth.ignored) {
                    break;
                }
                if row[t] >= best {
                    (best, chosen) = (row[t], Some(t));
                }
            }
            if let Some(t) = chosen {
                taken[t] = true;
            }
            (chosen.is_some(), chosen.is_some_and(|t| real[t].ignored))
        };
        overlaps.iter().map(one).collect()
    });
    let mut taken = vec![false; real.len()];
    let voc = overlaps
        .iter()
        .map(|row| {
            let best = row
                .iter()
                .enumerate()
                .fold(None::<(usize, f64)>, |b, (t, &o)| if o > b.map_or(0.0, |(_, o)| o) { Some((t, o)) } else { b });
            match best.filter(|(_, o)| *o >= 0.5) {
                Some((t, _)) if real[t].ignored => (false, true),
                Some((t, _)) if !taken[t] => {
                    taken[t] = true;
                    (true, false)
                }
                _ => (false, false),
            }
        })
        .collect();
    let truths = real.iter().filter(|t| !t.ignored).count();
    MatchedDetections { scores: order.iter().map(|&f| finds[f].score).collect(), hits, voc, truths }
}

/// Recall and precision after each find that counts, best first; with the finds' scores.
pub(super) fn curve(rows: &[(f64, bool)], truths: usize) -> Vec<(f64, f64)> {
    let mut hits = 0usize;
    rows.iter()
        .enumerate()
        .map(|(n, &(_, hit))| {
            hits += usize::from(hit);
            (hits as f64 / truths as f64, hits as f64 / ((n + 1) as f64 + f64::EPSILON))
        })
        .collect()
}

fn envelope(curve: &[(f64, f64)]) -> Vec<f64> {
    let mut out: Vec<f64> = curve.iter().map(|c| c.1).collect();
    for i in (1..out.len()).rev() {
        out[i - 1] = out[i - 1].max(out[i]);
    }
    out
}

/// Mean precision at 101 recalls.
pub(super) fn at_101_recalls(curve: &[(f64, f64)]) -> f64 {
    let high = envelope(curve);
    // As numpy's linspace(0, 1, 101) makes them.
    let step = 1.0 / 100.0;
    let recall = |i: usize| if i == 100 { 1.0 } else { i as f64 * step };
    let value = |i: usize| high.get(curve.partition_point(|c| c.0 < recall(i))).copied().unwrap_or(0.0);
    (0..101).map(value).sum::<f64>() / 101.0
}

fn area(curve: &[(f64, f64)]) -> f64 {
    let high = envelope(curve);
    let mut before = 0.0;
    let mut sum = 0.0;
    for (c, p) in curve.iter().zip(high) {
        sum += (c.0 - before) * p;
        before = c.0;
    }
    sum
}

/// Scores `finds` against `truths`, image by image.
pub fn score(truths: &[Vec<Object>], finds: &[Vec<Find>], classes: usize, shape: Shape) -> Scores {
    let one = |class: usize| {
        let met: Vec<MatchedDetections> = truths
            .iter()
            .zip(finds)
            .map(|(t, f)| {
                let of_class: Vec<&Find> = f.iter().filter(|f| f.class == class).collect();
                let real: Vec<&Object> = t.iter().filter(|t| t.class == class).collect();
                meet(&of_class, &real, shape)
            })
            .collect();
        let total: usize = met.iter().map(|m| m.truths).sum();
        let rows = |pick: &dyn Fn(&MatchedDetections) -> &Vec<(bool, bool)>| {
            let all = met.iter().flat_map(|m| m.scores.iter().copied().zip(pick(m).iter().copied()));
            let mut rows: Vec<(f64, bool)> =
                all.filter(|(_, (_, left_out))| !left_out).map(|(s, (hit, _))| (s, hit)).collect();
            rows.sort_by(|a, b| b.0.total_cmp(&a.0));
            rows
        };
        let at_half = rows(&|m: &MatchedDetections| &m.hits[0]);
        if total == 0 {
            return ClassScore { finds: at_half.len(), ap: [f64::NAN; 10], voc: f64::NAN, ..ClassScore::default() };
        }
        let ap = std::array::from_fn(|t| at_101_recalls(&curve(&rows(&|m: &MatchedDetections| &m.hits[t]), total)));
        let voc = area(&curve(&rows(&|m: &MatchedDetections| &m.voc), total));
        let points = curve(&at_half, total);
        let best_f1 = points.iter().zip(&at_half).fold((0.0, 0.0), |best, (&(r, p), &(s, _))| {
            let f1 = if r + p > 0.0 { 2.0 * r * p / (r + p) } else { 0.0 };
            if f1 > best.0 { (f1, s) } else { best }
        });
        ClassScore { truths: total, finds: at_half.len(), ap, voc, curve: points, best_f1 }
    };
    Scores { classes: (0..classes).map(one).collect() }
}

/// Finds of all images in the order of their scores, to be scored repeatedly on subsets of the images.
pub struct Ranking {
    /// Per class: score, hit (COCO's rule at 0.5), image.
    rows: Vec<Vec<(f64, bool, usize)>>,
    /// Per class and image: true objects that count.
    truths: Vec<Vec<usize>>,
}

impl Ranking {
    /// Ranks `finds`, image by image, by their boxes.
    pub fn new(truths: &[Vec<Object>], finds: &[Vec<Find>], classes: usize) -> Self {
        let mut ranking = Self { rows: vec![Vec::new(); classes], truths: vec![Vec::new(); classes] };
        for class in 0..classes {
            let rows = &mut ranking.rows[class];
            for (picture, (t, f)) in truths.iter().zip(finds).enumerate() {
                let of_class: Vec<&Find> = f.iter().filter(|f| f.class == class).collect();
                let real: Vec<&Object> = t.iter().filter(|t| t.class == class).collect();
                let met = meet(&of_class, &real, Shape::Box);
                let counted = met.scores.iter().zip(&met.hits[0]).filter(|(_, (_, ignored))| !ignored);
                rows.extend(counted.map(|(score, (hit, _))| (*score, *hit, picture)));
                ranking.truths[class].push(met.truths);
            }
            rows.sort_by(|a, b| b.0.total_cmp(&a.0));
        }
        ranking
    }

    /// COCO's AP at 0.5 of each class when each image counts `times` times; NaN without ground truth.
    pub fn ap50(&self, times: &[u32]) -> Vec<f64> {
        let one = |(rows, truths): (&Vec<(f64, bool, usize)>, &Vec<usize>)| {
            let total: usize = truths.iter().zip(times).map(|(t, n)| t * *n as usize).sum();
            if total == 0 {
                return f64::NAN;
            }
            let (mut hits, mut seen) = (0usize, 0usize);
            let mut points = Vec::with_capacity(rows.len());
            for &(_, hit, picture) in rows {
                let n = times[picture] as usize;
                if n > 0 {
                    seen += n;
                    hits += if hit { n } else { 0 };
                    points.push((hits as f64 / total as f64, hits as f64 / (seen as f64 + f64::EPSILON)));
                }
            }
            at_101_recalls(&points)
        };
        self.rows.iter().zip(&self.truths).map(one).collect()
    }
}

/// Matches of an image's true objects and finds regardless of class, at an overlap of 0.5: for each pair both numbers.
/// Crowds, finds on them and finds under `min_score` are ignored.
pub fn pairs(truths: &[Object], finds: &[Find], min_score: f64, shape: Shape) -> Vec<(Option<usize>, Option<usize>)> {
    let mut all: Vec<(f64, usize, usize)> = Vec::new();
    for (f, find) in finds.iter().enumerate().filter(|(_, f)| f.score >= min_score) {
        for (t, truth) in truths.iter().enumerate().filter(|(_, t)| !t.ignored) {
            let o = overlap(find, truth, shape);
            if o >= 0.5 {
                all.push((o, t, f));
            }
        }
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut taken, mut used, mut out) = (vec![false; truths.len()], vec![false; finds.len()], Vec::new());
    for (_, t, f) in all {
        if !taken[t] && !used[f] {
            (taken[t], used[f]) = (true, true);
            out.push((Some(t), Some(f)));
        }
    }
    out.extend((0..truths.len()).filter(|&t| !taken[t] && !truths[t].ignored).map(|t| (Some(t), None)));
    // A second box on a crowd is no mistake.
    let on_crowd = |f: usize| truths.iter().any(|t| t.ignored && overlap(&finds[f], t, shape) >= 0.5);
    out.extend(
        (0..finds.len()).filter(|&f| !used[f] && finds[f].score >= min_score && !on_crowd(f)).map(|f| (None, Some(f))),
    );
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(bbox: [f64; 4]) -> Object {
        Object { class: 0, bbox, mask: None, ignored: false }
    }

    fn find(bbox: [f64; 4], score: f64) -> Find {
        Find { class: 0, bbox, mask: None, score }
    }

    #[test]
    fn a_perfect_answer_scores_one() {
        let truths = vec![vec![object([0.0, 0.0, 10.0, 10.0]), object([20.0, 20.0, 10.0, 10.0])]];
        let finds = vec![vec![find([0.0, 0.0, 10.0, 10.0], 0.9), find([20.0, 20.0, 10.0, 10.0], 0.8)]];
        let scores = score(&truths, &finds, 1, Shape::Box);
        assert!((scores.ap() - 1.0).abs() < 1e-9 && (scores.voc() - 1.0).abs() < 1e-9, "{scores:?}");
    }

    #[test]
    fn a_wrong_find_before_a_right_one_halves_the_precision() {
        let truths = vec![vec![object([0.0, 0.0, 10.0, 10.0])], vec![]];
        let finds = vec![vec![find([0.0, 0.0, 10.0, 10.0], 0.5)], vec![find([0.0, 0.0, 10.0, 10.0], 0.9)]];
        let scores = score(&truths, &finds, 2, Shape::Box);
        assert!((scores.ap_at(0) - 0.5).abs() < 1e-9 && (scores.voc() - 0.5).abs() < 1e-9);
        assert!(scores.classes[1].voc.is_nan(), "a class without truth does not count");
    }

    #[test]
    fn half_found_reads_51_of_101_recalls() {
        let truths = vec![vec![object([0.0, 0.0, 10.0, 10.0]), object([20.0, 20.0, 10.0, 10.0])]];
        let finds = vec![vec![find([0.0, 0.0, 10.0, 10.0], 0.9), find([50.0, 0.0, 4.0, 4.0], 0.8)]];
        let scores = score(&truths, &finds, 1, Shape::Box);
        assert!((scores.ap_at(0) - 51.0 / 101.0).abs() < 1e-9);
        assert!((scores.voc() - 0.5).abs() < 1e-9);
    }

    #[test]
    fn loose_boxes_count_at_loose_thresholds_only() {
        // 10 x 10 against 10 x 7.2: overlap 0.72, five thresholds of ten.
        let truths = vec![vec![object([0.0, 0.0, 10.0, 10.0])]];
        let finds = vec![vec![find([0.0, 0.0, 10.0, 7.2], 0.9)]];
        assert!((score(&truths, &finds, 1, Shape::Box).ap() - 0.5).abs() < 1e-9);
    }

    #[test]
    fn crowds_neither_help_nor_harm() {
        let crowd = Object { ignored: true, ..object([40.0, 40.0, 50.0, 50.0]) };
        let truths = vec![vec![object([0.0, 0.0, 10.0, 10.0]), crowd]];
        let finds = vec![vec![
            find([0.0, 0.0, 10.0, 10.0], 0.5),
            find([45.0, 45.0, 10.0, 10.0], 0.9),
            find([60.0, 60.0, 10.0, 10.0], 0.8),
        ]];
        let scores = score(&truths, &finds, 1, Shape::Box);
        assert!((scores.ap() - 1.0).abs() < 1e-9, "{scores:?}");
        assert_eq!(pairs(&truths[0], &finds[0], 0.1, Shape::Box), [(Some(0), Some(0))]);
    }

    #[test]
    fn the_point_figure_and_its_resamples_count_alike() {
        let object = |class, left| Object { class, bbox: [left, 0.0, 10.0, 10.0], mask: None, ignored: left > 80.0 };
        let found = |class, left, score| Find { class, bbox: [left, 0.0, 10.0, 10.0], mask: None, score };
        let truths =
            vec![vec![object(0, 0.0), object(1, 20.0)], vec![object(0, 40.0), object(0, 90.0)], vec![object(1, 5.0)]];
        let finds = vec![
            vec![found(0, 1.0, 0.9), found(0, 50.0, 0.95), found(1, 21.0, 0.2)],
            vec![found(0, 90.0, 0.99), found(0, 41.0, 0.3), found(1, 0.0, 0.7)],
            vec![found(0, 5.0, 0.5)],
        ];
        let point = score(&truths, &finds, 2, Shape::Box);
        let ranking = Ranking::new(&truths, &finds, 2);
        assert_eq!(ranking.ap50(&[1, 1, 1]), [point.classes[0].ap[0], point.classes[1].ap[0]]);
        // A picture that counts twice is the same as two such pictures.
        let twice = |list: &[Vec<Object>]| [list, &list[..1]].concat();
        let twice_found = [&finds[..], &finds[..1]].concat();
        let point = score(&twice(&truths), &twice_found, 2, Shape::Box);
        assert_eq!(ranking.ap50(&[2, 1, 1]), [point.classes[0].ap[0], point.classes[1].ap[0]]);
        assert!(ranking.ap50(&[0, 1, 0])[1].is_nan(), "no truth of that class is drawn");
    }

    #[test]
    fn masks_are_compared_by_their_pixels() {
        let mut left = Mask::new(10, 10);
        left.add_polygon(&[[0.0, 0.0], [5.0, 0.0], [5.0, 10.0], [0.0, 10.0]]);
        let truth = Object { mask: Some(left.clone()), ..object([0.0, 0.0, 5.0, 10.0]) };
        let mut right = Mask::new(10, 10);
        right.add_polygon(&[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]);
        let found = Find { mask: Some(right), ..find([0.0, 0.0, 5.0, 10.0], 0.9) };
        assert!((overlap(&found, &truth, Shape::Mask) - 0.5).abs() < 1e-12);
        assert!((overlap(&found, &truth, Shape::Box) - 1.0).abs() < 1e-12);
    }
}
