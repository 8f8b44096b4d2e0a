//! The palette: a search field with a list, to add a node, connect the selected one, find one, or find any command or parameter by keyboard.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use eframe::egui::{
    Align, Align2, Color32, Context, Frame, Id, Key, Label, Modal, Modifiers, RichText, ScrollArea, Sense,
    TextWrapMode, Ui, WidgetInfo, WidgetType, vec2,
};
use panoscope_editor_model::texts;
use panoscope_editor_model::texts::text;
use panoscope_graph::NodeType;
use panoscope_host::loader::Loader;

use crate::actions::{self, Action};
use crate::panels::inspector::candidates;
use crate::search::{self, Candidate};
use panoscope_editor_model::document::{Document, default_value};
use panoscope_editor_model::examples::{self, PartFile};
use panoscope_editor_model::graph_view::{GraphView, NodeView};
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::ops::{self, NewWire, PendingWire};
use panoscope_editor_widgets::theme;
use panoscope_engine::sync::lock;

/// What the palette is open for.
#[derive(Clone, Debug)]
pub enum Purpose {
    /// Adding a node, for the end of a wire if there is one.
    Add {
        /// Position of the new node, where the user pointed at one.
        at: Option<(f32, f32)>,
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
    Add(Arc<NodeType>, Option<(f32, f32)>, Option<PendingWire>),
    /// The file of a part for a new node, and its position.
    AddPart(PathBuf, Option<(f32, f32)>),
    /// An input (node, input) and its output.
    Connect(String, String, Output),
    /// Several wires at once.
    ConnectAll(Vec<NewWire>),
    /// A node to go to.
    Go(String),
    /// An action to perform.
    Perform(Action),
    /// A parameter to go to: node, name.
    Param(String, String),
}

/// What can be added to a graph: all node types of this machine, and parts. Gathered on a separate thread, because loading plugins takes time.
#[derive(Clone, Default)]
pub struct Types(Arc<Mutex<Option<Arc<Offers>>>>);

#[derive(Default)]
struct Offers {
    types: Vec<Arc<NodeType>>,
    parts: Vec<PartFile>,
    /// How often graphs use a type or part.
    uses: HashMap<String, usize>,
}

impl Types {
    /// Gathers them for the graph at `path` and then calls `done`.
    pub fn gather(&self, loader: Arc<Loader>, path: &Path, done: impl Fn() + Send + 'static) {
        let place = Arc::clone(&self.0);
        let (folder, folders) = (path.parent().unwrap_or(Path::new("")).to_owned(), examples::folders(path));
        let gather = move || {
            let names: Vec<String> = loader.found().map(|f| f.note.name.clone()).collect();
            let types = loader.catalog(&names).node_types.into_iter().map(Arc::new).collect();
            let mut parts = examples::parts(&folders);
            parts.iter_mut().for_each(|part| part.path = examples::written(&part.path, &folder));
            *lock(&place) = Some(Arc::new(Offers { types, parts, uses: examples::uses(&folders) }));
            done();
        };
        // If the thread cannot be started, the list stays empty; the file can still be edited as text.
        let _ = std::thread::Builder::new().name("types".to_owned()).spawn(gather);
    }

    fn get(&self) -> Option<Arc<Offers>> {
        lock(&self.0).clone()
    }
}

/// The first line of a documentation.
fn first_line(doc: &str) -> String {
    doc.lines().next().unwrap_or_default().to_owned()
}

/// All actions.
fn commands() -> impl Iterator<Item = Entry> {
    actions::ALL.iter().filter(|(action, ..)| *action != Action::Commands).map(|(action, _, _, name)| Entry {
        name: texts::plain(name).to_owned(),
        side: actions::key_name(*action),
        // Found by its English name in every language.
        words: format!("{action:?}"),
        color: theme::accent(),
        ..Entry::new(Picked::Perform(*action))
    })
}

/// All nodes that are shown.
fn nodes(view: &GraphView) -> impl Iterator<Item = Entry> + '_ {
    view.nodes.iter().map(|n| Entry {
        name: n.id().to_owned(),
        side: n.outline.type_name.clone(),
        doc: n.node_type.as_ref().map(|t| first_line(&t.doc)).unwrap_or_default(),
        words: n.outline.type_name.clone(),
        color: theme::family(n.family()),
        ..Entry::new(Picked::Go(n.id().to_owned()))
    })
}

