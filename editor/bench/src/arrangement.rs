//! How a graph looks when it is opened: sizes of texts, the share of the window that it uses, overlaps. Nothing runs, and no window opens.

use std::path::Path;
use std::sync::Arc;

use eframe::egui::epaint::{ClippedShape, Shape};
use eframe::egui::{CentralPanel, Context, Frame, Panel, Pos2, RawInput, Rect, Vec2};
use panoscope_editor_model::document::Document;
use panoscope_editor_model::observe::Counters;
use panoscope_editor_widgets::{OutputCache, theme};
use panoscope_graph::GraphOptions;
use panoscope_host::loader::Loader;
use serde_json::{Value, json};

use crate::canvas::{Canvas, Scene};

/// Space of the bar above the canvas and of the panel beside it.
const BAR: f32 = 44.0;
const SIDE: f32 = 320.0;

/// The figures of one graph in a window of one size.
#[derive(Clone, Debug)]
pub struct Arrangement {
    /// Number of nodes that are shown.
    pub nodes: usize,
    /// Scale of the graph.
    pub scale: f32,
    /// Size of the smallest text on the canvas, in points; `None` without any text.
    pub min_text: Option<f32>,
    /// Share of nodes with their name written on them, also where it is shortened.
    pub named: f32,
    /// Share of the canvas inside the bounding box of the nodes.
    pub used: f32,
    /// Share of the canvas covered by nodes.
    pub covered: f32,
    /// Pairs of nodes that overlap.
    pub overlaps: usize,
    /// Wires that pass under a node, each with the node.
    pub under: Vec<String>,
}

impl Arrangement {
    /// Arranges the graph of a file in a window of this size (points).
    pub fn of(path: &Path, text: &str, loader: Arc<Loader>, window: Vec2) -> Self {
        let document = Document::with_options(path, text, loader, GraphOptions::default());
        let ctx = Context::default();
        theme::apply(&ctx);
        let (mut canvas, counters, shown) = (Canvas::default(), Counters::default(), OutputCache::default());
        let view = document.view();
        let mut shapes = Vec::new();
        // The first frame measures texts.
        for _ in 0..2 {
            let input = RawInput { screen_rect: Some(Rect::from_min_size(Pos2::ZERO, window)), ..RawInput::default() };
            let mut output = ctx.run_ui(input, |ui| {
                Panel::top("top").exact_size(BAR).show(ui, |_| {});
                Panel::right("side").frame(Frame::NONE).exact_size(SIDE).show(ui, |_| {});
                CentralPanel::no_frame().show(ui, |ui| {
                    let scene = Scene {
                        view,
                        counters: &counters,
                        shown: &shown,
                        heat: false,
                        running: false,
                        problem: None,
                        recorded: None,
                    };
                    canvas.show(ui, &scene, 1);
                });
            });
            // Nothing is drawn.
            output.textures_delta.clear();
            shapes = output.shapes;
        }
        let texts = texts(&shapes);
        let rects: Vec<Rect> = canvas.node_rects().into_iter().map(|(_, rect)| rect).collect();
        let area = |rect: Rect| rect.intersect(canvas.rect).area() / canvas.rect.area();
        let named = rects.iter().filter(|rect| texts.iter().any(|(at, _)| rect.expand(2.0).contains_rect(*at)));
        let overlapping = |(n, a): (usize, &Rect)| rects[..n].iter().filter(|b| a.shrink(0.5).intersects(**b)).count();
        Self {
            nodes: rects.len(),
            scale: canvas.zoom_factor(),
            min_text: texts.iter().map(|(_, size)| *size).reduce(f32::min),
            named: named.count() as f32 / rects.len().max(1) as f32,
            used: rects.iter().copied().reduce(|a, b| a.union(b)).map_or(0.0, area),
            covered: rects.iter().map(|rect| area(*rect)).sum(),
            overlaps: rects.iter().enumerate().map(overlapping).sum(),
            under: canvas.wires_under_nodes(view),
        }
    }

    /// As JSON; shares in percent.
    pub fn json(&self) -> Value {
        json!({
            "nodes": self.nodes,
            "scale": self.scale,
            "text_px": self.min_text,
            "named_pct": self.named * 100.0,
            "used_pct": self.used * 100.0,
            "covered_pct": self.covered * 100.0,
            "overlaps": self.overlaps,
            "wires_under_nodes": self.under,
        })
    }
}

/// Rectangles and font sizes of all texts that are visible.
fn texts(shapes: &[ClippedShape]) -> Vec<(Rect, f32)> {
    fn collect(shape: &Shape, clip: Rect, found: &mut Vec<(Rect, f32)>) {
        match shape {
            Shape::Vec(shapes) => shapes.iter().for_each(|shape| collect(shape, clip, found)),
            Shape::Text(text) => {
                let rect = text.visual_bounding_rect();
                let sizes = text.galley.job.sections.iter().map(|section| section.format.font_id.size);
                if let Some(size) = sizes.reduce(f32::min).filter(|_| rect.intersects(clip) && rect.is_positive()) {
                    found.push((rect, size));
                }
            }
            _ => {}
        }
    }
    let mut found = Vec::new();
    shapes.iter().for_each(|clipped| collect(&clipped.shape, clipped.clip_rect, &mut found));
    found
}
