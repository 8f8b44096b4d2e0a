//! The Debian package.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, bail};

use super::tree::{copy, copy_tree, md5sums, set_modes, total_bytes, write};
use super::{PLACED, Release};
use crate::install::binaries;
use crate::install::{self, Kind, LIBRARY};
use crate::process::{capture, run};

/// GStreamer's elements are loaded at run time, so that `dpkg-shlibdeps` does not see their packages: those that all
/// cameras and files need.
const DEPENDS: &str = "gstreamer1.0-plugins-base, gstreamer1.0-plugins-good";

/// Packages of codecs, of libraries that the windows load, and of programs that users start.
const RECOMMENDS: &str = "ffmpeg, gstreamer1.0-libav, gstreamer1.0-nice, gstreamer1.0-plugins-bad, gstreamer1.0-plugins-ugly, gstreamer1.0-rtsp, \
                          libegl1, libgl1, libvulkan1, libwayland-client0, libx11-6, libx11-xcb1, libxcursor1, libxi6, libxkbcommon-x11-0, libxkbcommon0, \
                          libxrandr2, v4l-utils";

const DESCRIPTION: &str = "stereo endoscope panoramas, depth and guidance
 Panoscope runs graphs of image-processing nodes on the live pictures of two
 endoscope cameras: stitching, disparity, 3-D measurement, tool detection and
 control of a robot arm. Nodes are plugins, graphs are TOML files.
 .
 It is research software and no medical device.
";

/// Sizes of the icon as PNG, px; window managers without SVG use them.
const ICON_SIZES_PX: [u32; 5] = [16, 32, 48, 128, 256];

/// Maintainer of the package, as `Name <address>`: from `DEBEMAIL` and `DEBFULLNAME` as for Debian's tools, else git's
/// user.
///
/// # Errors
/// Neither has an address.
pub fn maintainer() -> Result<String> {
    let variable = |name: &str| std::env::var(name).ok().filter(|value| !value.trim().is_empty());
    let git = |key: &str| {
        let value = capture(Command::new("git").args(["config", key])).ok()?;
        Some(value.trim().to_owned()).filter(|value| !value.is_empty())
    };
    let (name, address) = (variable("DEBFULLNAME"), variable("DEBEMAIL"));
    match field(name.or_else(|| git("user.name")), address.or_else(|| git("user.email"))) {
        Some(maintainer) => Ok(maintainer),
        None => {
            bail!("a package needs a maintainer: set DEBEMAIL=\"Name <address>\", or git's user.name and user.email")
        }
    }
}

/// `Name <address>`, where the address may include the name.
fn field(name: Option<String>, address: Option<String>) -> Option<String> {
    let address = address.filter(|address| address.contains('@'))?;
    if address.ends_with('>') {
        return Some(address);
    }
    Some(format!("{} <{address}>", name?))
}

