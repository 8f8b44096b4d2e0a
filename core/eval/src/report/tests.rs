use std::fs;
use std::path::PathBuf;

use panoscope_engine::Machine;
use panoscope_record::FileHash;

use super::*;
use crate::sweep::{RunMeasure, RunParam};

fn file(run: usize, params: &[(&str, &str, f64, bool)], measures: &[(&str, Option<f64>)]) -> RunFile {
    let hash =
        |name: &str| FileHash { name: name.into(), file: name.into(), bytes: 1, xxh3: "0123456789abcdef".into() };
    let param = |&(name, value, at, is_word): &(&str, &str, f64, bool)| RunParam {
        name: name.into(),
        value: value.into(),
        at,
        unit: if is_word { String::new() } else { "px".into() },
        is_word,
    };
    let measure = |&(name, value): &(&str, Option<f64>)| RunMeasure {
        name: name.into(),
        mean: value,
        median: value,
        min: value,
        max: value,
        deviation: Some(0.0),
        last: value.map(|v| v + 100.0),
        count: 3,
        missing: 0,
        failed_calls: 0,
        failed: value.is_none().then(|| "a <wrong> reason".into()),
    };
    RunFile {
        version: "1.2.3".into(),
        run,
        graph: "depth.toml".into(),
        graph_hash: hash("graph.toml"),
        plugins: vec![hash("stereo")],
        models: Vec::new(),
        machine: Machine { cpu: "A & B".into(), cores: 2, threads: 2, os: "Linux".into() },
        unix_ms: 0,
        seconds: 1.0,
        frames: 10,
        recording: None,
        settings: Vec::new(),
        dropped: Vec::new(),
        params: params.iter().map(param).collect(),
        measures: measures.iter().map(measure).collect(),
    }
}

fn study(name: &str, files: &[RunFile]) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope_report_{name}_{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    for file in files {
        let run = folder.join(format!("run_{:04}", file.run));
        fs::create_dir_all(&run).expect("a folder");
        fs::write(run.join(RESULTS), serde_json::to_string(file).expect("JSON")).expect("written");
    }
    folder
}

fn options(folder: PathBuf) -> Options {
    Options { folders: vec![folder], statistic: Statistic::Mean, larger: Vec::new(), smaller: Vec::new() }
}

#[test]
fn the_best_run_of_each_measure_is_marked_and_text_stays_text() {
    let run = |number, block: f64, kind, bad, coverage| {
        let block_text = block.to_string();
        let params = [("match.block_px", block_text.as_str(), block, false), ("match.type", kind, 0.0, true)];
        file(number, &params, &[("judge.bad2_pct", bad), ("judge.coverage_pct", coverage)])
    };
    let folder = study(
        "best",
        &[
            run(1, 5.0, "stereo_bm", Some(7.0), Some(60.0)),
            run(2, 9.0, "stereo_bm", Some(4.0), Some(80.0)),
            run(3, 5.0, "<script>", None, None),
            run(4, 9.0, "stereo_sgbm", Some(6.0), Some(70.0)),
        ],
    );
    let options = options(folder.clone());
    let comparison = compare(&options).expect("four runs");
    assert_eq!(comparison.params, ["match.block_px", "match.type"]);
    assert_eq!(comparison.best("judge.bad2_pct", &options), Some(1));
    assert_eq!(comparison.best("judge.coverage_pct", &options), Some(1), "of coverage more is better");
    let other = Options { smaller: vec!["judge.coverage_pct".into()], ..options.clone() };
    assert_eq!(comparison.best("judge.coverage_pct", &other), Some(0));
    let html = page(&comparison, &options);
    assert_eq!(html.matches("(best)").count(), 2);
    assert!(html.contains("<td class=\"best\">4.0000 (best)</td>"), "{html}");
    assert!(!html.contains("<script") && html.contains("&lt;script&gt;") && html.contains("a &lt;wrong&gt; reason"));
    assert!(html.contains("A &amp; B") && html.contains("stereo 01234567") && html.contains("<td>1-4</td>"));
    assert_eq!(html.matches("<svg").count(), 4, "two parameters, two measures");
    assert!(!html.contains("src=") && !html.contains("href="), "nothing from elsewhere");
    let last = Options { statistic: Statistic::Last, ..options };
    assert!(page(&comparison, &last).contains("104.0000 (best)"));
    fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn folders_without_runs_and_unknown_measures_are_named() {
    let folder = study("none", &[]);
    fs::create_dir_all(&folder).expect("a folder");
    let error = compare(&options(folder.clone())).expect_err("no run").to_string();
    assert!(error.contains("holds no run"), "{error}");
    fs::create_dir_all(folder.join("run_0001")).expect("a folder");
    fs::write(folder.join("run_0001").join(RESULTS), "{}").expect("written");
    let error = compare(&options(folder.clone())).expect_err("no results").to_string();
    assert!(error.contains("has no results of a run"), "{error}");
    fs::remove_dir_all(&folder).expect("removed");
    let folder = study("larger", &[file(1, &[("a.b", "1", 1.0, false)], &[("c.d", Some(1.0))])]);
    let error = compare(&Options { larger: vec!["c.e".into()], ..options(folder.clone()) }).expect_err("no c.e");
    assert!(error.to_string().contains("measures are c.d"), "{error}");
    fs::remove_dir_all(folder).expect("removed");
}
