//! ONNX Runtime's shared library, from its Python wheel.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};

use crate::wheel::Wheel;
use crate::workspace::Workspace;

/// Pinned version.
pub const VERSION: &str = "1.31.1";
pub const LIBRARY: &str = "libonnxruntime.so.1.31.1";
const MEMBERS: &[&str] =
    &["onnxruntime/capi/libonnxruntime.so.1.31.1", "onnxruntime/LICENSE", "onnxruntime/ThirdPartyNotices.txt"];

static X86_64: Wheel = Wheel {
    name: "onnxruntime",
    version: VERSION,
    sha256: "5752bd508126ae7c49894d3b9d2e83f0c3d487319246d04c444b393308d7ad7f",
    platform: "manylinux_2_28_x86_64",
    python: "311",
    abi: "cp311",
    members: MEMBERS,
};

static AARCH64: Wheel = Wheel {
    sha256: "da05378364c44d4407e463982d2bf8d5e4cfea873283757e48beeb41df97b7f3",
    platform: "manylinux_2_28_aarch64",
    ..X86_64
};

/// Fetches the library for this machine; returns its path. Does nothing if it was fetched before.
pub fn fetch(workspace: &Workspace) -> Result<PathBuf> {
    let wheel = match (std::env::consts::OS, std::env::consts::ARCH) {
        ("linux", "x86_64") => &X86_64,
        ("linux", "aarch64") => &AARCH64,
        (os, arch) => bail!(
            "no ONNX Runtime is pinned for {os} on {arch}: install ONNX Runtime {VERSION} and name its library in \
             ORT_DYLIB_PATH"
        ),
    };
    let folder = workspace.target.join("onnxruntime");
    wheel.unpack_into(&folder)?;
    Ok(folder.join(LIBRARY))
}

/// The library and its licence files.
pub fn files(library: &Path) -> Vec<PathBuf> {
    let names = MEMBERS.iter().filter_map(|member| Path::new(member).file_name());
    names.map(|name| library.with_file_name(name)).filter(|file| file.is_file()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_library_named_is_a_member_of_both_wheels() {
        for wheel in [&X86_64, &AARCH64] {
            assert!(wheel.members.iter().any(|member| member.ends_with(LIBRARY)));
            assert!(LIBRARY.ends_with(wheel.version));
            assert_eq!(wheel.sha256.len(), 64);
        }
        assert_ne!(X86_64.sha256, AARCH64.sha256);
    }
}
