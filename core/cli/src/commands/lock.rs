//! `panoscope lock`: fingerprints of a graph and of all files that its run depends on, optionally signed, which the
//! theatre compares.

use std::path::{Path, PathBuf};

use anyhow::Result;
use panoscope_graph::GraphText;
use panoscope_host::loader::keys::{SecretKey, public_file};
use panoscope_host::loader::lock::{ALWAYS_LOCKED, Lock, lock_path};
use panoscope_host::loader::verify::{self, VerifyError};
use panoscope_host::loader::{Kind, graph_file};

use crate::End;
use crate::given::Given;
use crate::terminal::{log, out, raw, stderr_color};
use crate::trust::Keys;

/// Arguments of `lock`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file.
    #[arg(required_unless_present = "new_key")]
    graph: Option<PathBuf>,
    #[command(flatten)]
    given: Given,
    /// Compares with the existing lock and writes nothing. Code of a plugin runs only after the plugin was compared.
    #[arg(long)]
    verify: bool,
    /// Signs the lock with this secret key.
    #[arg(long, value_name = "FILE", conflicts_with = "verify")]
    key: Option<PathBuf>,
    /// Makes a key pair: the secret key in FILE, the public key in FILE.pub.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["graph", "verify", "key"])]
    new_key: Option<PathBuf>,
    #[command(flatten)]
    keys: Keys,
}

/// Writes or compares.
pub fn run(arguments: &Arguments) -> Result<End> {
    if let Some(file) = &arguments.new_key {
        return new_key(file);
    }
    let Some(path) = &arguments.graph else { return Ok(End::Wrong) };
    let options = arguments.given.options(&[]);
    if arguments.verify {
        return match GraphText::load_with(path, &options) {
            Ok(text) => verify(path, &text, &arguments.keys),
            Err(diagnostics) => {
                log!("{}", diagnostics.render(stderr_color()).trim_end());
                Ok(End::Wrong)
            }
        };
    }
    // Before the graph is checked: a key that cannot be used is not found out after minutes.
    let key = match arguments.key.as_deref().map(SecretKey::read).transpose() {
        Ok(key) => key,
        Err(error) => {
            log!("error: {error}");
            return Ok(End::Wrong);
        }
    };
    let ready = match graph_file::open(path, &options) {
        Ok(ready) => ready,
        Err(diagnostics) => {
            log!("{}", diagnostics.render(stderr_color()).trim_end());
            return Ok(End::Wrong);
        }
    };
    let mut now = Lock::of(&ready.graph, &ready.catalog, &ready.loader, &ready.text, &ALWAYS_LOCKED);
    let missing: Vec<&str> = now.files.iter().filter(|f| f.sha256.is_empty()).map(|f| f.name.as_str()).collect();
    if !missing.is_empty() {
        log!("error: files that the graph names are not there: {}", missing.join(", "));
        return Ok(End::Wrong);
    }
    if let Some(key) = &key {
        now.sign(key);
    }
    let was = Lock::read(path).ok().flatten();
    let file = now.write(path)?;
    let mut words = String::new();
    // The libraries of OpenCV alone are more than a hundred.
    let libraries = now.files.iter().filter(|f| f.kind == Kind::Library);
    let (count, bytes) = libraries.fold((0, 0), |(count, bytes), file| (count + 1, bytes + file.bytes));
    for file in now.files.iter().filter(|f| f.kind != Kind::Library) {
        words += &format!("  {:<12} {:<28} {:>10} bytes  {}\n", file.kind, file.name, file.bytes, &file.sha256[..16]);
    }
    if count > 0 {
        words += &format!("  {:<12} {:<28} {bytes:>10} bytes\n", "libraries", format!("{count} that the plugins need"));
    }
    raw(&words);
    let signed = key.map_or_else(|| "not signed".to_owned(), |key| format!("signed with {}", key.public().short()));
    out!("{}: {} files locked, {signed}", file.display(), now.files.len());
    for difference in was.iter().flat_map(|was| was.differences(&now)) {
        out!("  {difference}");
    }
    Ok(End::Done)
}

fn new_key(file: &Path) -> Result<End> {
    match SecretKey::create(file) {
        Ok(public) => {
            let public_file = public_file(file);
            out!("{}: the secret key; keep it, and give it to nobody", file.display());
            out!(
                "{}: the public key {}; copy it into a folder of trusted keys:",
                public_file.display(),
                public.short()
            );
            for folder in panoscope_host::loader::keys::Trust::folders() {
                out!("  {}", folder.display());
            }
            Ok(End::Done)
        }
        Err(error) => {
            log!("error: {error}");
            Ok(End::Wrong)
        }
    }
}

fn verify(path: &Path, text: &GraphText, keys: &Keys) -> Result<End> {
    let Some(was) = Lock::read(path)? else {
        log!("error: {} is not locked: {} does not exist", path.display(), lock_path(path).display());
        return Ok(End::Wrong);
    };
    let signed_by = match was.check_signature(path, &keys.trusted()?) {
        Ok(signed_by) => signed_by,
        Err(error) => {
            log!("error: {error}");
            return Ok(End::Failed);
        }
    };
    match verify::open(text, &was, &ALWAYS_LOCKED) {
        Ok(_) => {
            let signed = signed_by.map_or_else(|| "not signed".to_owned(), |key| format!("signed by {key}"));
            out!("{}: as it was locked ({} files), {signed}", path.display(), was.files.len());
            Ok(End::Done)
        }
        Err(VerifyError::Differs(differences)) => {
            for difference in &differences {
                log!("error: {difference}");
            }
            Ok(End::Failed)
        }
        Err(VerifyError::Check(diagnostics)) => {
            log!("{}", diagnostics.render(stderr_color()).trim_end());
            Ok(End::Wrong)
        }
        Err(error @ VerifyError::Runtime(_)) => {
            log!("error: {error}");
            Ok(End::Failed)
        }
    }
}
