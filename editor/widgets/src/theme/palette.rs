//! The colours of both themes.

use eframe::egui::Color32;

pub(super) const fn rgb(hex: u32) -> Color32 {
    Color32::from_rgb((hex >> 16) as u8, (hex >> 8) as u8, hex as u8)
}

/// All colours of a theme; the functions of the module above say what each is for.
pub(super) struct Palette {
    pub ground: Color32,
    pub panel: Color32,
    pub raised: Color32,
    pub sunk: Color32,
    pub line: Color32,
    pub text: Color32,
    pub muted: Color32,
    pub accent: Color32,
    pub fault: Color32,
    pub warn: Color32,
    pub live: Color32,
    /// Buttons: at rest, under the pointer, pressed.
    pub buttons: [Color32; 3],
    /// The edge of a button under the pointer.
    pub button_edge: Color32,
    /// Sources, stitching, stereo, tools, arm, filters, sinks, others.
    pub families: [Color32; 8],
    pub classes: [Color32; 8],
    /// Images, maps, clouds, geometry, detections, others.
    pub packets: [Color32; 6],
    /// Loads of 0 to 1.
    pub heat: [Color32; 4],
}

pub(super) static DARK: Palette = Palette {
    ground: rgb(0x12151A),
    panel: rgb(0x181C22),
    raised: rgb(0x20262E),
    sunk: rgb(0x0D1014),
    line: rgb(0x2E3640),
    text: rgb(0xDCE2EA),
    muted: rgb(0x8D98A7),
    accent: rgb(0x56B4E9),
    fault: rgb(0xEE7733),
    warn: rgb(0xE6C229),
    live: rgb(0x43C6A0),
    buttons: [rgb(0x29313B), rgb(0x333D49), rgb(0x3C4856)],
    button_edge: rgb(0x4A5766),
    families: [
        rgb(0x0E9757),
        rgb(0xF6A403),
        rgb(0x5993FB),
        rgb(0xBA4894),
        rgb(0xC487D6),
        rgb(0xE3DA69),
        rgb(0xA2A2A2),
        rgb(0xCBE1E6),
    ],
    classes: [
        rgb(0x56B4E9),
        rgb(0xEFA000),
        rgb(0x5AF8D1),
        rgb(0xBD71AB),
        rgb(0xFEE836),
        rgb(0xEE7733),
        rgb(0xA8A8A8),
        rgb(0x0578C7),
    ],
    packets: [rgb(0x6CC8F5), rgb(0x0F9A66), rgb(0xB0E58C), rgb(0xF0C4D0), rgb(0xE7A32F), rgb(0x7C8798)],
    heat: [rgb(0x20262E), rgb(0x413A2C), rgb(0x6B4A22), rgb(0x9A4A1C)],
};

pub(super) static LIGHT: Palette = Palette {
    ground: rgb(0xECEFF3),
    panel: rgb(0xF7F9FB),
    raised: rgb(0xFFFFFF),
    sunk: rgb(0xE9EDF2),
    line: rgb(0xC3CBD6),
    text: rgb(0x1A212A),
    muted: rgb(0x535E6C),
    accent: rgb(0x0A5F9E),
    fault: rgb(0xB23F00),
    warn: rgb(0x4A3000),
    live: rgb(0x05775A),
    buttons: [rgb(0xE1E6EC), rgb(0xD3DAE3), rgb(0xC5CED9)],
    button_edge: rgb(0xA5B0BE),
    families: [
        rgb(0x2FA26F),
        rgb(0xC68109),
        rgb(0x3B74E2),
        rgb(0xC674BE),
        rgb(0x894AA0),
        rgb(0x968D45),
        rgb(0x5E6255),
        rgb(0x2B6271),
    ],
    classes: [
        rgb(0x0E4F7B),
        rgb(0xC48511),
        rgb(0x27A27B),
        rgb(0xBF73AE),
        rgb(0x928A39),
        rgb(0xB74707),
        rgb(0x6D7579),
        rgb(0x0F6AB8),
    ],
    packets: [rgb(0x0090CA), rgb(0x047047), rgb(0x6E9D55), rgb(0xDA6D8A), rgb(0xAB740D), rgb(0x464F5E)],
    heat: [rgb(0xFFFFFF), rgb(0xFBE7CF), rgb(0xF5C89A), rgb(0xEDA768)],
};
