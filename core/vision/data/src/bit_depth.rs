//! Finds the white value of images with more than eight bits: one for all views and images of a source, so that they
//! are comparable.

/// Usual bit depths of cameras.
const BITS: [u32; 5] = [8, 10, 12, 14, 16];

/// The white value of a bit depth.
pub fn white_of_bits(bits: u32) -> f32 {
    ((1u32 << bits.clamp(1, 16)) - 1) as f32
}

/// The smallest white of a usual bit depth that holds an image with this largest value; 1.0 for floats up to 1.0.
/// `None` when no depth holds it.
pub fn white_for(peak: f32, is_float: bool) -> Option<f32> {
    if is_float && peak <= 1.0 {
        return Some(1.0);
    }
    BITS.into_iter().map(white_of_bits).find(|white| peak <= *white)
}

/// An image with more than eight bits.
#[derive(Clone, Copy, Debug)]
pub struct Deep<'n> {
    /// Its name for messages.
    pub name: &'n str,
    /// Its largest value.
    pub peak: f32,
    /// Whether its values are floats.
    pub is_float: bool,
}

/// Log message when white is found or changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Remark {
    /// For information.
    Info(String),
    /// A warning.
    Warning(String),
}

/// Values that exceed 16 bits.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name}: values up to {peak} exceed 16 bits: scale the image so that white is 1.0, 255 or 65535")]
pub struct TooBright {
    name: String,
    peak: f32,
}

/// White, once it is known.
#[derive(Debug, Default)]
pub struct White {
    /// `bit_depth` and the white that follows.
    found: Option<(u32, f32)>,
    clip_reported: bool,
}

impl White {
    /// White of the images of one tick; 255 when none has more than eight bits. `bits` is the user's setting, 0 for
    /// none; `series` returns the largest values of other images of the same series.
    ///
    /// # Errors
    /// Values that exceed every bit depth.
    pub fn of<'n>(
        &mut self,
        bits: u32,
        images: impl Iterator<Item = Deep<'n>>,
        series: impl FnOnce() -> Vec<f32>,
    ) -> Result<(f32, Option<Remark>), TooBright> {
        let Some(Deep { name, peak, is_float }) = images.max_by(|a, b| a.peak.total_cmp(&b.peak)) else {
            return Ok((white_of_bits(8), None));
        };
        if bits > 0 {
            let white = white_of_bits(bits);
            let is_new = peak > white && !self.clip_reported;
            self.clip_reported |= is_new;
            let remark = is_new.then(|| {
                Remark::Warning(format!(
                    "{name} holds values up to {peak}, `bit_depth = {bits}` ends at {white}: what is brighter is shown white"
                ))
            });
            self.found = Some((bits, white));
            return Ok((white, remark));
        }
        let before = self.found.filter(|(bits, _)| *bits == 0).map(|(_, white)| white);
        if let Some(white) = before.filter(|white| peak <= *white) {
            return Ok((white, None));
        }
        let most = if before.is_none() { series().into_iter().fold(peak, f32::max) } else { peak };
        let white = white_for(most, is_float).ok_or_else(|| TooBright { name: name.to_owned(), peak: most })?;
        self.found = Some((0, white));
        let remark = match before {
            None => Remark::Info(format!(
                "{name} has more than 8 bits with values up to {most}: {white} is taken for white in all views (`bit_depth` sets it)"
            )),
            Some(before) => Remark::Warning(format!(
                "{name} holds values up to {most}, up to now {before} was white: from here on it is {white}. Set `bit_depth` to give all images one scale"
            )),
        };
        Ok((white, Some(remark)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_is_the_depth_that_holds_the_values() {
        assert_eq!(white_for(0.5, true), Some(1.0));
        assert_eq!(white_for(0.5, false), Some(255.0));
        for (peak, white) in [(200.0, 255.0), (256.0, 1023.0), (16_000.0, 16_383.0), (65_535.0, 65_535.0)] {
            assert_eq!(white_for(peak, true), Some(white));
        }
        assert_eq!(white_for(1e6, true), None);
    }

    #[test]
    fn white_grows_with_a_word_and_never_shrinks() {
        let of = |peak| std::iter::once(Deep { name: "left", peak, is_float: false });
        let mut white = White::default();
        let (first, remark) = white.of(0, of(900.0), Vec::new).unwrap();
        assert!(first == 1023.0 && matches!(remark, Some(Remark::Info(_))));
        assert_eq!(white.of(0, of(3.0), Vec::new), Ok((1023.0, None)));
        let (grown, remark) = white.of(0, of(4000.0), Vec::new).unwrap();
        assert!(grown == 4095.0 && matches!(remark, Some(Remark::Warning(_))));
        let (set, remark) = white.of(10, of(4000.0), Vec::new).unwrap();
        assert!(set == 1023.0 && matches!(remark, Some(Remark::Warning(_))));
        assert_eq!(white.of(10, of(4000.0), Vec::new), Ok((1023.0, None)));
        assert!(White::default().of(0, of(1e6), Vec::new).is_err());
        assert_eq!(white.of(0, std::iter::empty(), Vec::new), Ok((255.0, None)));
    }
}
