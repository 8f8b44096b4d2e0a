//! Results as tables, graph text, an image and JSON.

use std::fmt::Write as _;
use std::path::Path;

use panoscope_arm_core::control::Goals;
use panoscope_arm_core::tuning::course::{BAND, Channel, Motion};
use panoscope_arm_core::tuning::relay::{Parts, Rule};
use panoscope_arm_core::tuning::search::{
    LATER_MS, MAX_OF_ULTIMATE, OVERSHOOT_COST, RAMP_MM_S, SHAKE_COST, STEP_MM, SWING_COST, SWING_MM, with,
};
use panoscope_engine::text_table::table;
use serde_json::{Value, json};

use super::search::{Candidate, Method, Tuning, Tunings};
use crate::error::Result;
use crate::plot::{self, Chart, Series, Style};

fn number(value: f64, places: usize) -> String {
    if value.is_finite() { format!("{value:.places$}") } else { "never".to_owned() }
}

fn row(name: &str, found: &Candidate) -> Vec<String> {
    let (tuned, step, report) = (&found.tuned, &found.report.step, &found.report);
    vec![
        name.to_owned(),
        number(tuned.proportional, 2),
        number(tuned.integral, 2),
        number(tuned.derivative, 3),
        number(step.rise_s, 2),
        number(step.overshoot_pct, 1),
        number(step.settling_s, 2),
        number(step.steady_mm, 3),
        number(report.ramp_mm, 2),
        number(report.ramp_alone_mm, 2),
        number(found.cost.swing_mm, 2),
        number(found.cost.shake_mm_s2, 0),
        number(found.cost.total, 2),
    ]
}

impl Tunings {
    /// Limits of stability, the rules' gains, and the performance of all gains, as text.
    pub fn tables(&self) -> String {
        tables(&self.channels)
    }

    /// A line per channel with the number of gains tried; empty unless gains were searched.
    pub fn effort(&self) -> Vec<String> {
        let line = |tuning: &Tuning| format!("{}: {} sets of gains tried", tuning.channel.name(), tuning.tries);
        if self.method == Method::Search { self.channels.iter().map(line).collect() } else { Vec::new() }
    }

    /// The gains with the most parts as a fragment of graph text.
    pub fn fragment(&self) -> String {
        fragment(self)
    }

    /// Responses of all gains to a step and to a ramp as an image with a row of charts per channel.
    ///
    /// # Errors
    /// A response cannot be computed, or the file cannot be written.
    pub fn plot(&self, path: &Path) -> Result<()> {
        plot(path, self)
    }

    /// All results as JSON.
    ///
    /// # Errors
    /// A value cannot be written as JSON.
    pub fn json(&self) -> Result<String> {
        json(&self.channels)
    }
}

/// Limits of stability, rules, and performance of the gains.
fn tables(all: &[Tuning]) -> String {
    let mut text = String::new();
    for tuning in all {
        let u = &tuning.ultimate;
        let _ = writeln!(
            text,
            "{}: by relay feedback it swings forever at a gain of {:.2} 1/s, with a period of {:.3} s",
            tuning.channel.name(),
            u.gain,
            u.period_s
        );
        let mut rules = vec![["rule", "parts", "P 1/s", "I 1/s^2", "D"].map(str::to_owned).to_vec()];
        for rule in Rule::ALL {
            for parts in Parts::ALL {
                if let Some(t) = rule.gains(u, parts) {
                    let gains = [number(t.proportional, 2), number(t.integral, 2), number(t.derivative, 3)];
                    rules.push([rule.name().to_owned(), parts.name().to_owned()].into_iter().chain(gains).collect());
                }
            }
        }
        text += &table(&rules);
        let names = [
            "gains",
            "P 1/s",
            "I 1/s^2",
            "D",
            "rise s",
            "overshoot %",
            "settling s",
            "steady mm",
            "ramp mm",
            "ramp, nothing fed forward mm",
            "swing mm",
            "shake mm/s^2",
            "cost",
        ];
        let mut rows = vec![names.map(str::to_owned).to_vec()];
        rows.extend(tuning.found.iter().map(|found| row(found.parts.name(), found)));
        rows.push(row("as it is", &tuning.now));
        text += &table(&rows);
    }
    let _ = writeln!(
        text,
        "steps of {STEP_MM} mm, ramps of {RAMP_MM_S} mm/s, swings of {SWING_MM} mm at 0.5 Hz, exact tips; rise from 10 to 90 %, settling to {:.0} %",
        100.0 * BAND
    );
    let _ = writeln!(
        text,
        "cost: ITAE of step and ramp in mm s^2 + {SWING_COST} per mm of error on the swing + {SHAKE_COST} per 100 mm/s^2 of shaking + {OVERSHOOT_COST} per % of overshoot beyond the limit, the mean of this arm and one {LATER_MS} ms later; P at most {MAX_OF_ULTIMATE} of the gain that swings"
    );
    text
}

