//! Colours, sizes and distances of both windows. The hues follow Okabe and Ito ("Color Universal Design"), adjusted so that people with any
//! kind of colour vision can distinguish them; see the test below.

use eframe::egui::{
    Color32, Context, CornerRadius, FontFamily, FontId, Margin, Shadow, Stroke, TextStyle, Theme, Vec2,
    style::Selection,
};

const fn rgb(hex: u32) -> Color32 {
    Color32::from_rgb((hex >> 16) as u8, (hex >> 8) as u8, hex as u8)
}

/// Background of the window.
pub const GROUND: Color32 = rgb(0x12151A);
/// Background of panels.
pub const PANEL: Color32 = rgb(0x181C22);
/// Background of nodes and buttons.
pub const RAISED: Color32 = rgb(0x20262E);
/// Background of fields and of empty previews.
pub const SUNK: Color32 = rgb(0x0D1014);
/// Background of rendered surfaces.
pub const SURFACE: Color32 = Color32::from_gray(18);
/// Borders and grid points.
pub const LINE: Color32 = rgb(0x2E3640);
/// Normal text.
pub const TEXT: Color32 = rgb(0xDCE2EA);
/// Less important text.
pub const MUTED: Color32 = rgb(0x8D98A7);
/// The accent: selection, focus, values that differ from the file.
pub const ACCENT: Color32 = rgb(0x56B4E9);
/// A current fault.
pub const FAULT: Color32 = rgb(0xEE7733);
/// A past or possible fault.
pub const WARN: Color32 = rgb(0xE6C229);

/// Background of the theatre.
pub const BLACK: Color32 = rgb(0x06080A);
/// Normal, live operation.
pub const LIVE: Color32 = rgb(0x43C6A0);

/// Unit of all distances, in points.
pub const STEP: f32 = 4.0;

/// Colour of a family of nodes.
pub fn family(name: &str) -> Color32 {
    match name {
        "source" => rgb(0x0E9757),
        "stitch" => rgb(0xF6A403),
        "stereo" => rgb(0x5993FB),
        "tools" => rgb(0xBA4894),
        "arm" => rgb(0xC487D6),
        "overlay" | "filter" => rgb(0xE3DA69),
        "sink" => rgb(0xA2A2A2),
        "unknown" => FAULT,
        _ => rgb(0xCBE1E6),
    }
}

/// Colour of a detection class or of a curve: eight colours that colour-blind people can distinguish, then the same again.
pub fn class(index: u32) -> Color32 {
    const COLORS: [Color32; 8] = [
        rgb(0x56B4E9),
        rgb(0xEFA000),
        rgb(0x5AF8D1),
        rgb(0xBD71AB),
        rgb(0xFEE836),
        rgb(0xEE7733),
        rgb(0xA8A8A8),
        rgb(0x0578C7),
    ];
    COLORS[index as usize % COLORS.len()]
}

/// Colour of a packet type's pins and wires.
pub fn packet(name: &str) -> Color32 {
    match name {
        "image" | "mask" => rgb(0x6CC8F5),
        "disparity" | "depth" | "confidence" => rgb(0x0F9A66),
        "cloud" => rgb(0xB0E58C),
        "homography" | "calibration" | "pose" | "joints" | "roi" => rgb(0xF0C4D0),
        "detections" | "instances" | "tip" => rgb(0xE7A32F),
        _ => rgb(0x7C8798),
    }
}

/// Shape of a pin; makes packet types distinguishable without colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PinShape {
    /// Images and other packets.
    Circle,
    /// Maps of numbers.
    Square,
    /// Geometry.
    Diamond,
    /// Detections and clouds.
    Triangle,
}

/// Shape of the pin of a packet type.
pub fn pin_shape(name: &str) -> PinShape {
    match name {
        "disparity" | "depth" | "confidence" | "scalar" | "table" | "text" => PinShape::Square,
        "homography" | "calibration" | "pose" | "joints" | "roi" => PinShape::Diamond,
        "detections" | "instances" | "tip" | "cloud" => PinShape::Triangle,
        _ => PinShape::Circle,
    }
}

