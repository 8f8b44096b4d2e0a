//! Keys that sign locks, and the keys that an installation trusts.
//!
//! A key is an Ed25519 key in a text file of one line: `panoscope-secret-key 1 HEX` or `panoscope-public-key 1 HEX`.
//! Lines that begin with `#` are comments.

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};

use crate::loader::sealed::hex;

const SECRET: &str = "panoscope-secret-key";
const PUBLIC: &str = "panoscope-public-key";
/// Version of the files' layout.
const VERSION: &str = "1";

/// Trusted keys of the whole machine.
const SYSTEM_FOLDER: &str = "/etc/panoscope/keys";

/// Extension of files with public keys.
const ENDING: &str = "pub";

/// A key that was not made or read.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// A file could not be read or written.
    #[error("{file}: {cause}", file = file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// A new key would replace a file.
    #[error("{file} already exists, and keys are never replaced; choose another file", file = file.display())]
    Exists {
        /// The file.
        file: PathBuf,
    },
    /// The file is not a key.
    #[error("{file} is not a {expected} ({reason}); `panoscope lock --new-key FILE` makes keys", file = file.display())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// Kind of key that was expected.
        expected: &'static str,
        /// Description of the problem.
        reason: &'static str,
    },
    /// Other users may read the secret key.
    #[error("other users can read the secret key {file}, so it is not secret; make a new one, and protect it with `chmod 600`", file = file.display())]
    Open {
        /// The file.
        file: PathBuf,
    },
}

fn in_file(file: &Path) -> impl Fn(std::io::Error) -> KeyError {
    move |cause| KeyError::File { file: file.to_owned(), cause }
}

fn digits<const N: usize>(text: &str) -> Option<[u8; N]> {
    let mut out = [0; N];
    // A sign would be a digit to `from_str_radix`.
    if text.len() != 2 * N || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return None;
    }
    for (k, byte) in out.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&text[2 * k..2 * k + 2], 16).ok()?;
    }
    Some(out)
}

/// The 32 bytes of a key file of this kind.
fn read(file: &Path, expected: &'static str) -> Result<[u8; 32], KeyError> {
    let mut text = String::new();
    let damaged = |reason| KeyError::Damaged { file: file.to_owned(), expected, reason };
    let opened = File::open(file).map_err(in_file(file))?;
    // A key has a line or two; something else may have gigabytes.
    match opened.take(10_000).read_to_string(&mut text) {
        Ok(_) => {}
        Err(error) if error.kind() == std::io::ErrorKind::InvalidData => return Err(damaged("it is not text")),
        Err(cause) => return Err(KeyError::File { file: file.to_owned(), cause }),
    }
    let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let words: Vec<&str> = lines.next().unwrap_or("").split_whitespace().collect();
    match (words.as_slice(), lines.next()) {
        ([kind, VERSION, key], None) if *kind == expected => {
            digits(key).ok_or(damaged("its key does not have 64 hexadecimal digits"))
        }
        ([SECRET | PUBLIC, ..], _) => Err(damaged("it has another kind or version")),
        _ => Err(damaged("it has no key")),
    }
}

/// A signing key. Its holder can vouch for locks.
pub struct SecretKey {
    key: SigningKey,
    name: String,
}

