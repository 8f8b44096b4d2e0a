//! All actions of the editor and their keys. Buttons and keys trigger the same actions.

use eframe::egui::{InputState, Key, KeyboardShortcut, Modifiers};
use panoscope_editor_texts as texts;

/// An action of the editor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Action {
    /// Open the palette to add a node.
    Add,
    /// Open the palette to connect the selected node.
    Connect,
    /// Open the palette to find a node.
    Find,
    /// Undo the last edit.
    Undo,
    /// Redo the last undone edit.
    Redo,
    /// Save the file.
    Save,
    /// Show the whole graph.
    Fit,
    /// Zoom in.
    ZoomIn,
    /// Zoom out.
    ZoomOut,
    /// Delete the selection.
    Delete,
    /// Copy the selected nodes beside themselves.
    Duplicate,
    /// Bypass the selected nodes, or end the bypass.
    Bypass,
    /// Select all nodes.
    SelectAll,
    /// Select the next node.
    Next,
    /// Add the next node to the selection.
    NextToo,
    /// Show the output under the pointer, or of the selected node, in the viewer.
    View,
    /// Compare the output in the viewer with another one.
    Compare,
    /// Add a titled frame around the selected nodes.
    Frame,
    /// Add a note.
    Note,
    /// Align the selected nodes.
    Align,
    /// Open the selected part, or fold it.
    OpenPart,
    /// Make a part of the selected nodes.
    MakePart,
    /// Put the nodes of the selected part in its place.
    Dissolve,
    /// Show the form for arguments and overlays.
    Arguments,
    /// Colour nodes by the time that they take.
    Heat,
    /// Show the file's text.
    Text,
    /// Show plots of times and values.
    Plots,
    /// Show the history of parameter changes.
    History,
    /// Step back in the history.
    Back,
    /// Step forward in the history.
    Forward,
    /// Sweep a parameter.
    Sweep,
    /// Show presets and snapshots.
    States,
    /// Take a snapshot of the graph.
    Snapshot,
    /// Show mistakes and faults.
    Problems,
    /// Show the timeline of a recording.
    Timeline,
    /// Play the recording, or pause it.
    Play,
    /// One tick back in the recording.
    TickBack,
    /// One tick forward in the recording.
    TickForward,
    /// Show the paths of dropped and late ticks.
    Trace,
    /// Show the next problem with its cause and remedy.
    NextProblem,
    /// Show the previous problem.
    PreviousProblem,
    /// Restart the graph.
    Restart,
    /// Show the plugins.
    Plugins,
    /// Swap rebuilt plugins in.
    Reload,
    /// Change between dark and light.
    Theme,
    /// Speak the next language.
    Language,
    /// Open the palette of commands.
    Commands,
    /// Start the guided tour.
    Guide,
    /// Show the help of the selected node.
    NodeHelp,
    /// Open the source of the selected node, if it is written in Python.
    Source,
    /// Show the panel of the selected node.
    NodePanel,
    /// Show the panel of the whole graph.
    Overview,
    /// Show the viewer beside the graph, or over it.
    ViewerBeside,
    /// Give the keys to the next panel.
    NextPanel,
    /// Give the keys to the previous panel.
    PreviousPanel,
    /// Move the panel to the left of the graph.
    PanelLeft,
    /// Move the panel to the right of the graph.
    PanelRight,
    /// Move the panel above the graph.
    PanelAbove,
    /// Move the panel below the graph.
    PanelBelow,
    /// Make the panel larger.
    PanelLarger,
    /// Make the panel smaller.
    PanelSmaller,
    /// Put the panel into a window of its own, or back.
    TearOff,
    /// Close the panel.
    ClosePanel,
    /// Arrange all panels as at first.
    ResetLayout,
    /// Show the keys.
    Help,
    /// Close what is open, or clear the selection.
    Escape,
}

