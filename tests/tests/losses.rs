//! A campaign of losses: `panoscope record`, which also writes a video, is killed, suspended, run twice on one output, given a full disk, or loses an
//! isolated process. No log contains a panic, nothing that was in a file is lost, and each replay has the recorded bytes or fails.
//!
//! `PANOSCOPE_LOSS_CASES` sets the number of cases, `PANOSCOPE_LOSS_SEED` selects others. A case that fails is named with its number: the same seed
//! repeats it.

use std::collections::BTreeMap;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use panoscope_base::random::SplitMix64;
use panoscope_tests::scratch;

use crate::video::whole_frames;

const PATIENCE: Duration = Duration::from_secs(60);
/// Frames of a run that ends by itself.
const FRAMES: usize = 120;
/// Number of frames of a run that meets a second one, which waits for a lock for 1 s.
const LONG_FRAMES: usize = 400;
const RATE_HZ: f64 = 200.0;
/// Time limit of a call, ms. Some suspensions are longer; they are not hangs.
const HANG_MS: &str = "1000";
/// Exit code where no file system can be mounted.
const NO_MOUNT: i32 = 99;
/// Maximum number of ticks that are in the video but not yet in the recording: the recorder writes at least four times a second.
const MAX_BEHIND: usize = 80;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Loss {
    /// SIGKILL to the program and all processes that it started.
    Killed,
    /// SIGKILL to the process of an isolated node.
    IsolatedKilled,
    /// A second program writes the same video, or the same recording.
    Twice { recording: bool },
    /// The file system of the outputs soon becomes full.
    DiskFull { kib: u64 },
    /// SIGSTOP, and SIGCONT later.
    Asleep { ms: u64 },
}

#[derive(Clone, Debug)]
struct Case {
    loss: Loss,
    width_px: usize,
    /// Time from the first frames to the loss.
    after_ms: u64,
}

impl Case {
    fn new(number: u64, seed: u64) -> Self {
        let mut dice = SplitMix64(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ number);
        // Every kind comes as often as any other.
        let loss = match number % 5 {
            0 => Loss::Killed,
            1 => Loss::IsolatedKilled,
            2 => Loss::Twice { recording: dice.below(2) == 0 },
            3 => Loss::DiskFull { kib: 8 + 4 * dice.below(40) as u64 },
            _ => Loss::Asleep { ms: 20 + dice.below(2500) as u64 },
        };
        let width_px = [32, 64, 160][dice.below(3)];
        Self { loss, width_px, after_ms: dice.below(400) as u64 }
    }

    fn graph(&self, film: &str) -> String {
        let (width_px, isolate) = match self.loss {
            Loss::IsolatedKilled => (self.width_px, "isolate = \"doomed\"\n"),
            _ => (self.width_px, ""),
        };
        format!(
            "mode = \"live\"\nplugins = [\"flow\", \"sinks\"]\n\
             [nodes.camera]\ntype = \"frames\"\nparams = {{ width_px = {width_px}, height_px = 24, rate_hz = {RATE_HZ:?} }}\n\
             [nodes.film]\ntype = \"write_video\"\nparams = {{ path = \"{film}\" }}\n\
             inputs = {{ image = {{ from = \"camera.image\", queue = 1000 }} }}\n\
             [nodes.same]\ntype = \"pass\"\n{isolate}inputs = {{ image = {{ from = \"camera.image\", queue = 1000 }} }}\n\
             [nodes.end]\ntype = \"drain\"\ninputs = {{ image = {{ from = \"same.image\", queue = 1000 }} }}\n"
        )
    }
}

/// A program in a separate process group, which is killed when dropped.
struct Running {
    child: Child,
    log: PathBuf,
}

impl Running {
    /// Starts a program in a folder.
    fn start(program: &Path, folder: &Path, log: &str, words: &[&str]) -> Result<Self, String> {
        let path = folder.join(log);
        let file = std::fs::File::create(&path).map_err(|error| error.to_string())?;
        let also = file.try_clone().map_err(|error| error.to_string())?;
        let mut command = Command::new(program);
        command.args(words).current_dir(folder).stdin(Stdio::null()).stdout(file).stderr(also).process_group(0);
        panoscope_testing::own_settings(&mut command, folder);
        command.env("PANOSCOPE_HANG_MS", HANG_MS);
        let child = command.spawn().map_err(|error| error.to_string())?;
        Ok(Self { child, log: path })
    }

