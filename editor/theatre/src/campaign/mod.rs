//! The campaign of truthful pictures: seeded runs of simulated windows in which cameras stop, slip, swap, stick and return, and processes die. What
//! the screenshots show is compared with what was sent.
//!
//! `PANOSCOPE_PICTURE_CASES` sets the number of runs (10 without it), `PANOSCOPE_PICTURE_SEED` the first seed.

mod cases;
mod marks;
mod screen;
mod world;

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use eframe::egui::{Color32, Context, vec2};
use egui_kittest::Harness;
use panoscope_base::random::SplitMix64;
use panoscope_editor_widgets::golden::{Textures, paint};
use panoscope_graph::{Catalog, GraphText, Param, ParamKind, Pick, check};

use self::marks::Mark;
use self::screen::{Screen, Shown};
use self::world::{CameraState, DEPTH, LEFT, RIGHT, Reading, SURFACE, Simulated, WIDE, World};
use crate::plan::tests::node;
use crate::{Action, Opened, Options, Output, OutputCache, Pane, Plan, Theatre, Verified, time};

/// Simulated time of a run, ms.
const RUN_MS: u64 = 10_000;
/// The age from which on no image is shown undimmed, ms: the next frame is drawn up to 100 ms later.
const MAX_AGE_MS: u64 = 1100;
/// From here on a camera is silent or slow, ms.
const MIN_SILENT_MS: u64 = 800;
/// How long a camera may be stuck before that can be known, ms.
const MAX_STUCK_MS: u64 = 250;
/// Longest time from a camera to a frame of the window, ms.
const MAX_WAY_MS: u64 = 250;
/// From here on a silent camera has a notice, ms.
const MAX_SILENT_MS: u64 = 1600;
/// What counts as live is not older, ms.
const MAX_LIVE_MS: u64 = 320;
/// How much younger than it is an image may be called, ms: frames wait, and ages are rounded.
const AGE_ERROR_MS: f64 = 60.0;
/// Number of choices of views.
const VIEWS: usize = 4;
/// Time between two screenshots, frames.
const EVERY: u64 = 2;

fn catalog() -> Catalog {
    let text = |name: &str| Param {
        name: name.to_owned(),
        doc: String::new(),
        unit: String::new(),
        kind: ParamKind::Text { default: String::new() },
        reopen: true,
        pick: Pick::None,
        writes: false,
        shipped: false,
    };
    let mut scope = node("scope", &[], &["left:image", "right:image"]);
    scope.params = vec![text("left"), text("right")];
    let node_types = vec![
        scope,
        node("camera", &[], &["image:image"]),
        node("rig", &[], &["calibration:calibration"]),
        node("wide", &["l:image", "r:image"], &["panorama:image"]),
        node("depth", &["l:image", "r:image"], &["image:image"]),
        node("points", &["l:image", "r:image", "calibration:calibration"], &["cloud:cloud"]),
    ];
    Catalog { plugins: vec!["p".to_owned()], node_types, ..Catalog::default() }
}

fn graph(reading: Reading, views: &str) -> String {
    let sources = match reading.has_two_sources() {
        true => "[nodes.left]\ntype = \"camera\"\n[nodes.right]\ntype = \"camera\"\n",
        false => "[nodes.scope]\ntype = \"scope\"\nparams = { left = \"/dev/video0\", right = \"/dev/video1\" }\n",
    };
    let inputs = match reading.has_two_sources() {
        true => "l = \"left.image\", r = { from = \"right.image\", align = \"latest\" }",
        false => "l = \"scope.left\", r = \"scope.right\"",
    };
    format!(
        "plugins = [\"p\"]\n{sources}[nodes.rig]\ntype = \"rig\"\n\
         [nodes.wide]\ntype = \"wide\"\ninputs = {{ {inputs} }}\n\
         [nodes.depth]\ntype = \"depth\"\ninputs = {{ {inputs} }}\n\
         [nodes.points]\ntype = \"points\"\ninputs = {{ {inputs}, calibration = {{ from = \"rig.calibration\", align = \"latest\" }} }}\n\
         [preset]\nviews = [{views}]\n"
    )
}

