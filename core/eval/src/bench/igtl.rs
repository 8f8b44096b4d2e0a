//! OpenIGTLink: delay of a message forwarded by a graph, compared with the OpenIGTLink library and pyigtl.
//!
//! A graph of `igtl_receive` and `igtl_send` runs in a separate process. This process sends it transforms at 1,000 Hz,
//! then images, over loopback and measures the time until each returns: two transfers, two nodes and the engine
//! between them. The program on the library does the same without an engine.

use std::collections::BTreeMap;
use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use panoscope_igtl::message::{Image, Scalar, Transform};
use panoscope_igtl::{Content, Message, Reader, Timestamp};

use crate::error::{EvalError, FileAction, OnFile, Result};
use crate::figures::Figure;
use crate::inputs::Folder;
use crate::session::{Session, note};
use crate::statistics::percentile;

/// Options of [`measure`].
#[derive(Clone, Debug)]
pub struct Options {
    /// The `panoscope` program, which runs the graph.
    pub program: PathBuf,
    /// Shorter runs: a quick check, not a measurement.
    pub quick: bool,
}

const LIBRARY_PEER: &str = include_str!("igtl_peer.cpp");
const PYIGTL_PEER: &str = include_str!("igtl_peer.py");
const TRANSFORM_HZ: f64 = 1000.0;
const IMAGE_HZ: f64 = 60.0;
const SIZE_PX: (usize, usize) = (640, 480);
/// Images in flight when they are sent as fast as they return.
const IN_FLIGHT: u64 = 2;
/// Maximum wait for a program's answer.
const PATIENCE: Duration = Duration::from_secs(20);
const DEVICE: &str = "ToolToTracker";

/// A program that ends with the bench.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn free_port() -> Result<u16> {
    Ok(TcpListener::bind("127.0.0.1:0")?.local_addr()?.port())
}

fn connect(port: u16) -> Result<TcpStream> {
    let end = Instant::now() + PATIENCE;
    loop {
        match TcpStream::connect(("127.0.0.1", port)) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(PATIENCE))?;
                return Ok(stream);
            }
            Err(error) if Instant::now() > end => {
                return Err(EvalError::Peer { reason: format!("no program responds on port {port}: {error}") });
            }
            Err(_) => std::thread::sleep(Duration::from_millis(20)),
        }
    }
}

fn start(command: &mut Command) -> Result<Running> {
    let program = PathBuf::from(command.get_program());
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    Ok(Running(command.spawn().on_file(FileAction::Start, &program)?))
}

/// A graph that forwards its input.
fn graph(options: &Options, folder: &Path, port: u16) -> Result<Running> {
    let text = format!(
        "mode = \"live\"\nplugins = [\"openigtlink\"]\n\
         [nodes.receive]\ntype = \"igtl_receive\"\nparams = {{ port = {port} }}\n\
         [nodes.send]\ntype = \"igtl_send\"\ninputs = {{ pose = \"receive.pose\", image = \"receive.image\" }}\nparams = {{ port = {port} }}\n"
    );
    let file = folder.join("igtl.toml");
    std::fs::write(&file, text).on_file(FileAction::Write, &file)?;
    start(Command::new(&options.program).arg("run").arg(&file).arg("--headless"))
}

/// Builds the program on the library; `None` if the library or a compiler is missing.
fn library_program(folder: &Path) -> Result<Option<PathBuf>> {
    let (source, program) = (folder.join("igtl_peer.cpp"), folder.join("igtl_peer"));
    std::fs::write(&source, LIBRARY_PEER).on_file(FileAction::Write, &source)?;
    let mut build = Command::new("c++");
    build.args(["-O2", "-w", "-I/usr/include/openigtlink", "-o"]).arg(&program).arg(&source).arg("-lOpenIGTLink");
    let built = build.output().is_ok_and(|output| output.status.success());
    Ok(built.then_some(program))
}

fn transform(number: u64) -> Content<'static> {
    Content::Transform(Transform { translation_mm: [number as f32, 0.0, 0.0], ..Transform::default() })
}

/// The number of a message.
fn number_of(content: &Content<'_>) -> Option<u64> {
    match content {
        Content::Transform(transform) => Some(transform.translation_mm[0] as u64),
        Content::Image(image) => Some(u64::from_le_bytes(*image.pixels.first_chunk::<8>()?)),
        _ => None,
    }
}

/// An image whose first bytes are its number. Red and blue are swapped on the way through a graph and back.
fn picture(number: u64, pixels: &mut [u8]) -> Result<Content<'_>> {
    pixels[..8].copy_from_slice(&number.to_le_bytes());
    let image = Image::picture(SIZE_PX.0, SIZE_PX.1, 3, Scalar::Uint8, 1.0, pixels);
    Ok(Content::Image(image.map_err(|error| EvalError::Input { reason: error.to_string() })?))
}

