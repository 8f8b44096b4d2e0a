//! Keys with the same meaning in both windows.

use eframe::egui::Key;

/// The arrow keys and their directions; right and down are positive.
pub const ARROWS: [(Key, [f32; 2]); 4] = [
    (Key::ArrowLeft, [-1.0, 0.0]),
    (Key::ArrowRight, [1.0, 0.0]),
    (Key::ArrowUp, [0.0, -1.0]),
    (Key::ArrowDown, [0.0, 1.0]),
];