/// One run.
struct Run {
    world: Rc<RefCell<World>>,
    harness: Harness<'static, Option<Theatre>>,
    textures: Textures,
    dice: SplitMix64,
    /// Titles of each mark's view, by the number of the view.
    titles: Vec<Vec<String>>,
    frozen_ms: Option<u64>,
    tally: Tally,
}

/// What was looked at.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    screens: u64,
    images: u64,
    unreadable: u64,
    dimmed: u64,
    lengths: u64,
    pairs: u64,
    lost: u64,
}

impl Tally {
    fn add(&mut self, other: Self) {
        self.screens += other.screens;
        self.images += other.images;
        self.unreadable += other.unreadable;
        self.dimmed += other.dimmed;
        self.lengths += other.lengths;
        self.pairs += other.pairs;
        self.lost += other.lost;
    }
}

impl Run {
    fn new(seed: u64) -> Self {
        let mut dice = SplitMix64(seed);
        let reading = Reading::ALL[dice.below(Reading::ALL.len())];
        let views = dice.below(VIEWS);
        Self::of(reading, views, dice)
    }

    /// Of a way to read the cameras and a choice of views.
    fn of(reading: Reading, chosen: usize, mut dice: SplitMix64) -> Self {
        let left = if reading.has_two_sources() { "left.image" } else { "scope.left" };
        let views: [String; VIEWS] = [
            format!("\"wide.panorama\", \"depth.image\", \"points.cloud\", \"{left}\""),
            format!("\"depth.image\", \"{left}\""),
            format!("\"{left}\", \"wide.panorama\""),
            "\"points.cloud\"".to_owned(),
        ];
        let text = graph(reading, &views[chosen]);
        let catalog = catalog();
        let (graph, _) =
            check(&GraphText::parse("g.toml".as_ref(), &text), &catalog).into_result().expect("it is right");
        let plan = Plan::of(&graph, &catalog);
        let world = Rc::new(RefCell::new(World::new(reading, SplitMix64(dice.bits()))));
        let of = |node: &str, n: usize| {
            let output =
                if n < 2 { world.borrow().camera(n) } else { Output::new(node, ["panorama", "image", "cloud"][n - 2]) };
            let panes = plan.views.iter().chain(&plan.cameras);
            panes.filter(|pane| pane.output == output).map(Pane::title).collect::<Vec<_>>()
        };
        let mut titles = vec![Vec::new(); usize::from(SURFACE) + 1];
        for (n, (view, node)) in
            [(LEFT, ""), (RIGHT, ""), (WIDE, "wide"), (DEPTH, "depth"), (SURFACE, "points")].into_iter().enumerate()
        {
            titles[usize::from(view)] = of(node, n);
        }
        let folder = std::env::temp_dir().join(format!("panoscope_pictures_{}", std::process::id()));
        let options = Options { folder, ..Options::default() };
        let opened = Opened { plan, verified: Verified::AsLocked, text, lock: None, overridden: None, sealed: false };
        let runner = Rc::clone(&world);
        let open = move |ctx: &Context| {
            let runner = Box::new(Simulated(Rc::clone(&runner)));
            Theatre::show(ctx, "g.toml".as_ref(), options.clone(), opened.clone(), runner).expect("a thread")
        };
        let textures = Textures::default();
        // Small, because each pixel of a screenshot is computed.
        let harness = Harness::builder().with_size(vec2(720.0, 480.0)).renderer(textures.clone()).build_ui_state(
            move |ui, theatre: &mut Option<Theatre>| theatre.get_or_insert_with(|| open(ui.ctx())).ui(ui),
            None,
        );
        Self { world, harness, textures, dice, titles, frozen_ms: None, tally: Tally::default() }
    }

    fn theatre(&self) -> &Theatre {
        self.harness.state().as_ref().expect("it is open")
    }

    /// Runs; returns what went wrong first.
    fn run(&mut self) -> Result<(), String> {
        let mut frame = 0_u64;
        while self.world.borrow().ms < RUN_MS {
            let steps = 2 + self.dice.below(9);
            if self.dice.below(12) == 0 {
                self.act();
            }
            frame += 1;
            self.draw(steps, frame.is_multiple_of(EVERY))?;
        }
        Ok(())
    }

