//! What became of the parameters: who changed which, from what to what, from which tick on. It can be stepped through. No egui here.
//!
//! The document feeds it with every text that differs in a value, whatever led to that text. It is no list of edits: wires and places are left
//! out, and going back to a value is an edit of its own that can be undone.

use std::collections::VecDeque;

use toml::Value;

/// Most changes that are remembered.
const MOST: usize = 1000;

/// Who changed a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum By {
    /// Somebody at this window.
    Hand,
    /// An edit was undone.
    Undo,
    /// It was done again.
    Redo,
    /// The file was changed on disk.
    File,
    /// A step through the history.
    History,
}

impl By {
    /// In one word.
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

/// A parameter that got another value.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The node.
    pub node: String,
    /// Its parameter.
    pub param: String,
    /// Value before; `None` where the file gave none, so that the default held.
    pub from: Option<Value>,
    /// Value after.
    pub to: Option<Value>,
    /// Who changed it.
    pub by: By,
    /// Tick of the busiest source at which it was in force; `None` while it is not.
    pub tick: Option<u64>,
}

/// A value that a parameter is to have.
pub type Wanted = (String, String, Option<Value>);

/// All changes, oldest first, and where in them the graph stands.
#[derive(Clone, Debug, Default)]
pub struct History {
    changes: VecDeque<Change>,
    /// Changes that are in force: those before this place.
    at: usize,
}

impl History {
    /// The changes, oldest first.
    pub fn changes(&self) -> impl DoubleEndedIterator<Item = &Change> + ExactSizeIterator {
        self.changes.iter()
    }

    /// How many of them are in force; the others were stepped back from.
    pub fn at(&self) -> usize {
        self.at
    }

    /// Takes a change in. One that `goes_on` (a slider still being dragged) moves the end of the last one.
    pub fn take(&mut self, change: Change, goes_on: bool) {
        if self.at == self.changes.len()
            && goes_on
            && let Some(last) = self.changes.back_mut()
            && (&last.node, &last.param, last.by) == (&change.node, &change.param, change.by)
        {
            (last.to, last.tick) = (change.to, None);
            return;
        }
        // What was stepped back from came about, too: it is written down, so that the list tells what happened.
        let back: Vec<Change> = self.changes.range(self.at..).rev().cloned().collect();
        for c in back {
            self.changes.push_back(Change { from: c.to, to: c.from, by: By::History, tick: None, ..c });
        }
        self.changes.push_back(change);
        while self.changes.len() > MOST {
            self.changes.pop_front();
        }
        self.at = self.changes.len();
    }

    /// Changes that had no tick are in force since this one.
    pub fn in_force(&mut self, tick: u64) {
        self.changes.iter_mut().rev().filter(|c| c.tick.is_none()).for_each(|c| c.tick = Some(tick));
    }

    /// Whether some change has no tick yet.
    pub fn waits(&self) -> bool {
        self.changes.iter().rev().any(|c| c.tick.is_none())
    }

    /// What is to be set so that exactly the first `at` changes are in force.
    pub fn values_at(&self, at: usize) -> Vec<Wanted> {
        let at = at.min(self.changes.len());
        let mut wanted: Vec<Wanted> = Vec::new();
        let mut want = |c: &Change, value: &Option<Value>| {
            wanted.retain(|(node, param, _)| (node, param) != (&c.node, &c.param));
            wanted.push((c.node.clone(), c.param.clone(), value.clone()));
        };
        self.changes.iter().enumerate().take(self.at).skip(at).rev().for_each(|(_, c)| want(c, &c.from));
        self.changes.iter().take(at).skip(self.at).for_each(|c| want(c, &c.to));
        wanted
    }

    /// The graph stands there now.
    pub fn stepped_to(&mut self, at: usize) {
        self.at = at.min(self.changes.len());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(from: i64, to: i64) -> Change {
        let (node, param) = ("n".to_owned(), "p".to_owned());
        Change { node, param, from: Some(from.into()), to: Some(to.into()), by: By::Hand, tick: None }
    }

    fn value(history: &History, at: usize) -> Option<i64> {
        history.values_at(at).first().and_then(|(.., value)| value.as_ref()?.as_integer())
    }

    #[test]
    fn steps_lead_back_and_forth() {
        let mut history = History::default();
        history.take(change(1, 2), false);
        history.take(change(2, 3), true);
        assert_eq!(history.changes().len(), 1, "a drag is one change");
        history.take(change(3, 4), false);
        history.in_force(17);
        assert!(!history.waits() && history.changes().all(|c| c.tick == Some(17)));
        assert_eq!((value(&history, 1), value(&history, 0)), (Some(3), Some(1)));
        history.stepped_to(0);
        assert_eq!((value(&history, 1), value(&history, 2)), (Some(3), Some(4)));
        // A change from there: what was stepped back from is written down first.
        history.take(change(1, 9), false);
        let ends: Vec<_> = history.changes().map(|c| c.to.as_ref().and_then(Value::as_integer)).collect();
        assert_eq!(ends, [3, 4, 3, 1, 9].map(Some));
        assert_eq!(value(&history, 2), Some(4));
        assert_eq!(history.at(), 5);
    }
}
