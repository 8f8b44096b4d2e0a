//! Reads and builds data sets.

use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_object::InMemDicomObject;
use dicom_object::mem::InMemElement;

/// A data set.
pub(crate) type Set = InMemDicomObject;

/// An element with a text value.
pub(crate) fn text(tag: Tag, vr: VR, value: impl Into<String>) -> InMemElement {
    DataElement::new(tag, vr, PrimitiveValue::from(value.into()))
}

/// An element without a value.
pub(crate) fn empty(tag: Tag, vr: VR) -> InMemElement {
    DataElement::new(tag, vr, PrimitiveValue::Empty)
}

/// A number of 16 bits.
pub(crate) fn number(tag: Tag, value: u16) -> InMemElement {
    DataElement::new(tag, VR::US, PrimitiveValue::from(value))
}

/// A sequence.
pub(crate) fn sequence(tag: Tag, items: Vec<Set>) -> InMemElement {
    DataElement::new(tag, VR::SQ, DataSetSequence::from(items))
}

/// A data set of these elements.
pub(crate) fn set(elements: impl IntoIterator<Item = InMemElement>) -> Set {
    Set::from_element_iter(elements)
}

/// A text of a data set without padding; empty where there is none.
pub(crate) fn read(set: &Set, tag: Tag) -> String {
    let value = set.get(tag).and_then(|element| element.to_str().ok());
    value.map(|value| value.trim_end_matches('\0').trim().to_owned()).unwrap_or_default()
}

/// A number in a data set; `None` if it is missing.
pub(crate) fn read_number(set: &Set, tag: Tag) -> Option<u16> {
    set.get(tag)?.to_int::<u16>().ok()
}

/// The first item of a sequence.
pub(crate) fn first_item(set: &Set, tag: Tag) -> Option<&Set> {
    set.get(tag)?.items()?.first()
}

/// A code: value, scheme, meaning.
pub(crate) fn code(code: (&str, &str, &str)) -> Set {
    use dicom_dictionary_std::tags;
    set([
        text(tags::CODE_VALUE, VR::SH, code.0),
        text(tags::CODING_SCHEME_DESIGNATOR, VR::SH, code.1),
        text(tags::CODE_MEANING, VR::LO, code.2),
    ])
}

/// A decimal string, at most 16 characters.
pub(crate) fn decimal(value: f64) -> String {
    let exact = value.to_string();
    if exact.len() <= 16 {
        return exact;
    }
    (0..12)
        .rev()
        .map(|digits| format!("{value:.digits$}"))
        .find(|text| text.len() <= 16)
        .unwrap_or_else(|| format!("{value:.8e}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_fit_their_field() {
        for (value, expected) in
            [(12.5, "12.5"), (1.0 / 3.0, "0.33333333333"), (-123456.78901234567, "-123456.78901234")]
        {
            let text = decimal(value);
            assert!(text.len() <= 16 && (text.parse::<f64>().unwrap() - value).abs() < 1e-7, "{text}");
            assert!(text.starts_with(&expected[..4]), "{text}");
        }
        assert!(decimal(f64::MAX).len() <= 16 && decimal(1e-300).len() <= 16);
    }
}
