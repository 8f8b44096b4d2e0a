//! Requests and receives previews, falls back to the raw view, and collects the facts for notices.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use eframe::egui::Context;

use super::lost::{self, LostCameras, SilentCamera};
use super::measure::Measure;
use super::notices::{Facts, OLD_MS, STOPPED, STOPPED_MS};
use super::outage::FIRST;
use super::three_d::Pair;
use super::{OutputCache, Pane, Theatre, ThreeD, Verified, time};
use panoscope_editor_model::content::Content;
use panoscope_editor_model::observe::{Counters, Output, PreviewRequest};
use panoscope_editor_model::session::{Phase, Status};
use panoscope_editor_model::surface::Viewpoint;
use panoscope_host::audit::{ClipState, Event};

/// Minimum time between two previews.
const INTERVAL: Duration = Duration::from_millis(33);
/// Maximum width of a view, px.
const MAX_WIDTH: usize = 4096;
/// Width of the preview of a camera that is only monitored, px.
const WATCHED_WIDTH: usize = 64;

/// When the last packet of an output was received, and when its light arrived.
#[derive(Clone, Copy, Debug)]
pub(super) struct LastPacket {
    pub at: Instant,
    arrived_ns: Option<i64>,
    /// Whether the views were known to be swapped while it was the last one.
    was_swapped: bool,
}

impl LastPacket {
    /// Time since its light arrived.
    fn age_ms(&self) -> Option<f64> {
        Some(time::clock_ns().saturating_add_signed(self.arrived_ns?.saturating_neg()) as f64 / 1e6)
    }
}

/// How often a camera has sent its last image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Repeats {
    /// When the light of the first of them arrived.
    since: Instant,
    count: u32,
    /// Of the last time that it was stuck: since when, and until when in ns of the engine's clock.
    stuck: Option<(Instant, i64)>,
}

/// Images of a camera that are the same, with their noise, from which on it counts as stuck.
const MIN_REPEATS: u32 = 2;

impl Theatre {
    /// Takes the previews received since the last frame.
    pub(super) fn take_previews(&mut self, ctx: &Context) {
        let mut previews = self.runner.take_previews();
        let now = time::now();
        for camera in &self.plan.cameras {
            let (before, new) = (self.live.pixels(&camera.output), previews.get(&camera.output));
            let Some((new, arrived_ns)) = new.and_then(|packet| Some((packet.pixels.as_ref()?, packet.arrived_ns)))
            else {
                continue;
            };
            let first = Repeats { since: time::instant_of(arrived_ns), count: 0, stuck: None };
            let repeats = self.repeats.entry(camera.output.clone()).or_insert(first);
            match before {
                Some(before) if before == new => repeats.count += 1,
                // The same image in another size may be a new one.
                Some(before) if (before.width, before.height) != (new.width, new.height) => {}
                _ if repeats.count >= MIN_REPEATS => {
                    // Not until its next light, which may be older than the last image that it repeated.
                    let until_ns = i64::try_from(time::clock_ns()).unwrap_or(i64::MAX);
                    *repeats = Repeats { stuck: Some((repeats.since, until_ns)), ..first }
                }
                _ => *repeats = Repeats { stuck: repeats.stuck, ..first },
            }
        }
        for (output, packet) in &previews {
            let arrived_ns = self.arrived_ns(output, packet.arrived_ns);
            let last = LastPacket { at: now, arrived_ns, was_swapped: false };
            self.last_packets.insert(output.clone(), last);
        }
        if let Some(rig) = &self.plan.rig
            && let Some(Content::Rig(known)) = previews.get(&rig.calibration).map(|packet| &packet.content)
        {
            self.rig = Some(*known);
        }
        if let (Some(known), Some(rig)) = (self.rig, &self.plan.rig) {
            self.measure.set_rig(known, rig.noise);
        }
        if let Some(cloud) = self.plan.cloud.clone().filter(|_| self.measure.is_waiting())
            && let Some(packet) = previews.remove(&cloud)
            && packet.cloud.is_some()
            && !self.is_stale(&cloud)
        {
            self.measure.take(ctx, &cloud, packet);
            self.frozen = Some(now);
        }
        self.choose_raw();
        // Of all cameras, so that any of them can stand in at once. Only the raw view's is larger than it takes to watch it.
        let cameras = self.plan.cameras.iter().chain(&self.plan.raw).map(|camera| &camera.output);
        let live = cameras.filter_map(|camera| Some((camera.clone(), previews.get(camera)?.clone())));
        self.live.update(ctx, live.collect());
        if self.frozen.is_none() {
            if let Some(pair) = self.plan.pair.as_ref().filter(|_| self.three_d != ThreeD::Off) {
                let last_packets = &self.last_packets;
                self.pair.take(pair, &previews, |eye| last_packets.get(eye)?.arrived_ns);
            }
            for output in previews.keys() {
                self.shown_packets.extend(self.last_packets.get_key_value(output).map(|(o, last)| (o.clone(), *last)));
            }
            self.shown.update(ctx, previews);
        }
    }

