//! Takes a screenshot of the window (`--screenshot`) or measures its costs (`--measure`), after a script of actions.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use eframe::egui::{self, Context};

use panoscope_editor_model::session::Session;

use crate::film::Film;

/// When the last part of a measurement begins, as a share of its time: the CPU time of the whole process is that of this part.
const LAST_PART: f64 = 0.5;

/// A script of actions, and what is written at its end.
#[derive(Clone, Debug)]
pub struct Shot {
    /// File of a screenshot, and the seconds until it is taken.
    screenshot: Option<(PathBuf, f64)>,
    /// A film, in place of a screenshot.
    film: Option<Film>,
    /// File for the window's costs, and the seconds until it is written.
    measure: Option<(PathBuf, f64)>,
    /// Steps with the second at which each is due.
    script: VecDeque<(f64, String)>,
    start: Instant,
    /// Share of a core that the whole process takes in the last part of the measurement, %.
    process_pct: Arc<Mutex<f64>>,
}

impl Default for Shot {
    fn default() -> Self {
        Self::new(None, None, &[])
    }
}

impl Shot {
    /// A screenshot (a film from the beginning of the script on, if its name ends with `.gif`) or costs after a number of seconds, and a script before that. The script begins once the graph has had time to start. A
    /// step `wait:2` delays the following steps by two seconds.
    pub fn new(screenshot: Option<(PathBuf, f64)>, measure: Option<(PathBuf, f64)>, script: &[String]) -> Self {
        let after = screenshot.as_ref().or(measure.as_ref()).map_or(0.0, |(_, after)| *after);
        let mut due = (after * 0.4).min(4.0);
        let is_film = |(file, _): &(PathBuf, f64)| file.extension().is_some_and(|ending| ending == "gif");
        let (film, screenshot) = match screenshot {
            Some(shot) if is_film(&shot) => (Some(Film::new(shot.0, ((due - 1.0).max(0.0), after))), None),
            other => (None, other),
        };
        let mut steps = VecDeque::new();
        for step in script {
            match step.strip_prefix("wait:").and_then(|s| s.parse::<f64>().ok()) {
                Some(seconds) => due += seconds,
                None => steps.push_back((due, step.clone())),
            }
        }
        let process_pct = Arc::new(Mutex::new(f64::NAN));
        if let Some((_, after)) = &measure {
            measure_process(*after, Arc::clone(&process_pct));
        }
        Self { screenshot, film, measure, script: steps, start: Instant::now(), process_pct }
    }

    /// Whether a screenshot or costs are written at the end, so that nobody is at the window.
    pub fn is_scripted(&self) -> bool {
        self.screenshot.is_some() || self.film.is_some() || self.measure.is_some()
    }

    /// The next step of the script, if one is due.
    pub fn step(&mut self) -> Option<String> {
        let due = self.script.front()?.0;
        if self.start.elapsed().as_secs_f64() > due { self.script.pop_front().map(|(_, step)| step) } else { None }
    }

    /// Writes the window's costs and the graph's report, when they are due.
    pub fn measure(&mut self, ctx: &Context, costs: &Costs, session: &Session) {
        self.measure_with(ctx, costs, || {
            let report = session.handle().engine()?.report();
            serde_json::to_value(report).ok()
        });
    }

    /// As [`Self::measure`], with the graph's report as `report` gives it.
    pub fn measure_with(&mut self, ctx: &Context, costs: &Costs, report: impl FnOnce() -> Option<serde_json::Value>) {
        let Some((file, after)) = self.measure.clone() else { return };
        let seconds = self.start.elapsed().as_secs_f64();
        if seconds < after {
            return ctx.request_repaint_after(Duration::from_secs_f64((after - seconds).max(0.01)));
        }
        let process_pct = *self.process_pct.lock().unwrap_or_else(PoisonError::into_inner);
        let (ui_ms, frames) = costs.mean();
        let measured = (seconds - Costs::WARM_UP.as_secs_f64()).max(1e-3);
        let report = report();
        let json = serde_json::json!({
            "ui_ms": ui_ms,
            "ui_fps": frames as f64 / measured,
            "ui_cpu_pct": ui_ms * frames as f64 / measured / 10.0,
            "process_cpu_pct": process_pct,
            "report": report,
        });
        if let Err(error) = std::fs::write(&file, format!("{json:#}\n")) {
            eprintln!("error: {} was not written: {error}", file.display());
        }
        self.measure = None;
        ctx.send_viewport_cmd(egui::ViewportCommand::Close);
    }

