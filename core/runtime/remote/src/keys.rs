//! Certificates with which machines authenticate each other: a private authority, and a certificate and a key for each
//! machine.
//!
//! `panoscope keys DIR NAME...` makes `DIR/authority.pem` and `DIR/authority-key.pem` once, and for each machine a
//! folder `DIR/NAME` with the files that it needs. The key of the authority never leaves `DIR`.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::net::IpAddr;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, SanType,
};

pub use panoscope_host::attach::KEYS_VARIABLE;

const AUTHORITY: &str = "authority.pem";
const AUTHORITY_KEY: &str = "authority-key.pem";
const CERTIFICATE: &str = "certificate.pem";
const KEY: &str = "key.pem";
const NAME: &str = "name";

/// Keys that could not be made or read.
#[derive(Debug, thiserror::Error)]
pub enum KeysError {
    /// A file cannot be read or written.
    #[error("{file}: {cause}", file = file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// An invalid name.
    #[error("`{0}` cannot name a machine: a name has letters, digits, _ and -, as in `rack` or `rack=10.0.0.2`")]
    BadName(String),
    /// The machine has keys already.
    #[error("{folder} exists already; remove it to make new keys for `{name}`", folder = folder.display())]
    Exists {
        /// The machine.
        name: String,
        /// Its folder.
        folder: PathBuf,
    },
    /// Cryptography failed.
    #[error("certificates could not be made: {0}")]
    Crypto(#[from] rcgen::Error),
}

/// Whether a name is valid in zenoh keys and certificates: letters, digits, `_` and `-`.
pub fn is_name(name: &str) -> bool {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    !name.is_empty() && name.len() <= 64 && name.chars().all(fits)
}

/// The keys of this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Its name.
    pub name: String,
    /// Certificate of the authority.
    pub authority: PathBuf,
    /// Its certificate.
    pub certificate: PathBuf,
    /// The key of its certificate.
    pub key: PathBuf,
}

/// A machine to make keys for: its name, and its addresses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Member {
    name: String,
    addresses: Vec<String>,
}

impl Member {
    /// Reads `NAME` or `NAME=ADDRESS,ADDRESS`.
    ///
    /// # Errors
    /// The name is invalid.
    pub fn parse(text: &str) -> Result<Self, KeysError> {
        let (name, addresses) = text.split_once('=').unwrap_or((text, ""));
        if !is_name(name) {
            return Err(KeysError::BadName(text.to_owned()));
        }
        let addresses = addresses.split(',').map(str::trim).filter(|a| !a.is_empty()).map(str::to_owned).collect();
        Ok(Self { name: name.to_owned(), addresses })
    }
}

impl Identity {
    /// The keys in a folder that [`make`] made.
    ///
    /// # Errors
    /// A file is missing.
    pub fn read(folder: &Path) -> Result<Self, KeysError> {
        let file = |name: &str| {
            let file = folder.join(name);
            match fs::metadata(&file) {
                Ok(_) => Ok(file),
                Err(cause) => Err(KeysError::File { file, cause }),
            }
        };
        let named = file(NAME)?;
        let name = fs::read_to_string(&named).map_err(|cause| KeysError::File { file: named, cause })?;
        let name = name.trim().to_owned();
        if !is_name(&name) {
            return Err(KeysError::BadName(name));
        }
        Ok(Self { name, authority: file(AUTHORITY)?, certificate: file(CERTIFICATE)?, key: file(KEY)? })
    }

    /// The folder with the keys of this machine: `PANOSCOPE_KEYS`, else `panoscope/machine` in the user's configuration
    /// folder.
    pub fn folder() -> Option<PathBuf> {
        let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let given = std::env::var_os(KEYS_VARIABLE).filter(|value| !value.is_empty()).map(PathBuf::from);
        let config = || absolute("XDG_CONFIG_HOME").or_else(|| Some(absolute("HOME")?.join(".config")));
        given.or_else(|| Some(config()?.join("panoscope/machine")))
    }
}

