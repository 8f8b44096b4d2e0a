//! Test data from Python wheels.

use std::path::PathBuf;

use anyhow::Result;

use crate::wheel::Wheel;
use crate::workspace::Workspace;

/// The Middlebury "Motorcycle" pair with its true disparity, as scikit-image shipped it. Plain data: the wheel's
/// platform does not matter.
static MOTORCYCLE: Wheel = Wheel {
    name: "scikit-image",
    version: "0.15.0",
    sha256: "a8fb7dc56b14656768fdf21d4325bf82f543fad51dc83c24aa6a27456a946a2d",
    platform: "manylinux1_x86_64",
    python: "37",
    abi: "cp37m",
    members: &[
        "skimage/data/motorcycle_left.png",
        "skimage/data/motorcycle_right.png",
        "skimage/data/motorcycle_disp.npz",
        "scikit_image-0.15.0.dist-info/LICENSE.txt",
    ],
};

/// Fetches all test data that is missing; returns its folder, with a folder per set.
pub fn fetch(workspace: &Workspace) -> Result<PathBuf> {
    let folder = workspace.data_dir();
    MOTORCYCLE.unpack_into(&folder.join("motorcycle"))?;
    Ok(folder)
}
