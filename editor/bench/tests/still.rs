//! Runs of one image, which are over before the window has drawn anything.

use crate::common::{Folder, PATIENCE, Window, has_plugin};
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::Options;
use panoscope_editor_model::output::Output;
use panoscope_editor_model::session::Phase;
use std::time::Instant;

const NONE: Modifiers = Modifiers::NONE;
const WIDTH_PX: usize = 960;

/// A pair of views, both read, and a chain behind one of them whose last output nobody reads.
fn graph() -> String {
    format!(
        "name = \"still\"\nmode = \"batch\"\nplugins = [\"flow\", \"phantom\"]\n\
         [nodes.scope]\ntype = \"phantom\"\nparams = {{ width = {WIDTH_PX}, height = 540 }}\n\
         [nodes.mean]\ntype = \"smooth\"\ninputs = {{ image = \"scope.left\" }}\n\
         [nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"scope.right\" }}\n"
    )
}

#[test]
fn pictures_of_a_run_that_is_over_at_once_are_shown_and_shown_anew() {
    if !has_plugin("flow") || !has_plugin("phantom") {
        return;
    }
    let folder = Folder::new("still");
    let options = Options { frames: Some(1), ..Options::default() };
    let mut window = Window::open_with(&folder.write("still.toml", &graph()), options);
    window.until("it has ended", |app| app.session().status().phase == Phase::Ended);
    let [left, right, mean] =
        [("scope", "left"), ("scope", "right"), ("mean", "image")].map(|(n, p)| Output::new(n, p));
    for output in [&left, &mean] {
        window.until(&format!("{output:?} is shown"), |app| app.picture(output).is_some_and(|p| p.width < WIDTH_PX));
    }
    // Larger than before.
    window.select("mean");
    window.key(NONE, Key::V);
    window.until("mean is shown large", |app| app.picture(&mean).is_some_and(|p| p.width == WIDTH_PX));
    // One that had no picture before, and numbers of two.
    let until = Instant::now() + PATIENCE;
    while window.app().compared_with() != Some(&right) {
        assert!(Instant::now() < until, "it is never compared with the right view");
        window.key(NONE, Key::C);
    }
    window.until("the right view is shown", |app| app.picture(&right).is_some_and(|p| p.width == WIDTH_PX));
    window.until_shown("PSNR ");
    // Run again, it shows them once more.
    let generation = window.app().session().status().generation;
    window.key(NONE, Key::V);
    window.harness.get_by_label("Run again").click_accesskit();
    window.until("it has run again", |app| {
        let status = app.session().status();
        status.generation > generation && status.phase == Phase::Ended
    });
}
