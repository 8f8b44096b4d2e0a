//! Placement of labels next to boxes and points without overlaps.

/// An upright rectangle in pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Area {
    /// Left edge, px.
    pub x: f32,
    /// Upper edge, px.
    pub y: f32,
    /// Width, px.
    pub width: f32,
    /// Height, px.
    pub height: f32,
}

impl Area {
    /// Whether two areas share more than an edge.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.x < other.x + other.width
            && other.x < self.x + self.width
            && self.y < other.y + other.height
            && other.y < self.y + self.height
    }

    fn is_finite(&self) -> bool {
        [self.x, self.y, self.width, self.height].iter().all(|v| v.is_finite())
    }
}

/// Step of the search for free room when no usual position of a label is free, pixels.
const STEP_PX: f32 = 4.0;

/// Occupied areas of an image. Reuses its memory between images.
#[derive(Clone, Debug, Default)]
pub struct Labels {
    width: f32,
    height: f32,
    taken: Vec<Area>,
}

impl Labels {
    /// Begins an image of `width` x `height` pixels with all of its area free.
    pub fn begin(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width as f32, height as f32);
        self.taken.clear();
    }

    /// Keeps labels away from an area. Ignores one that is not finite.
    pub fn take(&mut self, area: Area) {
        if area.is_finite() {
            self.taken.push(area);
        }
    }

    /// All occupied areas, labels included, in order.
    pub fn taken(&self) -> &[Area] {
        &self.taken
    }

    /// Reserves an area for a label of `size` (width, height in pixels) about `anchor` and returns its upper left
    /// corner.
    ///
    /// The label overlaps no occupied area and is inside the image: above the anchor, else inside at its top, below it,
    /// next to it, else at the nearest free position. `None` if there is no free area, or a coordinate is not finite.
    pub fn place(&mut self, anchor: Area, size: (f32, f32)) -> Option<(f32, f32)> {
        let (w, h) = size;
        let fits = w > 0.0 && h > 0.0 && w <= self.width && h <= self.height;
        if !fits || !anchor.is_finite() {
            return None;
        }
        let (left, right) = (anchor.x, anchor.x + anchor.width - w);
        let (above, below) = (anchor.y - h, anchor.y + anchor.height);
        let usual = [
            (left, above),
            (left, anchor.y),
            (left, below),
            (right, above),
            (right, below),
            (anchor.x + anchor.width, anchor.y),
            (anchor.x - w, anchor.y),
            (anchor.x + anchor.width, below),
            (anchor.x - w, below),
            (anchor.x + anchor.width, above),
            (anchor.x - w, above),
            (left, below - h),
        ];
        // A label that would leave the picture sideways is moved in; one that would leave it above or below has its other positions.
        let inside = |(x, y): (f32, f32)| {
            let x = x.clamp(0.0, self.width - w);
            (y >= 0.0 && y + h <= self.height).then_some((x, y))
        };
        let found = usual.into_iter().filter_map(inside).find(|at| self.is_free(*at, size));
        let at = found.or_else(|| self.nearest(anchor, size))?;
        self.taken.push(Area { x: at.0, y: at.1, width: w, height: h });
        Some(at)
    }

    /// Reserves an area for a label of `size` with its upper left corner at `at`, if it is free and inside the image.
    pub fn place_at(&mut self, at: (f32, f32), size: (f32, f32)) -> Option<(f32, f32)> {
        let inside = at.0 >= 0.0 && at.1 >= 0.0 && at.0 + size.0 <= self.width && at.1 + size.1 <= self.height;
        if !inside || !self.is_free(at, size) {
            return None;
        }
        self.taken.push(Area { x: at.0, y: at.1, width: size.0, height: size.1 });
        Some(at)
    }

    fn is_free(&self, (x, y): (f32, f32), (width, height): (f32, f32)) -> bool {
        let area = Area { x, y, width, height };
        !self.taken.iter().any(|t| t.overlaps(&area))
    }

    /// The free position on a grid whose centre is nearest to the anchor's.
    fn nearest(&self, anchor: Area, size: (f32, f32)) -> Option<(f32, f32)> {
        let middle = (anchor.x + (anchor.width - size.0) / 2.0, anchor.y + (anchor.height - size.1) / 2.0);
        let (columns, rows) = ((self.width - size.0) / STEP_PX, (self.height - size.1) / STEP_PX);
        let mut best: Option<(f32, (f32, f32))> = None;
        for row in 0..=rows as usize {
            for column in 0..=columns as usize {
                let at = (column as f32 * STEP_PX, row as f32 * STEP_PX);
                let far = (at.0 - middle.0).powi(2) + (at.1 - middle.1).powi(2);
                if best.is_none_or(|(least, _)| far < least) && self.is_free(at, size) {
                    best = Some((far, at));
                }
            }
        }
        best.map(|(_, at)| at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (f32, f32) = (90.0, 16.0);

    fn area(x: f32, y: f32, width: f32, height: f32) -> Area {
        Area { x, y, width, height }
    }

    fn labels(width: usize, height: usize) -> Labels {
        let mut labels = Labels::default();
        labels.begin(width, height);
        labels
    }

    /// Nothing that is taken overlaps, and from `first` on all lies in the image.
    fn all_apart(labels: &Labels, first: usize) {
        let taken = labels.taken();
        for (k, a) in taken.iter().enumerate() {
            assert!(taken[..k].iter().all(|b| !a.overlaps(b)), "{a:?} overlaps one of {:?}", &taken[..k]);
        }
        for a in &taken[first..] {
            let inside = a.x >= 0.0 && a.y >= 0.0 && a.x + a.width <= labels.width && a.y + a.height <= labels.height;
            assert!(inside, "{a:?} leaves the picture");
        }
    }

    #[test]
    fn a_lone_box_has_its_label_above_and_one_at_the_upper_edge_inside() {
        assert_eq!(labels(320, 240).place(area(100.0, 100.0, 60.0, 40.0), SIZE), Some((100.0, 84.0)));
        assert_eq!(labels(320, 240).place(area(100.0, 1.0, 60.0, 40.0), SIZE), Some((100.0, 1.0)));
        // At the right edge it is moved in.
        assert_eq!(labels(320, 240).place(area(290.0, 100.0, 60.0, 40.0), SIZE), Some((230.0, 84.0)));
    }

    #[test]
    fn labels_of_boxes_that_lie_on_each_other_stay_apart() {
        let mut labels = labels(640, 480);
        for k in 0..8 {
            let at = 200.0 + 2.0 * k as f32;
            assert!(labels.place(area(at, at, 80.0, 60.0), SIZE).is_some());
        }
        all_apart(&labels, 0);
    }

    #[test]
    fn a_label_stays_off_the_tip_and_near_its_box() {
        let mut labels = labels(640, 480);
        // The tip's mark stands just where the label would.
        labels.take(area(300.0, 180.0, 36.0, 36.0));
        let (x, y) = labels.place(area(290.0, 200.0, 80.0, 60.0), SIZE).unwrap();
        all_apart(&labels, 0);
        assert!((x - 290.0).abs() < 100.0 && (y - 200.0).abs() < 100.0, "{x} {y}");
    }

    #[test]
    fn in_every_corner_labels_stay_in_the_picture() {
        let mut labels = labels(320, 240);
        for (x, y) in [(-30.0, -20.0), (300.0, -20.0), (-30.0, 220.0), (300.0, 220.0), (-500.0, 100.0), (0.0, 900.0)] {
            assert!(labels.place(area(x, y, 60.0, 40.0), SIZE).is_some());
        }
        all_apart(&labels, 0);
    }

    #[test]
    fn where_no_usual_place_is_free_the_nearest_is_taken() {
        let mut labels = labels(320, 240);
        labels.take(area(0.0, 0.0, 320.0, 200.0));
        let (_, y) = labels.place(area(100.0, 20.0, 60.0, 40.0), SIZE).unwrap();
        assert!((200.0..=204.0).contains(&y), "{y}");
        all_apart(&labels, 1);
    }

    #[test]
    fn without_room_there_is_no_label() {
        let mut labels = labels(100, 40);
        assert!(labels.place(area(0.0, 0.0, 10.0, 10.0), (90.0, 16.0)).is_some());
        assert!(labels.place(area(0.0, 0.0, 10.0, 10.0), (90.0, 16.0)).is_some());
        assert!(labels.place(area(0.0, 0.0, 10.0, 10.0), (90.0, 16.0)).is_none(), "full");
        assert!(labels.place(area(0.0, 0.0, 10.0, 10.0), (101.0, 4.0)).is_none(), "wider than the picture");
        assert!(labels.place(area(f32::NAN, 0.0, 10.0, 10.0), (10.0, 4.0)).is_none());
        labels.take(area(f32::NAN, 0.0, 1.0, 1.0));
        assert_eq!(labels.taken().len(), 2);
    }
}
