//! Parameters: one declaration serves the parser, `describe` and the editor.

use std::path::PathBuf;

use crate::abi;
use crate::error::{NodeError, Result};

/// A struct of parameters, made by `#[derive(Params)]`.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a struct of parameters",
    label = "not a struct of parameters",
    note = "write `#[derive(Params)]` above it; `#[param(flatten)]` takes such a struct, not a parameter"
)]
pub trait Params: Sized + Send + 'static {
    /// The declarations, in order.
    const PARAMS: &'static [abi::Param];

    /// Reads values in the order of the declarations.
    fn read(values: &[abi::ParamValue]) -> Result<Self>;
}

impl Params for () {
    const PARAMS: &'static [abi::Param] = &[];

    fn read(_: &[abi::ParamValue]) -> Result<Self> {
        Ok(())
    }
}

/// A type that a parameter may have.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a parameter type",
    label = "not a parameter",
    note = "parameters are `bool`, whole numbers up to 64 bits, `f32`, `f64`, `String`, `PathBuf`, `Vec<f64>` and enums with `#[derive(Choice)]`"
)]
pub trait ParamField: Sized {
    /// One of the `PARAM_` kinds.
    const KIND: u32;
    /// Smallest and largest value that the type can hold.
    const LIMITS: (f64, f64);
    /// Names of a choice's variants; empty for other types.
    const CHOICES: &'static [abi::Str] = &[];
    /// The compiler's message when the default is not one of the choices.
    const CHOICES_TEXT: &'static str = "";

    /// Converts the host's value. Fails when its kind differs or it does not fit the type.
    fn read(value: &abi::ParamValue) -> Result<Self>;
}

/// An enum that a parameter chooses from, made by `#[derive(Choice)]`.
pub trait Choice: Sized {
    /// Names in graph files.
    const WORDS: &'static [abi::Str];
    /// The compiler's message when a default is not one of the words.
    const WORDS_TEXT: &'static str;

    /// The variant at `index` in `WORDS`.
    fn from_index(index: u32) -> Option<Self>;
}

/// Largest whole number that a parameter may hold, because the ABI passes numbers as f64.
const MAX_INT: f64 = 9_007_199_254_740_992.0;

macro_rules! int_field {
    ($($ty:ty),*) => {$(
        impl ParamField for $ty {
            const KIND: u32 = abi::PARAM_INT;
            const LIMITS: (f64, f64) = {
                let (min, max) = (<$ty>::MIN as f64, <$ty>::MAX as f64);
                (if min < -MAX_INT { -MAX_INT } else { min }, if max > MAX_INT { MAX_INT } else { max })
            };

            fn read(value: &abi::ParamValue) -> Result<Self> {
                expect_kind(value, Self::KIND)?;
                <$ty>::try_from(value.int_value).map_err(|_| NodeError::new(format!("{} does not fit", value.int_value)))
            }
        }
    )*};
}
int_field!(u8, u16, u32, u64, usize, i8, i16, i32, i64);

macro_rules! float_field {
    ($($ty:ty),*) => {$(
        impl ParamField for $ty {
            const KIND: u32 = abi::PARAM_FLOAT;
            const LIMITS: (f64, f64) = (<$ty>::MIN as f64, <$ty>::MAX as f64);

            fn read(value: &abi::ParamValue) -> Result<Self> {
                expect_kind(value, Self::KIND)?;
                Ok(value.float_value as $ty)
            }
        }
    )*};
}
float_field!(f32, f64);

impl ParamField for bool {
    const KIND: u32 = abi::PARAM_BOOL;
    const LIMITS: (f64, f64) = (0.0, 1.0);

    fn read(value: &abi::ParamValue) -> Result<Self> {
        expect_kind(value, Self::KIND)?;
        Ok(value.int_value != 0)
    }
}

fn text(value: &abi::ParamValue) -> Result<&str> {
    // SAFETY: the host keeps the snapshot's texts valid for the length of the call.
    unsafe { value.text.text() }.ok_or_else(|| NodeError::new("a text parameter is not UTF-8"))
}

