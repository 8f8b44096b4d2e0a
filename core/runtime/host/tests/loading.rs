//! Files in a plugin folder are checked before they are loaded; unusable ones are reported.

use std::path::{Path, PathBuf};

use crate::common::{flow_plugin, scratch};
use panoscope_abi as abi;
use panoscope_graph::{GraphText, check};
use panoscope_host::loader::{Loader, inspect};

/// A fresh folder with one file in it.
fn folder_with(name: &str, file: &str, bytes: &[u8]) -> PathBuf {
    let folder = scratch(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::write(folder.join(file), bytes).expect("a file");
    folder
}

fn flow_bytes() -> Vec<u8> {
    std::fs::read(flow_plugin()).expect("the flow plugin is readable")
}

/// Offset of the note's body.
fn note_body(bytes: &[u8]) -> usize {
    let owner = bytes.windows(abi::NOTE_OWNER.len()).position(|w| w == abi::NOTE_OWNER).expect("a note");
    owner + abi::NOTE_OWNER.len()
}

/// The message of the only problem of a folder.
fn problem(folder: &Path) -> String {
    let loader = Loader::search(&[folder.to_owned()]);
    assert_eq!(loader.found().count(), 0);
    let [problem] = loader.problems() else { panic!("{:?}", loader.problems()) };
    assert!(!problem.help.is_empty());
    problem.message.clone()
}

#[test]
fn the_whole_file_is_found_and_loads() {
    let folder = folder_with("whole", "libflow.so", &flow_bytes());
    let loader = Loader::search(&[folder]);
    assert!(loader.problems().is_empty(), "{:?}", loader.problems());
    assert_eq!(loader.offering("pass").len(), 1);
    let loaded = loader.load("flow").expect("it loads");
    let from_code: Vec<&str> = loaded.node_types.iter().map(|t| t.name.as_str()).collect();
    assert_eq!(from_code, loaded.plugin.note.node_types, "note and code agree");
}

#[test]
fn a_truncated_library_is_refused_before_it_is_mapped() {
    let whole = flow_bytes();
    for percent in (0..100).step_by(5) {
        let cut = &whole[..whole.len() * percent / 100];
        let folder = folder_with("cut", "libflow.so", cut);
        let message = problem(&folder);
        let expected = if percent == 0 { "the file is empty" } else { "it is truncated" };
        assert!(message.contains(expected) && message.contains("libflow.so"), "{percent} %: {message}");
    }
    // The same when only the last byte is missing.
    let folder = folder_with("cut", "libflow.so", &whole[..whole.len() - 1]);
    assert!(problem(&folder).contains("it is truncated"));
}

#[test]
fn another_abi_is_refused_with_both_numbers_and_help() {
    let mut bytes = flow_bytes();
    let body = note_body(&bytes);
    let other = abi::ABI_MAJOR + 41;
    bytes[body..body + 4].copy_from_slice(&other.to_le_bytes());
    let folder = folder_with("abi", "libflow.so", &bytes);
    let message = problem(&folder);
    assert!(
        message.contains(&format!("ABI {other}")) && message.contains(&format!("has ABI {}", abi::ABI_MAJOR)),
        "{message}"
    );
    let loader = Loader::search(&[folder]);
    assert!(loader.problems()[0].help.contains("rebuild"), "{:?}", loader.problems());

    // A graph that lists the plugin gets the message at that position.
    let text = GraphText::parse("g.toml".as_ref(), "plugins = [\"flow\"]\n[nodes.a]\ntype = \"frames\"\n");
    let diagnostics = check(&text, &loader.catalog(&text.plugins())).into_result().unwrap_err().render(false);
    assert!(diagnostics.contains("g.toml:1:12") && diagnostics.contains("rebuild"), "{diagnostics}");
}

#[test]
fn a_newer_minor_number_is_fine() {
    let mut bytes = flow_bytes();
    let body = note_body(&bytes);
    bytes[body + 4..body + 8].copy_from_slice(&(abi::ABI_MINOR + 7).to_le_bytes());
    let folder = folder_with("minor", "libflow.so", &bytes);
    let loader = Loader::search(&[folder]);
    assert_eq!(loader.found().count(), 1);
    assert!(loader.load("flow").is_ok());
}

#[test]
fn a_note_with_another_name_than_the_code_is_refused() {
    let mut bytes = flow_bytes();
    let body = note_body(&bytes);
    bytes[body + 8..body + 12].copy_from_slice(b"flaw");
    let folder = folder_with("other_name", "libflow.so", &bytes);
    let error = Loader::search(&[folder]).load("flaw").err().expect("refused");
    assert!(error.message.contains("its note says `flaw`, its code says `flow`"), "{}", error.message);
}

#[test]
fn files_that_are_not_plugins_are_reported_or_ignored() {
    for (bytes, expected) in [
        (&b""[..], "the file is empty"),
        (b"hello", "it does not begin with ELF"),
        (b"\x7fELF", "it is truncated"),
        (&[0x7f; 5000], "it does not begin with ELF"),
    ] {
        let message = problem(&folder_with("garbage", "libodd.so", bytes));
        assert!(message.contains(expected), "{message}");
    }
    // Files without the ending `.so` are ignored.
    let folder = folder_with("others", "notes.txt", b"hello");
    let loader = Loader::search(&[folder, scratch("absent")]);
    assert!(loader.problems().is_empty());
}

#[test]
fn no_flipped_byte_crashes_the_reader() {
    let whole = flow_bytes();
    let section_table = u64::from_le_bytes(whole[40..48].try_into().expect("eight bytes")) as usize;
    let note = note_body(&whole);
    let offsets =
        (0..64).chain(64..64 + 56 * 8).chain(note - 24..note + 110).chain((section_table..whole.len()).step_by(7));
    for offset in offsets {
        for value in [0x00, 0xff, whole[offset] ^ 0x80] {
            let mut bytes = whole.clone();
            bytes[offset] = value;
            // Any result is fine, as long as the reader returns.
            let _ = panoscope_host::loader::elf::read_note(&bytes[..]);
        }
    }
}

#[test]
fn the_first_of_two_plugins_of_one_name_wins() {
    let first = folder_with("first", "libflow.so", &flow_bytes());
    let second = folder_with("second", "libflow.so", &flow_bytes());
    let loader = Loader::search(&[first.clone(), second]);
    assert_eq!(loader.found().count(), 1);
    assert!(loader.found().all(|f| f.file.starts_with(&first)));
}

#[test]
fn all_plugins_that_offer_a_type_are_named() {
    // A second plugin with the same types: the same library under another name, in its note and in its code.
    let mut bytes = flow_bytes();
    let body = note_body(&bytes);
    bytes[body + 8..body + 12].copy_from_slice(b"duct");
    let folder = folder_with("two", "libflow.so", &flow_bytes());
    std::fs::write(folder.join("libduct.so"), &bytes).expect("a file");
    let loader = Loader::search(std::slice::from_ref(&folder));
    let offering: Vec<&str> = loader.offering("pass").iter().map(|f| f.note.name.as_str()).collect();
    assert_eq!(offering, ["duct", "flow"]);
    assert!(inspect(&folder.join("libduct.so")).is_ok());
}

/// A lock with only this plugin.
fn lock_of(plugin: &str, file: &Path) -> panoscope_host::loader::lock::Lock {
    let sha256 = panoscope_host::loader::sealed::Fingerprint::of_file(file).expect("it is there").sha256;
    let bytes = std::fs::metadata(file).expect("it is there").len();
    let text = format!(
        "version = 2\nprogram = \"1\"\n[[file]]\nkind = \"plugin\"\nname = \"{plugin}\"\nbytes = {bytes}\nsha256 = \"{sha256}\"\n"
    );
    panoscope_host::loader::lock::Lock::parse(&text).expect("a lock")
}

#[test]
fn a_plugin_that_is_swapped_after_it_was_found_is_not_mapped() {
    let folder = folder_with("pinned", "libflow.so", &flow_bytes());
    let file = folder.join("libflow.so");
    let lock = lock_of("flow", &file);
    assert!(Loader::search(std::slice::from_ref(&folder)).pinned(&lock.files).load("flow").is_ok(), "as it was locked");
    let loader = Loader::search(std::slice::from_ref(&folder)).pinned(&lock.files);
    // Between the search and the loading.
    let mut other = flow_bytes();
    other.push(0);
    std::fs::write(&file, &other).expect("written");
    let problem = loader.load("flow").err().expect("refused");
    assert!(problem.message.contains("has changed since the graph was locked"), "{}", problem.message);
    // A search of the same folders keeps to the lock.
    assert!(loader.rescan().load("flow").is_err());
    assert!(Loader::search(std::slice::from_ref(&folder)).load("flow").is_ok(), "without a lock it loads");
    // A plugin that the lock does not have.
    let problem = Loader::search(&[folder]).pinned(&lock_of("other", &file).files).load("flow").err().expect("refused");
    assert!(problem.message.contains("the lock of the graph does not have it"), "{}", problem.message);
}

/// File descriptors of this process.
fn descriptors() -> usize {
    std::fs::read_dir("/proc/self/fd").expect("Linux has it").count()
}

#[test]
fn a_file_that_did_not_change_is_mapped_once() {
    let folder = folder_with("once", "libflow.so", &flow_bytes());
    let load = || {
        let loaded = Loader::search(std::slice::from_ref(&folder)).load("flow").expect("it loads");
        std::ptr::from_ref(loaded.entries[0])
    };
    let (first, before) = (load(), descriptors());
    (0..20).for_each(|_| assert_eq!(load(), first));
    assert_eq!(descriptors(), before);
    // A rebuilt file is another library; the earlier bytes are still mapped.
    let mut other = flow_bytes();
    other.push(0);
    std::fs::write(folder.join("libflow.so"), &other).expect("written");
    let rebuilt = load();
    assert_ne!(rebuilt, first);
    std::fs::write(folder.join("libflow.so"), flow_bytes()).expect("written");
    assert_eq!(load(), first);
    assert_eq!(descriptors(), before + 1);
}

#[test]
fn an_error_names_file_descriptors_when_there_are_none() {
    let folder = folder_with("limit", "libflow.so", &flow_bytes());
    let loader = Loader::search(&[folder]);
    // All but one, which reads the plugin's file: none is left for the copy.
    let mut files: Vec<std::fs::File> = Vec::new();
    let limit = libc::rlimit { rlim_cur: descriptors() as u64 + 8, rlim_max: descriptors() as u64 + 8 };
    // SAFETY: the limit is a local value; this test is the only one of its process.
    assert_eq!(unsafe { libc::setrlimit(libc::RLIMIT_NOFILE, &raw const limit) }, 0);
    while let Ok(file) = std::fs::File::open("/dev/null") {
        files.push(file);
    }
    for free in [0, 1] {
        files.truncate(files.len() - free);
        let problem = loader.rescan_in(loader.folders()).problems().first().cloned();
        let problem = problem.or_else(|| loader.load("flow").err()).expect("refused");
        let text = format!("{} {}", problem.message, problem.help);
        assert!(text.contains("file descriptors"), "{free}: {text}");
    }
}

#[test]
fn files_that_are_passed_over_are_named() {
    let good = folder_with("good", "libflow.so", &flow_bytes());
    let whole = flow_bytes();
    let strangers: [(&str, &[u8], &str); 2] = [
        ("broken", &whole[..whole.len() / 2], "it is truncated"),
        ("foreign", &without_note(), "it has no Panoscope note"),
    ];
    let text = GraphText::parse(
        "g.toml".as_ref(),
        "plugins = [\"flow\"]\n[nodes.a]\ntype = \"frames\"\n[nodes.b]\ntype = \"drain\"\ninputs = { image = \"a.image\" }\n",
    );
    for (name, bytes, reason) in strangers {
        let first = folder_with(name, "libflow.so", bytes);
        let warnings = |folders: &[PathBuf]| {
            let (_, warnings) = check(&text, &Loader::search(folders).catalog(&text.plugins()))
                .into_result()
                .unwrap_or_else(|d| panic!("{}", d.render(false)));
            warnings.render(false)
        };
        let text = warnings(&[first.clone(), good.clone()]);
        let (file, used) = (first.join("libflow.so"), good.join("libflow.so"));
        for part in [reason.to_owned(), file.display().to_string(), format!("{} is used instead", used.display())] {
            assert!(text.contains(&part), "{part}: {text}");
        }
        assert_eq!(warnings(&[good.clone(), first.clone()]), "", "a later file is not asked for");
    }
    // Without another one it is an error.
    let alone = Loader::search(&[folder_with("alone", "libflow.so", &without_note())]);
    let error = check(&text, &alone.catalog(&text.plugins())).into_result().unwrap_err().render(false);
    assert!(error.contains("plugin `flow` cannot be used") && error.contains("no Panoscope note"), "{error}");
}

/// A library that is no plugin: the owner of its note has another name.
fn without_note() -> Vec<u8> {
    let mut bytes = flow_bytes();
    let body = note_body(&bytes);
    bytes[body - abi::NOTE_OWNER.len()] ^= 1;
    bytes
}

#[test]
fn a_folder_of_the_search_path_that_is_not_there_is_named() {
    // Before the variable changes: it names the built plugins.
    let good = folder_with("with_absent", "libflow.so", &flow_bytes());
    let absent = scratch("absent_plugins");
    // SAFETY: this test is the only one of its process, and no other thread runs.
    unsafe { std::env::set_var(panoscope_host::loader::PLUGIN_PATH_VARIABLE, &absent) };
    let catalog = Loader::search(&panoscope_host::loader::search_path(&[good])).catalog(&["flow"]);
    let [problem] = &catalog.passed_over[..] else { panic!("{:?}", catalog.passed_over) };
    assert!(problem.message.contains(&absent.display().to_string()), "{problem:?}");
    assert!(problem.message.contains("PANOSCOPE_PLUGIN_PATH"), "{problem:?}");
}
