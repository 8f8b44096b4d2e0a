//! Files that the nodes of a run write. Each has one writer at a time, and a run never truncates a file that it wrote.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use panoscope_abi as abi;

use crate::sync::lock;

/// The files of one run.
#[derive(Debug, Default)]
pub(crate) struct Claims {
    state: Mutex<State>,
    next_token: AtomicU64,
}

#[derive(Debug, Default)]
struct State {
    files: HashMap<PathBuf, File>,
    /// Nodes that the current change closes: other nodes may claim their files.
    leaving: Vec<String>,
}

#[derive(Debug, Default)]
struct File {
    /// How many parts of it this run began.
    begun: u32,
    /// Open instances that write it: claim number and node.
    holders: Vec<(u64, String)>,
}

/// The claims of an instance, released when it closes.
#[derive(Debug, Default)]
pub(crate) struct Holds {
    pub claims: Option<Arc<Claims>>,
    pub token: u64,
    /// The path returned last, lent to the node until its call ends.
    pub answer: Mutex<String>,
}

impl Holds {
    /// For an instance that is about to open.
    pub fn new(claims: &Arc<Claims>) -> Self {
        let token = claims.next_token.fetch_add(1, Ordering::Relaxed);
        Self { claims: Some(Arc::clone(claims)), token, answer: Mutex::default() }
    }

    /// Releases everything.
    pub fn release(&mut self) {
        if let Some(claims) = self.claims.take() {
            let mut state = lock(&claims.state);
            for file in state.files.values_mut() {
                file.holders.retain(|(token, _)| *token != self.token);
            }
            // The number of parts stays known until the run ends.
            state.files.retain(|_, file| file.begun > 0 || !file.holders.is_empty());
        }
    }
}

impl Drop for Holds {
    fn drop(&mut self) {
        self.release();
    }
}

/// Until dropped, other nodes may claim the files of these nodes.
pub(crate) struct Leaving<'a>(&'a Claims);

impl Drop for Leaving<'_> {
    fn drop(&mut self) {
        lock(&self.0.state).leaving.clear();
    }
}

/// Another node writes the file.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("node `{by}` writes this file")]
pub(crate) struct Claimed {
    /// The node that writes it.
    pub by: String,
}

impl Claims {
    /// A change is about to close these nodes; the nodes that it opens may claim their files.
    pub fn leaving(&self, nodes: Vec<String>) -> Leaving<'_> {
        lock(&self.state).leaving = nodes;
        Leaving(self)
    }

    /// Whether an instance of this node claims its files. If so, its successor may open beside it.
    pub fn are_used_by(&self, node: &str) -> bool {
        lock(&self.state).files.values().any(|file| file.holders.iter().any(|(_, by)| by == node))
    }

    /// Returns the path to write, or the node that already writes it.
    pub fn claim(&self, token: u64, node: &str, path: &Path, action: u32) -> Result<PathBuf, Claimed> {
        if is_special(path) {
            return Ok(path.to_owned());
        }
        let key = key(path);
        let mut state = lock(&self.state);
        let State { files, leaving } = &mut *state;
        let file = files.entry(key).or_default();
        if !file.holders.iter().any(|(held, _)| *held == token) {
            let is_other = |(_, by): &&(u64, String)| by != node && !leaving.contains(by);
            if let Some((_, other)) = file.holders.iter().find(is_other) {
                return Err(Claimed { by: other.clone() });
            }
            file.holders.push((token, node.to_owned()));
        }
        if action == abi::CLAIM_HOLD {
            return Ok(path.to_owned());
        }
        let mut part = file.begun;
        let answer = loop {
            part += 1;
            let answer = part_name(path, part);
            // A node may have claimed a file with the name of this part.
            let taken = part > 1 && files.contains_key(&self::key(&answer));
            if !taken && (action == abi::CLAIM_BEGIN || !answer.exists()) {
                break answer;
            }
        };
        files.entry(self::key(path)).or_default().begun = part;
        if part > 1 {
            files.insert(self::key(&answer), File { begun: 1, holders: vec![(token, node.to_owned())] });
        }
        Ok(answer)
    }
}

