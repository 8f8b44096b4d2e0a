//! The Python package as a wheel: an installation inside the package's folder.
//!
//! A wheel is a zip file with a list of its files. It has the package, its native part, and in `panoscope/installation`
//! an installation as `cargo xtask install` makes it, without the windows.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use super::tree::{copy, copy_tree, files, write};
use super::{check::obstacle, commit_time_s, sbom};
use crate::build::{Built, Means, Profile, build, program_name, python_package};
use crate::install::{self, Kind, LIBRARY, Tree, strip};
use crate::process::{capture, run};
use crate::workspace::Workspace;
use crate::{licences, onnxruntime};

/// Requirement of the package in `pip` syntax.
const REQUIREMENT: &str = "numpy>=1.24,<3";
/// Requirement of `Recording.to_rerun`.
const RERUN: &str = "rerun-sdk>=0.41";
/// Minimum Python version of the native part.
const PYTHON: &str = "3.9";
/// Ticks that a check compares.
const FRAMES: u32 = 20;

/// A wheel and its sources.
pub struct Wheel {
    file: PathBuf,
    built: Built,
}

/// Builds and writes `panoscope-VERSION-cp39-abi3-manylinux_2_N_ARCH.whl` into `dir`.
///
/// # Errors
/// The build fails, `python3` or `strip` is missing, ONNX Runtime cannot be fetched, or a file cannot be written.
pub fn wheel(workspace: &Workspace, dir: &Path, profile: Profile) -> Result<Wheel> {
    fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
    let dir = &dir.canonicalize()?;
    let built = build(workspace, profile)?;
    let runtime = onnxruntime::fetch(workspace)?;
    let stage = dir.join("stage");
    let _ = fs::remove_dir_all(&stage);
    let package = stage.join("panoscope");
    let prefix = package.join("installation");
    // Copies: they are stripped.
    Tree { built: &built, windows: None, runtime: Some(&runtime) }.put_into(workspace, &prefix, Means::Copy)?;
    install::mark(&prefix, Kind::Wheel)?;
    // A zip has no links; pip makes the command.
    fs::remove_dir_all(prefix.join("bin"))?;
    let inner = python_package(&prefix.join(LIBRARY).join(program_name()));
    copy_tree(&inner, &package)?;
    fs::remove_dir_all(&inner)?;
    copy(&workspace.root.join("core/xtask/package/wheel_package.py"), &inner.join("__init__.py"))?;
    let binaries = elf_files(&stage)?;
    binaries.iter().try_for_each(|file| strip(file))?;
    let version = env!("CARGO_PKG_VERSION");
    let minor = binaries.iter().map(|file| Ok(newest_glibc(&fs::read(file)?))).collect::<Result<Vec<_>>>()?;
    let minor = minor.into_iter().max().flatten().context("no program refers to a version of the C library")?;
    let tag = format!("cp{}-abi3-manylinux_2_{minor}_{}", PYTHON.replace('.', ""), std::env::consts::ARCH);
    add_metadata(workspace, &stage.join(format!("panoscope-{version}.dist-info")), version, &tag)?;
    let file = dir.join(format!("panoscope-{version}-{tag}.whl"));
    let mut zip = Command::new("python3");
    zip.arg(workspace.root.join("core/xtask/package/write_wheel.py")).arg(&stage).arg(&file);
    run(zip.arg(commit_time_s(workspace).to_string()))?;
    fs::remove_dir_all(&stage)?;
    println!("{}", file.display());
    Ok(Wheel { file, built })
}

/// Adds the metadata for pip.
fn add_metadata(workspace: &Workspace, folder: &Path, version: &str, tag: &str) -> Result<()> {
    let introduction = fs::read_to_string(workspace.root.join("core/python/README.md"))?;
    let metadata = format!(
        "Metadata-Version: 2.1\nName: panoscope\nVersion: {version}\n\
         Summary: Graphs of image-processing nodes on stereo endoscope pictures: panoramas, depth, instruments\n\
         License: MIT OR Apache-2.0\nRequires-Python: >={PYTHON}\nRequires-Dist: {REQUIREMENT}\n\
         Provides-Extra: rerun\nRequires-Dist: {RERUN}; extra == \"rerun\"\n\
         Description-Content-Type: text/markdown\n\n{introduction}"
    );
    write(&folder.join("METADATA"), &metadata)?;
    let wheel = format!("Wheel-Version: 1.0\nGenerator: panoscope xtask\nRoot-Is-Purelib: false\nTag: {tag}\n");
    write(&folder.join("WHEEL"), &wheel)?;
    write(&folder.join("entry_points.txt"), "[console_scripts]\npanoscope = panoscope.installation:main\n")?;
    copy(&workspace.root.join("LICENSE"), &folder.join("licenses/LICENSE"))?;
    write(&folder.join("sboms").join(sbom::FILE), &sbom::bill(workspace)?)?;
    write(&folder.join("licenses/third-party-notices"), &licences::notices(workspace)?)
}

/// The programs and libraries below a folder.
fn elf_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for file in files(folder)?.into_iter().map(|file| folder.join(file)) {
        let mut start = [0; 4];
        let read = std::io::Read::read(&mut fs::File::open(&file)?, &mut start)?;
        if start[..read] == *b"\x7fELF" {
            found.push(file);
        }
    }
    Ok(found)
}

