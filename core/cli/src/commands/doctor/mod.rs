//! `panoscope doctor`.

mod arm;
mod libraries;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;
use panoscope_engine::Machine;
use panoscope_graph::{NodeType, ParamKind, can_listen, installed};
use panoscope_host::loader;
use panoscope_host::loader::graph_file;
use panoscope_host::loader::keys::Trust;

use super::devices;
use crate::installation::{Installation, Kind};
use crate::terminal::{out, stdout_color};
use crate::{End, beside};
use libraries::{ELEMENTS, GStreamer};

/// State of a checked item.
#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Fine,
    /// Only needed by some graphs or benches.
    Optional,
    Bad,
}

/// The highest real-time priority that a part of Panoscope asks for: that of the arm's guard.
const PRIORITY: i32 = 60;

struct Doctor {
    color: bool,
    bad: usize,
    installation: Installation,
    /// Types of nodes that can listen for other programs.
    listeners: Vec<String>,
}

impl Doctor {
    fn say(&mut self, state: State, what: &str, about: &str) {
        let (word, style) = match state {
            State::Fine => ("ok     ", "\x1b[32m"),
            State::Optional => ("absent ", "\x1b[33m"),
            State::Bad => ("WRONG  ", "\x1b[31m"),
        };
        let word = if self.color { format!("{style}{word}\x1b[0m") } else { word.to_owned() };
        self.bad += usize::from(state == State::Bad);
        out!("  {word} {what}: {about}");
    }

    fn installation(&mut self) {
        out!("installation");
        let description = self.installation.description();
        self.say(State::Fine, env!("CARGO_PKG_VERSION"), &description);
        match self.installation.graph_dir.clone() {
            None => self.say(State::Fine, "graphs", "in the source tree; each writes beside itself"),
            Some(folder) => {
                let files = fs::read_dir(&folder).into_iter().flatten().flatten().map(|entry| entry.path());
                let count = files.filter(|file| file.extension().is_some_and(|e| e == "toml")).count();
                match count {
                    0 => self.say(
                        State::Bad,
                        "graphs",
                        &format!("none in {}; {}", folder.display(), self.installation.repair()),
                    ),
                    n => {
                        let output = installed::output_dir();
                        let about =
                            format!("{n} in {}; from here they write into {}", folder.display(), output.display());
                        self.say(State::Fine, "graphs", &about);
                    }
                }
            }
        }
        let programs = [
            (beside::LAB, "`panoscope eval`, `export`, `dicom` and others"),
            (beside::EDITOR, "`panoscope edit`"),
            (beside::THEATRE, "`panoscope theatre`"),
        ];
        for (program, what) in programs {
            let file = self.installation.program_dir.join(program);
            match file.is_file() {
                true => self.say(State::Fine, program, &file.display().to_string()),
                false => {
                    let (state, how) = match self.installation.kind {
                        Kind::Build => (State::Optional, self.installation.repair()),
                        Kind::Wheel if program != beside::LAB => {
                            (State::Optional, "the Python package is without windows: install the Debian package")
                        }
                        Kind::Package | Kind::Folder | Kind::Wheel => (State::Bad, self.installation.repair()),
                    };
                    let how = format!("{what} needs {}; {how}", file.display());
                    self.say(state, program, &how);
                }
            }
        }
    }

    /// Keys whose locks are accepted, and the audit log.
    fn trust(&mut self) {
        out!("trust");
        let folders = Trust::folders().iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ");
        match Trust::installed() {
            Ok(trust) if trust.is_empty() => {
                let about =
                    format!("none: locks need no signature. Public keys (*.pub) in one of {folders} change that");
                self.say(State::Optional, "trusted keys", &about);
            }
            Ok(trust) => {
                for key in trust.keys() {
                    self.say(
                        State::Fine,
                        &format!("key {}", key.name()),
                        &format!("{}, its locks are accepted", key.short()),
                    );
                }
            }
            Err(error) => self.say(State::Bad, "trusted keys", &error.to_string()),
        }
        let Some(folder) = panoscope_host::audit::folder() else { return };
        match panoscope_host::audit::read(&folder) {
            Ok(report) if report.problems.is_empty() => {
                let about = format!("{} lines in {}, unbroken", report.entries.len(), folder.display());
                self.say(State::Fine, "audit log", &about);
            }
            Ok(report) => {
                let about = format!("damaged in {} places; `panoscope audit` shows them", report.problems.len());
                self.say(State::Bad, "audit log", &about);
            }
            Err(error) => self.say(State::Bad, "audit log", &format!("{}: {error}", folder.display())),
        }
    }

