//! Which outputs are previewed and probed.

use std::collections::HashMap;

use panoscope_abi::LINKS;

use super::{App, LARGE, THUMBNAIL};
use crate::viewer::Source;
use panoscope_editor_model::comparing::Comparison;
use panoscope_editor_model::docks::Panel;
use panoscope_editor_model::observe::{LARGE_INTERVAL, Output, PreviewRequest, THUMBNAIL_INTERVAL};
use panoscope_editor_model::picture::is_pictorial;
use panoscope_editor_model::probe::ProbeRequest;
use panoscope_editor_model::timeline::Timeline;

impl App {
    /// Outputs that can be compared in the viewer: those that are read, and those with a thumbnail.
    pub(super) fn sources(&self) -> Vec<Source> {
        let view = self.document.view();
        let mut found: Vec<Source> = Vec::new();
        let read = view.wires.iter().map(|w| (w.from, w.output.clone()));
        let shown = (0..view.nodes.len()).filter_map(|n| Some(self.canvas.shown_output(view, n)?.0));
        let read = read.map(|(node, port)| view.running_output(view.nodes[node].id(), &port));
        for output in read.chain(shown) {
            let Some(packet) = view.packet_of(&output).map(|p| p.name.clone()) else { continue };
            let source = Source { output, packet };
            if is_pictorial(&source.packet) && !found.contains(&source) {
                found.push(source);
            }
        }
        found
    }

    /// Outputs that the 3D view shows as lines: tips, poses, arm links.
    pub(super) fn trajectories(&self) -> Vec<(Output, String)> {
        let mut found = self.outputs_of(&["tip", "pose", "table"]);
        found.retain(|(output, packet)| packet != "table" || output.port == LINKS);
        found
    }

    /// Outputs whose packets are of one of the given types, with the type.
    pub(super) fn outputs_of(&self, packets: &[&str]) -> Vec<(Output, String)> {
        let nodes = self.document.view().flat().nodes.iter();
        let outputs = nodes.flat_map(|n| n.node_type.iter().flat_map(|t| &t.outputs).map(move |port| (n.id(), port)));
        outputs
            .filter(|(_, port)| packets.contains(&port.packet.name.as_str()))
            .map(|(id, port)| (Output::new(id, &port.name), port.packet.name.clone()))
            .collect()
    }

    /// How the two outputs in the viewer differ.
    pub fn comparison(&self) -> Option<Comparison> {
        self.timeline.as_ref().map_or_else(|| self.observer.comparison(), Timeline::comparison)
    }

    /// Requests previews of the visible outputs from the observer.
    pub(super) fn request_previews(&mut self, pixels_per_point: f32) {
        let mut requests: HashMap<Output, PreviewRequest> = HashMap::new();
        let mut request = |output: &Output, packet: &str, max_width: usize| {
            let entry = requests
                .entry(output.clone())
                .or_insert_with(|| PreviewRequest { packet: packet.to_owned(), ..PreviewRequest::default() });
            entry.max_width = entry.max_width.max(max_width);
        };
        if self.viewer.source().is_some() {
            self.viewer.sources().for_each(|s| request(&s.output, &s.packet, LARGE));
            if self.viewer.viewpoint().is_some() {
                self.trajectories().iter().for_each(|(output, packet)| request(output, packet, 1));
            }
        }
        if self.viewer.source().is_none() || self.docks.layout.viewer_beside {
            let width = self.canvas.thumbnail_width(pixels_per_point);
            self.canvas.visible().for_each(|(output, packet)| request(output, packet, width));
        }
        let mut probes: HashMap<Output, ProbeRequest> = HashMap::new();
        if let Some((output, request)) = self.viewer.probe_request() {
            probes.insert(output.clone(), request);
        }
        let panel_point = self.panel_point.take();
        if let Some(node) = self.selected().and_then(|id| self.document.view().node(&id))
            && let Some((output, packet)) = self.canvas.shown_output(self.document.view(), node)
        {
            if is_pictorial(&packet) {
                let request = ProbeRequest { at: panel_point, line: None };
                probes.entry(output.clone()).or_insert(request);
            }
            request(&output, &packet, if is_pictorial(&packet) { THUMBNAIL } else { 1 });
        }
        let values = self.docks.is_shown(Panel::Plots) && self.plots.wants_values();
        if values || self.docks.is_shown(Panel::Sweep) {
            self.outputs_of(&["scalar", "table"]).iter().for_each(|(output, packet)| request(output, packet, 1));
        }
        if values {
            let outputs = self.outputs_of(&["scalar", "table"]);
            let outputs: Vec<Output> = outputs.into_iter().map(|(output, _)| output).collect();
            self.plots.follow(&self.shown, &outputs);
        }
        self.viewer.view3d().check_calibration(&self.observer.counters());
        if let (Some(viewpoint), Some(source)) = (self.viewer.viewpoint(), self.viewer.source())
            && let Some(requests) = requests.get_mut(&source.output)
        {
            requests.viewpoint = Some(viewpoint);
        }
        let compared = self.viewer.comparison_request();
        self.observer.compare(compared.clone().filter(|_| self.timeline.is_none()));
        let of_running = if let Some(timeline) = &self.timeline {
            timeline.compare(compared);
            timeline.set_probes(probes);
            HashMap::new()
        } else {
            probes
        };
        self.observer.set_probes(of_running);
        let view = self.document.view();
        self.shown.retain(|output| requests.contains_key(output) || view.flat().node(&output.node).is_some());
        // The pictures of a recording take the place of those of the running graph.
        if let Some(timeline) = &self.timeline {
            timeline.set_requests(std::mem::take(&mut requests));
        }
        let large = self.viewer.source().is_some();
        self.observer.set_requests(requests, if large { LARGE_INTERVAL } else { THUMBNAIL_INTERVAL });
    }
}
