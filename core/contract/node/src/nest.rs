//! Lists of declarations at compile time: how a flattened struct's list becomes part of another. Called by the derives.

/// Functions on lists of one type of declaration, which has a `name` and whose empty value is given.
macro_rules! lists {
    ($module:ident, $element:ident, $empty:expr) => {
        #[doc = concat!("Lists of `", stringify!($element), "`.")]
        pub mod $module {
            use crate::abi::$element;

            const EMPTY: $element = $empty;

            /// All lists, one after the other; `COUNT` is the sum of their lengths.
            pub const fn concat<const COUNT: usize>(lists: &[&[$element]]) -> [$element; COUNT] {
                let mut all = [EMPTY; COUNT];
                let (mut at, mut list) = (0, 0);
                while list < lists.len() {
                    let mut index = 0;
                    while index < lists[list].len() {
                        all[at] = $element { ..lists[list][index] };
                        (at, index) = (at + 1, index + 1);
                    }
                    list += 1;
                }
                assert!(at == COUNT);
                all
            }

            /// Whether an entry of the list has this name.
            pub const fn has_name(list: &[$element], name: &str) -> bool {
                let mut index = 0;
                while index < list.len() {
                    // SAFETY: the derive makes declarations, and it names them by static texts.
                    if crate::param::same(unsafe { list[index].name.bytes() }, name.as_bytes()) {
                        return true;
                    }
                    index += 1;
                }
                false
            }

            /// Whether no entry of one list has the name of an entry of the other.
            pub const fn are_disjoint(one: &[$element], other: &[$element]) -> bool {
                let mut index = 0;
                while index < one.len() {
                    // SAFETY: the derive makes declarations, and it names them by static texts, which are UTF-8.
                    let name = unsafe { std::str::from_utf8_unchecked(one[index].name.bytes()) };
                    if has_name(other, name) {
                        return false;
                    }
                    index += 1;
                }
                true
            }
        }
    };
}

lists!(
    params,
    Param,
    Param {
        name: crate::abi::Str::EMPTY,
        doc: crate::abi::Str::EMPTY,
        unit: crate::abi::Str::EMPTY,
        kind: 0,
        flags: 0,
        default_number: 0.0,
        min: 0.0,
        max: 0.0,
        step: 0.0,
        default_text: crate::abi::Str::EMPTY,
        choices: std::ptr::null(),
        choices_len: 0,
        default_floats: std::ptr::null(),
        default_floats_len: 0,
    }
);
lists!(ports, Port, crate::port::nameless("", 0, 0, 0));