    fn machine(&mut self) {
        out!("machine");
        let machine = Machine::here(0);
        self.say(State::Fine, "processor", &format!("{}, {} cores for this process", machine.cpu, machine.cores));
        let memory = fs::read_to_string("/proc/meminfo").unwrap_or_default();
        let kib = |key: &str| -> Option<f64> {
            memory
                .lines()
                .find_map(|l| l.strip_prefix(key))?
                .trim_start_matches(':')
                .split_whitespace()
                .next()?
                .parse()
                .ok()
        };
        if let (Some(total), Some(free)) = (kib("MemTotal"), kib("MemAvailable")) {
            let text = format!("{:.1} GiB, {:.1} GiB available", total / 1_048_576.0, free / 1_048_576.0);
            self.say(State::Fine, "memory", &text);
        }
        let files = limit(libc::RLIMIT_NOFILE);
        let state = if files.is_some_and(|n| n < 256) { State::Bad } else { State::Fine };
        self.say(
            state,
            "open files",
            &files.map_or_else(|| "no limit".to_owned(), |n| format!("{n} at most (ulimit -n)")),
        );
        let locked =
            limit(libc::RLIMIT_MEMLOCK).map_or_else(|| "no limit".to_owned(), |n| format!("{} KiB at most", n / 1024));
        self.say(State::Fine, "locked memory", &locked);
        if realtime_allowed() {
            self.say(State::Fine, "real-time priority", "allowed (SCHED_FIFO)");
        } else {
            let how = format!(
                "not allowed: control nodes run at normal priority. For a user `me`: `me - rtprio {}` in /etc/security/limits.d/panoscope.conf, then log in again",
                PRIORITY
            );
            self.say(State::Optional, "real-time priority", &how);
        }
        let panoscope_host::isolate::Kernel { landlock, seccomp } = panoscope_host::isolate::kernel();
        match (landlock, seccomp) {
            (Some(version), true) => {
                let about = format!("`deny` is enforced: network by seccomp, new files by Landlock {version}");
                self.say(State::Fine, "isolated nodes", &about);
            }
            (landlock, seccomp) => {
                let lacks = [(seccomp, "seccomp for `network`"), (landlock.is_some(), "Landlock for `new_files`")];
                let lacks: Vec<&str> = lacks.iter().filter(|(there, _)| !there).map(|(_, what)| *what).collect();
                let about = format!("this kernel lacks {}: `deny` of a graph does nothing there", lacks.join(" and "));
                self.say(State::Optional, "isolated nodes", &about);
            }
        }
        for (state, what, about) in arm::lines() {
            self.say(state, &what, &about);
        }
    }

    fn plugins(&mut self) {
        out!("plugins");
        let mut any = false;
        for folder in loader::search_path(&[]) {
            let found = panoscope_host::loader::Loader::search(std::slice::from_ref(&folder));
            let count = found.found().count();
            any |= count > 0;
            let about = match (folder.is_dir(), count) {
                (false, _) => "no such folder".to_owned(),
                (true, n) => format!("{n} plugins"),
            };
            out!("          searched {}: {about}", folder.display());
        }
        let loader = graph_file::all_plugins();
        let names: Vec<String> = loader.found().map(|f| f.note.name.clone()).collect();
        for name in names {
            match loader.load(&name) {
                Ok(loaded) => {
                    let about =
                        format!("{}, loads, {} node types", loaded.plugin.note.version, loaded.node_types.len());
                    self.say(State::Fine, &name, &about);
                    loaded.node_types.iter().for_each(|node_type| self.shipped_files(node_type));
                    let listeners = loaded.node_types.iter().filter(|node_type| can_listen(node_type));
                    self.listeners.extend(listeners.map(|node_type| format!("`{}`", node_type.name)));
                }
                Err(problem) => {
                    self.say(State::Bad, &name, &format!("{}; {}", problem.message, problem.help));
                }
            }
        }
        for problem in loader.problems() {
            self.say(State::Bad, &problem.plugin, &format!("{}; {}", problem.message, problem.help));
        }
        if !any {
            let how = format!(
                "none found: {}, or name their folder in {}",
                self.installation.repair(),
                loader::PLUGIN_PATH_VARIABLE
            );
            self.say(State::Bad, "plugins", &how);
        }
    }