    /// Takes the screenshot, or the pictures of a film, when they are due.
    pub fn take(&mut self, ctx: &Context) {
        let seconds = self.start.elapsed().as_secs_f64();
        if self.film.as_mut().is_some_and(|film| film.take(ctx, seconds)) {
            self.film = None;
        }
        let Some((file, after)) = self.screenshot.clone() else { return };
        let elapsed = self.start.elapsed().as_secs_f64();
        let taken = ctx.input(|i| {
            i.events.iter().find_map(|e| match e {
                egui::Event::Screenshot { image, .. } => Some(Arc::clone(image)),
                _ => None,
            })
        });
        if let Some(image) = taken {
            let rgb: Vec<u8> = image.pixels.iter().flat_map(|p| [p.r(), p.g(), p.b()]).collect();
            let [width, height] = image.size.map(|n| n as u32);
            let saved = image::RgbImage::from_raw(width, height, rgb).map(|picture| picture.save(&file));
            match saved {
                Some(Ok(())) => println!("{}", file.display()),
                Some(Err(error)) => eprintln!("error: {} was not written: {error}", file.display()),
                None => eprintln!("error: the window returned no screenshot"),
            }
            self.screenshot = None;
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        } else if elapsed > after {
            ctx.send_viewport_cmd(egui::ViewportCommand::Screenshot(egui::UserData::default()));
            ctx.request_repaint_after(Duration::from_millis(200));
        } else {
            ctx.request_repaint_after(Duration::from_millis(100));
        }
    }
}

/// CPU time of the window's thread, which includes drawing by egui and the graphics driver.
#[derive(Clone, Debug)]
pub struct Costs {
    start: Instant,
    /// CPU time at the first measured frame and at the last one, ms.
    at_ms: (f64, f64),
    /// Number of measured frames.
    pub frames: u64,
}

impl Default for Costs {
    fn default() -> Self {
        Self { start: Instant::now(), at_ms: (0.0, 0.0), frames: 0 }
    }
}

impl Costs {
    /// Time before the measurement: start-up, fonts, shaders, first textures.
    const WARM_UP: Duration = Duration::from_secs(2);

    /// Counts a frame; call it once per frame.
    pub fn count_frame(&mut self) {
        let now_ms = thread_cpu_ms();
        if self.start.elapsed() < Self::WARM_UP {
            (self.at_ms, self.frames) = ((now_ms, now_ms), 0);
        } else {
            (self.at_ms.1, self.frames) = (now_ms, self.frames + 1);
        }
    }

    /// Mean CPU time per frame in ms, and the number of measured frames.
    pub fn mean(&self) -> (f64, u64) {
        ((self.at_ms.1 - self.at_ms.0) / self.frames.max(1) as f64, self.frames)
    }
}

/// Measures the process in the last part of a measurement of `after` seconds, on a thread of its own: no frame is drawn for it.
fn measure_process(after: f64, place: Arc<Mutex<f64>>) {
    let measure = move || {
        std::thread::sleep(Duration::from_secs_f64((after * LAST_PART).max(0.0)));
        let (began_ms, began) = (process_cpu_ms(), Instant::now());
        std::thread::sleep(Duration::from_secs_f64((after * (1.0 - LAST_PART) - 0.3).max(0.1)));
        let pct = (process_cpu_ms() - began_ms) / began.elapsed().as_secs_f64().max(1e-3) / 10.0;
        *place.lock().unwrap_or_else(PoisonError::into_inner) = pct;
    };
    // Without the thread there is no figure.
    let _ = std::thread::Builder::new().name("measure".to_owned()).spawn(measure);
}

/// CPU time of this thread in ms.
fn thread_cpu_ms() -> f64 {
    cpu_ms(libc::CLOCK_THREAD_CPUTIME_ID)
}

/// CPU time of all threads of this process in ms.
fn process_cpu_ms() -> f64 {
    cpu_ms(libc::CLOCK_PROCESS_CPUTIME_ID)
}

fn cpu_ms(clock: libc::clockid_t) -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a valid `timespec` for the call to write to.
    let status = unsafe { libc::clock_gettime(clock, &raw mut time) };
    if status == 0 { time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6 } else { 0.0 }
}
