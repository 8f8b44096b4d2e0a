//! Other machines for tests: `panoscope serve` as a process, and a relay that disturbs the connection.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A running `panoscope serve`; killed when dropped.
pub struct Machine {
    child: Child,
    /// Lines of its log.
    log: Arc<Mutex<Vec<String>>>,
}

/// An unused port of this machine.
///
/// # Panics
/// There is none.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("an address").port()
}

impl Machine {
    /// Starts `panoscope serve --name NAME --listen ADDRESS` with more arguments, and waits until it listens. `before` is put in front of the
    /// program, for example to enter a network namespace or to set variables. `None` if there is no program.
    ///
    /// # Panics
    /// It does not listen within 20 s.
    pub fn start(before: &[&str], name: &str, address: &str, more: &[&str], graph_dir: &Path) -> Option<Self> {
        let program = program()?;
        let words: Vec<String> = before.iter().map(|word| (*word).to_owned()).collect();
        let mut all = words.into_iter().chain([program.display().to_string()]);
        let mut command = Command::new(all.next()?);
        command.args(all).args(["serve", "--name", name, "--listen", address, "--graph-dir"]).arg(graph_dir);
        command.args(more).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap_or_else(|error| panic!("{command:?}: {error}"));
        let log = Arc::new(Mutex::new(Vec::new()));
        let (listens, heard) = channel();
        let streams: [Option<Box<dyn Read + Send>>; 2] = [
            child.stdout.take().map(|stream| Box::new(stream) as Box<dyn Read + Send>),
            child.stderr.take().map(|stream| Box::new(stream) as Box<dyn Read + Send>),
        ];
        for stream in streams.into_iter().flatten() {
            let (log, listens) = (Arc::clone(&log), listens.clone());
            std::thread::spawn(move || {
                for line in BufReader::new(stream).lines().map_while(Result::ok) {
                    if line.contains("listens at") {
                        let _ = listens.send(());
                    }
                    log.lock().unwrap_or_else(PoisonError::into_inner).push(line);
                }
            });
        }
        drop(listens);
        let this = Self { child, log };
        let listens = heard.recv_timeout(Duration::from_secs(20));
        assert!(listens.is_ok(), "it does not listen: {:?}", this.log());
        Some(this)
    }

    /// The lines of its log so far.
    pub fn log(&self) -> Vec<String> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Kills it, like a crash of its machine.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let ended = self.child.try_wait();
            eprintln!("the machine ({ended:?}) wrote: {:#?}", self.log());
        }
        self.kill();
    }
}

/// The program `panoscope` that tests use.
pub fn program() -> Option<PathBuf> {
    let given = std::env::var_os("PANOSCOPE_BIN").map(PathBuf::from);
    let beside = || Some(std::env::current_exe().ok()?.parent()?.parent()?.join("panoscope"));
    given.or_else(beside).filter(|program| program.is_file())
}

/// A network namespace that is connected to this one by a pair of virtual Ethernet devices: another machine, for the network. Removed when dropped.
pub struct Namespace {
    name: String,
    device: String,
    /// Its address.
    pub address: String,
}

impl Namespace {
    /// Creates a namespace; `number`, 0 to 3, distinguishes it from others of this process. `None` if this user lacks the permission.
    pub fn new(number: u8) -> Option<Self> {
        remove_namespaces_of_ended_processes();
        let process = std::process::id();
        let (name, device) = (format!("panoscope-{process}-{number}"), format!("ps{}v{number}", process % 100_000));
        // A network for each process: tests of several checkouts may run at once.
        let network = format!("10.{}.{}", 128 + (process >> 6 & 0x7f), (process & 0x3f) << 2 | u32::from(number & 3));
        let (here, there) = (format!("{network}.1/24"), format!("{network}.2"));
        ip(&["netns", "add", &name]).then_some(())?;
        // From here on it is removed in any case.
        let this = Self { name: name.clone(), device: device.clone(), address: there.clone() };
        let made = ip(&["link", "add", &device, "type", "veth", "peer", "name", "eth0", "netns", &name])
            && ip(&["addr", "add", &here, "dev", &device])
            && ip(&["link", "set", &device, "up"])
            && ip(&["-n", &name, "addr", "add", &format!("{there}/24"), "dev", "eth0"])
            && ip(&["-n", &name, "link", "set", "eth0", "up"])
            && ip(&["-n", &name, "link", "set", "lo", "up"]);
        made.then_some(this)
    }

    /// Words in front of a program that run it in the namespace.
    pub fn words(&self) -> [&str; 4] {
        ["ip", "netns", "exec", &self.name]
    }

    /// Disconnects or connects the cable, at its far end: while the near end is up, nothing for that address takes another route.
    pub fn set_joined(&self, joined: bool) {
        ip(&["-n", &self.name, "link", "set", "eth0", if joined { "up" } else { "down" }]);
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        ip(&["netns", "del", &self.name]);
        ip(&["link", "del", &self.device]);
    }
}

