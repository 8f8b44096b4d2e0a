//! The checklist before use: cameras, calibration, arm, disk, lock, network, audit log. Each line is measured while it is shown; nothing is ticked by hand.

use eframe::egui::text::{LayoutJob, TextWrapping};
use eframe::egui::{Align2, FontId, Rect, Sense, Stroke, StrokeKind, Ui, WidgetInfo, WidgetType, pos2, vec2};
use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::texts::{bytes, decimal, text};
use panoscope_editor_widgets::theme;

use super::Theatre;
use super::notices::{FULL_BYTES, Facts, LOW_BYTES, OLD_MS};
use super::open::Verified;
use super::pedal::Pedal;
use super::plan::Plan;

/// Width of the checklist; the pictures are beside it.
pub(super) const WIDTH: f32 = 400.0;
const ROW: f32 = 58.0;

/// The state of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// As it should be.
    Ready,
    /// Usable, but not as it should be.
    Attention,
    /// Not usable.
    Missing,
}

impl State {
    fn word(self) -> &'static str {
        match self {
            Self::Ready => text!("check-ready"),
            Self::Attention => text!("check-attention"),
            Self::Missing => text!("check-missing"),
        }
    }
}

/// A line of the checklist.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// What is checked.
    pub name: String,
    /// Its state.
    pub state: State,
    /// What was found.
    pub words: String,
}

/// What the checks need to know besides the facts for notices.
pub(super) struct Known<'a> {
    pub plan: &'a Plan,
    pub counters: &'a Counters,
    pub verified: &'a Verified,
    /// Age of each camera's last image, ms, in the order of the plan.
    pub camera_ages_ms: Vec<Option<f64>>,
    /// Whether the stereo geometry was received.
    pub has_rig: bool,
    /// The keys of the foot pedal.
    pub pedal: &'a Pedal,
}

/// The lines of the checklist.
pub(super) fn checks(facts: &Facts, known: &Known<'_>) -> Vec<Check> {
    let mut all = Vec::new();
    let mut add = |name: &str, state, words: String| all.push(Check { name: name.to_owned(), state, words });
    for (camera, age) in known.plan.cameras.iter().zip(&known.camera_ages_ms) {
        let title = camera.title();
        let lost = facts.lost.iter().any(|lost| lost.titles.contains(&title));
        let (state, words) = match age {
            Some(_) if lost => (State::Missing, text!("check-image-lost").to_owned()),
            Some(age) if *age > OLD_MS => (State::Attention, text!("check-image-old", seconds = decimal(age / 1e3, 1))),
            Some(age) => (State::Ready, text!("check-image", ms = decimal(*age, 0))),
            None => (State::Missing, text!("check-image-none").to_owned()),
        };
        add(&title, state, words);
    }
    if known.plan.cameras.is_empty() {
        add(text!("check-cameras"), State::Missing, text!("check-cameras-none").to_owned());
    }
    if known.plan.cloud.is_some() {
        let (state, words) = match known.plan.rig {
            _ if facts.swapped => (State::Missing, text!("check-calibration-swapped")),
            _ if facts.drifted => (State::Attention, text!("check-calibration-drifted")),
            _ if facts.out_of_step => (State::Attention, text!("check-calibration-out-of-step")),
            None => (State::Attention, text!("check-calibration-none")),
            Some(_) if known.has_rig => (State::Ready, text!("check-calibration-fits")),
            Some(_) => (State::Missing, text!("check-calibration-waits")),
        };
        add(text!("check-calibration"), state, words.to_owned());
    }
    for stop in &known.plan.stops {
        let works = known.counters.nodes.get(&stop.node).is_some_and(|node| node.fps > 0.0);
        let (state, words) = match works {
            _ if facts.emergency => (State::Attention, text!("check-arm-stopped")),
            true => (State::Ready, text!("check-arm-ready")),
            false => (State::Missing, text!("check-arm-missing")),
        };
        add(&text!("check-arm", node = &stop.node), state, words.to_owned());
    }
    let (state, words) = match facts.free_bytes {
        Some(free) if free < FULL_BYTES => (State::Missing, text!("check-disk-full", size = bytes(free))),
        Some(free) if free < LOW_BYTES => (State::Attention, text!("check-disk-low", size = bytes(free))),
        Some(free) => (State::Ready, text!("check-disk-ready", size = bytes(free))),
        None => (State::Attention, text!("check-disk-unknown").to_owned()),
    };
    add(text!("check-disk"), state, words);
    let (state, words) = match known.verified {
        Verified::Signed(by) => (State::Ready, text!("check-lock-signed", key = by)),
        Verified::AsLocked => (State::Ready, text!("check-lock-ready").to_owned()),
        Verified::Never => (State::Attention, text!("check-lock-never").to_owned()),
        Verified::Differs(how) => (State::Attention, text!("check-lock-differs", difference = how)),
    };
    add(text!("check-lock"), state, words);
    if !known.plan.listening.is_empty() {
        let state = if known.plan.is_public() { State::Attention } else { State::Ready };
        let all: Vec<String> = known.plan.listening.iter().map(|one| one.what.to_string()).collect();
        let words = match known.plan.is_public() {
            true => text!("check-network-public", nodes = all.join(", ")),
            false => text!("check-network-local", nodes = all.join(", ")),
        };
        add(text!("check-network"), state, words);
    }
    if let Some(machine) = &facts.machine {
        let (state, words) = match &machine.lost {
            Some(why) => (State::Missing, text!("check-machine-lost", reason = why)),
            None => (State::Ready, machine.clock_words()),
        };
        add(&text!("check-machine", machine = &machine.name), state, words);
    }
    if known.pedal.file.is_some() {
        let (state, words) = match &known.pedal.problem {
            Some(problem) => (State::Attention, problem.clone()),
            None => (State::Ready, text!("check-pedal-keys", count = known.pedal.keys.len())),
        };
        add(text!("check-pedal"), state, words);
    }
    if let Some(problem) = &facts.audit_problem {
        add(text!("check-audit"), State::Attention, text!("check-audit-problem", reason = problem));
    }
    all
}

