//! Key files. An installation reads whole folders of them.

use std::os::unix::fs::PermissionsExt;

use panoscope_host::loader::keys::{PublicKey, SecretKey, Trust};

use crate::scratch;

pub fn run(bytes: &[u8]) {
    let file = scratch::file("keys/hospital.pub", bytes);
    match PublicKey::read(&file) {
        Ok(key) => {
            let hex = key.hex();
            assert!(hex.len() == 64 && key.short() == hex[..16] && key.name() == "hospital", "{key:?}");
            let copy = scratch::file("keys/copy.pub", format!("panoscope-public-key 1 {hex}\n").as_bytes());
            assert_eq!(PublicKey::read(&copy).expect("its own digits").hex(), hex);
            let text = String::from_utf8_lossy(bytes).to_lowercase();
            assert!(text.contains(&hex), "the key is not the one in the file");
        }
        Err(error) => assert!(error.to_string().contains("hospital.pub"), "{error}"),
    }
    // An installation reads all keys of its folders; one that is damaged is not left out.
    let _ = std::fs::remove_file(scratch::path("keys/copy.pub"));
    let folder = file.parent().expect("it is in a folder").to_owned();
    match Trust::in_folders(&[folder.join("absent"), folder]) {
        Ok(trust) => assert!(trust.keys().iter().map(PublicKey::name).eq(["hospital"]), "{:?}", trust.keys()),
        Err(error) => assert!(PublicKey::read(&file).is_err() && error.to_string().contains("hospital.pub"), "{error}"),
    }
    let file = scratch::file("keys/secret", bytes);
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).expect("its own file");
    match SecretKey::read(&file) {
        Ok(key) => assert_eq!(key.public().hex().len(), 64),
        Err(error) => {
            let words = error.to_string();
            assert!(words.contains("keys/secret"), "{words}");
            // A message must not give a key away.
            let text = String::from_utf8_lossy(bytes);
            let digits = text.split_whitespace().filter(|word| word.len() == 64);
            digits.for_each(|digits| assert!(!words.contains(digits), "{words}"));
        }
    }
}

pub fn seeds() -> Vec<Vec<u8>> {
    let public = "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a";
    let texts = [
        format!("panoscope-public-key 1 {public}\n"),
        format!("# the key of a hospital\n\npanoscope-public-key 1 {}\n", public.to_uppercase()),
        format!("panoscope-secret-key 1 {}\n", "9d".repeat(32)),
        format!("panoscope-public-key 2 {public}\n"),
        format!("panoscope-public-key 1 {}\n", "ff".repeat(32)),
        format!("panoscope-public-key 1 {}\n", "+f".repeat(32)),
        format!("panoscope-public-key 1 {public}\npanoscope-public-key 1 {public}\n"),
        String::new(),
    ];
    texts.into_iter().map(String::into_bytes).collect()
}
