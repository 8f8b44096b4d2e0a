//! Handles received messages: answers requests, passes data to the nodes.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use panoscope_igtl::message::{Capability, KINDS, Query, Status, StatusCode, Verb};
use panoscope_igtl::{Content, IgtlError, Message, Raw, Timestamp};

use super::peer::{Outgoing, Peer};
use super::{Shared, lock, utc_ns};

/// Maximum number of waiting answers of one kind. A program that asks without reading gets only the newest ones.
const MAX_ANSWERS: usize = 16;

/// Handles one message.
///
/// # Errors
/// A request is malformed. The content of data is parsed by the nodes that take it.
pub fn take(peer: &Peer, shared: &Shared, raw: &Raw<'_>) -> Result<(), IgtlError> {
    let kind = raw.header.kind.as_ref();
    if kind.starts_with("GET_") || kind.starts_with("STT_") || kind.starts_with("STP_") {
        let message = raw.message()?;
        if let Content::Query(query) = &message.content {
            answer(peer, shared, &message, query);
        }
    } else if KINDS.contains(&kind) {
        shared.totals.received.fetch_add(1, Ordering::Relaxed);
        let (arrived, arrived_utc_ns) = (Instant::now(), utc_ns());
        // A full inbox may wait: it must not hold the list.
        let inboxes: Vec<_> = lock(&shared.inboxes).iter().filter_map(Weak::upgrade).collect();
        inboxes.iter().for_each(|inbox| inbox.offer(raw, arrived, arrived_utc_ns));
    } else if !kind.starts_with("RTS_") {
        shared.totals.skipped.fetch_add(1, Ordering::Relaxed);
    }
    Ok(())
}

fn answer(peer: &Peer, shared: &Shared, asked: &Message<'_>, query: &Query<'_>) {
    let subject = query.subject();
    match (&query.verb, subject) {
        (Verb::Get, Some("CAPABILITY")) => {
            let kinds = KINDS.iter().map(|kind| (*kind).into()).collect();
            reply(peer, asked, "CAPABILITY", Content::Capability(Capability { kinds }));
        }
        (Verb::Get, Some("STATUS")) => {
            let is_ready = !lock(&shared.newest).is_empty();
            let (code, text) = match is_ready {
                true => (StatusCode::Ok, "the graph runs"),
                false => (StatusCode::NotReady, "the graph has sent nothing yet"),
            };
            let status = Status { code: code as u16, sub_code: 0, name: "".into(), text: text.into() };
            reply(peer, asked, "STATUS", Content::Status(status));
        }
        (Verb::Get, Some(kind)) => get(peer, shared, asked, kind),
        (Verb::Start(_) | Verb::StartTracking(_) | Verb::Stop, _) => {
            let is_start = !matches!(query.verb, Verb::Stop);
            // Texts, states and capabilities are no series.
            let subject = subject.filter(|kind| !matches!(*kind, "STATUS" | "STRING" | "CAPABILITY"));
            if let Some(kind) = subject {
                peer.set_flow(kind, is_start, Duration::from_nanos(query.interval_ns()));
            }
            let verb = Verb::Answer { is_granted: subject.is_some() };
            reply(peer, asked, "RTS_", Content::Query(Query { verb, kind: query.kind.clone() }));
        }
        (Verb::Get | Verb::Answer { .. }, _) => {
            shared.totals.skipped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Answers a request for data: the newest message of the device, of any device if none is named, or an empty one.
fn get(peer: &Peer, shared: &Shared, asked: &Message<'_>, kind: &'static str) {
    let newest = lock(&shared.newest);
    let is_asked =
        |name: &&(&'static str, String)| name.0 == kind && (asked.device.is_empty() || asked.device == name.1);
    let found = newest.iter().find(|(name, _)| is_asked(name)).map(|(_, bytes)| Arc::clone(bytes));
    drop(newest);
    match found {
        Some(bytes) => offer(peer, kind, asked.device.to_string(), bytes),
        None => reply(peer, asked, kind, Content::Nothing),
    }
}

/// Sends an answer with the device name and header version of the request.
fn reply(peer: &Peer, asked: &Message<'_>, kind: &'static str, content: Content<'_>) {
    let mut message = Message::new(&*asked.device, Timestamp::from_unix_ns(utc_ns()), content);
    message.version = asked.version;
    message.message_id = asked.message_id;
    if matches!(message.content, Content::Nothing) {
        message.kind = kind.into();
    }
    let mut bytes = Vec::new();
    // Fails for names that are too long only; they came in a message.
    if message.encode(&mut bytes).is_ok() {
        offer(peer, kind, asked.device.to_string(), Arc::new(bytes));
    }
}

fn offer(peer: &Peer, kind: &'static str, device: String, bytes: Arc<Vec<u8>>) {
    let message = Outgoing { kind, device, bytes, is_pushed: true, is_answer: true, most: MAX_ANSWERS };
    peer.offer(&message, false);
}
