//! Secrets in texts: addresses with a user and a password.
//!
//! Everything that shows, sends or stores a text of a parameter, a log line or an error passes it through [`redact`]
//! first. A graph need not hold a password at all: `rtsp://user:${PANOSCOPE_SECRET_ENDOSCOPE}@host/left` names an
//! environment variable, which [`resolve`] reads when the address is opened.

use std::borrow::Cow;

/// Beginning of the names of environment variables that addresses may use. A graph comes from elsewhere: it must not
/// read others and send them to a host of its choice.
pub const VARIABLE_PREFIX: &str = "PANOSCOPE_SECRET_";

/// Replacement for hidden text.
const HIDDEN: &str = "***";

/// Names of GStreamer properties and of fields of addresses whose values are not shown.
const SECRET_NAMES: [&str; 6] = ["user-pw", "proxy-pw", "password", "passwd", "passphrase", "access_token"];

/// A secret in an address cannot be resolved.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SecretError {
    /// No such environment variable.
    #[error(
        "an address uses the environment variable `{name}`, which is not set; set it before the start of the program"
    )]
    NotSet {
        /// Name of the variable.
        name: String,
    },
    /// A variable that addresses may not use.
    #[error(
        "an address uses the environment variable `{name}`; only names that begin with {VARIABLE_PREFIX} are allowed"
    )]
    Name {
        /// Name of the variable.
        name: String,
    },
}

/// User and password of the first address in `text`: their range of bytes, without the `@`.
fn user_info(text: &str) -> Option<(usize, usize)> {
    let mut from = 0;
    while let Some(at) = text[from..].find("://") {
        let start = from + at + 3;
        let is_end = |c: char| c.is_whitespace() || matches!(c, '"' | '\'' | '`' | '<' | '>');
        let word = text[start..].split(is_end).next().unwrap_or("");
        let host = word.split(['/', '?', '#']).next().unwrap_or("");
        // A password may have a slash, which belongs there encoded; what follows the colon is not a port then.
        let is_port = |port: &str| port.bytes().all(|b| b.is_ascii_digit()) || host.starts_with('[');
        let has_port = host.rsplit_once(':').is_none_or(|(_, port)| is_port(port));
        let end = host.rfind('@').or_else(|| if has_port { None } else { word.rfind('@') });
        if let Some(len) = end {
            return Some((start, start + len));
        }
        from = start;
    }
    None
}

/// A text without its secrets: `rtsp://user:password@host` becomes `rtsp://***@host`. Names of environment variables
/// stay.
pub fn redact(text: &str) -> Cow<'_, str> {
    let mut out = Cow::Borrowed(text);
    if text.contains("://") {
        let (mut whole, mut rest) = (String::new(), text);
        while let Some((start, end)) = user_info(rest) {
            let (before, info) = (&rest[..start], &rest[start..end]);
            whole.push_str(before);
            whole.push_str(if is_reference(info) { info } else { HIDDEN });
            rest = &rest[end..];
        }
        if !whole.is_empty() {
            out = Cow::Owned(whole + rest);
        }
    }
    for name in SECRET_NAMES {
        if let Cow::Owned(hidden) = redact_value(&out, name) {
            out = Cow::Owned(hidden);
        }
    }
    out
}

/// Whether the password of `user:password` is only the name of a variable.
fn is_reference(info: &str) -> bool {
    let password = info.split_once(':').map_or("", |(_, password)| password);
    let name = password.strip_prefix("${").and_then(|rest| rest.strip_suffix('}'));
    name.is_some_and(|name| !name.contains(['$', '{', '}']))
}

/// Hides the values of `name=value`.
fn redact_value<'t>(text: &'t str, name: &str) -> Cow<'t, str> {
    let (mut out, mut rest) = (String::new(), text);
    while let Some(at) = rest.find(name) {
        let (before, after) = rest.split_at(at + name.len());
        out.push_str(before);
        rest = after;
        let Some(value) = after.strip_prefix('=') else { continue };
        let quote = value.chars().next().filter(|c| matches!(c, '"' | '\''));
        let is_end = |c: char| match quote {
            Some(quote) => c == quote,
            None => c.is_whitespace() || matches!(c, '&' | '"' | '\'' | '`' | '!'),
        };
        let inside = &value[quote.map_or(0, char::len_utf8)..];
        let len = inside.find(is_end).unwrap_or(inside.len());
        if len > 0 {
            out.push('=');
            out.extend(quote);
            out.push_str(HIDDEN);
            rest = &inside[len..];
        }
    }
    if out.is_empty() { Cow::Borrowed(text) } else { Cow::Owned(out + rest) }
}