impl Theatre {
    /// The lines of the checklist, as it is now.
    pub fn checklist(&self) -> &[Check] {
        &self.checks
    }

    /// Whether the checklist is shown.
    pub fn shows_checklist(&self) -> bool {
        self.checking
    }

    /// Measures the lines of the checklist.
    pub(super) fn update_checklist(&mut self, facts: &Facts, counters: &Counters) {
        if !self.checking {
            return;
        }
        let known = Known {
            plan: &self.plan,
            counters,
            verified: &self.verified,
            camera_ages_ms: self.plan.cameras.iter().map(|camera| self.age_ms(&camera.output)).collect(),
            has_rig: self.rig.is_some(),
            pedal: &self.pedal,
        };
        self.checks = checks(facts, &known);
    }

    /// Draws the checklist.
    pub(super) fn show_checklist(&self, ui: &mut Ui, room: Rect) {
        let painter = ui.painter_at(room);
        painter.rect(room, 12.0, theme::panel(), Stroke::new(1.0, theme::line()), StrokeKind::Inside);
        let inner = room.shrink(20.0);
        let left = self.checks.iter().filter(|check| check.state != State::Ready).count();
        let heading = match left {
            0 => text!("checklist-ready").to_owned(),
            left => text!("checklist-left", count = left),
        };
        let color = if left == 0 { theme::live() } else { theme::warn() };
        painter.text(inner.left_top(), Align2::LEFT_TOP, &heading, FontId::proportional(24.0), color);
        let label = |caption: &str| WidgetInfo::labeled(WidgetType::Label, true, caption.to_owned());
        let title = ui.interact(
            Rect::from_min_size(inner.min, vec2(inner.width(), 30.0)),
            ui.id().with("checks"),
            Sense::hover(),
        );
        title.widget_info(|| label(&text!("checklist-name", heading = &heading)));
        let mut y = inner.top() + 48.0;
        for (n, check) in self.checks.iter().enumerate() {
            let row = Rect::from_min_size(pos2(inner.left(), y), vec2(inner.width(), ROW));
            let response = ui.interact(row, ui.id().with(("check", n)), Sense::hover());
            response.widget_info(|| {
                label(&text!("check-name", check = &check.name, state = check.state.word(), found = &check.words))
            });
            // Shapes differ, so that the state does not depend on colour.
            let (at, color) = (
                row.left_top() + vec2(10.0, 14.0),
                match check.state {
                    State::Ready => theme::live(),
                    State::Attention => theme::warn(),
                    State::Missing => theme::fault(),
                },
            );
            let stroke = Stroke::new(3.0, color);
            match check.state {
                State::Ready => {
                    painter.line(vec![at + vec2(-8.0, 0.0), at + vec2(-2.0, 6.0), at + vec2(8.0, -7.0)], stroke);
                }
                State::Attention => super::bars::sign(&painter, at, 10.0, color),
                State::Missing => {
                    painter.line_segment([at + vec2(-7.0, -7.0), at + vec2(7.0, 7.0)], stroke);
                    painter.line_segment([at + vec2(-7.0, 7.0), at + vec2(7.0, -7.0)], stroke);
                }
            }
            let text = row.left_top() + vec2(34.0, 0.0);
            painter.text(text, Align2::LEFT_TOP, &check.name, FontId::proportional(20.0), theme::text());
            let mut job = LayoutJob::simple_singleline(check.words.clone(), FontId::proportional(16.0), theme::muted());
            job.wrap = TextWrapping::truncate_at_width(row.right() - text.x);
            painter.galley(text + vec2(0.0, 26.0), painter.layout_job(job), theme::muted());
            y += ROW;
        }
    }
}

