//! Which machine a window attaches to: `NAME@ADDRESS`, or a name from `machines.toml`.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;

/// A machine whose running graph a window shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    /// Its name, as given on its `--attachable` side.
    pub name: String,
    /// `tls/HOST:PORT`, or `tcp/127.0.0.1:PORT`.
    pub address: String,
    /// Silence after which the connection counts as lost, ms.
    pub timeout_ms: u32,
    /// Whether an address without encryption may lead to another machine.
    pub plaintext: bool,
    /// Folder with the keys of this machine; default: `PANOSCOPE_KEYS`.
    pub keys: Option<PathBuf>,
}

/// A machine that cannot be attached to.
#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    /// Not a valid name.
    #[error("`{0}` cannot name a machine: write NAME@ADDRESS as in rack@tls/10.0.0.2:7448, or a NAME of machines.toml")]
    Name(String),
    /// The machine has no address.
    #[error("machine `{name}` has no address: write {name}@tls/HOST:PORT, or [machines.{name}] with `address` into {file}", file = file.display())]
    Unknown {
        /// The machine.
        name: String,
        /// The file that was looked into.
        file: PathBuf,
    },
    /// The file is malformed.
    #[error("{file}: {words}", file = file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// Description of the problem.
        words: String,
    },
}

/// `machines.toml`.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Machines {
    #[serde(default)]
    machines: std::collections::BTreeMap<String, Entry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    address: String,
    #[serde(default = "timeout_ms")]
    timeout_ms: u32,
    #[serde(default)]
    plaintext: bool,
}

fn timeout_ms() -> u32 {
    1500
}

impl Target {
    /// The machine that `text` names. `config` is the folder with `machines.toml`.
    ///
    /// # Errors
    /// See [`TargetError`].
    pub fn find(text: &str, config: Option<&Path>) -> Result<Self, TargetError> {
        let (name, address) = text.split_once('@').map_or((text, None), |(name, address)| (name, Some(address)));
        let fits = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if name.is_empty() || name.len() > 64 || !name.chars().all(fits) {
            return Err(TargetError::Name(text.to_owned()));
        }
        let name = name.to_owned();
        if let Some(address) = address {
            return Ok(Self {
                name,
                address: address.to_owned(),
                timeout_ms: timeout_ms(),
                plaintext: false,
                keys: None,
            });
        }
        let file = config.unwrap_or(Path::new("")).join("machines.toml");
        let damaged = |words: String| TargetError::File { file: file.clone(), words };
        let text = match fs::read_to_string(&file) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(TargetError::Unknown { name, file });
            }
            Err(error) => return Err(damaged(error.to_string())),
        };
        let mut machines: Machines = toml::from_str(&text).map_err(|error| damaged(error.to_string()))?;
        match machines.machines.remove(&name) {
            Some(Entry { address, timeout_ms, plaintext }) => {
                Ok(Self { name, address, timeout_ms: timeout_ms.clamp(100, 60_000), plaintext, keys: None })
            }
            None => Err(TargetError::Unknown { name, file }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_has_its_address_with_it_or_in_the_file() {
        let folder = std::env::temp_dir().join(format!("panoscope-targets-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let given = Target::find("rack@tls/10.0.0.2:7448", None).expect("a machine");
        assert_eq!((given.name.as_str(), given.address.as_str()), ("rack", "tls/10.0.0.2:7448"));
        let error = Target::find("rack", Some(&folder)).expect_err("no file").to_string();
        assert!(error.contains("[machines.rack]"), "{error}");
        fs::write(folder.join("machines.toml"), "[machines.rack]\naddress = \"tls/10.0.0.2:1\"\n").expect("a file");
        assert_eq!(Target::find("rack", Some(&folder)).expect("a machine").address, "tls/10.0.0.2:1");
        assert!(matches!(Target::find("attic", Some(&folder)), Err(TargetError::Unknown { .. })));
        fs::write(folder.join("machines.toml"), "[machines.rack]\nadress = \"x\"\n").expect("a file");
        assert!(matches!(Target::find("rack", Some(&folder)), Err(TargetError::File { .. })));
        for bad in ["", "@tls/a:1", "a/b", "a b"] {
            assert!(matches!(Target::find(bad, None), Err(TargetError::Name(_))), "{bad}");
        }
        let _ = fs::remove_dir_all(&folder);
    }
}
