//! The palette: a search field with a list, to add a node, connect the selected one, find one, or find any command or parameter by keyboard.

use std::sync::{Arc, Mutex};

use eframe::egui::{
    Align, Align2, Context, Frame, Id, Key, Label, Modal, Modifiers, RichText, ScrollArea, Sense, TextWrapMode, Ui,
    WidgetInfo, WidgetType, vec2,
};
use panoscope_editor_texts as texts;
use panoscope_editor_texts::text;
use panoscope_graph::NodeType;
use panoscope_host::loader::Loader;

use crate::actions::{self, Action};
use crate::panels::inspector::candidates;
use crate::search;
use panoscope_editor_model::document::{Document, default_value};
use panoscope_editor_model::graph_view::{GraphView, NodeView};
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::ops::{self, PendingWire};
use panoscope_editor_widgets::theme;
use panoscope_engine::sync::lock;

/// What the palette is open for.
#[derive(Clone, Debug)]
pub enum Purpose {
    /// Adding a node at a position, for the end of a wire if there is one.
    Add {
        /// Position of the new node.
        at: (f32, f32),
        /// The existing end of the wire.
        pending: Option<PendingWire>,
    },
    /// Choosing an output for an input of a node.
    Connect {
        /// The node.
        node: String,
    },
    /// Finding a node.
    Find,
    /// Finding a command, a node, or a parameter of any node.
    Command,
}

/// What the user picked.
#[derive(Clone, Debug)]
pub enum Picked {
    /// A type for a new node, its position and the end of its wire.
    Add(Arc<NodeType>, (f32, f32), Option<PendingWire>),
    /// An input (node, input) and its output.
    Connect(String, String, Output),
    /// A node to go to.
    Go(String),
    /// An action to perform.
    Perform(Action),
    /// A parameter to go to: node, name.
    Param(String, String),
}

/// All node types of this machine. They are loaded on a thread of their own, because loading plugins takes time.
#[derive(Clone, Default)]
pub struct Types(Arc<Mutex<Option<TypeList>>>);

type TypeList = Arc<Vec<Arc<NodeType>>>;

impl Types {
    /// Loads them and then calls `done`.
    pub fn gather(&self, loader: Arc<Loader>, done: impl Fn() + Send + 'static) {
        let place = Arc::clone(&self.0);
        let gather = move || {
            let names: Vec<String> = loader.found().map(|f| f.note.name.clone()).collect();
            let types = loader.catalog(&names).node_types.into_iter().map(Arc::new).collect();
            *lock(&place) = Some(Arc::new(types));
            done();
        };
        // If the thread cannot be started, the list stays empty; the file can still be edited as text.
        let _ = std::thread::Builder::new().name("types".to_owned()).spawn(gather);
    }

    fn get(&self) -> Option<TypeList> {
        lock(&self.0).clone()
    }
}

/// All actions.
fn commands() -> impl Iterator<Item = Entry> {
    actions::ALL.iter().filter(|(action, ..)| *action != Action::Commands).map(|(action, _, _, name)| Entry {
        name: texts::plain(name).to_owned(),
        side: actions::key_name(*action),
        doc: format!("Command {action:?}"),
        color: theme::accent(),
        picked: Picked::Perform(*action),
    })
}

/// All nodes that are shown.
fn nodes(view: &GraphView) -> impl Iterator<Item = Entry> + '_ {
    view.nodes.iter().map(|n| Entry {
        name: n.id().to_owned(),
        side: n.outline.type_name.clone(),
        doc: n.node_type.as_ref().and_then(|t| t.doc.lines().next()).unwrap_or_default().to_owned(),
        color: theme::family(n.family()),
        picked: Picked::Go(n.id().to_owned()),
    })
}

/// The parameters of all nodes, those inside folded parts included, with their values.
fn params(view: &GraphView) -> impl Iterator<Item = Entry> + '_ {
    let entry = |n: &NodeView, param: &panoscope_graph::Param| {
        let value = n.outline.params.get(&param.name).cloned().unwrap_or_else(|| default_value(&param.kind));
        Entry {
            name: format!("{}.{}", n.id(), param.name),
            side: format!("{value} {}", param.unit).trim_end().to_owned(),
            doc: param.doc.lines().next().unwrap_or_default().to_owned(),
            color: theme::family(n.family()),
            picked: Picked::Param(n.id().to_owned(), param.name.clone()),
        }
    };
    let of = move |n: &NodeView| -> Vec<Entry> {
        n.node_type.iter().flat_map(|t| &t.params).map(|param| entry(n, param)).collect()
    };
    let inside = view.flat.iter().flat_map(|flat| &flat.nodes).filter(|n| view.node(n.id()).is_none());
    view.nodes.iter().chain(inside).flat_map(of)
}

struct Entry {
    name: String,
    /// On the right: type, key or value.
    side: String,
    doc: String,
    color: eframe::egui::Color32,
    picked: Picked,
}

/// The open palette.
pub struct Palette {
    purpose: Purpose,
    typed: String,
    chosen: usize,
    fresh: bool,
}

impl Palette {
    /// Opens the palette.
    pub fn new(purpose: Purpose) -> Self {
        Self { purpose, typed: String::new(), chosen: 0, fresh: true }
    }

