//! Makes packages of a release build: a Debian package and a folder in a tar file that runs from anywhere.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::build::{library_name, program_name, window_names};
use crate::process::{capture, run};
use crate::workspace::Workspace;
use crate::{install, onnxruntime};

/// Programs whose libraries are loaded at run time, so that `dpkg-shlibdeps` does not see them.
const RECOMMENDS: &str = "ffmpeg, libegl1, libgl1, libwayland-client0, libx11-6, libx11-xcb1, libxcursor1, libxi6, libxkbcommon-x11-0, \
                          libxkbcommon0, libxrandr2, v4l-utils";

const DESCRIPTION: &str = "stereo endoscope panoramas, depth and guidance
 Panoscope runs graphs of image-processing nodes on the live pictures of two
 endoscope cameras: stitching, disparity, 3-D measurement, tool detection and
 control of a robot arm. Nodes are plugins, graphs are TOML files.
 .
 It is research software and no medical device.
";

/// What a package is made of.
pub struct Release<'a> {
    pub workspace: &'a Workspace,
    pub version: String,
    /// Seconds since 1970 for all files, so that the same commit gives the same package.
    pub time_s: u64,
    /// The tree that `install` made.
    pub tree: PathBuf,
    /// Manual pages and completions.
    pub generated: PathBuf,
}

/// Builds in release and writes `panoscope_VERSION_ARCH.deb` and `panoscope-VERSION-ARCH.tar.gz` into `dir`.
///
/// # Errors
/// The build fails, a program of Debian's `dpkg-dev` or `binutils` is missing, or a file cannot be written.
pub fn package(workspace: &Workspace, dir: &Path) -> Result<()> {
    fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
    let dir = &dir.canonicalize()?;
    let tree = dir.join("tree");
    let _ = fs::remove_dir_all(&tree);
    install::install(workspace, &tree)?;
    let release = Release::new(workspace, dir, tree)?;
    for file in [release.tar(dir)?, release.deb(dir)?] {
        println!("{}", file.display());
    }
    Ok(())
}

impl<'a> Release<'a> {
    /// Strips the programs of an installed tree and writes its manual pages and completions.
    pub fn new(workspace: &'a Workspace, dir: &Path, tree: PathBuf) -> Result<Self> {
        for file in binaries(workspace, &tree) {
            run(Command::new("strip").args(["--strip-unneeded", "--remove-section=.comment"]).arg(&file))?;
        }
        let generated = dir.join("generated");
        let _ = fs::remove_dir_all(&generated);
        run(Command::new(tree.join(program_name())).arg("generate").arg(&generated))?;
        let time = capture(Command::new("git").current_dir(&workspace.root).args(["log", "-1", "--format=%ct"]));
        let time_s = time.ok().and_then(|text| text.trim().parse().ok()).unwrap_or(0);
        Ok(Self { workspace, version: env!("CARGO_PKG_VERSION").to_owned(), time_s, tree, generated })
    }

