//! The history of parameter changes: which parameter, from which value to which, from which tick on, and where the change came from.
//!
//! The document records every changed value, whatever changed the text. The history is not the undo list: it has no wires or positions, and
//! stepping back to a value is an edit that can be undone.

use std::collections::VecDeque;

use toml::Value;

/// Maximum number of changes in the history.
const MAX_ENTRIES: usize = 1000;

/// Where a change of a value came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The user of this window.
    Hand,
    /// Undo of an edit.
    Undo,
    /// Redo of an edit.
    Redo,
    /// A change of the file on disk.
    File,
    /// A step through the history.
    History,
}

impl Origin {
    /// The word that the history panel shows.
    pub fn word(self) -> &'static str {
        match self {
            Self::Hand => "hand",
            Self::Undo => "undo",
            Self::Redo => "redo",
            Self::File => "file",
            Self::History => "history",
        }
    }
}

/// A change of a parameter's value.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The node.
    pub node: String,
    /// Its parameter.
    pub param: String,
    /// Value before; `None` when the file had none, so that the default applied.
    pub from: Option<Value>,
    /// Value after; `None` when the default applies.
    pub to: Option<Value>,
    /// Where the change came from.
    pub by: Origin,
    /// First tick of the busiest source with the new value; `None` until it is applied.
    pub tick: Option<u64>,
}

/// Node, parameter and the value to set; `None` for the default.
pub type TargetValue = (String, String, Option<Value>);

/// All changes, oldest first, and the current position among them.
#[derive(Clone, Debug, Default)]
pub struct History {
    changes: VecDeque<Change>,
    /// Number of changes that are applied; later ones were stepped back from.
    at: usize,
}

impl History {
    /// The changes, oldest first.
    pub fn changes(&self) -> impl DoubleEndedIterator<Item = &Change> + ExactSizeIterator {
        self.changes.iter()
    }

    /// Number of changes that are applied; later ones were stepped back from.
    pub fn at(&self) -> usize {
        self.at
    }

    /// Records a change. If it `extends_last` (a slider still being dragged), it extends the last change.
    pub fn record(&mut self, change: Change, extends_last: bool) {
        if self.at == self.changes.len()
            && extends_last
            && let Some(last) = self.changes.back_mut()
            && (&last.node, &last.param, last.by) == (&change.node, &change.param, change.by)
        {
            (last.to, last.tick) = (change.to, None);
            return;
        }
        // Stepping back was a change too, so it is recorded before the new one.
        let back: Vec<Change> = self.changes.range(self.at..).rev().cloned().collect();
        for c in back {
            self.changes.push_back(Change { from: c.to, to: c.from, by: Origin::History, tick: None, ..c });
        }
        self.changes.push_back(change);
        while self.changes.len() > MAX_ENTRIES {
            self.changes.pop_front();
        }
        self.at = self.changes.len();
    }

    /// Sets the tick of all changes that have none yet.
    pub fn set_tick(&mut self, tick: u64) {
        self.changes.iter_mut().rev().filter(|c| c.tick.is_none()).for_each(|c| c.tick = Some(tick));
    }

    /// Whether a change has no tick yet.
    pub fn has_pending(&self) -> bool {
        self.changes.iter().rev().any(|c| c.tick.is_none())
    }

    /// The values to set so that exactly the first `at` changes are applied.
    pub fn values_at(&self, at: usize) -> Vec<TargetValue> {
        let at = at.min(self.changes.len());
        let mut targets: Vec<TargetValue> = Vec::new();
        let mut want = |c: &Change, value: &Option<Value>| {
            targets.retain(|(node, param, _)| (node, param) != (&c.node, &c.param));
            targets.push((c.node.clone(), c.param.clone(), value.clone()));
        };
        self.changes.iter().enumerate().take(self.at).skip(at).rev().for_each(|(_, c)| want(c, &c.from));
        self.changes.iter().take(at).skip(self.at).for_each(|c| want(c, &c.to));
        targets
    }

    /// Sets the position: the first `at` changes are applied.
    pub fn set_position(&mut self, at: usize) {
        self.at = at.min(self.changes.len());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(from: i64, to: i64) -> Change {
        let (node, param) = ("n".to_owned(), "p".to_owned());
        Change { node, param, from: Some(from.into()), to: Some(to.into()), by: Origin::Hand, tick: None }
    }

    fn value(history: &History, at: usize) -> Option<i64> {
        history.values_at(at).first().and_then(|(.., value)| value.as_ref()?.as_integer())
    }

    #[test]
    fn steps_lead_back_and_forth() {
        let mut history = History::default();
        history.record(change(1, 2), false);
        history.record(change(2, 3), true);
        assert_eq!(history.changes().len(), 1, "a drag is one change");
        history.record(change(3, 4), false);
        history.set_tick(17);
        assert!(!history.has_pending() && history.changes().all(|c| c.tick == Some(17)));
        assert_eq!((value(&history, 1), value(&history, 0)), (Some(3), Some(1)));
        history.set_position(0);
        assert_eq!((value(&history, 1), value(&history, 2)), (Some(3), Some(4)));
        // A change from an earlier position: the step back is recorded first.
        history.record(change(1, 9), false);
        let ends: Vec<_> = history.changes().map(|c| c.to.as_ref().and_then(Value::as_integer)).collect();
        assert_eq!(ends, [3, 4, 3, 1, 9].map(Some));
        assert_eq!(value(&history, 2), Some(4));
        assert_eq!(history.at(), 5);
    }
}
