//! Compares a screenshot of the theatre with a golden image.

use std::time::{Duration, Instant};

use crate::common::window::{Window, options};
use crate::common::{Folder, has_plugin};
use crate::looks_graph::{GRAPH, TICKS};
use eframe::egui::{Rect, pos2};
use egui_kittest::kittest::Queryable;
use panoscope_editor_widgets::golden::{compare, paint};
use panoscope_editor_widgets::theme::BLACK;
use panoscope_theatre as theatre;

#[test]
fn the_theatre_matches_the_golden_image() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("theatre_looks");
    let path = folder.write("looks.toml", GRAPH);
    let options = theatre::Options { frames: Some(TICKS), ..options(&folder) };
    let mut window = Window::open_with(folder, &path, options);
    window
        .until("it has ended", |t| t.notices().iter().any(|n| n.message == "The source has ended") && t.has_picture());
    let ended = Instant::now();
    window.until("all is at rest, and old", |_| ended.elapsed() > Duration::from_millis(1500));
    // The ages above the images grow, so they are masked.
    let views =
        ["(in place of Calm view)", "View Gray"].map(|label| window.harness.get_by_label_contains(label).rect());
    let ages = views.map(|v| Rect::from_min_max(pos2(v.right() - 180.0, v.top()), pos2(v.right(), v.top() + 32.0)));
    let picture = paint(&window.harness.ctx, window.harness.output(), &window.textures, BLACK);
    compare("theatre", picture, &ages);
}