/// Result of a program.
struct Outcome {
    /// Round-trip times, ms.
    times_ms: Vec<f64>,
    sent: u64,
    /// Returned messages per second.
    rate_hz: f64,
}

/// Sends for `seconds` at `rate_hz`, or as fast as messages return, and measures their times.
fn echo(port: u16, is_picture: bool, rate_hz: Option<f64>, seconds: f64) -> Result<Outcome> {
    let stream = connect(port)?;
    let mut sending = stream.try_clone()?;
    let (came_back, is_over) = (AtomicU64::new(0), AtomicBool::new(false));
    let (sent, received) = std::thread::scope(|scope| {
        let reading = scope.spawn(|| {
            let (mut stream, mut reader, mut received) = (&stream, Reader::default(), Vec::new());
            loop {
                while let Ok(Some(raw)) = reader.next_message() {
                    let now = Instant::now();
                    if let Some(number) = raw.message().ok().and_then(|message| number_of(&message.content)) {
                        received.push((number, now));
                        came_back.store(received.len() as u64, Ordering::Release);
                    }
                }
                match reader.fill(&mut stream) {
                    Ok(0) | Err(_) => {
                        is_over.store(true, Ordering::Release);
                        return received;
                    }
                    Ok(_) => {}
                }
            }
        });
        let sent = send(&mut sending, is_picture, rate_hz, seconds, &came_back, &is_over);
        // What is under way still counts.
        std::thread::sleep(Duration::from_millis(300));
        // It may be closed already.
        let _ = stream.shutdown(std::net::Shutdown::Both);
        (sent, reading.join().unwrap_or_default())
    });
    let sent: BTreeMap<u64, Instant> = sent?.into_iter().collect();
    let time_ms = |(number, at): &(u64, Instant)| {
        sent.get(number).map(|begun| at.saturating_duration_since(*begun).as_secs_f64() * 1e3)
    };
    // The first ones meet programs that have just started.
    let times_ms: Vec<f64> = received.iter().filter(|(number, _)| *number > 20).filter_map(time_ms).collect();
    let span = received.first().zip(received.last()).map(|(first, last)| last.1.duration_since(first.1).as_secs_f64());
    let rate_hz = span.filter(|s| *s > 0.0).map_or(0.0, |s| (received.len() - 1) as f64 / s);
    Ok(Outcome { times_ms, sent: sent.len() as u64, rate_hz })
}

fn send(
    stream: &mut TcpStream,
    is_picture: bool,
    rate_hz: Option<f64>,
    seconds: f64,
    came_back: &AtomicU64,
    is_over: &AtomicBool,
) -> Result<Vec<(u64, Instant)>> {
    let (mut pixels, mut bytes, mut sent) = (vec![128; SIZE_PX.0 * SIZE_PX.1 * 3], Vec::new(), Vec::new());
    let begin = Instant::now();
    let mut number = 0;
    while begin.elapsed().as_secs_f64() < seconds {
        number += 1;
        match rate_hz {
            Some(rate_hz) => {
                let due = begin + Duration::from_secs_f64(number as f64 / rate_hz);
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
            }
            None => {
                let waits = Instant::now();
                while number > came_back.load(Ordering::Acquire) + IN_FLIGHT && waits.elapsed() < PATIENCE {
                    std::thread::sleep(Duration::from_micros(50));
                }
            }
        }
        if is_over.load(Ordering::Acquire) {
            return Err(EvalError::Peer { reason: "the peer closed the connection".to_owned() });
        }
        let content = if is_picture { picture(number, &mut pixels)? } else { transform(number) };
        bytes.clear();
        let time = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_nanos() as i128);
        let message = Message::new(DEVICE, Timestamp::from_unix_ns(time), content);
        message.encode(&mut bytes).map_err(|error| EvalError::Input { reason: error.to_string() })?;
        let begun = Instant::now();
        stream.write_all(&bytes)?;
        sent.push((number, begun));
    }
    Ok(sent)
}

/// Times of pyigtl's transforms from their timestamps to their arrival here, one way, ms; `None` if pyigtl is not
/// installed.
fn pyigtl_ms(folder: &Path, seconds: f64) -> Result<Option<Vec<f64>>> {
    if !Command::new("python3").args(["-c", "import pyigtl"]).output().is_ok_and(|output| output.status.success()) {
        return Ok(None);
    }
    let (file, port) = (folder.join("igtl_peer.py"), free_port()?);
    std::fs::write(&file, PYIGTL_PEER).on_file(FileAction::Write, &file)?;
    let _program = start(Command::new("python3").arg(&file).args([port.to_string(), TRANSFORM_HZ.to_string()]))?;
    let (mut stream, mut reader, mut times_ms) = (connect(port)?, Reader::default(), Vec::new());
    let begin = Instant::now();
    while begin.elapsed().as_secs_f64() < seconds && reader.fill(&mut stream)? > 0 {
        while let Ok(Some(raw)) = reader.next_message() {
            let now_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_nanos() as i128);
            times_ms.push((now_ns - raw.header.time.unix_ns()) as f64 * 1e-6);
        }
    }
    Ok(Some(times_ms))
}

