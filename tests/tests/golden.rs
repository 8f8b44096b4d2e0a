//! Images that must not change. `PANOSCOPE_BLESS=1` renews them; look at what changed before you commit it.

use std::path::Path;

use image::RgbImage;
use panoscope_graph::{GraphOptions, GraphText};
use panoscope_tests::{root, run, run_with, scratch};

/// Peak signal-to-noise ratio in dB; infinite for equal images.
fn psnr_db(a: &RgbImage, b: &RgbImage) -> f64 {
    let squares: f64 = a.as_raw().iter().zip(b.as_raw()).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum();
    10.0 * (255.0 * 255.0 * a.as_raw().len() as f64 / squares).log10()
}

fn compare(name: &str, made: &Path) {
    let golden = root().join("tests/golden").join(format!("{name}.png"));
    if std::env::var_os("PANOSCOPE_BLESS").is_some() {
        std::fs::create_dir_all(golden.parent().expect("a folder")).expect("the folder of golden pictures");
        std::fs::copy(made, &golden).expect("the golden picture");
        return;
    }
    let made = image::open(made).expect("the picture of this run").to_rgb8();
    let want = image::open(&golden).unwrap_or_else(|e| panic!("{}: {e}", golden.display())).to_rgb8();
    assert_eq!(made.dimensions(), want.dimensions(), "{name} has another size");
    // Bytes are equal on one kind of processor; another one may round the registration differently.
    let similarity = psnr_db(&made, &want);
    assert!(similarity > 40.0, "{name} changed: {similarity:.1} dB from its golden picture");
}

#[test]
fn panorama_of_the_phantom() {
    let folder = scratch("golden-panorama");
    let graph = format!(
        r#"
mode = "batch"
plugins = ["phantom", "stitch", "sinks"]
[nodes.scope]
type = "phantom"
params = {{ scene = "bowel", seed = 3, width = 320, height = 240 }}
[nodes.register]
type = "register_surf"
inputs = {{ left = "scope.left", right = "scope.right" }}
params = {{ scale = 1 }}
[nodes.wide]
type = "composite"
inputs = {{ left = "scope.left", right = "scope.right", homography = "register.homography" }}
[nodes.still]
type = "write_images"
inputs = {{ image = "wide.panorama" }}
params = {{ path = "{}/panorama.png", at_end = true }}
"#,
        folder.display()
    );
    let done = run(&folder.join("graph.toml"), &graph, 10, 2);
    assert!(done.log.is_empty(), "{:?}", done.log);
    compare("panorama_bowel", &folder.join("panorama.png"));
    let _ = std::fs::remove_dir_all(&folder);
}

/// Settings that redirect every file of a graph into a folder.
fn redirected(text: &GraphText, folder: &Path) -> Vec<String> {
    let nodes = text.outline();
    let sinks = nodes.iter().filter(|node| node.type_name.starts_with("write_"));
    let file = |node: &panoscope_graph::NodeOutline| {
        let path = node.params.get("path").and_then(|path| path.as_str()).unwrap_or("file");
        let name = Path::new(path).file_name().expect("a file").to_string_lossy().into_owned();
        format!("{}.path={}", node.id, folder.join(name).display())
    };
    sinks.map(file).collect()
}

/// The images were made when each graph had its chain in its own file: parts change no byte.
#[test]
fn stills_of_shipped_graphs() {
    for name in ["compare_stitch", "stereo_judged"] {
        let folder = scratch(&format!("golden-{name}"));
        let path = root().join("graphs").join(format!("{name}.toml"));
        let live = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let text = live.replace("mode = \"live\"", "mode = \"batch\"");
        let mut set = vec!["scope.width=320".to_owned(), "scope.height=240".to_owned()];
        set.extend(redirected(&GraphText::parse(&path, &text), &folder));
        let done = run_with(&path, &text, &GraphOptions { set, ..GraphOptions::default() }, 4);
        let done = done.expect("no network in this graph");
        assert!(done.log.is_empty(), "{name}: {:?}", done.log);
        compare(name, &folder.join(format!("{name}.png")));
        let _ = std::fs::remove_dir_all(&folder);
    }
}
