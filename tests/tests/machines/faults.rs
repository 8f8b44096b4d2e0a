//! Machines and networks that fail while a graph runs.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use panoscope_engine::Options;
use panoscope_engine::fault::Fault;
use panoscope_tests::machines::{Machine, Relay, random};
use panoscope_tests::{run_disturbed, scratch};

use super::{FILTERS, ONE, PATIENCE, PATIENT, at_home, machine, options, plain_machine};

#[test]
fn a_lost_machine_disturbs_no_other_node_and_comes_back() {
    let folder = scratch("machines-lost");
    let Some((rack, port)) = plain_machine(&folder) else { return };
    let address = format!("tcp/127.0.0.1:{port}");
    let text = ONE.to_owned() + &machine(&address, PATIENT);
    let mut rack = Some(rack);
    let (mut lost_at, mut at_return) = (None, None);
    let end = Instant::now() + PATIENCE;
    let run = run_disturbed(&folder, &text, Options::default(), |engine| {
        let count = |node: &str| engine.report().nodes[node].count;
        if lost_at.is_none() && count("end_far") >= 10 {
            // The whole machine goes.
            rack = None;
            lost_at = Some(count("end"));
        } else if rack.is_none() && lost_at.is_some_and(|lost_at| count("end") > lost_at + 60) {
            rack = Machine::start(&[], "rack", &address, &[], &folder);
            at_return = Some(count("end_far"));
        }
        let is_back = at_return.is_some_and(|before| count("end_far") > before + 10);
        if is_back || Instant::now() > end {
            engine.stop();
        }
    });
    assert!(at_return.is_some() && Instant::now() < end, "it came back: {:?}", run.faults);
    assert!(run.faults.iter().all(|fault| fault.node == "far"), "{:?}", run.faults);
    assert!(run.faults.iter().any(|fault| fault.words.contains("machine `rack` is lost")), "{:?}", run.faults);
    let seqs: Vec<u64> = run.packets["scope.right"].keys().copied().collect();
    assert!(seqs.windows(2).all(|pair| pair[1] == pair[0] + 1), "no picture of the main branch is lost: {seqs:?}");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn what_accepts_and_closes_is_one_fault_for_each_attempt() {
    let folder = scratch("machines-closes");
    let Some((rack, port)) = plain_machine(&folder) else { return };
    const TIMEOUT_MS: f64 = 1000.0;
    let text = ONE.to_owned() + &machine(&format!("tcp/127.0.0.1:{port}"), "timeout_ms = 1000");
    let refused = |fault: &&Fault| fault.words.contains("refuses the connection");
    let (mut rack, end) = (Some(rack), Instant::now() + PATIENCE);
    let run = run_disturbed(&folder, &text, Options::default(), |engine| {
        if rack.is_some() && engine.report().nodes["end_far"].count >= 5 {
            // Something else listens in its place.
            rack = None;
            let listener = std::net::TcpListener::bind(("127.0.0.1", port)).expect("the port is free again");
            std::thread::spawn(move || listener.incoming().for_each(drop));
        }
        if engine.recent_faults().iter().filter(refused).count() >= 4 || Instant::now() > end {
            engine.stop();
        }
    });
    let faults: Vec<&Fault> = run.faults.iter().filter(refused).collect();
    assert!(faults.len() >= 4, "{:?}", run.faults);
    assert!(run.faults.iter().all(|fault| !fault.words.contains(".rs:")), "{:?}", run.faults);
    let pauses_ms: Vec<f64> = faults.windows(2).map(|pair| pair[1].run_ms - pair[0].run_ms).collect();
    assert!(pauses_ms.iter().all(|ms| *ms > 0.7 * TIMEOUT_MS), "{pauses_ms:?}");
    let _ = std::fs::remove_dir_all(&folder);
}

/// Faults of the network at random moments: each frame that arrives is correct, and every node works again in the end.
///
/// `PANOSCOPE_NETWORK_FAULTS` is their number, `PANOSCOPE_NETWORK_SEED` selects others.
#[test]
fn no_fault_of_the_network_makes_a_wrong_picture() {
    let number =
        |name: &str, otherwise: u64| std::env::var(name).ok().and_then(|n| n.parse().ok()).unwrap_or(otherwise);
    let (faults, seed) = (number("PANOSCOPE_NETWORK_FAULTS", 6), number("PANOSCOPE_NETWORK_SEED", 1));
    const FRAMES: u64 = 60;
    const AT_ONCE: u64 = 6;
    let folder = scratch("machines-campaign");
    let Some((_rack, port)) = plain_machine(&folder) else { return };
    let home = run_disturbed(&folder, &at_home(FILTERS), options(FRAMES), |_| ());
    let (mut made, mut state, mut delivered, mut lost) = (0, seed, 0, 0);
    while made < faults {
        let relay = Relay::start(([127, 0, 0, 1], port).into(), state);
        let pixels = if random(&mut state).is_multiple_of(2) { "raw" } else { "lz4" };
        let more = format!("pixels = \"{pixels}\"\ntimeout_ms = 300");
        let text = FILTERS.to_owned() + &machine(&format!("tcp/{}", relay.address), &more);
        let case = format!("seed {seed}, after {made} faults");
        let begin = made;
        let mut next = Instant::now() + Duration::from_millis(random(&mut state) % 200);
        let run = run_disturbed(&folder, &text, options(FRAMES), |_| {
            if Instant::now() < next || made >= faults || made >= begin + AT_ONCE {
                return;
            }
            made += 1;
            let weather = &relay.weather;
            match random(&mut state) % 5 {
                0 | 1 => _ = weather.resets.fetch_add(1, Ordering::Relaxed),
                2 => {
                    // Longer than the time after which a machine counts as lost, or shorter.
                    weather.is_parted.store(true, Ordering::Relaxed);
                    std::thread::sleep(Duration::from_millis(random(&mut state) % 600));
                    weather.is_parted.store(false, Ordering::Relaxed);
                }
                3 => weather.loses_one_of.store(50 + random(&mut state) % 100, Ordering::Relaxed),
                _ => {
                    weather.delay_us.store(random(&mut state) % 3_000, Ordering::Relaxed);
                    weather.jitter_us.store(random(&mut state) % 4_000, Ordering::Relaxed);
                }
            }
            next = Instant::now() + Duration::from_millis(random(&mut state) % 150);
        });
        for (port, packets) in &run.packets {
            // A source that fails loses no picture but a tick: it goes on with the picture after the last one that arrived.
            let is_source = port.starts_with("far.");
            // It says how old a picture is; where that is lost, it says so.
            let says_what_is_lost = |seq: &u64| port == "old.table" && !run.packets["here.image"].contains_key(seq);
            let right = |hash: &u64| home.packets[port].values().any(|known| known == hash);
            for (seq, hash) in packets {
                if is_source {
                    assert!(right(hash), "{case}: packet {seq} of {port}");
                    continue;
                }
                if !says_what_is_lost(seq) {
                    assert_eq!(home.packets[port].get(seq), Some(hash), "{case}: packet {seq} of {port}");
                }
            }
            delivered += packets.len();
            lost += home.packets[port].len() - packets.len();
        }
        for port in ["scope.left", "scope.right"] {
            assert_eq!(run.packets[port], home.packets[port], "{case}: nothing of the nodes here is lost");
        }
        let there = ["passes", "rectify", "marks", "old", "far"];
        assert!(run.faults.iter().all(|fault| there.contains(&fault.node.as_str())), "{case}: {:?}", run.faults);
    }
    println!("{made} faults of the network: {delivered} packets delivered, none wrong, {lost} lost with their ticks");
    assert!(delivered > 0);
    let _ = std::fs::remove_dir_all(&folder);
}
