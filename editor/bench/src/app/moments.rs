//! The recording that is shown on the nodes instead of the running graph.

use std::path::Path;
use std::sync::Arc;

use eframe::egui::{Context, Ui};

use super::App;
use crate::panels::files::{Files, Target};
use crate::panels::timeline::TimelineRequest;
use crate::viewer::Source;
use panoscope_editor_model::computing::Request;
use panoscope_editor_model::docks::Panel;
use panoscope_editor_model::numbered::next_file;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::session::{Status, recordings_folder};
use panoscope_editor_model::texts::text;
use panoscope_editor_model::timeline::{Timeline, second};
use panoscope_editor_widgets::OutputCache;

impl App {
    /// The recording that is shown.
    pub fn timeline(&self) -> Option<&Timeline> {
        self.timeline.as_ref()
    }

    /// Number of the tick of the picture that is shown of an output.
    pub fn shown_tick(&self, output: &panoscope_editor_model::observe::Output) -> Option<u64> {
        self.shown.packet(output).map(|packet| packet.seq)
    }

    /// Takes new pictures: of the recording while one is shown, else of the running graph.
    pub(super) fn take_pictures(&mut self, ctx: &Context) {
        let running = self.observer.take();
        self.timeline.iter().for_each(Timeline::follow_computation);
        let pictures = self.timeline.as_ref().map_or(running, Timeline::take);
        self.shown.update(ctx, pictures);
    }

    /// Draws the panel.
    pub(super) fn timeline_panel(&mut self, ui: &mut Ui) {
        let recording = self.session.status().recording;
        let graph = self.document.whole();
        match self.timeline_panel.show(ui, self.timeline.as_ref(), recording.as_deref(), graph) {
            Some(TimelineRequest::Open(path)) => self.open_recording(&path, ui.ctx()),
            Some(TimelineRequest::Browse(target)) => {
                let folder = recordings_folder(self.document.path());
                let folder = if folder.is_dir() { folder } else { self.folder().to_owned() };
                self.files = Some(Files::new(target, &folder, ""));
            }
            Some(TimelineRequest::Record) => self.record(),
            Some(TimelineRequest::Compute) => self.compute_the_others(),
            Some(TimelineRequest::Compare(path)) => self.compare_recordings(Some(&path)),
            Some(TimelineRequest::EndCompare) => self.compare_recordings(None),
            Some(TimelineRequest::Close) => self.close_recording(),
            None => {}
        }
    }

    /// Records the graph from its start on, or ends the recording.
    pub(super) fn record(&mut self) {
        if self.is_attached() {
            return self.notify(text!("need-own-machine"), true);
        }
        if self.session.status().recording.is_some() {
            self.session.record(None, self.document.runnable());
            return;
        }
        if !self.document.view().valid {
            return self.notify(text!("need-valid"), true);
        }
        let stem = self.document.path().file_stem().unwrap_or_default().to_string_lossy().into_owned();
        match next_file(&recordings_folder(self.document.path()), &stem, "mcap") {
            Ok(file) => {
                // What runs is shown, not the recording before.
                self.close_recording();
                self.notify(text!("record-begins", file = file.display().to_string()), false);
                self.session.record(Some(&file), self.document.runnable());
            }
            Err(error) => self.notify(error.to_string(), true),
        }
    }

    /// Shows a recording of this window once it is finished.
    pub(super) fn follow_recording(&mut self, ctx: &Context, status: &Status) {
        if status.recorded.is_none() || status.recorded == self.shown_recording {
            return;
        }
        self.shown_recording.clone_from(&status.recorded);
        let Some(recorded) = &status.recorded else { return };
        let file = recorded.file.display().to_string();
        let count = usize::try_from(recorded.ticks).unwrap_or(usize::MAX);
        match &recorded.failed {
            Some(reason) => self.notify(text!("record-failed", file = file, reason = reason), true),
            None => self.notify(text!("record-done", file = file, count = count), false),
        }
        if recorded.ticks > 0 {
            self.docks.open(Panel::Timeline);
            self.open_recording(&recorded.file, ctx);
        }
    }

    /// Opens the recording that was picked in the file list.
    pub(super) fn open_picked(&mut self, target: &Target, path: &str, ctx: &Context) {
        let folder = recordings_folder(self.document.path());
        let folder = if folder.is_dir() { folder } else { self.folder().to_owned() };
        match target {
            Target::SecondTimeline => self.compare_recordings(Some(&folder.join(path))),
            _ => self.open_recording(&folder.join(path), ctx),
        }
    }

    fn close_recording(&mut self) {
        if self.timeline.take().is_some() {
            self.shown = OutputCache::default();
        }
    }

    /// Takes the faults of the selected node, or of all nodes, out of the picture.
    pub(super) fn acknowledge(&mut self) {
        let node = self.selected();
        let count = self.observer.acknowledge(node.as_deref());
        self.summed = None;
        self.notify(text!("done-acknowledged", count = count), false);
    }

    fn open_recording(&mut self, path: &Path, ctx: &Context) {
        let for_wake = ctx.clone();
        match Timeline::open(path, Arc::new(move || for_wake.request_repaint())) {
            Ok(timeline) => {
                let recorded = |node: &str| timeline.ports().iter().any(|port| port.starts_with(&format!("{node}.")));
                if !self.document.view().flat().nodes.iter().any(|node| recorded(node.id())) {
                    self.notify(text!("need-recorded-graph"), true);
                }
                self.shown = OutputCache::default();
                self.timeline = Some(timeline);
                if self.is_anything_lacking() {
                    self.compute_the_others();
                }
            }
            Err(error) => self.notify(error.to_string(), true),
        }
    }

    /// Whether the recording lacks all outputs of a node.
    fn is_anything_lacking(&self) -> bool {
        let Some(timeline) = &self.timeline else { return false };
        self.document.view().flat().nodes.iter().any(|node| {
            let outputs = node.node_type.iter().flat_map(|node_type| &node_type.outputs);
            let mut outputs = outputs.map(|port| Output::new(node.id(), &port.name)).peekable();
            outputs.peek().is_some() && outputs.all(|output| !timeline.has(&output))
        })
    }

    /// Computes the outputs that the recording lacks with the graph of the window.
    fn compute_the_others(&mut self) {
        if self.is_attached() || !self.document.view().valid {
            return;
        }
        let graph = (self.document.path().to_owned(), self.document.whole().to_string());
        let request = Request { graph, loader: self.session.loader() };
        let result = self.timeline.as_mut().map(|timeline| timeline.compute(request));
        if let Some(Err(error)) = result {
            self.notify(error.to_string(), true);
        }
    }

    fn compare_recordings(&mut self, path: Option<&Path>) {
        let Some(timeline) = &mut self.timeline else { return };
        let result = timeline.compare_with(path);
        if let Err(error) = result {
            self.notify(error.to_string(), true);
        }
    }

    /// The output of the second recording beside one of the first, to compare with.
    pub(super) fn of_second_run(&self, source: &Source) -> Option<Source> {
        let timeline = self.timeline.as_ref()?;
        timeline.second_path()?;
        Some(Source { output: second(&source.output), packet: source.packet.clone() })
    }
}
