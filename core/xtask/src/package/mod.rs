//! Makes packages: a Debian package and a folder in a tar file that runs from anywhere.
//!
//! Both hold the same tree, below `usr` and below a folder: programs and plugins in `lib/panoscope`, links to the programs in `bin`, graphs in
//! `share/panoscope`, manual pages, completions and licences in `share`.

mod check;
mod deb;
mod tree;
mod wheel;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::build::{Profile, program_name, window_names};
use crate::install::{self, LIBRARY, Symbols};
use crate::licences;
use crate::process::{capture, run};
use crate::workspace::Workspace;
use tree::{copy, copy_tree};

pub use check::check;
pub use wheel::{check_wheel, wheel};

/// Files that a package manager places where the system looks for them; in the tar file they stand with the documents.
const PLACED: [&str; 2] = ["70-panoscope.rules", "panoscope@.service"];

/// What a package is made of.
pub struct Release<'a> {
    workspace: &'a Workspace,
    version: String,
    /// Seconds since 1970 for all files, so that the same commit gives the same package.
    time_s: u64,
    /// The tree that `install` made, with everything that both packages have.
    tree: PathBuf,
}

/// Builds and writes `panoscope_VERSION_ARCH.deb` and `panoscope-VERSION-ARCH.tar.gz` into `dir`; returns the first.
///
/// # Errors
/// The build fails, a program of Debian's `dpkg-dev` or `binutils` is missing, or a file cannot be written.
pub fn package(workspace: &Workspace, dir: &Path, profile: Profile) -> Result<PathBuf> {
    fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
    let dir = &dir.canonicalize()?;
    // Before the build, which takes long.
    let maintainer = deb::maintainer()?;
    let tree = dir.join("tree");
    let _ = fs::remove_dir_all(&tree);
    install::install(workspace, &tree, profile, Symbols::Stripped)?;
    let release = Release::new(workspace, tree)?;
    let (tar, deb) = (release.tar(dir)?, release.deb(dir, &maintainer)?);
    fs::remove_dir_all(&release.tree)?;
    println!("{}\n{}", tar.display(), deb.display());
    Ok(deb)
}

impl<'a> Release<'a> {
    /// Adds to an installed tree manual pages, completions and licences.
    fn new(workspace: &'a Workspace, tree: PathBuf) -> Result<Self> {
        let time_s = commit_time_s(workspace);
        let release = Self { workspace, version: env!("CARGO_PKG_VERSION").to_owned(), time_s, tree };
        release.add_manual()?;
        release.add_documents()?;
        Ok(release)
    }

    /// Manual pages and completions, as the command generates them.
    fn add_manual(&self) -> Result<()> {
        let share = self.tree.join("share");
        let generated = self.tree.with_extension("generated");
        let _ = fs::remove_dir_all(&generated);
        run(Command::new(self.tree.join("bin").join(program_name())).arg("generate").arg(&generated))?;
        copy_tree(&generated.join("man"), &share.join("man/man1"))?;
        for window in window_names() {
            copy(&self.source(&format!("{window}.1")), &share.join("man/man1").join(format!("{window}.1")))?;
        }
        for page in fs::read_dir(share.join("man/man1"))?.flatten() {
            run(Command::new("gzip").args(["-9", "--no-name", "--force"]).arg(page.path()))?;
        }
        let completions = generated.join("completions");
        copy(&completions.join("panoscope.bash"), &share.join("bash-completion/completions/panoscope"))?;
        copy(&completions.join("_panoscope"), &share.join("zsh/vendor-completions/_panoscope"))?;
        copy(&completions.join("panoscope.fish"), &share.join("fish/vendor_completions.d/panoscope.fish"))?;
        Ok(fs::remove_dir_all(&generated)?)
    }

    /// What people read: an introduction, licences, the cards of the models.
    fn add_documents(&self) -> Result<()> {
        let (library, doc) = (self.tree.join(LIBRARY), self.tree.join("share/doc/panoscope"));
        copy(&self.source("README.md"), &doc.join("README.md"))?;
        copy(&self.source("copyright"), &doc.join("copyright"))?;
        for name in PLACED {
            copy(&self.source(name), &doc.join(name))?;
        }
        for file in fs::read_dir(library.join("onnxruntime")).into_iter().flatten().flatten() {
            let name = file.file_name().to_string_lossy().into_owned();
            if !name.contains(".so") {
                tree::move_file(&file.path(), &doc.join(format!("onnxruntime-{name}")))?;
            }
        }
        for card in tree::markdown_files(&library.join("plugins"))? {
            tree::move_file(&card, &doc.join(card.file_name().unwrap_or_default()))?;
        }
        let notices = doc.join("third-party-notices");
        tree::write(&notices, &licences::notices(self.workspace)?)?;
        run(Command::new("gzip").args(["-9", "--no-name"]).arg(notices))
    }

    /// The tree in a tar file.
    fn tar(&self, dir: &Path) -> Result<PathBuf> {
        let name = format!("panoscope-{}-{}", self.version, std::env::consts::ARCH);
        let folder = dir.join(&name);
        let _ = fs::remove_dir_all(&folder);
        copy_tree(&self.tree, &folder)?;
        copy(&self.workspace.root.join("LICENSE"), &folder.join("LICENSE"))?;
        tree::move_file(&folder.join("share/doc/panoscope/README.md"), &folder.join("README.md"))?;
        let file = dir.join(format!("{name}.tar.gz"));
        let mut tar = Command::new("tar");
        tar.args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "--gzip", "--create"]);
        tar.arg(format!("--mtime=@{}", self.time_s)).arg("--directory").arg(dir).arg("--file").arg(&file).arg(&name);
        run(&mut tar)?;
        fs::remove_dir_all(&folder)?;
        Ok(file)
    }

    /// A file that packages have and the repository keeps beside this program.
    fn source(&self, name: &str) -> PathBuf {
        self.workspace.root.join("core/xtask/package").join(name)
    }
}

/// Seconds since 1970 of the commit; 0 where it is not known.
fn commit_time_s(workspace: &Workspace) -> u64 {
    let time = capture(Command::new("git").current_dir(&workspace.root).args(["log", "-1", "--format=%ct"]));
    time.ok().and_then(|text| text.trim().parse().ok()).unwrap_or(0)
}