    /// Models and other files that come with a node.
    fn shipped_files(&mut self, node_type: &NodeType) {
        for param in node_type.params.iter().filter(|param| param.shipped) {
            let ParamKind::Path { default, .. } = &param.kind else { continue };
            let file = node_type.shipped_dir.join(default);
            let what = format!("{}.{}", node_type.name, param.name);
            match fs::metadata(&file) {
                Ok(meta) => self.say(State::Fine, &what, &format!("{} ({} kB)", file.display(), meta.len() / 1000)),
                Err(error) => {
                    let how = format!("{}: {error}; {}", file.display(), self.installation.repair());
                    self.say(State::Bad, &what, &how);
                }
            }
        }
    }

    /// Lists what can listen for other programs. All of it is off by default.
    fn network(&mut self) {
        out!("network: nothing listens unless you ask for it");
        let web = "pictures, ages and metrics over HTTP, for reading only; on 127.0.0.1 unless you give IP:PORT";
        self.say(State::Fine, "run --web PORT", web);
        let foxglove = "WebSocket, outputs and parameters for Foxglove; on 127.0.0.1; reads outputs and parameters; sets numbers, switches and choices only with --foxglove-set";
        self.say(State::Fine, "run --foxglove PORT|IP:PORT", foxglove);
        for one in panoscope_host::attach::LISTENERS {
            self.say(State::Fine, one.option, &format!("{}; on {}; {}", one.what, one.default_address, one.access));
        }
        let serve = "nodes of other machines over TLS; hosts that --allow names, with certificates of your authority";
        self.say(State::Fine, "serve --listen ADDRESS", serve);
        let names = std::mem::take(&mut self.listeners);
        if !names.is_empty() {
            let about = "where their parameters say, 127.0.0.1 by default; `panoscope check GRAPH` lists where those of a graph do";
            self.say(State::Fine, &format!("nodes {}", names.join(", ")), about);
        }
    }

    fn programs(&mut self) {
        out!("programs and libraries");
        for (program, package, what) in [
            ("ffmpeg", "ffmpeg", "turns recordings into other formats"),
            ("ffprobe", "ffmpeg", "looks into recordings"),
            ("dot", "graphviz", "draws what `panoscope dot` writes"),
        ] {
            match find_program(program) {
                Some(path) => self.say(State::Fine, program, &path.display().to_string()),
                None => self.say(State::Optional, program, &format!("{what}; `apt install {package}`")),
            }
        }
        match libraries::mapped("libopencv_core.so") {
            Some(file) => self.say(State::Fine, "OpenCV", &file.display().to_string()),
            None => self.say(State::Optional, "OpenCV", "no plugin loaded it; nodes of `opencv` need it"),
        }
        self.gstreamer();
        self.onnx_runtime();
    }

    fn gstreamer(&mut self) {
        let Some(gstreamer) = GStreamer::open() else {
            let packages: Vec<&str> = ELEMENTS.iter().map(|(package, ..)| *package).collect();
            let how =
                format!("cameras, files and streams need it; `apt install libgstreamer1.0-0 {}`", packages.join(" "));
            return self.say(State::Bad, "GStreamer", &how);
        };
        self.say(State::Fine, "GStreamer", &gstreamer.version);
        for (package, what, elements) in ELEMENTS {
            let missing: Vec<&str> = elements.iter().copied().filter(|element| !gstreamer.has(element)).collect();
            if missing.is_empty() {
                self.say(State::Fine, package, what);
                continue;
            }
            // Without the first two no video comes in at all.
            let is_needed = package.ends_with("-base") || package.ends_with("-good");
            let state = if is_needed { State::Bad } else { State::Optional };
            self.say(state, package, &format!("{what}; no {}; `apt install {package}`", missing.join(", ")));
        }
    }

    fn onnx_runtime(&mut self) {
        let mut places: Vec<PathBuf> = std::env::var_os("ORT_DYLIB_PATH").map(PathBuf::from).into_iter().collect();
        if let Some(folder) = std::env::current_exe().ok().as_deref().and_then(Path::parent) {
            for up in [Some(folder), folder.parent()].into_iter().flatten() {
                places.extend(libraries_in(&up.join("onnxruntime")));
                places.extend(libraries_in(up));
            }
        }
        let loads = |path: &PathBuf| path.to_str().is_some_and(libraries::loads);
        match places.iter().find(|path| path.is_file()) {
            Some(path) if loads(path) => self.say(State::Fine, "ONNX Runtime", &path.display().to_string()),
            Some(path) => self.say(
                State::Bad,
                "ONNX Runtime",
                &format!("{} does not load; {}", path.display(), self.runtime_repair()),
            ),
            None if libraries::loads("libonnxruntime.so") => {
                self.say(State::Fine, "ONNX Runtime", "libonnxruntime.so of the system")
            }
            None => {
                let how =
                    format!("tool detection needs it; {}, or name its file in ORT_DYLIB_PATH", self.runtime_repair());
                self.say(State::Optional, "ONNX Runtime", &how);
            }
        }
    }

