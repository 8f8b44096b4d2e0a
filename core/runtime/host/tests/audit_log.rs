//! The log finds every change of its lines, survives crashes and full disks.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use panoscope_host::audit::{Auditor, ClipState, Event, LockFacts, Log, Report, date, read};

/// 2026-03-01 00:00:00.250 UTC.
const DAY: i64 = 1_772_323_200_250;
const NEXT_DAY: i64 = DAY + 86_400_000;

struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("panoscope_audit_{name}_{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        Self(folder)
    }

    fn file(&self, day: i64) -> PathBuf {
        self.0.join(format!("audit-{}.jsonl", date(day)))
    }

    fn lines(&self, day: i64) -> Vec<String> {
        fs::read_to_string(self.file(day)).expect("it is there").lines().map(str::to_owned).collect()
    }

    fn write_lines(&self, day: i64, lines: &[String]) {
        let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
        fs::write(self.file(day), text).expect("written");
    }

    fn report(&self) -> Report {
        read(&self.0).expect("it can be read")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn events() -> Vec<Event> {
    let lock = LockFacts { sha256: "ab".repeat(32), signed_by: Some("ward".to_owned()) };
    vec![
        Event::Opened {
            program: "0.1.0".to_owned(),
            graph: "surgeon.toml".to_owned(),
            graph_sha256: "cd".repeat(32),
            lock: Some(lock),
        },
        Event::Setting { node: "wide".to_owned(), param: "blend_px".to_owned(), value: "12".to_owned() },
        Event::Fault { node: "match".to_owned(), cause: "hang".to_owned(), done: "restart".to_owned() },
        Event::Clip { number: 7, state: ClipState::Started },
        Event::EmergencyStop { stopped: true },
        Event::Closed,
    ]
}

fn written(folder: &Folder) -> Log {
    let log = Log::new(&folder.0);
    for event in events() {
        log.append(DAY, event).expect("written");
    }
    log
}

fn messages(report: &Report) -> Vec<String> {
    report.problems.iter().map(|problem| problem.message.clone()).collect()
}

#[test]
fn events_are_read_back_in_their_order() {
    let folder = Folder::new("order");
    assert_eq!(folder.report(), Report::default(), "a log that does not exist is empty");
    written(&folder);
    let report = folder.report();
    assert!(report.problems.is_empty(), "{report:?}");
    assert_eq!(report.entries.iter().map(|entry| entry.event.clone()).collect::<Vec<_>>(), events());
    assert_eq!(report.entries.iter().map(|entry| entry.number).collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6]);
    assert_eq!(report.last.map(|(number, hash)| (number, hash.len())), Some((6, 64)));
    let shown: Vec<String> = report.entries.iter().map(ToString::to_string).collect();
    assert!(shown[0].contains("2026-03-01 00:00:00.250 UTC") && shown[0].contains("signed by ward"), "{shown:?}");
    assert!(shown[4].ends_with("emergency stop"), "{shown:?}");
    let mode = |path: &Path| fs::metadata(path).expect("it is there").permissions().mode() & 0o777;
    assert_eq!((mode(&folder.0), mode(&folder.file(DAY))), (0o700, 0o600), "others cannot read it");
}

#[test]
fn changed_removed_added_and_moved_lines_are_found() {
    let folder = Folder::new("changed");
    written(&folder);
    let whole = folder.lines(DAY);
    let problems = |lines: &[String]| {
        folder.write_lines(DAY, lines);
        messages(&folder.report())
    };
    assert!(problems(&whole).is_empty());
    let mut lines = whole.clone();
    lines[1] = lines[1].replace("\"12\"", "\"13\"");
    assert!(problems(&lines)[0].contains("damaged"), "{:?}", problems(&lines));
    let mut lines = whole.clone();
    lines.remove(2);
    assert_eq!(problems(&lines), ["lines 3 to 3 are missing before this one"]);
    let mut lines = whole.clone();
    lines.swap(2, 3);
    assert!(!problems(&lines).is_empty());
    let mut lines = whole.clone();
    lines.insert(3, whole[2].clone());
    assert!(problems(&lines)[0].contains("follows line 3"), "{:?}", problems(&lines));
    let mut lines = whole.clone();
    lines.insert(2, "{\"hello\":1}".to_owned());
    assert!(problems(&lines)[0].contains("damaged"));
    // Cut at the end of a line: only the head knows.
    assert_eq!(problems(&whole[..4]), ["lines 5 to 6 are missing at the end"]);
    assert_eq!(problems(&[]), ["lines 1 to 6 are missing at the end"]);
    // The same of one file alone cannot be known, but what is inside can.
    folder.write_lines(DAY, &whole[1..4]);
    assert!(read(&folder.file(DAY)).expect("read").problems.is_empty());
    folder.write_lines(DAY, &[whole[1].clone(), whole[3].clone()]);
    assert_eq!(read(&folder.file(DAY)).expect("read").problems.len(), 1);
    // A head that is gone, too.
    folder.write_lines(DAY, &whole);
    fs::remove_file(folder.0.join("head.json")).expect("removed");
    assert!(messages(&folder.report())[0].contains("missing or damaged"));
}

