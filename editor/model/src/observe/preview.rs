//! The preview of one output.

use std::sync::Arc;

use panoscope_engine::Engine;
use panoscope_engine::memory::FrameRef;
use panoscope_host::attach::{Attachment, PAIR_TICKS};

use super::feed::{Fed, Feed};
use super::{Output, PreviewRequest};
use crate::picture::{self, Range, RenderedPacket};
use crate::probe::{self, Probe, ProbeRequest};
use crate::surface::{self, Painter};

/// Where the confidence of points comes from.
struct Confidence {
    output: Output,
    feed: Feed,
    /// Number of points without it that were left out.
    left_out: usize,
}

/// Where the packets of an output come from, and the last one.
pub(super) struct OutputPreview {
    pub feed: Feed,
    confidence: Option<Confidence>,
    last: Option<Fed>,
    /// How it was rendered.
    rendered: Option<PreviewRequest>,
    /// The question about its values that was answered.
    answered: Option<ProbeRequest>,
    range: Range,
    /// While a surface is shown.
    painter: Option<Painter>,
}

impl OutputPreview {
    pub fn new(feed: Feed) -> Self {
        Self { feed, confidence: None, last: None, rendered: None, answered: None, range: None, painter: None }
    }

    /// The last packet.
    pub fn last(&self) -> Option<&FrameRef> {
        self.last.as_ref().map(|fed| &fed.frame)
    }

    /// What only a machine knows of the last packet: when its light arrived, and its size before it was thinned, px.
    pub fn elsewhere(&self) -> Option<(Option<i64>, (usize, usize))> {
        self.last.as_ref()?.elsewhere
    }

    /// Sets which output has the confidence of the points.
    pub fn set_confidence(
        &mut self,
        wanted: Option<&Output>,
        machine: Option<&Arc<Attachment>>,
        engine: Option<&Engine>,
    ) {
        if self.confidence.as_ref().map(|confidence| &confidence.output) == wanted {
            return;
        }
        if let Some(Confidence { output, feed, .. }) = self.confidence.take() {
            drop(feed);
            if let Some(engine) = engine {
                engine.end_previews(&output.node);
            }
        }
        self.confidence = wanted.and_then(|output| {
            let feed = Feed::of(output, machine, engine)?;
            Some(Confidence { output: output.clone(), feed, left_out: 0 })
        });
    }

    /// Sets how many packets are kept, and how many maps of confidence.
    pub fn keep(&self, packets: usize, maps: usize) {
        self.feed.keep(packets);
        if let Some(confidence) = &self.confidence {
            confidence.feed.keep(maps);
        }
    }

    /// A packet with the confidence of its tick where that is wanted.
    pub fn measured(&self, fed: Fed) -> Fed {
        let confidence = self.confidence.as_ref().and_then(|maps| maps.feed.take_tick(fed.frame.tick()));
        Fed { confidence: confidence.or(fed.confidence), ..fed }
    }

    /// The newest packet since the last call, with the confidence of its tick where that is wanted. `goes_on`: whether more packets may come.
    pub fn take(&mut self, goes_on: bool) -> Option<Fed> {
        let Some(confidence) = &mut self.confidence else { return self.feed.take() };
        if let Some([points, map]) = self.feed.take_pair(&confidence.feed) {
            return Some(Fed { confidence: Some(map.frame), ..points });
        }
        // The confidence of the first points may have come before it was asked for, and a machine hears later that it is; later ones have none.
        let fed = self.feed.take()?;
        confidence.left_out += 1;
        let most = if fed.elsewhere.is_some() { PAIR_TICKS } else { 1 };
        (confidence.left_out > most || !goes_on).then_some(fed)
    }

    /// Renders a new packet, or the last one if it is asked for in another way than it was rendered; `None` when there is nothing to render.
    /// While more may come, a packet without the confidence that is asked for now is not rendered again.
    pub fn render(&mut self, fed: Option<Fed>, request: &PreviewRequest, goes_on: bool) -> Option<RenderedPacket> {
        let is_new = fed.is_some();
        if is_new {
            (self.last, self.answered) = (fed, None);
        }
        let last = self.last.as_ref()?;
        let lacks_confidence = request.confidence.is_some() && last.confidence.is_none();
        if !is_new && (self.rendered.as_ref() == Some(request) || goes_on && lacks_confidence) {
            return None;
        }
        self.rendered = Some(request.clone());
        let (frame, bytes) = (last.frame.frame(), last.frame.bytes());
        let Some(viewpoint) = &request.viewpoint else {
            self.painter = None;
            let mut render = picture::render(&last.frame, &request.packet, request.max_width, &mut self.range);
            if request.points {
                let confidence = last.confidence.as_ref().map(|map| (map.frame(), map.bytes()));
                render.cloud = surface::cloud_of(frame, bytes, confidence).map(Arc::new);
            }
            return Some(render);
        };
        let mut render = RenderedPacket::of_tick(frame);
        if let Some((pixels, depth_buffer)) = self.painter.get_or_insert_default().paint(frame, bytes, viewpoint) {
            (render.pixels, render.depth_buffer) = (Some(pixels), depth_buffer);
        }
        Some(render)
    }

    /// The values of the last picture, where it or the question is a new one.
    pub fn probe(&mut self, request: &PreviewRequest, asked: &ProbeRequest) -> Option<Probe> {
        let last = self.last.as_ref().filter(|_| request.viewpoint.is_none())?;
        if self.answered.replace(*asked) == Some(*asked) {
            return None;
        }
        let probe = probe::read(last.frame.frame(), last.frame.bytes(), &request.packet, asked)?;
        Some(match last.elsewhere {
            Some((_, size)) => probe.of_thinned(size),
            None => probe,
        })
    }
}
