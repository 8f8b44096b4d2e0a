//! DICOM with real peers, see `python/dicom.py`.

use std::path::Path;
use std::process::Command;

use panoscope_tests::run_python_tests;

#[test]
fn stills_clips_and_measurements_reach_an_archive() {
    // Debian puts the server where only root's PATH has it.
    for program in ["/usr/sbin/Orthanc", "dump2dcm", "dciodvfy"] {
        if Command::new(program).arg("--version").output().is_err() {
            return panoscope_testing::skipped!(
                "no {program}: `cargo xtask test` installs orthanc, dcmtk and dicom3tools"
            );
        }
    }
    let worklists = Path::new("/usr/share/orthanc/plugins/libModalityWorklists.so");
    if !worklists.exists() {
        return panoscope_testing::skipped!("Orthanc has no worklists: {} is missing", worklists.display());
    }
    run_python_tests("dicom.py", "cv2, numpy, PIL, pydicom");
}
