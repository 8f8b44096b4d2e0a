//! Numbers as languages write them. Only for windows: files and logs have decimal points.

use super::{Language, Value, language};

/// A number with decimal places for a text.
#[must_use]
pub fn decimal(value: f64, places: u8) -> Value {
    Value::Number { value, places }
}

/// A number with decimal places in the language of this thread.
#[must_use]
pub fn number(value: f64, places: u8) -> String {
    written(language(), value, places)
}

pub(crate) fn written(language: Language, value: f64, places: u8) -> String {
    replaced(language, &format!("{value:.*}", usize::from(places)))
}

fn replaced(language: Language, formatted: &str) -> String {
    match language.decimal_sign() {
        '.' => formatted.to_owned(),
        sign => formatted.chars().map(|c| if c == '.' { sign } else { c }).collect(),
    }
}

/// A number that was formatted with a decimal point, as the language of this thread writes it.
#[must_use]
pub fn with_decimal_sign(formatted: &str) -> String {
    replaced(language(), formatted)
}

/// A number of bytes in MB or GB.
#[must_use]
pub fn bytes(count: u64) -> String {
    let mb = count as f64 / 1e6;
    if mb >= 1000.0 { format!("{} GB", number(mb / 1000.0, 1)) } else { format!("{} MB", number(mb, 0)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texts::set_language;

    #[test]
    fn numbers_have_the_sign_of_the_language() {
        assert_eq!(
            (number(1.25, 1), number(-3.0, 0), bytes(1_900_000_000)),
            ("1.2".into(), "-3".into(), "1.9 GB".into())
        );
        set_language(Language::German);
        assert_eq!(
            (number(1.25, 1), bytes(1_900_000_000), bytes(12_000_000)),
            ("1,2".into(), "1,9 GB".into(), "12 MB".into())
        );
        assert_eq!(with_decimal_sign("1.5e-3"), "1,5e-3");
    }
}
