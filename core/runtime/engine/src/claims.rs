//! Files that the nodes of a run write. Each has one writer at a time, in this run and among all runs, and a run never
//! truncates a file that it wrote.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use panoscope_abi as abi;

use crate::files::{LOCK_PATIENCE, OutputLock, OutputLocked, is_special};
use crate::sync::lock;

/// The files of one run.
#[derive(Debug, Default)]
pub(crate) struct Claims {
    state: Mutex<State>,
    next_token: AtomicU64,
    /// Whether files of earlier runs are never replaced.
    keeps: bool,
}

#[derive(Debug, Default)]
struct State {
    files: HashMap<PathBuf, File>,
    /// Nodes that the current change closes: other nodes may claim their files.
    leaving: Vec<String>,
}

#[derive(Debug, Default)]
struct File {
    /// Number of its parts that this run began.
    begun: u32,
    /// The part that holds the files of this run, where they are replaced as a whole; 0 if there is none yet.
    series: u32,
    /// Open instances that write it: claim number and node.
    holders: Vec<(u64, String)>,
    /// Excludes other runs; kept after the last holder has closed, because the run may go on with the next part.
    lock: Option<OutputLock>,
    /// Whether it is a later part of another file. The lock of that file also protects this name, so the lock of the
    /// part ends with its holder; otherwise a run of many parts would run out of descriptors.
    is_part: bool,
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
                if file.is_part && file.holders.is_empty() {
                    file.lock = None;
                }
            }
            // The number of parts stays known until the run ends.
            state.files.retain(|_, file| file.begun > 0 || file.series > 0 || !file.holders.is_empty());
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

/// A file that a node cannot write.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Claimed {
    /// Another node of this run writes it.
    #[error("node `{by}` writes this file")]
    Node {
        /// The node that writes it.
        by: String,
    },
    /// Another run writes it.
    #[error(transparent)]
    Run(#[from] OutputLocked),
}

impl Claims {
    /// For a run that never replaces files of earlier runs if it `keeps` them.
    pub fn new(keeps: bool) -> Self {
        Self { keeps, ..Self::default() }
    }

    /// Lets other runs write what no open instance of this one writes.
    pub fn unlock(&self) {
        lock(&self.state).files.values_mut().filter(|file| file.holders.is_empty()).for_each(|file| file.lock = None);
    }

    /// A change is about to close these nodes; the nodes that it opens may claim their files.
    pub fn leaving(&self, nodes: Vec<String>) -> Leaving<'_> {
        lock(&self.state).leaving = nodes;
        Leaving(self)
    }

    /// Whether an instance of this node claims its files. If so, its successor may open before it closes.
    pub fn are_used_by(&self, node: &str) -> bool {
        lock(&self.state).files.values().any(|file| file.holders.iter().any(|(_, by)| by == node))
    }

    /// Returns the path to write, or who already writes it. The answer to [`abi::CLAIM_HOLD`] is for files that are
    /// replaced as a whole, and for patterns of files: the same in the whole run.
    pub fn claim(&self, token: u64, node: &str, path: &Path, action: u32) -> Result<PathBuf, Claimed> {
        if is_special(path) {
            return Ok(path.to_owned());
        }
        let key = key(path);
        let mut state = lock(&self.state);
        let State { files, leaving } = &mut *state;
        let known = files.get(&key);
        if !known.is_some_and(|file| file.holders.iter().any(|(held, _)| *held == token)) {
            let is_other = |(_, by): &&(u64, String)| by != node && !leaving.contains(by);
            if let Some((_, other)) = known.and_then(|file| file.holders.iter().find(is_other)) {
                return Err(Claimed::Node { by: other.clone() });
            }
            let lock = if known.is_some_and(|file| file.lock.is_some()) {
                None
            } else {
                OutputLock::take(&key, LOCK_PATIENCE)?
            };
            let file = files.entry(key.clone()).or_default();
            file.lock = lock.or(file.lock.take());
            file.holders.push((token, node.to_owned()));
        }
        let file = files.entry(key.clone()).or_default();
        if action == abi::CLAIM_HOLD {
            if self.keeps && file.series == 0 {
                file.series = (1..).find(|part| !has_files(&part_name(path, *part))).unwrap_or(1);
            }
            return Ok(part_name(path, file.series));
        }
        let mut part = file.begun;
        let may_replace = action == abi::CLAIM_BEGIN && !self.keeps;
        let (answer, lock) = loop {
            part += 1;
            let answer = part_name(path, part);
            // A node may have claimed a file with the name of this part, here or in another run.
            let taken = part > 1 && files.contains_key(&self::key(&answer));
            if taken || !may_replace && answer.exists() {
                continue;
            }
            if part == 1 {
                break (answer, None);
            }
            if let Ok(lock) = OutputLock::take(&self::key(&answer), Duration::ZERO) {
                break (answer, lock);
            }
        };
        files.entry(key).or_default().begun = part;
        if part > 1 {
            files.insert(
                self::key(&answer),
                File { begun: 1, series: 0, holders: vec![(token, node.to_owned())], lock, is_part: true },
            );
        }
        Ok(answer)
    }
}

