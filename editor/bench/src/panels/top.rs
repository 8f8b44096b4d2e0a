//! The bar above the canvas: state of the run, rates, buttons.

use eframe::egui::{Align, Button, Layout, RichText, Sense, Ui, WidgetInfo, WidgetType, vec2};

use crate::actions::{self, Action};
use panoscope_editor_model::disk::is_full;
use panoscope_editor_model::document::Document;
use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::session::{Phase, Status};
use panoscope_editor_texts::{decimal, text};
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
            ui.label(RichText::new(text!("top-changed")).size(11.5).color(theme::accent()))
                .on_hover_text(text!("top-changed.hint"));
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
            button(ui, Action::Help, text!("top-keys"), false, true);
            button(ui, Action::Sweep, text!("top-sweep"), on(Action::Sweep), true);
            button(ui, Action::States, text!("top-presets"), on(Action::States), true);
            button(ui, Action::History, text!("top-history"), on(Action::History), true);
            button(ui, Action::Plots, text!("top-plots"), on(Action::Plots), true);
            button(ui, Action::Text, text!("top-text"), on(Action::Text), true);
            button(ui, Action::Heat, text!("top-heat"), on(Action::Heat), true);
            let wrong = document.view().diagnostics.len() + usize::from(status.problem.is_some());
            let caption = match wrong {
                0 => text!("top-problems").to_owned(),
                wrong => text!("top-problems.count", count = wrong),
            };
            button(ui, Action::Problems, &caption, on(Action::Problems), true);
            if !document.args().is_empty() || !document.given().with.is_empty() {
                let caption = match document.missing_args().len() {
                    0 => text!("top-arguments").to_owned(),
                    missing => text!("top-arguments.count", count = missing),
                };
                button(ui, Action::Arguments, &caption, false, true);
            }
            ui.separator();
            button(ui, Action::Fit, text!("top-fit"), false, true);
            button(ui, Action::Find, text!("top-find"), false, true);
            button(ui, Action::Add, text!("top-add"), false, true);
            ui.separator();
            button(ui, Action::Save, text!("top-save"), false, document.is_changed());
            button(ui, Action::Redo, text!("top-redo"), false, document.redo_label().is_some());
            button(ui, Action::Undo, text!("top-undo"), false, document.undo_label().is_some());
            if matches!(status.phase, Phase::Ended | Phase::Failed(_)) {
                button(ui, Action::Restart, text!("top-again"), true, true);
            }
        });
    });
    actions
}

fn state(ui: &mut Ui, document: &Document, status: &Status, counters: &Counters) {
    let behind = *status.running != **document.runnable();
    let off = counters.switched_off().map(|fault| match is_full(&fault.words) {
        true => text!("state-disk-full", node = &fault.node),
        false => text!("state-bypassed", node = &fault.node),
    });
    let off = off.min();
    let (color, caption) = match &status.phase {
        Phase::Idle if document.view().valid => (theme::muted(), text!("state-not-started").to_owned()),
        Phase::Idle if document.view().nodes.is_empty() && document.view().diagnostics.is_empty() => {
            (theme::muted(), text!("state-no-nodes").to_owned())
        }
        Phase::Idle if document.lacks_only_arguments() => {
            (theme::warn(), text!("state-lacks", arguments = document.missing_args().join(", ")))
        }
        Phase::Idle => (theme::fault(), text!("state-mistakes").to_owned()),
        Phase::Starting => (theme::muted(), text!("state-is-starting").to_owned()),
        Phase::Running if status.problem.is_some() => (theme::fault(), text!("state-change-failed").to_owned()),
        Phase::Running if behind && !document.view().valid => (theme::warn(), text!("state-last-valid").to_owned()),
        Phase::Running | Phase::Ended if off.is_some() => (theme::fault(), off.unwrap_or_default()),
        Phase::Running => (theme::family("source"), text!("state-running").to_owned()),
        Phase::Ended => (theme::muted(), text!("state-ended").to_owned()),
        Phase::Failed(why) => (theme::fault(), why.clone()),
    };
    let (rect, dot) = ui.allocate_exact_size(vec2(10.0, 10.0), Sense::hover());
    ui.painter().circle_filled(rect.center(), 4.0, color);
    dot.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, text!("state-name", state = &caption)));
    ui.label(RichText::new(&caption).size(12.0).color(theme::muted()));
    if status.phase == Phase::Running {
        let fps = counters.nodes.values().map(|n| n.fps).fold(0.0, f64::max);
        let age = counters.nodes.values().filter_map(|n| n.age_p99_ms).fold(0.0, f64::max);
        let drops: u64 = counters.nodes.values().map(|n| n.dropped).sum();
        let mut caption = text!("state-rate", rate = decimal(fps, 0));
        if age > 0.0 {
            caption += &format!("  ·  {}", text!("state-age", age = format_time(age)));
        }
        if drops > 0 {
            caption += &format!("  ·  {}", text!("state-drops", count = drops));
        }
        ui.label(RichText::new(caption).size(12.0));
    }
}