/// The gains with the most parts, ready for a graph.
fn fragment(tunings: &Tunings) -> String {
    let mut params = Vec::new();
    for tuning in &tunings.channels {
        let Some(found) = tuning.found.last() else { continue };
        let (name, t) = (tuning.channel.name(), found.tuned);
        params.push(format!(
            "{name}_p = {:.2}, {name}_i = {:.2}, {name}_d = {:.3}",
            t.proportional, t.integral, t.derivative
        ));
    }
    let filter_s = tunings.plant.goals.picture.filter_s;
    let node = tunings.plant.node.as_deref().unwrap_or("steer");
    format!("[nodes.{node}]\ntype = \"arm_pid\"\nparams = {{ {}, filter_s = {filter_s:?} }}\n", params.join(", "))
}

/// Responses of all gains to a step and to ramps: one row of charts per channel.
fn plot(path: &Path, tunings: &Tunings) -> Result<()> {
    let (course, goals) = (&tunings.plant.course, &tunings.goals);
    let mut charts = Vec::new();
    let alone = Goals { feed_forward: 0.0, ..*goals };
    for tuning in &tunings.channels {
        let channel = tuning.channel;
        let name = match channel {
            Channel::Picture => "place in the picture",
            Channel::Distance => "distance",
        };
        let motions = [
            (format!("{name}: step of {STEP_MM} mm"), Motion::Step(STEP_MM), goals),
            (format!("{name}: ramp of {RAMP_MM_S} mm/s, nothing fed forward"), Motion::Ramp(RAMP_MM_S), &alone),
        ];
        for (title, motion, goals) in motions {
            let mut series = Vec::new();
            for (color, found) in tuning.found.iter().enumerate() {
                let samples = course.play(&with(goals, channel, found.tuned), channel, motion)?;
                let points = samples.iter().filter(|s| s.at_s >= -0.2).map(|s| (s.at_s, s.error_mm)).collect();
                series.push(Series::new(found.parts.name(), Style::Line, color, points));
            }
            charts.push(Chart {
                title,
                x_label: "time, s".to_owned(),
                y_label: "error, mm".to_owned(),
                series,
                from_zero: true,
                ..Chart::default()
            });
        }
    }
    plot::save(path, &charts)
}

fn entry(found: &Candidate) -> Value {
    let (t, step) = (&found.tuned, &found.report.step);
    json!({
        "parts": found.parts.name(),
        "proportional": t.proportional, "integral": t.integral, "derivative": t.derivative,
        "rise_s": step.rise_s, "overshoot_pct": step.overshoot_pct, "settling_s": step.settling_s,
        "steady_mm": step.steady_mm, "itae_mm_s2": step.itae,
        "ramp_mm": found.report.ramp_mm, "ramp_alone_mm": found.report.ramp_alone_mm,
        "swing_mm": found.cost.swing_mm, "cost": found.cost.total, "shake_mm_s2": found.cost.shake_mm_s2,
    })
}

fn json(all: &[Tuning]) -> Result<String> {
    let channel = |tuning: &Tuning| {
        let u = &tuning.ultimate;
        let rules = Rule::ALL.iter().flat_map(|rule| {
            Parts::ALL.iter().filter_map(|parts| {
                let t = rule.gains(u, *parts)?;
                Some(json!({
                    "rule": rule.name(), "parts": parts.name(),
                    "proportional": t.proportional, "integral": t.integral, "derivative": t.derivative,
                }))
            })
        });
        json!({
            "channel": tuning.channel.name(),
            "ultimate_gain": u.gain, "ultimate_period_s": u.period_s,
            "rules": rules.collect::<Vec<Value>>(),
            "found": tuning.found.iter().map(entry).collect::<Vec<Value>>(),
            "now": entry(&tuning.now),
        })
    };
    let value = json!({ "channels": all.iter().map(channel).collect::<Vec<Value>>() });
    Ok(serde_json::to_string_pretty(&value)? + "\n")
}
