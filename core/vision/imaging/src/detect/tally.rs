//! Incremental precision, recall and average precision, image by image.

use super::score::{Find, Object, Shape, at_101_recalls, curve, mean, meet};

/// Detections of one class so far.
#[derive(Clone, Debug, Default)]
struct ClassTally {
    /// Score of each counted detection, and whether it matches an object, by COCO's rule at an overlap of 0.5; best
    /// first.
    rows: Vec<(f64, bool)>,
    /// Objects that count.
    truths: usize,
}

/// Counts of one class, or of all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Objects that count.
    pub truths: usize,
    /// Detections of at least the smallest score.
    pub finds: usize,
    /// Detections that match an object.
    pub hits: usize,
    /// COCO's average precision at an overlap of 0.5, over all scores; NaN without an object.
    pub ap50: f64,
}

impl Rates {
    /// Share of the detections that match an object; NaN without a detection.
    pub fn precision(&self) -> f64 {
        self.hits as f64 / self.finds as f64
    }

    /// Share of the objects that are detected; NaN without an object.
    pub fn recall(&self) -> f64 {
        self.hits as f64 / self.truths as f64
    }
}

/// Detections and objects of the images so far.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    classes: Vec<ClassTally>,
}

impl Tally {
    /// Adds an image. Per class and image the 100 best detections are used, as in COCO.
    pub fn add(&mut self, truths: &[Object], finds: &[Find]) {
        let numbers = truths.iter().map(|t| t.class).chain(finds.iter().map(|f| f.class));
        let classes = numbers.max().map_or(0, |most| most + 1);
        if self.classes.len() < classes {
            self.classes.resize_with(classes, ClassTally::default);
        }
        for (class, tally) in self.classes.iter_mut().enumerate() {
            let of_class: Vec<&Find> = finds.iter().filter(|f| f.class == class).collect();
            let real: Vec<&Object> = truths.iter().filter(|t| t.class == class).collect();
            if of_class.is_empty() && real.is_empty() {
                continue;
            }
            let met = meet(&of_class, &real, Shape::Box);
            tally.truths += met.truths;
            for (score, (hit, _)) in met.scores.iter().zip(&met.hits[0]).filter(|(_, (_, is_ignored))| !is_ignored) {
                let at = tally.rows.partition_point(|(other, _)| other.total_cmp(score).is_ge());
                tally.rows.insert(at, (*score, *hit));
            }
        }
    }

    /// Number of classes so far.
    pub fn classes(&self) -> usize {
        self.classes.len()
    }

    /// Counts of a class; zeros for an unknown class.
    pub fn class(&self, class: usize, min_score: f64) -> Rates {
        let none = ClassTally::default();
        let tally = self.classes.get(class).unwrap_or(&none);
        let kept = &tally.rows[..tally.rows.partition_point(|(score, _)| *score >= min_score)];
        let ap50 = if tally.truths == 0 { f64::NAN } else { at_101_recalls(&curve(&tally.rows, tally.truths)) };
        Rates { truths: tally.truths, finds: kept.len(), hits: kept.iter().filter(|row| row.1).count(), ap50 }
    }

    /// Counts of all classes together; the average precision is the mean of the classes that have objects.
    pub fn all(&self, min_score: f64) -> Rates {
        let rates: Vec<Rates> = (0..self.classes.len()).map(|class| self.class(class, min_score)).collect();
        Rates {
            truths: rates.iter().map(|r| r.truths).sum(),
            finds: rates.iter().map(|r| r.finds).sum(),
            hits: rates.iter().map(|r| r.hits).sum(),
            ap50: mean(rates.iter().map(|r| r.ap50)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Ranking, score};
    use super::*;

    fn object(class: usize, left: f64) -> Object {
        Object { class, bbox: [left, 0.0, 10.0, 10.0], mask: None, ignored: left > 80.0 }
    }

    fn found(class: usize, left: f64, score: f64) -> Find {
        Find { class, bbox: [left, 0.0, 10.0, 10.0], mask: None, score }
    }

    #[test]
    fn counts_so_far_are_those_of_all_pictures_at_once() {
        let truths =
            vec![vec![object(0, 0.0), object(1, 20.0)], vec![object(0, 40.0), object(0, 90.0)], vec![object(1, 5.0)]];
        let finds = vec![
            vec![found(0, 1.0, 0.9), found(0, 50.0, 0.95), found(1, 21.0, 0.2)],
            vec![found(0, 90.0, 0.99), found(0, 41.0, 0.3), found(1, 0.0, 0.7)],
            vec![found(0, 5.0, 0.5)],
        ];
        let mut tally = Tally::default();
        truths.iter().zip(&finds).for_each(|(t, f)| tally.add(t, f));
        let ap50 = Ranking::new(&truths, &finds, 2).ap50(&[1, 1, 1]);
        assert_eq!([tally.class(0, 0.0).ap50, tally.class(1, 0.0).ap50], [ap50[0], ap50[1]]);
        assert_eq!(tally.all(0.0).ap50, score(&truths, &finds, 2, Shape::Box).ap_at(0));
        // Of class 0 the detection on the ignored object does not count; 0.3 is below the smallest score.
        let rates = tally.class(0, 0.4);
        assert_eq!((rates.truths, rates.finds, rates.hits), (2, 3, 1));
        assert_eq!((rates.precision(), rates.recall()), (1.0 / 3.0, 0.5));
        let all = tally.all(0.0);
        assert_eq!((all.truths, all.finds, all.hits), (4, 6, 3));
    }

    #[test]
    fn nothing_is_unknown_and_not_zero() {
        let mut tally = Tally::default();
        assert!(tally.all(0.5).ap50.is_nan() && tally.all(0.5).precision().is_nan());
        tally.add(&[], &[found(3, 0.0, 0.9)]);
        let rates = tally.class(3, 0.5);
        assert_eq!((tally.classes(), rates.finds, rates.precision()), (4, 1, 0.0));
        assert!(rates.recall().is_nan() && rates.ap50.is_nan());
    }
}
