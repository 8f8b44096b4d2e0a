//! Disturbances of a soak test: changed parameters, removed and restored sinks, killed processes.

use std::time::Instant;

use panoscope_base::random::{SplitMix64, unit};
use panoscope_engine::{Engine, SetError};
use panoscope_graph::{Catalog, Graph, Node, Param, ParamKind, ParamValue};
use panoscope_host::loader::Live;
use panoscope_host::loader::live::LiveError;

use crate::system;

/// A live edit that the engine refused; the old graph runs on unchanged.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum EditRefused {
    /// A parameter keeps its value.
    #[error("{param} = {value}: {cause}")]
    Param { param: String, value: f64, cause: SetError },
    /// A sink stays.
    #[error("without `{sink}`: {cause}")]
    Sink { sink: String, cause: LiveError },
    /// The original text was not applied again.
    #[error("{0}")]
    Text(LiveError),
}

/// Intervals of the disturbances; `None`: never.
#[derive(Clone, Copy, Debug, Default)]
pub struct Disturbances {
    /// Seconds between live edits. In turn, a parameter changes by up to a tenth of its range, the original graph is
    /// restored, a sink is removed, and the sink is restored.
    pub edit_every_s: Option<f64>,
    /// Seconds between SIGKILLs, each of the process of another group of isolated nodes.
    pub kill_every_s: Option<f64>,
}

/// Disturbances so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Done {
    /// Live edits that the engine applied.
    pub edits: u64,
    /// Live edits that it refused; the old graph continued.
    pub refused: u64,
    /// Killed processes.
    pub kills: u64,
}

/// A float parameter that has a range.
struct Slider {
    node: String,
    param: String,
    index: usize,
    min: f64,
    max: f64,
}

/// Disturbs a running graph. A fixed seed chooses the parameters and sinks.
pub struct Disturber {
    settings: Disturbances,
    began: Instant,
    /// The graph as it was at the start.
    text: String,
    sliders: Vec<Slider>,
    sinks: Vec<String>,
    random: SplitMix64,
    edits: u64,
    kills: u64,
    done: Done,
}

impl Disturber {
    /// Creates it for a running graph with this text, checked against `catalog`.
    pub fn new(settings: Disturbances, text: &str, graph: &Graph, catalog: &Catalog) -> Self {
        Self {
            settings,
            began: Instant::now(),
            text: text.to_owned(),
            sliders: sliders(graph, catalog),
            sinks: sinks(graph),
            random: SplitMix64(1),
            edits: 0,
            kills: 0,
            done: Done::default(),
        }
    }

    /// Disturbances so far.
    pub fn done(&self) -> Done {
        self.done
    }

    /// Makes the disturbances that are due. Returns the refusal of an edit.
    pub fn disturb(&mut self, live: &mut Live) -> Option<EditRefused> {
        let seconds = self.began.elapsed().as_secs_f64();
        let is_due =
            |every: Option<f64>, so_far: u64| every.is_some_and(|every| seconds >= every * (so_far + 1) as f64);
        if is_due(self.settings.kill_every_s, self.kills) {
            self.done.kills += u64::from(kill_one(live.engine(), self.kills));
            self.kills += 1;
        }
        if !is_due(self.settings.edit_every_s, self.edits) {
            return None;
        }
        let made = match self.edits % 4 {
            0 => self.move_param(live.engine()),
            2 => self.remove_sink(live),
            _ => live.apply_text(&self.text).map(|_| true).map_err(EditRefused::Text),
        };
        self.edits += 1;
        match made {
            Ok(changed) => {
                self.done.edits += u64::from(changed);
                None
            }
            Err(reason) => {
                self.done.refused += 1;
                Some(reason)
            }
        }
    }

    /// Changes a parameter by up to a tenth of its range. Returns whether there was one.
    fn move_param(&mut self, engine: &Engine) -> Result<bool, EditRefused> {
        let Some(Slider { node, param, index, min, max }) = self.sliders.get(self.random.below(self.sliders.len()))
        else {
            return Ok(false);
        };
        let Some(ParamValue::Float(value)) = engine.param_values(node).and_then(|values| values.get(*index).cloned())
        else {
            return Ok(false);
        };
        let share = 2.0 * unit(self.random.bits()) - 1.0;
        let moved = (value + 0.1 * share * (max - min)).clamp(*min, *max);
        let refusal = |cause| EditRefused::Param { param: format!("{node}.{param}"), value: moved, cause };
        engine.set_param(node, param, ParamValue::Float(moved)).map_err(refusal)?;
        Ok(true)
    }

    /// Removes a sink while another remains. Returns whether there was one.
    fn remove_sink(&mut self, live: &mut Live) -> Result<bool, EditRefused> {
        if self.sinks.len() < 2 {
            return Ok(false);
        }
        let sink = &self.sinks[self.random.below(self.sinks.len())];
        live.remove_node(sink).map_err(|cause| EditRefused::Sink { sink: sink.clone(), cause })?;
        Ok(true)
    }
}

/// The float parameters with a range, of all nodes.
fn sliders(graph: &Graph, catalog: &Catalog) -> Vec<Slider> {
    let of_node = |node: &Node| {
        let params = node.node_type(catalog).params.iter().enumerate();
        let slider = |(index, param): (usize, &Param)| match param.kind {
            ParamKind::Float { min: Some(min), max: Some(max), .. } => {
                Some(Slider { node: node.id.clone(), param: param.name.clone(), index, min, max })
            }
            _ => None,
        };
        params.filter_map(slider).collect::<Vec<_>>()
    };
    graph.nodes.iter().flat_map(of_node).collect()
}

/// The nodes whose outputs no node reads.
fn sinks(graph: &Graph) -> Vec<String> {
    let takes_nothing = |&(index, _): &(usize, &Node)| graph.edges.iter().all(|edge| edge.from_node != index);
    graph.nodes.iter().enumerate().filter(takes_nothing).map(|(_, node)| node.id.clone()).collect()
}

/// Kills the process of one group of isolated nodes, of each group in turn. Returns whether a process was running.
fn kill_one(engine: &Engine, turn: u64) -> bool {
    let running: Vec<u32> = engine.report().groups.values().filter_map(|group| group.process_id).collect();
    let Some(id) = (turn as usize).checked_rem(running.len()).map(|index| running[index]) else { return false };
    system::kill(id)
}