/// The parameters of all nodes, those inside folded parts included, with their values.
fn params(view: &GraphView) -> impl Iterator<Item = Entry> + '_ {
    let entry = |n: &NodeView, param: &panoscope_graph::Param| {
        let value = n.outline.params.get(&param.name).cloned().unwrap_or_else(|| default_value(&param.kind));
        Entry {
            name: format!("{}.{}", n.id(), param.name),
            side: format!("{value} {}", param.unit).trim_end().to_owned(),
            doc: first_line(&param.doc),
            color: theme::family(n.family()),
            ..Entry::new(Picked::Param(n.id().to_owned(), param.name.clone()))
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
    /// More words by which it is found.
    words: String,
    /// How often it is used.
    uses: usize,
    color: Color32,
    picked: Picked,
}

impl Entry {
    fn new(picked: Picked) -> Self {
        let (name, side, doc, words) = (String::new(), String::new(), String::new(), String::new());
        Self { name, side, doc, words, uses: 0, color: theme::muted(), picked }
    }

    /// A node type.
    fn of_type(t: &Arc<NodeType>, at: Option<(f32, f32)>, pending: Option<&PendingWire>, uses: usize) -> Self {
        let ports = t.inputs.iter().chain(&t.outputs);
        let ports: Vec<String> = ports.map(|port| format!("{} {}", port.name, port.packet.name)).collect();
        Self {
            name: t.name.clone(),
            side: format!("{} · {}", t.family, t.plugin),
            doc: first_line(&t.doc),
            words: format!("{} {} {} {}", t.family, t.plugin, ports.join(" "), t.doc),
            uses,
            color: theme::family(&t.family),
            ..Self::new(Picked::Add(Arc::clone(t), at, pending.cloned()))
        }
    }

    /// A part.
    fn of_part(part: &PartFile, at: Option<(f32, f32)>, uses: usize) -> Self {
        Self {
            name: part.name.clone(),
            side: text!("palette-part").to_owned(),
            doc: part.doc.clone(),
            words: part.ports.join(" "),
            uses,
            color: theme::family("part"),
            ..Self::new(Picked::AddPart(part.path.clone(), at))
        }
    }
}

/// Wires for a node: first all of them by the names of its ports, then one by one.
fn wires(document: &Document, node: usize) -> Vec<Entry> {
    let view = document.view();
    let id = view.nodes[node].id();
    let together = |wires: Vec<NewWire>, caption: fn(&str, &str) -> String, to: &str| {
        let ports: Vec<&str> = wires.iter().map(|(_, (_, input))| input.as_str()).collect();
        let doc: Vec<String> = wires.iter().map(|(from, (node, input))| format!("{from} > {node}.{input}")).collect();
        let (name, doc) = (caption(&ports.join(", "), to), doc.join("   "));
        Entry { name, doc, color: theme::accent(), ..Entry::new(Picked::ConnectAll(wires)) }
    };
    let mut all = Vec::new();
    let named = ops::wires_by_name(view, node);
    if named.len() > 1 {
        all.push(together(named, |ports, _| text!("palette-by-name", ports = ports), id));
    }
    for other in (0..view.nodes.len()).filter(|other| *other != node) {
        let named = ops::wires_to(view, node, other);
        if !named.is_empty() {
            let caption = |ports: &str, to: &str| text!("palette-to", ports = ports, node = to);
            all.push(together(named, caption, view.nodes[other].id()));
        }
    }
    let inputs = view.nodes[node].node_type.iter().flat_map(|t| &t.inputs);
    let pairs =
        inputs.flat_map(|port| candidates(document, node, &port.name).into_iter().map(move |from| (port, from)));
    all.extend(pairs.map(|(port, from)| Entry {
        name: text!("palette-from", input = &port.name, output = from.to_string()),
        side: port.packet.name.clone(),
        doc: first_line(&port.doc),
        color: theme::packet(&port.packet.name),
        ..Entry::new(Picked::Connect(id.to_owned(), port.name.clone(), from))
    }));
    all
}

/// What was found last, and for what.
struct Found {
    typed: String,
    revision: u64,
    /// Whether node types and parts were known.
    complete: bool,
    entries: Vec<Entry>,
    order: Vec<usize>,
}

/// The open palette.
pub struct Palette {
    purpose: Purpose,
    typed: String,
    chosen: usize,
    fresh: bool,
    found: Option<Found>,
}

impl Palette {
    /// Opens the palette.
    pub fn new(purpose: Purpose) -> Self {
        Self { purpose, typed: String::new(), chosen: 0, fresh: true, found: None }
    }

    fn entries(&self, document: &Document, types: &Types) -> Vec<Entry> {
        let view = document.view();
        match &self.purpose {
            Purpose::Add { at, pending } => {
                let offers = types.get().unwrap_or_default();
                let here = |name: &str| view.flat().nodes.iter().filter(|n| n.outline.type_name == name).count();
                let uses = |name: &str| offers.uses.get(name).copied().unwrap_or(0) + here(name);
                let fits = |t: &&Arc<NodeType>| {
                    pending.as_ref().is_none_or(|pending| ops::fitting_port(view, t, pending).is_some())
                };
                let nodes = offers.types.iter().filter(fits);
                let nodes = nodes.map(|t| Entry::of_type(t, *at, pending.as_ref(), uses(&t.name)));
                let parts = offers.parts.iter().filter(|_| pending.is_none());
                nodes.chain(parts.map(|part| Entry::of_part(part, *at, uses(&part.name)))).collect()
            }
            Purpose::Connect { node } => view.node(node).map(|index| wires(document, index)).unwrap_or_default(),
            Purpose::Command => commands().chain(nodes(view)).chain(params(view)).collect(),
            Purpose::Find => nodes(view).collect(),
        }
    }

    /// What is found by the typed words. It is searched again only when they or the graph have changed.
    fn search(&mut self, document: &Document, types: &Types) -> Found {
        let (revision, complete) = (document.revision(), types.get().is_some());
        let is_same = |f: &Found| f.typed == self.typed && f.revision == revision && f.complete == complete;
        if let Some(found) = self.found.take().filter(is_same) {
            return found;
        }
        let entries = self.entries(document, types);
        let words: Vec<String> = entries.iter().map(|e| format!("{} {}", e.doc, e.words)).collect();
        let candidates = entries.iter().zip(&words);
        let candidates = candidates.map(|(e, words)| Candidate { name: &e.name, words, uses: e.uses });
        let order = search::rank(&self.typed, text!("palette-synonyms"), candidates);
        Found { typed: self.typed.clone(), revision, complete, entries, order }
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
        let found = self.search(document, types);
        let Found { entries, order, .. } = &found;
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
        self.found = Some(found);
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
