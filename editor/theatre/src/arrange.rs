//! Computes the rectangles of the images from the layout and the available space.

use eframe::egui::{Rect, Vec2, pos2, vec2};
use panoscope_imaging::composition::{Composition, Frame};

/// Distance between images, points.
pub const GAP: f32 = 12.0;
/// Height of the title above each image, points.
pub const TITLE: f32 = 30.0;

/// Which views are shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// The first view large, the others next to it and below it.
    #[default]
    All,
    /// One view alone.
    One(usize),
}

impl Layout {
    /// The next layout of `count` views: all, then each alone, then all again.
    pub fn next(self, count: usize) -> Self {
        match self {
            Self::All if count > 0 => Self::One(0),
            Self::One(n) if n + 1 < count => Self::One(n + 1),
            _ => Self::All,
        }
    }

    /// The previous layout of `count` views.
    pub fn previous(self, count: usize) -> Self {
        match self {
            Self::All if count > 0 => Self::One(count - 1),
            Self::One(n) if n > 0 => Self::One(n - 1),
            _ => Self::All,
        }
    }

    /// Index of the view that stills and clips are made of.
    pub fn main(self) -> usize {
        match self {
            Self::All => 0,
            Self::One(n) => n,
        }
    }

    /// Index and rectangle of each visible view inside `room`; `shapes` has the size of each view's image, if it has one.
    pub fn rects(self, composition: &mut Composition, shapes: &[Option<Vec2>], room: Rect) -> Vec<(usize, Rect)> {
        let count = shapes.len();
        match (self, count) {
            (_, 0) => Vec::new(),
            (Self::One(n), _) => vec![(n.min(count - 1), room)],
            (Self::All, 1) => vec![(0, room)],
            (Self::All, _) => {
                let points = |length: f32| length.max(0.0) as usize;
                // A composition has a margin around everything, the room has none.
                let [width, height] = [room.width(), room.height()].map(|length| points(length + 2.0 * GAP));
                let frame = Frame { width, height, gap: points(GAP), side_share: 0.0 };
                let images = shapes.iter().map(|shape| (shape.map(|s| (points(s.x), points(s.y))), points(TITLE)));
                composition.update(frame, images);
                let rect = |x: usize, y: usize, width: usize, height: usize| {
                    let min = room.min + vec2(x as f32 - GAP, y as f32 - GAP);
                    Rect::from_min_size(min, vec2(width as f32, height as f32))
                };
                let cells = composition.cells().iter();
                let mut rects: Vec<_> = cells.map(|cell| rect(cell.x, cell.y, cell.width, cell.height)).collect();
                if let [a, b] = &mut rects[..]
                    && let [Some(one), Some(other)] = shapes
                    && a.right() <= b.left()
                {
                    [*a, *b] = level([*a, *b], [*one, *other]);
                }
                rects.into_iter().enumerate().collect()
            }
        }
    }
}

/// Adjusts the rectangles of two views with images of these sizes so that the tops of both images are at the higher one's height.
fn level(rooms: [Rect; 2], sizes: [Vec2; 2]) -> [Rect; 2] {
    let below_title = |room: Rect| Rect::from_min_max(room.min + vec2(0.0, TITLE), room.max);
    let pictures = [0, 1].map(|k| fit(below_title(rooms[k]), sizes[k]));
    let top = pictures[0].top().min(pictures[1].top());
    [0, 1].map(|k| {
        let bottom = top + pictures[k].height();
        Rect::from_min_max(pos2(rooms[k].left(), top - TITLE), pos2(rooms[k].right(), bottom))
    })
}

/// Widths of an inset as fractions of the room's; the first one that covers nothing is used.
const INSET_SHARES: [f32; 5] = [0.24, 0.21, 0.18, 0.15, 0.125];
/// Fraction of an image's width and height, around its centre, that an inset must not cover.
const MIDDLE: f32 = 0.5;

