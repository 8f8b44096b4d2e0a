//! `cargo xtask screens`: screenshots of both windows with running graphs, taken on a virtual screen.

use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};

use crate::build::{Profile, build, build_windows};
use crate::packages::Purpose;
use crate::process;
use crate::setup;
use crate::workspace::Workspace;

/// Name of the screenshot (a film if it ends with `.gif`), graph, actions before it is taken, seconds until then.
const SCREENS: &[(&str, &str, &[&str], &str)] = &[
    ("bench", "graphs/panorama.toml", &[], "8"),
    ("bench_node", "graphs/panorama.toml", &["select:wide"], "8"),
    ("bench_depth", "graphs/depth.toml", &["select:stereo"], "12"),
    ("bench_part", "graphs/depth.toml", &["select:stereo", "openpart"], "12"),
    ("bench_arguments", "graphs/panorama_files.toml", &[], "6"),
    ("bench_heat_text", "graphs/stereo_wls_fbs.toml", &["heat", "text"], "12"),
    ("bench_plots", "graphs/panorama.toml", &["plots"], "20"),
    (
        "bench_sweep",
        "graphs/depth.toml",
        &["select:lengths", "sweep:lengths.radius_px lengths.table.error_mm[1]"],
        "45",
    ),
    (
        "bench_history",
        "graphs/panorama.toml",
        &["set:wide/composite.blend_px=8", "wait:1", "set:wide/composite.blend_px=24", "history"],
        "9",
    ),
    ("bench_pick", "graphs/depth.toml", &["select:lengths", "pick:lengths.points"], "10"),
    ("bench_files", "graphs/panorama_files.toml", &["browse:scope.left"], "6"),
    ("bench_viewer", "graphs/panorama.toml", &["view:wide/composite.panorama"], "8"),
    ("bench_compare", "graphs/depth.toml", &["view:stereo/rectify.left", "compare:stereo/points.depth"], "12"),
    ("bench_surface", "graphs/depth.toml", &["view:stereo/points.cloud"], "12"),
    ("bench_arm", "graphs/surgeon.toml", &["view:points.cloud", "orbit:2.2,0.5,0.09"], "15"),
    ("bench_system", "graphs/surgeon.toml", &[], "15"),
    ("bench_problems", "tests/bad_graphs/many_mistakes.toml", &["problems", "text"], "4"),
    ("bench_templates", "graphs/new.toml", &[], "4"),
    ("bench_plugins", "graphs/panorama.toml", &["plugins"], "8"),
    ("bench_add", "graphs/panorama.toml", &["add"], "8"),
    ("bench_keys", "graphs/panorama.toml", &["help"], "8"),
    // A rewire and back, a sweep, a swap of the plugins: while the graph runs.
    (
        "bench_film.gif",
        "graphs/panorama.toml",
        &[
            "wire:scope.left still.image",
            "wait:2",
            "undo",
            "wait:2",
            "sweep:wide/register.hessian_threshold wide/register.rms_px",
            "wait:16",
            "sweep",
            "reload",
        ],
        "27",
    ),
    ("theatre", "graphs/depth.toml", &[], "12"),
    ("theatre_panorama", "graphs/panorama.toml", &["view:1"], "8"),
    ("theatre_surface", "graphs/depth.toml", &["view:2"], "12"),
    ("theatre_measure", "graphs/depth.toml", &["measure", "wait:2", "tap:0.45,0.4", "tap:0.7,0.62"], "14"),
    ("theatre_arguments", "graphs/panorama_files.toml", &[], "6"),
    ("theatre_frozen", "graphs/panorama.toml", &["freeze"], "8"),
    ("theatre_arm", "graphs/surgeon.toml", &[], "15"),
    ("theatre_arm_stopped", "graphs/surgeon.toml", &["stop", "more"], "15"),
];

/// A virtual screen, closed when dropped.
struct Screen {
    server: Child,
    display: String,
}

impl Screen {
    fn start() -> Result<Self> {
        for number in 60..90 {
            let display = format!(":{number}");
            let mut command = Command::new("Xvfb");
            command.args([display.as_str(), "-screen", "0", "1440x900x24", "-nolisten", "tcp"]);
            let mut server =
                command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().context("Xvfb does not start")?;
            // It ends at once where the display is taken.
            std::thread::sleep(Duration::from_millis(1500));
            if server.try_wait()?.is_none() {
                return Ok(Self { server, display });
            }
        }
        bail!("no free display for Xvfb")
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// Takes all screenshots, or those that `args` names after the folder.
///
/// # Errors
/// Something is missing, the build fails, or a screenshot was not taken.
pub fn screens(workspace: &Workspace, args: &[String]) -> Result<()> {
    setup::ensure(&[Purpose::Build, Purpose::Screens])?;
    let folder = args.first().map_or_else(|| workspace.target.join("screens"), PathBuf::from);
    let only = args.get(1..).unwrap_or_default();
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let built = build(workspace, Profile::Release)?;
    let windows = build_windows(workspace, Profile::Release)?;
    let screen = Screen::start()?;
    for (name, graph, actions, after) in SCREENS.iter().filter(|s| only.is_empty() || only.iter().any(|o| o == s.0)) {
        let file = folder.join(if name.contains('.') { (*name).to_owned() } else { format!("{name}.png") });
        let _ = fs::remove_file(&file);
        let is_theatre = name.starts_with("theatre");
        let mut command = Command::new(if is_theatre { &windows.theatre } else { &windows.editor });
        command.arg(workspace.root.join(graph)).arg("--screenshot").arg(&file).args(["--after", after]);
        if is_theatre {
            command.args(["--unlocked", "--windowed", "--into"]).arg(folder.join("kept"));
        }
        for action in *actions {
            command.args(["--do", action]);
        }
        command.env("DISPLAY", &screen.display).env("LIBGL_ALWAYS_SOFTWARE", "1").env_remove("WAYLAND_DISPLAY");
        command.env("PANOSCOPE_PLUGIN_PATH", &built.plugin_dir);
        process::run(&mut command)?;
        ensure!(file.is_file(), "the screenshot {} was not taken", file.display());
    }
    Ok(())
}