    /// Passes a number of steps and draws a frame; looks at it if it `is_judged`.
    fn draw(&mut self, steps: usize, is_judged: bool) -> Result<(), String> {
        (0..steps).for_each(|_| self.world.borrow_mut().step());
        self.harness.step();
        let now_ms = self.world.borrow().ms;
        self.frozen_ms = self.theatre().frozen.map(|at| now_ms - time::since(at).as_millis() as u64);
        if !is_judged {
            return Ok(());
        }
        let screen = Screen::read(&self.harness.ctx, self.harness.output(), &self.textures);
        self.judge(&screen).map_err(|error| {
            let file = std::env::temp_dir().join(format!("panoscope_pictures_{}_{now_ms}.png", std::process::id()));
            let _ = paint(&self.harness.ctx, self.harness.output(), &self.textures, Color32::BLACK).save(&file);
            let texts: Vec<&str> = screen.texts.iter().map(|(_, text)| text.as_str()).collect();
            let (world, notices) = (self.world.borrow(), self.theatre().notices());
            format!(
                "{error}\n at {now_ms} ms, {:?}, frozen since {:?}, notices {notices:?}\n texts {texts:?}\n images {:?}\n{}\n {}",
                world.reading,
                self.frozen_ms,
                screen.images,
                world.log(),
                file.display()
            )
        })
    }

    /// The user does something.
    fn act(&mut self) {
        const ACTIONS: [Action; 12] = [
            Action::Next,
            Action::Previous,
            Action::One(0),
            Action::One(1),
            Action::Freeze,
            Action::Freeze,
            Action::Measure,
            Action::Measure,
            Action::ThreeD,
            Action::Inset,
            Action::Checklist,
            Action::Again,
        ];
        let action = ACTIONS[self.dice.below(ACTIONS.len())];
        self.world.borrow_mut().note(format!("{action:?}"));
        let [x, y] = [0; 2].map(|_| 0.1 + 0.8 * self.dice.below(1000) as f32 / 1000.0);
        let theatre = self.harness.state_mut().as_mut().expect("it is open");
        if theatre.measure.picture().is_some() && action != Action::Measure {
            theatre.measure.tap(x, y);
        } else {
            theatre.perform(action);
        }
    }

    fn judge(&mut self, screen: &Screen) -> Result<(), String> {
        let world = Rc::clone(&self.world);
        let world = world.borrow();
        self.tally.screens += 1;
        let shows_pair = self.theatre().shows_pair();
        let mut eyes = Vec::new();
        let is_stuck = (0..2).any(|n| world.was_stuck[n] || world.ms - world.changed_ms[n] < 2 * MAX_WAY_MS);
        for image in &screen.images {
            self.tally.images += 1;
            let [Some((mark, is_bright)), Some((other, _))] = image.marks else {
                self.tally.unreadable += 1;
                continue;
            };
            self.tally.dimmed += u64::from(!is_bright);
            eyes.extend(if mark == other { vec![mark] } else { vec![mark, other] });
            if is_bright {
                // What was frozen is as old as it was then.
                let is_live = self.frozen_ms.is_none() || image.title.starts_with("Live");
                let at_ms = self.frozen_ms.filter(|_| !is_live).unwrap_or(world.ms);
                let age_ms = at_ms.saturating_sub(mark.light_ms.min(other.light_ms));
                let limit_ms = if is_stuck { MAX_AGE_MS + MAX_STUCK_MS } else { MAX_AGE_MS };
                if age_ms > limit_ms {
                    return Err(format!("undimmed and {age_ms} ms old: {image:?}"));
                }
                // That a camera is stuck shows after a while only.
                let is_known = is_live && !is_stuck;
                if let Some(said) = image.age_ms.filter(|said| is_known && said + AGE_ERROR_MS < age_ms as f64) {
                    return Err(format!("{age_ms} ms old and called {said} ms old: {image:?}"));
                }
            }
            if !shows_pair {
                self.judge_title(&world, screen, image, mark)?;
            }
        }
        if shows_pair && let [left, right] = eyes[..] {
            self.tally.pairs += 1;
            if !world.pairs.contains(&[left.light_ms, right.light_ms]) {
                return Err(format!("no pair: {left:?} and {right:?}"));
            }
            // Before they are known to be exchanged, the eyes show what is on the cables.
            let is_exchanged = match [left.view, right.view] {
                [LEFT, RIGHT] => false,
                [RIGHT, LEFT] => true,
                _ => return Err(format!("no two eyes: {left:?} and {right:?}")),
            };
            if is_exchanged && !self.may_be_exchanged(&world, screen, 0, left) {
                return Err(format!("the eyes are exchanged: {left:?} and {right:?}"));
            }
        }
        self.judge_lengths(&world, screen)?;
        self.judge_notices(&world)?;
        if screen.texts.iter().any(|(_, text)| text == "LIVE") && !is_stuck {
            let is_bright = |image: &Shown| image.marks[0].is_none_or(|(_, is_bright)| is_bright);
            let present = |image: &Shown| {
                is_bright(image) && self.mark(image).is_some_and(|mark| world.ms - mark.light_ms <= MAX_LIVE_MS)
            };
            let has_readable = screen.images.iter().any(|image| self.mark(image).is_some());
            if has_readable && !screen.images.iter().any(present) {
                return Err("called live, and nothing is".to_owned());
            }
        }
        Ok(())
    }