#[test]
fn a_line_that_a_crash_cut_off_is_named_and_the_log_goes_on() {
    let folder = Folder::new("crash");
    let log = written(&folder);
    let whole = fs::read(folder.file(DAY)).expect("read");
    let head = fs::read(folder.0.join("head.json")).expect("read");
    log.append(DAY, Event::Restarted).expect("written");
    let longer = fs::read(folder.file(DAY)).expect("read");
    for cut in [whole.len() + 1, (whole.len() + longer.len()) / 2, longer.len() - 2] {
        fs::write(folder.file(DAY), &longer[..cut]).expect("written");
        fs::write(folder.0.join("head.json"), &head).expect("written");
        assert!(messages(&folder.report())[0].contains("cut off"), "{:?}", folder.report());
        log.append(DAY, Event::Closed).expect("written");
        let report = folder.report();
        assert!(report.problems.is_empty(), "{report:?}");
        let last: Vec<Event> = report.entries.iter().rev().take(2).map(|entry| entry.event.clone()).collect();
        let cut_bytes = (cut - whole.len()) as u64;
        assert!(matches!(&last[1], Event::Recovered { cut_bytes: n, .. } if *n == cut_bytes), "{last:?}");
        assert_eq!((&last[0], report.entries.len()), (&Event::Closed, 8));
    }
    // A crash between the line and its head, or before its line feed: the line counts.
    for end in [longer.len(), longer.len() - 1] {
        fs::write(folder.file(DAY), &longer[..end]).expect("written");
        fs::write(folder.0.join("head.json"), &head).expect("written");
        assert!(folder.report().problems.is_empty());
        log.append(DAY, Event::Closed).expect("written");
        let report = folder.report();
        assert!(report.problems.is_empty() && report.entries.len() == 8, "{report:?}");
        assert_eq!(report.entries[6].event, Event::Restarted);
    }
}

#[test]
fn a_fragment_that_was_not_left_by_a_crash_is_no_excuse() {
    let folder = Folder::new("excuse");
    let log = written(&folder);
    let mut text = fs::read_to_string(folder.file(DAY)).expect("read");
    text.push_str("{\"line\":7,");
    fs::write(folder.file(DAY), &text).expect("written");
    log.append(DAY, Event::Closed).expect("written");
    assert!(folder.report().problems.is_empty());
    // The line that names the fragment does not cover another one.
    let text = fs::read_to_string(folder.file(DAY)).expect("read").replace("{\"line\":7,\n", "{\"line\":8,\n");
    fs::write(folder.file(DAY), text).expect("written");
    assert!(messages(&folder.report())[0].contains("damaged"));
}

#[test]
fn a_log_that_was_cut_says_so_when_it_is_continued() {
    let folder = Folder::new("cut");
    let log = written(&folder);
    let whole = folder.lines(DAY);
    folder.write_lines(DAY, &whole[..3]);
    log.append(DAY, Event::Closed).expect("written");
    let report = folder.report();
    let all = messages(&report).join("; ");
    assert!(
        all.contains("lines 4 to 6 are missing") && all.contains("was damaged when this line was written"),
        "{all}"
    );
    // A whole file, too.
    fs::remove_file(folder.file(DAY)).expect("removed");
    log.append(NEXT_DAY, Event::Closed).expect("written");
    assert!(messages(&folder.report()).join("; ").contains("are missing"));
}

#[test]
fn every_day_has_its_file_and_the_chain_goes_through_all() {
    let folder = Folder::new("days");
    let log = written(&folder);
    log.append(NEXT_DAY, Event::Restarted).expect("written");
    // A clock that is set back does not break the order.
    log.append(DAY, Event::Closed).expect("written");
    assert_eq!((folder.lines(DAY).len(), folder.lines(NEXT_DAY).len()), (6, 2));
    let report = folder.report();
    assert!(report.problems.is_empty() && report.entries.len() == 8, "{report:?}");
    fs::remove_file(folder.file(DAY)).expect("removed");
    assert_eq!(messages(&folder.report()), ["lines 1 to 6 are missing before this one"]);
}

