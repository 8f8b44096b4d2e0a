//! Runs cases of the simulator: `panoscope-sim SEED`, or `panoscope-sim FROM..TO` (exclusive).

use std::process::ExitCode;
use std::time::Instant;

use panoscope_sim::case::Case;
use panoscope_sim::check::check;
use panoscope_sim::drive::play;
use panoscope_sim::world::mutate;

const USAGE: &str =
    "usage: panoscope-sim SEED | FROM..TO [--trace] [--describe] [--hash] [--mutation NAME] [--until-found]
  --trace          prints everything that happened, in order
  --describe       prints the case
  --hash           prints the hash of the trace of each seed
  --mutation NAME  with a mistake in the engine, see tests/sim/engine/mutations.rs
  --until-found    ends with the first seed that fails";

#[derive(Default)]
struct Request {
    seeds: std::ops::Range<u64>,
    trace: bool,
    describe: bool,
    hash: bool,
    mutation: Option<String>,
    until_found: bool,
}

fn request() -> Option<Request> {
    let mut request = Request::default();
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--trace" => request.trace = true,
            "--describe" => request.describe = true,
            "--hash" => request.hash = true,
            "--until-found" => request.until_found = true,
            "--mutation" => request.mutation = Some(args.next()?),
            seeds => {
                let (from, to) = match seeds.split_once("..") {
                    Some((from, to)) => (from.parse().ok()?, to.parse().ok()?),
                    None => (seeds.parse().ok()?, seeds.parse::<u64>().ok()?.checked_add(1)?),
                };
                request.seeds = from..to;
            }
        }
    }
    let known = |name: &String| panoscope_sim::engine::mutations().contains(&name.as_str());
    let valid = !request.seeds.is_empty() && request.mutation.as_ref().is_none_or(known);
    valid.then_some(request)
}

fn main() -> ExitCode {
    let Some(request) = request() else {
        eprintln!("{USAGE}\nmutations: {}", panoscope_sim::engine::mutations().join(", "));
        return ExitCode::from(2);
    };
    mutate(request.mutation.as_deref());
    let (begin, mut cases, mut failed) = (Instant::now(), 0u64, 0u64);
    let (mut simulated_ns, mut decisions, mut threads, mut faults, mut made, mut refused) = (0u64, 0, 0, 0, 0, 0);
    for seed in request.seeds.clone() {
        let case = Case::new(seed);
        if request.describe {
            println!("{}", case.describe());
        }
        let done = play(case, request.trace);
        cases += 1;
        simulated_ns += done.ended.simulated_ns;
        decisions += done.ended.decisions;
        threads += done.ended.threads;
        if let Ok(ran) = &done.ended.result {
            faults += ran.faults.len();
            made += ran.edits.0;
            refused += ran.edits.1;
        }
        done.ended.trace.iter().for_each(|line| println!("{line}"));
        if request.hash {
            println!("seed {seed} trace {:016x} decisions {}", done.ended.trace_hash, done.ended.decisions);
        }
        let failures = check(&done);
        if failures.is_empty() {
            continue;
        }
        failed += 1;
        let mutation = request.mutation.as_ref().map(|name| format!(" --mutation {name}")).unwrap_or_default();
        println!("FAILED seed {seed}; repeat it: cargo run -p panoscope-sim -- {seed} --describe --trace{mutation}");
        failures.iter().for_each(|failure| println!("  {failure}"));
        if request.until_found {
            break;
        }
    }
    let seconds = begin.elapsed().as_secs_f64();
    println!(
        "{cases} cases, {failed} failed; {:.0} s simulated in {seconds:.1} s, {decisions} decisions, {threads} threads, {faults} faults, \
         {made} edits made, {refused} refused",
        simulated_ns as f64 / 1e9
    );
    if failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
