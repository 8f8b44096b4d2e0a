//! The page, and its content security policy.

/// The page: one file, which loads nothing else.
pub const HTML: &str = include_str!("page.html");

/// Content security policy: scripts and styles of the page itself, images and state of this server, nothing else.
pub const POLICY: &str = "default-src 'none'; img-src 'self' blob:; connect-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";
