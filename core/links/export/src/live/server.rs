//! The server, and the thread of the run that feeds it.

use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use foxglove::websocket::{AnyClient, GetParametersResponder, Parameter, ParameterHandler, SetParametersResponder};
use foxglove::{Context, WebSocketServer, WebSocketServerHandle};
use panoscope_engine::Engine;
use panoscope_engine::sync::lock;
use panoscope_graph::{Catalog, Graph};
use panoscope_host::loader::Live;
use panoscope_monitor::Address;

use crate::live::error::LiveServerError;
use crate::live::outputs::{self, Output};
use crate::live::parameters::{self, Request};
use crate::live::{gate, publisher};

/// Time between two checks for changes of the graph or its parameters.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// Maximum number of messages that wait for a slow client; the oldest are dropped. A live change that adds more topics
/// than this ends connections, and clients reconnect.
const BACKLOG: usize = 64;
/// Maximum number of waiting requests to set parameters.
const MAX_REQUESTS: usize = 64;

/// Settings of a server.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Address to listen on.
    pub address: Address,
    /// Whether clients may set parameters.
    pub may_set: bool,
}

/// Shared by the thread of the run, the publisher and the server.
#[derive(Default)]
struct Shared {
    /// Outputs with their topics.
    outputs: Mutex<Vec<Output>>,
    /// Whether the server must end.
    ends: AtomicBool,
    parameters: Mutex<BTreeMap<String, Parameter>>,
    requests: Mutex<Vec<Request>>,
    may_set: bool,
    refused: Arc<gate::Refused>,
}

/// Answers requests for parameters with the values that the run published.
struct Handler(Arc<Shared>);

impl Handler {
    fn named(&self, names: &[String]) -> Vec<Parameter> {
        let known = lock(&self.0.parameters);
        match names {
            [] => known.values().cloned().collect(),
            names => names.iter().filter_map(|name| known.get(name).cloned()).collect(),
        }
    }
}

impl ParameterHandler for Handler {
    fn get(&self, _: AnyClient, names: Vec<String>, _: Option<String>, responder: GetParametersResponder) {
        responder.respond(self.named(&names));
    }

    fn set(&self, client: AnyClient, parameters: Vec<Parameter>, _: Option<String>, responder: SetParametersResponder) {
        let refuse = |words: &str, responder: SetParametersResponder| {
            client.send_error(words);
            let names: Vec<String> = parameters.iter().map(|parameter| parameter.name.clone()).collect();
            // Without names this would be all of them.
            responder.respond(if names.is_empty() { Vec::new() } else { self.named(&names) });
        };
        if !self.0.may_set {
            return refuse("parameters can only be read; start the run with --foxglove-set to set them", responder);
        }
        let mut requests = lock(&self.0.requests);
        if requests.len() >= MAX_REQUESTS {
            drop(requests);
            return refuse("too many requests to set parameters wait", responder);
        }
        requests.push(Request { client: client.clone(), parameters, responder });
    }
}

/// Serves a running graph to Foxglove until it is dropped.
pub struct FoxgloveServer {
    address: SocketAddr,
    shared: Arc<Shared>,
    context: Arc<Context>,
    /// The public listener and the address of the server behind it. Clients wait until the first update of the graph,
    /// after which all topics are announced at once.
    door: Option<(TcpListener, SocketAddr)>,
    /// The graph at the last check.
    known: Option<(Graph, Catalog)>,
    looked: Option<Instant>,
    publisher: Option<JoinHandle<()>>,
    // Fields are dropped in this order: the server before what it runs on.
    handle: WebSocketServerHandle,
    runtime: Option<tokio::runtime::Runtime>,
}

impl FoxgloveServer {
    /// Begins to listen; topics appear with the first [`Self::update`]. `name` is that of the graph.
    ///
    /// # Errors
    /// The address cannot be used.
    pub fn start(name: &str, options: Options) -> Result<Self, LiveServerError> {
        let socket = options.address.socket();
        let listen = |cause| LiveServerError::Listen { address: socket, cause };
        let listener = TcpListener::bind(socket).map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        let address = listener.local_addr().map_err(listen)?;
        let thread = |cause| LiveServerError::Thread { address, cause };
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("foxglove")
            .enable_all()
            .build()
            .map_err(thread)?;
        let shared = Arc::new(Shared { may_set: options.may_set, ..Shared::default() });
        let context = Context::new();
        let hidden = gate::hidden_loopback();
        let server = WebSocketServer::new()
            .name(format!("Panoscope: {name}"))
            .context(&context)
            .bind(hidden.to_string(), 0)
            .message_backlog_size(BACKLOG)
            .parameter_handler(Arc::new(Handler(Arc::clone(&shared))));
        let handle = runtime
            .block_on(server.start())
            .map_err(|error| LiveServerError::Foxglove { address, words: error.to_string() })?;
        let door = Some((listener, SocketAddr::from((hidden, handle.port()))));
        let publishes = Arc::clone(&shared);
        let publisher = std::thread::Builder::new()
            .name("foxglove-out".to_owned())
            .spawn(move || publisher::run(&publishes.outputs, &publishes.ends))
            .map_err(thread)?;
        Ok(Self {
            address,
            shared,
            context,
            door,
            known: None,
            looked: None,
            publisher: Some(publisher),
            handle,
            runtime: Some(runtime),
        })
    }