/// The part of an image that an inset must not cover.
pub fn middle(picture: Rect) -> Rect {
    Rect::from_center_size(picture.center(), picture.size() * MIDDLE)
}

/// The rectangle of a small image with the proportions of `size` and its title, in a corner of `room`, in which `pictures` with their titles are
/// drawn.
///
/// It is in free space if there is any; else over the corner of an image, so small that it covers no image's [`middle`] and no title.
pub fn inset(room: Rect, size: Vec2, pictures: &[Rect]) -> Rect {
    let high = |width: f32| TITLE + width * size.y.max(1.0) / size.x.max(1.0);
    let corners = |bounds: Rect, width: f32| {
        let size = vec2(width, high(width));
        // The lower right first, because tools and menus are most often at the lower left.
        [(true, true), (true, false), (false, true), (false, false)].map(|(right, bottom)| {
            let x = if right { bounds.right() - size.x } else { bounds.left() };
            let y = if bottom { bounds.bottom() - size.y } else { bounds.top() };
            Rect::from_min_size(pos2(x, y), size)
        })
    };
    let apart = |a: Rect, b: Rect| !a.shrink(0.5).intersects(b.shrink(0.5));
    for share in INSET_SHARES {
        let free = |rect: &Rect| room.expand(0.5).contains_rect(*rect) && pictures.iter().all(|p| apart(*rect, *p));
        if let Some(rect) = corners(room, room.width() * share).into_iter().find(free) {
            return rect;
        }
    }
    // The corner of the room or of the largest image where it covers least, as large as the middles of the images allow.
    let area = |r: &Rect| r.width() * r.height();
    let largest = pictures.iter().copied().max_by(|a, b| area(a).total_cmp(&area(b))).unwrap_or(room);
    let most = (largest.width() * (1.0 - MIDDLE) / 2.0).min(room.width() * INSET_SHARES[0]);
    let title = |picture: &Rect| picture.with_max_y(picture.top() + TITLE);
    let allowed = |rect: &Rect| pictures.iter().all(|p| apart(*rect, middle(*p)) && apart(*rect, title(p)));
    // In whole points, so that rounding does not decide between equal corners.
    let covered = |rect: &Rect| {
        let shared = pictures.iter().map(|p| rect.intersect(*p)).filter(Rect::is_positive);
        shared.map(|r| area(&r)).sum::<f32>().round()
    };
    let mut width = most;
    loop {
        let rects = corners(room, width).into_iter().chain(corners(largest, width)).filter(allowed);
        if let Some(rect) = rects.min_by(|a, b| covered(a).total_cmp(&covered(b))) {
            return rect;
        }
        width *= 0.9;
        if width < 1.0 {
            return corners(largest, width)[0];
        }
    }
}

