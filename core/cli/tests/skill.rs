//! `panoscope eval skill`: reports of tracks as `write_table` writes them, and what it says of files that are none.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::common::plugins;

fn run(arguments: &[&str]) -> (i32, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_panoscope")).args(arguments).output().expect("the program starts");
    let Output { status, stdout, stderr } = output;
    let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
    (status.code().unwrap_or(-1), text(stdout), text(stderr))
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope_skill_{}_{name}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

fn file(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).expect("a file");
    path.display().to_string()
}

/// A track of `tip_track`: from 1 s on 20 mm/s along x for 4 s, then rest for 2 s, then lost; the second line of each
/// second is only predicted.
fn left_hand() -> String {
    let mut text =
        String::from("seq,source,capture_ms,text,x_mm,y_mm,z_mm,room_x_mm,room_y_mm,room_z_mm,gap_ms,track_id\n");
    for k in 0..270 {
        let t = f64::from(k) / 30.0;
        let x = 20.0 * (t - 1.0).clamp(0.0, 4.0);
        let phase = if t < 3.0 { "exposure" } else { "\"clip, \"\"cut\"\"\"" };
        let gap = if k % 30 == 1 { 33.3 } else { 0.0 };
        let place = if t < 7.0 { format!("1,2,{},{x},5,60,{gap},4", 50.0 + x) } else { ",,,,,,,".to_owned() };
        text.push_str(&format!("{k},0,{},{phase},{place}\n", t * 1e3));
    }
    text
}

/// A track of `proximity` in JSON lines: rests, but moves from 3 to 5 s; touches once.
fn right_hand() -> String {
    let mut text = String::new();
    for k in 0..210 {
        let t = f64::from(k) / 30.0;
        let (x, touch) = (30.0 * (t - 3.0).clamp(0.0, 2.0), if (5.5..6.5).contains(&t) { 0.2 } else { 8.0 });
        text.push_str(&format!(
            "{{\"seq\":{k},\"source\":0,\"capture_ms\":{},\"table\":[{{\"track_id\":2,\"class_index\":1,\"x_mm\":{x},\"y_mm\":0,\"z_mm\":55,\"tissue_mm\":{touch}}}]}}\n",
            t * 1e3
        ));
    }
    text
}

#[test]
fn two_tracks_become_a_report_with_phases_pairs_and_a_page() {
    let folder = folder("report");
    let (left, right) = (file(&folder, "left.csv", &left_hand()), file(&folder, "right.jsonl", &right_hand()));
    let (json, html) = (folder.join("skill.json"), folder.join("skill.html"));
    let (json, html) = (json.display().to_string(), html.display().to_string());
    let labels = ["--labels", "hook,grasper"];
    let (code, out, err) =
        run(&[&["eval", "skill", &left, &right, "--json", &json, "--html", &html], &labels[..]].concat());
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("left #4") && out.contains("right grasper #2"), "{out}");
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&json).expect("the report")).expect("JSON");
    let near = |value: &serde_json::Value, want: f64| {
        let value = value.as_f64().unwrap_or(f64::NAN);
        assert!((value - want).abs() <= 0.01 * want.abs().max(1.0), "{value} instead of {want}");
    };
    let [left, right] = [0, 1].map(|tool| &report["tools"][tool]);
    near(&left["all"]["path_mm"], 80.0);
    near(&left["all"]["depth_path_mm"], 80.0);
    // The last picture with a tip is at 6.97 s, the last of all at 8.97 s.
    near(&left["all"]["out_of_view_s"], 2.0);
    near(&left["phases"]["exposure"]["path_mm"], 40.0);
    near(&left["phases"]["clip, \"cut\""]["path_mm"], 40.0);
    assert_eq!(left["all"]["departures"], 1.0, "a prediction of 33 ms is no departure");
    assert!(left["all"]["contacts"].is_null() && left["all"]["grasps"].is_null());
    near(&right["all"]["path_mm"], 60.0);
    assert_eq!((&right["all"]["contacts"], &right["all"]["grasps"]), (&1.0.into(), &1.into()));
    // Both move from 3 to 5 s, the first one alone for 2 s before.
    let pair = &report["pairs"][0];
    assert!((pair["all"]["overlap"].as_f64().expect("a share") - 0.5).abs() < 0.03, "{pair}");
    let page = std::fs::read_to_string(&html).expect("the page");
    for part in ["<svg", "left #4", "right grasper #2", "Phase: clip, &quot;cut&quot;", "Balasubramanian", "Both hands"]
    {
        assert!(page.contains(part), "the page has no `{part}`");
    }
    assert!(!page.contains("http") && !page.contains("<script") && !page.contains("NaN"), "one file, no network");
    std::fs::remove_dir_all(folder).expect("the folder goes");
}

#[test]
fn phases_come_from_a_file_of_their_own_too() {
    let folder = folder("phases");
    let left = file(&folder, "left.csv", &left_hand());
    let phases = file(&folder, "phases.csv", "start_s,name\n0,approach\n2,dissection\n");
    let json = folder.join("skill.json").display().to_string();
    let (code, _, err) = run(&["eval", "skill", &left, "--phases", &phases, "--json", &json]);
    assert_eq!(code, 0, "{err}");
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&json).expect("the report")).expect("JSON");
    let path = |phase: &str| report["tools"][0]["phases"][phase]["path_mm"].as_f64().expect("a path");
    assert!((path("approach") - 20.0).abs() < 0.5 && (path("dissection") - 60.0).abs() < 0.5, "{report}");
    std::fs::remove_dir_all(folder).expect("the folder goes");
}

