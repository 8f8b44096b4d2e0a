//! Checks of HTTP requests, for servers of web pages.

use std::net::{IpAddr, SocketAddr};

/// Whether the field `Host` of a request is an IP address or `localhost`, with or without a port. This stops DNS
/// rebinding: a page elsewhere can make its own name resolve to this machine and read responses, but the `Host` of its
/// requests is that name.
pub fn is_own_host(host: &str) -> bool {
    let address = host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(host);
    let is_name = |host: &str| host == "localhost";
    host.parse::<SocketAddr>().is_ok()
        || address.parse::<IpAddr>().is_ok()
        || is_name(host)
        || host.split_once(':').is_some_and(|(name, port)| is_name(name) && port.parse::<u16>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_and_localhost_are_own_hosts() {
        for host in ["127.0.0.1:9464", "localhost", "localhost:1", "[::1]:80", "[::1]", "10.0.0.2"] {
            assert!(is_own_host(host), "{host}");
        }
        let foreign =
            ["", "evil.example:9464", "localhost.evil.example", "127.0.0.1.evil.example", "a b", "localhost:x", ":1"];
        for host in foreign {
            assert!(!is_own_host(host), "{host}");
        }
    }
}
