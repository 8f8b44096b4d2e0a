//! Numbers that are shown and typed as the language of the window writes them.

use eframe::egui::DragValue;
use eframe::egui::emath::{self, Numeric};
use eframe::egui::style::NumberFormatter;
use panoscope_editor_model::texts::with_decimal_sign;

/// A field for a number that is dragged or typed. A decimal comma is a decimal point.
pub fn drag_value<T: Numeric>(value: &mut T) -> DragValue<'_> {
    DragValue::new(value).custom_parser(parse)
}

/// Reads a number that somebody typed: with a decimal point or a decimal comma, spaces are ignored.
pub fn parse(text: &str) -> Option<f64> {
    let text: String = text.chars().filter(|c| !c.is_whitespace()).collect();
    text.replace('\u{2212}', "-").replace(',', ".").parse().ok()
}

/// Shows the numbers of sliders and fields with the decimal sign of the window's language, whichever it is at the time.
pub(crate) fn formatter() -> NumberFormatter {
    NumberFormatter::new(|value, places| with_decimal_sign(&emath::format_with_decimals_in_range(value, places)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_editor_model::texts::{Language, set_language};

    #[test]
    fn what_is_shown_can_be_typed() {
        for language in Language::ALL {
            set_language(language);
            for value in [0.0, -1.5, 1234.25, 1e-4] {
                assert_eq!(parse(&formatter().format(value, 0..=4)), Some(value), "{language:?}");
            }
        }
        assert_eq!(formatter().format(1.5, 0..=4), "1,5");
        assert_eq!(
            (parse(" 1 234,5 "), parse("\u{2212}2"), parse("2.5"), parse("x")),
            (Some(1234.5), Some(-2.0), Some(2.5), None)
        );
    }
}
