//! The system packages that Panoscope needs.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::process::find_program;
use crate::system::System;

/// Folder of Debian's opencv-doc with images for tests.
const OPENCV_DOC_DATA: &str = "/usr/share/doc/opencv-doc/examples/data";

/// Purpose of a package.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Compiling and running; required.
    Build,
    /// Data and programs for tests, which are otherwise skipped.
    Test,
    /// Fetching files from Python wheels.
    Wheels,
    /// Windows on a virtual screen, for screenshots and tests.
    Screens,
    /// Building packages.
    Package,
    /// A minimal system in which packages are checked; without it they are not.
    Check,
}

impl Purpose {
    /// Whether packages of this purpose are optional.
    pub fn is_optional(self) -> bool {
        matches!(self, Self::Test | Self::Check)
    }
}

/// How to detect a package without a package database.
enum Evidence {
    Program(&'static str),
    PkgConfig(&'static str),
    /// Name of an element for `gst-inspect-1.0`.
    GStreamer(&'static str),
    AnyFile(&'static [&'static str]),
    Libclang,
}

/// A package with its name on each system.
pub struct Package {
    pub debian: &'static str,
    fedora: Option<&'static str>,
    arch: Option<&'static str>,
    brew: Option<&'static str>,
    pub purpose: Purpose,
    evidence: Evidence,
}

impl Package {
    /// Its name on a system, if known.
    pub fn name_on(&self, system: System) -> Option<&'static str> {
        match system {
            System::Debian => Some(self.debian),
            System::Fedora => self.fedora,
            System::Arch => self.arch,
            System::MacOs => self.brew,
            System::Other => None,
        }
    }
}

const fn package(
    purpose: Purpose,
    debian: &'static str,
    others: [Option<&'static str>; 3],
    evidence: Evidence,
) -> Package {
    let [fedora, arch, brew] = others;
    Package { debian, fedora, arch, brew, purpose, evidence }
}

/// All packages, in the order of output.
pub static PACKAGES: &[Package] = &[
    package(Purpose::Build, "gcc", [Some("gcc"), Some("gcc"), Some("gcc")], Evidence::Program("cc")),
    package(Purpose::Build, "g++", [Some("gcc-c++"), Some("gcc"), Some("gcc")], Evidence::Program("c++")),
    package(
        Purpose::Build,
        "pkg-config",
        [Some("pkgconf-pkg-config"), Some("pkgconf"), Some("pkgconf")],
        Evidence::Program("pkg-config"),
    ),
    // The `opencv` crate reads OpenCV's headers through libclang and asks the program for the C++ include paths.
    package(Purpose::Build, "clang", [Some("clang"), Some("clang"), Some("llvm")], Evidence::Program("clang")),
    package(Purpose::Build, "libclang-dev", [Some("clang-devel"), Some("clang"), Some("llvm")], Evidence::Libclang),
    package(
        Purpose::Build,
        "libopencv-dev",
        [Some("opencv-devel"), Some("opencv"), Some("opencv")],
        Evidence::PkgConfig("opencv4"),
    ),
    package(
        Purpose::Build,
        "libopencv-contrib-dev",
        [Some("opencv-devel"), Some("opencv"), Some("opencv")],
        Evidence::AnyFile(&[
            "/usr/include/opencv4/opencv2/ximgproc.hpp",
            "/usr/local/include/opencv4/opencv2/ximgproc.hpp",
            "/opt/homebrew/include/opencv4/opencv2/ximgproc.hpp",
        ]),
    ),
    // Video in and out.
    package(
        Purpose::Build,
        "libgstreamer-plugins-base1.0-dev",
        [Some("gstreamer1-plugins-base-devel"), Some("gst-plugins-base"), Some("gstreamer")],
        Evidence::PkgConfig("gstreamer-app-1.0"),
    ),
    package(
        Purpose::Build,
        "libgstreamer-plugins-bad1.0-dev",
        [Some("gstreamer1-plugins-bad-free-devel"), Some("gst-plugins-bad-libs"), Some("gstreamer")],
        Evidence::PkgConfig("gstreamer-webrtc-1.0"),
    ),
    package(
        Purpose::Build,
        "libgstrtspserver-1.0-dev",
        [Some("gstreamer1-rtsp-server-devel"), Some("gst-rtsp-server"), Some("gstreamer")],
        Evidence::PkgConfig("gstreamer-rtsp-server-1.0"),
    ),
    package(
        Purpose::Build,
        "gstreamer1.0-plugins-base",
        [Some("gstreamer1-plugins-base"), Some("gst-plugins-base"), Some("gstreamer")],
        Evidence::GStreamer("videoconvert"),
    ),
    package(
        Purpose::Build,
        "gstreamer1.0-plugins-good",
        [Some("gstreamer1-plugins-good"), Some("gst-plugins-good"), Some("gstreamer")],
        Evidence::GStreamer("matroskamux"),
    ),
    package(
        Purpose::Build,
        "gstreamer1.0-plugins-bad",
        [Some("gstreamer1-plugins-bad-free"), Some("gst-plugins-bad"), Some("gstreamer")],
        Evidence::GStreamer("h264parse"),
    ),
    package(
        Purpose::Build,
        "gstreamer1.0-plugins-ugly",
        [Some("gstreamer1-plugins-ugly"), Some("gst-plugins-ugly"), Some("gstreamer")],
        Evidence::GStreamer("x264enc"),
    ),
    package(
        Purpose::Build,
        "gstreamer1.0-rtsp",
        [Some("gstreamer1-rtsp-server"), Some("gst-rtsp-server"), Some("gstreamer")],
        Evidence::GStreamer("rtspclientsink"),
    ),
    package(
        Purpose::Build,
        "gstreamer1.0-nice",
        [Some("libnice-gstreamer1"), Some("libnice"), Some("libnice-gstreamer")],
        Evidence::GStreamer("nicesrc"),
    ),
    package(
        Purpose::Build,
        "gstreamer1.0-libav",
        [Some("gstreamer1-plugin-libav"), Some("gst-libav"), Some("gstreamer")],
        Evidence::GStreamer("avdec_h264"),
    ),
    package(
        Purpose::Build,
        "gstreamer1.0-tools",
        [Some("gstreamer1"), Some("gstreamer"), Some("gstreamer")],
        Evidence::Program("gst-launch-1.0"),
    ),
    package(Purpose::Package, "dpkg-dev", [None, None, None], Evidence::Program("dpkg-shlibdeps")),
    package(
        Purpose::Package,
        "binutils",
        [Some("binutils"), Some("binutils"), Some("binutils")],
        Evidence::Program("strip"),
    ),
    package(Purpose::Package, "librsvg2-bin", [None, None, None], Evidence::Program("rsvg-convert")),
    package(
        Purpose::Check,
        "debootstrap",
        [Some("debootstrap"), Some("debootstrap"), None],
        Evidence::AnyFile(&["/usr/sbin/debootstrap", "/usr/bin/debootstrap"]),
    ),
    package(Purpose::Test, "opencv-doc", [None, None, None], Evidence::AnyFile(&[OPENCV_DOC_DATA])),
    package(
        Purpose::Test,
        "graphviz",
        [Some("graphviz"), Some("graphviz"), Some("graphviz")],
        Evidence::Program("dot"),
    ),
    package(Purpose::Test, "iproute2", [Some("iproute"), Some("iproute2"), None], Evidence::Program("ip")),
    package(
        Purpose::Test,
        "prometheus",
        [Some("golang-github-prometheus"), Some("prometheus"), Some("prometheus")],
        Evidence::Program("promtool"),
    ),
    package(
        Purpose::Test,
        "libopenigtlink-dev",
        [None, None, None],
        Evidence::AnyFile(&["/usr/include/openigtlink/igtlMessageBase.h"]),
    ),
    // An archive with a worklist server, tools that write and validate DICOM; 17 MB in all.
    package(Purpose::Test, "orthanc", [None, None, None], Evidence::Program("Orthanc")),
    package(Purpose::Test, "dcmtk", [Some("dcmtk"), None, Some("dcmtk")], Evidence::Program("dump2dcm")),
    package(Purpose::Test, "dicom3tools", [None, None, None], Evidence::Program("dciodvfy")),
    // A GPU that the processor plays.
    package(
        Purpose::Test,
        "libvulkan1",
        [Some("vulkan-loader"), Some("vulkan-icd-loader"), Some("vulkan-loader")],
        Evidence::PkgConfig("vulkan"),
    ),
    package(
        Purpose::Test,
        "mesa-vulkan-drivers",
        [Some("mesa-vulkan-drivers"), Some("vulkan-swrast"), None],
        Evidence::AnyFile(&[
            "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json",
            "/usr/share/vulkan/icd.d/lvp_icd.aarch64.json",
            "/usr/share/vulkan/icd.d/lvp_icd.json",
        ]),
    ),
    package(Purpose::Test, "chromium", [Some("chromium"), Some("chromium"), None], Evidence::Program("chromium")),
    package(
        Purpose::Wheels,
        "python3-pip",
        [Some("python3-pip"), Some("python-pip"), Some("python")],
        Evidence::Program("pip3"),
    ),
    package(
        Purpose::Screens,
        "xvfb",
        [Some("xorg-x11-server-Xvfb"), Some("xorg-server-xvfb"), None],
        Evidence::Program("Xvfb"),
    ),
    package(
        Purpose::Screens,
        "libgl1-mesa-dri",
        [Some("mesa-dri-drivers"), Some("mesa"), None],
        Evidence::AnyFile(&["/usr/lib/x86_64-linux-gnu/dri/swrast_dri.so", "/usr/lib64/dri/swrast_dri.so"]),
    ),
    package(Purpose::Screens, "libegl1", [Some("libglvnd-egl"), Some("libglvnd"), None], Evidence::PkgConfig("egl")),
    package(
        Purpose::Screens,
        "libxkbcommon-x11-0",
        [Some("libxkbcommon-x11"), Some("libxkbcommon-x11"), None],
        Evidence::PkgConfig("xkbcommon-x11"),
    ),
    package(
        Purpose::Screens,
        "libxcursor1",
        [Some("libXcursor"), Some("libxcursor"), None],
        Evidence::PkgConfig("xcursor"),
    ),
    package(Purpose::Screens, "libxi6", [Some("libXi"), Some("libxi"), None], Evidence::PkgConfig("xi")),
];

/// The packages of these purposes that are not installed.
pub fn missing(system: System, purposes: &[Purpose]) -> Vec<&'static Package> {
    let wanted = PACKAGES.iter().filter(|package| purposes.contains(&package.purpose));
    if system != System::Debian {
        return wanted.filter(|package| !shows(&package.evidence)).collect();
    }
    let wanted: Vec<_> = wanted.collect();
    let installed = installed_on_debian(&wanted);
    wanted
        .into_iter()
        .filter(|package| {
            if package.debian == "opencv-doc" && documentation_is_excluded() {
                return !shows(&package.evidence);
            }
            // A compiler from elsewhere serves as well as the distribution's.
            let from_elsewhere = matches!(package.evidence, Evidence::Program(_)) && shows(&package.evidence);
            !installed.contains(package.debian) && !from_elsewhere
        })
        .collect()
}

fn installed_on_debian(packages: &[&Package]) -> BTreeSet<String> {
    let mut command = Command::new("dpkg-query");
    command.args(["-W", "-f", "${Package} ${db:Status-Status}\\n"]).args(packages.iter().map(|package| package.debian));
    // It fails when one of the names is unknown, and still lists the others.
    let text = command.output().map(|output| output.stdout).unwrap_or_default();
    installed_names(&String::from_utf8_lossy(&text))
}

/// Names of installed packages in lines of `name status`.
fn installed_names(dpkg_query: &str) -> BTreeSet<String> {
    dpkg_query
        .lines()
        .filter_map(|line| line.trim().split_once(' '))
        .filter(|(_, status)| *status == "installed")
        .map(|(name, _)| name.to_owned())
        .collect()
}

/// Whether dpkg is configured to exclude documentation, as in many container images: then an installed opencv-doc may
/// be empty.
fn documentation_is_excluded() -> bool {
    let Ok(folder) = std::fs::read_dir("/etc/dpkg/dpkg.cfg.d") else { return false };
    folder.flatten().any(|file| {
        let text = std::fs::read_to_string(file.path()).unwrap_or_default();
        text.lines().any(|line| line.trim().starts_with("path-exclude") && line.contains("/usr/share/doc"))
    })
}

fn shows(evidence: &Evidence) -> bool {
    match evidence {
        Evidence::Program(name) => find_program(name).is_some(),
        Evidence::AnyFile(paths) => paths.iter().any(|path| Path::new(path).exists()),
        Evidence::PkgConfig(module) => {
            let found = Command::new("pkg-config").args(["--exists", module]).status();
            found.is_ok_and(|status| status.success())
        }
        Evidence::GStreamer(element) => {
            let found = Command::new("gst-inspect-1.0").args(["--exists", element]).status();
            found.is_ok_and(|status| status.success())
        }
        Evidence::Libclang => libclang_is_found(),
    }
}

fn libclang_is_found() -> bool {
    let mut folders: Vec<PathBuf> =
        ["/usr/lib", "/usr/lib64", "/usr/local/lib", "/opt/homebrew/opt/llvm/lib", "/usr/local/opt/llvm/lib"]
            .map(PathBuf::from)
            .to_vec();
    folders.extend(std::env::var_os("LIBCLANG_PATH").map(PathBuf::from));
    if let Some(clang) = find_program("clang").and_then(|clang| clang.canonicalize().ok()) {
        folders.extend(clang.ancestors().nth(2).map(|prefix| prefix.join("lib")));
    }
    folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).any(|folder| {
        folder.flatten().any(|file| {
            let name = file.file_name();
            let name = name.to_string_lossy();
            name.starts_with("libclang.so") || name.starts_with("libclang-") || name == "libclang.dylib"
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_installed_packages_count() {
        let text = "libopencv-dev installed\nclang not-installed\ngcc config-files\npkg-config installed\n\n";
        let names = installed_names(text);
        assert_eq!(names.iter().map(String::as_str).collect::<Vec<_>>(), ["libopencv-dev", "pkg-config"]);
    }

    #[test]
    fn every_needed_package_is_named_on_every_known_system() {
        for package in PACKAGES.iter().filter(|package| !package.purpose.is_optional()) {
            let all = [System::Debian, System::Fedora, System::Arch, System::MacOs];
            let systems = match package.purpose {
                // A virtual screen needs X11, a Debian package needs Debian.
                Purpose::Screens => &all[..3],
                Purpose::Package => &all[..1],
                _ => &all[..],
            };
            for &system in systems {
                assert!(package.name_on(system).is_some(), "{} has no name on {system:?}", package.debian);
            }
        }
    }

    #[test]
    fn only_wanted_purposes_are_looked_for() {
        assert!(missing(System::Other, &[]).is_empty());
        let wheels = missing(System::Other, &[Purpose::Wheels]);
        assert!(wheels.iter().all(|package| package.purpose == Purpose::Wheels));
    }

    #[test]
    fn evidence_is_looked_for_not_assumed() {
        assert!(shows(&Evidence::Program("sh")));
        assert!(!shows(&Evidence::Program("no-such-program-here")));
        assert!(!shows(&Evidence::AnyFile(&["/no/such/file"])));
        assert!(!shows(&Evidence::PkgConfig("no-such-module-here")));
    }
}