/// Colour of the heat map for a load `share` of 0 to 1.
pub fn heat(share: f32) -> Color32 {
    let stops = [rgb(0x20262E), rgb(0x413A2C), rgb(0x6B4A22), rgb(0x9A4A1C)];
    let x = share.clamp(0.0, 1.0) * (stops.len() - 1) as f32;
    let i = (x as usize).min(stops.len() - 2);
    stops[i].lerp_to_gamma(stops[i + 1], x - i as f32)
}

/// Sets the style of the whole window.
pub fn apply(ctx: &Context) {
    ctx.set_theme(Theme::Dark);
    ctx.style_mut_of(Theme::Dark, |style| {
        style.text_styles = [
            (TextStyle::Small, FontId::new(11.0, FontFamily::Proportional)),
            (TextStyle::Body, FontId::new(13.0, FontFamily::Proportional)),
            (TextStyle::Button, FontId::new(13.0, FontFamily::Proportional)),
            (TextStyle::Heading, FontId::new(16.0, FontFamily::Proportional)),
            (TextStyle::Monospace, FontId::new(12.0, FontFamily::Monospace)),
        ]
        .into();
        let spacing = &mut style.spacing;
        spacing.item_spacing = Vec2::new(2.0 * STEP, 2.0 * STEP);
        spacing.button_padding = Vec2::new(2.0 * STEP, STEP);
        spacing.interact_size.y = 6.0 * STEP;
        spacing.slider_rail_height = STEP;
        spacing.window_margin = Margin::same(16);
        spacing.menu_margin = Margin::same(8);
        style.animation_time = 0.1;
        let visuals = &mut style.visuals;
        visuals.panel_fill = GROUND;
        visuals.window_fill = PANEL;
        visuals.window_stroke = Stroke::new(1.0, LINE);
        visuals.window_corner_radius = CornerRadius::same(8);
        visuals.menu_corner_radius = CornerRadius::same(8);
        visuals.window_shadow = Shadow { offset: [0, 8], blur: 24, spread: 0, color: Color32::from_black_alpha(110) };
        visuals.popup_shadow = visuals.window_shadow;
        visuals.extreme_bg_color = SUNK;
        visuals.faint_bg_color = RAISED;
        visuals.code_bg_color = SUNK;
        visuals.hyperlink_color = ACCENT;
        visuals.warn_fg_color = WARN;
        visuals.error_fg_color = FAULT;
        visuals.selection = Selection { bg_fill: ACCENT.gamma_multiply(0.35), stroke: Stroke::new(1.0, ACCENT) };
        visuals.slider_trailing_fill = true;
        visuals.weak_text_color = Some(MUTED);
        let widgets = &mut visuals.widgets;
        let states = [
            &mut widgets.noninteractive,
            &mut widgets.inactive,
            &mut widgets.hovered,
            &mut widgets.active,
            &mut widgets.open,
        ];
        for widget in states {
            widget.corner_radius = CornerRadius::same(4);
            widget.expansion = 0.0;
        }
        widgets.noninteractive.bg_stroke = Stroke::new(1.0, LINE);
        widgets.noninteractive.fg_stroke = Stroke::new(1.0, TEXT);
        widgets.noninteractive.bg_fill = PANEL;
        for (widget, fill) in [
            (&mut widgets.inactive, rgb(0x29313B)),
            (&mut widgets.hovered, rgb(0x333D49)),
            (&mut widgets.active, rgb(0x3C4856)),
            (&mut widgets.open, rgb(0x333D49)),
        ] {
            widget.bg_fill = fill;
            widget.weak_bg_fill = fill;
            widget.bg_stroke = Stroke::NONE;
            widget.fg_stroke = Stroke::new(1.0, TEXT);
        }
        widgets.hovered.bg_stroke = Stroke::new(1.0, rgb(0x4A5766));
        widgets.active.bg_stroke = Stroke::new(1.0, ACCENT);
    });
}

