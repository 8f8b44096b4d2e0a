//! The bar above the canvas: state of the run, rates, buttons.

use std::path::Path;

use eframe::egui::{
    Align, Button, Layout, RichText, Sense, TextStyle, TextWrapMode, Ui, UiBuilder, WidgetInfo, WidgetType, vec2,
};

use crate::actions::{self, Action};
use panoscope_editor_model::disk::is_full;
use panoscope_editor_model::document::Document;
use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::playing::Playing;
use panoscope_editor_model::session::{Phase, Status};
use panoscope_editor_model::texts::{decimal, text};
use panoscope_editor_widgets::format_time;
use panoscope_editor_widgets::theme;

/// Space for the graph's name and the state of the run, points.
const STATE: f32 = 260.0;

/// A button of the bar.
struct Item {
    action: Action,
    caption: String,
    selected: bool,
    enabled: bool,
}

/// Which groups of buttons are menus, because the window is narrow.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
enum Folded {
    None,
    Look,
    RunAndLook,
}

/// Shows the bar; returns the actions that the user requests.
///
/// `recorded` is the recording that is shown in place of the running graph, `playing` how it or files are played; `on` says whether an action's panel or mode is on.
pub fn show(
    ui: &mut Ui,
    document: &Document,
    (status, counters, recorded): (&Status, &Counters, Option<&Path>),
    playing: Option<Playing>,
    on: impl Fn(Action) -> bool,
) -> Vec<Action> {
    let mut actions = Vec::new();
    let item =
        |action, caption: &str, enabled| Item { action, caption: caption.to_owned(), selected: on(action), enabled };
    let edit = [
        item(Action::Undo, text!("top-undo"), document.undo_label().is_some()),
        item(Action::Redo, text!("top-redo"), document.redo_label().is_some()),
        item(Action::Save, text!("top-save"), document.is_changed()),
        item(Action::Add, text!("top-add"), true),
        item(Action::Find, text!("top-find"), true),
    ];
    let look = [
        item(Action::Fit, text!("top-fit"), true),
        item(Action::Heat, text!("top-heat"), true),
        item(Action::Text, text!("top-text"), true),
        item(Action::Plots, text!("top-plots"), true),
        item(Action::History, text!("top-history"), true),
        item(Action::States, text!("top-presets"), true),
        item(Action::Help, text!("top-keys"), true),
    ];
    let mut run = play_items(playing);
    run.extend(run_items(document, status, item));
    ui.horizontal_centered(|ui| {
        ui.spacing_mut().item_spacing.x = theme::STEP * 1.5;
        let bar = ui.available_rect_before_wrap();
        let widths =
            [&edit[..], &run, &look].map(|group| group.iter().map(|item| width(ui, &item.caption)).sum::<f32>());
        let room = bar.width() - STATE;
        let menu = 64.0;
        let folded = match widths {
            [edit, run, look] if edit + run + look <= room => Folded::None,
            [edit, run, _] if edit + run + menu <= room => Folded::Look,
            _ => Folded::RunAndLook,
        };
        let buttons = ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            let mut group = |ui: &mut Ui, items: &[Item], menu: Option<&str>| match menu {
                None => actions.extend(items.iter().rev().filter(|item| button(ui, item)).map(|item| item.action)),
                Some(name) => {
                    let menu = ui.menu_button(name, |ui| {
                        let pressed = items.iter().filter(|item| button(ui, item)).map(|item| item.action);
                        let pressed: Vec<Action> = pressed.collect();
                        if !pressed.is_empty() {
                            actions.extend(pressed);
                            ui.close();
                        }
                    });
                    menu.response.on_hover_text(text!("top-menu"));
                }
            };
            group(ui, &look, (folded >= Folded::Look).then(|| text!("top-look")));
            ui.separator();
            group(ui, &run, (folded == Folded::RunAndLook).then(|| text!("top-run")));
            ui.separator();
            group(ui, &edit, None);
        });
        // The buttons keep their places; the words before them are cut where they end.
        let left =
            bar.with_max_x((buttons.response.rect.left().min(ui.min_rect().right()) - theme::STEP).max(bar.left()));
        ui.scope_builder(UiBuilder::new().max_rect(left).layout(Layout::left_to_right(Align::Center)), |ui| {
            ui.set_clip_rect(left.intersect(ui.clip_rect()));
            ui.style_mut().wrap_mode = Some(TextWrapMode::Truncate);
            words(ui, RichText::new(&document.view().name).size(15.0).strong());
            if document.is_changed() && has_room(ui) {
                ui.label(RichText::new(text!("top-changed")).size(11.5).color(theme::accent()))
                    .on_hover_text(text!("top-changed.hint"));
            }
            ui.add_space(theme::STEP);
            state(ui, document, (status, counters, recorded));
        });
    });
    actions
}

/// The buttons of what is played: pause, step, loop, speed.
fn play_items(playing: Option<Playing>) -> Vec<Item> {
    let Some(Playing { plays, loops, speed }) = playing else { return Vec::new() };
    let item = |action, caption: &str, selected| Item { action, caption: caption.to_owned(), selected, enabled: true };
    let places = if speed.fract() == 0.0 { 0 } else { 2 };
    vec![
        item(Action::Play, if plays { text!("top-play.pause") } else { text!("top-play") }, !plays),
        item(Action::TickForward, text!("top-step"), false),
        item(Action::Loop, text!("top-loop"), loops),
        item(Action::Speed, &text!("top-speed", speed = decimal(speed, places)), speed != 1.0),
    ]
}

