//! Installs the system packages that are missing, or prints how to get them.

use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::packages::{Package, Purpose, missing};
use crate::process;
use crate::system::System;

/// Result of `ensure`.
#[derive(Debug, PartialEq, Eq)]
pub enum Outcome {
    NothingMissing,
    Installed,
    /// Only optional packages are still missing; a line named them.
    GoesWithout,
}

/// Ensures that the packages of these purposes are installed. Silent and fast if they are.
pub fn ensure(purposes: &[Purpose]) -> Result<Outcome> {
    let system = System::current();
    let absent = missing(system, purposes);
    if absent.is_empty() {
        return Ok(Outcome::NothingMissing);
    }
    if system != System::Debian {
        return without(system, &absent, None);
    }
    let Some(root) = Root::available() else {
        let why = "this user may not install packages (neither root, nor is there sudo)";
        return without(system, &absent, Some(why.to_owned()));
    };
    println!("Installing what is missing with apt-get (this can take minutes): {}", names(system, &absent));
    // A foreign source that does not answer fails the update, and the packages may still be had from the others.
    let updated = root.apt_get(&["update", "-qq"]);
    if let Err(error) = install(&root, &absent) {
        let why = [updated.err(), Some(error)].into_iter().flatten().map(|error| format!("{error:#}"));
        return without(system, &missing(system, purposes), Some(why.collect::<Vec<_>>().join("\n")));
    }
    match missing(system, purposes) {
        rest if rest.is_empty() => Ok(Outcome::Installed),
        rest => without(system, &rest, Some("apt-get installed them, yet they are not found".to_owned())),
    }
}

fn install(root: &Root, packages: &[&Package]) -> Result<()> {
    let install = |packages: &[&Package]| {
        // Containers often leave documentation out, and opencv-doc's images with it; `--reinstall` mends an empty one.
        let mut args = vec!["install", "-qq", "-y", "--no-install-recommends", "--reinstall"];
        args.extend(["-o", "Dpkg::Options::=--path-include=/usr/share/doc/opencv-doc/*"]);
        args.extend(packages.iter().map(|package| package.debian));
        root.apt_get(&args)
    };
    let needed: Vec<&Package> = packages.iter().copied().filter(|package| !package.purpose.is_optional()).collect();
    match install(packages) {
        // One package that a distribution lacks must not keep the needed ones away.
        Err(_) if !needed.is_empty() && needed.len() < packages.len() => install(&needed),
        outcome => outcome,
    }
}

/// Returns an error if a required package is missing, else prints the missing optional ones.
fn without(system: System, absent: &[&Package], why: Option<String>) -> Result<Outcome> {
    let (optional, needed): (Vec<&Package>, Vec<&Package>) =
        absent.iter().copied().partition(|package| package.purpose.is_optional());
    if !needed.is_empty() {
        let why = why.map_or(String::new(), |why| format!("\nreason: {why}"));
        bail!("missing: {}\nto install: {}{why}", names(System::Debian, &needed), advice(system, &needed));
    }
    if !optional.is_empty() {
        let is_for = |purpose| optional.iter().any(|package| package.purpose == purpose);
        let effect =
            if is_for(Purpose::Test) { "tests that need it skip" } else { "packages are not checked in a bare system" };
        eprintln!("note: going on without {} ({effect})", names(System::Debian, &optional));
        if let Some(why) = why {
            eprintln!("note: {}", process::tail(&why, 3));
        }
    }
    Ok(Outcome::GoesWithout)
}

fn names(system: System, packages: &[&Package]) -> String {
    let mut names: Vec<&str> = packages.iter().filter_map(|package| package.name_on(system)).collect();
    names.dedup();
    names.join(" ")
}

/// The command to install packages, or their names if the package manager is unknown.
fn advice(system: System, packages: &[&Package]) -> String {
    match system.install_command() {
        Some(command) => format!("{command} {}", names(system, packages)),
        None => "OpenCV 4 with its contrib modules and headers, clang with libclang, a C++ compiler and pkg-config, \
                 from this system's packages (the names above are Debian's)"
            .to_owned(),
    }
}

/// How to become root for installing packages.
enum Root {
    Already,
    Sudo,
}

/// Runs apt-get so that no package starts a service, now or at the next boot; tests start their own servers.
const WITHOUT_SERVICES: &str = r#"
policy=/usr/sbin/policy-rc.d
if [ ! -e $policy ]; then
    trap 'rm -f $policy' EXIT
    trap 'exit 1' HUP INT TERM
    printf '#!/bin/sh\nexit 101\n' > $policy && chmod 755 $policy
fi
fresh=
for service in orthanc prometheus; do
    [ -e /lib/systemd/system/$service.service ] || fresh="$fresh $service"
done
apt-get "$@" || exit
for service in $fresh; do
    if [ -e /lib/systemd/system/$service.service ]; then
        rm -f /etc/systemd/system/multi-user.target.wants/$service.service
    fi
done
"#;

impl Root {
    fn available() -> Option<Self> {
        let id = process::capture(Command::new("id").arg("-u")).ok()?;
        if id.trim() == "0" {
            return Some(Self::Already);
        }
        process::find_program("sudo").map(|_| Self::Sudo)
    }

    fn apt_get(&self, args: &[&str]) -> Result<()> {
        let mut command = match self {
            Self::Already => Command::new("env"),
            Self::Sudo => {
                let mut sudo = Command::new("sudo");
                if !std::io::IsTerminal::is_terminal(&std::io::stdin()) {
                    // Nobody could type a password: fail instead of waiting.
                    sudo.arg("-n");
                }
                sudo.arg("env");
                sudo
            }
        };
        command.args(["DEBIAN_FRONTEND=noninteractive", "sh", "-c", WITHOUT_SERVICES, "sh"]);
        command.args(["-o", "DPkg::Lock::Timeout=120"]).args(args);
        process::capture(&mut command).map(drop).context("apt-get could not finish")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packages::PACKAGES;

    fn named(debian: &[&str]) -> Vec<&'static Package> {
        PACKAGES.iter().filter(|package| debian.contains(&package.debian)).collect()
    }

    #[test]
    fn a_missing_compiler_is_an_error_that_says_how_to_get_it() {
        let absent = named(&["g++", "libopencv-dev", "libopencv-contrib-dev"]);
        let text = without(System::Fedora, &absent, None).unwrap_err().to_string();
        assert!(text.contains("missing: g++ libopencv-dev libopencv-contrib-dev"), "{text}");
        assert!(text.contains("dnf install gcc-c++ opencv-devel"), "{text}");
        let text = without(System::Other, &absent, Some("no network".to_owned())).unwrap_err().to_string();
        assert!(text.contains("OpenCV 4") && text.contains("no network"), "{text}");
    }

    #[test]
    fn missing_test_data_is_no_error() {
        assert_eq!(without(System::Arch, &named(&["opencv-doc"]), None).unwrap(), Outcome::GoesWithout);
    }
}
