//! Running graphs beside other programs. The peers are real and run on this machine.

use panoscope_tests::run_python_tests;

#[test]
fn rerun_receives_a_running_graph() {
    run_python_tests("rerun_live.py", "rerun, pyarrow");
}