    fn runtime_repair(&self) -> &'static str {
        match self.installation.kind {
            Kind::Build => "`cargo xtask onnxruntime` fetches it",
            Kind::Package | Kind::Folder | Kind::Wheel => self.installation.repair(),
        }
    }

    fn cameras(&mut self) {
        out!("devices");
        match rule() {
            Some(file) => self.say(State::Fine, "udev rule", &file.display().to_string()),
            None => {
                let how = match self.installation.kind {
                    Kind::Package => self.installation.repair(),
                    Kind::Folder => "copy share/doc/panoscope/70-panoscope.rules to /etc/udev/rules.d",
                    Kind::Wheel => "become a member of both groups",
                    Kind::Build => "copy core/xtask/package/70-panoscope.rules to /etc/udev/rules.d",
                };
                let why = "without it only members of the groups `video` and `dialout` open cameras and the arm's serial port";
                self.say(State::Optional, "udev rule", &format!("{why}; {how}"));
            }
        }
        self.say(State::Fine, "GPU", "not used: nodes compute on the processor; the windows draw with OpenGL");
        let cameras = devices::cameras();
        if cameras.is_empty() {
            self.say(State::Optional, "cameras", "no video devices; files and the phantom work without");
        }
        for camera in cameras {
            let name = camera.path.display().to_string();
            match camera.accessible {
                Some(true) => self.say(State::Fine, &name, &camera.name),
                Some(false) => {
                    self.say(
                        State::Bad,
                        &name,
                        &format!("{}: no permission; `sudo usermod -aG video $USER`, then log in again", camera.name),
                    );
                }
                None => self.say(State::Bad, &name, &format!("{}: its device file is missing", camera.name)),
            }
        }
    }
}

/// Shows what is installed, what is missing and how to get it.
pub fn run() -> Result<End> {
    let mut doctor =
        Doctor { color: stdout_color(), bad: 0, installation: Installation::current(), listeners: Vec::new() };
    doctor.installation();
    doctor.trust();
    doctor.machine();
    doctor.plugins();
    doctor.network();
    doctor.programs();
    doctor.cameras();
    Ok(if doctor.bad == 0 { End::Done } else { End::Failed })
}

/// The soft limit of a resource; `None` for no limit.
fn limit(resource: libc::__rlimit_resource_t) -> Option<u64> {
    // SAFETY: the struct is written by the call and is plain data.
    let limit = unsafe {
        let mut limit: libc::rlimit = std::mem::zeroed();
        libc::getrlimit(resource, &raw mut limit);
        limit
    };
    (limit.rlim_cur != libc::RLIM_INFINITY).then_some(limit.rlim_cur)
}

/// Whether a thread of this process may have real-time priority: tested on a separate thread.
fn realtime_allowed() -> bool {
    let tried = std::thread::spawn(|| {
        let priority = libc::sched_param { sched_priority: 20 };
        // SAFETY: a plain system call; it concerns the calling thread only, which ends here.
        unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const priority) == 0 }
    });
    tried.join().unwrap_or(false)
}

/// The udev rule that gives the user at the machine access to cameras and serial ports.
fn rule() -> Option<PathBuf> {
    let folders = ["/etc/udev/rules.d", "/run/udev/rules.d", "/usr/lib/udev/rules.d", "/lib/udev/rules.d"];
    folders.map(|folder| Path::new(folder).join("70-panoscope.rules")).into_iter().find(|file| file.is_file())
}

fn find_program(name: &str) -> Option<PathBuf> {
    std::env::split_paths(&std::env::var_os("PATH")?).map(|folder| folder.join(name)).find(|file| file.is_file())
}

fn libraries_in(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let is_onnx =
        |path: &PathBuf| path.file_name().is_some_and(|n| n.to_string_lossy().starts_with("libonnxruntime.so"));
    entries.flatten().map(|e| e.path()).filter(is_onnx).collect()
}
