//! All actions of the editor and their keys. Buttons and keys trigger the same actions.

use eframe::egui::{InputState, Key, KeyboardShortcut, ModifierNames, Modifiers};
use panoscope_editor_model::texts::{self, text};

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
    /// Arrange the selected nodes along the flow, or all nodes.
    Arrange,
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
    /// Take faults that are mended out of the picture.
    Acknowledge,
    /// Show the timeline of a recording.
    Timeline,
    /// Record the run from its start, or end the recording and show it.
    Record,
    /// Play the recording or the files, or pause them.
    Play,
    /// Begin again at the end, or not.
    Loop,
    /// The next speed of the recording or the files.
    Speed,
    /// One tick back in the recording.
    TickBack,
    /// One tick forward in the recording or the files.
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
const fn named(name: &'static str) -> &'static str {
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
        (Add, NONE, Key::A, named("action-add")),
        (Connect, NONE, Key::W, named("action-connect")),
        (Find, CTRL, Key::F, named("action-find")),
        (Delete, NONE, Key::Delete, named("action-delete")),
        (Duplicate, CTRL, Key::D, named("action-duplicate")),
        (Bypass, NONE, Key::B, named("action-bypass")),
        (Undo, CTRL, Key::Z, named("action-undo")),
        (Redo, SHIFT, Key::Z, named("action-redo")),
        (Save, CTRL, Key::S, named("action-save")),
        (View, NONE, Key::V, named("action-view")),
        (Compare, NONE, Key::C, named("action-compare")),
        (Fit, NONE, Key::F, named("action-fit")),
        (ZoomIn, NONE, Key::Plus, named("action-zoom-in")),
        (ZoomOut, NONE, Key::Minus, named("action-zoom-out")),
        (SelectAll, CTRL, Key::A, named("action-select-all")),
        (Next, NONE, Key::N, named("action-next")),
        (NextToo, Modifiers::SHIFT, Key::N, named("action-next-too")),
        (Frame, NONE, Key::G, named("action-frame")),
        (Note, NONE, Key::O, named("action-note")),
        (Align, NONE, Key::L, named("action-align")),
        (Arrange, Modifiers::SHIFT, Key::A, named("action-arrange")),
        (OpenPart, NONE, Key::E, named("action-open-part")),
        (MakePart, NONE, Key::K, named("action-make-part")),
        (Dissolve, Modifiers::SHIFT, Key::K, named("action-dissolve")),
        (Arguments, NONE, Key::I, named("action-arguments")),
        (Heat, NONE, Key::H, named("action-heat")),
        (Text, NONE, Key::T, named("action-text")),
        (Plots, NONE, Key::P, named("action-plots")),
        (History, NONE, Key::Y, named("action-history")),
        (Back, NONE, Key::OpenBracket, named("action-back")),
        (Forward, NONE, Key::CloseBracket, named("action-forward")),
        (Sweep, NONE, Key::S, named("action-sweep")),
        (States, NONE, Key::R, named("action-states")),
        (Snapshot, Modifiers::SHIFT, Key::R, named("action-snapshot")),
        (Problems, NONE, Key::M, named("action-problems")),
        (Acknowledge, Modifiers::SHIFT, Key::M, named("action-acknowledge")),
        (Timeline, NONE, Key::J, named("action-timeline")),
        (Record, Modifiers::SHIFT, Key::J, named("action-record")),
        (Play, NONE, Key::Q, named("action-play")),
        (Loop, Modifiers::SHIFT, Key::Q, named("action-loop")),
        (Speed, NONE, Key::Z, named("action-speed")),
        (TickBack, NONE, Key::Comma, named("action-tick-back")),
        (TickForward, NONE, Key::Period, named("action-tick-forward")),
        (Trace, NONE, Key::D, named("action-trace")),
        (NextProblem, NONE, Key::F8, named("action-next-problem")),
        (PreviousProblem, Modifiers::SHIFT, Key::F8, named("action-previous-problem")),
        (Plugins, NONE, Key::U, named("action-plugins")),
        (Reload, CTRL, Key::R, named("action-reload")),
        (Restart, SHIFT, Key::R, named("action-restart")),
        (Theme, Modifiers::SHIFT, Key::T, named("action-theme")),
        (Language, Modifiers::SHIFT, Key::L, named("action-language")),
        (Commands, CTRL, Key::K, named("action-commands")),
        (NodeHelp, Modifiers::SHIFT, Key::F1, named("action-node-help")),
        (Source, NONE, Key::X, named("action-source")),
        (NodePanel, Modifiers::SHIFT, Key::I, named("action-node-panel")),
        (Overview, Modifiers::SHIFT, Key::O, named("action-overview")),
        (ViewerBeside, Modifiers::SHIFT, Key::V, named("action-viewer-beside")),
        (NextPanel, NONE, Key::F6, named("action-next-panel")),
        (PreviousPanel, Modifiers::SHIFT, Key::F6, named("action-previous-panel")),
        (PanelLeft, ALT, Key::ArrowLeft, named("action-panel-left")),
        (PanelRight, ALT, Key::ArrowRight, named("action-panel-right")),
        (PanelAbove, ALT, Key::ArrowUp, named("action-panel-above")),
        (PanelBelow, ALT, Key::ArrowDown, named("action-panel-below")),
        (PanelLarger, ALT, Key::Plus, named("action-panel-larger")),
        (PanelSmaller, ALT, Key::Minus, named("action-panel-smaller")),
        (TearOff, ALT, Key::Enter, named("action-tear-off")),
        (ClosePanel, CTRL, Key::W, named("action-close-panel")),
        (ResetLayout, ALT, Key::Num0, named("action-reset-layout")),
        (Guide, CTRL, Key::F1, named("action-guide")),
        (Help, NONE, Key::F1, named("action-help")),
        (Escape, NONE, Key::Escape, named("action-escape")),
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
    let names = ModifierNames { ctrl: text!("key-ctrl"), shift: text!("key-shift"), ..ModifierNames::NAMES };
    found.map_or_else(String::new, |(_, modifiers, key, _)| {
        let name = KeyboardShortcut::new(*modifiers, *key).format(&names, false);
        // Shown as printed on the key.
        let sign = match key {
            Key::Plus => "+",
            Key::Minus => "-",
            Key::Comma => ",",
            Key::Period => ".",
            Key::OpenBracket => "[",
            Key::CloseBracket => "]",
            Key::Delete => text!("key-delete"),
            Key::Enter => text!("key-enter"),
            Key::Escape => text!("key-escape"),
            Key::ArrowLeft => text!("key-left"),
            Key::ArrowRight => text!("key-right"),
            Key::ArrowUp => text!("key-up"),
            Key::ArrowDown => text!("key-down"),
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