/// The largest rectangle with the proportions of `size`, centred in `room`.
pub fn fit(room: Rect, size: Vec2) -> Rect {
    let scale = (room.width() / size.x.max(1.0)).min(room.height() / size.y.max(1.0)).max(0.0);
    Rect::from_center_size(room.center(), size * scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_key_leads_round() {
        let (mut layout, mut seen) = (Layout::All, vec![Layout::All]);
        for _ in 0..3 {
            layout = layout.next(3);
            seen.push(layout);
            assert_eq!(layout.previous(3), seen[seen.len() - 2]);
        }
        assert_eq!(layout, Layout::One(2));
        assert_eq!(layout.next(3), Layout::All);
        assert_eq!(Layout::All.next(0), Layout::All);
    }

    fn rects(shapes: &[Vec2], room: Rect) -> Vec<Rect> {
        let shapes: Vec<_> = shapes.iter().copied().map(Some).collect();
        let rects = Layout::All.rects(&mut Composition::default(), &shapes, room);
        assert!(rects.iter().enumerate().all(|(k, (n, _))| k == *n));
        rects.into_iter().map(|(_, rect)| rect).collect()
    }

    #[test]
    fn images_are_inside_and_apart() {
        let room = Rect::from_min_size(pos2(16.0, 80.0), vec2(1400.0, 700.0));
        for count in 1..6 {
            let rects = rects(&vec![vec2(640.0, 480.0); count], room);
            assert_eq!(rects.len(), count);
            for (k, a) in rects.iter().enumerate() {
                assert!(room.expand(0.5).contains_rect(*a), "{a:?}");
                assert!(rects[..k].iter().all(|b| !a.shrink(0.5).intersects(b.shrink(0.5))));
            }
        }
        assert_eq!(fit(room, vec2(100.0, 100.0)).size(), vec2(700.0, 700.0));
    }

    #[test]
    fn the_first_image_takes_most_of_the_room() {
        let view = vec2(640.0, 480.0);
        for (width, height) in [(1248.0, 560.0), (1880.0, 900.0), (1248.0, 840.0)] {
            let room = Rect::from_min_size(pos2(16.0, 80.0), vec2(width, height));
            for wider in [1.0, 1.1, 1.3] {
                let main = vec2(view.x * wider, view.y);
                let rects = rects(&[main, view, view], room);
                let share = |r: &Rect| r.width() * r.height() / (width * height);
                let largest = fit(Rect::from_min_max(room.min + vec2(0.0, TITLE), room.max), main);
                let (first, all) = (share(&rects[0]), rects.iter().map(share).sum::<f32>());
                let what = format!("{width} x {height}, {wider}: {first:.3} of {:.3}, all {all:.3}", share(&largest));
                assert!(first >= share(&largest).min(0.6) && all >= 0.72, "{what} {rects:?}");
            }
        }
    }

    #[test]
    fn an_inset_takes_free_ground_and_else_a_corner() {
        let room = Rect::from_min_size(pos2(20.0, 68.0), vec2(1400.0, 780.0));
        let camera = vec2(640.0, 480.0);
        // There is free space beside a 4:3 image and above a wide one.
        for picture in [vec2(640.0, 480.0), vec2(2000.0, 500.0)] {
            let picture = fit(room, picture);
            let rect = inset(room, camera, &[picture]);
            assert!(room.expand(0.5).contains_rect(rect), "{rect:?}");
            assert!(!rect.shrink(0.5).intersects(picture), "{rect:?} covers {picture:?}");
            assert!(rect.width() >= 0.12 * room.width());
        }
        // An image that fills the room, such as a panorama: in its corner.
        for picture in [room, Rect::from_center_size(room.center(), vec2(1400.0, 700.0))] {
            let rect = inset(room, camera, &[picture]);
            assert!(room.expand(0.5).contains_rect(rect), "{rect:?}");
            assert!(!rect.intersects(middle(picture)), "{rect:?} reaches into the middle");
            assert!(rect.width() >= 0.15 * room.width(), "{rect:?}");
        }
        // Several images: no middle is covered.
        for count in 1..6 {
            let pictures = rects(&vec![camera; count], room);
            let rect = inset(room, camera, &pictures);
            assert!(pictures.iter().all(|p| !rect.shrink(0.5).intersects(middle(*p))), "{count}: {rect:?}");
            let mut titles = pictures.iter().map(|p| p.with_max_y(p.top() + TITLE));
            assert!(titles.all(|title| !rect.shrink(0.5).intersects(title.shrink(0.5))), "{count}: {rect:?}");
        }
    }

    #[test]
    fn two_pictures_begin_at_one_height() {
        let room = Rect::from_min_size(pos2(16.0, 80.0), vec2(1400.0, 700.0));
        let rects = rects(&[vec2(900.0, 560.0), vec2(640.0, 480.0)], room);
        assert_eq!(rects[0].top(), rects[1].top());
        assert!(rects.iter().all(|rect| room.expand(0.5).contains_rect(*rect)), "{rects:?}");
    }
}
