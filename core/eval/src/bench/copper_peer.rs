// Chains of copper tasks that pass a packet by copy. `copper_peer LENGTH TICKS` prints the time of one tick, ns.

use bincode::{Decode, Encode};
use cu29::prelude::*;
use serde::{Deserialize, Serialize};

/// As large as the description of a frame that a hop of Panoscope passes.
#[derive(Clone, Debug, Default, Encode, Decode, Serialize, Deserialize, Reflect)]
pub struct Packet {
    words: [u64; 10],
}

#[derive(Reflect)]
pub struct Source {
    seq: u64,
}

impl Freezable for Source {}

impl CuSrcTask for Source {
    type Resources<'r> = ();
    type Output<'m> = output_msg!(Packet);

    fn new(_: Option<&ComponentConfig>, _: Self::Resources<'_>) -> CuResult<Self> {
        Ok(Self { seq: 0 })
    }

    fn process(&mut self, _: &CuContext, output: &mut Self::Output<'_>) -> CuResult<()> {
        self.seq += 1;
        output.set_payload(Packet { words: [self.seq; 10] });
        Ok(())
    }
}

#[derive(Reflect)]
pub struct Pass;

impl Freezable for Pass {}

impl CuTask for Pass {
    type Resources<'r> = ();
    type Input<'m> = input_msg!(Packet);
    type Output<'m> = output_msg!(Packet);

    fn new(_: Option<&ComponentConfig>, _: Self::Resources<'_>) -> CuResult<Self> {
        Ok(Self)
    }

    fn process(&mut self, _: &CuContext, input: &Self::Input<'_>, output: &mut Self::Output<'_>) -> CuResult<()> {
        if let Some(packet) = input.payload() {
            output.set_payload(packet.clone());
        }
        Ok(())
    }
}

#[derive(Reflect)]
pub struct Sink {
    last: u64,
}

impl Freezable for Sink {}

impl CuSinkTask for Sink {
    type Resources<'r> = ();
    type Input<'m> = input_msg!(Packet);

    fn new(_: Option<&ComponentConfig>, _: Self::Resources<'_>) -> CuResult<Self> {
        Ok(Self { last: 0 })
    }

    fn process(&mut self, _: &CuContext, input: &Self::Input<'_>) -> CuResult<()> {
        let packet = input.payload().ok_or_else(|| CuError::from("a tick reached the sink without its packet"))?;
        if packet.words != [self.last + 1; 10] {
            return Err(CuError::from("a packet was lost or changed"));
        }
        self.last += 1;
        Ok(())
    }
}

macro_rules! chain {
    ($name:ident, $config:literal) => {
        mod $name {
            use super::{Packet, Pass, Sink, Source};
            use cu29::prelude::*;

            #[copper_runtime(config = $config)]
            struct Chain {}

            pub fn ns_per_tick(log: &std::path::Path, ticks: u64) -> CuResult<f64> {
                let mut chain = Chain::builder().with_log_path(log, Some(1 << 20))?.build()?.start()?;
                for _ in 0..ticks / 10 {
                    chain.run_one_iteration()?;
                }
                let start = std::time::Instant::now();
                for _ in 0..ticks {
                    chain.run_one_iteration()?;
                }
                let ns = start.elapsed().as_nanos() as f64 / ticks as f64;
                chain.stop()?;
                Ok(ns)
            }
        }
    };
}

// CHAINS

fn main() -> CuResult<()> {
    let mut arguments = std::env::args().skip(1);
    let mut number = || arguments.next().and_then(|text| text.parse::<u64>().ok()).ok_or("give LENGTH and TICKS");
    let (length, ticks) = (number()?, number()?);
    // The runtime opens a log even without logging; each process has its own.
    let folder = std::env::temp_dir().join(format!("copper_peer_{}", std::process::id()));
    std::fs::create_dir_all(&folder).map_err(|error| CuError::new_with_cause("cannot make a folder for the log", error))?;
    let log = folder.join("log.copper");
    let ns = match length {
        // LENGTHS
        _ => Err(CuError::from("no chain has this length")),
    };
    // Only a folder in the temporary folder would stay.
    let _ = std::fs::remove_dir_all(&folder);
    println!("{:.1}", ns?);
    Ok(())
}
