//! A sweep as lines, tables, JSON, CSV and a chart.

use panoscope_engine::text_table;
use serde_json::{Value, json};

use super::measure::Summary;
use super::run::{Point, Sweep};
use crate::error::Result;
use crate::plot::{Chart, Series, Style};

pub(super) fn number(value: f64) -> String {
    if value.abs() >= 1000.0 { format!("{value:.0}") } else { format!("{value:.4}") }
}

/// Note for the result of a run with failed calls.
pub(super) fn failures(summary: &Summary) -> String {
    match summary.failed_calls {
        0 => String::new(),
        1 => " (1 call of a node failed)".to_owned(),
        count => format!(" ({count} calls of nodes failed)"),
    }
}

/// A point as one line of text.
pub fn line(sweep: &Sweep, point: &Point) -> String {
    let (param, unit) = (sweep.param(), sweep.unit());
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    match &point.result {
        Ok(s) => format!("{param} = {}{unit}: {}{}", point.value, number(s.mean), failures(s)),
        Err(why) => format!("{param} = {}{unit}: {why}", point.value),
    }
}

/// Points as text, one row per value.
pub fn table(sweep: &Sweep, points: &[Point]) -> String {
    let head = [sweep.param(), "mean", "median", "min", "max", "deviation", "last", "count", "missing", "failed calls"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    for point in points {
        let mut cells = vec![point.value.clone()];
        match &point.result {
            Ok(Summary { count, missing, failed_calls, mean, median, min, max, deviation, last }) => {
                cells.extend([mean, median, min, max, deviation, last].map(|v| number(*v)));
                cells.extend([count, missing, failed_calls].map(ToString::to_string));
            }
            Err(_) => cells.push("failed".to_owned()),
        }
        rows.push(cells);
    }
    text_table::table(&rows)
}

/// Points as JSON, one object per value.
///
/// # Errors
/// A value cannot be written as JSON.
pub fn json(sweep: &Sweep, points: &[Point]) -> Result<String> {
    let rows: Vec<Value> = points.iter().map(|point| row(sweep, point)).collect();
    Ok(serde_json::to_string_pretty(&rows)? + "\n")
}

fn row(sweep: &Sweep, point: &Point) -> Value {
    let (summary, failed) = match &point.result {
        Ok(summary) => (Some(summary), None),
        Err(why) => (None, Some(&why.reason)),
    };
    // JSON has no NaN: what is unknown is null.
    let of = |value: fn(&Summary) -> f64| summary.map(value).filter(|v| v.is_finite());
    json!({
        "param": sweep.param(),
        "value": point.value,
        "at": point.at,
        "unit": sweep.unit(),
        "measure": sweep.measure_text(),
        "mean": of(|s| s.mean),
        "median": of(|s| s.median),
        "min": of(|s| s.min),
        "max": of(|s| s.max),
        "deviation": of(|s| s.deviation),
        "last": of(|s| s.last),
        "count": summary.map(|s| s.count),
        "missing": summary.map(|s| s.missing),
        "failed_calls": summary.map(|s| s.failed_calls),
        "failed": failed,
    })
}

/// Draws mean, minimum and maximum over the values.
pub fn chart(sweep: &Sweep, points: &[Point]) -> Chart {
    let (unit, has_words) = (sweep.unit(), sweep.has_words());
    let known = || points.iter().filter_map(|p| Some((p.at, p.result.as_ref().ok()?)));
    let bars = known().flat_map(|(at, s)| [(at, s.min), (at, s.max)]).collect();
    let means = known().map(|(at, s)| (at, s.mean)).collect();
    Chart {
        title: format!("{} over {}", sweep.measure_text(), sweep.param()),
        x_label: if unit.is_empty() { sweep.param().to_owned() } else { format!("{} [{unit}]", sweep.param()) },
        y_label: sweep.measure_text().to_owned(),
        // Between words there is nothing.
        series: vec![
            Series::new("smallest to largest", Style::Bars, 1, bars),
            Series::new("mean", if has_words { Style::Dots } else { Style::Line }, 0, means),
        ],
        from_zero: false,
        log: false,
        words: if has_words { points.iter().map(|p| (p.at, p.value.clone())).collect() } else { Vec::new() },
    }
}

/// Points as CSV, one line each.
pub fn csv(param: &str, measure: &str, points: &[Point]) -> String {
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let mut out = format!(
        "{},{},median,min,max,deviation,count,missing,last,failed_calls,failed\n",
        quoted(param),
        quoted(measure)
    );
    for point in points {
        let value = quoted(&point.value);
        match &point.result {
            Ok(s) => {
                let numbers = [s.mean, s.median, s.min, s.max, s.deviation].map(|v| v.to_string()).join(",");
                out += &format!("{value},{numbers},{},{},{},{},\n", s.count, s.missing, s.last, s.failed_calls);
            }
            Err(why) => out += &format!("{value},,,,,,,,,,{}\n", quoted(why.reason.lines().next().unwrap_or_default())),
        }
    }
    out
}
