//! Everything that can be done, with its key. Buttons and keys ask for the same actions.

use eframe::egui::{InputState, Key, KeyboardShortcut, Modifiers};

/// What can be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Action {
    /// Add a node by typing.
    Add,
    /// Connect the selected node by typing.
    Connect,
    /// Find a node by typing.
    Find,
    /// Take the last edit back.
    Undo,
    /// Do it again.
    Redo,
    /// Save the file.
    Save,
    /// Show the whole graph.
    Fit,
    /// Zoom in.
    ZoomIn,
    /// Zoom out.
    ZoomOut,
    /// Remove what is selected.
    Delete,
    /// Copy the selected nodes beside themselves.
    Duplicate,
    /// Lead the readers of the selected nodes around them.
    Bypass,
    /// Select all nodes.
    SelectAll,
    /// Select the next node.
    Next,
    /// Select the next node, too.
    NextToo,
    /// Show the output under the pointer, or of the selected node, large.
    View,
    /// Compare what is shown large with another output.
    Compare,
    /// Put a titled frame around the selected nodes.
    Frame,
    /// Add a note.
    Note,
    /// Put the selected nodes in line.
    Align,
    /// Colour nodes by where time goes.
    Heat,
    /// Show the file's text.
    Text,
    /// Show curves of times.
    Plots,
    /// Show what became of the parameters.
    History,
    /// Step back to the value before.
    Back,
    /// Step forward again.
    Forward,
    /// Sweep a parameter.
    Sweep,
    /// Show mistakes and faults.
    Problems,
    /// Start the graph anew.
    Restart,
    /// Show the plugins.
    Plugins,
    /// Swap rebuilt plugins in.
    Reload,
    /// Show the keys.
    Help,
    /// Leave what is open.
    Escape,
}

/// Every action with its key and its words, in the order of the help.
pub const ALL: &[(Action, Modifiers, Key, &str)] = {
    use Action::*;
    const NONE: Modifiers = Modifiers::NONE;
    const CTRL: Modifiers = Modifiers::COMMAND;
    const SHIFT: Modifiers = Modifiers::COMMAND.plus(Modifiers::SHIFT);
    &[
        (Add, NONE, Key::A, "Add a node"),
        (Connect, NONE, Key::W, "Connect the selected node"),
        (Find, CTRL, Key::F, "Find a node"),
        (Delete, NONE, Key::Delete, "Delete the selection"),
        (Duplicate, CTRL, Key::D, "Duplicate the selection"),
        (Bypass, NONE, Key::B, "Bypass the selected nodes, or end it"),
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
        (NextToo, Modifiers::SHIFT, Key::N, "Select the next node, too"),
        (Frame, NONE, Key::G, "Frame the selected nodes"),
        (Note, NONE, Key::O, "Add a note"),
        (Align, NONE, Key::L, "Put the selected nodes in line"),
        (Heat, NONE, Key::H, "Heat map: where time goes"),
        (Text, NONE, Key::T, "The file's text"),
        (Plots, NONE, Key::P, "Curves of times"),
        (History, NONE, Key::Y, "History of the parameters"),
        (Back, NONE, Key::OpenBracket, "One value back in the history"),
        (Forward, NONE, Key::CloseBracket, "One value forward in the history"),
        (Sweep, NONE, Key::S, "Sweep a parameter"),
        (Problems, NONE, Key::M, "Mistakes and faults"),
        (Plugins, NONE, Key::U, "Plugins and what they offer"),
        (Reload, CTRL, Key::R, "Swap rebuilt plugins in"),
        (Restart, SHIFT, Key::R, "Start the graph anew"),
        (Help, NONE, Key::F1, "These keys"),
        (Escape, NONE, Key::Escape, "Close what is open"),
    ]
};

/// Actions whose keys count while something is picked on a picture; the other keys are for that.
const PICKING: [Action; 5] = [Action::Undo, Action::Redo, Action::Save, Action::Help, Action::Escape];

/// As [`pressed`], while something is picked on a picture.
pub fn pressed_while_picking(input: &mut InputState) -> Vec<Action> {
    let mut all: Vec<_> = ALL.iter().filter(|(action, ..)| PICKING.contains(action)).collect();
    all.sort_by_key(|(_, m, ..)| std::cmp::Reverse(u8::from(m.command) + u8::from(m.shift)));
    all.retain(|(_, modifiers, key, _)| input.consume_key(*modifiers, *key));
    all.into_iter().map(|(action, ..)| *action).collect()
}

/// Takes the actions whose keys were pressed out of the input. While a text is being typed only keys with Ctrl count, and Escape.
pub fn pressed(input: &mut InputState, typing: bool) -> Vec<Action> {
    let mut found = Vec::new();
    // Keys with more modifiers first: Ctrl+Shift+Z is no Ctrl+Z.
    let mut all: Vec<_> = ALL.iter().collect();
    all.sort_by_key(|(_, m, ..)| std::cmp::Reverse(u8::from(m.command) + u8::from(m.shift)));
    for (action, modifiers, key, _) in all {
        let own_use = matches!(action, Action::SelectAll | Action::Undo | Action::Redo) || !modifiers.command;
        if typing && own_use && *action != Action::Escape {
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

/// The key of an action in words.
pub fn key_words(action: Action) -> String {
    let found = ALL.iter().find(|(a, ..)| *a == action);
    found.map_or_else(String::new, |(_, modifiers, key, _)| {
        let words = KeyboardShortcut::new(*modifiers, *key).format(&eframe::egui::ModifierNames::NAMES, false);
        // As it stands on the key.
        let sign = match key {
            Key::Plus => "+",
            Key::Minus => "-",
            Key::OpenBracket => "[",
            Key::CloseBracket => "]",
            _ => return words,
        };
        words.replace(key.name(), sign)
    })
}

/// What an action does, with its key.
pub fn hint(action: Action) -> String {
    let words = ALL.iter().find(|(a, ..)| *a == action).map_or("", |(.., words)| words);
    format!("{words} ({})", key_words(action))
}
