//! Regions of frames: crops in px, and the halves of a frame that holds both views.

use panoscope_node::Rect;

/// Why a frame cannot be cropped.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum CropError {
    /// The crop extends beyond the frame.
    #[error("the crop {width}x{height} at ({x}, {y}) extends beyond the frame of {picture_width}x{picture_height}")]
    Leaves { x: usize, y: usize, width: usize, height: usize, picture_width: usize, picture_height: usize },
    /// A number is negative, not an integer, or larger than any frame.
    #[error("the crop {crop:?} is not valid: give x, y, width, height as integers in px, not negative")]
    NotWhole { crop: [f64; 4] },
    /// The list does not have four numbers, or four for each view.
    #[error(
        "`crop` has {count} numbers: give x, y, width, height once for all views, or once for each of the {views} views"
    )]
    Count { count: usize, views: usize },
}

/// How one source holds two views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Halves {
    /// Left view on the left.
    SideBySide,
    /// Left view above.
    TopBottom,
}

impl Halves {
    /// Half of a frame that holds both views; `view` is 0 or 1. An odd last row or column belongs to neither.
    pub fn of(self, picture: Rect, view: usize) -> Rect {
        let Rect { x, y, width, height } = picture;
        match self {
            Self::SideBySide => Rect { x: x + view * (width / 2), width: width / 2, ..picture },
            Self::TopBottom => Rect { y: y + view * (height / 2), height: height / 2, ..picture },
        }
    }
}

/// The region `x, y, width, height` of `picture`, in px from its corner. A width or height of 0 extends to the edge.
///
/// # Errors
/// The numbers are not integers, or the region extends beyond the frame.
pub fn part(picture: Rect, crop: [f64; 4]) -> Result<Rect, CropError> {
    let [x, y, width, height] = whole_numbers(crop)?;
    let width = if width == 0 { picture.width.saturating_sub(x) } else { width };
    let height = if height == 0 { picture.height.saturating_sub(y) } else { height };
    if width == 0 || height == 0 || x + width > picture.width || y + height > picture.height {
        let (picture_width, picture_height) = (picture.width, picture.height);
        return Err(CropError::Leaves { x, y, width, height, picture_width, picture_height });
    }
    Ok(Rect { x: picture.x + x, y: picture.y + y, width, height })
}

/// Reads `x, y, width, height` as integers.
///
/// # Errors
/// A number is negative, not an integer, or larger than any frame.
pub fn whole_numbers(crop: [f64; 4]) -> Result<[usize; 4], CropError> {
    if crop.iter().all(|value| *value >= 0.0 && value.fract() == 0.0 && *value < 1e6) {
        return Ok(crop.map(|value| value as usize));
    }
    Err(CropError::NotWhole { crop })
}

/// The crop of view `view` out of a flat list that holds nothing, one rectangle for all views, or one for each.
///
/// # Errors
/// The list has another length.
pub fn of_view(list: &[f64], view: usize, views: usize) -> Result<Option<[f64; 4]>, CropError> {
    let (rectangles, rest) = list.as_chunks::<4>();
    if !rest.is_empty() || !(rectangles.is_empty() || rectangles.len() == 1 || rectangles.len() == views) {
        return Err(CropError::Count { count: list.len(), views });
    }
    Ok(rectangles.get(view).or(rectangles.first()).copied())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crops_stay_inside() {
        let whole = Rect::whole(640, 480);
        assert_eq!(part(whole, [220.0, 0.0, 420.0, 480.0]), Ok(Rect { x: 220, y: 0, width: 420, height: 480 }));
        assert_eq!(part(whole, [10.0, 20.0, 0.0, 0.0]), Ok(Rect { x: 10, y: 20, width: 630, height: 460 }));
        assert!(
            part(whole, [300.0, 0.0, 420.0, 480.0])
                .unwrap_err()
                .to_string()
                .contains("extends beyond the frame of 640x480")
        );
        assert!(part(whole, [0.5, 0.0, 1.0, 1.0]).is_err());
        assert!(part(whole, [-1.0, 0.0, 1.0, 1.0]).is_err());
        assert!(part(whole, [f64::NAN, 0.0, 1.0, 1.0]).is_err());
        assert!(part(whole, [640.0, 0.0, 0.0, 0.0]).is_err());
    }

    #[test]
    fn halves_are_equal() {
        let whole = Rect::whole(641, 480);
        assert_eq!(Halves::SideBySide.of(whole, 1), Rect { x: 320, y: 0, width: 320, height: 480 });
        assert_eq!(Halves::TopBottom.of(whole, 1), Rect { x: 0, y: 240, width: 641, height: 240 });
    }

    #[test]
    fn one_crop_serves_all_views() {
        assert_eq!(of_view(&[], 1, 2), Ok(None));
        assert_eq!(of_view(&[1.0, 2.0, 3.0, 4.0], 1, 2), Ok(Some([1.0, 2.0, 3.0, 4.0])));
        assert_eq!(of_view(&[0.0, 0.0, 3.0, 4.0, 9.0, 0.0, 3.0, 4.0], 1, 2), Ok(Some([9.0, 0.0, 3.0, 4.0])));
        assert!(of_view(&[1.0, 2.0], 0, 2).is_err());
        assert!(of_view(&[0.0; 12], 0, 2).is_err());
    }
}