impl Release<'_> {
    /// Writes the package into `dir`.
    pub fn deb(&self, dir: &Path, maintainer: &str) -> Result<PathBuf> {
        let root = dir.join("deb");
        let _ = fs::remove_dir_all(&root);
        let prefix = root.join("usr");
        self.lay_out(&root, &prefix, maintainer)?;
        let architecture = capture(Command::new("dpkg").arg("--print-architecture"))?.trim().to_owned();
        let depends = format!("{}, {DEPENDS}", self.libraries(dir, &prefix)?);
        let size_kib = total_bytes(&root)?.div_ceil(1024);
        let text = format!(
            "Package: panoscope\nVersion: {}\nArchitecture: {architecture}\nMaintainer: {maintainer}\n\
             Installed-Size: {size_kib}\nDepends: {depends}\nRecommends: {RECOMMENDS}\nSection: science\nPriority: optional\n\
             Description: {DESCRIPTION}",
            self.version
        );
        write(&root.join("DEBIAN/control"), &text)?;
        write(&root.join("DEBIAN/md5sums"), &md5sums(&root)?)?;
        set_modes(&root, &format!("usr/{LIBRARY}"))?;
        let file = dir.join(format!("panoscope_{}_{architecture}.deb", self.version));
        let mut build = Command::new("dpkg-deb");
        build.env("SOURCE_DATE_EPOCH", self.time_s.to_string());
        build.args(["--root-owner-group", "-Zxz", "--build"]).arg(&root).arg(&file);
        capture(&mut build)?;
        fs::remove_dir_all(&root)?;
        Ok(file)
    }

    /// Creates the tree, with the files that only a package manager can install.
    fn lay_out(&self, root: &Path, prefix: &Path, maintainer: &str) -> Result<()> {
        let share = prefix.join("share");
        copy_tree(&self.tree, prefix)?;
        install::mark(prefix, Kind::Package)?;
        for name in ["panoscope-editor.desktop", "panoscope-theatre.desktop"] {
            copy(&self.source(name), &share.join("applications").join(name))?;
        }
        let icons = share.join("icons/hicolor");
        let drawing = self.source("panoscope.svg");
        copy(&drawing, &icons.join("scalable/apps/panoscope.svg"))?;
        for size_px in ICON_SIZES_PX {
            let picture = icons.join(format!("{size_px}x{size_px}/apps/panoscope.png"));
            super::tree::make_parent(&picture)?;
            let size = size_px.to_string();
            let mut convert = Command::new("rsvg-convert");
            convert.args(["--width", &size, "--height", &size, "--output"]).arg(&picture).arg(&drawing);
            run(&mut convert)?;
        }
        let doc = share.join("doc/panoscope");
        for (name, folder) in PLACED.into_iter().zip(["usr/lib/udev/rules.d", "usr/lib/systemd/system"]) {
            fs::remove_file(doc.join(name))?;
            copy(&self.source(name), &root.join(folder).join(name))?;
        }
        copy(&self.source("lintian-overrides"), &share.join("lintian/overrides/panoscope"))?;
        let date = capture(Command::new("date").args(["--utc", "--rfc-email", &format!("--date=@{}", self.time_s)]))?;
        let entry = format!(
            "panoscope ({}) unstable; urgency=medium\n\n  * Release {}.\n\n -- {maintainer}  {}\n",
            self.version,
            self.version,
            date.trim()
        );
        write(&doc.join("changelog"), &entry)?;
        run(Command::new("gzip").args(["-9", "--no-name"]).arg(doc.join("changelog")))
    }

    /// Debian packages of the libraries that the programs are linked with.
    fn libraries(&self, dir: &Path, prefix: &Path) -> Result<String> {
        let source = dir.join("shlibdeps");
        write(&source.join("debian/control"), "Source: panoscope\n\nPackage: panoscope\nArchitecture: any\n")?;
        let mut command = Command::new("dpkg-shlibdeps");
        command.current_dir(&source).args(["-O", "--warnings=0"]);
        command.arg(format!("-l{}", prefix.join(LIBRARY).join("onnxruntime").display()));
        command.args(binaries(self.workspace, prefix));
        let text = capture(&mut command)?;
        fs::remove_dir_all(&source)?;
        let Some(depends) = text.lines().find_map(|line| line.strip_prefix("shlibs:Depends=")) else {
            bail!("dpkg-shlibdeps named no libraries: {text}");
        };
        Ok(depends.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_maintainer_has_a_name_and_an_address() {
        let some = |text: &str| Some(text.to_owned());
        assert_eq!(field(some("A B"), some("a@b.org")).as_deref(), Some("A B <a@b.org>"));
        assert_eq!(field(None, some("A B <a@b.org>")).as_deref(), Some("A B <a@b.org>"));
        assert_eq!(field(some("C"), some("A B <a@b.org>")).as_deref(), Some("A B <a@b.org>"));
        assert_eq!(field(some("A B"), None), None);
        assert_eq!(field(None, some("a@b.org")), None);
        assert_eq!(field(some("A B"), some("nobody")), None);
    }

    #[test]
    fn fields_hold_no_line_that_ends_them() {
        assert!(DESCRIPTION.lines().skip(1).all(|line| line.starts_with(' ')));
        for list in [DEPENDS, RECOMMENDS] {
            let mut names: Vec<&str> = list.split(", ").collect();
            assert!(names.iter().all(|name| !name.is_empty() && !name.contains(char::is_whitespace)), "{list}");
            let sorted = names.is_sorted();
            names.dedup();
            assert!(sorted && names.len() == list.split(", ").count(), "{list}");
        }
    }
}
