//! The bar above the canvas: state of the run, rates, buttons.

use eframe::egui::{Align, Button, Layout, RichText, Sense, Ui, WidgetInfo, WidgetType, vec2};

use crate::actions::{self, Action};
use panoscope_editor_model::disk::is_full;
use panoscope_editor_model::document::Document;
use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::session::{Phase, Status};
use panoscope_editor_widgets::format_time;
use panoscope_editor_widgets::theme;

/// Shows the bar; returns the actions that the user requests.
///
/// `on` says whether an action's panel or mode is on.
pub fn show(
    ui: &mut Ui,
    document: &Document,
    status: &Status,
    counters: &Counters,
    on: impl Fn(Action) -> bool,
) -> Vec<Action> {
    let mut actions = Vec::new();
    ui.horizontal_centered(|ui| {
        ui.spacing_mut().item_spacing.x = theme::STEP * 1.5;
        ui.label(RichText::new(&document.view().name).size(15.0).strong());
        if document.is_changed() {
            ui.label(RichText::new("changed").size(11.5).color(theme::accent()))
                .on_hover_text("There are unsaved changes");
        }
        ui.add_space(2.0 * theme::STEP);
        state(ui, document, status, counters);
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            let mut button = |ui: &mut Ui, action, caption: &str, selected: bool, enabled: bool| {
                let button = Button::new(caption).selected(selected).frame_when_inactive(selected);
                if ui.add_enabled(enabled, button).on_hover_text(actions::hint(action)).clicked() {
                    actions.push(action);
                }
            };
            button(ui, Action::Help, "Keys", false, true);
            button(ui, Action::Sweep, "Sweep", on(Action::Sweep), true);
            button(ui, Action::States, "Presets", on(Action::States), true);
            button(ui, Action::History, "History", on(Action::History), true);
            button(ui, Action::Plots, "Plots", on(Action::Plots), true);
            button(ui, Action::Text, "Text", on(Action::Text), true);
            button(ui, Action::Heat, "Heat", on(Action::Heat), true);
            let wrong = document.view().diagnostics.len() + usize::from(status.problem.is_some());
            let caption = if wrong == 0 { "Problems".to_owned() } else { format!("Problems {wrong}") };
            button(ui, Action::Problems, &caption, on(Action::Problems), true);
            if !document.args().is_empty() || !document.given().with.is_empty() {
                let caption = match document.missing_args().len() {
                    0 => "Arguments".to_owned(),
                    missing => format!("Arguments {missing}"),
                };
                button(ui, Action::Arguments, &caption, false, true);
            }
            ui.separator();
            button(ui, Action::Fit, "Fit", false, true);
            button(ui, Action::Find, "Find", false, true);
            button(ui, Action::Add, "Add", false, true);
            ui.separator();
            button(ui, Action::Save, "Save", false, document.is_changed());
            button(ui, Action::Redo, "Redo", false, document.redo_label().is_some());
            button(ui, Action::Undo, "Undo", false, document.undo_label().is_some());
            if matches!(status.phase, Phase::Ended | Phase::Failed(_)) {
                button(ui, Action::Restart, "Run again", true, true);
            }
        });
    });
    actions
}

fn state(ui: &mut Ui, document: &Document, status: &Status, counters: &Counters) {
    let behind = *status.running != **document.runnable();
    let off = counters.switched_off().map(|fault| match is_full(&fault.words) {
        true => format!("the disk is full: `{}` has stopped writing", fault.node),
        false => format!("`{}` is bypassed after a fault", fault.node),
    });
    let off = off.min();
    let (color, caption) = match &status.phase {
        Phase::Idle if document.view().valid => (theme::muted(), "not started".to_owned()),
        Phase::Idle if document.view().nodes.is_empty() && document.view().diagnostics.is_empty() => {
            (theme::muted(), "no nodes yet: press A to add one".to_owned())
        }
        Phase::Idle if document.lacks_only_arguments() => {
            (theme::warn(), format!("needs a value for {}", document.missing_args().join(", ")))
        }
        Phase::Idle => (theme::fault(), "the file has mistakes".to_owned()),
        Phase::Starting => (theme::muted(), "starting".to_owned()),
        Phase::Running if status.problem.is_some() => {
            (theme::fault(), "the change failed; the old graph keeps running".to_owned())
        }
        Phase::Running if behind && !document.view().valid => {
            (theme::warn(), "the file has mistakes; the last valid graph keeps running".to_owned())
        }
        Phase::Running | Phase::Ended if off.is_some() => (theme::fault(), off.unwrap_or_default()),
        Phase::Running => (theme::family("source"), "running".to_owned()),
        Phase::Ended => (theme::muted(), "the run has ended and its files are finished".to_owned()),
        Phase::Failed(why) => (theme::fault(), why.clone()),
    };
    let (rect, dot) = ui.allocate_exact_size(vec2(10.0, 10.0), Sense::hover());
    ui.painter().circle_filled(rect.center(), 4.0, color);
    dot.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, format!("State: {caption}")));
    ui.label(RichText::new(&caption).size(12.0).color(theme::muted()));
    if status.phase == Phase::Running {
        let fps = counters.nodes.values().map(|n| n.fps).fold(0.0, f64::max);
        let age = counters.nodes.values().filter_map(|n| n.age_p99_ms).fold(0.0, f64::max);
        let drops: u64 = counters.nodes.values().map(|n| n.dropped).sum();
        let mut caption = format!("{fps:.0} fps");
        if age > 0.0 {
            caption += &format!("  ·  age p99 {}", format_time(age));
        }
        if drops > 0 {
            caption += &format!("  ·  {drops} drop{}", if drops > 1 { "s" } else { "" });
        }
        ui.label(RichText::new(caption).size(12.0));
    }
}
