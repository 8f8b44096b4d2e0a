//! Addresses to listen on.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::str::FromStr;

/// Where a [`crate::Monitor`] listens: `PORT` for this machine only, or `IP:PORT`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Address(SocketAddr);

/// A text that is not an address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{text}` is not an address to listen on; write a port such as 9464 (this machine only), or IP:PORT such as 0.0.0.0:9464"
)]
pub struct AddressError {
    /// The text.
    pub text: String,
}

impl Address {
    /// The address.
    pub fn socket(self) -> SocketAddr {
        self.0
    }

    /// Whether other machines can reach it.
    pub fn is_public(self) -> bool {
        !self.0.ip().is_loopback()
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let local = |port| SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), port);
        let address = text.parse().map(local).or_else(|_| text.parse::<SocketAddr>());
        address.map(Self).map_err(|_| AddressError { text: text.to_owned() })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_alone_is_this_machine_only() {
        let address: Address = "9464".parse().unwrap();
        assert_eq!((address.to_string().as_str(), address.is_public()), ("127.0.0.1:9464", false));
        assert!("0.0.0.0:0".parse::<Address>().unwrap().is_public());
        assert!(!"[::1]:80".parse::<Address>().unwrap().is_public());
    }

    #[test]
    fn other_texts_are_errors_with_a_remedy() {
        for text in ["", "localhost:80", "70000", "1.2.3.4", "-1"] {
            let error = text.parse::<Address>().unwrap_err().to_string();
            assert!(error.contains(&format!("`{text}`")) && error.contains("IP:PORT"), "{error}");
        }
    }
}
