//! A TOML value with its byte span, in file order. A separate type, because numbers that do not fit and repeated tables
//! must survive to be reported; a plain deserializer stops at them.

use std::ops::Range;
use toml::de::{DeTable, DeValue};
use toml::value::Datetime;

/// Something read from the text, with its span.
#[derive(Clone, Debug, PartialEq)]
pub struct Spanned<T> {
    /// The read content.
    pub value: T,
    /// Bytes of the text.
    pub span: Range<usize>,
}

impl<T> Spanned<T> {
    pub(crate) fn new(value: T, span: Range<usize>) -> Self {
        Self { value, span }
    }
}

/// Entries in file order.
pub type Table = Vec<(Spanned<String>, Value)>;

/// A value with its location.
pub type Value = Spanned<Kind>;

/// What a value is.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// `true`, `false`
    Bool(bool),
    /// A whole number that fits 64 bits.
    Int(i64),
    /// A whole number that does not, as written.
    HugeInt(String),
    /// Any other number, `nan` and `inf` included.
    Float(f64),
    /// A text.
    Text(String),
    /// A date or time. No parameter takes one.
    Datetime(Datetime),
    /// `[ ... ]`
    List(Vec<Value>),
    /// `{ ... }`, `[table]` or dotted keys.
    Table(Table),
    /// An argument of the graph that has no value, or a wrong one; that is reported elsewhere.
    Missing,
}

impl Kind {
    /// Description of the kind, for "found ...".
    pub(crate) fn found(&self) -> &'static str {
        match self {
            Self::Bool(_) => "true or false",
            Self::Int(_) | Self::HugeInt(_) => "a whole number",
            Self::Float(_) => "a number with a fraction",
            Self::Text(_) => "a text",
            Self::Datetime(_) => "a date or time",
            Self::List(_) => "a list",
            Self::Table(_) => "a table",
            Self::Missing => "missing",
        }
    }

    pub(crate) fn text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    /// Value of any number.
    pub(crate) fn number(&self) -> Option<f64> {
        match self {
            Self::Int(i) => Some(*i as f64),
            Self::Float(f) => Some(*f),
            _ => None,
        }
    }

    /// The value without spans, for tables that are passed on as they are.
    pub(crate) fn plain(&self) -> toml::Value {
        match self {
            Self::Bool(b) => (*b).into(),
            Self::Int(i) => (*i).into(),
            Self::HugeInt(text) => text.as_str().into(),
            Self::Float(f) => (*f).into(),
            Self::Text(text) => text.as_str().into(),
            Self::Datetime(d) => toml::Value::Datetime(*d),
            Self::List(list) => toml::Value::Array(list.iter().map(|v| v.value.plain()).collect()),
            Self::Table(table) => toml::Value::Table(plain_table(table)),
            Self::Missing => "".into(),
        }
    }
}

/// Moves all spans of a table by `base` bytes.
pub(crate) fn shift(table: &mut Table, base: usize) {
    fn shift_value(value: &mut Value, base: usize) {
        move_by(&mut value.span, base);
        match &mut value.value {
            Kind::List(items) => items.iter_mut().for_each(|item| shift_value(item, base)),
            Kind::Table(table) => shift(table, base),
            _ => {}
        }
    }
    fn move_by(span: &mut Range<usize>, base: usize) {
        *span = span.start + base..span.end + base;
    }
    for (key, value) in table {
        move_by(&mut key.span, base);
        shift_value(value, base);
    }
}

pub(crate) fn plain_table(table: &Table) -> toml::Table {
    table.iter().map(|(k, v)| (k.value.clone(), v.value.plain())).collect()
}

pub(crate) fn from_toml(value: &toml::Spanned<DeValue<'_>>) -> Value {
    let kind = match value.get_ref() {
        DeValue::Boolean(b) => Kind::Bool(*b),
        DeValue::Integer(i) => match i64::from_str_radix(i.as_str(), i.radix()) {
            Ok(i) => Kind::Int(i),
            Err(_) => Kind::HugeInt(i.to_string()),
        },
        // The TOML grammar admits only what Rust parses; `inf` and `nan` are caught where a value is used.
        DeValue::Float(f) => Kind::Float(f.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::String(text) => Kind::Text(text.to_string()),
        DeValue::Datetime(d) => Kind::Datetime(*d),
        DeValue::Array(array) => Kind::List(array.iter().map(from_toml).collect()),
        DeValue::Table(table) => Kind::Table(table_from_toml(table)),
    };
    Spanned::new(kind, value.span())
}

pub(crate) fn table_from_toml(table: &DeTable<'_>) -> Table {
    let mut entries: Table =
        table.iter().map(|(k, v)| (Spanned::new(k.get_ref().to_string(), k.span()), from_toml(v))).collect();
    entries.sort_by_key(|(k, _)| k.span.start);
    entries
}
