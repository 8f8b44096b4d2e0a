//! The theatre: a surgeon's window over a running graph. Full screen, dark, large type; pictures and what must be known, and only the settings that
//! the preset offers. Nothing ever covers a picture: what is told stands above, what can be done below.
//!
//! Whatever fails, a camera's own picture stays: where a view stops it takes its place, and where the graph as a whole cannot run its sources are
//! started alone.

mod acts;
mod arrange;
mod bars;
mod keep;
mod measure;
mod notices;
mod open;
mod plan;
mod records;
mod settings;
mod stage;

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui::{self, Context, Key, Rect, Ui, pos2, vec2};
use panoscope_graph::edit::GraphEdit;
use panoscope_graph::{GraphText, ParamValue};
use panoscope_runtime::clock;

use crate::app::{Costs, Shot};
use crate::content::{Content, Rig};
use crate::observe::{Counters, Observer, Output, Wanted};
use crate::panels::Shown;
use crate::session::{Phase, Session, Status};
use crate::surface::Sight;
use crate::theme;

pub use acts::{Act, key_words};
pub use arrange::Layout;
pub use keep::{free_bytes, next_file, with_clip, without_clip, write_still};
pub use measure::Length;
pub use notices::{Notice, Urgency};
pub use open::{OpenError, Options, Ready};
pub use plan::{Place, Plan, Setting};

use keep::{Clip, Keeper};
use measure::Measure;
use notices::{Facts, STOPPED, Stages, told};

/// Shortest time from one picture to the next.
const INTERVAL: Duration = Duration::from_millis(33);
/// How long Esc is held to leave, and the stop to be released.
const HOLD: Duration = Duration::from_secs(2);
/// How long a view may take to show its first picture before it counts as stopped.
const FIRST: Duration = Duration::from_secs(5);
/// How long a remark stays.
const REMARK: Duration = Duration::from_secs(5);
/// Most columns of a view.
const MOST_WIDTH: usize = 4096;
/// Columns of a camera's picture that is only watched.
const WATCHED_WIDTH: usize = 64;
const TOP: f32 = 68.0;
const BOTTOM: f32 = 104.0;
const EDGE: f32 = 20.0;
/// Height of the window in points that sizes are made for.
const USUAL_HEIGHT: f32 = 960.0;

/// When something was seen of an output, and how old it was.
#[derive(Clone, Copy, Debug)]
struct Seen {
    at: Instant,
    ingest_ns: Option<u64>,
}

/// The window.
pub struct Theatre {
    plan: Plan,
    session: Session,
    observer: Observer,
    /// The whole graph as it is to run: the file's, with the settings and the clip of now.
    text: String,
    /// Only the sources run, for this reason.
    raw_only: Option<String>,
    shown: Shown,
    /// The raw view, which goes on while the rest is frozen.
    live: Shown,
    seen: HashMap<Output, Seen>,
    running_since: Option<Instant>,
    layout: Layout,
    frozen: Option<Instant>,
    measure: Measure,
    /// Cameras behind the points to measure in.
    rig: Option<Rig>,
    sights: HashMap<Output, Sight>,
    keeper: Keeper,
    clip: Option<Clip>,
    emergency: bool,
    /// Settings that were changed here, by node and parameter.
    chosen: HashMap<(String, String), ParamValue>,
    stages: Stages,
    told: Vec<Notice>,
    remark: Option<(String, bool, Instant)>,
    /// Since when Esc, and the released stop, are held.
    leaving: Option<Instant>,
    releasing: Option<Instant>,
    unlocked: Option<String>,
    scale: f32,
    left: bool,
    shot: Shot,
    costs: Costs,
}

impl Theatre {
    /// Opens a graph file whose text was read, compares it with its lock and sets it going.
    ///
    /// # Errors
    /// See [`OpenError`]; nothing runs then.
    pub fn open(ctx: &Context, path: &Path, text: &str, options: Options) -> Result<Self, OpenError> {
        let ready = Ready::look(path, text, options.unlocked)?;
        Self::of(ctx, path, text, options, ready)
    }