    /// Runs only the sources when the whole graph cannot run.
    pub(super) fn fall_back(&mut self, status: &Status) {
        match status.phase {
            Phase::Running if self.running_since.is_none() => self.running_since = Some(time::now()),
            Phase::Running => {}
            _ => self.running_since = None,
        }
        match status.phase {
            Phase::Starting if self.starting_since.is_none() => self.starting_since = Some(time::now()),
            Phase::Starting => {}
            _ => self.starting_since = None,
        }
        // The cameras of another machine are not started from here.
        if self.shows_raw() || status.busy || self.machine.is_some() {
            return;
        }
        let why = match (&status.phase, &status.problem) {
            (Phase::Failed(why), _) => why.clone(),
            (Phase::Idle | Phase::Ended, Some(problem)) => problem.line().to_owned(),
            _ => return,
        };
        self.take_clip(ClipState::Failed);
        self.audit.log(Event::CamerasOnly);
        match self.plan.raw_only(&self.text) {
            Ok(text) => self.runner.restart(&text),
            Err(error) => self.notify(error.to_string(), true),
        }
        self.raw_only = Some(why);
        self.keep();
        self.frozen = None;
        self.measure = Measure::default();
    }

    /// How long an output has been requested in this run. One that nobody requested, in a freeze or another layout, was not silent.
    fn requested(&self, output: &Output) -> Duration {
        let since = self.running_since.map(time::since).unwrap_or_default();
        self.requested.get(output).map_or(Duration::ZERO, |at| time::since(*at).min(since))
    }

    /// Time since the last packet of an output; `None` before the first one.
    fn silent(&self, output: &Output) -> Option<Duration> {
        self.last_packets.get(output).map(|last| time::since(last.at).min(self.requested(output)))
    }

    fn has_stopped(&self, output: &Output) -> bool {
        self.silent(output).map_or(self.requested(output) > FIRST, |age| age > STOPPED)
    }

    /// Cameras that send nothing.
    fn lost_cameras(&mut self, counters: &Counters, running: bool) -> Vec<LostCameras> {
        let mut named = std::mem::take(&mut self.named_lost);
        let cameras = self.plan.cameras.iter().zip(&self.plan.camera_sources);
        let cameras = cameras.map(|(camera, source)| SilentCamera {
            output: &camera.output,
            title: camera.title(),
            source: source.as_str(),
            since: self.silent(&camera.output),
            has_stopped: running && self.has_stopped(&camera.output),
        });
        let lost = lost::cameras(&cameras.collect::<Vec<_>>(), &mut named, |node| {
            // Clocks of two machines differ: of another one's faults it is not known when they were.
            counters.faults.get(node).filter(|_| self.machine.is_none())
        });
        self.named_lost = named;
        lost
    }

