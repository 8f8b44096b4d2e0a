//! Shared by nodes that serve video over the network: paths, and errors of listening.

use std::net::{IpAddr, SocketAddr};

/// Why a stream cannot be served.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum ServeError {
    /// The system does not allow listening on the address.
    #[error("cannot listen on {at}: {reason}; {help}")]
    Listen { at: SocketAddr, reason: String, help: &'static str },
    /// Another node already serves this path.
    #[error("node `{node}` already serves `{path}` on {at}: give this node another `path`")]
    Taken { node: String, path: String, at: SocketAddr },
}

/// What is wrong with a path of a stream; `None` if nothing.
fn path_problem(path: &str) -> Option<String> {
    if path.trim_matches('/').is_empty() {
        return Some("it is empty".to_owned());
    }
    let is_good = |c: char| c.is_ascii_alphanumeric() || "-_./~".contains(c);
    match path.chars().find(|&c| !is_good(c)) {
        Some(' ') => Some("it contains a space".to_owned()),
        Some(other) => Some(format!("it contains `{other}`")),
        None => None,
    }
}

/// A wrong parameter: its name, what is wrong, and what to write.
pub type Mistake = (&'static str, String, &'static str);

/// What is wrong with the address to listen on and the path of a stream.
pub fn address_mistakes(address: &str, path: &str) -> Vec<Mistake> {
    let mut mistakes = Vec::new();
    if address.parse::<IpAddr>().is_err() {
        let help = "write 127.0.0.1, 0.0.0.0 or the address of a network card";
        mistakes.push(("address", format!("`{address}` is not an IP address"), help));
    }
    if let Some(problem) = path_problem(path) {
        let help = "write letters, digits, `-`, `_`, `.` and `/`, such as `/wide`";
        mistakes.push(("path", format!("`{path}` is not a valid path of a stream: {problem}"), help));
    }
    mistakes
}

/// Converts a refusal of the system to an error that says what to do.
pub fn refused(at: SocketAddr, error: &std::io::Error) -> ServeError {
    let help = match error.kind() {
        std::io::ErrorKind::AddrInUse => "another program uses this port: give another `port`, or end that program",
        std::io::ErrorKind::AddrNotAvailable => "this machine has no such address: see `ip address`",
        std::io::ErrorKind::PermissionDenied if (1..1024).contains(&at.port()) => {
            "ports below 1024 need root: choose a higher `port`"
        }
        std::io::ErrorKind::PermissionDenied => "sockets are denied: remove `network` from the graph's `deny`",
        _ => "give another `address` or `port`",
    };
    ServeError::Listen { at, reason: error.to_string(), help }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_says_what_to_do() {
        let denied = std::io::Error::from(std::io::ErrorKind::PermissionDenied);
        for (port, words) in [(80, "below 1024"), (8889, "`deny`"), (0, "`deny`")] {
            let message = refused(SocketAddr::from(([127, 0, 0, 1], port)), &denied).to_string();
            assert!(message.contains(words) && message.contains("127.0.0.1"), "{message}");
        }
    }

    #[test]
    fn paths_are_plain() {
        for path in ["/live", "live", "/a/b-c_d.e"] {
            assert_eq!(path_problem(path), None, "{path}");
        }
        for (path, problem) in [("", "empty"), ("/", "empty"), ("/my view", "space"), ("/a?b", "`?`"), ("/ä", "`ä`")]
        {
            let found = path_problem(path).unwrap_or_default();
            assert!(found.contains(problem), "{path}: {found}");
        }
    }
}
