//! Names of classes, which differ between data sets and models.

/// `SpecimenBag`, `Specimen Bag` and `specimen_bag` become one class.
pub fn normal_name(name: &str) -> String {
    let mut out = String::new();
    let mut before = ' ';
    for c in name.trim().chars() {
        if c.is_whitespace() || c == '-' {
            if !out.ends_with('_') {
                out.push('_');
            }
        } else {
            if c.is_uppercase() && before.is_lowercase() {
                out.push('_');
            }
            out.extend(c.to_lowercase());
        }
        before = c;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::normal_name;

    #[test]
    fn ways_to_write_a_class_are_one() {
        for name in ["SpecimenBag", "Specimen Bag", "specimen_bag", " specimen-bag "] {
            assert_eq!(normal_name(name), "specimen_bag");
        }
    }
}
