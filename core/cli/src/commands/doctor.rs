//! `panoscope doctor`.

use std::ffi::CString;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;
use panoscope_engine::Machine;
use panoscope_loader as loader;

use super::devices;
use crate::End;
use crate::installation::Installation;
use crate::terminal::{out, stdout_color};
use panoscope_eval::graph_file;

/// How a thing stands.
#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Fine,
    /// Some graphs or benches do without.
    Optional,
    Bad,
}

struct Doctor {
    color: bool,
    bad: usize,
    installation: Installation,
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
            let how = "not allowed: control nodes run at normal priority. For a user `me`: `me - rtprio 50` in /etc/security/limits.conf, then log in again";
            self.say(State::Optional, "real-time priority", how);
        }
    }

    fn plugins(&mut self) {
        out!("plugins");
        let mut any = false;
        for folder in loader::search_path(&[]) {
            let found = panoscope_loader::Loader::search(std::slice::from_ref(&folder));
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
                }
                Err(problem) => {
                    let mend = missing_library(&problem.message).unwrap_or(problem.help);
                    self.say(State::Bad, &name, &format!("{}; {mend}", problem.message));
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
        match open_library("libgstreamer-1.0.so.0") {
            Ok(()) => self.say(State::Fine, "GStreamer", "libgstreamer-1.0.so.0 loads"),
            Err(_) => {
                let how = "pipelines in `capture` and the peer of `bench hop`; `apt install libgstreamer1.0-0 gstreamer1.0-plugins-base gstreamer1.0-plugins-good`";
                self.say(State::Optional, "GStreamer", how);
            }
        }
        self.onnx_runtime();
    }

    fn onnx_runtime(&mut self) {
        let mut places: Vec<PathBuf> = std::env::var_os("ORT_DYLIB_PATH").map(PathBuf::from).into_iter().collect();
        if let Some(folder) = std::env::current_exe().ok().as_deref().and_then(Path::parent) {
            for up in [Some(folder), folder.parent()].into_iter().flatten() {
                places.extend(libraries_in(&up.join("onnxruntime")));
                places.extend(libraries_in(up));
            }
        }
        let loads = |path: &PathBuf| path.to_str().is_some_and(|p| open_library(p).is_ok());
        match places.iter().find(|path| path.is_file()) {
            Some(path) if loads(path) => self.say(State::Fine, "ONNX Runtime", &path.display().to_string()),
            Some(path) => self.say(
                State::Bad,
                "ONNX Runtime",
                &format!(
                    "{} does not load: remove it and run `cargo xtask onnxruntime`, or reinstall Panoscope",
                    path.display()
                ),
            ),
            None if open_library("libonnxruntime.so").is_ok() => {
                self.say(State::Fine, "ONNX Runtime", "libonnxruntime.so of the system")
            }
            None => {
                let how =
                    "tool detection needs it; `cargo xtask onnxruntime` fetches it, or name the file in ORT_DYLIB_PATH";
                self.say(State::Optional, "ONNX Runtime", how);
            }
        }
    }

    fn cameras(&mut self) {
        out!("cameras");
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
    let mut doctor = Doctor { color: stdout_color(), bad: 0, installation: Installation::current() };
    doctor.installation();
    doctor.machine();
    doctor.plugins();
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

/// Whether a thread of this process may have real-time priority: tried on a thread of its own.
fn realtime_allowed() -> bool {
    let tried = std::thread::spawn(|| {
        let priority = libc::sched_param { sched_priority: 20 };
        // SAFETY: a plain system call; it concerns the calling thread only, which ends here.
        unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const priority) == 0 }
    });
    tried.join().unwrap_or(false)
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

/// Tries the dynamic linker; the library stays loaded until the program ends.
fn open_library(name: &str) -> Result<(), ()> {
    let name = CString::new(name).map_err(|_| ())?;
    // SAFETY: constructors of a system library run; it is never closed.
    let handle = unsafe { libc::dlopen(name.as_ptr(), libc::RTLD_LAZY | libc::RTLD_LOCAL) };
    if handle.is_null() { Err(()) } else { Ok(()) }
}

/// The package with the library that the dynamic linker misses, as far as it is known.
fn missing_library(message: &str) -> Option<String> {
    let library = message.split([' ', ':', '`']).find(|word| word.starts_with("lib") && word.contains(".so"))?;
    let packages = if library.starts_with("libopencv_ximgproc") {
        "libopencv-contrib-dev"
    } else if library.starts_with("libopencv") {
        "libopencv-dev"
    } else if library.starts_with("libgst") {
        "libgstreamer1.0-0 libgstreamer-plugins-base1.0-0"
    } else {
        return None;
    };
    message.contains("cannot open shared object").then(|| format!("`apt install {packages}`"))
}

#[cfg(test)]
mod tests {
    use super::missing_library;

    #[test]
    fn a_missing_library_is_named_with_its_package() {
        let words =
            "x.so does not load: libopencv_core.so.406: cannot open shared object file: No such file or directory";
        assert_eq!(missing_library(words).as_deref(), Some("`apt install libopencv-dev`"));
        assert_eq!(missing_library("x.so does not load: libother.so: cannot open shared object file"), None);
    }
}
