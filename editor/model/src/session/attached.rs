//! A session whose graph runs on another machine: requests go there, and what happens there becomes the status.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use panoscope_engine::sync::lock;
use panoscope_host::attach::{Attachment, Contact, State};

use super::{Phase, Requests, RunProblem, Session, Shared, Wake};

/// Between two looks at the machine.
const LOOK: Duration = Duration::from_millis(100);
/// Changes of this window that are remembered.
const MAX_OWN: usize = 64;

impl Session {
    /// A session for the graph that runs on another machine. Changes are made there; `path` is where a copy of the graph would be saved.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn attached(path: &Path, attachment: Attachment) -> std::io::Result<Self> {
        let attachment = Arc::new(attachment);
        let shared = Arc::new(Shared::new(path, &[], None, Some(Arc::clone(&attachment))));
        let waking = Arc::downgrade(&shared);
        let wake: Arc<Wake> = Arc::new(move || {
            if let Some(shared) = waking.upgrade() {
                shared.wake();
            }
        });
        attachment.set_wake(wake);
        let worker = Worker { shared: Arc::clone(&shared), machine: attachment, revision: 0, own: Own::default() };
        let worker = std::thread::Builder::new().name("machine".to_owned()).spawn(move || worker.run())?;
        Ok(Self { shared, worker: Some(worker) })
    }
}

struct Worker {
    shared: Arc<Shared>,
    machine: Arc<Attachment>,
    revision: u64,
    own: Own,
}

/// Texts that this window had the machine run, without a change of others between them. The window edits on before it sees that one runs.
#[derive(Default)]
struct Own {
    before: VecDeque<String>,
    last: String,
}

impl Own {
    /// The text that a change of `base` starts from.
    fn base(&self, base: String) -> String {
        if self.before.contains(&base) { self.last.clone() } else { base }
    }

    /// A change was made.
    fn made(&mut self, base: String, text: &str) {
        if base != self.last {
            self.before.clear();
        }
        self.before.push_back(base);
        if self.before.len() > MAX_OWN {
            self.before.pop_front();
        }
        text.clone_into(&mut self.last);
    }

    /// The machine runs a text.
    fn runs(&mut self, text: &str) {
        if text != self.last && !self.before.iter().any(|before| before == text) {
            *self = Self::default();
        }
    }
}

impl Worker {
    fn run(mut self) {
        loop {
            let requests = self.next();
            if requests.quit {
                self.shared.update(|status| status.busy = false);
                return;
            }
            if requests.restart || requests.stop || requests.reload {
                let name = &self.machine.target().name;
                let message = format!("the run is started, stopped and reloaded on `{name}`, not from here");
                self.shared.update(|status| status.problem = Some(RunProblem { node: None, message, mistake: None }));
            } else if let Some(text) = requests.text {
                self.change(requests.base, &text);
            }
            self.follow();
            let more = lock(&self.shared.requests).any();
            if lock(&self.shared.status).busy != more {
                self.shared.update(|status| status.busy = more);
            }
        }
    }

    /// Waits for a request, or until it is time to look at the machine.
    fn next(&self) -> Requests {
        let mut requests = lock(&self.shared.requests);
        if !requests.any() {
            requests = self.shared.requested.wait_timeout(requests, LOOK).unwrap_or_else(PoisonError::into_inner).0;
        }
        std::mem::take(&mut *requests)
    }

    /// Has the machine run a text that was edited from `base`.
    fn change(&mut self, base: Option<String>, text: &str) {
        let Some(opened) = self.machine.state().opened else { return };
        let base = self.own.base(base.unwrap_or_else(|| opened.text.clone()));
        if base == text {
            return self.shared.update(|status| status.problem = None);
        }
        let goes_on = || !lock(&self.shared.requests).quit;
        let result = self.machine.run(&base, text, goes_on);
        if result.is_ok() {
            self.own.made(base, text);
        }
        self.shared.update(|status| match result {
            Ok(words) => {
                (status.problem, status.last) = (None, words);
                status.running = text.into();
            }
            Err(refused) => {
                status.problem = Some(RunProblem { node: refused.node, message: refused.words, mistake: None })
            }
        });
    }

    /// Takes over what has happened on the machine.
    fn follow(&mut self) {
        let State { contact, opened, revision, .. } = self.machine.state();
        let is_new = revision != self.revision;
        self.revision = revision;
        if let Some(opened) = opened.as_ref().filter(|_| is_new) {
            self.own.runs(&opened.text);
        }
        let phase = match contact {
            Contact::None => Phase::Starting,
            // What runs there runs on.
            Contact::Attached | Contact::Lost(_) => Phase::Running,
            Contact::Ended(_) => Phase::Ended,
        };
        let ticks = self.machine.nodes().values().map(|node| node.count).max().unwrap_or(0);
        let is_other = lock(&self.shared.status).phase != phase;
        if is_new || is_other {
            self.shared.update(|status| {
                if let Some(opened) = opened.filter(|_| is_new) {
                    status.running = opened.text.as_str().into();
                    status.generation += 1;
                    status.tick = ticks;
                }
                status.phase = phase;
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_edits_on_before_it_sees_its_last_change() {
        let mut own = Own::default();
        assert_eq!(own.base("s".to_owned()), "s");
        own.made("s".to_owned(), "a");
        assert_eq!(own.base("s".to_owned()), "a", "what the window saw when it edited");
        own.made("a".to_owned(), "b");
        own.runs("a");
        assert_eq!((own.base("s".to_owned()), own.base("a".to_owned())), ("b".to_owned(), "b".to_owned()));
        own.runs("of somebody else");
        assert_eq!(own.base("a".to_owned()), "a", "the machine refuses it");
    }
}