#[cfg(test)]
mod tests {
    use panoscope_editor_model::observe::Output;
    use panoscope_editor_model::texts::phrase;
    use panoscope_engine::NodeWindow;

    use super::*;
    use crate::lost::LostCameras;
    use crate::plan::{Listens, Pane, RigSource, Stop};
    use panoscope_imaging::stereo::length::Noise;

    fn plan() -> Plan {
        let camera = |label: &str| Pane {
            output: Output::new("scope", label),
            packet: "image".to_owned(),
            label: format!("{label} camera"),
            camera: Some(label.to_owned()),
        };
        Plan {
            cameras: vec![camera("Left"), camera("Right")],
            cloud: Some(Output::new("points", "cloud")),
            rig: Some(RigSource { calibration: Output::new("scope", "calibration"), noise: Noise::USUAL }),
            stops: vec![Stop { node: "arm".to_owned(), reset: None }],
            ..Plan::default()
        }
    }

    fn states(facts: &Facts, ages: [Option<f64>; 2], has_rig: bool, arm_fps: f64, verified: &Verified) -> Vec<State> {
        let (plan, mut counters) = (plan(), Counters::default());
        counters.nodes.insert("arm".to_owned(), NodeWindow { fps: arm_fps, ..NodeWindow::default() });
        let pedal = &Pedal::default();
        let known = Known { plan: &plan, counters: &counters, verified, camera_ages_ms: ages.to_vec(), has_rig, pedal };
        checks(facts, &known).into_iter().map(|check| check.state).collect()
    }

    #[test]
    fn what_listens_is_a_line_of_its_own() {
        let check = |listening: Vec<Listens>| {
            let mut plan = plan();
            plan.listening = listening;
            let (facts, counters) = (Facts::default(), Counters::default());
            let (verified, pedal) = (&Verified::AsLocked, &Pedal::default());
            let known = Known {
                plan: &plan,
                counters: &counters,
                verified,
                camera_ages_ms: vec![None, None],
                has_rig: true,
                pedal,
            };
            checks(&facts, &known).into_iter().find(|check| check.name == "Network")
        };
        let one = |node: &str, is_public| {
            let what = phrase!("listens-node", node = node, address = "127.0.0.1:8554");
            Listens { what, is_public }
        };
        assert_eq!(check(Vec::new()), None);
        let local = check(vec![one("stream", false)]).expect("a line");
        assert_eq!((local.state, local.words.as_str()), (State::Ready, "this machine only: stream at 127.0.0.1:8554"));
        let both = check(vec![one("a", false), one("b", true)]).expect("a line");
        assert_eq!(
            (both.state, both.words.as_str()),
            (State::Attention, "other machines reach it: a at 127.0.0.1:8554, b at 127.0.0.1:8554")
        );
    }

    #[test]
    fn each_line_is_ready_only_when_it_was_measured() {
        use State::{Attention, Missing, Ready};
        let good = Facts { free_bytes: Some(u64::MAX), ..Facts::default() };
        let ages = [Some(20.0), Some(30.0)];
        let locked = Verified::AsLocked;
        assert_eq!(states(&good, ages, true, 30.0, &locked), [Ready; 6]);
        let all_wrong = Facts { free_bytes: Some(1), drifted: true, emergency: true, ..Facts::default() };
        let differs = Verified::Differs("graph".to_owned());
        assert_eq!(
            states(&all_wrong, [None, Some(900.0)], true, 30.0, &differs),
            [Missing, Attention, Attention, Attention, Missing, Attention]
        );
        assert_eq!(
            states(&good, ages, false, 0.0, &Verified::Never),
            [Ready, Ready, Missing, Missing, Ready, Attention]
        );
        let lost = LostCameras { titles: vec!["Left camera".to_owned()], since: None };
        let lost = Facts { lost: vec![lost], swapped: true, ..Facts::default() };
        assert_eq!(states(&lost, ages, true, 30.0, &locked), [Missing, Ready, Missing, Ready, Attention, Ready]);
    }
}