impl ParamField for String {
    const KIND: u32 = abi::PARAM_TEXT;
    const LIMITS: (f64, f64) = (0.0, 0.0);

    fn read(value: &abi::ParamValue) -> Result<Self> {
        expect_kind(value, Self::KIND)?;
        Ok(text(value)?.to_owned())
    }
}

impl ParamField for PathBuf {
    const KIND: u32 = abi::PARAM_PATH;
    const LIMITS: (f64, f64) = (0.0, 0.0);

    fn read(value: &abi::ParamValue) -> Result<Self> {
        expect_kind(value, Self::KIND)?;
        Ok(PathBuf::from(text(value)?))
    }
}

impl ParamField for Vec<f64> {
    const KIND: u32 = abi::PARAM_FLOATS;
    const LIMITS: (f64, f64) = (0.0, 4096.0);

    fn read(value: &abi::ParamValue) -> Result<Self> {
        expect_kind(value, Self::KIND)?;
        if value.floats_len == 0 {
            return Ok(Vec::new());
        }
        // SAFETY: the host keeps the snapshot's numbers valid for the length of the call.
        Ok(unsafe { std::slice::from_raw_parts(value.floats, value.floats_len) }.to_vec())
    }
}

/// Implements [`ParamField`] for a [`Choice`]; used by the derive.
#[doc(hidden)]
#[macro_export]
macro_rules! choice_param_field {
    ($ty:ty) => {
        impl $crate::ParamField for $ty {
            const KIND: u32 = $crate::abi::PARAM_CHOICE;
            const LIMITS: (f64, f64) = (0.0, 0.0);
            const CHOICES: &'static [$crate::abi::Str] = <$ty as $crate::Choice>::WORDS;
            const CHOICES_TEXT: &'static str = <$ty as $crate::Choice>::WORDS_TEXT;

            fn read(value: &$crate::abi::ParamValue) -> $crate::Result<Self> {
                <$ty as $crate::Choice>::from_index(value.index)
                    .ok_or_else(|| $crate::NodeError::new("the host passed a choice that does not exist"))
            }
        }
    };
}

fn expect_kind(value: &abi::ParamValue, kind: u32) -> Result<()> {
    if value.kind == kind {
        return Ok(());
    }
    Err(NodeError::new(format!("a parameter of kind {kind} was given a value of kind {}", value.kind)))
}

/// The error for a host that passed another number of values than declared.
pub fn wrong_param_count(expected: usize, found: usize) -> NodeError {
    NodeError::new(format!("{expected} parameters are declared, but the host passed {found}"))
}

