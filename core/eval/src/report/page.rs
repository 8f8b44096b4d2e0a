//! The comparison as one self-contained HTML page: tables and plots, without scripts, other files or network.

use std::fmt::Write;

use super::{Comparison, Options, Run};
use crate::svg::{Axis, Plot, STYLE, escaped};
use crate::sweep::RunParam;

/// Size of a plot, px.
const PLOT: (f64, f64) = (480.0, 240.0);
/// Maximum number of decimals.
const PLACES: usize = 4;

fn number(value: f64) -> String {
    if value.abs() >= 1000.0 { format!("{value:.0}") } else { format!("{value:.PLACES$}") }
}

fn param<'a>(run: &'a Run, name: &str) -> Option<&'a RunParam> {
    run.file.params.iter().find(|param| param.name == name)
}

fn value(run: &Run, measure: &str, options: &Options) -> Option<f64> {
    run.file.measures.iter().find(|m| m.name == measure).and_then(|m| options.statistic.of(m))
}

/// The page.
pub fn page(comparison: &Comparison, options: &Options) -> String {
    let mut out = String::new();
    let title = format!("{} runs compared", comparison.runs.len());
    let _ = write!(
        out,
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>\
         <style>{STYLE}.best{{font-weight:700;background:#e3f1e3}}.wide{{overflow-x:auto}}.failed{{color:#a00}}</style></head><body>\n\
         <h1>{title}</h1>\n<p>Measures are the {} over each run. The best run of each measure is marked.</p>\n",
        options.statistic.name()
    );
    table(&mut out, comparison, options);
    plots(&mut out, comparison, options);
    origins(&mut out, comparison);
    out.push_str("</body></html>\n");
    out
}

fn table(out: &mut String, comparison: &Comparison, options: &Options) {
    out.push_str("<h2>Runs</h2>\n<div class=\"wide\"><table><thead><tr><th>run</th>");
    for name in &comparison.params {
        let unit = comparison.runs.iter().find_map(|run| param(run, name)).map_or("", |param| param.unit.as_str());
        let unit = if unit.is_empty() { String::new() } else { format!(" [{}]", escaped(unit)) };
        let _ = write!(out, "<th>{}{unit}</th>", escaped(name));
    }
    let mut best = Vec::new();
    for name in &comparison.measures {
        let word = if options.is_larger_better(name) { "more" } else { "less" };
        let _ = write!(out, "<th>{}<br><small>{word} is better</small></th>", escaped(name));
        best.push(comparison.best(name, options));
    }
    out.push_str("</tr></thead><tbody>\n");
    for (index, run) in comparison.runs.iter().enumerate() {
        let _ = write!(out, "<tr><td>{}</td>", escaped(&run.folder.display().to_string()));
        for name in &comparison.params {
            let _ = write!(out, "<td>{}</td>", param(run, name).map_or_else(String::new, |p| escaped(&p.value)));
        }
        for (name, best) in comparison.measures.iter().zip(&best) {
            let failed = run.file.measures.iter().find(|m| m.name == *name).and_then(|m| m.failed.as_ref());
            let _ = match (value(run, name, options), failed) {
                (Some(value), _) if *best == Some(index) => {
                    write!(out, "<td class=\"best\">{} (best)</td>", number(value))
                }
                (Some(value), _) => write!(out, "<td>{}</td>", number(value)),
                (None, Some(why)) => write!(out, "<td class=\"failed\" title=\"{}\">failed</td>", escaped(why)),
                (None, None) => write!(out, "<td>unknown</td>"),
            };
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

/// A plot for each parameter that has several values, and each measure.
fn plots(out: &mut String, comparison: &Comparison, options: &Options) {
    for name in &comparison.params {
        let of_runs: Vec<(&Run, &RunParam)> =
            comparison.runs.iter().filter_map(|run| Some((run, param(run, name)?))).collect();
        // Words of several studies may have other positions: one position for each word.
        let mut words: Vec<&str> = of_runs.iter().filter(|(_, p)| p.is_word).map(|(_, p)| p.value.as_str()).collect();
        words.sort_unstable();
        words.dedup();
        let at = |param: &RunParam| {
            if words.is_empty() {
                param.at
            } else {
                words.iter().position(|word| *word == param.value).map_or(f64::NAN, |at| at as f64)
            }
        };
        let mut across: Vec<f64> = of_runs.iter().map(|(_, param)| at(param)).filter(|v| v.is_finite()).collect();
        across.sort_by(f64::total_cmp);
        across.dedup();
        let (Some(first), Some(last)) = (across.first(), across.last()) else { continue };
        if across.len() < 2 {
            continue;
        }
        let unit = of_runs.first().map_or("", |(_, param)| param.unit.as_str());
        let label = if unit.is_empty() { name.clone() } else { format!("{name} [{unit}]") };
        let _ = write!(out, "<h2>{}</h2>\n<div class=\"two\">\n", escaped(name));
        for measure in &comparison.measures {
            let points: Vec<(f64, f64)> = of_runs
                .iter()
                .filter_map(|(run, param)| Some((at(param), value(run, measure, options)?)))
                .filter(|(x, _)| x.is_finite())
                .collect();
            if points.is_empty() {
                continue;
            }
            let (low, high) =
                points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p.1), h.max(p.1)));
            let title = format!("{measure} over {name}");
            let along = if words.is_empty() { Axis::around(*first, *last) } else { Axis::of_words(&words) };
            let mut plot = Plot::new(&title, PLOT, along, Axis::around(low, high), &label, measure);
            if words.is_empty() {
                // The mean of the runs that share a value.
                let means = across.iter().filter_map(|x| {
                    let here: Vec<f64> = points.iter().filter(|p| p.0 == *x).map(|p| p.1).collect();
                    (!here.is_empty()).then(|| ((*x, here.iter().sum::<f64>() / here.len() as f64), true))
                });
                plot.line(0, means);
            }
            plot.dots(1, points.into_iter());
            let _ = writeln!(out, "<div>{}</div>", plot.end());
        }
        out.push_str("</div>\n");
    }
}

/// Writes a table of graph, machine and versions. Runs that share all of them are one row.
fn origins(out: &mut String, comparison: &Comparison) {
    out.push_str("<h2>Origin</h2>\n<div class=\"wide\"><table><thead><tr>");
    for head in ["runs", "graph", "input", "machine", "Panoscope", "plugins", "settings"] {
        let _ = write!(out, "<th>{head}</th>");
    }
    out.push_str("</tr></thead><tbody>\n");
    let mut rows: Vec<(Vec<usize>, Vec<String>)> = Vec::new();
    for (index, run) in comparison.runs.iter().enumerate() {
        let file = &run.file;
        let machine = &file.machine;
        let short = |hash: &str| hash.get(..8).unwrap_or(hash).to_owned();
        let plugins = file.plugins.iter().chain(&file.models).map(|p| format!("{} {}", p.name, short(&p.xxh3)));
        let input = file.recording.clone().unwrap_or_else(|| "sources of the graph".to_owned());
        let mut settings = file.settings.clone();
        settings.extend(file.dropped.iter().map(|param| format!("without {param}")));
        let cells = vec![
            file.graph.clone(),
            format!("{input}, {} ticks", file.frames),
            format!("{}, {} cores, {}", machine.cpu, machine.cores, machine.os),
            file.version.clone(),
            plugins.collect::<Vec<_>>().join(", "),
            settings.join(", "),
        ];
        match rows.iter_mut().find(|(_, other)| *other == cells) {
            Some((runs, _)) => runs.push(index + 1),
            None => rows.push((vec![index + 1], cells)),
        }
    }
    for (runs, cells) in rows {
        let _ = write!(out, "<tr><td>{}</td>", spans(&runs));
        for cell in cells {
            let _ = write!(out, "<td>{}</td>", escaped(&cell));
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n<p>Runs are counted in the order of the first table. Plugins and models carry the first digits of their XXH3 hashes.</p>\n");
}

/// Ascending numbers as ranges, such as `1-4, 7`.
fn spans(numbers: &[usize]) -> String {
    let mut parts: Vec<(usize, usize)> = Vec::new();
    for number in numbers {
        match parts.last_mut() {
            Some((_, end)) if *end + 1 == *number => *end = *number,
            _ => parts.push((*number, *number)),
        }
    }
    let words = parts.iter().map(|(a, b)| if a == b { a.to_string() } else { format!("{a}-{b}") });
    words.collect::<Vec<_>>().join(", ")
}