/// N of the newest `GLIBC_2.N` in the strings of a program or library, which has one for each version that it needs.
fn newest_glibc(elf: &[u8]) -> Option<u32> {
    const NAME: &[u8] = b"GLIBC_2.";
    let version = |at: usize| {
        let digits: Vec<u8> = elf[at + NAME.len()..].iter().copied().take_while(u8::is_ascii_digit).take(3).collect();
        String::from_utf8(digits).ok()?.parse().ok()
    };
    let names = (0..elf.len().saturating_sub(NAME.len())).filter(|&at| elf[at] == b'G' && elf[at..].starts_with(NAME));
    names.filter_map(version).max()
}

/// Installs the wheel into an empty environment in a minimal Debian below `dir` and compares outputs of graphs there
/// with the command here. The Debian stays for the next check. If the check is impossible, a line gives the reason.
///
/// # Errors
/// A step failed, or fingerprints differ.
pub fn check_wheel(workspace: &Workspace, wheel: &Wheel, dir: &Path) -> Result<()> {
    if let Some(reason) = obstacle(&["debootstrap", "unshare", "chroot"]) {
        println!("not checked, the wheel was not installed: {reason}");
        return Ok(());
    }
    let dir = &dir.canonicalize()?;
    let wheels = dir.join("wheels");
    let mut download = Command::new("python3");
    download.args(["-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--only-binary=:all:"]);
    // Debian 12 has this Python.
    download.args(["--implementation", "cp", "--python-version", "311", "--platform"]);
    download.arg(format!("manylinux2014_{}", std::env::consts::ARCH)).arg("--platform");
    download.arg(format!("manylinux_2_28_{}", std::env::consts::ARCH)).arg("--dest").arg(&wheels).arg(REQUIREMENT);
    if let Err(error) = capture(&mut download) {
        println!("not checked, NumPy was not fetched: {error:#}");
        return Ok(());
    }
    let scripts = workspace.root.join("core/xtask/package");
    let mut inside = Command::new("unshare");
    inside.args(["--mount", "sh", "-eu"]).arg(scripts.join("check_wheel.sh")).arg(&wheel.file).arg(&wheels).arg(dir);
    run(inside.arg(scripts.join("check_wheel.py")).arg(FRAMES.to_string())).context("the wheel failed its check")?;
    let digests = dir.join("command.json");
    let mut record = wheel.built.panoscope();
    record.current_dir(dir).arg("record").arg(workspace.root.join("graphs/panorama.toml"));
    record.args(["--headless", "--unpaced", "--all-ports", "--frames", &FRAMES.to_string(), "--output"]);
    capture(record.arg(dir.join("command.mcap")).arg("--digests").arg(&digests))?;
    let count = compare(&fs::read_to_string(dir.join("fingerprints.json"))?, &fs::read_to_string(digests)?)?;
    println!("{count} arrays of the wheel are those of the command");
    Ok(())
}

/// Compares fingerprints by output and tick with those of the command; returns their number.
fn compare(mine: &str, command: &str) -> Result<usize> {
    // The panorama comes out of a part.
    const NAMES: [(&str, &str); 2] = [("scope.left", "scope.left"), ("wide.panorama", "wide/composite.panorama")];
    let (mine, command): (serde_json::Value, serde_json::Value) =
        (serde_json::from_str(mine)?, serde_json::from_str(command)?);
    let mut count = 0;
    for (output, port) in NAMES {
        let packets = command["ports"][port]["packets"].as_array().with_context(|| format!("no packets of {port}"))?;
        if packets.len() != FRAMES as usize {
            bail!("the command made {} packets of {port}, not {FRAMES}", packets.len());
        }
        for packet in packets {
            let (tick, wanted) = (&packet[1], &packet[2]);
            let got = &mine[output][tick.to_string()];
            if got != wanted {
                bail!("{output} at tick {tick} has the fingerprint {got} in the wheel, {wanted} by the command");
            }
            count += 1;
        }
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_version_of_the_c_library_counts() {
        assert_eq!(newest_glibc(b"\0GLIBC_2.2.5\0GLIBC_2.34\0GLIBC_2.9\0GLIBC_PRIVATE\0"), Some(34));
        assert_eq!(newest_glibc(b"GLIBC_2."), None);
        assert_eq!(newest_glibc(b""), None);
    }

    #[test]
    fn fingerprints_that_differ_are_named() {
        let packets = |hash: &str| {
            let all: Vec<_> = (0..FRAMES).map(|tick| serde_json::json!([0, tick, hash])).collect();
            serde_json::json!({"ports": {"scope.left": {"packets": all}, "wide/composite.panorama": {"packets": all}}})
        };
        let of =
            |hash: &str| (0..FRAMES).map(|tick| (tick.to_string(), hash.into())).collect::<serde_json::Map<_, _>>();
        let mine = serde_json::json!({"scope.left": of("0a"), "wide.panorama": of("0a")}).to_string();
        assert_eq!(compare(&mine, &packets("0a").to_string()).unwrap(), 2 * FRAMES as usize);
        let error = compare(&mine, &packets("0b").to_string()).unwrap_err().to_string();
        assert!(error.contains("scope.left at tick 0"), "{error}");
    }
}
