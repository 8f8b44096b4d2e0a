//! Running graphs with other programs: Foxglove's protocol, rerun, ROS 2. The peers are real and run on this machine.

use panoscope_tests::run_python_tests;

#[test]
fn foxglove_shows_and_sets_a_running_graph() {
    run_python_tests("foxglove_live.py", "foxglove, mcap_protobuf, PIL, websockets");
}

#[test]
fn bags_go_to_ros_and_back() {
    run_python_tests("ros2_bags.py", "rosbags, PIL");
}

#[test]
fn topics_go_to_ros_and_back() {
    run_python_tests("ros2_topics.py", "cyclonedds");
}

#[test]
fn rerun_receives_a_running_graph() {
    run_python_tests("rerun_live.py", "rerun, pyarrow");
}

#[test]
fn the_python_package_is_typed() {
    run_python_tests("type_checks.py", "mypy");
}

#[test]
fn results_become_tables_of_other_libraries() {
    run_python_tests("tables.py", "pandas, polars, pyarrow");
}
