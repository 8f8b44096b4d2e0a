//! Tables 5.1 to 5.5 of the thesis, from our own data and measurements, as Markdown.

use std::fmt::Write;

use super::find::Node;
use super::judged::JudgeInputs;
use super::picture::confusion;
use super::truth::Truth;
use panoscope_imaging::detect::{ClassScore, Scores, Shape};

fn row(out: &mut String, cells: &[String]) {
    let _ = writeln!(out, "| {} |", cells.join(" | "));
}

fn head(out: &mut String, title: &str, cells: &[String]) {
    let _ = writeln!(out, "\n{title}\n");
    row(out, cells);
    row(out, &vec!["---".to_owned(); cells.len()]);
}

fn percent(value: f64) -> String {
    if value.is_nan() { "-".to_owned() } else { format!("{:.1} %", value * 100.0) }
}

/// Names of the classes of all ground truths, which number classes separately.
fn names<'j>(truths: impl Iterator<Item = &'j Truth>) -> Vec<&'j str> {
    let mut names: Vec<&str> = Vec::new();
    for name in truths.flat_map(|truth| &truth.classes) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    names
}

fn number_of(truth: &Truth, name: &str) -> Option<usize> {
    truth.classes.iter().position(|class| class == name)
}

/// Number of images with a class, and number of its objects.
fn counts(truth: &Truth, name: &str) -> (usize, usize) {
    let Some(class) = number_of(truth, name) else { return (0, 0) };
    let of = |p: &super::truth::Picture| p.objects.iter().filter(|o| o.class == class && !o.ignored).count();
    (truth.pictures.iter().filter(|p| of(p) > 0).count(), truth.pictures.iter().map(of).sum())
}

fn data(out: &mut String, title: &str, list: &[&JudgeInputs]) {
    if list.is_empty() {
        return;
    }
    let mut cells = vec!["tool".to_owned()];
    cells.extend(list.iter().map(|j| format!("{}: frames", j.case)));
    cells.extend(list.iter().map(|j| format!("{}: instruments", j.case)));
    head(out, title, &cells);
    for name in names(list.iter().map(|j| &j.truth)) {
        let all: Vec<(usize, usize)> = list.iter().map(|j| counts(&j.truth, name)).collect();
        let mut cells = vec![name.to_owned()];
        cells.extend(all.iter().map(|c| c.0.to_string()));
        cells.extend(all.iter().map(|c| c.1.to_string()));
        row(out, &cells);
    }
    let mut cells = vec!["all".to_owned()];
    cells.extend(list.iter().map(|j| j.truth.pictures.len().to_string()));
    cells.extend(list.iter().map(|j| j.truth.pictures.iter().map(|p| p.objects.len()).sum::<usize>().to_string()));
    row(out, &cells);
}

fn found(out: &mut String, title: &str, list: &[&JudgeInputs], shape: Shape) {
    if list.is_empty() {
        return;
    }
    let mut cells = vec!["tool".to_owned()];
    cells.extend(list.iter().map(|j| format!("{}: right, another tool, missed, false", j.case)));
    head(out, title, &cells);
    let tables: Vec<_> = list.iter().map(|j| confusion(&j.truth, &j.finds, shape)).collect();
    for name in names(list.iter().map(|j| &j.truth)) {
        let mut cells = vec![name.to_owned()];
        for (j, t) in list.iter().zip(&tables) {
            let n = j.truth.classes.len();
            let Some(class) = number_of(&j.truth, name) else {
                cells.push("-".to_owned());
                continue;
            };
            let right = t[class][class];
            let other: usize = t[class][..n].iter().sum::<usize>() - right;
            cells.push(format!("{right}, {other}, {}, {}", t[class][n], t[n][class]));
        }
        row(out, &cells);
    }
}

