//! The page, and what a browser may do with it.

/// The page: one file, which loads nothing from elsewhere.
pub const HTML: &str = include_str!("page.html");

/// Scripts and styles of the page itself, pictures and state of this server, nothing else.
pub const POLICY: &str = "default-src 'none'; img-src 'self' blob:; connect-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";
