//! Serves one connection: reads messages and answers them.

use std::net::TcpStream;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Weak};

use panoscope_igtl::{IgtlError, Reader};

use super::peer::Peer;
use super::{Inbox, Remark, Shared, answer, lock};

/// Serves a connection until it ends. `is_client`: this side connected.
pub fn serve(shared: &Arc<Shared>, stream: TcpStream, is_client: bool) {
    let peer = match Peer::new(stream) {
        Ok(peer) => Arc::new(peer),
        Err(error) => return shared.remark(true, format!("a connection could not be set up: {error}")),
    };
    {
        let mut peers = lock(&shared.peers);
        if shared.is_stopping() {
            return;
        }
        peers.push(Arc::clone(&peer));
    }
    shared.connected.fetch_add(1, Ordering::AcqRel);
    let whom = if is_client { "connected to" } else { "connection from" };
    shared.remark(false, format!("{whom} {}", peer.words));
    let (own, own_shared) = (Arc::clone(&peer), Arc::clone(shared));
    let writer = std::thread::Builder::new().name("igtl-write".to_owned()).spawn(move || own.write(&own_shared));
    let reason = match &writer {
        Ok(_) => read(&peer, shared),
        Err(error) => Some(format!("no thread could be started: {error}")),
    };
    peer.close();
    if let Ok(writer) = writer {
        // A panic was printed when it happened.
        let _ = writer.join();
    }
    lock(&shared.peers).retain(|other| !Arc::ptr_eq(other, &peer));
    if shared.is_stopping() {
        return;
    }
    let is_end = reason.is_none();
    let words = match reason {
        Some(reason) => format!("the connection to {} was lost: {reason}", peer.words),
        None => format!("{} closed the connection", peer.words),
    };
    // A client of ours that leaves is its own choice; a server that leaves is missed.
    let words = if is_client { format!("{words}; reconnecting") } else { words };
    shared.add_remark(Remark { is_fault: is_client, is_end, is_apart: is_client, words });
    lock(&shared.inboxes).iter().filter_map(Weak::upgrade).for_each(|inbox: Arc<Inbox>| inbox.wake());
}

/// Reads until the connection ends. Returns why it ended.
fn read(peer: &Peer, shared: &Shared) -> Option<String> {
    let mut reader = Reader::default();
    let mut has_warned = false;
    loop {
        match reader.fill(&mut &peer.stream) {
            Ok(0) => return None,
            Ok(_) => {}
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
            Err(error) => return Some(error.to_string()),
        }
        loop {
            let error = match reader.next_message() {
                Ok(Some(raw)) => match answer::take(peer, shared, &raw) {
                    Ok(()) => continue,
                    Err(error) => error,
                },
                Ok(None) => break,
                Err(error) => error,
            };
            shared.totals.damaged.fetch_add(1, Ordering::Relaxed);
            if reader.is_broken() {
                return Some(error.to_string());
            }
            warn_once(peer, shared, &mut has_warned, &error);
        }
    }
}

/// Logs only the first malformed message of a connection: a peer that sends one sends many.
fn warn_once(peer: &Peer, shared: &Shared, has_warned: &mut bool, error: &IgtlError) {
    if !std::mem::replace(has_warned, true) {
        shared.remark(true, format!("a message of {} was dropped: {error}; further ones are only counted", peer.words));
    }
}