    /// As [`Self::open`], of what was looked at already.
    ///
    /// # Errors
    /// The system gave no thread.
    pub fn of(ctx: &Context, path: &Path, text: &str, options: Options, ready: Ready) -> Result<Self, OpenError> {
        theme::apply(ctx);
        theme::apply_theatre(ctx);
        let paths = GraphText::parse(path, text).plugin_paths();
        let session = Session::new(path, &paths, options.frames)?;
        let for_wake = ctx.clone();
        session.set_wake(Arc::new(move || for_wake.request_repaint()));
        let observer = Observer::new(session.handle())?;
        session.run(text);
        Ok(Self {
            plan: ready.plan,
            observer,
            session,
            text: text.to_owned(),
            raw_only: None,
            shown: Shown::default(),
            live: Shown::default(),
            seen: HashMap::new(),
            running_since: None,
            layout: Layout::All,
            frozen: None,
            measure: Measure::default(),
            rig: None,
            sights: HashMap::new(),
            keeper: Keeper::new(&options.folder, options.label.as_deref())?,
            clip: None,
            emergency: false,
            chosen: HashMap::new(),
            stages: Stages::default(),
            told: Vec::new(),
            remark: None,
            leaving: None,
            releasing: None,
            unlocked: ready.unlocked,
            scale: options.scale,
            left: false,
            shot: options.shot,
            costs: Costs::default(),
        })
    }

    /// What the graph offers.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The session.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// What is told now, the most urgent first.
    pub fn notices(&self) -> &[Notice] {
        &self.told
    }

    /// What is shown of the views.
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Whether the picture is held still.
    pub fn is_frozen(&self) -> bool {
        self.frozen.is_some()
    }

    /// The clip under way.
    pub fn clip_file(&self) -> Option<&Path> {
        self.clip.as_ref().map(|c| c.file.as_path())
    }

    /// Distance between the two points that were tapped last.
    pub fn distance(&self) -> Option<Length> {
        self.measure.distance()
    }

    /// Whether the window was asked to close.
    pub fn has_left(&self) -> bool {
        self.left
    }

    /// What was remarked last.
    pub fn remark(&self) -> Option<&str> {
        self.remark.as_ref().map(|(words, ..)| words.as_str())
    }

    pub(crate) fn say(&mut self, words: impl Into<String>, wrong: bool) {
        self.remark = Some((words.into(), wrong, Instant::now()));
    }