impl SecretKey {
    /// Makes a key pair: the secret key in `file`, which only its owner can read, and the public key next to it as
    /// `file.pub`.
    ///
    /// # Errors
    /// One of the files exists, or cannot be written.
    pub fn create(file: &Path) -> Result<PublicKey, KeyError> {
        let public_file = public_file(file);
        let exists = |cause: std::io::Error, file: &Path| match cause.kind() {
            std::io::ErrorKind::AlreadyExists => KeyError::Exists { file: file.to_owned() },
            _ => KeyError::File { file: file.to_owned(), cause },
        };
        if public_file.exists() {
            return Err(KeyError::Exists { file: public_file });
        }
        let mut seed = [0; 32];
        let random = Path::new("/dev/urandom");
        File::open(random).and_then(|mut random| random.read_exact(&mut seed)).map_err(in_file(random))?;
        let secret = Self { key: SigningKey::from_bytes(&seed), name: name_of(file) };
        let public = secret.public();
        let mut out = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(file)
            .map_err(|cause| exists(cause, file))?;
        let text = format!(
            "# Signs locks of Panoscope. Keep it secret: whoever has it can vouch for any graph.\n{SECRET} {VERSION} {}\n",
            hex(&seed)
        );
        out.write_all(text.as_bytes()).and_then(|()| out.sync_all()).map_err(in_file(file))?;
        let text = format!("{PUBLIC} {VERSION} {}\n", public.hex());
        let mut out = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&public_file)
            .map_err(|cause| exists(cause, &public_file))?;
        out.write_all(text.as_bytes()).and_then(|()| out.sync_all()).map_err(in_file(&public_file))?;
        Ok(public)
    }

    /// Reads a secret key.
    ///
    /// # Errors
    /// The file cannot be read, is not a secret key, or can be read by others.
    pub fn read(file: &Path) -> Result<Self, KeyError> {
        let meta = std::fs::metadata(file).map_err(in_file(file))?;
        let seed = read(file, SECRET)?;
        if meta.mode() & 0o077 != 0 {
            return Err(KeyError::Open { file: file.to_owned() });
        }
        Ok(Self { key: SigningKey::from_bytes(&seed), name: name_of(file) })
    }

    /// The public key, with which others check signatures of this key.
    pub fn public(&self) -> PublicKey {
        PublicKey { key: self.key.verifying_key(), name: self.name.clone() }
    }

    /// Signature of a message, as hexadecimal digits.
    pub(crate) fn sign(&self, message: &[u8]) -> String {
        hex(&self.key.sign(message).to_bytes())
    }
}

/// The file of the public key that belongs to the secret key in `file`.
pub fn public_file(file: &Path) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(".");
    name.push(ENDING);
    name.into()
}

fn name_of(file: &Path) -> String {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    name.strip_suffix(".pub").unwrap_or(&name).to_owned()
}

/// A key that checks signatures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PublicKey {
    key: VerifyingKey,
    name: String,
}

impl PublicKey {
    /// Reads a public key; its name is that of its file.
    ///
    /// # Errors
    /// The file cannot be read, or is not a public key.
    pub fn read(file: &Path) -> Result<Self, KeyError> {
        let reason = "its digits are no point of the curve";
        let bytes = read(file, PUBLIC)?;
        let key = VerifyingKey::from_bytes(&bytes);
        let key = key.map_err(|_| KeyError::Damaged { file: file.to_owned(), expected: PUBLIC, reason })?;
        Ok(Self { key, name: name_of(file) })
    }

    /// The name of its file, without `.pub`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The key as 64 hexadecimal digits.
    pub fn hex(&self) -> String {
        hex(self.key.as_bytes())
    }

    /// The first 16 digits, for messages.
    pub fn short(&self) -> String {
        self.hex().chars().take(16).collect()
    }

    /// Whether a signature, as hexadecimal digits, is that of this key for the message.
    pub(crate) fn verifies(&self, message: &[u8], signature: &str) -> bool {
        let signature = digits(signature).map(|bytes| Signature::from_bytes(&bytes));
        signature.is_some_and(|signature| self.key.verify_strict(message, &signature).is_ok())
    }
}

/// The public keys whose locks an installation accepts.
#[derive(Clone, Debug, Default)]
pub struct Trust {
    keys: Vec<PublicKey>,
}

impl Trust {
    /// Folders with trusted keys (`*.pub`): `/etc/panoscope/keys`, and `panoscope/keys` in the user's configuration
    /// folder.
    pub fn folders() -> Vec<PathBuf> {
        let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let config = absolute("XDG_CONFIG_HOME").or_else(|| Some(absolute("HOME")?.join(".config")));
        let own = config.map(|config| config.join("panoscope/keys"));
        std::iter::once(PathBuf::from(SYSTEM_FOLDER)).chain(own).collect()
    }

    /// The folder to name in messages about a missing key.
    pub(crate) fn folder_to_use() -> String {
        Self::folders().pop().unwrap_or_else(|| SYSTEM_FOLDER.into()).display().to_string()
    }

