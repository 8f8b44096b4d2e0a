//! Colours, sizes and distances. Dark and calm: one accent; hues that colour-blind eyes tell apart (Okabe and Ito, "Color Universal Design").

use eframe::egui::{
    Color32, Context, CornerRadius, FontFamily, FontId, Margin, Shadow, Stroke, TextStyle, Theme, Vec2,
    style::Selection,
};

const fn rgb(hex: u32) -> Color32 {
    Color32::from_rgb((hex >> 16) as u8, (hex >> 8) as u8, hex as u8)
}

/// Behind everything.
pub const GROUND: Color32 = rgb(0x12151A);
/// Panels.
pub const PANEL: Color32 = rgb(0x181C22);
/// Nodes and raised things.
pub const RAISED: Color32 = rgb(0x20262E);
/// Fields and pictures without a picture.
pub const SUNK: Color32 = rgb(0x0D1014);
/// Around surfaces, which are painted on this.
pub const SURFACE: Color32 = Color32::from_gray(18);
/// Thin lines.
pub const LINE: Color32 = rgb(0x2E3640);
/// Text.
pub const TEXT: Color32 = rgb(0xDCE2EA);
/// Text that can wait.
pub const MUTED: Color32 = rgb(0x8D98A7);
/// The accent: selection, focus, values that differ from the file.
pub const ACCENT: Color32 = rgb(0x56B4E9);
/// Something is wrong now.
pub const FAULT: Color32 = rgb(0xEE7733);
/// Something was wrong, or may be.
pub const WARN: Color32 = rgb(0xE6C229);

/// Behind pictures in the theatre.
pub const BLACK: Color32 = rgb(0x06080A);
/// All is well and goes on.
pub const LIVE: Color32 = rgb(0x43C6A0);

/// One step of the grid that all distances are multiples of, in points.
pub const STEP: f32 = 4.0;

/// Colour of a family of nodes.
pub fn family(name: &str) -> Color32 {
    match name {
        "source" => rgb(0x009E73),
        "stitch" => rgb(0xE69F00),
        "stereo" => rgb(0x3D8FD1),
        "tools" => rgb(0xCC79A7),
        "arm" => rgb(0xB58AD6),
        "overlay" | "filter" => rgb(0xD9CE5B),
        "sink" => rgb(0x9AA5B1),
        "unknown" => FAULT,
        _ => rgb(0x6F8FA8),
    }
}

/// Colour of a class of things that are found, or of a curve: eight that colour-blind eyes tell apart, then the same again.
pub fn class(index: u32) -> Color32 {
    const COLORS: [Color32; 8] = [
        rgb(0x56B4E9),
        rgb(0xE69F00),
        rgb(0x2DBE95),
        rgb(0xCC79A7),
        rgb(0xF0E442),
        rgb(0xEE7733),
        rgb(0x9AA5B1),
        rgb(0x3D8FD1),
    ];
    COLORS[index as usize % COLORS.len()]
}

/// Colour of what flows through a pin.
pub fn packet(name: &str) -> Color32 {
    match name {
        "image" | "mask" => rgb(0x7FC4EC),
        "disparity" | "depth" | "confidence" => rgb(0x2DBE95),
        "cloud" => rgb(0x8FD16F),
        "homography" | "calibration" | "pose" | "joints" | "roi" => rgb(0xD99ABF),
        "detections" | "instances" | "tip" => rgb(0xEBB13D),
        _ => rgb(0xA9B3BF),
    }
}

/// Shape of a pin, so that colour is not the only sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PinShape {
    /// Pictures.
    Circle,
    /// Maps of numbers.
    Square,
    /// Geometry.
    Diamond,
    /// Things found, and clouds.
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

/// From calm to hot, for the heat map; `share` 0..=1.
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
        visuals.panel_fill = PANEL;
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

/// What the theatre has larger and darker.
pub fn apply_theatre(ctx: &Context) {
    ctx.style_mut_of(Theme::Dark, |style| {
        style.visuals.panel_fill = BLACK;
        style.interaction.tooltip_delay = f32::INFINITY;
        style.animation_time = 0.0;
    });
}
