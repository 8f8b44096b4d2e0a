//! Licences of the crates linked into the programs.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use crate::linked::{Crate, linked};
use crate::workspace::Workspace;
use anyhow::{Context, Result};

/// Prefixes of the names of licence files.
const NAMES: [&str; 6] = ["LICEN", "COPYING", "NOTICE", "COPYRIGHT", "OFL", "UFL"];

/// The licences of all external crates linked into the workspace's programs and plugins: a list, then each text once.
///
/// # Errors
/// `cargo metadata` fails.
pub fn notices(workspace: &Workspace) -> Result<String> {
    let crates = linked(workspace)?;
    let titles: Vec<String> = crates.iter().map(Crate::title).collect();
    let mut texts: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    let mut list =
        String::from("Panoscope's programs are linked with these crates. The texts of their licences follow.\n\n");
    for (one, title) in crates.iter().zip(&titles) {
        let _ = writeln!(list, "{title}: {}", one.licence.as_deref().unwrap_or("see its text"));
        for text in terms(&one.folder)? {
            texts.entry(text).or_default().push(title);
        }
    }
    list.push_str("\nThey contain the font Roboto Medium 2.138, reduced to Latin letters: Copyright 2011 Google Inc., Apache License 2.0.\n");
    for (text, users) in texts {
        let _ = write!(list, "\n{}\n{}\n\n{text}\n", "-".repeat(80), users.join(", "));
    }
    Ok(list)
}

/// The licence texts in a crate's folder, and of its fonts.
fn terms(folder: &Path) -> Result<Vec<String>> {
    let mut texts = Vec::new();
    for (folder, is_fonts) in [(folder.to_owned(), false), (folder.join("fonts"), true)] {
        let mut files: Vec<PathBuf> = fs::read_dir(&folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
        files.sort();
        for file in files.iter().filter(|file| file.is_file()) {
            let name = file.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
            if NAMES.iter().any(|start| name.starts_with(start)) || is_fonts && name.ends_with(".TXT") {
                let bytes = fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
                texts.push(String::from_utf8_lossy(&bytes).replace('\r', "").trim().to_owned());
            }
        }
    }
    Ok(texts)
}

#[cfg(test)]
mod tests {
    use spdx::{Expression, LicenseReq};

    use super::*;
    use crate::package::spdx;

    #[test]
    fn every_linked_crate_has_a_licence_that_is_allowed() {
        let workspace = Workspace::locate().unwrap();
        let rules: toml::Table = fs::read_to_string(workspace.root.join(".cargo/deny.toml")).unwrap().parse().unwrap();
        let allowed: Vec<&str> =
            rules["licenses"]["allow"].as_array().unwrap().iter().filter_map(toml::Value::as_str).collect();
        let is_allowed = |asked: &LicenseReq| allowed.contains(&asked.to_string().as_str());
        let fits = |licence: &str| Expression::parse(&spdx(licence)).is_ok_and(|terms| terms.evaluate(is_allowed));
        assert!(fits("MIT/Apache-2.0") && fits("GPL-3.0-only OR MIT") && !fits("GPL-3.0-only AND MIT"));
        let wrong: Vec<_> = linked(&workspace)
            .unwrap()
            .into_iter()
            .filter(|one| !one.licence.as_deref().is_some_and(fits))
            .map(|one| format!("{}: {}", one.title(), one.licence.as_deref().unwrap_or("none")))
            .collect();
        assert!(wrong.is_empty(), "not in .cargo/deny.toml: {wrong:#?}");
    }

    #[test]
    fn fonts_and_crates_of_the_windows_have_their_terms() {
        let notices = notices(&Workspace::locate().unwrap()).unwrap();
        for words in [
            "eframe 0.",
            "SIL OPEN FONT LICENSE",
            "UBUNTU FONT LICENCE",
            "Permission is hereby granted, free of charge",
        ] {
            assert!(notices.contains(words), "{words}");
        }
    }
}
