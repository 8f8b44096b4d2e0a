//! Killed at any moment while saving, the file holds one whole text or the other.

use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use panoscope_editor::disk;

const CHILD: &str = "PANOSCOPE_TEST_SAVE_FOREVER";

fn text(letter: char) -> String {
    format!("# {letter}\n{}", format!("{}\n", letter.to_string().repeat(99)).repeat(4000))
}

#[test]
fn a_kill_while_saving_leaves_a_whole_file() {
    if let Some(path) = std::env::var_os(CHILD) {
        let (path, texts) = (PathBuf::from(path), ['a', 'b'].map(text));
        loop {
            texts.iter().for_each(|text| disk::save(&path, text).expect("it is saved"));
        }
    }
    let folder = std::env::temp_dir().join(format!("panoscope_kill_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary files can be written");
    let (path, texts) = (folder.join("g.toml"), ['a', 'b'].map(text));
    disk::save(&path, &texts[0]).expect("it is saved");
    let (mut kills, mut saves) = (0u64, 0);
    while kills < 30 {
        let this = std::env::current_exe().expect("a test has a file");
        let mut child = Command::new(this)
            .args(["--exact", "a_kill_while_saving_leaves_a_whole_file", "--nocapture"])
            .env(CHILD, &path)
            .stdout(std::process::Stdio::null())
            .spawn()
            .expect("it starts");
        let before = std::fs::metadata(&path).and_then(|m| m.modified()).ok();
        // Times that lie apart evenly fall on all parts of a save.
        std::thread::sleep(Duration::from_micros(40_000 + kills * 1_370));
        child.kill().expect("it is killed");
        child.wait().expect("it ended");
        kills += 1;
        saves += u64::from(before != std::fs::metadata(&path).and_then(|m| m.modified()).ok());
        let now = std::fs::read_to_string(&path).expect("the file is there");
        assert!(texts.contains(&now), "half a file after kill {kills}: {} bytes", now.len());
        let kept = std::fs::read_to_string(disk::backup_of(&path)).unwrap_or_else(|_| texts[0].clone());
        assert!(texts.contains(&kept), "half a backup after kill {kills}: {} bytes", kept.len());
    }
    assert!(saves > 0, "nothing was saved in between");
    std::fs::remove_dir_all(&folder).expect("it is removed");
}