/// The buttons about the run.
fn run_items(document: &Document, status: &Status, item: impl Fn(Action, &str, bool) -> Item) -> Vec<Item> {
    let mut run = Vec::new();
    if matches!(status.phase, Phase::Ended | Phase::Failed(_)) {
        run.push(Item { selected: true, ..item(Action::Restart, text!("top-again"), true) });
    }
    let (records, may) = (status.recording.is_some(), document.view().valid);
    let caption = if records { text!("top-record.stop") } else { text!("top-record") };
    run.push(Item { selected: records, ..item(Action::Record, caption, may || records) });
    if !document.args().is_empty() || !document.given().with.is_empty() {
        let caption = match document.missing_args().len() {
            0 => text!("top-arguments").to_owned(),
            missing => text!("top-arguments.count", count = missing),
        };
        run.push(Item { selected: false, ..item(Action::Arguments, &caption, true) });
    }
    let wrong = document.view().diagnostics.len() + usize::from(status.problem.is_some());
    let caption = match wrong {
        0 => text!("top-problems").to_owned(),
        wrong => text!("top-problems.count", count = wrong),
    };
    run.push(item(Action::Problems, &caption, true));
    run.push(item(Action::Sweep, text!("top-sweep"), true));
    run
}

/// Shows a button; returns whether it was clicked.
fn button(ui: &mut Ui, item: &Item) -> bool {
    let button = Button::new(&item.caption).selected(item.selected).frame_when_inactive(item.selected);
    ui.add_enabled(item.enabled, button).on_hover_text(actions::hint(item.action)).clicked()
}

/// Whether there is space for a word.
fn has_room(ui: &Ui) -> bool {
    ui.available_width() > 32.0
}

/// Shows words, cut where there is no space, and none where there is nearly none.
fn words(ui: &mut Ui, words: RichText) {
    if has_room(ui) {
        ui.label(words);
    }
}

/// Width of a button with its distance to the next one, points.
fn width(ui: &Ui, caption: &str) -> f32 {
    let font = TextStyle::Button.resolve(ui.style());
    let words = ui.painter().layout_no_wrap(caption.to_owned(), font, theme::text());
    words.size().x + 2.0 * ui.spacing().button_padding.x + ui.spacing().item_spacing.x
}

fn state(ui: &mut Ui, document: &Document, (status, counters, recorded): (&Status, &Counters, Option<&Path>)) {
    let behind = *status.running != **document.runnable();
    let off = counters.switched_off().map(|fault| match is_full(&fault.words) {
        true => text!("state-disk-full", node = &fault.node),
        false => text!("state-bypassed", node = &fault.node),
    });
    let off = off.min();
    let unfinished = || text!("state-unfinished", count = document.view().open_inputs());
    let (color, caption) = match &status.phase {
        _ if recorded.is_some() => {
            let file = recorded.and_then(Path::file_name).unwrap_or_default().to_string_lossy().into_owned();
            (theme::warn(), text!("state-recorded", file = file))
        }
        Phase::Idle if document.view().valid => (theme::muted(), text!("state-not-started").to_owned()),
        Phase::Idle if document.view().nodes.is_empty() && document.view().diagnostics.is_empty() => {
            (theme::muted(), text!("state-no-nodes").to_owned())
        }
        Phase::Idle if document.lacks_only_arguments() => {
            (theme::warn(), text!("state-lacks", arguments = document.missing_args().join(", ")))
        }
        Phase::Idle if document.view().is_unfinished() => (theme::muted(), unfinished()),
        Phase::Idle => (theme::fault(), text!("state-mistakes").to_owned()),
        Phase::Starting => (theme::muted(), text!("state-is-starting").to_owned()),
        Phase::Running if status.problem.is_some() => (theme::fault(), text!("state-change-failed").to_owned()),
        Phase::Running if behind && document.view().is_unfinished() => {
            (theme::muted(), text!("state-unfinished-runs", count = document.view().open_inputs()))
        }
        Phase::Running if behind && !document.view().valid => (theme::warn(), text!("state-last-valid").to_owned()),
        Phase::Running | Phase::Ended if off.is_some() => (theme::fault(), off.unwrap_or_default()),
        Phase::Running if status.recording.is_some() => {
            let file = status.recording.as_deref().and_then(Path::file_name).unwrap_or_default();
            (theme::fault(), text!("record-runs", file = file.to_string_lossy()))
        }
        Phase::Running => (theme::family("source"), text!("state-running").to_owned()),
        Phase::Ended => (theme::muted(), text!("state-ended").to_owned()),
        Phase::Failed(why) => (theme::fault(), why.clone()),
    };
    if ui.available_width() < 12.0 {
        return;
    }
    let (rect, dot) = ui.allocate_exact_size(vec2(10.0, 10.0), Sense::hover());
    ui.painter().circle_filled(rect.center(), 4.0, color);
    dot.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, text!("state-name", state = &caption)));
    words(ui, RichText::new(&caption).size(12.0).color(theme::muted()));
    if let (Phase::Ended | Phase::Failed(_), Some(over), None) = (&status.phase, counters.over, recorded) {
        let count = usize::try_from(over.frames).unwrap_or(usize::MAX);
        let rate = decimal(over.frames as f64 / over.seconds.max(1e-3), 1);
        let caption = text!("state-over", count = count, seconds = decimal(over.seconds, 1), rate = rate);
        words(ui, RichText::new(caption).size(12.0));
    }
    if status.phase == Phase::Running && recorded.is_none() {
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
        words(ui, RichText::new(caption).size(12.0));
    }
}
