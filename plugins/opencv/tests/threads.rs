//! OpenCV's number of threads belongs to the process: this test is alone in its file, so that no other test sets it.

use opencv::core::{get_num_threads, set_num_threads};
use panoscope_node::Gray8;
use panoscope_node::harness::Harness;
use panoscope_opencv::{FeaturesOpencv, RegisterOpencv};

#[test]
fn the_number_stays_from_frame_to_frame_and_is_put_back_by_the_last_node() {
    set_num_threads(2).unwrap();
    let before = get_num_threads().unwrap();
    let gray = vec![90u8; 64 * 48];
    let mut features = Harness::<FeaturesOpencv>::from_toml("params = { threads = 1 }").unwrap();
    let mut register = Harness::<RegisterOpencv>::from_toml("params = { threads = 1 }").unwrap();
    assert_eq!(get_num_threads().unwrap(), before, "opening alone changes nothing");
    for _ in 0..2 {
        features.input_image::<Gray8>("left", 64, 48, &gray);
        register.input_image::<Gray8>("left", 64, 48, &gray).input_image::<Gray8>("right", 64, 48, &gray);
        features.process().unwrap();
        assert_eq!(get_num_threads().unwrap(), 1);
        register.process().unwrap();
        assert_eq!(get_num_threads().unwrap(), 1, "put back between frames, the threads would start anew with each");
    }
    drop(features);
    assert_eq!(get_num_threads().unwrap(), 1, "the other node works on");
    drop(register);
    assert_eq!(get_num_threads().unwrap(), before);
}
