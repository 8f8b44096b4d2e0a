//! `panoscope tune`: gains of the arm's PID, found on the simulated arm.

use std::path::PathBuf;

use anyhow::{Context, Result};
use panoscope_arm_core::tuning::relay::Rule;
use panoscope_eval::{EvalError, tune};

use crate::session::Terminal;
use panoscope_cli::given::Given;
use panoscope_cli::terminal::{log, out, raw, stderr_color};
use panoscope_cli::{End, interrupt};

/// Arguments of `tune`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file whose controller and simulated arm are tuned. Default: the shipped arm, with the defaults of
    /// `arm_pid` and `arm_sim`.
    graph: Option<PathBuf>,
    /// The `arm_pid` of the graph; only needed if it has several.
    #[arg(long, value_name = "ID", requires = "graph")]
    node: Option<String>,
    /// Sets a parameter of the graph first; repeatable.
    #[arg(long, value_name = "NODE.PARAM=VALUE", requires = "graph")]
    set: Vec<String>,
    #[command(flatten)]
    given: Given,
    /// Method: rules from the limit of stability found by relay feedback, or a search that starts from them.
    #[arg(long, value_enum, default_value_t = Method::Search)]
    method: Method,
    /// The rule of --method relay.
    #[arg(long, value_enum, default_value_t = RuleName::TyreusLuyben)]
    rule: RuleName,
    /// Overshoot of a step without a penalty in the search, %.
    #[arg(long, default_value_t = tune::Options::default().overshoot_pct)]
    overshoot: f64,
    /// Share of the tip's own movement that is fed forward; 0 tunes the PID alone, as in the thesis. Default: the
    /// node's value.
    #[arg(long, value_name = "SHARE")]
    feed_forward: Option<f64>,
    /// Draws the responses of P, PI and PID to a step and to a ramp.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
    /// Writes limits of stability, gains and responses as JSON.
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
}

/// Method of [`Arguments`].
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

/// Finds gains, and shows and writes them.
pub fn run(arguments: &Arguments) -> Result<End> {
    interrupt::listen();
    let method = match arguments.method {
        Method::Relay => tune::Method::Relay(arguments.rule.rule()),
        Method::Search => tune::Method::Search,
    };
    let options = tune::Options {
        graph: arguments.graph.clone(),
        node: arguments.node.clone(),
        given: arguments.given.options(&arguments.set),
        method,
        overshoot_pct: arguments.overshoot,
        feed_forward: arguments.feed_forward,
    };
    let tunings = match tune::tune(&Terminal, &options) {
        Ok(tunings) => tunings,
        Err(EvalError::Options { reason }) => {
            log!("error: {reason}");
            return Ok(End::Wrong);
        }
        Err(EvalError::Check { diagnostics }) => {
            log!("{}", diagnostics.render(stderr_color()).trim_end());
            return Ok(End::Wrong);
        }
        Err(error) => return Err(error.into()),
    };
    raw(&tunings.tables());
    tunings.effort().iter().for_each(|line| log!("{line}"));
    out!("");
    raw(&tunings.fragment());
    if let Some(path) = &arguments.plot {
        tunings.plot(path)?;
    }
    if let Some(path) = &arguments.json {
        std::fs::write(path, tunings.json()?).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(End::Done)
}
