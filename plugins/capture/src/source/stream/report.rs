//! Messages about the frames of a stream.

use super::{HEADER_ERROR_FRAMES, State, Stream};

impl Stream {
    /// Unusual properties of its frames, as text.
    pub fn remark(&self) -> Option<String> {
        let State::Open(input) = &self.state else { return None };
        let format = input.format();
        let (width, height) = format.pixel_aspect;
        let mut parts = Vec::new();
        if width != height {
            parts.push(format!(
                "its pixel aspect ratio is {width}:{height}: pixels are kept, so fx and fy of its calibration differ by this ratio"
            ));
        }
        if format.exif_orientation > 1 {
            parts.push("its metadata asks for a rotation (`orientation`)".to_owned());
        }
        if format.is_interlaced {
            parts.push("its frames are interlaced: only the upper field of each is used".to_owned());
        }
        (!parts.is_empty())
            .then(|| format!("{} ({}x{}): {}", self.name.in_words(), format.width, format.height, parts.join("; ")))
    }

    /// A message about missing frames at the end of a file or pipeline that announced more.
    pub(super) fn missing(&self) -> Option<String> {
        let (read, announced, name) = (self.frames, self.expected, self.name.in_words());
        let State::Open(input) = &self.state else { return None };
        let counts = |announced: u64| {
            (announced > read + HEADER_ERROR_FRAMES + read / 100).then(|| {
                format!(
                    "{name} ended after {read} of {announced} frames: it is truncated or damaged, or a frame in it cannot be decoded"
                )
            })
        };
        let Some(length) = self.length else { return counts(announced) };
        // Frames may lie at any distance, so only the time of the last one says whether the file is whole.
        let (length_s, reached_s) = (length.as_secs_f64(), input.reached().as_secs_f64());
        let frame_s = self.fps.map_or(0.0, |fps| 1.0 / fps);
        // The container's clock may have begun hours before the first frame, and its length count from there or from the first frame.
        let begin_s = self.before.map_or(0.0, |(_, last_s)| (reached_s - last_s - frame_s).max(0.0));
        let (end_s, span_s) =
            if begin_s < length_s { (reached_s, length_s - begin_s) } else { (reached_s - begin_s, length_s) };
        let slack_s = HEADER_ERROR_FRAMES as f64 * frame_s + span_s / 100.0 + self.max_step_s;
        if end_s + slack_s < length_s {
            return Some(format!(
                "{name} ended at {end_s:.1} of {length_s:.1} s, after {read} frames: it is truncated or damaged, or a frame in it cannot be decoded"
            ));
        }
        if input.has_damage() { counts(announced) } else { None }
    }
}
