//! Finds gains for both channels of the controller.

use std::path::PathBuf;

use panoscope_arm_core::control::Goals;
use panoscope_arm_core::tuning::course::Channel;
use panoscope_arm_core::tuning::relay::{Parts, Rule, Tuned, Ultimate};
use panoscope_arm_core::tuning::search::{self, Cost, Report};

use panoscope_graph::GraphOptions;

use super::params::{self, Plant};
use crate::error::{Context, EvalError, Result};
use crate::session::{Session, check_cancelled};

/// Method of tuning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// This rule, applied to the limit of stability that relay feedback finds.
    Relay(Rule),
    /// A search that begins with the rules' gains.
    Search,
}

/// Options of [`tune`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Graph file whose controller and simulated arm are tuned. Default: the shipped arm with the defaults of `arm_pid`
    /// and `arm_sim`.
    pub graph: Option<PathBuf>,
    /// The `arm_pid` of the graph; only needed if it has several.
    pub node: Option<String>,
    /// Overlays, arguments and settings of the graph.
    pub given: GraphOptions,
    /// Method of tuning.
    pub method: Method,
    /// Overshoot of a step that the search does not penalise, percent.
    pub overshoot_pct: f64,
    /// Share of the tip's own movement that is fed forward, 0 to 1; default: that of the node.
    pub feed_forward: Option<f64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            graph: None,
            node: None,
            given: GraphOptions::default(),
            method: Method::Search,
            overshoot_pct: 10.0,
            feed_forward: None,
        }
    }
}

/// Gains of some parts of a channel, and their performance.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// P, PI or PID.
    pub parts: Parts,
    /// The gains.
    pub tuned: Tuned,
    /// Cost that the search minimises.
    pub cost: Cost,
    /// Responses to steps and ramps.
    pub report: Report,
}

/// Results of one channel.
#[derive(Clone, Debug)]
pub struct Tuning {
    /// The channel.
    pub channel: Channel,
    /// Limit of stability.
    pub ultimate: Ultimate,
    /// The gains that the controller has now.
    pub now: Candidate,
    /// P, PI and PID, those that the method provides.
    pub found: Vec<Candidate>,
    /// Number of gains tried.
    pub tries: usize,
}

/// Result of [`tune`].
pub struct Tunings {
    /// One per channel.
    pub channels: Vec<Tuning>,
    /// Controller and arm.
    pub plant: Plant,
    /// Goals with the feed-forward share that was used.
    pub goals: Goals,
    /// Method of tuning.
    pub method: Method,
}

/// Finds gains for both channels of the arm's controller on the simulated arm.
///
/// # Errors
/// An option is out of range, the graph cannot be used, the loop does not oscillate under relay feedback, or the
/// session is cancelled.
pub fn tune(session: &dyn Session, options: &Options) -> Result<Tunings> {
    if !(0.0..=100.0).contains(&options.overshoot_pct) {
        let reason = format!("--overshoot is {}: it is a percentage, 0 to 100", options.overshoot_pct);
        return Err(EvalError::Options { reason });
    }
    if let Some(share) = options.feed_forward.filter(|share| !(0.0..=1.0).contains(share)) {
        return Err(EvalError::Options { reason: format!("--feed-forward is {share}; it must be between 0 and 1") });
    }
    let plant = match &options.graph {
        None => params::shipped()?,
        Some(graph) => params::of_graph(graph, options.node.as_deref(), &options.given)?,
    };
    let mut goals = plant.goals;
    goals.feed_forward = options.feed_forward.unwrap_or(goals.feed_forward);
    let mut channels = Vec::new();
    for channel in Channel::ALL {
        channels.push(one(session, options, &plant, &goals, channel)?);
    }
    Ok(Tunings { channels, plant, goals, method: options.method })
}

fn one(session: &dyn Session, options: &Options, plant: &Plant, goals: &Goals, channel: Channel) -> Result<Tuning> {
    let course = &plant.course;
    let ultimate =
        course.relay(goals, channel).with_context(|| format!("cannot tune the {} of the tip", channel.name()))?;
    let mut tries = 0;
    let judge = |tuned: Tuned| search::cost(course, goals, channel, tuned, options.overshoot_pct);
    let report = |tuned: Tuned| search::report(course, goals, channel, tuned);
    let judged = |parts: Parts, tuned: Tuned| -> Result<Candidate> {
        Ok(Candidate { parts, tuned, cost: judge(tuned)?, report: report(tuned)? })
    };
    let mut found: Vec<Candidate> = Vec::new();
    for parts in Parts::ALL {
        if let Method::Relay(rule) = options.method {
            if let Some(tuned) = rule.gains(&ultimate, parts) {
                found.push(judged(parts, tuned)?);
            }
            continue;
        }
        let starts = search::starts(&ultimate, parts, found.last().map(|fewer| fewer.tuned));
        let mut tried = |_: Tuned, _: &Cost| {
            tries += 1;
            !session.is_cancelled()
        };
        let ranges = search::ranges(&ultimate);
        let (tuned, cost) = search::search(&starts, &ranges, parts, &mut { judge }, &mut tried)?;
        check_cancelled(session)?;
        found.push(Candidate { parts, tuned, cost, report: report(tuned)? });
    }
    let now = judged(Parts::Pid, params::gains_of(goals, channel))?;
    Ok(Tuning { channel, ultimate, now, found, tries })
}
