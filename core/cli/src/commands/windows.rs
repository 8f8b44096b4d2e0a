//! Options of `run` and `record` that let windows of other machines attach.

use std::path::PathBuf;

use panoscope_engine::Engine;
use panoscope_host::attach::{AttachError, Attachable, Options};

use crate::terminal::log;

/// Settings for windows of other machines.
#[derive(clap::Args)]
#[group(id = "windows")]
pub struct Arguments {
    /// Lets `panoscope edit --attach` and `panoscope theatre --attach` of other machines show the running graph:
    /// tls/IP:PORT with keys of `panoscope keys`, or tcp/127.0.0.1:PORT for windows of this machine. Windows only read,
    /// unless --allow-edit names their machine.
    #[arg(long, value_name = "ADDRESS")]
    attachable: Option<String>,
    /// Name of this machine for windows; default: the name in its keys.
    #[arg(long, value_name = "NAME", requires = "attachable")]
    attachable_name: Option<String>,
    /// Machine whose windows may read, by the name in its certificate; repeatable.
    #[arg(long, value_name = "NAME", requires = "attachable")]
    allow_read: Vec<String>,
    /// Machine whose windows may read and change the graph: with all that installed nodes can do with the rights of
    /// this user, but no emergency stop and no other plugins. `unnamed` means windows of this machine over tcp/.
    /// Repeatable.
    #[arg(long, value_name = "NAME", requires = "attachable")]
    allow_edit: Vec<String>,
    /// Folder with the keys of this machine, made by `panoscope keys`; default: PANOSCOPE_KEYS.
    #[arg(long, value_name = "DIR", requires = "attachable")]
    keys: Option<PathBuf>,
}

impl Arguments {
    /// Listens for windows, if requested, and reports it.
    pub fn start(&self) -> Result<Option<Attachable>, AttachError> {
        let Some(address) = &self.attachable else { return Ok(None) };
        let attachable = Attachable::start(Options {
            address: address.clone(),
            name: self.attachable_name.clone(),
            keys: self.keys.clone(),
            plaintext: false,
            readers: self.allow_read.clone(),
            editors: self.allow_edit.clone(),
        })?;
        let who = |names: &[String]| if names.is_empty() { "nobody".to_owned() } else { names.join(", ") };
        log!(
            "windows attach to `{}` at {address}: {} may read, {} may read and edit",
            attachable.name(),
            if address.starts_with("tcp/") { "this machine".to_owned() } else { who(&self.allow_read) },
            who(&self.allow_edit)
        );
        Ok(Some(attachable))
    }
}

/// Runs `work`, and serves windows of the engine meanwhile.
pub fn beside(windows: Option<&Attachable>, engine: &Engine, work: impl FnOnce()) {
    let Some(windows) = windows else { return work() };
    std::thread::scope(|scope| {
        let packets = std::thread::Builder::new().name("windows".to_owned());
        if let Err(error) = packets.spawn_scoped(scope, || windows.send_packets(engine)) {
            log!("warning: windows get no pictures: a thread could not be started: {error}");
        }
        // Also where the work panics: the scope waits for the thread.
        let _finish = Finish(windows);
        work();
    });
}

/// Tells windows that the run has ended.
struct Finish<'w>(&'w Attachable);

impl Drop for Finish<'_> {
    fn drop(&mut self) {
        self.0.finish("the run is over");
    }
}
