//! A `panoscope run` with machines in network namespaces, whose cable is cut.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use panoscope_tests::machines::{Machine, Namespace, program};
use panoscope_tests::scratch;

use super::keys::keys;
use super::{PATIENCE, PATIENT, machine};

/// A `panoscope run` without an end, and its log. Killed when dropped.
struct Host {
    child: Child,
    /// Lines of its standard error.
    log: Arc<Mutex<Vec<String>>>,
}

impl Host {
    fn start(command: &mut Command) -> Self {
        let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().expect("it runs");
        let stream = child.stderr.take().expect("a pipe");
        let log = Arc::new(Mutex::new(Vec::new()));
        let lines = Arc::clone(&log);
        std::thread::spawn(move || {
            for line in BufReader::new(stream).lines().map_while(Result::ok) {
                lines.lock().unwrap_or_else(PoisonError::into_inner).push(line);
            }
        });
        Self { child, log }
    }

    fn log(&self) -> Vec<String> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Waits for a condition while it runs.
    fn until(&mut self, what: &str, holds: impl Fn(&Self) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !holds(self) {
            let ended = self.child.try_wait().expect("a child");
            assert!(ended.is_none() && Instant::now() < end, "{what}: {ended:?}, {:#?}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Interrupts it, as its user does.
    fn interrupt(mut self) -> ExitStatus {
        let sent = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status();
        assert!(sent.is_ok_and(|status| status.success()), "it takes a signal");
        let end = Instant::now() + PATIENCE;
        loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                return status;
            }
            assert!(Instant::now() < end, "it does not end: {:#?}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Number of images `NAME_000000.png` and so on in a folder.
fn pictures_of(folder: &Path, name: &str) -> usize {
    let files = std::fs::read_dir(folder).expect("a folder").flatten().map(|entry| entry.file_name());
    let mine = |file: &str| file.strip_prefix(name).is_some_and(|rest| rest.starts_with('_') && rest.ends_with(".png"));
    files.filter(|file| mine(&file.to_string_lossy())).count()
}

#[test]
fn three_machines_in_namespaces_survive_a_cut_cable() {
    let folder = scratch("machines-namespaces");
    let (Some(one), Some(two)) = (Namespace::new(1), Namespace::new(2)) else {
        return panoscope_testing::skipped!("this user makes no network namespaces");
    };
    let names = [format!("rack={}", one.address), format!("attic={}", two.address)];
    let Some(keys) = keys(&folder, &["theatre", &names[0], &names[1]]) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let start = |space: &Namespace, name: &str| {
        let own = keys.join(name).display().to_string();
        let address = format!("tls/{}:7447", space.address);
        let machine = Machine::start(&space.words(), name, &address, &["--allow", "theatre", "--keys", &own], &folder);
        (machine.expect("a program"), address)
    };
    let ((_rack, rack), (_attic, attic)) = (start(&one, "rack"), start(&two, "attic"));
    // What comes back is written, so that it can be counted while the graph runs. The queue of the main branch is shorter than the cut, and longer than
    // a loaded machine keeps a thread waiting.
    let text = format!(
        "mode = \"live\"\nplugins = [\"flow\", \"phantom\", \"sinks\"]\n\
         [nodes.scope]\ntype = \"phantom\"\nparams = {{ width = 96, height = 64 }}\n\
         [nodes.far]\ntype = \"pass\"\non = \"rack\"\ninputs = {{ image = {{ from = \"scope.left\", align = \"latest\" }} }}\n\
         [nodes.third]\ntype = \"pass\"\non = \"attic\"\ninputs = {{ image = {{ from = \"far.image\", align = \"latest\" }} }}\n\
         [nodes.end]\ntype = \"drain\"\ninputs = {{ image = {{ from = \"scope.right\", queue = 90 }} }}\n\
         [nodes.end_far]\ntype = \"write_images\"\ninputs = {{ image = \"far.image\" }}\nparams = {{ path = \"far_{{seq}}.png\" }}\n\
         [nodes.end_third]\ntype = \"write_images\"\ninputs = {{ image = \"third.image\" }}\nparams = {{ path = \"third_{{seq}}.png\" }}\n{}{}",
        machine(&rack, PATIENT),
        machine(&attic, PATIENT).replace("machines.rack", "machines.attic")
    );
    // The run takes the keys from the variable of its process.
    let graph = folder.join("graph.toml");
    std::fs::write(&graph, text).expect("a file");
    let report = folder.join("report.json");
    let mut command = Command::new(program().expect("a program"));
    command.args(["run", "--headless", "--report"]).arg(&report).arg(&graph);
    // The calls that the cut holds up end by the time-out of the machine, not by the watchdog.
    command.env("PANOSCOPE_KEYS", keys.join("theatre")).env("PANOSCOPE_HANG_MS", "60000");
    let mut host = Host::start(&mut command);
    let counts = || ["far", "third"].map(|name| pictures_of(&folder, name));
    host.until("30 pictures of each machine", |_| counts().iter().all(|count| *count > 30));
    let cut = Instant::now();
    one.set_joined(false);
    host.until("the loss of the rack, after more than its time-out", |host| {
        let is_lost = host.log().iter().any(|line| line.contains("machine `rack` is lost"));
        is_lost && cut.elapsed() > Duration::from_secs(5)
    });
    let at_loss = counts();
    one.set_joined(true);
    host.until("30 more of each", |_| counts().iter().zip(at_loss).all(|(now, before)| *now > before + 30));
    let status = host.interrupt();
    let report = std::fs::read_to_string(&report).expect("a report");
    let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
    let number = |node: &str, what: &str| report["nodes"][node][what].as_u64().expect("a number");
    let (made, done) = (number("scope", "made"), number("end", "count"));
    assert_eq!((done, number("scope", "dropped")), (made, 0), "the main branch: {report}");
    assert_eq!(number("third", "faults"), 0, "of the other machine: {report}");
    assert!(number("far", "faults") >= 1 && report["groups"]["rack"]["processes"].as_u64() >= Some(2), "{report}");
    assert!(number("end_far", "count") > 60 && number("end_third", "count") > 60, "{report}");
    assert_eq!(status.code(), Some(1), "a fault is a lost tick");
    let _ = std::fs::remove_dir_all(&folder);
}
