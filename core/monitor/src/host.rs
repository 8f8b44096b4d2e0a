//! Which hosts a request may name.

use std::net::IpAddr;

use hyper::Uri;

/// Whether `Host` is an IP address or `localhost`. A page elsewhere can have its own name resolve to this machine and then read answers; the
/// `Host` of its requests is that name.
pub fn is_own_host(host: &str) -> bool {
    let Ok(uri) = host.parse::<Uri>() else { return false };
    let Some(name) = uri.host() else { return false };
    let name = name.trim_start_matches('[').trim_end_matches(']');
    name == "localhost" || name.parse::<IpAddr>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_and_localhost_are_own_hosts() {
        for host in ["127.0.0.1:9464", "localhost", "localhost:1", "[::1]:80", "10.0.0.2"] {
            assert!(is_own_host(host), "{host}");
        }
        for host in ["", "evil.example:9464", "localhost.evil.example", "127.0.0.1.evil.example", "a b"] {
            assert!(!is_own_host(host), "{host}");
        }
    }
}
