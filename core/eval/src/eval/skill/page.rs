//! The report as one self-contained page: tables and plots, without scripts or network access.

use std::fmt::Write;

use panoscope_arm_core::tracking::skill::measures::FIGURES;
use panoscope_arm_core::tracking::skill::{Measures, Movement};

use super::study::{SkillStudy, shown};
use crate::svg::{Axis, COLORS, Plot, STYLE, WIDTH, escaped};

/// Meanings of measures, with their sources.
const MEANINGS: [(&str, &str); 11] = [
    (
        "Time, time out of view, departures",
        "From the tool's first picture on. Pictures without it for longer than the longest gap are time out of view. (Oropesa et al. 2013)",
    ),
    (
        "Path, speed",
        "Length of the tip's smoothed path while it moves; rest adds none, since what a tracker trembles there would grow with time. Mean speed is path over time of movement. (Oropesa et al. 2013; Chmarra et al. 2007)",
    ),
    (
        "Idle share",
        "Share of the time in view in which the tool is slower than the speed of rest for longer than the shortest rest. (D'Angelo et al. 2015)",
    ),
    (
        "Movement",
        "From rest to rest, measured from where its speed first passes a tenth of its peak (or the speed of rest) to where it last does.",
    ),
    (
        "Economy of motion",
        "Straight distance between the ends of movements over their paths; 1 is straight. (Oropesa et al. 2013)",
    ),
    (
        "Jerk; log dimensionless jerk",
        "Third derivative of the place, from a quintic spline. -ln(T^3 / v_peak^2 * integral of squared jerk), mean of all movements; greater is smoother; -5.32 is a minimum-jerk reach from rest to rest, -4.04 one that is measured from a tenth of its peak speed to a tenth, as here. (Hogan and Sternad 2009; Balasubramanian et al. 2012, 2015)",
    ),
    (
        "Spectral arc length",
        "Minus the length of the normalised amplitude spectrum of the speed, up to 10 Hz or where it stays below 0.05, mean of all movements; greater is smoother. (Balasubramanian et al. 2012, 2015)",
    ),
    (
        "Working box, ellipsoid",
        "Extent of all places in view; volume of the ellipsoid that holds 95 % of a normal distribution like theirs. (Oropesa et al. 2013)",
    ),
    (
        "Depth",
        "Range of the depth in the camera's frame, and path along it while the tool moves. (Oropesa et al. 2013)",
    ),
    (
        "Both hands",
        "Share of the time in which either tool moves, both in view, in which both do; and the correlation of their speeds. (Hofstad et al. 2013)",
    ),
    (
        "Touches, grasps",
        "Stretches in which the tip is within the distance of touch of the tissue. Of tools that grasp they are counted as grasps: the tracks do not tell whether jaws close.",
    ),
];

fn measures_table(out: &mut String, heads: &[&str], columns: &[(&Measures, Option<u64>)]) {
    out.push_str("<table><tr><th>measure</th>");
    heads.iter().for_each(|head| out.push_str(&format!("<th>{}</th>", escaped(head))));
    out.push_str("</tr>");
    for figure in FIGURES {
        let _ = write!(out, "<tr><td>{}</td>", escaped(figure.title));
        columns.iter().for_each(|(m, _)| out.push_str(&format!("<td>{}</td>", shown((figure.of)(m)))));
        out.push_str("</tr>");
    }
    out.push_str("<tr><td>grasps</td>");
    columns.iter().for_each(|(_, grasps)| {
        out.push_str(&format!("<td>{}</td>", grasps.map_or_else(|| "-".to_owned(), |n| n.to_string())));
    });
    out.push_str("</tr></table>\n");
}

/// Renders the page.
pub fn page(study: &SkillStudy) -> String {
    let mut out = String::from(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>Surgical skill</title><style>",
    );
    out.push_str(STYLE);
    out.push_str("</style></head><body><h1>Surgical skill</h1>\n");
    let names: Vec<&str> = study.session.tools().map(|tool| tool.name).collect();
    let length_s = study.span_s.1 - study.span_s.0;
    let files: Vec<String> = study.files.iter().map(|file| escaped(file)).collect();
    let _ = writeln!(out, "<p>{}; {:.1} s.</p><p>", files.join(", "), length_s);
    for (index, name) in names.iter().enumerate() {
        let color = COLORS[index % COLORS.len()];
        let _ = write!(out, "<span class=\"key\" style=\"background:{color}\"></span>{}", escaped(name));
    }
    out.push_str("</p><h2>Measures</h2>\n");
    let totals: Vec<_> = study.session.tools().map(|tool| (tool.total, study.grasps(tool.name, tool.total))).collect();
    measures_table(&mut out, &names, &totals);
    pairs(&mut out, study, &names);
    over_time(&mut out, study, &names);
    paths(&mut out, study);
    movements(&mut out, study);
    if study.session.phases().len() > 1 {
        for (phase, name) in study.session.phases().iter().enumerate() {
            let of = |tool: &panoscope_arm_core::tracking::skill::ToolReport<'_>| !tool.phases[phase].is_empty();
            let tools: Vec<_> = study.session.tools().filter(of).collect();
            let name = if name.is_empty() { "(no phase)" } else { name };
            let _ = writeln!(out, "<h2>Phase: {}</h2>", escaped(name));
            let heads: Vec<&str> = tools.iter().map(|tool| tool.name).collect();
            let columns = tools.iter().map(|tool| (&tool.phases[phase], study.grasps(tool.name, &tool.phases[phase])));
            measures_table(&mut out, &heads, &columns.collect::<Vec<_>>());
        }
    }
    out.push_str("<h2>What the measures mean</h2><dl>");
    for (what, meaning) in MEANINGS {
        let _ = write!(out, "<dt>{}</dt><dd>{}</dd>", escaped(what), escaped(meaning));
    }
    out.push_str("</dl></body></html>\n");
    out
}

