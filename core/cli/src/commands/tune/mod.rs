//! `panoscope tune`: gains of the arm's PID, found on the simulated arm.

mod params;
mod show;

use std::path::PathBuf;

use anyhow::{Context, Result};
use panoscope_arm_core::tuning::course::Channel;
use panoscope_arm_core::tuning::relay::{Parts, Rule, Tuned, Ultimate};
use panoscope_arm_core::tuning::search::{self, Cost, Report};

use crate::terminal::{stderr_color, tell};
use crate::{End, interrupt};

/// Arguments of `tune`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file whose controller and simulated arm are tuned. Without it: the arm that ships, with the defaults of `arm_pid` and `arm_sim`.
    graph: Option<PathBuf>,
    /// The `arm_pid` of the graph; only needed where it has several.
    #[arg(long, value_name = "ID", requires = "graph")]
    node: Option<String>,
    /// Sets a parameter of the graph before. May be given again.
    #[arg(long, value_name = "NODE.PARAM=VALUE", requires = "graph")]
    set: Vec<String>,
    /// How gains are found: by rules from the limit of stability, which relay feedback finds, or by a search that begins at them.
    #[arg(long, value_enum, default_value_t = Method::Search)]
    method: Method,
    /// The rule of --method relay.
    #[arg(long, value_enum, default_value_t = RuleName::TyreusLuyben)]
    rule: RuleName,
    /// Overshoot of a step that the search leaves unpunished, %.
    #[arg(long, default_value_t = 10.0)]
    overshoot: f64,
    /// Share of the tip's own movement that is fed forward; 0 tunes the PID alone, as the thesis has it. Without it what the node has.
    #[arg(long, value_name = "SHARE")]
    feed_forward: Option<f64>,
    /// Draws the responses of P, PI and PID to a step and to a ramp.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
    /// Writes limits of stability, gains and responses as JSON.
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
}

/// See [`Arguments`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    Relay,
    Search,
}

/// Names of [`Rule`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum RuleName {
    ZieglerNichols,
    TyreusLuyben,
    Amigo,
}

impl RuleName {
    fn rule(self) -> Rule {
        match self {
            Self::ZieglerNichols => Rule::ZieglerNichols,
            Self::TyreusLuyben => Rule::TyreusLuyben,
            Self::Amigo => Rule::Amigo,
        }
    }
}

/// Gains of some parts of a channel, and what they do.
struct Found {
    parts: Parts,
    tuned: Tuned,
    cost: Cost,
    report: Report,
}

/// One channel.
struct Tuning {
    channel: Channel,
    ultimate: Ultimate,
    /// What the controller has now.
    now: Found,
    /// P, PI, PID, as far as the method has them.
    found: Vec<Found>,
    /// Gains that were tried.
    tries: usize,
}

/// Tunes.
pub fn run(arguments: &Arguments) -> Result<End> {
    interrupt::listen();
    if !(0.0..=100.0).contains(&arguments.overshoot) {
        tell!("error: --overshoot is {}: it is a percentage, 0 to 100", arguments.overshoot);
        return Ok(End::Wrong);
    }
    if let Some(share) = arguments.feed_forward.filter(|share| !(0.0..=1.0).contains(share)) {
        tell!("error: --feed-forward is {share}: it is a share, 0 to 1");
        return Ok(End::Wrong);
    }
    let taken = match &arguments.graph {
        None => params::shipped()?,
        Some(graph) => match params::of_graph(graph, arguments.node.as_deref(), &arguments.set)? {
            Ok(taken) => taken,
            Err(params::Refused::Graph(diagnostics)) => {
                tell!("{}", diagnostics.render(stderr_color()).trim_end());
                return Ok(End::Wrong);
            }
            Err(params::Refused::Node(words)) => {
                tell!("error: {}: {words}", graph.display());
                return Ok(End::Wrong);
            }
        },
    };
    let mut goals = taken.goals;
    goals.feed_forward = arguments.feed_forward.unwrap_or(goals.feed_forward);
    let mut all = Vec::new();
    for channel in Channel::ALL {
        let course = &taken.course;
        let ultimate = course
            .relay(&goals, channel)
            .with_context(|| format!("the {} of the tip could not be tuned", channel.name()))?;
        let mut tries = 0;
        let judge = |tuned: Tuned| search::cost(course, &goals, channel, tuned, arguments.overshoot);
        let judged = |parts: Parts, tuned: Tuned| -> Result<Found> {
            Ok(Found { parts, tuned, cost: judge(tuned)?, report: search::report(course, &goals, channel, tuned)? })
        };
        let mut found: Vec<Found> = Vec::new();
        for parts in Parts::ALL {
            if arguments.method == Method::Relay {
                if let Some(tuned) = arguments.rule.rule().gains(&ultimate, parts) {
                    found.push(judged(parts, tuned)?);
                }
                continue;
            }
            let starts = search::starts(&ultimate, parts, found.last().map(|fewer| fewer.tuned));
            let mut tried = |_: Tuned, _: &Cost| {
                tries += 1;
                !interrupt::asked()
            };
            let ranges = search::ranges(&ultimate);
            let (tuned, cost) = search::search(&starts, &ranges, parts, &mut { judge }, &mut tried)?;
            anyhow::ensure!(!interrupt::asked(), "interrupted");
            found.push(Found { parts, tuned, cost, report: search::report(course, &goals, channel, tuned)? });
        }
        let now = judged(Parts::Pid, params::gains_of(&goals, channel))?;
        all.push(Tuning { channel, ultimate, now, found, tries });
    }
    show::tables(&all, arguments.method == Method::Search);
    show::fragment(&all, &taken);
    if let Some(path) = &arguments.plot {
        show::plot(path, &all, &taken.course, &goals)?;
    }
    if let Some(path) = &arguments.json {
        show::json(path, &all)?;
    }
    Ok(End::Done)
}
