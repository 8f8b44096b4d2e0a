//! The settings a preset offers.

use super::Checker;
use super::params::limits;
use crate::checked::{Pin, Preset, PresetView};
use crate::file::{PinText, ViewText};
use crate::nearest::{list, nearest};
use crate::packet::PacketType;
use crate::param::ParamKind;
use std::ops::Range;

impl<'a> Checker<'a> {
    pub(super) fn pins(&mut self) -> Preset {
        Preset {
            pinned: self.text.pins.iter().filter_map(|pin| self.pin(pin)).collect(),
            views: self.text.views.iter().filter_map(|view| self.view(view)).collect(),
        }
    }

    fn view(&mut self, view: &'a ViewText) -> Option<PresetView> {
        let reference = &view.from;
        if self.doubled.contains(reference.node.as_str()) {
            return None;
        }
        let Some(&node) = self.ids.get(reference.node.as_str()) else {
            self.unknown_node(&reference.span, &reference.node);
            return None;
        };
        let node_type = self.type_of(node)?;
        let Some(port) = node_type.output(&reference.port) else {
            if !reference.through_part {
                self.unknown_output(reference, node_type, None);
            }
            return None;
        };
        let packet = &node_type.outputs[port].packet.name;
        if packet != PacketType::ANY && !PresetView::PACKETS.contains(&packet.as_str()) {
            let message =
                format!("`{}.{}` is {packet}, which cannot be shown as an image", reference.node, reference.port);
            self.error("wrong-view", &reference.span, message).help("the theatre shows pictures, maps and clouds");
            return None;
        }
        let label = view.label.clone().unwrap_or_else(|| self.id(node).to_owned());
        Some(PresetView { node, port, label })
    }

    fn pin(&mut self, pin: &'a PinText) -> Option<Pin> {
        let (name, span) = (&pin.param.value, &pin.param.span);
        let Some((id, param)) = name.split_once('.').filter(|(n, p)| !n.is_empty() && !p.is_empty()) else {
            self.error("bad-reference", span, format!("`{name}` is no reference to a parameter"))
                .label("expected \"node.parameter\"")
                .help("as in { param = \"wide.blend_px\" }");
            return None;
        };
        if self.doubled.contains(id) {
            return None;
        }
        let Some(&node) = self.ids.get(id) else {
            self.unknown_node(span, id);
            return None;
        };
        let node_type = self.type_of(node)?;
        let Some(index) = node_type.param(param) else {
            self.unknown_param(span, node_type, param);
            return None;
        };
        let declared = &node_type.params[index];
        let (min, max) = match declared.kind {
            ParamKind::Int { min, max, .. } => (min.map(|m| m as f64), max.map(|m| m as f64)),
            ParamKind::Float { min, max, .. } => (min, max),
            _ => {
                if let Some((low, _)) = &pin.range {
                    let message = format!("`{name}` is {}, so it has no range", declared.kind.expected());
                    self.error("useless-range", &low.span, message).help("remove `range`");
                }
                (None, None)
            }
        };
        if let Some((low, high)) = &pin.range {
            for end in [low, high] {
                if min.is_some_and(|m| end.value < m) || max.is_some_and(|m| end.value > m) {
                    let message = format!("{} lies outside what `{name}` allows, {}", end.value, limits(declared));
                    self.error("pin-range", &end.span, message).help("a preset may narrow a range, never widen it");
                }
            }
        }
        let range = pin.range.as_ref().map(|(low, high)| (low.value, high.value));
        let label = pin.label.clone().unwrap_or_else(|| param.to_owned());
        Some(Pin { node, param: index, range, label })
    }

    /// Reports a reference to an unknown node.
    pub(super) fn unknown_node(&mut self, span: &Range<usize>, id: &str) {
        // Its table may be one of the lines that could not be read.
        if self.text.incomplete {
            return;
        }
        let near = nearest(id, self.text.flat.nodes.iter().map(|n| n.id.value.as_str()));
        let label = near.map(|n| format!("did you mean `{n}`?")).unwrap_or_default();
        let ids = list(self.text.flat.nodes.iter().map(|n| n.id.value.as_str()), 12, "and");
        let span = span.start..(span.start + id.len()).min(span.end);
        self.error("unknown-node", &span, format!("there is no node `{id}`"))
            .label(label)
            .help(format!("nodes: {ids}"));
    }
}