/// Measures: transforms at 1,000 Hz, images of 640x480 at 60 Hz and as fast as they come back.
///
/// # Errors
/// The graph does not run, or a connection breaks.
pub fn measure(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let seconds = if options.quick { 3.0 } else { 10.0 };
    let rounds = if options.quick { 1 } else { 3 };
    let folder = Folder::new("panoscope-bench-igtl")?;
    let library = library_program(folder.path())?;
    if library.is_none() {
        note!(session, "skipped: the OpenIGTLink library beside it: no libopenigtlink-dev or no c++");
    }
    let cases = [("transform", false, Some(TRANSFORM_HZ)), ("image", true, Some(IMAGE_HZ)), ("image_fast", true, None)];
    let mut figures = Vec::new();
    for (name, is_picture, rate_hz) in cases {
        let (mut own, mut theirs) = (Vec::new(), Vec::new());
        for _ in 0..rounds {
            if session.is_cancelled() {
                return Err(EvalError::Cancelled);
            }
            let port = free_port()?;
            let program = graph(options, folder.path(), port)?;
            own.push(echo(port, is_picture, rate_hz, seconds)?);
            drop(program);
            if let Some(library) = &library {
                let port = free_port()?;
                let program = start(Command::new(library).arg(port.to_string()))?;
                theirs.push(echo(port, is_picture, rate_hz, seconds)?);
                drop(program);
            }
        }
        figures.extend(case(name, is_picture, rate_hz, &own, &theirs));
    }
    match pyigtl_ms(folder.path(), seconds)? {
        Some(times_ms) => {
            let input = "transforms of a pyigtl server at 1,000 Hz to this program, one way";
            for (name, share) in [("p50", 0.5), ("p99", 0.99)] {
                let value = percentile(&times_ms, share);
                figures.push(Figure::new(&format!("igtl_pyigtl/{name}"), value, "ms", input));
            }
        }
        None => note!(session, "skipped: pyigtl beside it: no python3 with pyigtl"),
    }
    Ok(figures)
}

/// The figures of a case: the best of several rounds, because other load only adds time.
fn case(name: &str, is_picture: bool, rate_hz: Option<f64>, own: &[Outcome], theirs: &[Outcome]) -> Vec<Figure> {
    let what = if is_picture { "640x480 RGB" } else { "TRANSFORM" };
    let pace = rate_hz.map_or("as fast as they come back".to_owned(), |rate_hz| format!("at {rate_hz:.0} Hz"));
    let input = format!("{what} {pace}, to a graph and back over loopback");
    let best = |all: &[Outcome], share| {
        all.iter()
            .map(|outcome| percentile(&outcome.times_ms, share))
            .filter(|ms| ms.is_finite())
            .min_by(f64::total_cmp)
    };
    let mut figures = Vec::new();
    for (share_name, share) in [("p50", 0.5), ("p99", 0.99)] {
        let figure =
            Figure::new(&format!("igtl_{name}/{share_name}"), best(own, share).unwrap_or(f64::NAN), "ms", &input);
        figures.push(figure.beside("OpenIGTLink library, echo", best(theirs, share)));
    }
    if rate_hz.is_some() {
        let lost: u64 = own.iter().map(|outcome| outcome.sent.saturating_sub(20 + outcome.times_ms.len() as u64)).sum();
        let sent: u64 = own.iter().map(|outcome| outcome.sent).sum();
        let share = 100.0 * lost as f64 / sent.max(1) as f64;
        figures.push(Figure::new(&format!("igtl_{name}/lost"), share, "%", &input));
    } else {
        let rate = |all: &[Outcome]| all.iter().map(|outcome| outcome.rate_hz).max_by(f64::total_cmp);
        let mut figure = Figure::new(&format!("igtl_{name}/rate"), rate(own).unwrap_or(f64::NAN), "Hz", &input);
        if let Some(peer) = rate(theirs) {
            figure.peer = Some("OpenIGTLink library, echo".to_owned());
            figure.peer_value = Some(peer);
            figure.ratio = (peer > 0.0).then(|| figure.value / peer);
        }
        figures.push(figure);
    }
    figures
}
