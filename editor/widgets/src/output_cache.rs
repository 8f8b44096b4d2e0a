//! Outputs as they were seen last: pictures for the graphics card, and words.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use eframe::egui::{Color32, ColorImage, Context, TextureHandle, TextureId, TextureOptions, Vec2, vec2};

use panoscope_editor_model::observe::Output;
use panoscope_editor_model::picture::{Look, Pixels};

/// A time in words, with three digits that matter.
pub fn time_words(ms: f64) -> String {
    match ms {
        _ if ms >= 1000.0 => format!("{:.1} s", ms / 1e3),
        _ if ms >= 100.0 => format!("{ms:.0} ms"),
        _ if ms >= 0.1 => format!("{ms:.1} ms"),
        _ => format!("{:.0} us", ms * 1e3),
    }
}

/// A unit as it stands behind a number; parts of one have none.
pub fn unit_words(unit: &str) -> &str {
    if unit == "ratio" { "" } else { unit }
}

/// What is older is not live.
const STALE: Duration = Duration::from_secs(2);

/// An output as it was seen last.
struct Seen {
    texture: Option<TextureHandle>,
    look: Look,
    pixels: Option<Pixels>,
    at: Instant,
}

/// Pictures and words of the outputs that are looked at.
#[derive(Default)]
pub struct Shown {
    seen: HashMap<Output, Seen>,
}

/// For the graphics card.
pub fn image_of(pixels: &Pixels) -> ColorImage {
    let colors = pixels.rgba.chunks_exact(4).map(|p| Color32::from_rgb(p[0], p[1], p[2])).collect();
    ColorImage::new([pixels.width, pixels.height], colors)
}

impl Shown {
    /// Takes new looks over; textures of the same size are written in place.
    pub fn update(&mut self, ctx: &Context, looks: HashMap<Output, Look>) {
        for (output, mut look) in looks {
            let seen = self.seen.entry(output).or_insert_with(|| Seen {
                texture: None,
                look: Look::default(),
                pixels: None,
                at: Instant::now(),
            });
            if let Some(pixels) = look.pixels.take() {
                let image = image_of(&pixels);
                seen.pixels = Some(pixels);
                match &mut seen.texture {
                    Some(texture) if texture.size() == image.size => {
                        texture.set_partial([0, 0], image, TextureOptions::LINEAR);
                    }
                    texture => *texture = Some(ctx.load_texture("output", image, TextureOptions::LINEAR)),
                }
            }
            seen.look = look;
            seen.at = Instant::now();
        }
    }

    /// Forgets outputs that are gone.
    pub fn keep(&mut self, wanted: impl Fn(&Output) -> bool) {
        self.seen.retain(|output, _| wanted(output));
    }

    /// The texture of an output, and its size in pixels.
    pub fn texture(&self, output: &Output) -> Option<(TextureId, Vec2)> {
        let texture = self.seen.get(output)?.texture.as_ref()?;
        Some((texture.id(), texture.size_vec2()))
    }

    /// For how long nothing new has come, once that is too long to take what is shown for live.
    pub fn stale(&self, output: &Output) -> Option<Duration> {
        self.seen.get(output).map(|seen| seen.at.elapsed()).filter(|age| *age > STALE)
    }

    /// The pixels of an output.
    pub fn pixels(&self, output: &Output) -> Option<&Pixels> {
        self.seen.get(output)?.pixels.as_ref()
    }

    /// What is known of an output besides its picture.
    pub fn look(&self, output: &Output) -> Option<&Look> {
        Some(&self.seen.get(output)?.look)
    }

    /// Range or contents in words.
    pub fn words(&self, output: &Output) -> Option<&str> {
        self.look(output).map(|l| l.words.as_str()).filter(|w| !w.is_empty())
    }

    /// Size of the packet itself, in pixels.
    pub fn size(&self, output: &Output) -> Option<Vec2> {
        self.look(output).map(|l| vec2(l.size.0 as f32, l.size.1 as f32))
    }
}
