//! What the theatre believes, and what it writes into its audit log.

use std::path::{Path, PathBuf};

use crate::common::window::{GRAPH, Window, options};
use crate::common::{Folder, has_plugin};
use eframe::egui::{Context, Key};
use panoscope_graph::{GraphText, ParamValue, check};
use panoscope_host::audit::{ClipState, Event, Report, date, read};
use panoscope_host::loader::keys::{SecretKey, Trust};
use panoscope_host::loader::lock::{ALWAYS_LOCKED, Lock, LockError};
use panoscope_host::loader::{self as loader, Loader};
use panoscope_theatre::{OpenError, Options, Theatre, Verified};

/// Locks the graph file, signed where there is a key.
pub fn lock(path: &Path, key: Option<&SecretKey>) {
    let loader = Loader::search(&loader::search_path(&[]));
    let text = GraphText::load(path).expect("it is there");
    let catalog = loader.catalog(&text.plugins());
    let (graph, _) = check(&text, &catalog).into_result().expect("it is right");
    let mut lock = Lock::of(&graph, &catalog, &loader, &text, &ALWAYS_LOCKED);
    if let Some(key) = key {
        lock.sign(key);
    }
    lock.write(path).expect("it is written");
}

/// A new key and the trust in it.
fn key(folder: &Folder, name: &str) -> (SecretKey, Trust) {
    let file = folder.0.join(name);
    let public = SecretKey::create(&file).expect("a key");
    let mut trust = Trust::default();
    trust.add(public);
    (SecretKey::read(&file).expect("a key"), trust)
}

fn open(path: &Path, options: Options) -> Result<(), OpenError> {
    Theatre::open(&Context::default(), path, GRAPH, options).map(drop)
}

#[test]
fn who_trusts_keys_opens_only_what_they_signed() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("trust");
    let path = folder.write("g.toml", GRAPH);
    let ((ward, trust), (stranger, other)) = (key(&folder, "ward"), key(&folder, "stranger"));
    let with = |trust: &Trust| Options { trust: trust.clone(), ..options(&folder) };
    let refused = |trust: &Trust| match open(&path, with(trust)) {
        Err(OpenError::Lock(error)) => error,
        other => panic!("{other:?}"),
    };
    assert!(matches!(refused(&trust), LockError::Never { .. }));
    lock(&path, None);
    assert!(matches!(refused(&trust), LockError::Unsigned { .. }));
    open(&path, options(&folder)).expect("nobody is trusted here, so nobody need sign");
    lock(&path, Some(&stranger));
    assert!(matches!(refused(&trust), LockError::UnknownKey { .. }));
    assert!(matches!(refused(&Trust::default()), LockError::UnknownKey { .. }));
    open(&path, with(&other)).expect("it is trusted there");
    lock(&path, Some(&ward));
    let file = panoscope_host::loader::lock::lock_path(&path);
    let whole = std::fs::read_to_string(&file).expect("the lock");
    std::fs::write(&file, whole.replacen("bytes = ", "bytes = 1", 1)).expect("written");
    assert!(matches!(refused(&trust), LockError::Altered { .. }));
    std::fs::write(&file, &whole).expect("written");
    // Overridden, it is marked.
    std::fs::write(&file, whole.replacen("bytes = ", "bytes = 1", 1)).expect("written");
    open(&path, Options { unlocked: true, ..with(&trust) }).expect("overridden");
    std::fs::write(&file, &whole).expect("written");
    let options = with(&trust);
    let window = Window::open_with(folder, &path, options);
    assert_eq!(*window.theatre().verified(), Verified::Signed("ward".to_owned()));
    assert_eq!(window.theatre().verified().mark(), None);
}

/// The log in a folder.
fn log(folder: &Folder) -> Report {
    read(&folder.0).expect("it can be read")
}

fn events(report: &Report) -> Vec<Event> {
    report.entries.iter().map(|entry| entry.event.clone()).collect()
}