#[test]
fn several_writers_make_one_chain() {
    let folder = Folder::new("several");
    std::thread::scope(|scope| {
        for writer in 0..4 {
            let log = Log::new(&folder.0);
            scope.spawn(move || {
                for number in 0..10 {
                    log.append(DAY, Event::Still { number: 100 * writer + number }).expect("written");
                }
            });
        }
    });
    let report = folder.report();
    assert!(report.problems.is_empty() && report.entries.len() == 40, "{:?}", report.problems);
}

#[test]
fn a_log_that_is_read_while_it_is_written_is_whole() {
    for _ in 0..10 {
        let folder = Folder::new("beside");
        fs::create_dir_all(&folder.0).expect("a folder");
        std::thread::scope(|scope| {
            let writer = scope.spawn(|| written(&folder));
            while !writer.is_finished() {
                assert_eq!(messages(&folder.report()), [""; 0]);
            }
        });
        assert_eq!(folder.report().entries.len(), events().len());
    }
}

#[test]
fn a_full_disk_is_named_and_events_wait_for_space() {
    let folder = Folder::new("full");
    fs::create_dir_all(&folder.0).expect("a folder");
    // Whatever day it is when the event is written.
    let now = || i64::try_from(std::time::UNIX_EPOCH.elapsed().expect("after 1970").as_millis()).expect("fits");
    for day in [now(), now() + 86_400_000] {
        symlink("/dev/full", folder.file(day)).expect("a link");
    }
    let mut auditor = Auditor::new(&folder.0).expect("it starts");
    auditor.log(Event::Restarted);
    auditor.log(Event::Closed);
    let wait = |what: &str, is_so: &dyn Fn() -> bool| {
        let until = Instant::now() + Duration::from_secs(30);
        while !is_so() {
            assert!(Instant::now() < until, "not within 30 s: {what}");
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    wait("the full disk is named", &|| auditor.problem().is_some_and(|problem| problem.contains("the disk is full")));
    for day in [now(), now() + 86_400_000] {
        let _ = fs::remove_file(folder.file(day));
    }
    wait("there is space again", &|| auditor.problem().is_none());
    auditor.close();
    let report = folder.report();
    assert!(report.problems.is_empty(), "{report:?}");
    let kept: Vec<Event> = report.entries.into_iter().map(|entry| entry.event).collect();
    assert_eq!(kept, [Event::Restarted, Event::Closed]);
}

#[test]
fn no_event_has_a_field_for_words_of_the_user() {
    // Who adds a field decides here whether it can hold patient data.
    let known = [
        "event",
        "program",
        "graph",
        "graph_sha256",
        "lock",
        "by",
        "reason",
        "node",
        "param",
        "value",
        "cause",
        "done",
        "line",
        "number",
        "state",
        "stopped",
        "count",
        "cut_bytes",
        "cut_sha256",
        "unix_ms",
        "before",
        "hash",
    ];
    let folder = Folder::new("fields");
    let log = written(&folder);
    for event in [
        Event::Override { by: "--unlocked".to_owned(), reason: "plugin `stitch` has changed".to_owned() },
        Event::Refused { graph: "g.toml".to_owned(), reason: "not signed".to_owned() },
        Event::Still { number: 3 },
        Event::CamerasOnly,
        Event::Lost { count: 2 },
        Event::Recovered { cut_bytes: 1, cut_sha256: String::new() },
        Event::Damaged { reason: String::new() },
    ] {
        log.append(DAY, event).expect("written");
    }
    for line in folder.lines(DAY) {
        let value: serde_json::Value = serde_json::from_str(&line).expect("JSON");
        for key in value.as_object().expect("an object").keys() {
            assert!(known.contains(&key.as_str()), "{key}");
        }
    }
}

#[test]
fn a_log_whose_files_were_all_deleted_is_damaged() {
    let folder = Folder::new("deleted");
    let log = written(&folder);
    log.append(NEXT_DAY, Event::Closed).expect("written");
    for day in [DAY, NEXT_DAY] {
        fs::remove_file(folder.file(day)).expect("removed");
    }
    let count = events().len() + 1;
    assert_eq!(messages(&folder.report()), [format!("lines 1 to {count} are missing at the end")]);
    // A head that cannot be read is no empty log either.
    fs::write(folder.0.join("head.json"), "{}").expect("written");
    assert_eq!(messages(&folder.report()), ["it is missing or damaged, so a cut-off end cannot be noticed"]);
    fs::remove_file(folder.0.join("head.json")).expect("removed");
    assert_eq!(folder.report(), Report::default());
}