    /// What an image shows, also where something covers a part of it.
    fn mark(&self, image: &Shown) -> Option<Mark> {
        let theatre = self.theatre();
        let panes = || theatre.plan.views.iter().chain(&theatre.plan.cameras);
        let covered = || {
            let caches = [&theatre.shown, &theatre.live];
            let of = |cache: &OutputCache, pane: &Pane| {
                let (texture, _) = cache.texture(&pane.output)?;
                Mark::of(cache.pixels(&pane.output).filter(|_| texture == image.texture)?)
            };
            caches.into_iter().find_map(|cache| panes().find_map(|pane| of(cache, pane)))
        };
        image.marks[0].map(|(mark, _)| mark).or_else(covered)
    }

    /// Whether the title of an image names what it shows.
    fn judge_title(&self, world: &World, screen: &Screen, image: &Shown, mark: Mark) -> Result<(), String> {
        let shown = image.title.split(" (in place of").next().unwrap_or_default();
        // A picture that is measured has a hint in place of the title; the whole of a zoomed one has none.
        if self.theatre().measure.picture().is_some() && !shown.starts_with("Live") {
            return Ok(());
        }
        let is_named = |view: u8| self.titles[usize::from(view)].iter().any(|title| shown.contains(title.as_str()));
        if is_named(mark.view) {
            return Ok(());
        }
        let (other, n) = if mark.view == LEFT { (RIGHT, 1) } else { (LEFT, 0) };
        if mark.view <= RIGHT && is_named(other) && self.may_be_exchanged(world, screen, n, mark) {
            return Ok(());
        }
        Err(format!("wrong name: {image:?}, which is one of {:?}", self.titles[usize::from(mark.view)]))
    }

    /// Whether the image of a camera may show what the other one sees: a notice says that they are exchanged, or that could not be known.
    fn may_be_exchanged(&self, world: &World, screen: &Screen, camera: usize, mark: Mark) -> bool {
        let is_said = || self.theatre().notices().iter().any(|notice| notice.message.contains("swapped"));
        world.cabling(&world.camera(camera), mark).is_some_and(|cabling| cabling.is_swapped && !cabling.is_known)
            || screen.has("swapped")
            || is_said()
    }

    /// No length rests on lost light or on swapped views.
    fn judge_lengths(&mut self, world: &World, screen: &Screen) -> Result<(), String> {
        let lengths: Vec<&str> =
            screen.texts.iter().map(|(_, text)| text.as_str()).filter(|text| text.contains(" mm")).collect();
        if lengths.is_empty() {
            return Ok(());
        }
        self.tally.lengths += 1;
        let held = self.theatre().measure.picture().and_then(|(held, output)| held.texture(output));
        let is_shown = held.is_some_and(|(texture, _)| screen.images.iter().any(|image| image.texture == texture));
        // The points that were tapped cover a part of it.
        let mark = self.theatre().measure.picture().and_then(|(held, output)| Mark::of(held.pixels(output)?));
        match (mark.filter(|_| is_shown), self.frozen_ms) {
            (Some(mark), Some(_))
                if world
                    .cabling(&Output::new("points", "cloud"), mark)
                    .is_none_or(|cabling| cabling.is_swapped && cabling.is_known) =>
            {
                Err(format!("swapped views give a length: {lengths:?}, {mark:?}"))
            }
            (Some(mark), Some(frozen_ms)) if frozen_ms.saturating_sub(mark.light_ms) <= MAX_AGE_MS => Ok(()),
            other => Err(format!("a length of old light: {lengths:?}, {other:?}")),
        }
    }

