//! All actions of the editor and their keys. Buttons and keys trigger the same actions.

use eframe::egui::{InputState, Key, KeyboardShortcut, Modifiers};

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

/// Every action with its key and description, in the order of the help.
pub const ALL: &[(Action, Modifiers, Key, &str)] = {
    use Action::*;
    const NONE: Modifiers = Modifiers::NONE;
    const CTRL: Modifiers = Modifiers::COMMAND;
    const SHIFT: Modifiers = Modifiers::COMMAND.plus(Modifiers::SHIFT);
    const ALT: Modifiers = Modifiers::ALT;
    &[
        (Add, NONE, Key::A, "Add a node"),
        (Connect, NONE, Key::W, "Connect the selected node"),
        (Find, CTRL, Key::F, "Find a node"),
        (Delete, NONE, Key::Delete, "Delete the selection"),
        (Duplicate, CTRL, Key::D, "Duplicate the selection"),
        (Bypass, NONE, Key::B, "Bypass the selected nodes, or end the bypass"),
        (Undo, CTRL, Key::Z, "Undo"),
        (Redo, SHIFT, Key::Z, "Redo"),
        (Save, CTRL, Key::S, "Save the file"),
        (View, NONE, Key::V, "Show the output large"),
        (Compare, NONE, Key::C, "Compare it with the next output"),
        (Fit, NONE, Key::F, "Show the whole graph"),
        (ZoomIn, NONE, Key::Plus, "Zoom in"),
        (ZoomOut, NONE, Key::Minus, "Zoom out"),
        (SelectAll, CTRL, Key::A, "Select all nodes"),
        (Next, NONE, Key::N, "Select the next node"),
        (NextToo, Modifiers::SHIFT, Key::N, "Add the next node to the selection"),
        (Frame, NONE, Key::G, "Frame the selected nodes"),
        (Note, NONE, Key::O, "Add a note"),
        (Align, NONE, Key::L, "Align the selected nodes"),
        (OpenPart, NONE, Key::E, "Open the selected part, or fold it"),
        (MakePart, NONE, Key::K, "Make a part of the selected nodes"),
        (Dissolve, Modifiers::SHIFT, Key::K, "Dissolve the selected part into its nodes"),
        (Arguments, NONE, Key::I, "Arguments and overlays of the graph"),
        (Heat, NONE, Key::H, "Heat map: where time goes"),
        (Text, NONE, Key::T, "The file's text"),
        (Plots, NONE, Key::P, "Plots of times and values"),
        (History, NONE, Key::Y, "History of the parameters"),
        (Back, NONE, Key::OpenBracket, "One step back in the history"),
        (Forward, NONE, Key::CloseBracket, "One step forward in the history"),
        (Sweep, NONE, Key::S, "Sweep a parameter"),
        (States, NONE, Key::R, "Presets and snapshots"),
        (Snapshot, Modifiers::SHIFT, Key::R, "Take a snapshot of the graph"),
        (Problems, NONE, Key::M, "Mistakes and faults"),
        (Timeline, NONE, Key::J, "Timeline of a recording"),
        (Play, NONE, Key::Q, "Play the recording, or pause it"),
        (TickBack, NONE, Key::Comma, "One tick back in the recording"),
        (TickForward, NONE, Key::Period, "One tick forward in the recording"),
        (Trace, NONE, Key::D, "Paths of dropped and late ticks"),
        (NextProblem, NONE, Key::F8, "The next problem: its cause and what to do"),
        (PreviousProblem, Modifiers::SHIFT, Key::F8, "The previous problem"),
        (Plugins, NONE, Key::U, "Plugins and what they offer"),
        (Reload, CTRL, Key::R, "Swap rebuilt plugins in"),
        (Restart, SHIFT, Key::R, "Restart the graph"),
        (Theme, Modifiers::SHIFT, Key::T, "Dark or light"),
        (Commands, CTRL, Key::K, "Find a command, node or parameter"),
        (NodeHelp, Modifiers::SHIFT, Key::F1, "Help of the selected node"),
        (Source, NONE, Key::X, "Source of the selected node, if it is written in Python"),
        (NodePanel, Modifiers::SHIFT, Key::I, "Panel of the selected node"),
        (Overview, Modifiers::SHIFT, Key::O, "Panel of the whole graph"),
        (ViewerBeside, Modifiers::SHIFT, Key::V, "The viewer beside the graph, or over it"),
        (NextPanel, NONE, Key::F6, "The next panel gets the keys"),
        (PreviousPanel, Modifiers::SHIFT, Key::F6, "The previous panel gets the keys"),
        (PanelLeft, ALT, Key::ArrowLeft, "Move the panel to the left of the graph"),
        (PanelRight, ALT, Key::ArrowRight, "Move the panel to the right of the graph"),
        (PanelAbove, ALT, Key::ArrowUp, "Move the panel above the graph"),
        (PanelBelow, ALT, Key::ArrowDown, "Move the panel below the graph"),
        (PanelLarger, ALT, Key::Plus, "Make the panel larger"),
        (PanelSmaller, ALT, Key::Minus, "Make the panel smaller"),
        (TearOff, ALT, Key::Enter, "Put the panel into a window of its own, or back"),
        (ClosePanel, CTRL, Key::W, "Close the panel"),
        (ResetLayout, ALT, Key::Num0, "Reset the layout of the panels"),
        (Guide, CTRL, Key::F1, "Guided tour of one minute"),
        (Help, NONE, Key::F1, "These keys"),
        (Escape, NONE, Key::Escape, "Close what is open"),
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
    let description = ALL.iter().find(|(a, ..)| *a == action).map_or("", |(.., description)| description);
    format!("{description} ({})", key_name(action))
}
