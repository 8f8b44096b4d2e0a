//! The last preview of each output: textures for the graphics card, and texts.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use eframe::egui::{Color32, ColorImage, Context, TextureHandle, TextureId, TextureOptions, Vec2, vec2};

use panoscope_editor_model::observe::Output;
use panoscope_editor_model::picture::RenderedPacket;
use panoscope_editor_model::pixels::Pixels;
use panoscope_editor_model::texts::number;

/// A time in ms, formatted with its unit and three significant digits, in the language of the window.
pub fn format_time(ms: f64) -> String {
    match ms {
        _ if ms >= 1000.0 => format!("{} s", number(ms / 1e3, 1)),
        _ if ms >= 100.0 => format!("{ms:.0} ms"),
        _ if ms >= 0.1 => format!("{} ms", number(ms, 1)),
        _ => format!("{:.0} us", ms * 1e3),
    }
}

/// The unit to show after a number; empty for ratios.
pub fn unit_suffix(unit: &str) -> &str {
    if unit == "ratio" { "" } else { unit }
}

/// Age from which a preview is not live.
const STALE: Duration = Duration::from_secs(2);

/// The last preview of an output.
struct CachedOutput {
    texture: Option<TextureHandle>,
    packet: RenderedPacket,
    pixels: Option<Pixels>,
    at: Instant,
}

/// The last previews of the outputs that a window shows.
#[derive(Default)]
pub struct OutputCache {
    outputs: HashMap<Output, CachedOutput>,
    /// Whether the run has ended.
    is_over: bool,
}

/// Converts pixels to egui's image type, for textures.
pub fn image_of(pixels: &Pixels) -> ColorImage {
    let colors = pixels.rgba.chunks_exact(4).map(|p| Color32::from_rgb(p[0], p[1], p[2])).collect();
    ColorImage::new([pixels.width, pixels.height], colors)
}

impl OutputCache {
    /// Stores new previews; a texture of the same size is updated in place.
    pub fn update(&mut self, ctx: &Context, looks: HashMap<Output, RenderedPacket>) {
        for (output, mut packet) in looks {
            let outputs = self.outputs.entry(output).or_insert_with(|| CachedOutput {
                texture: None,
                packet: RenderedPacket::default(),
                pixels: None,
                at: Instant::now(),
            });
            if let Some(pixels) = packet.pixels.take() {
                let image = image_of(&pixels);
                outputs.pixels = Some(pixels);
                match &mut outputs.texture {
                    Some(texture) if texture.size() == image.size => {
                        texture.set_partial([0, 0], image, TextureOptions::LINEAR);
                    }
                    texture => *texture = Some(ctx.load_texture("output", image, TextureOptions::LINEAR)),
                }
            }
            outputs.packet = packet;
            outputs.at = Instant::now();
        }
    }

    /// Drops the outputs for which `wanted` is false.
    pub fn retain(&mut self, wanted: impl Fn(&Output) -> bool) {
        self.outputs.retain(|output, _| wanted(output));
    }

    /// The texture of an output, and its size in px.
    pub fn texture(&self, output: &Output) -> Option<(TextureId, Vec2)> {
        let texture = self.outputs.get(output)?.texture.as_ref()?;
        Some((texture.id(), texture.size_vec2()))
    }

    /// Sets whether the run has ended: its last previews are what it came to, and count as old no more.
    pub fn set_over(&mut self, is_over: bool) {
        self.is_over = is_over;
    }

    /// Age of the last preview, if it is too old to count as live.
    pub fn stale(&self, output: &Output) -> Option<Duration> {
        let age = self.outputs.get(output).map(|outputs| outputs.at.elapsed());
        age.filter(|age| *age > STALE && !self.is_over)
    }

    /// Time until the next preview counts as old; `None` when all do.
    pub fn until_stale(&self) -> Option<Duration> {
        let running = self.outputs.values().filter(|_| !self.is_over);
        let left = running.filter_map(|output| STALE.checked_sub(output.at.elapsed()));
        left.min().map(|left| left + Duration::from_millis(20))
    }

    /// The pixels of an output.
    pub fn pixels(&self, output: &Output) -> Option<&Pixels> {
        self.outputs.get(output)?.pixels.as_ref()
    }

    /// The last preview of an output, without its pixels.
    pub fn packet(&self, output: &Output) -> Option<&RenderedPacket> {
        Some(&self.outputs.get(output)?.packet)
    }

    /// The text of the last preview: range of colours or contents; `None` when it is empty.
    pub fn text(&self, output: &Output) -> Option<&str> {
        self.packet(output).map(|l| l.text.as_str()).filter(|w| !w.is_empty())
    }

    /// Size of the packet itself in px.
    pub fn size(&self, output: &Output) -> Option<Vec2> {
        self.packet(output).map(|l| vec2(l.size.0 as f32, l.size.1 as f32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_previews_of_an_ended_run_are_not_old() {
        let output = Output::new("a", "image");
        let mut cache = OutputCache::default();
        let old = Instant::now().checked_sub(3 * STALE).expect("the machine runs for longer");
        let kept = CachedOutput { texture: None, packet: RenderedPacket::default(), pixels: None, at: old };
        cache.outputs.insert(output.clone(), kept);
        assert!(cache.stale(&output).is_some_and(|age| age > STALE));
        cache.set_over(true);
        assert!(cache.stale(&output).is_none() && cache.until_stale().is_none());
    }
}