    /// The current facts for notices.
    pub(super) fn facts(&mut self, status: &Status, counters: &Counters) -> Facts {
        let running = status.phase == Phase::Running;
        let lost = self.lost_cameras(counters, running);
        let raw_goes_on = self.raw().is_some_and(|raw| !self.has_stopped(&raw.output));
        let is_live = running && self.frozen.is_none();
        let looking = is_live && !self.shows_raw();
        let stopped = self.displayed().into_iter().filter(|_| looking && raw_goes_on && !self.measure.is_waiting());
        let stopped = stopped.filter(|p| self.has_stopped(&p.output) && !self.plan.is_source(&p.output.node));
        let stopped: Vec<String> = stopped.map(|p| p.label.clone()).collect();
        let main = self.plan.views.get(self.layout.main());
        let main = if self.shows_raw() { self.raw() } else { main };
        let main = main.map(|v| v.output.clone());
        let left_eye = self.plan.pair.as_ref().map(|[left, _]| left.clone()).filter(|_| self.shows_pair());
        let main = left_eye.or(main);
        let picture_age_ms = main.as_ref().and_then(|main| self.picture_age_ms(main, self.shows_raw()));
        let packets = if self.shows_raw() { &self.last_packets } else { &self.shown_packets };
        let has_main = main.as_ref().is_none_or(|main| packets.contains_key(main));
        // Of a pair each image counts, and the pair.
        let eyes = self.plan.pair.iter().flatten().filter(|_| self.shows_pair());
        let ages_ms = eyes.filter_map(|eye| self.picture_age_ms(eye, false)).chain(picture_age_ms);
        let pair_age_ms = self.pair.age().filter(|_| self.shows_pair()).map(|age| age.as_secs_f64() * 1e3);
        let is_old = is_live && ages_ms.chain(pair_age_ms).any(|age_ms| age_ms > OLD_MS);
        let age_ms = main.filter(|_| is_live).and_then(|main| self.shown_age_ms(&main));
        self.doubts.update(counters);
        self.mark_swapped(self.doubts.swapped);
        let is_swapped = counters.metric_is_on("views_swapped") == Some(true);
        let problem = status.problem.as_ref().filter(|_| !status.busy).map(|t| t.line().to_owned());
        let nothing_runs = match &status.phase {
            Phase::Failed(why) => Some(why.clone()),
            Phase::Idle | Phase::Ended => problem.clone(),
            Phase::Starting | Phase::Running => None,
        };
        let source_faults = counters.faults.iter().filter(|(node, _)| self.plan.is_source(node));
        let writes = !self.shows_raw() && !self.plan.written.is_empty();
        let (stages, full_stages) = self.stages.update(counters, time::now());
        Facts {
            // Set only when the sources alone do not run either.
            why_dark: nothing_runs.filter(|_| !status.busy && self.shows_raw()),
            outage: self.outage_facts(),
            machine: self.machine_facts(),
            source_faults: source_faults.map(|(node, fault)| (node.clone(), fault.words.clone())).collect(),
            phase: status.phase.clone(),
            starting: self.starting_since.map(time::since),
            problem,
            raw_only: self.raw_only.clone(),
            has_raw: self
                .raw()
                .is_some_and(|raw| self.live.texture(&raw.output).is_some() && !self.is_stale(&raw.output)),
            emergency: self.emergency,
            lost,
            stuck: self.stuck_cameras(running),
            stopped,
            age_ms,
            is_old,
            has_main,
            stages,
            full_stages,
            free_bytes: self.storage.free_bytes(),
            audit_problem: self.audit.problem(),
            pedal_problem: self.pedal.problem.clone(),
            recording: self.clip.is_some() || writes && self.machine.is_none(),
            written_bytes: (writes && running).then(|| self.sink_files.bytes()),
            drifted: self.doubts.drifted,
            unlike: counters.metric_is_on("unlike") == Some(true),
            swapped: self.doubts.swapped,
            was_swapped: !is_swapped && (self.doubts.swapped || self.shows_swapped()),
            out_of_step: self.doubts.out_of_step,
            public: {
                let public = self.plan.listening.iter().filter(|one| one.is_public);
                public.map(|one| one.what.to_string()).collect()
            },
            unlocked: match &self.verified {
                Verified::Differs(how) => Some(how.clone()),
                Verified::Signed(_) | Verified::AsLocked | Verified::Never => None,
            },
        }
    }

    /// Age of an output's last packet: the time since its light arrived.
    pub(super) fn age_ms(&self, output: &Output) -> Option<f64> {
        self.last_packets.get(output)?.age_ms()
    }

    /// Age of the image that an output shows, ms: the time since its light arrived, or since it came, where nobody knows when its light arrived and
    /// it is not new. `None` before the first image; and, where an output was hidden, until its first new image or for [`STOPPED`].
    pub(super) fn shown_age_ms(&self, output: &Output) -> Option<f64> {
        let last = *self.last_packets.get(output)?;
        if self.requested.get(output).is_some_and(|asked| last.at < *asked && time::since(*asked) < STOPPED) {
            return None;
        }
        Self::age_of(last, Duration::ZERO)
    }

    /// Age of a packet, `ago` before now; see [`Self::shown_age_ms`].
    fn age_of(packet: LastPacket, ago: Duration) -> Option<f64> {
        let silent_ms = time::since(packet.at).saturating_sub(ago).as_secs_f64() * 1e3;
        match packet.age_ms() {
            Some(age_ms) => Some((age_ms - ago.as_secs_f64() * 1e3).max(silent_ms)),
            None => (silent_ms > OLD_MS).then_some(silent_ms),
        }
    }

