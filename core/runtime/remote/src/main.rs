//! The program that links machines. Other programs start it, and users through `panoscope serve` and `panoscope keys`;
//! its arguments are internal.
//!
//! - `link ADDRESS PIXELS TIMEOUT_MS PLAINTEXT MACHINE`: see [`panoscope_remote::link`]
//! - `serve NAME ADDRESS KEYS GRAPH_DIR PLAINTEXT HOST...`: KEYS is empty where no folder of keys is given
//! - `keys FOLDER NAME[=ADDRESS,...]...`
//! - `attachable NAME ADDRESS KEYS PLAINTEXT HOST...`: see [`panoscope_remote::attachable`]; NAME and KEYS may be empty
//! - `attach ADDRESS TIMEOUT_MS PLAINTEXT NAME`: see [`panoscope_remote::attach`]
//! - `bench PORT BYTES COUNT`: zenoh alone; writes the seconds that it took

use std::ffi::OsString;
use std::num::ParseIntError;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use panoscope_engine::heap;
use panoscope_host::attach::tunnel::{ATTACH, ATTACHABLE};
use panoscope_host::isolate::LINK_COMMAND;
use panoscope_remote::error::RemoteError;
use panoscope_remote::keys::{Identity, KEYS_VARIABLE, Member, make};
use panoscope_remote::serve::{Options, Server};
use panoscope_remote::{attach, attachable, link, network, raw, refused};

/// Exit status for wrong arguments or keys.
const WRONG: u8 = 2;

static ENDS: AtomicBool = AtomicBool::new(false);

extern "C" fn end(_: libc::c_int) {
    ENDS.store(true, Ordering::Relaxed);
}

fn main() -> ExitCode {
    let words: Vec<OsString> = std::env::args_os().skip(1).collect();
    let Some((command, rest)) = words.split_first() else { return usage() };
    if rest.iter().any(|word| word.to_string_lossy().starts_with("tls/")) {
        // SAFETY: the program begins here; nothing has started a thread.
        unsafe { network::work_in_one_thread() };
    }
    heap::keep_large_blocks();
    if command == LINK_COMMAND {
        link::run(rest);
    }
    let Some(rest) = rest.iter().map(|word| word.to_str()).collect::<Option<Vec<&str>>>() else { return usage() };
    let done = match (command.to_str(), &rest[..]) {
        (Some("serve"), [name, address, keys, graph_dir, plaintext, hosts @ ..]) => {
            serve(name, address, keys, graph_dir, *plaintext == "true", hosts)
        }
        (Some(ATTACHABLE), [name, address, keys, plaintext, hosts @ ..]) => identity(keys, address.starts_with("tls/"))
            .and_then(|identity| attachable::run(name, address, identity, *plaintext == "true", hosts)),
        (Some(ATTACH), [address, timeout_ms, plaintext, name]) => {
            attach::run(address, timeout_ms, *plaintext == "true", name)
        }
        (Some("keys"), [folder, members @ ..]) if !members.is_empty() => make_keys(Path::new(folder), members),
        (Some("bench"), [port, bytes, count]) => bench(port, bytes, count),
        _ => return usage(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(WRONG)
        }
    }
}

fn usage() -> ExitCode {
    eprintln!(
        "error: other programs of Panoscope start this one; see `panoscope serve --help` and `panoscope keys --help`"
    );
    ExitCode::from(WRONG)
}

/// The keys of this machine, if they are needed.
fn identity(keys: &str, is_tls: bool) -> Result<Option<Identity>, RemoteError> {
    let folder = if keys.is_empty() { Identity::folder() } else { Some(PathBuf::from(keys)) };
    let unreadable = |cause| RemoteError::UnreadableKeys { cause, remedy: "`panoscope keys` makes keys" };
    let read = |folder: PathBuf| Identity::read(&folder).map_err(unreadable);
    folder.filter(|_| is_tls).map(read).transpose()
}

/// Serves until a signal ends it.
fn serve(
    name: &str,
    address: &str,
    keys: &str,
    graph_dir: &str,
    plaintext: bool,
    hosts: &[&str],
) -> Result<(), RemoteError> {
    let is_tls = address.starts_with("tls/");
    let identity = identity(keys, is_tls)?;
    if is_tls && hosts.is_empty() {
        return Err(RemoteError::NoHosts);
    }
    if plaintext && !is_tls {
        eprintln!("warning: whoever reaches {address} can run nodes here and see their pictures");
    }
    for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP] {
        let handler: extern "C" fn(libc::c_int) = end;
        // SAFETY: the handler only stores to an atomic.
        unsafe { libc::signal(signal, handler as *const () as libc::sighandler_t) };
    }
    let options = Options {
        name: name.to_owned(),
        address: address.to_owned(),
        plaintext,
        identity,
        hosts: hosts.iter().map(|host| (*host).to_owned()).collect(),
        graph_dir: std::path::absolute(graph_dir)
            .map_err(|cause| RemoteError::Path { path: graph_dir.to_owned(), cause })?,
        plugins: Vec::new(),
    };
    refused::log(|line| eprintln!("{line}"));
    let server = Server::start(options, Box::new(|words: &str| eprintln!("{words}")))?;
    println!("`{name}` listens at {address}");
    while !ENDS.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(50));
    }
    drop(server);
    Ok(())
}

fn make_keys(folder: &Path, members: &[&str]) -> Result<(), RemoteError> {
    let members = members.iter().map(|text| Member::parse(text)).collect::<Result<Vec<_>, _>>()?;
    let made = make(folder, &members)?;
    made.iter().for_each(|folder| println!("{}", folder.display()));
    println!("copy each folder to its machine, and name it there with --keys or {KEYS_VARIABLE};");
    println!("{} makes more keys: it stays here", folder.join("authority-key.pem").display());
    Ok(())
}

fn number<N: FromStr<Err = ParseIntError>>(text: &str) -> Result<N, RemoteError> {
    text.parse().map_err(|cause| RemoteError::NotANumber { text: text.to_owned(), cause })
}

fn bench(port: &str, bytes: &str, count: &str) -> Result<(), RemoteError> {
    let taken = raw::publish(number(port)?, number(bytes)?, number(count)?)?;
    println!("{}", taken.as_secs_f64());
    Ok(())
}
