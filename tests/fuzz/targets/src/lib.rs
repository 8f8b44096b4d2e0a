//! Functions that take unchecked bytes, one per parser of foreign files and messages.
//!
//! The fuzzer calls them (`tests/fuzz/fuzz_targets`), and the test `corpora` replays the fuzzer's findings with the stable toolchain. A function
//! panics when the parser violates a property: accepted input must survive being written and read again, positions of errors must be inside the file,
//! and the work must be proportional to the number of bytes. The callers add limits of memory and time.

mod arm;
mod attach;
mod audit;
mod calibration;
mod descriptor;
mod dicom;
mod draw;
mod graph;
mod igtl;
mod isolated;
mod keys;
mod labels;
mod machine;
mod model;
mod numbers;
mod packets;
mod pedal;
mod picture;
mod plugin;
mod recording;
mod ros;
mod scratch;
mod states;
mod webrtc;

use std::path::Path;

/// A parser under test.
pub struct Target {
    /// Name of the target, of its corpus and of its file in `tests/fuzz/fuzz_targets`.
    pub name: &'static str,
    /// Parses bytes and asserts properties of the result.
    pub run: fn(&[u8]),
    /// Initial inputs: valid ones and typical mistakes.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All targets, sorted by name.
pub const TARGETS: &[Target] = &[
    Target { name: "arm_line", run: arm::line, seeds: arm::line_seeds },
    Target { name: "attach_message", run: attach::run, seeds: attach::seeds },
    Target { name: "audit", run: audit::run, seeds: audit::seeds },
    Target { name: "board", run: calibration::board, seeds: calibration::board_seeds },
    Target { name: "calibration", run: calibration::file, seeds: calibration::file_seeds },
    Target { name: "coco", run: labels::coco, seeds: labels::coco_seeds },
    Target { name: "descriptor", run: descriptor::run, seeds: descriptor::seeds },
    Target { name: "described_plugin", run: isolated::description, seeds: isolated::description_seeds },
    Target { name: "dicom_entry", run: dicom::entry, seeds: dicom::entry_seeds },
    Target { name: "dicom_film", run: dicom::film, seeds: dicom::film_seeds },
    Target { name: "dicom_lengths", run: dicom::lengths, seeds: dicom::lengths_seeds },
    Target { name: "digests", run: recording::digests, seeds: recording::digest_seeds },
    Target { name: "event", run: recording::event, seeds: recording::event_seeds },
    Target { name: "float_image", run: numbers::float_image, seeds: numbers::float_image_seeds },
    Target { name: "gate", run: ros::gate, seeds: ros::gate_seeds },
    Target { name: "graph", run: graph::run, seeds: graph::seeds },
    Target { name: "guard_message", run: arm::message, seeds: arm::message_seeds },
    Target { name: "igtl", run: igtl::run, seeds: igtl::seeds },
    Target { name: "isolated_call", run: isolated::calls, seeds: isolated::call_seeds },
    Target { name: "keys", run: keys::run, seeds: keys::seeds },
    Target { name: "labelme", run: labels::labelme, seeds: labels::labelme_seeds },
    Target { name: "latch", run: arm::latch, seeds: arm::latch_seeds },
    Target { name: "layout", run: states::layout, seeds: states::layout_seeds },
    Target { name: "lock", run: plugin::lock, seeds: plugin::lock_seeds },
    Target { name: "machine_message", run: machine::run, seeds: machine::seeds },
    Target { name: "onnx", run: model::run, seeds: model::seeds },
    Target { name: "packet", run: packets::run, seeds: packets::seeds },
    Target { name: "pedal", run: pedal::run, seeds: pedal::seeds },
    Target { name: "picture", run: picture::run, seeds: picture::seeds },
    Target { name: "plugin_note", run: plugin::note, seeds: plugin::note_seeds },
    Target { name: "presets", run: states::presets, seeds: states::preset_seeds },
    Target { name: "recording", run: recording::file, seeds: recording::file_seeds },
    Target { name: "ros_bag", run: ros::bag, seeds: ros::bag_seeds },
    Target { name: "ros_message", run: ros::message, seeds: ros::message_seeds },
    Target { name: "rtde", run: arm::rtde, seeds: arm::rtde_seeds },
    Target { name: "snapshot", run: states::snapshot, seeds: states::snapshot_seeds },
    Target { name: "truth_file", run: numbers::truth_file, seeds: numbers::truth_file_seeds },
    Target { name: "urdf", run: arm::urdf, seeds: arm::urdf_seeds },
    Target { name: "via", run: labels::via, seeds: labels::via_seeds },
    Target { name: "voc", run: labels::voc, seeds: labels::voc_seeds },
    Target { name: "webrtc_offer", run: webrtc::offer, seeds: webrtc::offer_seeds },
    Target { name: "yolo_labels", run: labels::yolo, seeds: labels::yolo_seeds },
];

/// Environment variable with the folder to which [`begin`] writes the seeds.
pub const SEEDS_VARIABLE: &str = "PANOSCOPE_FUZZ_SEEDS";
/// Environment variable with the folder for files that a target needs; in memory where possible.
pub const SCRATCH_VARIABLE: &str = "PANOSCOPE_FUZZ_SCRATCH";

/// The target called `name`.
///
/// # Panics
/// There is none.
pub fn target(name: &str) -> &'static Target {
    TARGETS.iter().find(|target| target.name == name).unwrap_or_else(|| panic!("there is no target `{name}`"))
}

/// Prepares a fuzzer: writes the seeds of a target to the folder that [`SEEDS_VARIABLE`] names.
///
/// # Panics
/// The seeds cannot be written.
pub fn begin(name: &str) {
    let Some(folder) = std::env::var_os(SEEDS_VARIABLE) else { return };
    let folder = Path::new(&folder);
    std::fs::create_dir_all(folder).expect("a folder for the seeds");
    for (number, seed) in (target(name).seeds)().iter().enumerate() {
        std::fs::write(folder.join(format!("seed-{number:02}")), seed).expect("a seed");
    }
}