    /// Draws a frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        self.costs.count_frame();
        let ctx = ui.ctx().clone();
        let status = self.session.status();
        let counters = self.observer.counters();
        self.look(&ctx);
        self.fall_back(&status);
        let facts = self.facts(&status, &counters);
        self.told = notices::notices(&facts);
        self.keep_up(&status, &counters);
        let focused = ctx.memory(|m| m.focused().is_some());
        for act in ctx.input_mut(|input| acts::pressed(input, focused)) {
            self.act(act);
        }
        self.leave(&ctx);
        self.follow_screen(&ctx);
        let whole = ui.available_rect_before_wrap();
        ui.allocate_rect(whole, egui::Sense::hover());
        ui.painter().rect_filled(whole, 0.0, theme::BLACK);
        let top = Rect::from_min_size(whole.min, vec2(whole.width(), TOP));
        let bottom = Rect::from_min_max(pos2(whole.left(), whole.bottom() - BOTTOM), whole.max);
        let stage =
            Rect::from_min_max(pos2(whole.left() + EDGE, top.bottom()), pos2(whole.right() - EDGE, bottom.top() - 8.0));
        self.top_bar(ui, top, &status, &facts);
        self.stage(ui, stage, &facts);
        self.bottom_bar(ui, bottom);
        self.want();
        // Ages grow without anything new to show.
        ctx.request_repaint_after(Duration::from_millis(100));
        self.play_script(&ctx);
        self.shot.take(&ctx);
        self.shot.measure(&ctx, &self.costs, &self.session);
    }

    /// Sizes follow the screen's height, so that type is as large on any.
    fn follow_screen(&self, ctx: &Context) {
        let now = ctx.zoom_factor();
        let height_px = ctx.viewport_rect().height() * now;
        let zoom = (height_px / USUAL_HEIGHT * self.scale).clamp(0.5, 4.0);
        // In steps, so that no window manager's rounding makes it swing.
        let zoom = (zoom * 20.0).round() / 20.0;
        if (zoom - now).abs() > 0.01 {
            ctx.set_zoom_factor(zoom);
        }
    }

    /// Takes what came since the last frame.
    fn look(&mut self, ctx: &Context) {
        let mut looks = self.observer.take();
        let now = Instant::now();
        for (output, look) in &looks {
            self.seen.insert(output.clone(), Seen { at: now, ingest_ns: look.ingest_ns });
        }
        if let Some(rig) = &self.plan.rig
            && let Some(Content::Rig(known)) = looks.get(&rig.calibration).map(|look| &look.content)
        {
            self.rig = Some(*known);
        }
        if let (Some(known), Some(rig)) = (self.rig, &self.plan.rig) {
            self.measure.know(known, rig.noise);
        }
        if let Some(cloud) = self.plan.cloud.clone().filter(|_| self.measure.waits())
            && let Some(look) = looks.remove(&cloud)
            && look.cloud.is_some()
        {
            self.measure.take(ctx, &cloud, look);
            self.frozen = Some(now);
        }
        if let Some(raw) = self.plan.raw.as_ref().map(|raw| &raw.output)
            && let Some(look) = looks.get(raw)
        {
            self.live.update(ctx, HashMap::from([(raw.clone(), look.clone())]));
        }
        if self.frozen.is_none() {
            self.shown.update(ctx, looks);
        }
    }

    /// When the graph as a whole cannot run, its sources go on alone.
    fn fall_back(&mut self, status: &Status) {
        match status.phase {
            Phase::Running if self.running_since.is_none() => self.running_since = Some(Instant::now()),
            Phase::Running => {}
            _ => self.running_since = None,
        }
        if self.raw_only.is_some() || status.busy {
            return;
        }
        let why = match (&status.phase, &status.trouble) {
            (Phase::Failed(why), _) => why.clone(),
            (Phase::Idle | Phase::Ended, Some(trouble)) => trouble.words.clone(),
            _ => return,
        };
        self.clip_is_over();
        match self.plan.raw_only(&self.text) {
            Ok(text) => self.session.restart(&text),
            Err(error) => self.say(error.to_string(), true),
        }
        self.raw_only = Some(why);
        self.frozen = None;
        self.measure = Measure::default();
    }

    fn facts(&mut self, status: &Status, counters: &Counters) -> Facts {
        let running = status.phase == Phase::Running;
        let since = self.running_since.map(|s| s.elapsed()).unwrap_or_default();
        let silent = |output: &Output| self.seen.get(output).map(|seen| seen.at.elapsed().min(since));
        let has_stopped = |output: &Output| silent(output).map_or(since > FIRST, |age| age > STOPPED);
        let lost = self.plan.cameras.iter().filter(|c| running && has_stopped(&c.output));
        let lost: Vec<_> = lost.map(|c| (c.label.clone(), silent(&c.output))).collect();
        let raw_goes_on = self.plan.raw.as_ref().is_some_and(|raw| !has_stopped(&raw.output));
        let looking = running && self.frozen.is_none() && self.raw_only.is_none();
        let stopped = self.displayed().into_iter().filter(|_| looking && raw_goes_on && !self.measure.waits());
        let stopped = stopped.filter(|p| has_stopped(&p.output) && !self.plan.is_source(&p.output.node));
        let stopped: Vec<String> = stopped.map(|p| p.label.clone()).collect();
        let main = self.plan.views.get(self.layout.main()).map(|v| v.output.clone());
        let age_ms = main.filter(|_| looking).and_then(|main| self.age_ms(&main));
        let calibrated = |metric| told(counters, metric);
        Facts {
            phase: status.phase.clone(),
            trouble: status.trouble.as_ref().filter(|_| !status.busy).map(|t| t.words.clone()),
            raw_only: self.raw_only.clone(),
            emergency: self.emergency,
            lost,
            stopped,
            age_ms,
            stages: self.stages.look(counters, Instant::now()),
            free_bytes: self.keeper.free_bytes(),
            recording: self.clip.is_some(),
            drifted: calibrated("drifted"),
            swapped: calibrated("views_swapped"),
            unlocked: self.unlocked.clone(),
        }
    }

    /// Age of what is known of an output: from its tick's ingest until now.
    fn age_ms(&self, output: &Output) -> Option<f64> {
        let ingest_ns = self.seen.get(output)?.ingest_ns?;
        Some(clock::now_ns().saturating_sub(ingest_ns) as f64 / 1e6)
    }

    /// Views that the layout shows.
    fn displayed(&self) -> Vec<&Place> {
        match self.layout {
            Layout::All => self.plan.views.iter().collect(),
            Layout::One(n) => self.plan.views.get(n).into_iter().collect(),
        }
    }

    /// Whether the place of a view is taken by the raw one, because it has stopped.
    fn replaced(&self, place: &Place, facts: &Facts) -> bool {
        self.raw_only.is_some() || facts.stopped.contains(&place.label)
    }

    /// Tells the observer what is looked at.
    fn want(&mut self) {
        let mut wanted: HashMap<Output, Wanted> = HashMap::new();
        let of = |place: &Place, most_width| Wanted { packet: place.packet.clone(), most_width, ..Wanted::default() };
        for camera in &self.plan.cameras {
            wanted.insert(camera.output.clone(), of(camera, WATCHED_WIDTH));
        }
        if let Some(raw) = &self.plan.raw {
            wanted.insert(raw.output.clone(), of(raw, MOST_WIDTH));
        }
        if let Some(rig) = self.plan.rig.as_ref().filter(|_| self.measure.is_on() && self.rig.is_none()) {
            let packet = "calibration".to_owned();
            wanted.insert(rig.calibration.clone(), Wanted { packet, most_width: 1, ..Wanted::default() });
        }
        if self.frozen.is_none() && self.raw_only.is_none() {
            for place in self.displayed() {
                let sight =
                    (place.packet == "cloud").then(|| self.sights.get(&place.output).copied().unwrap_or_default());
                wanted.insert(place.output.clone(), Wanted { sight, ..of(place, MOST_WIDTH) });
            }
            if let Some(cloud) = self.plan.cloud.as_ref().filter(|_| self.measure.waits()) {
                let packet = "cloud".to_owned();
                let points = Wanted { packet, most_width: MOST_WIDTH, points: true, ..Wanted::default() };
                wanted.insert(cloud.clone(), points);
            }
        }
        self.observer.want(wanted, INTERVAL);
    }

    /// Does what is asked for.
    pub fn act(&mut self, act: Act) {
        let count = self.plan.views.len();
        match act {
            Act::Next => self.layout = self.layout.next(count),
            Act::Previous => self.layout = self.layout.previous(count),
            Act::One(n) if n < count => {
                self.layout = if self.layout == Layout::One(n) { Layout::All } else { Layout::One(n) };
            }
            Act::One(_) => {}
            Act::Freeze if self.raw_only.is_some() => self.say("the camera's own picture is never held still", false),
            Act::Freeze if self.frozen.is_none() && !self.has_picture() => self.say("there is no picture yet", true),
            Act::Freeze => {
                self.frozen = if self.frozen.is_some() { None } else { Some(Instant::now()) };
                self.measure = Measure::default();
            }
            Act::Still => self.still(),
            Act::Record => self.record(),
            Act::Measure => self.measure_or_end(),
            // Stopped already: holding lets it go.
            Act::Stop if self.emergency => self.releasing = Some(Instant::now()),
            Act::Stop => self.emergency_stop(true),
            Act::Again => self.again(),
        }
        if matches!(act, Act::Next | Act::Previous | Act::One(_)) && self.measure.is_on() {
            self.measure = Measure::default();
            self.frozen = None;
        }
    }

    /// Whether the main view has shown anything.
    pub fn has_picture(&self) -> bool {
        let main = self.plan.views.get(self.layout.main());
        main.is_some_and(|m| self.shown.texture(&m.output).is_some())
    }

    fn measure_or_end(&mut self) {
        if self.measure.is_on() {
            self.measure = Measure::default();
            self.frozen = None;
        } else if self.plan.cloud.is_none() || self.raw_only.is_some() {
            self.say("this graph has no points to measure in", true);
        } else {
            self.frozen = None;
            self.measure = Measure::begin();
        }
    }

    /// Starts the whole graph again, after it has stopped.
    fn again(&mut self) {
        let ended = matches!(self.session.status().phase, Phase::Ended | Phase::Failed(_));
        if self.raw_only.take().is_some() || ended {
            self.seen.clear();
            self.session.restart(&self.text);
        }
    }

    /// Stops the arm at once, or lets it go again.
    pub fn emergency_stop(&mut self, on: bool) {
        if self.plan.stops.is_empty() {
            return;
        }
        self.emergency = on;
        let engine = self.session.handle().engine();
        let mut failed = Vec::new();
        let mut resets = Vec::new();
        for stop in &self.plan.stops {
            // Now, even while the graph is being changed.
            let set = engine.as_ref().map(|e| e.set_bool_at_once(&stop.node, plan::EMERGENCY_STOP, on));
            if !matches!(set, Some(Ok(()))) && self.raw_only.is_none() {
                failed.push(stop.node.clone());
            }
            let values = engine.as_ref().and_then(|e| e.param_values(&stop.node));
            if let Some(ParamValue::Int(number)) = stop.reset.and_then(|at| values?.into_iter().nth(at))
                && !on
            {
                resets.push((stop.node.clone(), number.wrapping_add(1).max(0)));
            }
        }
        let stops = &self.plan.stops;
        let text = GraphEdit::parse(&self.text).and_then(|mut edit| {
            stops.iter().try_for_each(|stop| edit.set_param(&stop.node, plan::EMERGENCY_STOP, &on.into()))?;
            resets.iter().try_for_each(|(node, number)| edit.set_param(node, plan::RESET, &(*number).into()))?;
            Ok(edit.text())
        });
        match text {
            // And once more as part of the graph, so that it outlasts every change.
            Ok(text) => self.run(text),
            Err(error) => self.say(error.to_string(), true),
        }
        if !failed.is_empty() {
            self.say(format!("{} did not take the stop: switch the arm off", failed.join(", ")), true);
        }
    }

    /// Lets the arm go once the button, or the key, was held long enough.
    fn release(&mut self, ctx: &Context, held: bool) {
        let keys = acts::KEYS.iter().find(|(act, _)| *act == Act::Stop).map_or(&[][..], |(_, keys)| keys);
        let held = held || ctx.input(|i| keys.iter().any(|key| i.key_down(*key)));
        match self.releasing {
            Some(_) if !held => self.releasing = None,
            Some(since) if since.elapsed() >= HOLD => {
                self.releasing = None;
                self.emergency_stop(false);
            }
            Some(_) => ctx.request_repaint(),
            None => {}
        }
    }

    /// Whether the arm was stopped from here.
    pub fn is_stopped(&self) -> bool {
        self.emergency
    }

    /// The whole graph's text from now on.
    fn run(&mut self, text: String) {
        self.text = text;
        if self.raw_only.is_none() {
            self.session.run(&self.text);
        }
    }

    /// Value of a setting now: what was chosen here, else what is in force.
    fn value(&self, setting: &Setting) -> Option<ParamValue> {
        if let Some(chosen) = self.chosen.get(&(setting.node.clone(), setting.param.name.clone())) {
            return Some(chosen.clone());
        }
        let engine = self.session.handle().engine()?;
        engine.param_values(&setting.node)?.into_iter().nth(setting.index)
    }

    /// Puts a value of a setting in force; it is never written to the file.
    pub fn choose(&mut self, node: &str, param: &str, value: ParamValue) {
        let toml: toml::Value = match &value {
            ParamValue::Bool(on) => (*on).into(),
            ParamValue::Int(number) => (*number).into(),
            ParamValue::Float(number) => (*number).into(),
            ParamValue::Choice { name, .. } => name.as_str().into(),
            _ => return,
        };
        let text = GraphEdit::parse(&self.text).and_then(|mut edit| {
            edit.set_param(node, param, &toml)?;
            Ok(edit.text())
        });
        match text {
            Ok(text) => {
                self.chosen.insert((node.to_owned(), param.to_owned()), value);
                self.run(text);
            }
            Err(error) => self.say(error.to_string(), true),
        }
    }

    /// Esc for a moment ends what is begun; held for two seconds it leaves.
    fn leave(&mut self, ctx: &Context) {
        let down = ctx.input(|i| i.key_down(Key::Escape));
        if !down {
            if self.leaving.take().is_some_and(|since| since.elapsed() < HOLD / 4) && self.measure.is_on() {
                self.measure_or_end();
            }
            return;
        }
        let since = *self.leaving.get_or_insert_with(Instant::now);
        ctx.request_repaint();
        if since.elapsed() >= HOLD && !self.left {
            self.left = true;
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        }
    }

    fn play_script(&mut self, ctx: &Context) {
        while let Some(step) = self.shot.step() {
            let (word, rest) = step.split_once(':').unwrap_or((&step, ""));
            let named = acts::KEYS.iter().find(|(act, _)| format!("{act:?}").eq_ignore_ascii_case(word));
            match (word, named) {
                (_, Some((act, _))) => self.act(*act),
                ("view", _) => self.act(Act::One(rest.parse::<usize>().unwrap_or(1).saturating_sub(1))),
                ("tap", _) => {
                    let at = rest.split_once(',').and_then(|(x, y)| Some((x.parse().ok()?, y.parse().ok()?)));
                    if let Some((x, y)) = at {
                        self.measure.tap(x, y);
                    }
                }
                _ => self.say(format!("there is no action `{step}`"), true),
            }
            ctx.request_repaint();
        }
    }
}

impl eframe::App for Theatre {
    fn ui(&mut self, ui: &mut Ui, _: &mut eframe::Frame) {
        Self::ui(self, ui);
    }

    fn on_exit(&mut self, _: Option<&eframe::glow::Context>) {
        self.session.close();
    }

    fn persist_egui_memory(&self) -> bool {
        false
    }
}