/// An address with the values of the environment variables that its user and password name as `${NAME}`, encoded as
/// addresses need it.
///
/// # Errors
/// A variable is not set, or may not be used.
pub fn resolve(text: &str) -> Result<Cow<'_, str>, SecretError> {
    resolve_with(text, |name| std::env::var(name).ok())
}

fn resolve_with(text: &str, variable: impl Fn(&str) -> Option<String>) -> Result<Cow<'_, str>, SecretError> {
    let (mut out, mut rest) = (String::new(), text);
    while let Some((start, end)) = user_info(rest) {
        let (before, mut info) = (&rest[..start], &rest[start..end]);
        out.push_str(before);
        while let Some((plain, (name, after))) =
            info.split_once("${").and_then(|(plain, after)| Some((plain, after.split_once('}')?)))
        {
            if !name.starts_with(VARIABLE_PREFIX) {
                return Err(SecretError::Name { name: name.to_owned() });
            }
            let value = variable(name).ok_or_else(|| SecretError::NotSet { name: name.to_owned() })?;
            out.push_str(plain);
            encode(&value, &mut out);
            info = after;
        }
        out.push_str(info);
        rest = &rest[end..];
    }
    Ok(if out.is_empty() { Cow::Borrowed(text) } else { Cow::Owned(out + rest) })
}

/// Encodes what has a meaning in an address.
fn encode(value: &str, out: &mut String) {
    for byte in value.bytes() {
        match byte {
            b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' => out.push(byte.into()),
            byte => *out += &format!("%{byte:02X}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn users_and_passwords_are_hidden() {
        for (text, shown) in [
            ("rtsp://surgeon:geheim@10.0.0.2:554/left", "rtsp://***@10.0.0.2:554/left"),
            (
                "cannot open rtsp://u:p@a/x, then `http://v:q@b`: refused",
                "cannot open rtsp://***@a/x, then `http://***@b`: refused",
            ),
            ("{\"left\":\"rtsp://u:p@[::1]:554/x\"}", "{\"left\":\"rtsp://***@[::1]:554/x\"}"),
            ("rtsp://u:p@ss@host/x", "rtsp://***@host/x"),
            ("rtsp://u:pa/ss@host/x", "rtsp://***@host/x"),
            ("rtsp://user@host", "rtsp://***@host"),
            (
                "rtspsrc location=rtsp://h/x user-id=u user-pw=geheim ! decodebin",
                "rtspsrc location=rtsp://h/x user-id=u user-pw=*** ! decodebin",
            ),
            ("user-pw=\"ge heim\" ! x", "user-pw=\"***\" ! x"),
            ("srt://host:9?passphrase=geheim&mode=caller", "srt://host:9?passphrase=***&mode=caller"),
        ] {
            assert_eq!(redact(text), shown);
            assert_eq!(redact(&redact(text)), shown, "once is enough");
        }
    }

    #[test]
    fn other_texts_stay_as_they_are() {
        for text in [
            "",
            "rtsp://host:554/left",
            "rtsp://[::1]:8554/a@b",
            "https://host/a@b",
            "a@b://",
            "3 px @ 20 Hz",
            "rtsp://u:${PANOSCOPE_SECRET_A}@host",
            "no password here",
            "password=",
        ] {
            assert!(matches!(redact(text), Cow::Borrowed(_)) || redact(text) == text, "{text}: {}", redact(text));
        }
    }

    #[test]
    fn secrets_come_from_the_environment() {
        let variable = |name: &str| (name == "PANOSCOPE_SECRET_A").then(|| "p@ss/w:ö".to_owned());
        let resolved = |text: &'static str| resolve_with(text, variable).map(Cow::into_owned);
        assert_eq!(
            resolved("rtsp://u:${PANOSCOPE_SECRET_A}@host/${x}"),
            Ok("rtsp://u:p%40ss%2Fw%3A%C3%B6@host/${x}".to_owned())
        );
        assert_eq!(resolved("rtsp://host/${PANOSCOPE_SECRET_A}"), Ok("rtsp://host/${PANOSCOPE_SECRET_A}".to_owned()));
        let name = "PANOSCOPE_SECRET_B".to_owned();
        assert_eq!(resolved("rtsp://u:${PANOSCOPE_SECRET_B}@host"), Err(SecretError::NotSet { name }));
        assert_eq!(resolved("rtsp://u:${HOME}@host"), Err(SecretError::Name { name: "HOME".to_owned() }));
    }
}