/// Whether there is a file of this name or pattern. Digits stand for `{seq}`, and anything for another placeholder; a
/// port may follow the name.
fn has_files(pattern: &Path) -> bool {
    let Some((folder, name)) = pattern.parent().zip(pattern.file_name().and_then(OsStr::to_str)) else { return false };
    let (before, after) = match (name.find('{'), name.rfind('}')) {
        (Some(open), Some(close)) if open < close => (&name[..open], &name[close + 1..]),
        _ => name.split_at(name.find('.').unwrap_or(name.len())),
    };
    let (is_pattern, is_numbered) = (name.contains('{'), name.contains("{seq"));
    let (between, after) = after.split_at(after.find('.').unwrap_or(after.len()));
    let is_one = |found: &str| {
        let Some(rest) = found.strip_prefix(before).and_then(|rest| rest.strip_suffix(after)) else { return false };
        let is_named = is_pattern || rest.is_empty() || rest.starts_with('_');
        is_named && rest.contains(between) && (!is_numbered || rest.contains(|c: char| c.is_ascii_digit()))
    };
    let Ok(entries) = std::fs::read_dir(folder) else { return false };
    entries.flatten().any(|entry| entry.file_name().to_str().is_some_and(is_one))
}

/// One name for all spellings of a path, as far as the file system resolves them. A symbolic link at the path itself is
/// not followed, because the file that is written replaces it.
fn key(path: &Path) -> PathBuf {
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
        assert_eq!(claims.claim(1, "a", &path, abi::CLAIM_HOLD).unwrap(), path);
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
        assert_eq!(claims.claim(1, "a", &path, abi::CLAIM_BEGIN_NEW).unwrap(), folder.join("clip.part2"));
        let keeping = Claims::new(true);
        let (video, stills) = (folder.join("v.mkv"), folder.join("{seq}.png"));
        for file in ["v.mkv", "v.part2.mkv", "000007.png", "000003_mask.part2.png", "overview.png", "last_depth.pfm"] {
            std::fs::write(folder.join(file), "earlier").unwrap();
        }
        assert_eq!(keeping.claim(1, "a", &video, abi::CLAIM_BEGIN).unwrap(), folder.join("v.part3.mkv"));
        let hold = |name: &str| keeping.claim(1, "a", &folder.join(name), abi::CLAIM_HOLD).unwrap();
        assert_eq!(hold("{seq}.png"), folder.join("{seq}.part3.png"));
        // A reopened node goes on with its files.
        std::fs::write(folder.join("000001.part3.png"), "new").unwrap();
        assert_eq!(hold("{seq}.png"), folder.join("{seq}.part3.png"));
        assert_eq!(hold("last.pfm"), folder.join("last.part2.pfm"));
        for others in ["{seq}_left.png", "las.pfm", "view_{port}.png"] {
            assert_eq!(hold(others), folder.join(others));
        }
        drop(keeping);
        assert_eq!(Claims::default().claim(1, "b", &stills, abi::CLAIM_HOLD).unwrap(), stills, "replaced");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_file_has_one_run_that_writes_it() {
        let folder = folder("runs");
        let path = folder.join("v.mkv");
        let run = Arc::new(Claims::default());
        let mut first = Holds::new(&run);
        run.claim(first.token, "a", &path, abi::CLAIM_HOLD).unwrap();
        let other = Claims::default();
        let refused = other.claim(1, "a", &path, abi::CLAIM_HOLD).expect_err("another run has it").to_string();
        assert!(refused.contains("another run (process ") && refused.contains("v.mkv"), "{refused}");
        // A hot swap: the successor opens next to the instance.
        let mut next = Holds::new(&run);
        assert_eq!(run.claim(next.token, "a", &path, abi::CLAIM_BEGIN).unwrap(), path);
        first.release();
        run.unlock();
        other.claim(1, "a", &path, abi::CLAIM_HOLD).expect_err("it is still written");
        next.release();
        other.claim(1, "a", &path, abi::CLAIM_HOLD).expect_err("the run may go on with it");
        run.unlock();
        other.claim(1, "a", &path, abi::CLAIM_HOLD).unwrap();
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_part_is_locked_while_it_is_written() {
        let folder = folder("part_locks");
        let (claims, path) = (Arc::new(Claims::default()), folder.join("v.mkv"));
        let other = Claims::default();
        let locks = || {
            let names =
                std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
            names.filter(|name| name.ends_with(".lock")).count()
        };
        for part in 1..5 {
            let mut holds = Holds::new(&claims);
            let file = claims.claim(holds.token, "a", &path, abi::CLAIM_BEGIN).unwrap();
            other.claim(1, "b", &file, abi::CLAIM_HOLD).expect_err("it is being written");
            assert_eq!(locks(), part.min(2));
            holds.release();
            assert_eq!(locks(), 1, "of the file whose next part the run may begin");
        }
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
        let refused = claims.claim(77, "b", &same, abi::CLAIM_HOLD);
        assert!(matches!(&refused, Err(Claimed::Node { by }) if by == "a"), "{refused:?}");
        assert_eq!(claims.claim(78, "a", &same, abi::CLAIM_HOLD).unwrap(), same, "its own successor may");
        {
            let _leaving = claims.leaving(vec!["a".to_owned()]);
            claims.claim(79, "b", &same, abi::CLAIM_HOLD).unwrap();
        }
        first.release();
        assert!(claims.are_used_by("b"));
        // Pipes and devices are not claimed.
        for token in [1, 2] {
            let null = Path::new("/dev/null");
            assert_eq!(claims.claim(token, &token.to_string(), null, abi::CLAIM_BEGIN).unwrap(), null);
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
        assert_eq!(claims.claim(5, "b", &path, abi::CLAIM_BEGIN).unwrap(), folder.join("t.part2.csv"));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