    /// Cameras that are called lost are lost, and the lost ones are named.
    fn judge_notices(&mut self, world: &World) -> Result<(), String> {
        let silent_ms = |n: usize| world.sent_ms[n].map_or(world.ms, |sent_ms| world.ms - sent_ms);
        let is_dead =
            |n: usize| world.cameras[n] == CameraState::Silent && world.ms - world.changed_ms[n] > MIN_SILENT_MS;
        let titles = [LEFT, RIGHT].map(|view| self.titles[usize::from(view)].last().cloned().unwrap_or_default());
        let theatre = self.harness.state().as_ref().expect("it is open");
        let mut named = [false; 2];
        for notice in theatre.notices() {
            let message = notice.message.as_str();
            let alone = message
                .split_once(" lost: no image")
                .map(|(title, _)| title)
                .or_else(|| message.strip_suffix(" delivers no image"));
            let listed = message.strip_prefix("No new image: none from ");
            for n in [0, 1] {
                if alone == Some(titles[n].as_str()) {
                    self.tally.lost += 1;
                    named[n] = true;
                    let has_sent_for_ms =
                        world.ms - world.changed_ms[n].max(world.changed_ms[1 - n]).max(world.since_ms);
                    if silent_ms(n) < MIN_SILENT_MS && has_sent_for_ms > MAX_WAY_MS {
                        return Err(format!("camera {n} sends and is called lost"));
                    }
                    if world.cameras[n] != CameraState::Silent
                        && has_sent_for_ms > MAX_WAY_MS
                        && is_dead(1 - n)
                        && !world.is_last_word(n)
                        && world.is_running()
                        && world.ms - world.since_ms > MIN_SILENT_MS
                    {
                        return Err(format!("camera {n} is called lost instead of the other one"));
                    }
                }
                named[n] |= listed.is_some_and(|listed| listed.contains(titles[n].as_str()));
            }
        }
        let has_run = world.is_running() && world.ms - world.since_ms > MAX_SILENT_MS;
        for n in [0, 1] {
            let is_lost =
                world.cameras[n] == CameraState::Silent && world.sent_ms[n].is_some_and(|at| at > world.since_ms);
            let is_known = named[n] || theatre.outage().is_some() || named[1 - n] && !world.reading.has_two_sources();
            if has_run && is_lost && silent_ms(n) > MAX_SILENT_MS && !is_known {
                return Err(format!("camera {n} is lost and not named"));
            }
        }
        Ok(())
    }
}

fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(otherwise)
}

/// Runs seeds; returns what was looked at and what went wrong, by seed.
fn campaign(first: u64, cases: u64) -> (Tally, Vec<(u64, String)>) {
    let (next, found, tally) = (AtomicU64::new(first), Mutex::new(Vec::new()), Mutex::new(Tally::default()));
    let work = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= first + cases {
                return;
            }
            let mut run = Run::new(seed);
            let result = run.run();
            tally.lock().expect("no panic").add(run.tally);
            if let Err(error) = result {
                found.lock().expect("no panic").push((seed, error));
            }
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    std::thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
    (tally.into_inner().expect("no panic"), found.into_inner().expect("no panic"))
}

#[test]
fn no_picture_misleads() {
    let (first, cases) = (number("PANOSCOPE_PICTURE_SEED", 1), number("PANOSCOPE_PICTURE_CASES", 10));
    let begin = std::time::Instant::now();
    let (tally, mut found) = campaign(first, cases);
    println!("{cases} runs in {:.1} s: {tally:?}", begin.elapsed().as_secs_f64());
    found.sort();
    let shown: Vec<String> = found.iter().take(3).map(|(seed, error)| format!("seed {seed}: {error}")).collect();
    let seeds: Vec<u64> = found.iter().map(|(seed, _)| *seed).collect();
    assert!(found.is_empty(), "{} of {cases} runs mislead, seeds {seeds:?}\n{}", found.len(), shown.join("\n\n"));
    assert!(tally.unreadable * 20 <= tally.images, "too little can be read: {tally:?}");
    assert!(tally.images > 100 * cases && tally.dimmed > 0, "{tally:?}");
}
