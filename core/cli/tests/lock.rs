//! Locks: nothing of a graph is used before it was compared, what was compared is what is used, and signatures are
//! believed only from trusted keys.

use crate::common;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

const PROGRAM: &str = env!("CARGO_BIN_EXE_panoscope");
/// How long a condition may take on a loaded machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// A folder with a graph, and commands that run in it.
struct Bench {
    folder: PathBuf,
}

impl Bench {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("panoscope_cli_lock_{name}_{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(folder.join("own")).expect("a folder");
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).expect("written");
    }

    fn command(&self, words: &str) -> Command {
        let mut command = Command::new(PROGRAM);
        command.current_dir(&self.folder).args(words.split_whitespace());
        command.env("PANOSCOPE_PLUGIN_PATH", common::built_plugins(&["flow", "fixtures", "sinks"]));
        command.env("PANOSCOPE_TRAP", self.path("trap.txt")).env("LD_LIBRARY_PATH", self.path("libraries"));
        panoscope_testing::own_settings(&mut command, &self.folder);
        command
    }

    /// Exit code, and what was printed.
    fn run(&self, words: &str) -> (i32, String) {
        let Output { status, stdout, stderr } = self.command(words).output().expect("the program starts");
        let text = String::from_utf8_lossy(&stdout).into_owned() + &String::from_utf8_lossy(&stderr);
        (status.code().unwrap_or(-1), text)
    }

    /// What ran of the trap since the last call: lines of its plugin and its library.
    fn ran(&self) -> Vec<String> {
        let text = std::fs::read_to_string(self.path("trap.txt")).unwrap_or_default();
        let _ = std::fs::remove_file(self.path("trap.txt"));
        text.lines().map(str::to_owned).collect()
    }

    /// Builds `trap.c`; `false`, with a report that the test is skipped, without a compiler.
    fn build(&self, output: &str, flags: &[&str]) -> bool {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let output = self.path(output);
        std::fs::create_dir_all(output.parent().expect("a folder")).expect("a folder");
        let built = Command::new("cc")
            .args(["-std=c11", "-O2", "-fPIC", "-fvisibility=hidden", "-shared", "-I"])
            .arg(root.join("core/contract/abi"))
            .arg(root.join("tests/c/trap.c"))
            .arg("-o")
            .arg(&output)
            .args(flags)
            .current_dir(&self.folder)
            .output();
        match built {
            Ok(built) => {
                assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
                true
            }
            Err(error) => {
                panoscope_testing::skipped!("cc cannot be run ({error})");
                false
            }
        }
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// A source and the trap, whose plugin is in the graph's own folder `own`.
const TRAPPED: &str = r#"
mode = "batch"
plugins = ["flow", "trap"]
plugin_paths = ["own"]
[nodes.source]
type = "frames"
params = { width_px = 16, height_px = 16 }
[nodes.trap]
type = "trap"
inputs = { image = "source.image" }
"#;

#[test]
fn no_code_of_a_plugin_runs_before_it_was_compared() {
    let bench = Bench::new("order");
    if !bench.build("own/libtrap.so", &[]) {
        return;
    }
    bench.write("g.toml", TRAPPED);
    let (code, said) = bench.run("lock g.toml");
    assert_eq!((code, bench.ran()), (0, vec!["plugin".to_owned()]), "{said}");
    // As it was locked, it runs; otherwise this test would prove nothing.
    let (code, said) = bench.run("lock g.toml --verify");
    assert_eq!((code, bench.ran()), (0, vec!["plugin".to_owned()]), "{said}");
    let (code, said) = bench.run("run g.toml --lock --frames 3 --headless");
    assert_eq!((code, bench.ran()), (0, vec!["plugin".to_owned()]), "{said}");
    // Another plugin of the same name.
    assert!(bench.build("own/libtrap.so", &["-O0"]));
    for words in ["lock g.toml --verify", "run g.toml --lock --frames 3 --headless"] {
        let (code, said) = bench.run(words);
        assert!(code != 0 && said.contains("plugin `trap` has changed since the graph was locked"), "{words}: {said}");
        assert_eq!(bench.ran(), Vec::<String>::new(), "{words}: its constructor ran");
    }
    // The graph names a plugin that the lock does not have.
    bench.write("g.toml", &TRAPPED.replace("[\"flow\", \"trap\"]", "[\"flow\"]").replace("\"trap\"", "\"drain\""));
    assert_eq!(bench.run("lock g.toml").0, 0);
    bench.ran();
    bench.write("g.toml", TRAPPED);
    let (code, said) = bench.run("run g.toml --lock --frames 3 --headless");
    assert!(code == 2 && said.contains("plugin `trap` is used now and was not locked"), "{said}");
    assert_eq!(bench.ran(), Vec::<String>::new());
}

#[test]
fn no_code_of_a_library_runs_before_it_was_compared() {
    let bench = Bench::new("library");
    let flags = ["-DNEEDS_LIBRARY", "-Llibraries", "-ltrap_library"];
    if !bench.build("libraries/libtrap_library.so", &["-DLIBRARY"]) || !bench.build("own/libtrap.so", &flags) {
        return;
    }
    bench.write("g.toml", TRAPPED);
    let (code, said) = bench.run("lock g.toml");
    assert_eq!((code, bench.ran()), (0, vec!["library".to_owned(), "plugin".to_owned()]), "{said}");
    let (code, said) = bench.run("run g.toml --lock --frames 3 --headless");
    assert_eq!((code, bench.ran().len()), (0, 2), "{said}");
    assert!(bench.build("libraries/libtrap_library.so", &["-DLIBRARY", "-DANSWER=43"]));
    let (code, said) = bench.run("run g.toml --lock --frames 3 --headless");
    assert!(
        code == 2 && said.contains("library `libtrap_library.so` has changed since the graph was locked"),
        "{said}"
    );
    assert_eq!(bench.ran(), Vec::<String>::new());
    std::fs::remove_file(bench.path("libraries/libtrap_library.so")).expect("removed");
    let (_, said) = bench.run("run g.toml --lock --frames 3 --headless");
    assert!(said.contains("library `libtrap_library.so` was locked and is missing now"), "{said}");
}

#[test]
fn commands_that_only_look_never_run_a_plugin_that_the_graph_brings() {
    let bench = Bench::new("foreign");
    if !bench.build("own/libtrap.so", &[]) {
        return;
    }
    bench.write("g.toml", TRAPPED);
    // Who runs a graph, runs its plugins.
    let (code, said) = bench.run("record g.toml -o r.mcap --frames 3 --headless");
    assert_eq!((code, bench.ran().is_empty()), (0, false), "{said}");
    for words in ["check g.toml", "dot g.toml", "replay r.mcap --headless", "replay r.mcap --graph g.toml --headless"] {
        let (code, said) = bench.run(words);
        assert!(code == 2, "{words}: {code}: {said}");
        for part in ["plugin `trap` cannot be used", "was not loaded", "--trust-plugins"] {
            assert!(said.contains(part), "{words}: {said}");
        }
        assert_eq!(bench.ran(), Vec::<String>::new(), "{words}: its constructor ran");
        let (code, said) = bench.run(&format!("{words} --trust-plugins"));
        assert_eq!((code, bench.ran().is_empty()), (0, false), "{words} --trust-plugins: {said}");
    }
    if panoscope_host::isolate::kernel().landlock.is_none() {
        panoscope_testing::skipped!("the trap could write its file: this kernel has no Landlock");
        return;
    }
    // What a constructor writes shows where it ran: nowhere, because the process in which it does may write nothing.
    for words in ["check g.toml", "dot g.toml", "run g.toml --frames 3 --headless"] {
        let (code, said) = bench.run(&format!("{words} --isolate-plugins"));
        assert_eq!((code, bench.ran()), (0, Vec::new()), "{words} --isolate-plugins: {said}");
    }
    // A folder that the user names is the user's choice.
    let mut command = bench.command("check g.toml");
    let all = common::built_plugins(&["flow", "fixtures", "sinks"]);
    let all = std::env::split_paths(&all).chain([bench.path("own")]);
    command.env("PANOSCOPE_PLUGIN_PATH", std::env::join_paths(all).expect("a search path"));
    assert!(command.output().expect("it starts").status.success());
    assert!(!bench.ran().is_empty());
}

/// A node that reads a file whenever it opens, and fails now and then.
const READS: &str = r#"
plugins = ["flow", "fixtures"]
[nodes.source]
type = "frames"
params = { width_px = 16, height_px = 16, rate_hz = 100.0 }
[nodes.reader]
type = "reader"
inputs = { image = "source.image" }
params = { file = "words.txt", log = "read.txt", fails_every = 10 }
[nodes.sink]
type = "drain"
inputs = { image = "reader.image" }
"#;

/// Runs the graph until its node has read the file, replaces the file, and waits until the node has read it again;
/// returns what it read.
fn read_across_a_swap(bench: &Bench, words: &str) -> Vec<String> {
    let read = || -> Vec<String> {
        let text = std::fs::read_to_string(bench.path("read.txt")).unwrap_or_default();
        text.lines().map(str::to_owned).collect()
    };
    let mut child = bench.command(words).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
    let mut wait = |what: &str, count: usize| {
        let until = Instant::now() + PATIENCE;
        while read().len() < count {
            assert_eq!(child.try_wait().expect("a child"), None, "{what}: it has ended; {:?}", read());
            assert!(Instant::now() < until, "{what}: {:?}", read());
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    wait("the first opening", 1);
    std::fs::write(bench.path("new.txt"), "swapped").expect("written");
    std::fs::rename(bench.path("new.txt"), bench.path("words.txt")).expect("renamed");
    // One may have been under way.
    let before = read().len();
    wait("two more openings", before + 2);
    let _ = child.kill();
    let _ = child.wait();
    let all = read();
    let _ = std::fs::remove_file(bench.path("read.txt"));
    all
}

#[test]
fn a_node_that_opens_again_reads_what_was_compared() {
    let bench = Bench::new("again");
    bench.write("g.toml", READS);
    bench.write("words.txt", "compared");
    assert_eq!(bench.run("lock g.toml").0, 0);
    let _ = std::fs::remove_file(bench.path("read.txt"));
    let all = read_across_a_swap(&bench, "run g.toml --lock --headless");
    assert!(all.len() >= 3 && all.iter().all(|line| line == "compared"), "{all:?}");
    // Without the lock the node reads the file as it is: the swap was real.
    bench.write("words.txt", "compared");
    let all = read_across_a_swap(&bench, "run g.toml --headless");
    assert_eq!(all.last().map(String::as_str), Some("swapped"), "{all:?}");
    // And the next run under the lock is refused.
    let (code, said) = bench.run("run g.toml --lock --frames 5 --headless");
    assert!(code == 2 && said.contains("file `reader.file` has changed since the graph was locked"), "{said}");
}

#[test]
fn a_signature_is_believed_only_from_a_trusted_key() {
    let bench = Bench::new("signed");
    bench.write("g.toml", READS);
    bench.write("words.txt", "compared");
    let (code, said) = bench.run("lock --new-key ward");
    assert!(code == 0 && said.contains("ward.pub"), "{said}");
    let mode = std::fs::metadata(bench.path("ward")).expect("the key").permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    let (code, said) = bench.run("lock --new-key ward");
    assert!(code == 2 && said.contains("never replaced"), "{said}");
    assert_eq!(bench.run("lock --new-key stranger").0, 0);
    let run = "run g.toml --lock --frames 3 --headless";
    let refused = |words: &str, part: &str| {
        let (code, said) = bench.run(words);
        assert!(code != 0 && said.contains(part), "{words}: {code}: {said}");
    };
    refused(run, "is not locked");
    // Unsigned: accepted as long as no key is trusted.
    assert_eq!(bench.run("lock g.toml").0, 0);
    let (code, said) = bench.run(run);
    assert_eq!(code, 0, "{said}");
    for words in [run, "lock g.toml --verify"] {
        refused(&format!("{words} --trust ward.pub"), "is not signed");
    }
    // Signed by a key that nobody trusts, by a stranger, and by the right one.
    let (code, said) = bench.run("lock g.toml --key ward");
    assert!(code == 0 && said.contains("signed with"), "{said}");
    for words in [run, "lock g.toml --verify"] {
        refused(words, "does not trust");
        refused(&format!("{words} --trust stranger.pub"), "does not trust");
        let (code, said) = bench.run(&format!("{words} --trust ward.pub"));
        assert_eq!(code, 0, "{words}: {said}");
    }
    // Trusted by the installation.
    std::fs::create_dir_all(bench.path("config/panoscope/keys")).expect("a folder");
    std::fs::copy(bench.path("ward.pub"), bench.path("config/panoscope/keys/ward.pub")).expect("copied");
    let (code, said) = bench.run("lock g.toml --verify");
    assert!(code == 0 && said.contains("signed by ward"), "{said}");
    let (_, said) = bench.run("doctor");
    assert!(said.contains("key ward") && said.contains("audit log"), "{said}");
    // An altered lock, and an altered file under a whole lock.
    let lock = std::fs::read_to_string(bench.path("g.toml.lock")).expect("the lock");
    let at = lock.find("sha256 = \"").expect("a hash") + "sha256 = \"".len();
    let other = if &lock[at..=at] == "0" { "1" } else { "0" };
    bench.write("g.toml.lock", &format!("{}{other}{}", &lock[..at], &lock[at + 1..]));
    refused(run, "was altered after it was signed");
    bench.write("g.toml.lock", &lock);
    bench.write("words.txt", "other");
    refused(run, "file `reader.file` has changed");
    bench.write("words.txt", "compared");
    assert_eq!(bench.run(run).0, 0);
    // A secret key that others can read proves nothing.
    std::fs::set_permissions(bench.path("ward"), std::fs::Permissions::from_mode(0o644)).expect("permissions");
    refused("lock g.toml --key ward", "other users can read");
    refused("lock g.toml --key ward.pub", "is not a panoscope-secret-key");
    // A key that somebody meant to trust is not left out silently.
    bench.write("config/panoscope/keys/broken.pub", "hello");
    refused(run, "broken.pub");
}

#[test]
fn the_audit_log_is_shown_and_a_damaged_one_named() {
    let bench = Bench::new("audit");
    let (code, said) = bench.run("audit");
    assert!(code == 0 && said.contains("no lines"), "{said}");
    let log = panoscope_host::audit::Log::new(&bench.path("state/panoscope/audit"));
    for number in 1..=3 {
        log.append(1_772_323_200_250, panoscope_host::audit::Event::Still { number }).expect("written");
    }
    let (code, said) = bench.run("audit");
    assert!(code == 0 && said.contains("2026-03-01 00:00:00.250 UTC  still 3"), "{said}");
    assert!(said.contains("3 lines, unbroken"), "{said}");
    let file = bench.path("state/panoscope/audit/audit-2026-03-01.jsonl");
    let text = std::fs::read_to_string(&file).expect("the log");
    std::fs::write(&file, text.replacen(":2,", ":7,", 1)).expect("written");
    for words in ["audit", "audit state/panoscope/audit/audit-2026-03-01.jsonl"] {
        let (code, said) = bench.run(words);
        assert!(code == 1 && said.contains("DAMAGED") && said.contains("jsonl:2"), "{words}: {said}");
    }
    assert_eq!(bench.run("audit nowhere").0, 2);
}

#[test]
fn a_locked_graph_is_set_to_nothing_that_its_preset_does_not_offer() {
    let bench = Bench::new("settings");
    let graph = "mode = \"batch\"\nplugins = [\"flow\"]\n[nodes.source]\ntype = \"frames\"\nparams = { width_px = 16, height_px = 16 }\n\
        [nodes.end]\ntype = \"drain\"\ninputs = { image = \"source.image\" }\n\
        [preset]\npinned = [{ param = \"source.rate_hz\", range = [10, 60] }]\n";
    bench.write("g.toml", graph);
    let (code, said) = bench.run("lock g.toml");
    assert_eq!(code, 0, "{said}");
    let run = |set: &str| bench.run(&format!("run g.toml --lock --headless --frames 2 {set}"));
    for set in ["--set source.width_px=32", "--set source.rate_hz=90"] {
        let (code, said) = run(set);
        let setting = set.trim_start_matches("--set ");
        assert!(code == 2 && said.contains(setting) && said.contains("does not offer"), "{set}: {code} {said}");
    }
    for set in ["", "--set source.rate_hz=20"] {
        let (code, said) = run(set);
        assert_eq!(code, 0, "{set}: {said}");
    }
}