    /// The tree in a tar file.
    pub fn tar(&self, dir: &Path) -> Result<PathBuf> {
        let name = format!("panoscope-{}-{}", self.version, std::env::consts::ARCH);
        let folder = dir.join(&name);
        let _ = fs::remove_dir_all(&folder);
        copy_tree(&self.tree, &folder)?;
        copy_tree(&self.generated, &folder.join("share"))?;
        copy(&self.workspace.root.join("LICENSE"), &folder.join("LICENSE"))?;
        copy(&self.workspace.root.join("README.md"), &folder.join("README.md"))?;
        let file = dir.join(format!("{name}.tar.gz"));
        let mut tar = Command::new("tar");
        tar.args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "--gzip", "--create"]);
        tar.arg(format!("--mtime=@{}", self.time_s)).arg("--directory").arg(dir).arg("--file").arg(&file).arg(&name);
        run(&mut tar)?;
        fs::remove_dir_all(&folder)?;
        Ok(file)
    }

    /// The Debian package.
    pub fn deb(&self, dir: &Path) -> Result<PathBuf> {
        let root = dir.join("deb");
        let _ = fs::remove_dir_all(&root);
        let library = root.join("usr/lib/panoscope");
        self.lay_out_deb(&root, &library)?;
        let architecture = capture(Command::new("dpkg").arg("--print-architecture"))?.trim().to_owned();
        let depends = self.depends(dir, &library)?;
        let control = root.join("DEBIAN");
        let size_kib = total_bytes(&root)?.div_ceil(1024);
        let text = format!(
            "Package: panoscope\nVersion: {}\nArchitecture: {architecture}\nMaintainer: {MAINTAINER}\n\
             Installed-Size: {size_kib}\nDepends: {depends}\nRecommends: {RECOMMENDS}\nSection: science\nPriority: optional\n\
             Description: {DESCRIPTION}",
            self.version
        );
        write(&control.join("control"), &text)?;
        write(&control.join("md5sums"), &md5sums(&root)?)?;
        set_modes(&root)?;
        let file = dir.join(format!("panoscope_{}_{architecture}.deb", self.version));
        let mut build = Command::new("dpkg-deb");
        build.env("SOURCE_DATE_EPOCH", self.time_s.to_string());
        build.args(["--root-owner-group", "-Zxz", "--build"]).arg(&root).arg(&file);
        capture(&mut build)?;
        fs::remove_dir_all(&root)?;
        Ok(file)
    }

    fn lay_out_deb(&self, root: &Path, library: &Path) -> Result<()> {
        let package = self.workspace.root.join("core/xtask/package");
        let share = root.join("usr/share");
        copy_tree(&self.tree, library)?;
        fs::create_dir_all(&share)?;
        copy_tree(&library.join("graphs"), &share.join("panoscope/graphs"))?;
        fs::remove_dir_all(library.join("graphs"))?;
        // Graphs name models as `../plugins/...`.
        symlink("../../lib/panoscope/plugins", share.join("panoscope/plugins"))?;
        let doc = share.join("doc/panoscope");
        fs::create_dir_all(&doc)?;
        for file in fs::read_dir(library.join("onnxruntime")).into_iter().flatten().flatten() {
            if !file.file_name().to_string_lossy().contains(".so") {
                let name = format!("onnxruntime-{}", file.file_name().to_string_lossy());
                copy(&file.path(), &doc.join(name))?;
                fs::remove_file(file.path())?;
            }
        }
        for model in markdown_files(&library.join("plugins"))? {
            copy(&model, &doc.join(model.file_name().unwrap_or_default()))?;
            fs::remove_file(&model)?;
        }
        fs::create_dir_all(root.join("usr/bin"))?;
        for program in std::iter::once(program_name()).chain(window_names()) {
            symlink(format!("../lib/panoscope/{program}"), root.join("usr/bin").join(&program))?;
        }
        for name in ["panoscope-editor.desktop", "panoscope-theatre.desktop"] {
            copy(&package.join(name), &share.join("applications").join(name))?;
        }
        copy(&package.join("panoscope.svg"), &share.join("icons/hicolor/scalable/apps/panoscope.svg"))?;
        copy(&package.join("70-panoscope.rules"), &root.join("usr/lib/udev/rules.d/70-panoscope.rules"))?;
        copy(&package.join("lintian-overrides"), &share.join("lintian/overrides/panoscope"))?;
        let completions = self.generated.join("completions");
        copy(&completions.join("panoscope.bash"), &share.join("bash-completion/completions/panoscope"))?;
        copy(&completions.join("_panoscope"), &share.join("zsh/vendor-completions/_panoscope"))?;
        copy(&completions.join("panoscope.fish"), &share.join("fish/vendor_completions.d/panoscope.fish"))?;
        copy_tree(&self.generated.join("man"), &share.join("man/man1"))?;
        for window in window_names() {
            let page = share.join("man/man1").join(format!("{window}.1"));
            copy(&package.join(format!("{window}.1")), &page)?;
        }
        for page in fs::read_dir(share.join("man/man1"))?.flatten() {
            run(Command::new("gzip").args(["-9", "--no-name", "--force"]).arg(page.path()))?;
        }
        copy(&self.workspace.root.join("README.md"), &doc.join("README.md"))?;
        copy(&package.join("copyright"), &doc.join("copyright"))?;
        let date = capture(Command::new("date").args(["--utc", "--rfc-email", &format!("--date=@{}", self.time_s)]))?;
        let entry = format!(
            "panoscope ({}) unstable; urgency=medium\n\n  * Release {}.\n\n -- {MAINTAINER}  {}\n",
            self.version,
            self.version,
            date.trim()
        );
        write(&doc.join("changelog"), &entry)?;
        run(Command::new("gzip").args(["-9", "--no-name"]).arg(doc.join("changelog")))
    }

    /// The packages whose libraries the programs need.
    fn depends(&self, dir: &Path, library: &Path) -> Result<String> {
        let source = dir.join("shlibdeps");
        write(&source.join("debian/control"), "Source: panoscope\n\nPackage: panoscope\nArchitecture: any\n")?;
        let mut command = Command::new("dpkg-shlibdeps");
        command.current_dir(&source).args(["-O", "--warnings=0"]);
        command.arg(format!("-l{}", library.join("onnxruntime").display()));
        command.args(binaries(self.workspace, library));
        let text = capture(&mut command)?;
        fs::remove_dir_all(&source)?;
        let Some(depends) = text.lines().find_map(|line| line.strip_prefix("shlibs:Depends=")) else {
            bail!("dpkg-shlibdeps named no libraries: {text}");
        };
        Ok(depends.to_owned())
    }
}