/// Makes keys for machines in `folder`, and the authority that certifies them, if there is none yet. Returns the folder
/// of each machine.
///
/// # Errors
/// See [`KeysError`]. Nothing that exists is overwritten.
pub fn make(folder: &Path, members: &[Member]) -> Result<Vec<PathBuf>, KeysError> {
    let at = |file: &Path| {
        let file = file.to_owned();
        move |cause| KeysError::File { file, cause }
    };
    fs::create_dir_all(folder).map_err(at(folder))?;
    if let Some(member) = members.iter().find(|member| folder.join(&member.name).exists()) {
        return Err(KeysError::Exists { name: member.name.clone(), folder: folder.join(&member.name) });
    }
    let (certificate, key) = (folder.join(AUTHORITY), folder.join(AUTHORITY_KEY));
    let authority_key = if key.exists() {
        KeyPair::from_pem(&fs::read_to_string(&key).map_err(at(&key))?)?
    } else {
        let new = KeyPair::generate()?;
        write(&certificate, &authority()?.self_signed(&new)?.pem(), 0o644)?;
        write(&key, &new.serialize_pem(), 0o600)?;
        new
    };
    let authority_pem = fs::read_to_string(&certificate).map_err(at(&certificate))?;
    let issuer = Issuer::new(authority()?, authority_key);
    let mut folders = Vec::new();
    for member in members {
        let own = folder.join(&member.name);
        fs::create_dir(&own).map_err(at(&own))?;
        let key = KeyPair::generate()?;
        let certificate = params(member)?.signed_by(&key, &issuer)?;
        write(&own.join(AUTHORITY), &authority_pem, 0o644)?;
        write(&own.join(CERTIFICATE), &certificate.pem(), 0o644)?;
        write(&own.join(KEY), &key.serialize_pem(), 0o600)?;
        write(&own.join(NAME), &format!("{}\n", member.name), 0o644)?;
        folders.push(own);
    }
    Ok(folders)
}

/// The authority's certificate; always the same except for its key.
fn authority() -> Result<CertificateParams, KeysError> {
    let mut params = CertificateParams::new(Vec::<String>::new())?;
    params.distinguished_name = named("Panoscope machines");
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    Ok(params)
}

fn params(member: &Member) -> Result<CertificateParams, KeysError> {
    let mut params = CertificateParams::new(vec![member.name.clone()])?;
    for address in &member.addresses {
        params.subject_alt_names.push(match address.parse::<IpAddr>() {
            Ok(ip) => SanType::IpAddress(ip),
            Err(_) => SanType::DnsName(address.as_str().try_into()?),
        });
    }
    params.distinguished_name = named(&member.name);
    params.use_authority_key_identifier_extension = true;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
    Ok(params)
}

fn named(name: &str) -> DistinguishedName {
    let mut names = DistinguishedName::new();
    names.push(DnType::CommonName, name);
    names
}

fn write(file: &Path, text: &str, mode: u32) -> Result<(), KeysError> {
    let written = || OpenOptions::new().write(true).create_new(true).mode(mode).open(file)?.write_all(text.as_bytes());
    written().map_err(|cause| KeysError::File { file: file.to_owned(), cause })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn names_fit_keys() {
        assert!(is_name("rack") && is_name("theatre_2-b"));
        assert!(!is_name("") && !is_name("a/b") && !is_name("*") && !is_name("a b") && !is_name(&"x".repeat(65)));
    }

    #[test]
    fn keys_are_made_once_and_more_later() {
        let folder = std::env::temp_dir().join(format!("panoscope-keys-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        let members =
            |names: &[&str]| names.iter().map(|name| Member::parse(name).expect("a name")).collect::<Vec<_>>();
        let made = make(&folder, &members(&["theatre", "rack=127.0.0.1,rack.local"])).expect("keys");
        assert_eq!(made, [folder.join("theatre"), folder.join("rack")]);
        let rack = Identity::read(&made[1]).expect("keys");
        assert_eq!(rack.name, "rack");
        let mode = fs::metadata(&rack.key).expect("a file").permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "nobody else reads a key");
        assert!(matches!(make(&folder, &members(&["rack"])), Err(KeysError::Exists { .. })));
        make(&folder, &members(&["third"])).expect("keys by the same authority");
        let authority = |name: &str| fs::read(folder.join(name).join(AUTHORITY)).expect("a file");
        assert_eq!(authority("third"), authority("theatre"));
        assert!(Identity::read(&folder).is_err(), "that is no machine");
        assert!(Member::parse("a/b").is_err() && Member::parse("=10.0.0.1").is_err());
        let _ = fs::remove_dir_all(&folder);
    }
}