/// The literal after `default =`.
pub enum DefaultValue {
    /// A number.
    Number(f64),
    /// `true` or `false`.
    Flag(bool),
    /// A text, a path or the word of a choice.
    Text(&'static str),
    /// A list of numbers.
    Floats(&'static [f64]),
}

/// A parameter's declaration as the derive reads it.
pub struct Declared {
    /// Name in graph files.
    pub name: &'static str,
    /// The field's doc comment; shown as a tooltip.
    pub doc: &'static str,
    /// Unit or empty.
    pub unit: &'static str,
    /// `PARAM_` kind of the field's type.
    pub kind: u32,
    /// Values of the field's type.
    pub limits: (f64, f64),
    /// Names of a choice's variants; empty for other types.
    pub choices: &'static [abi::Str],
    /// Value when the graph does not set the parameter.
    pub default: DefaultValue,
    /// Low end of the range.
    pub min: Option<f64>,
    /// High end of the range.
    pub max: Option<f64>,
    /// Distance between allowed numbers, from the low end on; 0 when every number is allowed.
    pub step: f64,
    /// A change reopens the node.
    pub reopen: bool,
    /// The path must exist.
    pub must_exist: bool,
    /// The node writes the path's file.
    pub writes: bool,
    /// The default comes with the plugin.
    pub shipped: bool,
    /// Way of picking the value in the editor: `PARAM_POINTS`, `PARAM_RECTANGLES`, `PARAM_FILE`, or 0 for none of them.
    pub pick: u32,
}

pub(crate) const fn same(a: &[u8], b: &[u8]) -> bool {
    if a.len() != b.len() {
        return false;
    }
    let mut i = 0;
    while i < a.len() {
        if a[i] != b[i] {
            return false;
        }
        i += 1;
    }
    true
}

/// Whether the type is a number; called by the derive.
pub const fn is_number<T: ParamField>() -> bool {
    T::KIND == abi::PARAM_INT || T::KIND == abi::PARAM_FLOAT
}

/// Whether the type is a switch; called by the derive.
pub const fn is_flag<T: ParamField>() -> bool {
    T::KIND == abi::PARAM_BOOL
}

/// Whether the type is a path; called by the derive.
pub const fn is_path<T: ParamField>() -> bool {
    T::KIND == abi::PARAM_PATH
}

/// Whether the type takes a text as default; called by the derive.
pub const fn is_text<T: ParamField>() -> bool {
    T::KIND == abi::PARAM_TEXT || T::KIND == abi::PARAM_PATH || T::KIND == abi::PARAM_CHOICE
}

/// Whether the type is a list of numbers; called by the derive.
pub const fn is_floats<T: ParamField>() -> bool {
    T::KIND == abi::PARAM_FLOATS
}

/// Whether a whole number can be reached by steps from the low end; called by the derive.
pub const fn on_step<T: ParamField>(number: f64, min: f64, step: f64) -> bool {
    T::KIND != abi::PARAM_INT || (step >= 1.0 && (number - min) % step == 0.0)
}

/// Whether a word is one of the type's choices, or the type is not a choice; called by the derive.
pub const fn has_word<T: ParamField>(word: &str) -> bool {
    T::KIND != abi::PARAM_CHOICE || index_of(T::CHOICES, word) < T::CHOICES.len()
}

/// Index of a word; the list's length when it is not in the list.
const fn index_of(words: &[abi::Str], word: &str) -> usize {
    let mut index = 0;
    // SAFETY: choices are static texts made by the derive.
    while index < words.len() && !same(unsafe { words[index].bytes() }, word.as_bytes()) {
        index += 1;
    }
    index
}

/// Converts a declaration to the ABI's form. The derive has checked it, with messages that point at the source text.
pub const fn param(d: Declared) -> abi::Param {
    let mut out = abi::Param {
        name: abi::Str::new(d.name),
        doc: abi::Str::new(d.doc),
        unit: abi::Str::new(d.unit),
        kind: d.kind,
        flags: if d.reopen { abi::PARAM_REOPEN } else { 0 }
            | if d.must_exist { abi::PARAM_MUST_EXIST } else { 0 }
            | if d.writes { abi::PARAM_WRITES } else { 0 }
            | if d.shipped { abi::PARAM_SHIPPED } else { 0 }
            | d.pick,
        default_number: 0.0,
        min: d.limits.0,
        max: d.limits.1,
        step: d.step,
        default_text: abi::Str::EMPTY,
        choices: d.choices.as_ptr(),
        choices_len: d.choices.len(),
        default_floats: std::ptr::null(),
        default_floats_len: 0,
    };
    if let (Some(min), Some(max)) = (d.min, d.max) {
        out.min = min;
        out.max = max;
    }
    match d.default {
        DefaultValue::Number(number) => out.default_number = number,
        DefaultValue::Flag(flag) => out.default_number = if flag { 1.0 } else { 0.0 },
        DefaultValue::Text(text) => {
            if d.kind == abi::PARAM_CHOICE {
                out.default_number = index_of(d.choices, text) as f64;
            }
            out.default_text = abi::Str::new(text);
        }
        DefaultValue::Floats(floats) => {
            out.default_floats = floats.as_ptr();
            out.default_floats_len = floats.len();
        }
    }
    out
}