fn pairs(out: &mut String, study: &SkillStudy, names: &[&str]) {
    if names.len() < 2 {
        return;
    }
    out.push_str("<h2>Both hands</h2><table><tr><th>tools</th><th>both in view, s</th><th>both move, s</th><th>of either's movement</th><th>correlation of speeds</th></tr>");
    for (a, b, both, _) in study.session.pairs() {
        let _ = write!(
            out,
            "<tr><td>{} and {}</td><td>{:.1}</td><td>{:.1}</td><td>{}</td><td>{}</td></tr>",
            escaped(names[a]),
            escaped(names[b]),
            both.seen_s(),
            both.both_s(),
            shown(both.overlap()),
            shown(both.correlation())
        );
    }
    out.push_str("</table>\n");
}

fn over_time(out: &mut String, study: &SkillStudy, names: &[&str]) {
    let (from, to) = study.span_s;
    // Times on plots begin with the recording.
    let time = Axis::around(0.0, to - from);
    let flags = |plot: &mut Plot| {
        if study.session.phases().len() > 1 {
            study.changes.iter().for_each(|(at, phase)| plot.flag(at - from, study.phase_name(*phase)));
        }
    };
    out.push_str("<h2>Speed</h2>");
    let top = study.traces.iter().flat_map(|trace| &trace.parts).map(|part| part.speed_max).fold(1.0, f64::max);
    let mut plot =
        Plot::new("highest speed over time", (WIDTH, 240.0), time.clone(), Axis::around(0.0, top), "s", "mm/s");
    for (index, trace) in study.traces.iter().enumerate() {
        let of = trace.parts.iter().enumerate();
        let points = of
            .map(|(k, part)| ((trace.part_s(k) - from, if part.cells == 0 { f64::NAN } else { part.speed_max }), true));
        plot.line(index, points);
    }
    flags(&mut plot);
    out.push_str(&plot.end());
    out.push_str("<h2>Moving, resting, out of view</h2><p>Full colour where a tool moves, pale where it rests, blank where it is out of view.</p>");
    let count = names.len() as f64;
    let rows = Axis::around(0.0, count);
    let mut plot = Plot::new("activity over time", (WIDTH, 70.0 + 34.0 * count), time, rows, "s", "");
    for (index, trace) in study.traces.iter().enumerate() {
        let base = count - 1.0 - index as f64;
        for (k, part) in trace.parts.iter().enumerate().filter(|(_, part)| part.cells > 0) {
            let (middle, half) = (trace.part_s(k) - from, 0.005 * trace.per_part as f64);
            let seen = f64::from(part.cells) / trace.per_part as f64;
            let moving = f64::from(part.moving) / f64::from(part.cells);
            plot.bar(
                index,
                (middle - half, middle + half),
                (base + 0.15, base + 0.75),
                (0.2 + 0.8 * moving) * seen.min(1.0),
            );
        }
        plot.word(base + 0.88, names[index]);
    }
    flags(&mut plot);
    out.push_str(&plot.end());
}

fn paths(out: &mut String, study: &SkillStudy) {
    out.push_str("<h2>Paths</h2><div class=\"two\">");
    for (title, axes, labels) in [
        ("path as the camera looks", [0, 1], ("across, mm", "down, mm")),
        ("path from above", [0, 2], ("across, mm", "away, mm")),
    ] {
        let range = |axis: usize| {
            let values = study.traces.iter().flat_map(|trace| &trace.places).map(|(place, _)| place[axis]);
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
        };
        let ((x0, x1), (y0, y1)) = (range(axes[0]), range(axes[1]));
        // One scale for both directions; y is drawn downwards, as in a picture.
        let half = 0.5 * (x1 - x0).max(y1 - y0).max(1.0);
        let (x, y) = (0.5 * (x0 + x1), 0.5 * (y0 + y1));
        let flip = if axes[1] == 1 { -1.0 } else { 1.0 };
        let (across, up) = (Axis::around(x - half, x + half), Axis::around(flip * y - half, flip * y + half));
        let y_label = if flip < 0.0 { "up, mm" } else { labels.1 };
        let mut plot = Plot::new(title, (480.0, 440.0), across, up, labels.0, y_label);
        for (index, trace) in study.traces.iter().enumerate() {
            let points = trace.places.iter().map(|(p, is_joined)| ((p[axes[0]], flip * p[axes[1]]), *is_joined));
            plot.line(index, points);
        }
        out.push_str(&plot.end());
    }
    out.push_str("</div>");
}

fn movements(out: &mut String, study: &SkillStudy) {
    let all = || study.traces.iter().flat_map(|trace| &trace.movements);
    if all().next().is_none() {
        return;
    }
    out.push_str("<h2>Smoothness of each movement</h2>");
    let (from, to) = study.span_s;
    type Of = fn(&Movement) -> Option<f64>;
    for (title, of) in [
        ("log dimensionless jerk", (|m| m.ldlj) as Of),
        ("spectral arc length", |m| m.sparc),
        ("economy of motion", |m| Some(m.chord_mm / m.path_mm)),
    ] {
        let values = all().filter_map(of);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        let axis = Axis::around(low, high);
        let mut plot = Plot::new(title, (WIDTH, 190.0), Axis::around(0.0, to - from), axis, "s", title);
        for (index, trace) in study.traces.iter().enumerate() {
            let points = trace.movements.iter().filter_map(|m| Some((m.start_s - from + 0.5 * m.duration_s, of(m)?)));
            plot.dots(index, points);
        }
        out.push_str(&plot.end());
    }
}
