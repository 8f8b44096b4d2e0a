//! Showing worklist entries, and asking which one it is.

use std::io::{BufRead, IsTerminal, Write};

use anyhow::{Result, bail};
use panoscope_engine::text_table::table as text_table;
use panoscope_export::dicom::Entry;

use panoscope_cli::terminal::log;

/// A name in natural order: `Müller, Änne` of `Müller^Änne`.
fn name(patient: &str) -> String {
    let alphabetic = patient.split('=').find(|group| !group.is_empty()).unwrap_or_default();
    let mut parts = alphabetic.split('^').filter(|part| !part.is_empty());
    let family = parts.next().unwrap_or_default();
    let given: Vec<&str> = parts.collect();
    if given.is_empty() { family.to_owned() } else { format!("{family}, {}", given.join(" ")) }
}

/// `2026-03-09` of `20260309`.
fn date(day: &str) -> String {
    match day.is_ascii() && day.len() == 8 {
        true => format!("{}-{}-{}", &day[..4], &day[4..6], &day[6..]),
        false => day.to_owned(),
    }
}

/// `07:05` of `070500`.
fn time(clock: &str) -> String {
    match clock.is_ascii() && clock.len() >= 4 {
        true => format!("{}:{}", &clock[..2], &clock[2..4]),
        false => clock.to_owned(),
    }
}

/// Entries as a table, numbered from 1.
pub fn table(entries: &[Entry]) -> String {
    if entries.is_empty() {
        return "no entries".to_owned();
    }
    let head = ["", "accession", "step", "patient ID", "name", "born", "sex", "scheduled", "", "modality", "procedure"];
    let row = |(number, entry): (usize, &Entry)| {
        vec![
            (number + 1).to_string(),
            entry.accession.clone(),
            entry.step.0.clone(),
            entry.patient_id.clone(),
            name(&entry.patient_name),
            date(&entry.birth_date),
            entry.sex.clone(),
            date(&entry.start.0),
            time(&entry.start.1),
            entry.modality.clone(),
            if entry.step.1.is_empty() { entry.requested.1.clone() } else { entry.step.1.clone() },
        ]
    };
    let rows: Vec<Vec<String>> = entries.iter().enumerate().map(row).collect();
    let whole: Vec<Vec<String>> = std::iter::once(head.map(str::to_owned).to_vec()).chain(rows).collect();
    text_table(&whole).trim_end().to_owned()
}

/// Asks for the entry, then for confirmation of the patient; `None` if it is not confirmed.
///
/// # Errors There are no entries, or there is no terminal.
pub fn ask(entries: &[Entry]) -> Result<Option<&Entry>> {
    if entries.is_empty() {
        bail!("the worklist has no entries for this query: see --date, --modality and --station");
    }
    if !std::io::stdin().is_terminal() {
        bail!("there is no terminal to ask on: choose the entry with --entry");
    }
    log!("{}", table(entries));
    let Some(entry) = line("Number of the entry: ")?.parse().ok().and_then(|n: usize| entries.get(n.checked_sub(1)?))
    else {
        return Ok(None);
    };
    let words =
        format!("{}, born {}, {}: type yes: ", name(&entry.patient_name), date(&entry.birth_date), entry.patient_id);
    Ok((line(&words)? == "yes").then_some(entry))
}

fn line(question: &str) -> Result<String> {
    let mut error = std::io::stderr().lock();
    write!(error, "{question}")?;
    error.flush()?;
    let mut answer = String::new();
    std::io::stdin().lock().read_line(&mut answer)?;
    Ok(answer.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_dates_are_readable() {
        assert_eq!(name("Müller^Änne^^Dr."), "Müller, Änne Dr.");
        assert_eq!(name("=山田^太郎"), "山田, 太郎");
        assert_eq!((date("19700102").as_str(), date("x").as_str()), ("1970-01-02", "x"));
        assert_eq!((time("0705").as_str(), time("").as_str()), ("07:05", ""));
        let entry = Entry { patient_name: "Müller^Änne".into(), accession: "A1".into(), ..Entry::default() };
        let table = table(&[entry]);
        assert!(table.contains("Müller, Änne") && table.contains("A1"), "{table}");
    }
}