    /// The address that it listens on; port 0 is replaced by the one that the system chose.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Publishes the current state and handles requests of clients. Call it several times a second, on the thread that
    /// takes previews. Returns log lines about set parameters, connections and refusals.
    pub fn update(&mut self, live: &mut Live) -> Vec<String> {
        let mut lines = Vec::new();
        let now = Instant::now();
        if self.looked.is_none_or(|looked| now.duration_since(looked) >= LOOK_EVERY) {
            self.looked = Some(now);
            lines.extend(self.look(live));
            lines.extend(self.shared.refused.take().map(|line| format!("foxglove: {line}")));
        }
        self.set(live, &mut lines);
        self.subscribe(live.engine());
        lines
    }

    /// Follows changes of the graph and of its parameters.
    fn look(&mut self, live: &Live) -> Option<String> {
        let engine = live.engine();
        let graph = engine.graph();
        let mut failure = None;
        if self.known.as_ref().is_none_or(|(known, _)| *known != graph) {
            let catalog = live.loader().catalog_of_graph(&graph);
            let mut outputs = lock(&self.shared.outputs);
            match outputs::follow(&mut outputs, &self.context, &graph, &catalog) {
                Ok(ended) => ended.iter().for_each(|node| engine.end_previews(node)),
                Err(error) => failure = Some(format!("foxglove: {error}")),
            }
            drop(outputs);
            self.known = Some((graph, catalog));
        }
        self.publish_parameters(engine);
        if let (Some((listener, server)), Some(runtime)) = (self.door.take(), &self.runtime) {
            runtime.spawn(gate::accept(listener, server, Arc::clone(&self.shared.refused)));
        }
        failure
    }

    /// Publishes values that have changed.
    fn publish_parameters(&self, engine: &Engine) {
        let Some((graph, catalog)) = &self.known else { return };
        let new = parameters::all(engine, graph, catalog);
        let mut known = lock(&self.shared.parameters);
        let changed: Vec<Parameter> = new
            .iter()
            .filter(|(name, value)| known.get(*name) != Some(value))
            .map(|(_, value)| value.clone())
            .collect();
        *known = new;
        drop(known);
        if !changed.is_empty() {
            self.handle.publish_parameter_values(changed);
        }
    }

    fn set(&mut self, live: &mut Live, lines: &mut Vec<String>) {
        let requests = std::mem::take(&mut *lock(&self.shared.requests));
        for Request { client, parameters, responder } in requests {
            for parameter in &parameters {
                let Some((graph, catalog)) = &self.known else { continue };
                match parameters::set(live, graph, catalog, parameter) {
                    Ok(false) => {}
                    Ok(true) => lines.push(format!("foxglove: `{}` was set", parameter.name)),
                    Err(error) => {
                        let words = error.to_string();
                        client.send_error(words.clone());
                        lines.push(format!("foxglove: {words}"));
                    }
                }
            }
            self.publish_parameters(live.engine());
            let known = lock(&self.shared.parameters);
            responder.respond(parameters.iter().filter_map(|asked| known.get(&asked.name).cloned()).collect());
        }
    }

    /// Subscribes to requested outputs and drops other previews.
    fn subscribe(&self, engine: &Engine) {
        let mut ended = Vec::new();
        for output in lock(&self.shared.outputs).iter_mut() {
            match (output.is_wanted(), output.preview.is_some()) {
                (true, false) => output.preview = engine.preview(&output.node, &output.port),
                (false, true) => {
                    output.preview = None;
                    ended.push(output.node.clone());
                }
                _ => {}
            }
        }
        ended.iter().for_each(|node| engine.end_previews(node));
    }
}

impl Drop for FoxgloveServer {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        if let Some(publisher) = self.publisher.take() {
            let _ = publisher.join();
        }
        // Frames go back before the graph closes.
        lock(&self.shared.outputs).clear();
        // A client with an open connection does not keep the program.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::from_millis(100));
        }
    }
}