    /// When the light of a packet arrived that comes now: of a camera that sends the same image again and again, when it sent that one first.
    fn arrived_ns(&self, output: &Output, arrived_ns: Option<i64>) -> Option<i64> {
        let cameras = self.plan.cameras_of.iter().find(|(made, _)| made == output).map(|(_, cameras)| &cameras[..]);
        let stuck = cameras.into_iter().flatten().filter_map(|camera| {
            let camera = &self.plan.cameras[*camera];
            // What was made of its images meanwhile may come after its next one.
            let was_stuck = self.repeats.get(&camera.output).and_then(|repeats| repeats.stuck);
            let was_stuck = was_stuck.filter(|(since, until_ns)| {
                arrived_ns.is_some_and(|ns| ns < *until_ns && time::instant_of(Some(ns)) >= *since)
            });
            self.stuck_for(camera).or(was_stuck.map(|(since, _)| time::since(since)))
        });
        let Some(stuck) = stuck.max() else { return arrived_ns };
        let now_ns = i64::try_from(time::clock_ns()).unwrap_or(i64::MAX);
        let first_ns = now_ns.saturating_sub(i64::try_from(stuck.as_nanos()).unwrap_or(i64::MAX));
        Some(arrived_ns.map_or(first_ns, |arrived_ns| arrived_ns.min(first_ns)))
    }

    /// Age of the picture that is on the screen for an output, ms: of a live one now, of another one when it was frozen. It may be older than the
    /// last packet.
    fn picture_age_ms(&self, output: &Output, live: bool) -> Option<f64> {
        let packets = if live { &self.last_packets } else { &self.shown_packets };
        let ago = self.frozen.filter(|_| !live).map_or(Duration::ZERO, time::since);
        Self::age_of(*packets.get(output)?, ago)
    }

    /// Whether the picture that is on the screen for an output is too old to be taken for a present one, or was when it was frozen.
    pub(super) fn is_picture_stale(&self, output: &Output, live: bool) -> bool {
        self.picture_age_ms(output, live).is_some_and(|age_ms| age_ms > STOPPED_MS)
    }

    /// Whether the picture that is on the screen for an output is older than its last packet, because it was frozen.
    pub(super) fn lags(&self, output: &Output) -> bool {
        let at = |packets: &HashMap<Output, LastPacket>| packets.get(output).map(|packet| packet.at);
        at(&self.shown_packets) < at(&self.last_packets)
    }

    /// Marks the images on the screen while the views are swapped: they stay as they are when the cameras are right again.
    fn mark_swapped(&mut self, is_swapped: bool) {
        let packets = self.last_packets.values_mut().chain(self.shown_packets.values_mut());
        packets.for_each(|packet| packet.was_swapped |= is_swapped);
    }

    /// Whether an image on the screen that is not present any more was the last one while the views were swapped.
    fn shows_swapped(&self) -> bool {
        let is_past = |output: &Output, live: bool| {
            let packets = if live { &self.last_packets } else { &self.shown_packets };
            let is_frozen = !live && self.frozen.is_some();
            let is_old = || self.picture_age_ms(output, live).is_some_and(|age_ms| age_ms > OLD_MS);
            packets.get(output).is_some_and(|packet| packet.was_swapped) && (is_frozen || is_old())
        };
        let is_raw_past = || self.raw().is_some_and(|raw| is_past(&raw.output, true));
        if self.shows_raw() {
            return is_raw_past();
        }
        if self.shows_pair() {
            return self.plan.pair.iter().flatten().any(|eye| is_past(eye, false));
        }
        // In place of a view, and beside a frozen one, is the image of a camera.
        let is_pane_past =
            |pane: &Pane| if self.is_withdrawn(pane) { is_raw_past() } else { is_past(&pane.output, false) };
        self.frozen.is_some() && is_raw_past() || self.displayed().into_iter().any(is_pane_past)
    }

    /// Forgets the images that views show, but not those of cameras.
    pub(super) fn forget_shown_images(&mut self) {
        (self.shown, self.pair) = (OutputCache::default(), Pair::default());
        self.shown_packets.clear();
    }

    /// Forgets all images of the run before.
    pub(super) fn forget_images(&mut self) {
        self.forget_shown_images();
        self.live = OutputCache::default();
        self.last_packets.clear();
        self.repeats.clear();
    }

    /// For how long a camera has sent the same image; `None` while it sends new ones.
    fn stuck_for(&self, camera: &Pane) -> Option<Duration> {
        self.repeats.get(&camera.output).filter(|r| r.count >= MIN_REPEATS).map(|r| time::since(r.since))
    }

    /// The cameras that send the same image again and again, and for how long. One that sends nothing is lost.
    fn stuck_cameras(&self, running: bool) -> Vec<(String, Duration)> {
        let sends = |camera: &&Pane| {
            running && self.last_packets.get(&camera.output).is_some_and(|last| time::since(last.at) <= STOPPED)
        };
        let stuck = self.plan.cameras.iter().filter(sends).filter_map(|camera| {
            self.stuck_for(camera).filter(|since| *since > STOPPED).map(|since| (camera.title(), since))
        });
        stuck.collect()
    }

