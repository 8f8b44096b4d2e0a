//! `panoscope import`.

use std::path::{Path, PathBuf};

use anyhow::Result;
use panoscope_data::data_sets::{self as data_sets, Found, KNOWN, MAX_LEVELS, Pictures, Sequence};
use panoscope_engine::text_table::table;
use serde_json::{Value, json};

use panoscope_cli::End;
use panoscope_cli::terminal::{log, out};

/// Overlay that plays a sequence.
const OVERLAY: &str = "graphs/sources/data_set.toml";

/// Arguments of `import`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folder of a data set, or of several.
    folder: PathBuf,
    /// As JSON: all properties of each sequence.
    #[arg(long)]
    json: bool,
}

/// Content of a calibration.
enum Cameras {
    None,
    Read { baseline_mm: f64, is_rectified: bool },
    Damaged(String),
}

/// Reads the calibration of the first image that has one.
fn cameras(sequence: &Sequence) -> Cameras {
    let Some(files) = &sequence.calibration else { return Cameras::None };
    let Some(picture) = files.sets.iter().position(|set| !set.is_empty()) else { return Cameras::None };
    match files.read(picture) {
        Ok(Some(read)) => Cameras::Read { baseline_mm: read.baseline_mm, is_rectified: read.is_rectified != 0 },
        Ok(None) => Cameras::None,
        Err(error) => Cameras::Damaged(error.to_string()),
    }
}

fn kind(sequence: &Sequence) -> &'static str {
    match &sequence.pictures {
        Pictures::Files { .. } => "pictures",
        Pictures::Video { .. } => "video",
    }
}

/// A cell for data that only some images have.
fn share(count: usize, sequence: &Sequence, words: &str) -> String {
    match sequence.count() {
        Some(all) if count < all => format!("{words} ({count})"),
        None => format!("{words} ({count})"),
        _ => words.to_owned(),
    }
}

fn row(sequence: &Sequence, cameras: &Cameras) -> Vec<String> {
    let dash = || "-".to_owned();
    let size = sequence.crop.map(|[_, _, width, height]| (width, height)).or(sequence.size);
    vec![
        sequence.name.clone(),
        sequence.data_set.to_owned(),
        sequence.count().map_or_else(|| "video".to_owned(), |count| count.to_string()),
        size.map_or_else(dash, |(width, height)| format!("{width}x{height}")),
        sequence.views().to_string(),
        match cameras {
            Cameras::None => dash(),
            Cameras::Read { baseline_mm, is_rectified } => {
                format!("{baseline_mm:.2} mm{}", if *is_rectified { ", rectified" } else { "" })
            }
            Cameras::Damaged(_) => "damaged".to_owned(),
        },
        sequence.truth.as_ref().map_or_else(dash, |truth| share(truth.count(), sequence, truth.holds.words())),
        sequence.labels.as_ref().map_or_else(dash, |labels| share(labels.count(), sequence, labels.words())),
    ]
}

/// Remarks of a sequence, with mistakes in its calibration.
fn remarks(sequence: &Sequence, cameras: &Cameras) -> Vec<String> {
    let mut all = sequence.remarks.clone();
    if let Cameras::Damaged(why) = cameras {
        all.push(why.clone());
    }
    all
}

fn as_json(sequence: &Sequence) -> Value {
    let cameras = cameras(sequence);
    let calibration = sequence.calibration.as_ref().map(|files| {
        let (baseline_mm, is_rectified, error) = match &cameras {
            Cameras::Read { baseline_mm, is_rectified } => (Some(baseline_mm), Some(is_rectified), None),
            Cameras::Damaged(why) => (None, None, Some(why)),
            Cameras::None => (None, None, None),
        };
        let files = if files.is_per_picture() { Value::from("one for each picture") } else { json!(files.sets[0]) };
        json!({ "files": files, "baseline_mm": baseline_mm, "is_rectified": is_rectified, "error": error })
    });
    json!({
        "sequence": sequence.name,
        "data_set": sequence.data_set,
        "folder": sequence.folder,
        "kind": kind(sequence),
        "pictures": sequence.count(),
        "size": sequence.size,
        "crop": sequence.crop,
        "views": sequence.views(),
        "calibration": calibration,
        "truth": sequence.truth.as_ref().map(|truth| {
            json!({ "holds": truth.holds.words(), "pictures": truth.count(), "divisor": truth.divisor })
        }),
        "labels": sequence.labels.as_ref().map(|labels| {
            json!({ "kind": labels.words(), "pictures": labels.count(), "classes": labels.classes() })
        }),
        "remarks": remarks(sequence, &cameras),
    })
}

