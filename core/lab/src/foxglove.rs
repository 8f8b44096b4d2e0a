//! `--foxglove` of `run`, `record` and `soak`.

use anyhow::Result;
use panoscope_cli::commands::run::{Arguments, Server};
use panoscope_cli::terminal::log;
use panoscope_export::live::{FoxgloveServer, Options};
use panoscope_host::loader::Live;

struct Foxglove {
    options: Options,
    server: Option<FoxgloveServer>,
}

/// The server of a run, if the arguments request one.
pub fn server(arguments: &Arguments) -> Option<Box<dyn Server>> {
    let (address, may_set) = arguments.foxglove()?;
    Some(Box::new(Foxglove { options: Options { address, may_set }, server: None }))
}

impl Server for Foxglove {
    fn start(&mut self, graph: &str) -> Result<()> {
        let server = FoxgloveServer::start(graph, self.options)?;
        log!("serves ws://{} for Foxglove", server.address());
        if self.options.address.is_public() {
            let also = if self.options.may_set { " and sets parameters" } else { "" };
            log!("warning: other machines can reach this address; whoever does sees the pictures{also}");
        }
        self.server = Some(server);
        Ok(())
    }

    fn update(&mut self, live: &mut Live) {
        let lines = self.server.as_mut().map(|server| server.update(live)).unwrap_or_default();
        lines.iter().for_each(|line| log!("{line}"));
    }
}