    /// Whether the image that an output shows is too old to be taken for the present one.
    pub(super) fn is_stale(&self, output: &Output) -> bool {
        self.shown_age_ms(output).is_some_and(|age_ms| age_ms > STOPPED_MS)
    }

    /// Whether a view is taken from the screen because it is too old and may show numbers that a stage has drawn: another image stands in for it.
    pub(super) fn is_withdrawn(&self, pane: &Pane) -> bool {
        self.frozen.is_none() && !self.plan.is_source(&pane.output.node) && self.is_stale(&pane.output)
    }

    /// The image of a camera that stands in for views: the first camera's, or that of another one while only that one delivers.
    pub(super) fn raw(&self) -> Option<&Pane> {
        self.plan.cameras.get(self.raw_camera).or(self.plan.raw.as_ref())
    }

    /// Chooses the camera for [`Self::raw`].
    fn choose_raw(&mut self) {
        let age_of = |camera: &Pane| {
            let has_image = self.last_packets.contains_key(&camera.output);
            has_image.then(|| self.shown_age_ms(&camera.output).unwrap_or_default())
        };
        // Cameras that fall silent together do not take turns.
        let delivers = |camera: &Pane| age_of(camera).is_some_and(|age_ms| age_ms < STOPPED_MS / 2.0);
        let is_lost = |camera: &Pane| age_of(camera).is_none_or(|age_ms| age_ms > STOPPED_MS);
        let cameras = &self.plan.cameras;
        // While none delivers, the last one stays.
        if let Some(first) = cameras.iter().position(delivers)
            && (first == 0 || cameras.get(self.raw_camera).is_none_or(is_lost))
        {
            self.raw_camera = first;
        }
    }

    /// Requests previews of the visible outputs from the observer.
    pub(super) fn request_previews(&mut self) {
        let mut requests: HashMap<Output, PreviewRequest> = HashMap::new();
        let of = |pane: &Pane, max_width| PreviewRequest {
            packet: pane.packet.clone(),
            max_width,
            ..PreviewRequest::default()
        };
        for camera in &self.plan.cameras {
            requests.insert(camera.output.clone(), of(camera, WATCHED_WIDTH));
        }
        if let Some(raw) = self.raw() {
            requests.insert(raw.output.clone(), of(raw, MAX_WIDTH));
        }
        if let Some(rig) =
            self.plan.rig.as_ref().filter(|_| (self.measure.is_on() || self.checking) && self.rig.is_none())
        {
            let packet = "calibration".to_owned();
            requests
                .insert(rig.calibration.clone(), PreviewRequest { packet, max_width: 1, ..PreviewRequest::default() });
        }
        if self.frozen.is_none() && self.raw_only.is_none() {
            // No length is right while the calibration does not fit.
            let has_ruler = !self.doubts.drifted;
            for pane in self.displayed() {
                let kept = || self.viewpoints.get(&pane.output).copied().unwrap_or_default();
                let viewpoint = (pane.packet == "cloud").then(|| Viewpoint { has_ruler, ..kept() });
                requests.insert(pane.output.clone(), PreviewRequest { viewpoint, ..of(pane, MAX_WIDTH) });
            }
            if let Some(cloud) = self.plan.cloud.as_ref().filter(|_| self.measure.is_waiting()) {
                let packet = "cloud".to_owned();
                let confidence = self.plan.confidence.clone();
                let points = PreviewRequest {
                    packet,
                    max_width: MAX_WIDTH,
                    points: true,
                    confidence,
                    ..PreviewRequest::default()
                };
                requests.insert(cloud.clone(), points);
            }
        }
        if let Some(pair) = self.plan.pair.as_ref().filter(|_| self.frozen.is_none() && self.shows_pair()) {
            let [left, right] = pair;
            for (eye, other) in [(left, right), (right, left)] {
                let (packet, pair) = ("image".to_owned(), Some(other.clone()));
                let request = PreviewRequest { packet, max_width: MAX_WIDTH, pair, ..PreviewRequest::default() };
                requests.insert(eye.clone(), request);
            }
        }
        self.requested.retain(|output, _| requests.contains_key(output));
        let now = time::now();
        for output in requests.keys() {
            self.requested.entry(output.clone()).or_insert(now);
        }
        self.runner.request_previews(requests, INTERVAL);
    }
}
