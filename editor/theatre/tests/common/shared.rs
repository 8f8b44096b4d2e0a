//! Helpers for tests of both windows.
#![allow(dead_code, reason = "each test binary uses a part")]

use std::path::PathBuf;
use std::time::Duration;

use panoscope_host::loader::{self as loader, Loader};

/// Maximum time to wait for a condition.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Whether a plugin can be loaded; a test that needs it is skipped otherwise. Test graphs with nodes of `flow` have nodes
/// of the test plugin `fixtures` beside them, so `flow` asks for both.
pub fn has_plugin(name: &str) -> bool {
    let needed: &[&str] = if name == "flow" { &["flow", "fixtures"] } else { &[name] };
    let loader = Loader::search(&loader::search_path(&[]));
    let missing = needed.iter().find(|name| !loader.found().any(|f| f.note.name == **name));
    if let Some(name) = missing {
        panoscope_testing::skipped!("plugin `{name}` is not in PANOSCOPE_PLUGIN_PATH; `cargo xtask test` sets it");
    }
    missing.is_none()
}

/// A temporary folder of one test, removed at the end.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("panoscope_editor_{name}_{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("temporary files can be written");
        Self(folder)
    }

    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.join(name);
        std::fs::write(&path, text).expect("temporary files can be written");
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