/// Changes the style for the theatre: darker, no tooltips, no animations.
pub fn apply_theatre(ctx: &Context) {
    ctx.style_mut_of(Theme::Dark, |style| {
        style.visuals.panel_fill = BLACK;
        style.interaction.tooltip_delay = f32::INFINITY;
        style.animation_time = 0.0;
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Transforms of linear RGB that simulate colour vision deficiencies: Machado, Oliveira and Fernandes, "A Physiologically-based Model for
    /// Simulation of Color Vision Deficiency", 2009, severity 1. The first one is normal vision.
    const EYES: [(&str, [[f32; 3]; 3]); 4] = [
        ("usual", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        (
            "protanope",
            [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        ),
        (
            "deuteranope",
            [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
        ),
        (
            "tritanope",
            [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
        ),
    ];

    fn linear(color: Color32) -> [f32; 3] {
        [color.r(), color.g(), color.b()].map(|v| {
            let v = f32::from(v) / 255.0;
            if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
        })
    }

    /// CIE L*a*b* under D65.
    fn lab([r, g, b]: [f32; 3]) -> [f32; 3] {
        let curve = |t: f32| if t > 0.008856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 };
        let x = curve((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
        let y = curve(0.2126 * r + 0.7152 * g + 0.0722 * b);
        let z = curve((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    fn seen(color: Color32, eye: &[[f32; 3]; 3]) -> [f32; 3] {
        let light = linear(color);
        lab(eye.map(|row| row.iter().zip(light).map(|(a, b)| a * b).sum::<f32>().clamp(0.0, 1.0)))
    }

    /// Smallest difference of two colours of a set over all kinds of vision; about 2.3 is just noticeable.
    fn least(colors: &[Color32]) -> f32 {
        let mut least = f32::MAX;
        for (_, eye) in &EYES {
            for (k, a) in colors.iter().enumerate() {
                for b in &colors[..k] {
                    let apart: f32 = seen(*a, eye).iter().zip(seen(*b, eye)).map(|(x, y)| (x - y).powi(2)).sum();
                    least = least.min(apart.sqrt());
                }
            }
        }
        least
    }

    fn contrast(a: Color32, b: Color32) -> f32 {
        let light = |color| {
            let [r, g, b] = linear(color);
            0.2126 * r + 0.7152 * g + 0.0722 * b + 0.05
        };
        (light(a) / light(b)).max(light(b) / light(a))
    }

    #[test]
    fn colours_are_distinguishable_with_any_colour_vision() {
        let families = ["source", "stitch", "stereo", "tools", "arm", "filter", "sink", "unknown", "other"].map(family);
        let classes: Vec<Color32> = (0..8).map(class).collect();
        let packets = ["image", "depth", "cloud", "pose", "tip", "text"].map(packet);
        for (name, colors, apart) in
            [("families", &families[..], 18.0), ("classes", &classes, 14.0), ("packets", &packets, 20.0)]
        {
            assert!(least(colors) > apart, "{name}: {}", least(colors));
        }
        // Normal, past fault and current fault must differ more.
        assert!(least(&[LIVE, WARN, FAULT]) > 18.0, "{}", least(&[LIVE, WARN, FAULT]));
    }

    #[test]
    fn texts_and_marks_have_enough_contrast() {
        for ground in [GROUND, PANEL, RAISED, BLACK, SUNK] {
            for text in [TEXT, MUTED, ACCENT, FAULT, WARN] {
                assert!(contrast(text, ground) > 4.5, "{text:?} on {ground:?}: {}", contrast(text, ground));
            }
        }
        for mark in ["source", "stitch", "stereo", "tools", "arm", "filter", "sink", "other"].map(family) {
            assert!(contrast(mark, RAISED) > 3.0, "{mark:?}: {}", contrast(mark, RAISED));
        }
    }
}