/// Reports the known layouts.
fn nothing(folder: &Path, found: &Found) {
    log!(
        "no data set of a known layout in {} ({} folders searched, down to {MAX_LEVELS} levels)",
        folder.display(),
        found.folders
    );
    for remark in &found.remarks {
        log!("    {remark}");
    }
    log!("A sequence is known by what its folder holds:");
    for known in KNOWN {
        log!("    {}: {}", known.data_set, known.holds);
    }
    log!("Other files are sources, too: graphs/sources/files.toml takes two videos, folders or patterns of pictures.");
}

/// The command that plays a sequence.
fn command(folder: &Path, sequence: &Sequence) -> String {
    let quoted = |text: &str| {
        let is_plain = text.chars().all(|c| c.is_alphanumeric() || "_-./".contains(c));
        if is_plain { text.to_owned() } else { format!("'{}'", text.replace('\'', r"'\''")) }
    };
    let graph = match (sequence.views(), sequence.calibration.is_some()) {
        (2, true) => "graphs/depth.toml",
        (2, false) => "graphs/panorama.toml",
        _ => "graphs/tools_judged.toml",
    };
    let folder = quoted(&folder.display().to_string());
    format!("panoscope run {graph} --with {OVERLAY} --folder {folder} --sequence {}", quoted(&sequence.name))
}

/// Lists the sequences of data sets.
pub fn run(arguments: &Arguments) -> Result<End> {
    let folder = &arguments.folder;
    let found = match data_sets::find(folder) {
        Ok(found) => found,
        Err(error) => {
            log!("error: {error}");
            return Ok(End::Wrong);
        }
    };
    if arguments.json {
        let sequences: Vec<Value> = found.sequences.iter().map(as_json).collect();
        let known: Vec<Value> =
            KNOWN.iter().map(|known| json!({ "data_set": known.data_set, "holds": known.holds })).collect();
        let all = json!({
            "folder": folder,
            "sequences": sequences,
            "remarks": found.remarks,
            "folders_searched": found.folders,
            "known": known,
        });
        out!("{}", serde_json::to_string_pretty(&all)?);
        return Ok(if found.sequences.is_empty() { End::Failed } else { End::Done });
    }
    let Some(first) = found.sequences.first() else {
        nothing(folder, &found);
        return Ok(End::Failed);
    };
    let head = ["sequence", "data set", "pictures", "size", "views", "calibration", "truth", "labels"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    let mut notes: Vec<(String, Vec<&str>)> = Vec::new();
    for sequence in &found.sequences {
        let cameras = cameras(sequence);
        rows.push(row(sequence, &cameras));
        for remark in remarks(sequence, &cameras) {
            // A remark that holds for many sequences is shown once.
            match notes.iter_mut().find(|(known, _)| *known == remark) {
                Some((_, names)) => names.push(&sequence.name),
                None => notes.push((remark, vec![&sequence.name])),
            }
        }
    }
    out!("{}", table(&rows).trim_end());
    for (remark, names) in &notes {
        match names[..] {
            [one] => out!("  {one}: {remark}"),
            [one, ..] => out!("  {one} and {} more: {remark}", names.len() - 1),
            [] => {}
        }
    }
    for remark in &found.remarks {
        out!("  {remark}");
    }
    out!("\n{}", command(folder, first));
    Ok(End::Done)
}