#[test]
fn files_that_are_no_tracks_are_named_with_what_to_give() {
    let folder = folder("wrong");
    let head = "seq,source,capture_ms,x_mm,y_mm,z_mm\n";
    let cases = [
        ("none.csv", "seq,source,capture_ms,distance_mm\n1,0,0,4\n".to_owned(), "no columns of positions"),
        ("time.csv", "x_mm,y_mm,z_mm\n1,2,3\n".to_owned(), "no column `capture_ms`"),
        ("back.csv", format!("{head}0,0,100,1,2,3\n1,0,50,1,2,3\n"), "line 3: time goes back"),
        ("cells.csv", format!("{head}0,0,100,1,2,3\n1,0\n2,0,200,1,2,3\n"), "line 3 has another number of cells"),
        ("clock.csv", format!("{head}0,0,soon,1,2,3\n"), "line 2 has no time"),
        ("words.jsonl", "{\"seq\":0,\"capture_ms\":1}\nwords\n{}\n".to_owned(), "line 2 is not JSON"),
        ("empty.csv", String::new(), "is empty"),
        ("unseen.csv", format!("{head}0,0,100,,,\n"), "no positions of a tip"),
    ];
    for (name, text, want) in cases {
        let (code, _, err) = run(&["eval", "skill", &file(&folder, name, &text)]);
        assert_eq!(code, 1, "{name}: {err}");
        assert!(err.contains(name) && err.contains(want), "{name}: {err}");
    }
    // A line that a crash cut off is lost, not wrong.
    let cut = format!("{}8,0,9100,cu", left_hand());
    let (code, out, err) = run(&["eval", "skill", &file(&folder, "cut.csv", &cut)]);
    assert!(code == 0 && out.contains("path, mm"), "{err}");
    let (code, _, err) = run(&["eval", "skill", "--html", "page.html"]);
    assert!(code == 2 && err.contains("need a track"), "{err}");
    std::fs::remove_dir_all(folder).expect("the folder goes");
}

#[test]
fn without_a_track_the_measures_are_less_than_a_hundredth_off_closed_forms() {
    let folder = folder("judge");
    let json = folder.join("figures.json").display().to_string();
    let (code, _, err) = run(&["eval", "skill", "--json", &json]);
    assert_eq!(code, 0, "{err}");
    let figures: Vec<serde_json::Value> =
        serde_json::from_str(&std::fs::read_to_string(&json).expect("figures")).expect("JSON");
    let worst = figures.iter().find(|figure| figure["name"] == "worst_error_pct").expect("the worst");
    assert!(worst["value"].as_f64().is_some_and(|percent| percent < 1.0), "{worst}");
    assert!(figures.iter().any(|figure| figure["name"] == "ldlj/reaches" && figure["peer"] == "closed form"));
    std::fs::remove_dir_all(folder).expect("the folder goes");
}

#[test]
fn a_rendered_circle_has_its_closed_form_though_pictures_are_lost() {
    let Some(plugins) = plugins(&["phantom", "sinks"]) else { return };
    let folder = folder("circle");
    // The tip circles at 12 mm in 5 s, with 0.3 of that in depth at twice the rate; from 7 s on it has its full radius. Ends after three turns.
    let graph = "mode = \"batch\"\nplugins = [\"phantom\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n\
        params = { width = 64, height = 48, distance_mm = 66.0, speed_mm_s = 0.0, tools = 1, tool_motion = \"circle\", drop_share = 0.1 }\n\
        [nodes.out]\ntype = \"write_table\"\ninputs = { tip = \"scope.lead\" }\nparams = { path = \"tip.csv\" }\n";
    let graph = file(&folder, "graph.toml", graph);
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
    let ran = command.env("PANOSCOPE_PLUGIN_PATH", plugins).args(["run", &graph, "--headless", "--frames", "661"]);
    let ran = ran.output().expect("it starts");
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let track = folder.join("tip.csv").display().to_string();
    let phases = file(&folder, "phases.csv", "0,begin\n7,turns\n");
    let json = folder.join("skill.json").display().to_string();
    let (code, _, err) = run(&["eval", "skill", &track, "--phases", &phases, "--json", &json]);
    assert_eq!(code, 0, "{err}");
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&json).expect("the report")).expect("JSON");
    let measured = &report["tools"][0]["phases"]["turns"];
    let (radius, length) = (12.0_f64, 15.0_f64);
    let omega = std::f64::consts::TAU / 5.0;
    let speed =
        |k: i32| radius * omega * (1.0 + 0.36 * (f64::from(k) * 0.001 * std::f64::consts::TAU).cos().powi(2)).sqrt();
    let mean = (0..1000).map(speed).sum::<f64>() / 1000.0;
    // Jerk: r w^3 across, 2.4 r w^3 cos(2 w t) away.
    let jerk = radius * omega.powi(3) * (1.0 + 0.5 * 2.4 * 2.4_f64).sqrt();
    let peak = radius * omega * 1.36_f64.sqrt();
    for (name, want) in [
        ("time_s", length),
        ("path_mm", mean * length),
        ("mean_speed_mm_s", mean),
        ("peak_speed_mm_s", peak),
        ("jerk_rms_mm_s3", jerk),
        ("ldlj", -(length.powi(4) / (peak * peak) * jerk * jerk).ln()),
        ("box_x_mm", 2.0 * radius),
        ("box_z_mm", 0.6 * radius),
        ("depth_range_mm", 0.6 * radius),
        ("depth_path_mm", 3.0 * 8.0 * 0.3 * radius),
        ("movements", 1.0),
    ] {
        let value = measured[name].as_f64().unwrap_or(f64::NAN);
        assert!((value / want - 1.0).abs() < 0.01, "{name} is {value}, in closed form {want}");
    }
    std::fs::remove_dir_all(folder).expect("the folder goes");
}
