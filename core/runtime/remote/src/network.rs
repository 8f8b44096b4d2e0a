//! The use of zenoh at both ends: one address, no discovery, one set of keys per host.

use std::net::ToSocketAddrs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use zenoh::matching::{MatchingListener, MatchingStatus};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Sample;
use zenoh::{Config, Session, Wait};

use crate::keys::Identity;

/// Name of a host that has no certificate.
pub const UNNAMED: &str = "unnamed";

/// A session that could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// A malformed address.
    #[error("`{0}` is not an address; write tls/HOST:PORT, or tcp/HOST:PORT inside one machine")]
    BadAddress(String),
    /// An unencrypted address of another machine.
    #[error(
        "`{0}` would connect to another machine without encryption: {remedy}",
        remedy = "use tls/ and keys of `panoscope keys`"
    )]
    Plaintext(String),
    /// TLS without certificates.
    #[error("`{0}` needs keys: make them with `panoscope keys`, and name their folder with --keys or PANOSCOPE_KEYS")]
    NoKeys(String),
    /// An error of zenoh.
    #[error("{0}")]
    Zenoh(String),
}

/// An address as written in a graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// As it was given.
    pub text: String,
    /// Whether it is encrypted.
    pub is_tls: bool,
}

impl Address {
    /// Reads an address. An unencrypted address must be on this machine, unless `plaintext` is set.
    pub fn parse(text: &str, plaintext: bool) -> Result<Self, NetworkError> {
        let bad = || NetworkError::BadAddress(text.to_owned());
        let (protocol, host) = text.split_once('/').ok_or_else(bad)?;
        let is_tls = match protocol {
            "tls" => true,
            "tcp" => false,
            _ => return Err(bad()),
        };
        if host.contains(['#', '?', '/']) || !host.contains(':') {
            return Err(bad());
        }
        let this = Self { text: text.to_owned(), is_tls };
        if !is_tls && !plaintext && !is_loopback(host) { Err(NetworkError::Plaintext(this.text)) } else { Ok(this) }
    }
}

/// Whether all addresses of a host and port are on this machine.
fn is_loopback(host: &str) -> bool {
    match host.to_socket_addrs() {
        Ok(addresses) => {
            let addresses: Vec<_> = addresses.collect();
            !addresses.is_empty() && addresses.iter().all(|address| address.ip().is_loopback())
        }
        Err(_) => false,
    }
}

/// Lets one thread do all of zenoh's work: it reads and writes a TLS connection from two threads at once, which rustls
/// does not allow and which damages memory (zenoh's issue 2557).
///
/// # Safety
/// The process has no other thread yet, and has not used zenoh.
pub unsafe fn work_in_one_thread() {
    let runtime = "(app: (worker_threads: 1), rx: (handover: app), tx: (handover: app), net: (handover: app), acc: (handover: app))";
    // SAFETY: the caller's promise: nobody reads the environment meanwhile.
    unsafe { std::env::set_var("ZENOH_RUNTIME", runtime) };
}

/// A zenoh configuration without discovery.
fn quiet() -> Result<Config, NetworkError> {
    let mut config = Config::default();
    let settings = [
        ("mode", "\"peer\""),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("scouting/delay", "0"),
        ("open/return_conditions/connect_scouted", "false"),
        ("adminspace/enabled", "false"),
        // Whoever waits longer is lost anyway; a full queue must not close the connection.
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", "60000000"),
        ("transport/unicast/open_timeout", "2000"),
        ("transport/unicast/accept_timeout", "2000"),
    ];
    for (key, value) in settings {
        set(&mut config, key, value)?;
    }
    Ok(config)
}

fn set(config: &mut Config, key: &str, value: &str) -> Result<(), NetworkError> {
    config.insert_json5(key, value).map_err(|error| NetworkError::Zenoh(format!("{key} = {value}: {error}")))
}

fn quoted(text: &str) -> String {
    format!("{text:?}")
}

fn path(path: &Path) -> String {
    quoted(&path.display().to_string())
}

/// Adds the certificates of both sides; the answering machine must have the called name.
fn with_tls(config: &mut Config, identity: &Identity, is_server: bool) -> Result<(), NetworkError> {
    let side = if is_server { "listen" } else { "connect" };
    let settings = [
        ("root_ca_certificate".to_owned(), path(&identity.authority)),
        (format!("{side}_certificate"), path(&identity.certificate)),
        (format!("{side}_private_key"), path(&identity.key)),
        ("enable_mtls".to_owned(), "true".to_owned()),
        ("verify_name_on_connect".to_owned(), "true".to_owned()),
    ];
    for (key, value) in settings {
        set(config, &format!("transport/link/tls/{key}"), &value)?;
    }
    Ok(())
}

fn open(config: Config) -> Result<Session, NetworkError> {
    zenoh::open(config).wait().map_err(|error| NetworkError::Zenoh(without_places(&error.to_string())))
}

/// A message of zenoh without locations in its source, such as `closed at /root/link.rs:64.`
fn without_places(message: &str) -> String {
    let (mut kept, mut rest) = (String::new(), message);
    while let Some(at) = rest.find(" at ") {
        let (before, place) = rest.split_at(at);
        let end = place[4..].find(' ').map_or(place.len(), |end| end + 4);
        let is_place = place[4..end].contains(".rs:");
        kept.push_str(before);
        kept.push_str(if is_place { "" } else { &place[..4] });
        rest = &place[if is_place { end } else { 4 }..];
    }
    kept + rest
}

