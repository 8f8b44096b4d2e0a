//! The recording that is shown on the nodes instead of the running graph.

use std::path::Path;
use std::sync::Arc;

use eframe::egui::{Context, Ui};

use super::App;
use crate::panels::timeline::TimelineRequest;
use crate::viewer::Source;
use panoscope_editor_model::timeline::{Timeline, second};
use panoscope_editor_texts::text;
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
        let pictures = self.timeline.as_ref().map_or(running, Timeline::take);
        self.shown.update(ctx, pictures);
    }

    /// Draws the panel.
    pub(super) fn timeline_panel(&mut self, ui: &mut Ui) {
        match self.timeline_panel.show(ui, self.timeline.as_ref()) {
            Some(TimelineRequest::Open(path)) => self.open_recording(&path, ui.ctx()),
            Some(TimelineRequest::Compare(path)) => self.compare_recordings(Some(&path)),
            Some(TimelineRequest::EndCompare) => self.compare_recordings(None),
            Some(TimelineRequest::Close) => {
                self.timeline = None;
                self.shown = OutputCache::default();
            }
            None => {}
        }
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
            }
            Err(error) => self.notify(error.to_string(), true),
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