/// Name and address in the package's fields.
const MAINTAINER: &str = "Panoscope maintainers <panoscope@example.org>";

/// Programs and libraries of an installed tree.
fn binaries(workspace: &Workspace, tree: &Path) -> Vec<PathBuf> {
    let programs = std::iter::once(program_name()).chain(window_names()).map(|name| tree.join(name));
    let plugins = workspace.plugins.iter().map(|plugin| tree.join("plugins").join(library_name(&plugin.name)));
    let runtime = fs::read_dir(tree.join("onnxruntime")).into_iter().flatten().flatten().map(|entry| entry.path());
    let runtime = runtime.filter(|path| path.to_string_lossy().contains(onnxruntime::LIBRARY));
    programs.chain(plugins).chain(runtime).filter(|path| path.is_file()).collect()
}

fn markdown_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?.flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(markdown_files(&path)?);
        } else if path.extension().is_some_and(|extension| extension == "md") {
            found.push(path);
        }
    }
    Ok(found)
}

fn write(path: &Path, text: &str) -> Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    fs::copy(from, to).with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
    Ok(())
}

fn copy_tree(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to).with_context(|| format!("cannot make {}", to.display()))?;
    for entry in fs::read_dir(from).with_context(|| format!("cannot read {}", from.display()))? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy_tree(&entry.path(), &target)?;
        } else {
            copy(&entry.path(), &target)?;
        }
    }
    Ok(())
}

/// Files below a folder with their paths from there, in order of names. Follows no links.
fn files(root: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder)? {
            let entry = entry?;
            let kind = entry.file_type()?;
            if kind.is_dir() {
                folders.push(entry.path());
            } else if kind.is_file() {
                found.push(entry.path().strip_prefix(root)?.to_owned());
            }
        }
    }
    found.sort();
    Ok(found)
}

fn total_bytes(root: &Path) -> Result<u64> {
    files(root)?.iter().map(|file| Ok(fs::metadata(root.join(file))?.len())).sum()
}

fn md5sums(root: &Path) -> Result<String> {
    let mut command = Command::new("md5sum");
    command.current_dir(root).args(files(root)?.iter().filter(|file| !file.starts_with("DEBIAN")));
    capture(&mut command)
}

/// Folders and programs 755, other files 644, as Debian's policy wants.
fn set_modes(root: &Path) -> Result<()> {
    for file in files(root)? {
        let path = root.join(&file);
        let is_program = file.parent().is_some_and(|folder| folder.ends_with("usr/lib/panoscope"));
        fs::set_permissions(&path, fs::Permissions::from_mode(if is_program { 0o755 } else { 0o644 }))?;
        for folder in path.ancestors().skip(1).take_while(|folder| folder.starts_with(root)) {
            fs::set_permissions(folder, fs::Permissions::from_mode(0o755))?;
        }
    }
    Ok(())
}