/// Connects to a server.
pub fn connect(address: &Address, identity: Option<&Identity>) -> Result<Session, NetworkError> {
    let mut config = quiet()?;
    set(&mut config, "connect/endpoints", &format!("[{}]", quoted(&address.text)))?;
    set(&mut config, "connect/timeout_ms", "0")?;
    set(&mut config, "connect/exit_on_failure", "true")?;
    set(&mut config, "listen/endpoints", "[]")?;
    if address.is_tls {
        let identity = identity.ok_or_else(|| NetworkError::NoKeys(address.text.clone()))?;
        with_tls(&mut config, identity, false)?;
    }
    open(config)
}

/// Listens for hosts. With certificates, each host in `hosts` may use only its own keys; other hosts may use none.
pub fn listen(
    machine: &str,
    address: &Address,
    identity: Option<&Identity>,
    hosts: &[String],
) -> Result<Session, NetworkError> {
    let mut config = quiet()?;
    set(&mut config, "listen/endpoints", &format!("[{}]", quoted(&address.text)))?;
    if address.is_tls {
        let identity = identity.ok_or_else(|| NetworkError::NoKeys(address.text.clone()))?;
        with_tls(&mut config, identity, true)?;
        set(&mut config, "access_control", &access(machine, hosts))?;
    }
    open(config)
}

/// zenoh's access rules: which host may use which keys. All else is refused.
fn access(machine: &str, hosts: &[String]) -> String {
    let list = |each: &dyn Fn(&String) -> String| hosts.iter().map(each).collect::<Vec<_>>().join(", ");
    let rules = list(&|host| {
        format!(
            r#"{{ id: "keys-{host}", messages: ["put", "declare_subscriber"], flows: ["ingress", "egress"],
                 permission: "allow", key_exprs: ["panoscope/{machine}/{host}/**"] }}"#
        )
    });
    let subjects = list(&|host| format!(r#"{{ id: "host-{host}", cert_common_names: ["{host}"] }}"#));
    let policies = list(&|host| format!(r#"{{ rules: ["keys-{host}"], subjects: ["host-{host}"] }}"#));
    format!(
        r#"{{ enabled: true, default_permission: "deny", rules: [{rules}], subjects: [{subjects}], policies: [{policies}] }}"#
    )
}

/// The part of a connection's keys that both ends share.
pub fn prefix(machine: &str, host: &str, session: &str) -> String {
    format!("panoscope/{machine}/{host}/{session}")
}

/// The session in the key of a message, see [`prefix`].
pub fn session_of(sample: &Sample) -> Option<String> {
    sample.key_expr().as_str().split('/').nth(3).map(str::to_owned)
}

/// Answers a probe of the clock with its content followed by this machine's clock at `now_ns`. Returns false, without
/// an answer, for a malformed probe.
pub fn answer_probe(session: &Session, key: String, probe: &Sample, now_ns: i64) -> bool {
    let bytes = probe.payload().to_bytes();
    let Some(sent) = bytes.first_chunk::<8>() else { return false };
    let put = session.put(key, [*sent, now_ns.to_le_bytes()].concat());
    let _ = put.priority(Priority::RealTime).express(true).wait();
    true
}

/// A publisher of messages: nothing is dropped; the caller waits while the network is slow. `is_urgent` messages
/// overtake others.
pub fn publisher(
    session: &Session,
    key: String,
    is_urgent: bool,
) -> Result<zenoh::pubsub::Publisher<'static>, NetworkError> {
    let (priority, congestion) = match is_urgent {
        true => (Priority::RealTime, CongestionControl::Drop),
        false => (Priority::Data, CongestionControl::Block),
    };
    let declared =
        session.declare_publisher(key).congestion_control(congestion).priority(priority).express(true).wait();
    declared.map_err(|error| NetworkError::Zenoh(error.to_string()))
}

/// Calls `lost` when the other end of a publisher disappears. zenoh reconnects by itself without reporting lost
/// messages, so a user that needs every message must restart its session. The watch ends when the returned value is
/// dropped.
pub fn watch_end(
    publisher: &zenoh::pubsub::Publisher<'static>,
    lost: impl Fn() + Send + Sync + 'static,
) -> Result<MatchingListener<()>, NetworkError> {
    let was_there = AtomicBool::new(false);
    let changed = move |status: MatchingStatus| {
        if was_there.swap(status.matching(), Ordering::Relaxed) && !status.matching() {
            lost();
        }
    };
    let watch = publisher.matching_listener().callback(changed).wait();
    watch.map_err(|error| NetworkError::Zenoh(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_addresses_stay_on_this_machine() {
        assert!(Address::parse("tcp/127.0.0.1:7447", false).is_ok_and(|address| !address.is_tls));
        assert!(Address::parse("tcp/[::1]:7447", false).is_ok());
        assert!(matches!(Address::parse("tcp/192.0.2.1:7447", false), Err(NetworkError::Plaintext(_))));
        assert!(matches!(Address::parse("tcp/0.0.0.0:7447", false), Err(NetworkError::Plaintext(_))));
        assert!(Address::parse("tcp/192.0.2.1:7447", true).is_ok());
        assert!(Address::parse("tls/192.0.2.1:7447", false).is_ok_and(|address| address.is_tls));
        for bad in ["", "rack", "udp/127.0.0.1:1", "tls/rack", "tcp/127.0.0.1:1#iface=lo"] {
            assert!(matches!(Address::parse(bad, true), Err(NetworkError::BadAddress(_))), "{bad}");
        }
    }

    #[test]
    fn messages_name_no_place_in_the_source_of_zenoh() {
        let message = "Unable to connect to any of [tcp/127.0.0.1:7] at noon! at /root/.cargo/zenoh/src/net/orchestrator.rs:250. \
                       - Caused by link closed at src/unicast.rs:64.";
        let shown = "Unable to connect to any of [tcp/127.0.0.1:7] at noon! - Caused by link closed";
        assert_eq!(without_places(message), shown);
        assert_eq!(without_places("refused"), "refused");
    }
}
