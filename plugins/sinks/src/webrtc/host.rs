//! Which requests of browsers are accepted: those of pages of this server.

use hyper::header::{HOST, HeaderMap, HeaderName, ORIGIN};
use panoscope_base::web::is_own_host;

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Foreign {
    /// `Host` is a name, which could belong to another page.
    #[error("use an IP address or `localhost` as the host: a name could belong to another page")]
    Host,
    /// A page of another origin sent it.
    #[error("only pages of this server may send requests: open the server's own page")]
    Origin,
}

fn only<'h>(headers: &'h HeaderMap, name: &HeaderName) -> Option<&'h str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(value)
}

/// Refuses requests that a page of another origin made a browser send. Programs send no `Origin`.
///
/// # Errors
/// Why the request is refused.
pub fn check(headers: &HeaderMap) -> Result<(), Foreign> {
    let host = only(headers, &HOST).filter(|host| is_own_host(host)).ok_or(Foreign::Host)?;
    if !headers.contains_key(ORIGIN) {
        return Ok(());
    }
    let origin = only(headers, &ORIGIN).and_then(|origin| origin.strip_prefix("http://"));
    if origin == Some(host) { Ok(()) } else { Err(Foreign::Origin) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(fields: &[(HeaderName, &'static str)]) -> Result<(), Foreign> {
        let mut headers = HeaderMap::new();
        for (name, value) in fields {
            headers.append(name, value.parse().unwrap());
        }
        check(&headers)
    }

    #[test]
    fn only_own_hosts_and_origins_may_ask() {
        for host in ["127.0.0.1:8889", "localhost:1", "[::1]:80", "10.0.0.2"] {
            assert_eq!(checked(&[(HOST, host)]), Ok(()), "{host}");
        }
        for host in ["", "evil.example:8889", "127.0.0.1.evil.example", "a b"] {
            assert_eq!(checked(&[(HOST, host)]), Err(Foreign::Host), "{host}");
        }
        assert_eq!(checked(&[]), Err(Foreign::Host));
        assert_eq!(checked(&[(HOST, "10.0.0.2"), (HOST, "10.0.0.2")]), Err(Foreign::Host));
        let own = (HOST, "127.0.0.1:8889");
        assert_eq!(checked(&[own.clone(), (ORIGIN, "http://127.0.0.1:8889")]), Ok(()));
        for origin in ["null", "http://evil.example", "http://127.0.0.1:8890", "https://127.0.0.1:8889", ""] {
            assert_eq!(checked(&[own.clone(), (ORIGIN, origin)]), Err(Foreign::Origin), "{origin}");
        }
    }
}
