//! A node that owns a device is closed before its successor opens; when that fails, the old one has its device back.

use std::time::{Duration, Instant};

use crate::common::{PATIENCE, ready};
use panoscope_engine::Options;
use panoscope_host::loader::Live;

const TEXT: &str = r#"
mode = "live"
plugins = ["flow", "fixtures"]
[nodes.a]
type = "frames"
params = { width_px = 16, height_px = 8, format = "gray8", rate_hz = 200.0 }
[nodes.camera]
type = "device"
params = { name = "left" }
inputs = { image = { from = "a.image", queue = 200 } }
[nodes.end]
type = "drain"
inputs = { image = "camera.image" }
"#;

fn start() -> Live {
    ready("exclusive.toml", TEXT).start(Options { threads: 2, ..Options::default() }).expect("it starts")
}

fn goes_on(live: &Live, what: &str) {
    let count = || live.engine().report().nodes["end"].count;
    let (before, end) = (count(), Instant::now() + PATIENCE);
    while count() < before + 10 {
        assert!(Instant::now() < end, "{what}: the picture stands still");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn an_exclusive_node_whose_successor_does_not_open_is_back() {
    let mut live = start();
    goes_on(&live, "at first");
    let error = live.set_param("camera", "name", &"broken".into()).expect_err("it does not open");
    assert!(error.to_string().contains("`camera`") && error.to_string().contains("does not answer"), "{error}");
    assert_eq!(live.text(), TEXT, "the text is as before");
    goes_on(&live, "after a failed reopening");
    // The same device again: it can only open when the old instance has given it back.
    let applied = live.edit(|d| d.set_param("camera", "name", &"right".into())).expect("a good change");
    assert_eq!(applied.reopened, ["camera"]);
    goes_on(&live, "with another device");

    // Gone and in its place another node on the same device, with one more that fails: all of it is undone.
    let error = live
        .edit(|d| {
            d.remove_node("camera")?;
            d.add_node("other", "device")?;
            d.set_param("other", "name", &"right".into())?;
            d.set_input("other", "image", &["a.image"])?;
            d.add_node("worse", "device")?;
            d.set_param("worse", "name", &"broken".into())?;
            d.set_input("worse", "image", &["other.image"])?;
            d.set_input("end", "image", &["other.image"])
        })
        .expect_err("`worse` does not open");
    assert!(error.to_string().contains("`worse`"), "{error}");
    goes_on(&live, "after a failed replacement");
    let applied = live
        .edit(|d| {
            d.remove_node("camera")?;
            d.add_node("other", "device")?;
            d.set_param("other", "name", &"right".into())?;
            d.set_input("other", "image", &["a.image"])?;
            d.set_input("end", "image", &["other.image"])
        })
        .expect("the device is free by then");
    assert_eq!(applied.added, ["other"]);
    goes_on(&live, "with another node");
    assert!(live.engine().recent_faults().is_empty(), "{:?}", live.engine().recent_faults());
    live.engine().stop();
    assert!(live.engine().wait(Some(PATIENCE)));
    let report = live.engine().report();
    assert_eq!(report.nodes["end"].count, report.nodes["a"].count, "no frame was lost");
}
