//! Python packages for the tests, in the build folder instead of the user's Python.

use std::path::PathBuf;
use std::process::Command;

use crate::packages::Purpose;
use crate::process;
use crate::setup;
use crate::workspace::Workspace;

/// A set of packages that is fetched together.
pub struct Packages {
    /// Name in messages.
    name: &'static str,
    /// Modules whose import shows that the packages are installed.
    modules: &'static str,
    requirements: &'static [&'static str],
    /// Folder inside the target folder.
    folder: &'static str,
}

/// Packages for nodes in Python.
pub const NUMPY: Packages =
    Packages { name: "NumPy", modules: "numpy", requirements: &["numpy>=1.24,<3"], folder: "python" };

/// Environment variable with the folder of [`PEERS`], for the tests that use them.
pub const PEERS_VARIABLE: &str = "PANOSCOPE_PYTHON_PEERS";

/// Peers for tests of Panoscope: readers of the files that `panoscope export` and `panoscope dicom` write, a client of
/// Foxglove's protocol, bags and DDS of ROS 2, OpenCV, ONNX Runtime, notebooks, tables, and type checkers; 1.6 GB.
/// foxglove-sdk has the version of the crate `foxglove`, because schemas are compared; onnxruntime has that of
/// `crate::onnxruntime`, because values are compared.
pub const PEERS: Packages = Packages {
    name: "packages for tests in Python",
    modules: "basedpyright, cv2, cyclonedds, distributed, foxglove, ipykernel, ipywidgets, mcap, mcap_protobuf, mypy, nbclient, numpy, onnxruntime, pandas, PIL, polars, pyarrow, pydicom, pyigtl, rerun, rosbags, websockets",
    requirements: &[
        "basedpyright>=1.30,<2",
        "cyclonedds==11.0.1",
        "distributed>=2024.8",
        "foxglove-sdk==0.30.3",
        "ipykernel>=6,<8",
        "ipywidgets>=8,<9",
        "mcap==1.6.0",
        "mcap-protobuf-support==0.6.0",
        "mypy>=1.15,<3",
        "nbclient>=0.10,<0.12",
        "numpy>=1.24,<3",
        "onnxruntime==1.31.1",
        "opencv-python-headless>=4.10,<5",
        "pandas>=2,<4",
        "pillow",
        "polars>=1,<2",
        "pyarrow>=14",
        "pydicom>=3,<4",
        "pyigtl==0.3.4",
        "rerun-sdk==0.41.0",
        "rosbags==0.11.9",
        "websockets==17.4",
    ],
    folder: "python_peers",
};

impl Packages {
    fn are_in(&self, path: Option<&PathBuf>) -> bool {
        let mut python = Command::new("python3");
        python.arg("-c").arg(format!("import {}", self.modules)).envs(path.map(|path| ("PYTHONPATH", path)));
        process::capture(&mut python).is_ok()
    }

    /// The folder for `PYTHONPATH`; `None` if Python already has the packages, or if they cannot be fetched, so that
    /// tests are skipped.
    pub fn folder(&self, workspace: &Workspace) -> Option<PathBuf> {
        if self.are_in(None) {
            return None;
        }
        let folder = workspace.target.join(self.folder);
        if self.are_in(Some(&folder)) {
            return Some(folder);
        }
        println!("Fetching {} with pip", self.name);
        let install = || {
            let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--upgrade", "--target"];
            process::capture(Command::new("python3").args(pip).arg(&folder).args(self.requirements))
        };
        let installed =
            install().or_else(|error| setup::ensure(&[Purpose::Wheels]).map_err(|_| error).and_then(|_| install()));
        match installed {
            Ok(_) => Some(folder),
            Err(error) => {
                println!("{} were not fetched: {error:#}", self.name);
                None
            }
        }
    }
}