/// Devices and pipes are never truncated and may have any number of writers.
fn is_special(path: &Path) -> bool {
    path.metadata().is_ok_and(|found| !found.is_file())
}

/// One name for all spellings of a path, as far as the file system resolves them.
fn key(path: &Path) -> PathBuf {
    if let Ok(whole) = path.canonicalize() {
        return whole;
    }
    match (path.parent().map(Path::canonicalize), path.file_name()) {
        (Some(Ok(folder)), Some(name)) => folder.join(name),
        _ => std::path::absolute(path).unwrap_or_else(|_| path.to_owned()),
    }
}

/// `video.mkv`, `video.part2.mkv`, `video.part3.mkv`.
fn part_name(path: &Path, part: u32) -> PathBuf {
    if part <= 1 {
        return path.to_owned();
    }
    match path.extension() {
        Some(ending) => path.with_extension(format!("part{part}.{}", ending.to_string_lossy())),
        None => path.with_extension(format!("part{part}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("panoscope_claims_{name}_{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        path
    }

    #[test]
    fn each_beginning_is_another_part() {
        let folder = folder("parts");
        let (claims, path) = (Claims::default(), folder.join("v.mkv"));
        let begin = |token| claims.claim(token, "a", &path, abi::CLAIM_BEGIN).unwrap();
        assert_eq!(claims.claim(1, "a", &path, abi::CLAIM_HOLD), Ok(path.clone()));
        assert_eq!(begin(1), path, "claiming is not beginning");
        assert_eq!(begin(2), folder.join("v.part2.mkv"));
        // Another node's file has the name of the next part.
        claims.claim(9, "b", &folder.join("v.part3.mkv"), abi::CLAIM_HOLD).unwrap();
        assert_eq!(begin(3), folder.join("v.part4.mkv"));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn files_of_earlier_runs_are_kept_where_that_is_wanted() {
        let folder = folder("kept");
        let (claims, path) = (Claims::default(), folder.join("clip"));
        std::fs::write(&path, "earlier").unwrap();
        assert_eq!(claims.claim(1, "a", &path, abi::CLAIM_BEGIN_NEW), Ok(folder.join("clip.part2")));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_file_has_one_writer_whatever_its_path_looks_like() {
        let folder = folder("writers");
        let claims = Arc::new(Claims::default());
        let path = folder.join("t.csv");
        let mut first = Holds::new(&claims);
        claims.claim(first.token, "a", &path, abi::CLAIM_HOLD).unwrap();
        let same = folder.join("../").join(folder.file_name().unwrap()).join("t.csv");
        assert_eq!(claims.claim(77, "b", &same, abi::CLAIM_HOLD), Err(Claimed { by: "a".to_owned() }));
        assert_eq!(claims.claim(78, "a", &same, abi::CLAIM_HOLD), Ok(same.clone()), "its own successor may");
        {
            let _leaving = claims.leaving(vec!["a".to_owned()]);
            claims.claim(79, "b", &same, abi::CLAIM_HOLD).unwrap();
        }
        first.release();
        assert!(claims.are_used_by("b"));
        // Pipes and devices are not claimed.
        for token in [1, 2] {
            let null = Path::new("/dev/null");
            assert_eq!(claims.claim(token, &token.to_string(), null, abi::CLAIM_BEGIN), Ok(null.to_owned()));
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_was_written_in_a_run_is_not_begun_anew_by_another_node() {
        let folder = folder("after");
        let claims = Arc::new(Claims::default());
        let path = folder.join("t.csv");
        let mut first = Holds::new(&claims);
        claims.claim(first.token, "a", &path, abi::CLAIM_BEGIN).unwrap();
        first.release();
        assert_eq!(claims.claim(5, "b", &path, abi::CLAIM_BEGIN), Ok(folder.join("t.part2.csv")));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
