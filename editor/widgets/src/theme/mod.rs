//! Colours, sizes and distances of both windows, dark and light. The hues follow Okabe and Ito ("Color Universal Design"), adjusted so that people
//! with any kind of colour vision can distinguish them; see the tests.

mod palette;
mod system;
#[cfg(test)]
mod tests;

use std::cell::Cell;

use eframe::egui::{
    Color32, Context, CornerRadius, FontFamily, FontId, Margin, Shadow, Stroke, TextStyle, Theme, Vec2,
    style::Selection,
};

use palette::{DARK, LIGHT, Palette, rgb};
pub use system::Choice;

thread_local! {
    /// The palette of the windows that this thread draws.
    static CURRENT: Cell<&'static Palette> = const { Cell::new(&DARK) };
}

fn palette() -> &'static Palette {
    CURRENT.get()
}

/// Whether the windows of this thread are light.
pub fn is_light() -> bool {
    std::ptr::eq(palette(), &LIGHT)
}

/// Background of the window.
pub fn ground() -> Color32 {
    palette().ground
}

/// Background of panels.
pub fn panel() -> Color32 {
    palette().panel
}

/// Background of nodes and buttons.
pub fn raised() -> Color32 {
    palette().raised
}

/// Background of fields and of empty previews.
pub fn sunk() -> Color32 {
    palette().sunk
}

/// Borders and grid points.
pub fn line() -> Color32 {
    palette().line
}

/// Normal text.
pub fn text() -> Color32 {
    palette().text
}

/// Less important text.
pub fn muted() -> Color32 {
    palette().muted
}

/// The accent: selection, focus, values that differ from the file.
pub fn accent() -> Color32 {
    palette().accent
}

/// A current fault.
pub fn fault() -> Color32 {
    palette().fault
}

/// A past or possible fault.
pub fn warn() -> Color32 {
    palette().warn
}

/// Normal, live operation.
pub fn live() -> Color32 {
    palette().live
}

/// Background of rendered surfaces.
pub const SURFACE: Color32 = Color32::from_gray(18);
/// Background of the theatre, which is always dark.
pub const BLACK: Color32 = rgb(0x06080A);

/// Size of the smallest text on a screen, px.
const MIN_TEXT_PX: f32 = 11.0;

/// Size of a text in points, at least what is legible where the window is scaled down.
pub fn legible(ctx: &Context, size: f32) -> f32 {
    size.max(MIN_TEXT_PX / ctx.pixels_per_point())
}

/// Unit of all distances, in points.
pub const STEP: f32 = 4.0;

/// Colour of a family of nodes.
pub fn family(name: &str) -> Color32 {
    let families = &palette().families;
    match name {
        "source" => families[0],
        "stitch" => families[1],
        "stereo" => families[2],
        "tools" => families[3],
        "arm" => families[4],
        "overlay" | "filter" => families[5],
        "sink" => families[6],
        "unknown" => fault(),
        _ => families[7],
    }
}

/// Colour of a detection class or of a curve: eight colours that colour-blind people can distinguish, then the same again.
pub fn class(index: u32) -> Color32 {
    let classes = &palette().classes;
    classes[index as usize % classes.len()]
}

/// Colour of a packet type's pins and wires.
pub fn packet(name: &str) -> Color32 {
    let packets = &palette().packets;
    match name {
        "image" | "mask" => packets[0],
        "disparity" | "depth" | "confidence" => packets[1],
        "cloud" => packets[2],
        "homography" | "calibration" | "pose" | "joints" | "roi" => packets[3],
        "detections" | "instances" | "tip" => packets[4],
        _ => packets[5],
    }
}

/// The colour of a text on a filled mark: black or white, whichever is more legible.
pub fn on(mark: Color32) -> Color32 {
    let light = 0.299 * f32::from(mark.r()) + 0.587 * f32::from(mark.g()) + 0.114 * f32::from(mark.b());
    if light > 120.0 { rgb(0x0D1014) } else { Color32::WHITE }
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
    let stops = &palette().heat;
    let x = share.clamp(0.0, 1.0) * (stops.len() - 1) as f32;
    let i = (x as usize).min(stops.len() - 2);
    stops[i].lerp_to_gamma(stops[i + 1], x - i as f32)
}

/// Sets the style of the whole window, dark.
pub fn apply(ctx: &Context) {
    apply_choice(ctx, Choice::Dark);
}

/// Sets the style of the whole window. Returns whether it is light.
pub fn apply_choice(ctx: &Context, choice: Choice) -> bool {
    let light = choice.is_light(ctx);
    CURRENT.set(if light { &LIGHT } else { &DARK });
    let theme = if light { Theme::Light } else { Theme::Dark };
    ctx.set_theme(theme);
    style(ctx, theme);
    light
}

fn style(ctx: &Context, theme: Theme) {
    let Palette { buttons, button_edge, .. } = *palette();
    ctx.style_mut_of(theme, |style| {
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
        style.number_formatter = crate::numbers::formatter();
        let visuals = &mut style.visuals;
        visuals.panel_fill = ground();
        visuals.window_fill = panel();
        visuals.window_stroke = Stroke::new(1.0, line());
        visuals.window_corner_radius = CornerRadius::same(8);
        visuals.menu_corner_radius = CornerRadius::same(8);
        visuals.window_shadow = Shadow {
            offset: [0, 8],
            blur: 24,
            spread: 0,
            color: Color32::from_black_alpha(if is_light() { 48 } else { 110 }),
        };
        visuals.popup_shadow = visuals.window_shadow;
        visuals.extreme_bg_color = sunk();
        visuals.faint_bg_color = raised();
        visuals.code_bg_color = sunk();
        visuals.hyperlink_color = accent();
        visuals.warn_fg_color = warn();
        visuals.error_fg_color = fault();
        visuals.selection = Selection { bg_fill: accent().gamma_multiply(0.35), stroke: Stroke::new(1.0, accent()) };
        visuals.slider_trailing_fill = true;
        visuals.weak_text_color = Some(muted());
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
        widgets.noninteractive.bg_stroke = Stroke::new(1.0, line());
        widgets.noninteractive.fg_stroke = Stroke::new(1.0, text());
        widgets.noninteractive.bg_fill = panel();
        for (widget, fill) in [
            (&mut widgets.inactive, buttons[0]),
            (&mut widgets.hovered, buttons[1]),
            (&mut widgets.active, buttons[2]),
            (&mut widgets.open, buttons[1]),
        ] {
            widget.bg_fill = fill;
            widget.weak_bg_fill = fill;
            widget.bg_stroke = Stroke::NONE;
            widget.fg_stroke = Stroke::new(1.0, text());
        }
        widgets.hovered.bg_stroke = Stroke::new(1.0, button_edge);
        widgets.active.bg_stroke = Stroke::new(1.0, accent());
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
