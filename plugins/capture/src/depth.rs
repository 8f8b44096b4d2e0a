//! Which value of pictures with more than eight bits is white: one for all views and all pictures of a node, so that they can be compared.

use panoscope_node::{Context, NodeError, Result};

use crate::source::{Picture, white_of_bits};

/// White, once it is known.
#[derive(Debug, Default)]
pub struct Depth {
    /// `bit_depth` and the white that follows.
    found: Option<(u32, f32)>,
    clip_reported: bool,
}

impl Depth {
    /// White of the pictures of one tick; 255 when none has more than eight bits. `bits` is what the user says, 0 for nothing; `series` gives
    /// the largest values of other pictures of the same series.
    ///
    /// # Errors
    /// Values that no bit depth holds.
    pub fn white<'p>(
        &mut self,
        cx: &Context<'_>,
        bits: u32,
        pictures: impl Iterator<Item = (&'p str, &'p Picture)>,
        series: impl FnOnce() -> Vec<f32>,
    ) -> Result<f32> {
        let deep = pictures.filter_map(|(name, picture)| Some((name, picture, picture.peak()?)));
        let Some((name, picture, peak)) = deep.max_by(|a, b| a.2.total_cmp(&b.2)) else { return Ok(white_of_bits(8)) };
        if bits > 0 {
            let white = white_of_bits(bits);
            if peak > white && !self.clip_reported {
                self.clip_reported = true;
                cx.warn(&format!(
                    "{name} holds values up to {peak}, `bit_depth = {bits}` ends at {white}: what is brighter is shown white"
                ));
            }
            self.found = Some((bits, white));
            return Ok(white);
        }
        let before = self.found.filter(|(bits, _)| *bits == 0).map(|(_, white)| white);
        if let Some(white) = before.filter(|white| peak <= *white) {
            return Ok(white);
        }
        let most = if before.is_none() { series().into_iter().fold(peak, f32::max) } else { peak };
        let white = picture.white_for(most).map_err(|most| {
            NodeError::new(format!(
                "{name}: values up to {most} are more than 16 bits hold: scale the picture so that white is 1.0, 255 or 65535"
            ))
        })?;
        self.found = Some((0, white));
        match before {
            None => cx.info(&format!(
                "{name} has more than 8 bits with values up to {most}: {white} is taken for white in all views (`bit_depth` sets it)"
            )),
            Some(before) => cx.warn(&format!(
                "{name} holds values up to {most}, up to now {before} was white: from here on it is {white}. Set `bit_depth` to give all pictures one scale"
            )),
        }
        Ok(white)
    }
}