#[test]
fn what_happens_in_the_theatre_is_logged_without_names() {
    if !has_plugin("flow") || !has_plugin("sinks") {
        return;
    }
    let (folder, kept) = (Folder::new("logged"), Folder::new("logged_audit"));
    let path = folder.write("g.toml", &GRAPH.replace("type = \"drain\"", "type = \"device\""));
    lock(&path, None);
    let options = Options { audit: Some(kept.0.clone()), label: Some("Miller".to_owned()), ..options(&folder) };
    let mut window = Window::open_with(folder, &path, options);
    window.until("a picture is there", Theatre::has_picture);
    let theatre = |window: &mut Window, act: &dyn Fn(&mut Theatre)| {
        act(window.harness.state_mut().as_mut().expect("it is open"));
    };
    // A slider that is dragged gives one line.
    for value in [60, 70, 80] {
        theatre(&mut window, &|t| t.choose("calm", "past_weight", ParamValue::Int(value)));
    }
    window.key(Key::S);
    window.until("the still is saved", |t| t.remark().is_some_and(|r| r.contains("is saved")));
    window.key(Key::R);
    window.until("the clip runs", |t| {
        t.session().expect("it runs here").handle().engine().is_some_and(|e| e.graph().node("theatre_clip").is_some())
    });
    window.key(Key::R);
    window.key(Key::E);
    window.until("the arm is stopped", Theatre::is_stopped);
    drop(window);
    let report = log(&kept);
    assert!(report.problems.is_empty(), "{report:?}");
    let all = events(&report);
    assert!(matches!(&all[0], Event::Opened { graph, lock: Some(_), .. } if graph == "g.toml"), "{all:?}");
    let setting = Event::Setting { node: "calm".to_owned(), param: "past_weight".to_owned(), value: "80".to_owned() };
    let expected = [
        setting,
        Event::Still { number: 1 },
        Event::Clip { number: 2, state: ClipState::Started },
        Event::Clip { number: 2, state: ClipState::Ended },
        Event::EmergencyStop { stopped: true },
        Event::Closed,
    ];
    assert_eq!(all[1..], expected);
    for file in std::fs::read_dir(&kept.0).expect("the log") {
        let text = std::fs::read_to_string(file.expect("a file").path()).expect("text");
        assert!(!text.contains("Miller") && !text.contains("clip_0002"), "{text}");
    }
}

#[test]
fn overrides_refusals_and_faults_are_logged() {
    if !has_plugin("flow") || !has_plugin("fixtures") {
        return;
    }
    let (folder, kept) = (Folder::new("overrides"), Folder::new("overrides_audit"));
    let path = folder.write("g.toml", GRAPH);
    lock(&path, None);
    let failing = GRAPH.replace(
        "type = \"smooth\"\ninputs = { image = \"camera.image\" }\nparams = { past_weight = 100 }",
        "type = \"failing\"\ninputs = { image = \"camera.image\" }\nparams = { first = 3 }",
    );
    let failing =
        failing.replace("\npinned = [{ param = \"calm.past_weight\", range = [50, 150], label = \"calmness\" }]", "");
    std::fs::write(&path, &failing).expect("written");
    let audited = Options { audit: Some(kept.0.clone()), ..options(&folder) };
    let refused = Theatre::open(&Context::default(), &path, &failing, audited.clone()).map(drop);
    assert!(matches!(refused, Err(OpenError::Locked(_))), "{refused:?}");
    let options = Options { unlocked: true, ..audited };
    let mut window = Window::open_with(folder, &path, options);
    window.until("the node has failed", |t| {
        t.session()
            .expect("it runs here")
            .handle()
            .engine()
            .is_some_and(|e| e.recent_faults().iter().any(|f| f.node == "calm"))
    });
    window.until_notice("Stage `calm`");
    drop(window);
    let all = events(&log(&kept));
    assert!(matches!(&all[0], Event::Refused { graph, .. } if graph == "g.toml"), "{all:?}");
    let overridden = all.iter().position(|event| matches!(event, Event::Override { by, .. } if by == "--unlocked"));
    let opened = all.iter().position(|event| matches!(event, Event::Opened { lock: None, .. }));
    assert!(overridden.is_some() && overridden < opened, "{all:?}");
    assert!(all.iter().any(|event| matches!(event, Event::Fault { node, .. } if node == "calm")), "{all:?}");
}

/// Today's file and tomorrow's, whatever day it is when the event is written.
fn files_of_today(folder: &Path) -> [PathBuf; 2] {
    let now = std::time::UNIX_EPOCH.elapsed().expect("after 1970").as_millis();
    let now = i64::try_from(now).expect("it fits");
    [now, now + 86_400_000].map(|day| folder.join(format!("audit-{}.jsonl", date(day))))
}

#[test]
fn a_full_disk_does_not_stop_the_theatre_and_is_shown() {
    if !has_plugin("flow") {
        return;
    }
    let (folder, kept) = (Folder::new("full"), Folder::new("full_audit"));
    for file in files_of_today(&kept.0) {
        std::os::unix::fs::symlink("/dev/full", file).expect("a link");
    }
    let path = folder.write("g.toml", GRAPH);
    let options = Options { audit: Some(kept.0.clone()), ..options(&folder) };
    let mut window = Window::open_with(folder, &path, options);
    window.until("a picture is there", Theatre::has_picture);
    window.until_notice("The audit log is not written: the disk is full");
    // As soon as there is space, the log goes on where it began.
    for file in files_of_today(&kept.0) {
        let _ = std::fs::remove_file(file);
    }
    window.until("the notice is gone", |t| !t.notices().iter().any(|n| n.message.contains("audit log")));
    drop(window);
    let report = log(&kept);
    assert!(report.problems.is_empty(), "{report:?}");
    assert!(matches!(events(&report)[..], [Event::Opened { .. }, .., Event::Closed]), "{report:?}");
}
