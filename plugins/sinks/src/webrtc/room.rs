//! The viewers of one node.

use std::collections::BTreeMap;
use std::hash::{BuildHasher, Hasher};
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use panoscope_media::offer::{Offer, OfferError};

use super::viewer::{Viewer, ViewerError};
use crate::stream::fanout::Fanout;

/// Maximum number of viewers of a node at a time.
pub const MAX_VIEWERS: usize = 8;

/// Why a viewer cannot join.
#[derive(Debug, thiserror::Error)]
pub enum JoinError {
    /// The maximum number of viewers is reached.
    #[error("{MAX_VIEWERS} viewers are already connected: close one of them")]
    Full,
    /// The node has ended.
    #[error("the stream has ended")]
    Ended,
    /// The offer cannot be answered.
    #[error(transparent)]
    Offer(#[from] OfferError),
    /// GStreamer failed.
    #[error(transparent)]
    Viewer(#[from] ViewerError),
}

#[derive(Default)]
struct Seats {
    viewers: BTreeMap<String, Viewer>,
    /// Seats reserved for viewers whose offer is being answered.
    taken: usize,
    has_ended: bool,
}

/// The viewers of a node: they join, leave, and are removed when they are gone.
pub struct Room {
    /// Name of the node.
    pub node: String,
    fanout: Arc<Fanout>,
    seats: Mutex<Seats>,
}

/// A name that cannot be guessed, so that nobody can end the connection of another viewer.
fn secret() -> String {
    // Keyed with random numbers of the system.
    let half = || std::collections::hash_map::RandomState::new().build_hasher().finish();
    format!("{:016x}{:016x}", half(), half())
}

/// A reserved seat, released when answering fails.
struct Taken<'r>(&'r Room);

impl Drop for Taken<'_> {
    fn drop(&mut self) {
        self.0.seats().taken -= 1;
    }
}

impl Room {
    /// A room without viewers for the packets of `fanout`.
    pub fn new(node: &str, fanout: &Arc<Fanout>) -> Self {
        Self { node: node.to_owned(), fanout: Arc::clone(fanout), seats: Mutex::default() }
    }

    fn seats(&self) -> MutexGuard<'_, Seats> {
        self.seats.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Answers the offer of a viewer that reached this machine at `local`. Returns the viewer's name and the answer. Takes about 10 ms.
    ///
    /// # Errors
    /// All seats are taken, or the offer cannot be answered.
    pub fn join(&self, offer: &[u8], local: IpAddr) -> Result<(String, String), JoinError> {
        let offer = Offer::parse(offer)?;
        {
            let mut seats = self.seats();
            if seats.has_ended {
                return Err(JoinError::Ended);
            }
            if seats.viewers.len() + seats.taken >= MAX_VIEWERS {
                return Err(JoinError::Full);
            }
            seats.taken += 1;
        }
        let taken = Taken(self);
        let (viewer, answer) = Viewer::connect(&offer, local, &self.fanout)?;
        let name = secret();
        let mut seats = self.seats();
        let refused = if seats.has_ended { Some(viewer) } else { seats.viewers.insert(name.clone(), viewer) };
        drop(seats);
        drop(taken);
        match refused {
            // Stopped here, without the lock.
            Some(_) => Err(JoinError::Ended),
            None => Ok((name, answer)),
        }
    }

    /// Ends the connection of a viewer. Returns whether it existed.
    pub fn leave(&self, name: &str) -> bool {
        let viewer = self.seats().viewers.remove(name);
        viewer.is_some()
    }

    /// Removes viewers that are gone.
    pub fn clean_up(&self) {
        let gone: Vec<_> = self.seats().viewers.extract_if(.., |_, viewer| viewer.has_left()).collect();
        // Stopped without the lock, because that waits for threads.
        drop(gone);
    }

    /// Ends all connections and accepts no more.
    pub fn end(&self) {
        let mut seats = self.seats();
        seats.has_ended = true;
        let viewers = std::mem::take(&mut seats.viewers);
        drop(seats);
        drop(viewers);
    }
}