    fn entries(&self, document: &Document, types: &Types) -> Vec<Entry> {
        let view = document.view();
        match &self.purpose {
            Purpose::Add { at, pending } => {
                let types = types.get().unwrap_or_default();
                let fits = |t: &&Arc<NodeType>| {
                    pending.as_ref().is_none_or(|pending| ops::fitting_port(view, t, pending).is_some())
                };
                let entry = |t: &Arc<NodeType>| Entry {
                    name: t.name.clone(),
                    side: format!("{} · {}", t.family, t.plugin),
                    doc: t.doc.lines().next().unwrap_or_default().to_owned(),
                    color: theme::family(&t.family),
                    picked: Picked::Add(Arc::clone(t), *at, pending.clone()),
                };
                types.iter().filter(fits).map(entry).collect()
            }
            Purpose::Connect { node } => {
                let Some(index) = view.node(node) else { return Vec::new() };
                let inputs = view.nodes[index].node_type.iter().flat_map(|t| &t.inputs);
                let pairs = inputs
                    .flat_map(|port| candidates(document, index, &port.name).into_iter().map(move |from| (port, from)));
                let entry = |(port, from): (&panoscope_graph::Port, Output)| Entry {
                    name: text!("palette-from", input = &port.name, output = from.to_string()),
                    side: port.packet.name.clone(),
                    doc: port.doc.lines().next().unwrap_or_default().to_owned(),
                    color: theme::packet(&port.packet.name),
                    picked: Picked::Connect(node.clone(), port.name.clone(), from),
                };
                pairs.map(entry).collect()
            }
            Purpose::Command => commands().chain(nodes(view)).chain(params(view)).collect(),
            Purpose::Find => nodes(view).collect(),
        }
    }

    fn hint(&self) -> &'static str {
        match &self.purpose {
            Purpose::Add { pending: None, .. } => text!("palette-add"),
            Purpose::Add { .. } => text!("palette-add-to-wire"),
            Purpose::Connect { .. } => text!("palette-connect"),
            Purpose::Find => text!("palette-find"),
            Purpose::Command => text!("palette-command"),
        }
    }

    /// Shows the palette; returns what was picked, or `Some(None)` when it was closed without picking.
    pub fn show(&mut self, ctx: &Context, document: &Document, types: &Types) -> Option<Option<Picked>> {
        let entries = self.entries(document, types);
        let order = search::rank(&self.typed, entries.iter().map(|e| (e.name.as_str(), e.doc.as_str())));
        self.chosen = self.chosen.min(order.len().saturating_sub(1));
        let take = |key| ctx.input_mut(|i| i.consume_key(Modifiers::NONE, key));
        if take(Key::ArrowDown) {
            self.chosen = (self.chosen + 1).min(order.len().saturating_sub(1));
        }
        if take(Key::ArrowUp) {
            self.chosen = self.chosen.saturating_sub(1);
        }
        let mut result = None;
        if take(Key::Enter) {
            result = order.get(self.chosen).map(|&index| Some(entries[index].picked.clone()));
        }
        let frame = Frame::popup(&ctx.global_style()).inner_margin(12.0);
        let area = Modal::default_area(Id::new("palette")).anchor(Align2::CENTER_TOP, vec2(0.0, 96.0));
        let shown = Modal::new(Id::new("palette"))
            .area(area)
            .frame(frame)
            .backdrop_color(theme::sunk().gamma_multiply(0.5))
            .show(ctx, |ui| {
                ui.set_width(520.0);
                let hint = self.hint();
                if search::field(ui, &mut self.typed, &mut self.fresh, hint, text!("palette-name")) {
                    self.chosen = 0;
                }
                ui.add_space(theme::STEP);
                ScrollArea::vertical().min_scrolled_height(400.0).max_height(400.0).auto_shrink([false, true]).show(
                    ui,
                    |ui| {
                        ui.spacing_mut().item_spacing.y = 0.0;
                        for (row, &index) in order.iter().enumerate() {
                            if row_of(ui, &entries[index], row == self.chosen) {
                                result = Some(Some(entries[index].picked.clone()));
                            }
                        }
                        if order.is_empty() {
                            let reading = matches!(self.purpose, Purpose::Add { .. }) && types.get().is_none();
                            let message = if reading { text!("palette-loading") } else { text!("palette-no-match") };
                            ui.label(RichText::new(message).color(theme::muted()));
                        }
                    },
                );
            });
        if result.is_none() && shown.should_close() { Some(None) } else { result }
    }
}

/// Draws one row; returns whether it was clicked.
fn row_of(ui: &mut Ui, entry: &Entry, chosen: bool) -> bool {
    let (rect, row) = ui.allocate_exact_size(vec2(ui.available_width(), 44.0), Sense::click());
    row.widget_info(|| {
        WidgetInfo::selected(WidgetType::SelectableLabel, true, chosen, text!("palette-pick", name = &entry.name))
    });
    if !ui.is_rect_visible(rect) && !chosen {
        return row.clicked();
    }
    search::mark_row(ui, rect, &row, chosen);
    let bar = eframe::egui::Rect::from_min_size(rect.min + vec2(6.0, 8.0), vec2(3.0, 28.0));
    ui.painter().rect_filled(bar, 1.5, entry.color);
    let inside = rect.shrink2(vec2(16.0, 3.0));
    ui.scope_builder(eframe::egui::UiBuilder::new().max_rect(inside), |ui| {
        ui.spacing_mut().item_spacing.y = 1.0;
        ui.horizontal(|ui| {
            ui.spacing_mut().interact_size.y = 16.0;
            ui.add(Label::new(RichText::new(&entry.name).strong()).selectable(false));
            ui.with_layout(eframe::egui::Layout::right_to_left(Align::Center), |ui| {
                ui.add(Label::new(RichText::new(&entry.side).size(11.0).color(theme::muted())).selectable(false));
            });
        });
        let doc = RichText::new(&entry.doc).size(11.5).color(theme::muted());
        ui.add(Label::new(doc).wrap_mode(TextWrapMode::Truncate).selectable(false));
    });
    row.clicked()
}