/// The name of a text, which is known to be there.
const fn text(name: &'static str) -> &'static str {
    texts::assert_declared(name, &[]);
    name
}

/// Every action with its key and the name of the text that describes it, in the order of the help.
pub const ALL: &[(Action, Modifiers, Key, &str)] = {
    use Action::*;
    const NONE: Modifiers = Modifiers::NONE;
    const CTRL: Modifiers = Modifiers::COMMAND;
    const SHIFT: Modifiers = Modifiers::COMMAND.plus(Modifiers::SHIFT);
    const ALT: Modifiers = Modifiers::ALT;
    &[
        (Add, NONE, Key::A, text("action-add")),
        (Connect, NONE, Key::W, text("action-connect")),
        (Find, CTRL, Key::F, text("action-find")),
        (Delete, NONE, Key::Delete, text("action-delete")),
        (Duplicate, CTRL, Key::D, text("action-duplicate")),
        (Bypass, NONE, Key::B, text("action-bypass")),
        (Undo, CTRL, Key::Z, text("action-undo")),
        (Redo, SHIFT, Key::Z, text("action-redo")),
        (Save, CTRL, Key::S, text("action-save")),
        (View, NONE, Key::V, text("action-view")),
        (Compare, NONE, Key::C, text("action-compare")),
        (Fit, NONE, Key::F, text("action-fit")),
        (ZoomIn, NONE, Key::Plus, text("action-zoom-in")),
        (ZoomOut, NONE, Key::Minus, text("action-zoom-out")),
        (SelectAll, CTRL, Key::A, text("action-select-all")),
        (Next, NONE, Key::N, text("action-next")),
        (NextToo, Modifiers::SHIFT, Key::N, text("action-next-too")),
        (Frame, NONE, Key::G, text("action-frame")),
        (Note, NONE, Key::O, text("action-note")),
        (Align, NONE, Key::L, text("action-align")),
        (OpenPart, NONE, Key::E, text("action-open-part")),
        (MakePart, NONE, Key::K, text("action-make-part")),
        (Dissolve, Modifiers::SHIFT, Key::K, text("action-dissolve")),
        (Arguments, NONE, Key::I, text("action-arguments")),
        (Heat, NONE, Key::H, text("action-heat")),
        (Text, NONE, Key::T, text("action-text")),
        (Plots, NONE, Key::P, text("action-plots")),
        (History, NONE, Key::Y, text("action-history")),
        (Back, NONE, Key::OpenBracket, text("action-back")),
        (Forward, NONE, Key::CloseBracket, text("action-forward")),
        (Sweep, NONE, Key::S, text("action-sweep")),
        (States, NONE, Key::R, text("action-states")),
        (Snapshot, Modifiers::SHIFT, Key::R, text("action-snapshot")),
        (Problems, NONE, Key::M, text("action-problems")),
        (Timeline, NONE, Key::J, text("action-timeline")),
        (Play, NONE, Key::Q, text("action-play")),
        (TickBack, NONE, Key::Comma, text("action-tick-back")),
        (TickForward, NONE, Key::Period, text("action-tick-forward")),
        (Trace, NONE, Key::D, text("action-trace")),
        (NextProblem, NONE, Key::F8, text("action-next-problem")),
        (PreviousProblem, Modifiers::SHIFT, Key::F8, text("action-previous-problem")),
        (Plugins, NONE, Key::U, text("action-plugins")),
        (Reload, CTRL, Key::R, text("action-reload")),
        (Restart, SHIFT, Key::R, text("action-restart")),
        (Theme, Modifiers::SHIFT, Key::T, text("action-theme")),
        (Language, Modifiers::SHIFT, Key::L, text("action-language")),
        (Commands, CTRL, Key::K, text("action-commands")),
        (NodeHelp, Modifiers::SHIFT, Key::F1, text("action-node-help")),
        (Source, NONE, Key::X, text("action-source")),
        (NodePanel, Modifiers::SHIFT, Key::I, text("action-node-panel")),
        (Overview, Modifiers::SHIFT, Key::O, text("action-overview")),
        (ViewerBeside, Modifiers::SHIFT, Key::V, text("action-viewer-beside")),
        (NextPanel, NONE, Key::F6, text("action-next-panel")),
        (PreviousPanel, Modifiers::SHIFT, Key::F6, text("action-previous-panel")),
        (PanelLeft, ALT, Key::ArrowLeft, text("action-panel-left")),
        (PanelRight, ALT, Key::ArrowRight, text("action-panel-right")),
        (PanelAbove, ALT, Key::ArrowUp, text("action-panel-above")),
        (PanelBelow, ALT, Key::ArrowDown, text("action-panel-below")),
        (PanelLarger, ALT, Key::Plus, text("action-panel-larger")),
        (PanelSmaller, ALT, Key::Minus, text("action-panel-smaller")),
        (TearOff, ALT, Key::Enter, text("action-tear-off")),
        (ClosePanel, CTRL, Key::W, text("action-close-panel")),
        (ResetLayout, ALT, Key::Num0, text("action-reset-layout")),
        (Guide, CTRL, Key::F1, text("action-guide")),
        (Help, NONE, Key::F1, text("action-help")),
        (Escape, NONE, Key::Escape, text("action-escape")),
    ]
};

/// Actions whose keys work while picking on an image; the picker gets the other keys.
const PICKING: [Action; 5] = [Action::Undo, Action::Redo, Action::Save, Action::Help, Action::Escape];

/// Number of modifiers.
fn count(modifiers: Modifiers) -> u8 {
    u8::from(modifiers.command) + u8::from(modifiers.shift) + u8::from(modifiers.alt)
}

/// As [`pressed`], while picking on an image.
pub fn pressed_while_picking(input: &mut InputState) -> Vec<Action> {
    let mut all: Vec<_> = ALL.iter().filter(|(action, ..)| PICKING.contains(action)).collect();
    all.sort_by_key(|(_, modifiers, ..)| std::cmp::Reverse(count(*modifiers)));
    all.retain(|(_, modifiers, key, _)| input.consume_key(*modifiers, *key));
    all.into_iter().map(|(action, ..)| *action).collect()
}

/// Consumes the keys of actions and returns the actions. While a text is edited, only Escape, F6 and keys with Ctrl count.
pub fn pressed(input: &mut InputState, typing: bool) -> Vec<Action> {
    let mut found = Vec::new();
    // Keys with more modifiers first, so that Ctrl+Shift+Z does not count as Ctrl+Z.
    let mut all: Vec<_> = ALL.iter().collect();
    all.sort_by_key(|(_, modifiers, ..)| std::cmp::Reverse(count(*modifiers)));
    for (action, modifiers, key, _) in all {
        let own_use = matches!(action, Action::SelectAll | Action::Undo | Action::Redo) || !modifiers.command;
        let leaves = matches!(action, Action::Escape | Action::NextPanel | Action::PreviousPanel);
        if typing && own_use && !leaves {
            continue;
        }
        if input.consume_key(*modifiers, *key) {
            found.push(*action);
        }
    }
    if !typing && input.consume_key(Modifiers::NONE, Key::Backspace) {
        found.push(Action::Delete);
    }
    found
}

/// The name of an action's key.
pub fn key_name(action: Action) -> String {
    let found = ALL.iter().find(|(a, ..)| *a == action);
    found.map_or_else(String::new, |(_, modifiers, key, _)| {
        let name = KeyboardShortcut::new(*modifiers, *key).format(&eframe::egui::ModifierNames::NAMES, false);
        // Shown as printed on the key.
        let sign = match key {
            Key::Plus => "+",
            Key::Minus => "-",
            Key::Comma => ",",
            Key::Period => ".",
            Key::OpenBracket => "[",
            Key::CloseBracket => "]",
            _ => return name,
        };
        name.replace(key.name(), sign)
    })
}

/// The description of an action with its key, for tooltips.
pub fn hint(action: Action) -> String {
    let description = ALL.iter().find(|(a, ..)| *a == action).map_or("", |(.., name)| texts::plain(name));
    format!("{description} ({})", key_name(action))
}