    /// The keys of [`Self::folders`].
    ///
    /// # Errors
    /// A file cannot be read or is not a public key: a key that was meant to be trusted must not be skipped silently.
    pub fn installed() -> Result<Self, KeyError> {
        Self::in_folders(&Self::folders())
    }

    /// The keys in some folders; one that does not exist has none.
    ///
    /// # Errors
    /// As [`Self::installed`].
    pub fn in_folders(folders: &[PathBuf]) -> Result<Self, KeyError> {
        let mut trust = Self::default();
        for folder in folders {
            let entries = match std::fs::read_dir(folder) {
                Ok(entries) => entries,
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
                Err(cause) => return Err(KeyError::File { file: folder.clone(), cause }),
            };
            let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
            files.retain(|file| file.extension().is_some_and(|e| e == ENDING));
            files.sort();
            for file in files {
                trust.add(PublicKey::read(&file)?);
            }
        }
        Ok(trust)
    }

    /// Trusts one more key.
    pub fn add(&mut self, key: PublicKey) {
        self.keys.push(key);
    }

    /// Whether no key is trusted.
    pub fn is_empty(&self) -> bool {
        self.keys.is_empty()
    }

    /// All trusted keys.
    pub fn keys(&self) -> &[PublicKey] {
        &self.keys
    }

    /// The trusted key with these hexadecimal digits.
    pub(crate) fn find(&self, hex: &str) -> Option<&PublicKey> {
        self.keys.iter().find(|key| key.hex() == hex)
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("panoscope_keys_{name}_{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_new_key_is_private_and_never_replaces_a_file() {
        let folder = folder("new");
        let file = folder.join("ward");
        let public = SecretKey::create(&file).unwrap();
        assert_eq!(std::fs::metadata(&file).unwrap().mode() & 0o777, 0o600);
        assert_eq!(PublicKey::read(&folder.join("ward.pub")).unwrap(), public);
        assert_eq!((public.name(), public.short().len()), ("ward", 16));
        let before = std::fs::read(&file).unwrap();
        assert!(matches!(SecretKey::create(&file), Err(KeyError::Exists { .. })));
        std::fs::remove_file(folder.join("ward.pub")).unwrap();
        assert!(matches!(SecretKey::create(&file), Err(KeyError::Exists { .. })));
        assert_eq!(std::fs::read(&file).unwrap(), before, "it is unchanged");
        assert_ne!(SecretKey::create(&folder.join("other")).unwrap().hex(), public.hex());
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_secret_key_that_others_can_read_is_refused() {
        let folder = folder("open");
        let file = folder.join("ward");
        SecretKey::create(&file).unwrap();
        SecretKey::read(&file).unwrap();
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o640)).unwrap();
        let error = SecretKey::read(&file).err().unwrap();
        assert!(matches!(error, KeyError::Open { .. }) && error.to_string().contains("chmod 600"), "{error}");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn files_that_are_no_keys_are_named() {
        let folder = folder("damaged");
        let file = folder.join("x.pub");
        for text in [
            &b""[..],
            b"hello",
            b"panoscope-secret-key 1 00",
            b"panoscope-public-key 9 00",
            b"panoscope-public-key 1 00",
            b"\xff\xfe",
        ] {
            std::fs::write(&file, text).unwrap();
            let error = PublicKey::read(&file).unwrap_err();
            assert!(matches!(error, KeyError::Damaged { .. }) && error.to_string().contains("x.pub"), "{error}");
        }
        assert!(Trust::in_folders(std::slice::from_ref(&folder)).is_err(), "a damaged key is not left out silently");
        std::fs::remove_file(&file).unwrap();
        SecretKey::create(&folder.join("ward")).unwrap();
        let trust = Trust::in_folders(&[folder.join("absent"), folder.clone()]).unwrap();
        assert_eq!(trust.keys().iter().map(PublicKey::name).collect::<Vec<_>>(), ["ward"]);
        std::fs::remove_dir_all(folder).unwrap();
    }
}
