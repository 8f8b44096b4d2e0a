//! The theatre: a surgeon's window over a running graph. Full screen, dark, large type; pictures and what must be known, and only the settings that
//! the preset offers. Nothing ever covers a picture's middle: what is told stands above, what can be done below, and the live picture beside a frozen
//! one in a corner.
//!
//! Whatever fails, a camera's own picture stays: where a view stops it takes its place, and where the graph as a whole cannot run its sources are
//! started alone.

mod acts;
mod arm;
mod arrange;
mod bars;
mod keep;
mod measure;
mod notices;
mod open;
mod plan;
mod records;
mod refused;
mod settings;
mod stage;
mod watch;

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui::{self, Context, Key, Rect, Ui, pos2, vec2};
use panoscope_graph::ParamValue;
use panoscope_graph::edit::GraphEdit;

use panoscope_editor_model::content::Rig;
use panoscope_editor_model::observe::{Observer, Output};
use panoscope_editor_model::session::{Phase, Session};
use panoscope_editor_model::surface::Sight;
use panoscope_editor_widgets::Shown;
use panoscope_editor_widgets::theme;
use panoscope_editor_widgets::{Costs, Shot};

pub use acts::{Act, key_words};
pub use arrange::Layout;
pub use keep::{free_bytes, with_clip, without_clip, write_still};
pub use measure::Length;
pub use notices::{Notice, Urgency};
pub use open::{OpenError, Options, Ready, Verified};
pub use plan::{Place, Plan, Setting};
pub use refused::Refused;

use keep::{Clip, Keeper};
use measure::Measure;
use notices::{Facts, Stages};
use watch::Seen;

/// How long Esc is held to leave, and the stop to be released.
const HOLD: Duration = Duration::from_secs(2);
/// How long a remark stays.
const REMARK: Duration = Duration::from_secs(5);
const TOP: f32 = 68.0;
const BOTTOM: f32 = 104.0;
const EDGE: f32 = 20.0;
/// Height of the window in points that sizes are made for, and the least width that all buttons have room in.
const USUAL_HEIGHT: f32 = 960.0;
const LEAST_WIDTH: f32 = 1180.0;

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
    /// Which of the settings are shown, where there is no room for all.
    page: usize,
    stages: Stages,
    told: Vec<Notice>,
    remark: Option<(String, bool, Instant)>,
    /// Since when Esc, and the released stop, are held.
    leaving: Option<Instant>,
    releasing: Option<Instant>,
    verified: Verified,
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
        Self::of(ctx, path, options, ready)
    }

    /// As [`Self::open`], of what was looked at already.
    ///
    /// # Errors
    /// The system gave no thread.
    pub fn of(ctx: &Context, path: &Path, options: Options, ready: Ready) -> Result<Self, OpenError> {
        theme::apply(ctx);
        theme::apply_theatre(ctx);
        let session = Session::new(path, &ready.plugin_paths, options.frames)?;
        let for_wake = ctx.clone();
        session.set_wake(Arc::new(move || for_wake.request_repaint()));
        let observer = Observer::new(session.handle())?;
        session.run(&ready.text);
        Ok(Self {
            plan: ready.plan,
            observer,
            session,
            text: ready.text,
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
            page: 0,
            stages: Stages::default(),
            told: Vec::new(),
            remark: None,
            leaving: None,
            releasing: None,
            verified: ready.verified,
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

    /// Whether somebody has verified what runs.
    pub fn verified(&self) -> &Verified {
        &self.verified
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

    /// From where the surface of an output, such as `points.cloud`, is looked at; `None` for one that was not shown yet.
    pub fn sight(&self, output: &str) -> Option<Sight> {
        self.sights.iter().find(|(known, _)| known.to_string() == output).map(|(_, sight)| *sight)
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
        let counters = self.observer.counters();
        self.look(&ctx);
        self.fall_back(&self.session.status());
        let status = self.session.status();
        let facts = self.facts(&status, &counters);
        self.told = notices::notices(&facts);
        self.keep_up(&status, &counters);
        // These press what has the focus, and tap while points are chosen by keys.
        let left: &[Key] = match ctx.memory(|m| m.focused().is_some()) {
            true => &[Key::Space, Key::Enter],
            false if self.measure.is_on() => &[Key::Enter],
            false => &[],
        };
        for act in ctx.input_mut(|input| acts::pressed(input, left)) {
            self.act(act);
        }
        self.leave(&ctx);
        self.follow_screen(&ctx);
        let whole = ui.available_rect_before_wrap();
        ui.allocate_rect(whole, egui::Sense::hover());
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

    /// Sizes follow the screen's height, so that type is as large on any, as far as its width has room for the buttons.
    fn follow_screen(&self, ctx: &Context) {
        let now = ctx.zoom_factor();
        let size_px = ctx.viewport_rect().size() * now;
        let zoom = (size_px.y / USUAL_HEIGHT * self.scale).min(size_px.x / LEAST_WIDTH).clamp(0.5, 4.0);
        // In steps, so that no window manager's rounding makes it swing.
        let zoom = (zoom * 20.0).round() / 20.0;
        if (zoom - now).abs() > 0.01 {
            ctx.set_zoom_factor(zoom);
        }
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
            Act::More => self.page += 1,
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

    fn clear_color(&self, _: &egui::Visuals) -> [f32; 4] {
        theme::BLACK.to_normalized_gamma_f32()
    }

    fn on_exit(&mut self, _: Option<&eframe::glow::Context>) {
        panoscope_engine::ending::signals::notice();
        self.session.close();
    }

    fn persist_egui_memory(&self) -> bool {
        false
    }
}
