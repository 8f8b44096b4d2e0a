//! How the sources of files are played: held, stepped, at another speed, again and again. The values run and are not in the graph's files.

use toml::Value;

use crate::document::{Document, PlayedValue, default_value};
use crate::graph_view::NodeView;
use crate::observe::Counters;

/// Speeds that a step goes through, as factors of the files' rate.
pub const SPEEDS: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];
/// Parameters of a source that plays files.
const PAUSED: &str = "paused";
const STEP: &str = "step";
const SPEED: &str = "speed";
const LOOP: &str = "loop";
/// The metric with the number of the shown frame, which such a source has only while it shows files.
const FRAME: &str = "frame";

/// How something is played: the files of the running graph, or a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Playing {
    /// Whether it goes on by itself.
    pub plays: bool,
    /// Whether it begins again at its end.
    pub loops: bool,
    /// How fast it goes, as a factor of its rate.
    pub speed: f64,
}

/// A change of how the files are played.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Pause, or go on.
    Toggle,
    /// One more frame, and pause.
    Step,
    /// Begin again at the end, or not.
    Loop,
    /// The next of [`SPEEDS`].
    Speed,
}

/// The next of [`SPEEDS`]; after the last one the first.
pub fn next_speed(speed: f64) -> f64 {
    SPEEDS.into_iter().find(|known| *known > speed + 1e-6).unwrap_or(SPEEDS[0])
}

/// The nodes that play files.
fn players<'d>(document: &'d Document, counters: &'d Counters) -> impl Iterator<Item = &'d NodeView> {
    let has_params = |node: &&NodeView| {
        let params = node.node_type.iter().flat_map(|node_type| &node_type.params);
        params.filter(|param| [PAUSED, STEP, SPEED, LOOP].contains(&param.name.as_str())).count() == 4
    };
    let shows_file = |node: &&NodeView| {
        counters.nodes.get(node.id()).is_some_and(|now| now.metrics.iter().any(|(name, _)| name == FRAME))
    };
    document.view().flat().nodes.iter().filter(has_params).filter(shows_file)
}

/// The value with which a parameter of a node runs.
fn value_of(document: &Document, node: &NodeView, param: &str) -> Option<Value> {
    let played = document.played().iter().find(|(id, name, _)| id == node.id() && name == param);
    let default = || {
        let declared = node.node_type.as_ref()?.params.iter().find(|declared| declared.name == param)?;
        Some(default_value(&declared.kind))
    };
    played.map(|(.., value)| value).or_else(|| node.outline.params.get(param)).cloned().or_else(default)
}

/// How the files of the running graph are played; `None` where it shows none.
pub fn of_files(document: &Document, counters: &Counters) -> Option<Playing> {
    let node = players(document, counters).next()?;
    let value = |param| value_of(document, node, param);
    let is_on = |param| value(param).and_then(|value| value.as_bool()).unwrap_or(false);
    let speed = value(SPEED).and_then(|value| value.as_float().or(value.as_integer().map(|whole| whole as f64)));
    Some(Playing { plays: !is_on(PAUSED), loops: is_on(LOOP), speed: speed.unwrap_or(1.0) })
}

/// Changes how all files of the running graph are played; returns how they are then, `None` where there are none.
pub fn change(document: &mut Document, counters: &Counters, change: Change) -> Option<Playing> {
    let now = of_files(document, counters)?;
    let mut played = document.played().to_vec();
    for node in players(document, counters) {
        let values: Vec<(&str, Value)> = match change {
            Change::Toggle => vec![(PAUSED, now.plays.into())],
            Change::Step => {
                let step = value_of(document, node, STEP).and_then(|step| step.as_integer()).unwrap_or(0);
                vec![(PAUSED, true.into()), (STEP, (step + 1).into())]
            }
            Change::Loop => vec![(LOOP, (!now.loops).into())],
            Change::Speed => vec![(SPEED, next_speed(now.speed).into())],
        };
        for (param, value) in values {
            set(&mut played, node.id(), param, value);
        }
    }
    document.set_played(played);
    of_files(document, counters)
}

fn set(played: &mut Vec<PlayedValue>, node: &str, param: &str, value: Value) {
    match played.iter_mut().find(|(id, name, _)| id == node && name == param) {
        Some((.., known)) => *known = value,
        None => played.push((node.to_owned(), param.to_owned(), value)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_go_round() {
        assert_eq!(next_speed(1.0), 2.0);
        assert_eq!(next_speed(0.3), 0.5);
        assert_eq!(next_speed(4.0), 0.25);
        assert_eq!(next_speed(20.0), 0.25);
    }
}
