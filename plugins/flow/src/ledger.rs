//! `ledger`: writes down which tick each of its inputs held.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;

use panoscope_node::{AnyImage, Context, List, NoPorts, Node, NodeInfo, Open, Params, Ports, Result, error};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Anything whose alignment is to be seen; entries may be empty.
    images: List<'f, AnyImage<'f>>,
}

/// Where to write.
#[derive(Params)]
pub struct Place {
    /// File for one JSON line per tick: `{"seq", "capture_ns", "inputs": [seq or null, ...]}`.
    #[param(default = "ledger.jsonl", reopen, writes)]
    path: PathBuf,
}

/// Writes one line per tick: its number, and the number of the tick that each input holds.
pub struct Ledger(BufWriter<File>);

impl Node for Ledger {
    const INFO: NodeInfo =
        NodeInfo::blocking("ledger", "sink", "Writes which tick each input held, a JSON line per tick.").side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Place;

    fn open(_: &Open<'_>, params: &Place) -> Result<Self> {
        if let Some(folder) = params.path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let file = File::create(&params.path).map_err(|e| error!("{}: {e}", params.path.display()))?;
        Ok(Self(BufWriter::new(file)))
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, _: &Place) -> Result<()> {
        let tick = cx.tick();
        write!(self.0, "{{\"seq\":{},\"capture_ns\":{},\"inputs\":[", tick.seq, tick.capture_ns)?;
        for (index, image) in input.images.iter().enumerate() {
            let comma = if index == 0 { "" } else { "," };
            match image {
                Some(image) => write!(self.0, "{comma}{}", image.frame().tick.seq)?,
                None => write!(self.0, "{comma}null")?,
            }
        }
        writeln!(self.0, "]}}")?;
        Ok(())
    }
}
