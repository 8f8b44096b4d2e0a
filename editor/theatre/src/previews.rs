//! What is looked at, what came of it, and how things stand.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use eframe::egui::Context;
use panoscope_engine::clock;

use super::measure::Measure;
use super::notices::{Facts, STOPPED, told};
use super::{Place, Theatre, Verified};
use panoscope_editor_model::content::Content;
use panoscope_editor_model::observe::{Counters, Output, Wanted};
use panoscope_editor_model::session::{Phase, Status};

/// Shortest time from one picture to the next.
const INTERVAL: Duration = Duration::from_millis(33);
/// How long a view may take to show its first picture before it counts as stopped.
const FIRST: Duration = Duration::from_secs(5);
/// Most columns of a view.
const MOST_WIDTH: usize = 4096;
/// Columns of a camera's picture that is only watched.
const WATCHED_WIDTH: usize = 64;

/// When something was seen of an output, and how old it was.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    at: Instant,
    ingest_ns: Option<u64>,
}

impl Theatre {
    /// Takes what came since the last frame.
    pub(super) fn look(&mut self, ctx: &Context) {
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
    pub(super) fn fall_back(&mut self, status: &Status) {
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

    pub(super) fn facts(&mut self, status: &Status, counters: &Counters) -> Facts {
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
        let trouble = status.trouble.as_ref().filter(|_| !status.busy).map(|t| t.words.clone());
        let nothing_runs = match &status.phase {
            Phase::Failed(why) => Some(why.clone()),
            Phase::Idle | Phase::Ended => trouble.clone(),
            Phase::Starting | Phase::Running => None,
        };
        let source_faults = counters.faults.iter().filter(|(node, _)| self.plan.is_source(node));
        Facts {
            // The sources alone do not run either.
            why_dark: nothing_runs.filter(|_| !status.busy && self.raw_only.is_some()),
            source_faults: source_faults.map(|(node, fault)| (node.clone(), fault.words.clone())).collect(),
            phase: status.phase.clone(),
            trouble,
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
            unlocked: match &self.verified {
                Verified::Differs(how) => Some(how.clone()),
                Verified::AsLocked | Verified::Never => None,
            },
        }
    }

    /// Age of what is known of an output: from its tick's ingest until now.
    pub(super) fn age_ms(&self, output: &Output) -> Option<f64> {
        let ingest_ns = self.seen.get(output)?.ingest_ns?;
        Some(clock::now_ns().saturating_sub(ingest_ns) as f64 / 1e6)
    }

    /// Tells the observer what is looked at.
    pub(super) fn want(&mut self) {
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
}