fn precision(out: &mut String, title: &str, list: &[(&JudgeInputs, &str, &Scores)]) {
    if list.is_empty() {
        return;
    }
    let mut cells = vec!["tool".to_owned()];
    for (j, what, _) in list {
        cells.extend([format!("{}, {what}: AP50", j.case), format!("{}, {what}: AP50-95", j.case)]);
    }
    head(out, title, &cells);
    for name in names(list.iter().map(|(j, _, _)| &j.truth)) {
        let mut cells = vec![name.to_owned()];
        for (j, _, s) in list {
            let c = number_of(&j.truth, name).and_then(|class| s.classes.get(class));
            cells.push(percent(c.map_or(f64::NAN, |c| c.ap[0])));
            cells.push(percent(c.map_or(f64::NAN, ClassScore::mean_ap)));
        }
        row(out, &cells);
    }
    let mut cells = vec!["mean".to_owned()];
    for (_, _, s) in list {
        cells.extend([percent(s.ap_at(0)), percent(s.ap())]);
    }
    row(out, &cells);
    let mut cells = vec!["median time a frame".to_owned()];
    for (j, _, _) in list {
        cells.extend([format!("{:.1} ms", j.ms), String::new()]);
    }
    row(out, &cells);
}

/// All tables of the evaluations.
pub fn all(judged: &[JudgeInputs]) -> String {
    let of = |node: Node| -> Vec<&JudgeInputs> { judged.iter().filter(|j| j.node == node).collect() };
    let (boxes, masks) = (of(Node::Yolo), of(Node::MaskRcnn));
    let mut out = String::from(
        "# Tables 5.1 to 5.5, rebuilt\n\nFrames of each case are what lies on this machine; nothing is copied from the thesis.\n",
    );
    data(&mut out, "## Table 5.1: frames and instruments, boxes", &boxes);
    found(&mut out, "## Table 5.2: detections at score 0.3 and overlap 0.5", &boxes, Shape::Box);
    let list: Vec<_> = boxes.iter().map(|j| (*j, "boxes", &j.boxes)).collect();
    precision(&mut out, "## Table 5.3: average precision of the detector", &list);
    data(&mut out, "## Table 5.4: frames and instruments, outlines", &masks);
    let mut list = Vec::new();
    for j in &masks {
        list.push((*j, "boxes", &j.boxes));
        list.extend(j.masks.as_ref().map(|m| (*j, "masks", m)));
    }
    precision(&mut out, "## Table 5.5: average precision of the segmenter", &list);
    out
}

#[cfg(test)]
mod tests {
    use super::super::truth::Picture;
    use super::*;
    use panoscope_imaging::detect::Object;

    /// A case whose classes are numbered in this order, one object of each; its AP is 0.1 for `hook`, 0.2 for the
    /// others.
    fn case(name: &str, classes: &[&str]) -> JudgeInputs {
        let object = |class| Object { class, bbox: [0.0, 0.0, 9.0, 9.0], mask: None, ignored: false };
        let picture =
            Picture { path: "a.png".into(), width: 64, height: 48, objects: (0..classes.len()).map(object).collect() };
        let score =
            |class: &&str| ClassScore { ap: [if *class == "hook" { 0.1 } else { 0.2 }; 10], ..ClassScore::default() };
        JudgeInputs {
            case: name.to_owned(),
            node: Node::MaskRcnn,
            truth: Truth { classes: classes.iter().map(|c| (*c).to_owned()).collect(), pictures: vec![picture] },
            finds: vec![Vec::new()],
            boxes: Scores { classes: classes.iter().map(score).collect() },
            bounds: None,
            masks: None,
            ms: 1.0,
        }
    }

    #[test]
    fn rows_belong_to_names_however_a_truth_numbers_them() {
        let tables = all(&[case("real", &["grasper", "hook"]), case("drawn", &["hook", "scissors", "grasper"])]);
        for row in
            ["| hook | 1 | 1 | 1 | 1 |", "| scissors | 0 | 1 | 0 | 1 |", "| hook | 10.0 % | 10.0 % | 10.0 % | 10.0 % |"]
        {
            assert!(tables.contains(row), "{row}\n{tables}");
        }
        assert!(tables.contains("| scissors | - | - | 20.0 % | 20.0 % |"), "{tables}");
    }
}