/// Removes namespaces of killed tests. Their addresses would answer in place of those of a later test.
fn remove_namespaces_of_ended_processes() {
    for entry in std::fs::read_dir("/run/netns").into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let process = name.strip_prefix("panoscope-").and_then(|rest| rest.split_once('-')?.0.parse::<u32>().ok());
        if process.is_some_and(|process| !Path::new(&format!("/proc/{process}")).exists()) {
            // Its device goes with it.
            ip(&["netns", "del", &name]);
        }
    }
}

fn ip(words: &[&str]) -> bool {
    let mut command = Command::new("ip");
    command.args(words).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// How a relay disturbs the bytes that pass.
#[derive(Debug, Default)]
pub struct Weather {
    /// Minimum delay of each piece of data, us.
    pub delay_us: AtomicU64,
    /// Maximum additional delay, us.
    pub jitter_us: AtomicU64,
    /// One in this many pieces is lost and sent again, as TCP does: the following ones wait 200 ms; 0 for none.
    pub loses_one_of: AtomicU64,
    /// Nothing passes.
    pub is_parted: AtomicBool,
    /// Each increment closes all connections at once.
    pub resets: AtomicU64,
}

/// Time after which TCP sends a lost packet again.
const RESEND: Duration = Duration::from_millis(200);

/// Forwards connections to an address, and disturbs them.
pub struct Relay {
    /// Where it listens.
    pub address: SocketAddr,
    /// Its disturbances; they may change at any time.
    pub weather: Arc<Weather>,
    ends: Arc<AtomicBool>,
}

impl Relay {
    /// Listens at an unused port for connections to `target`. `seed` seeds its random numbers.
    ///
    /// # Panics
    /// There is no port.
    pub fn start(target: SocketAddr, seed: u64) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address");
        listener.set_nonblocking(true).expect("a socket");
        let (weather, ends) = (Arc::new(Weather::default()), Arc::new(AtomicBool::new(false)));
        let (mine, over) = (Arc::clone(&weather), Arc::clone(&ends));
        std::thread::spawn(move || {
            let mut seed = seed;
            while !over.load(Ordering::Relaxed) {
                // While nothing passes, no connection is made either.
                let accepted = if mine.is_parted.load(Ordering::Relaxed) { None } else { listener.accept().ok() };
                let Some((near, _)) = accepted else {
                    std::thread::sleep(Duration::from_millis(5));
                    continue;
                };
                let Ok(far) = TcpStream::connect_timeout(&target, Duration::from_millis(500)) else { continue };
                let _ = (near.set_nonblocking(false), near.set_nodelay(true), far.set_nodelay(true));
                for (from, to) in [(&near, &far), (&far, &near)] {
                    let (Ok(from), Ok(to)) = (from.try_clone(), to.try_clone()) else { continue };
                    seed = seed.wrapping_add(1);
                    carry(from, to, seed, &mine, &over);
                }
            }
        });
        Self { address, weather, ends }
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
    }
}

/// The next number of a generator (SplitMix64).
pub fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Forwards one direction of a connection: one thread reads, one writes after the delay.
fn carry(mut from: TcpStream, to: TcpStream, seed: u64, weather: &Arc<Weather>, ends: &Arc<AtomicBool>) {
    let (sender, pieces) = channel::<(Instant, Vec<u8>)>();
    let (mine, over, mut state) = (Arc::clone(weather), Arc::clone(ends), seed);
    let target = to.try_clone();
    std::thread::spawn(move || {
        let resets = mine.resets.load(Ordering::Relaxed);
        let _ = from.set_read_timeout(Some(Duration::from_millis(10)));
        let (mut buffer, mut last) = (vec![0; 64 << 10], Instant::now());
        loop {
            if over.load(Ordering::Relaxed) || mine.resets.load(Ordering::Relaxed) != resets {
                break;
            }
            if mine.is_parted.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(2));
                continue;
            }
            let len = match from.read(&mut buffer) {
                Ok(0) => break,
                Ok(len) => len,
                Err(error) if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {
                    continue;
                }
                Err(_) => break,
            };
            let load = |number: &AtomicU64| number.load(Ordering::Relaxed);
            let mut wait =
                Duration::from_micros(load(&mine.delay_us) + random(&mut state) % (load(&mine.jitter_us) + 1));
            let loses = load(&mine.loses_one_of);
            if loses > 0 && random(&mut state).is_multiple_of(loses) {
                wait += RESEND;
            }
            // Bytes arrive in order.
            last = last.max(Instant::now() + wait);
            if sender.send((last, buffer[..len].to_vec())).is_err() {
                break;
            }
        }
        let _ = from.shutdown(Shutdown::Both);
        let _ = target.map(|target| target.shutdown(Shutdown::Both));
    });
    let (mine, over) = (Arc::clone(weather), Arc::clone(ends));
    std::thread::spawn(move || deliver(to, &pieces, &mine, &over));
}

fn deliver(mut to: TcpStream, pieces: &Receiver<(Instant, Vec<u8>)>, weather: &Weather, ends: &AtomicBool) {
    while let Ok((at, bytes)) = pieces.recv() {
        std::thread::sleep(at.saturating_duration_since(Instant::now()));
        while weather.is_parted.load(Ordering::Relaxed) && !ends.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(2));
        }
        if to.write_all(&bytes).is_err() {
            break;
        }
    }
}