    fn signal(&self, signal: libc::c_int) {
        // SAFETY: a plain system call; the group of a child that was not waited for.
        unsafe { libc::kill(-self.child.id().cast_signed(), signal) };
    }

    /// Waits for its end; returns how it ended and what it printed.
    fn end(&mut self) -> Result<(ExitStatus, String), String> {
        let end = Instant::now() + PATIENCE;
        loop {
            if let Some(status) = self.child.try_wait().map_err(|error| error.to_string())? {
                let text = std::fs::read_to_string(&self.log).map_err(|error| error.to_string())?;
                if text.contains("panicked") {
                    return Err(format!("a panic: {text}"));
                }
                return Ok((status, text));
            }
            if Instant::now() > end {
                return Err(format!("it did not end: {}", std::fs::read_to_string(&self.log).unwrap_or_default()));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// As [`Self::end`], for a run that must succeed.
    fn succeeds(&mut self) -> Result<String, String> {
        let (status, text) = self.end()?;
        if status.success() { Ok(text) } else { Err(format!("{status}: {text}")) }
    }

    /// Waits until a file contains frames and the time of the case has passed.
    fn until_frames(&mut self, film: &Path, after_ms: u64) -> Result<(), String> {
        let end = Instant::now() + PATIENCE;
        while frames(film) < 3 {
            if self.child.try_wait().is_ok_and(|ended| ended.is_some()) || Instant::now() > end {
                return Err(format!("no frames: {}", std::fs::read_to_string(&self.log).unwrap_or_default()));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        std::thread::sleep(Duration::from_millis(after_ms));
        Ok(())
    }

    /// The process of its isolated node.
    fn isolated(&self) -> Option<i32> {
        let own = self.child.id();
        let entries = std::fs::read_dir("/proc").ok()?.flatten();
        let mut numbers = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
        numbers.find(|process| {
            let read = |file| std::fs::read_to_string(format!("/proc/{process}/{file}")).unwrap_or_default();
            let parent = read("stat").rsplit_once(") ").and_then(|(_, rest)| rest.split(' ').nth(1)?.parse().ok());
            parent == Some(own) && read("cmdline").contains("doomed")
        })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if !matches!(self.child.try_wait(), Ok(Some(_))) {
            self.signal(libc::SIGKILL);
            let _ = self.child.wait();
        }
    }
}

fn frames(film: &Path) -> usize {
    std::fs::read(film).map_or(0, |bytes| whole_frames(&bytes).0)
}

/// Fingerprints by port and tick.
type Fingerprints = BTreeMap<String, BTreeMap<u64, String>>;

fn fingerprints(file: &Path) -> Result<Fingerprints, String> {
    let text = std::fs::read_to_string(file).map_err(|error| format!("{}: {error}", file.display()))?;
    let value: serde_json::Value = serde_json::from_str(&text).map_err(|error| error.to_string())?;
    let ports = value["ports"].as_object().ok_or("no ports")?.iter();
    let packets = |port: &serde_json::Value| {
        let all = port["packets"].as_array().into_iter().flatten();
        all.filter_map(|packet| Some((packet[1].as_u64()?, packet[2].as_str()?.to_owned()))).collect()
    };
    Ok(ports.map(|(name, port)| (name.clone(), packets(port))).collect())
}

/// Runs cases in a folder and compares them with undisturbed runs.
struct Campaign {
    program: PathBuf,
    folder: PathBuf,
    /// Expected fingerprints by width: more ticks than any case.
    expected: BTreeMap<usize, Fingerprints>,
    frames: usize,
    replays: usize,
}

impl Campaign {
    fn record(&self, graph: &str, recording: &str, frames: Option<usize>) -> Result<Running, String> {
        let (log, count) = (format!("{recording}.log"), frames.unwrap_or(100_000).to_string());
        let words = ["record", graph, "-o", recording, "--headless", "--frames", count.as_str()];
        Running::start(&self.program, &self.folder, &log, &words)
    }

    /// Records on a file system of a given size, whose files are copied when the run has ended. The exit code is [`NO_MOUNT`] if the system allows no
    /// mounts.
    fn record_on(&self, kib: u64, graph: &str, recording: &str) -> Result<Running, String> {
        let script = format!(
            "mkdir -p full && mount -t tmpfs -o size={kib}k none full || exit {NO_MOUNT}\n\
             \"$@\" --frames {FRAMES} --headless\ncode=$?\ncp full/* .\nexit $code"
        );
        let (program, recording) = (self.program.to_string_lossy(), format!("full/{recording}"));
        let inside = ["--user", "--map-root-user", "--mount", "sh", "-c", script.as_str(), "sh"];
        let words = [&inside[..], &[&*program, "record", graph, "-o", recording.as_str()]].concat();
        Running::start(Path::new("unshare"), &self.folder, "full.log", &words)
    }

    /// Replays a recording; returns its ticks. An incomplete one must be refused with a reason after its last tick.
    fn replay(&mut self, case: &Case, recording: &str) -> Result<(usize, bool), String> {
        let digests = self.folder.join("replay.json");
        let _ = std::fs::remove_file(&digests);
        let words = ["replay", recording, "--headless", "--digests", "replay.json"];
        let (status, text) = Running::start(&self.program, &self.folder, "replay.log", &words)?.end()?;
        let is_whole = status.success();
        if status.code().is_none() || !is_whole && !text.contains("cut off") {
            return Err(format!("a replay ends with {status} and no reason: {text}"));
        }
        let played = fingerprints(&digests)?;
        for (port, packets) in &played {
            let expected = self.expected[&case.width_px].get(port).ok_or_else(|| format!("a port `{port}`"))?;
            if let Some((tick, _)) =
                packets.iter().find(|(tick, hash)| expected.get(tick).is_some_and(|is| is != *hash))
            {
                return Err(format!("a replay has other bytes at tick {tick} of `{port}`, and its end is {status}"));
            }
        }
        self.replays += 1;
        Ok((played.get("camera.image").map_or(0, BTreeMap::len), is_whole))
    }

    /// Computes the expected fingerprints for a width.
    fn expect(&mut self, case: &Case) -> Result<(), String> {
        if self.expected.contains_key(&case.width_px) {
            return Ok(());
        }
        let text = Case { loss: Loss::Killed, ..case.clone() }.graph("expected.mkv");
        std::fs::write(self.folder.join("expected.toml"), text.replace("\"live\"", "\"batch\"")).expect("a file");
        let words = [
            "record",
            "expected.toml",
            "--frames",
            "600",
            "--headless",
            "-o",
            "expected.mcap",
            "--digests",
            "expected.json",
        ];
        Running::start(&self.program, &self.folder, "expected.log", &words)?.succeeds()?;
        self.expected.insert(case.width_px, fingerprints(&self.folder.join("expected.json"))?);
        Ok(())
    }

    fn judge(&mut self, case: &Case) -> Result<(), String> {
        self.expect(case)?;
        let film = self.folder.join("film.mkv");
        for name in ["film.mkv", "other.mkv", "run.mcap", "next.mcap"] {
            let _ = std::fs::remove_file(self.folder.join(name));
        }
        std::fs::write(self.folder.join("graph.toml"), case.graph("film.mkv")).expect("a file");
        match case.loss {
            Loss::Killed => {
                let mut running = self.record("graph.toml", "run.mcap", None)?;
                running.until_frames(&film, case.after_ms)?;
                let recording = self.folder.join("run.mcap");
                let before = (read(&film)?, read(&recording)?);
                running.signal(libc::SIGKILL);
                running.end()?;
                let seen = whole_frames(&before.0).0;
                let after = (read(&film)?, read(&recording)?);
                if !after.0.starts_with(&before.0) || !after.1.starts_with(&before.1) {
                    return Err("bytes that were in a file are gone".to_owned());
                }
                let (ticks, is_whole) = self.replay(case, "run.mcap")?;
                if is_whole || ticks + MAX_BEHIND < seen {
                    return Err(format!("{seen} frames were in the video; the replay has {ticks}, whole: {is_whole}"));
                }
                // The next run takes over the locks and leaves the recording alone.
                self.record("graph.toml", "next.mcap", Some(20))?.succeeds()?;
                if read(&recording)? != after.1 || frames(&film) != 20 {
                    return Err("the next run changed the recording, or wrote no video".to_owned());
                }
                self.frames += seen;
            }
            Loss::IsolatedKilled => {
                let mut running = self.record("graph.toml", "run.mcap", Some(FRAMES))?;
                // Its end may come first.
                running.until_frames(&film, case.after_ms / 2)?;
                if let Some(process) = running.isolated() {
                    // SAFETY: a plain system call; a process of the run, which has not been waited for or has just ended.
                    unsafe { libc::kill(process, libc::SIGKILL) };
                }
                let (status, text) = running.end()?;
                if status.code().is_none() {
                    return Err(format!("{status}: {text}"));
                }
                self.whole(case, &film, FRAMES)?;
            }
            Loss::Twice { recording } => {
                let (graph, name) = if recording { ("other.toml", "run.mcap") } else { ("graph.toml", "next.mcap") };
                std::fs::write(self.folder.join("other.toml"), case.graph("other.mkv")).expect("a file");
                let mut first = self.record("graph.toml", "run.mcap", Some(LONG_FRAMES))?;
                first.until_frames(&film, 3 * case.after_ms)?;
                // Its log must not be that of the first one.
                let words = ["record", graph, "-o", name, "--headless", "--frames", "30"];
                let mut second = Running::start(&self.program, &self.folder, "second.log", &words)?;
                first.succeeds()?;
                match second.end()? {
                    // The first one had ended while this one waited for its lock.
                    (status, _) if status.success() => {
                        let film = self.folder.join(if recording { "other.mkv" } else { "film.mkv" });
                        if frames(&film) != 30 {
                            return Err(format!("the second run succeeds with {} of 30 frames", frames(&film)));
                        }
                        self.replay(case, name)?;
                    }
                    (_, text) if text.contains("another run") => self.whole(case, &film, LONG_FRAMES)?,
                    (status, text) => return Err(format!("the second run: {status}: {text}")),
                }
            }
            Loss::DiskFull { kib } => {
                std::fs::write(self.folder.join("graph.toml"), case.graph("full/film.mkv")).expect("a file");
                let (status, text) = self.record_on(kib, "graph.toml", "run.mcap")?.end()?;
                if status.code() == Some(NO_MOUNT) {
                    panoscope_testing::skipped!("no file system can be mounted: {text}");
                    return Ok(());
                }
                if status.code().is_none_or(|code| code > 2) {
                    return Err(format!("{status}: {text}"));
                }
                let written = frames(&film);
                if status.success() {
                    return self.whole(case, &film, FRAMES);
                }
                if !text.contains("disk is full") && !text.contains("No space left") {
                    return Err(format!("no reason: {text}"));
                }
                let ticks = match self.folder.join("run.mcap").exists() {
                    true => self.replay(case, "run.mcap"),
                    false => Ok((0, false)),
                };
                // A limit below its first bytes leaves no recording.
                let (ticks, is_whole) = ticks.or_else(|error| match error.contains("not a recording") {
                    true => Ok((0, false)),
                    false => Err(error),
                })?;
                if is_whole && ticks < FRAMES {
                    return Err(format!("a replay of {ticks} of {FRAMES} ticks succeeds"));
                }
                self.frames += written;
            }
            Loss::Asleep { ms } => {
                let mut running = self.record("graph.toml", "run.mcap", Some(FRAMES))?;
                running.until_frames(&film, case.after_ms / 2)?;
                running.signal(libc::SIGSTOP);
                std::thread::sleep(Duration::from_millis(ms));
                running.signal(libc::SIGCONT);
                running.succeeds()?;
                self.whole(case, &film, FRAMES)?;
            }
        }
        Ok(())
    }

    /// Checks a video and a recording that must be complete.
    fn whole(&mut self, case: &Case, film: &Path, count: usize) -> Result<(), String> {
        let written = frames(film);
        let (ticks, is_whole) = self.replay(case, "run.mcap")?;
        if written != count || ticks != count || !is_whole {
            return Err(format!(
                "{written} frames in the video and {ticks} in the recording of {count}, whole: {is_whole}"
            ));
        }
        self.frames += written;
        Ok(())
    }
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

#[test]
fn nothing_that_was_acknowledged_is_lost() {
    let Some(program) = std::env::var_os("PANOSCOPE_BIN").map(PathBuf::from) else {
        return panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
    };
    let (cases, seed) = (number("PANOSCOPE_LOSS_CASES", 5), number("PANOSCOPE_LOSS_SEED", 1));
    let folder = scratch("losses");
    let mut campaign = Campaign { program, folder, expected: BTreeMap::new(), frames: 0, replays: 0 };
    let mut failures = Vec::new();
    for index in 0..cases {
        let case = Case::new(index, seed);
        if let Err(reason) = campaign.judge(&case) {
            failures.push(format!("case {index} of seed {seed}, {case:?}: {reason}"));
        }
    }
    let _ = std::fs::remove_dir_all(&campaign.folder);
    println!(
        "{cases} losses, {} not as they should be; {} frames and {} replays compared",
        failures.len(),
        campaign.frames,
        campaign.replays
    );
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
