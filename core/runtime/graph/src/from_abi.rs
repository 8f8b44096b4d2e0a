//! Between the plugins' contract and the plain types of this crate: descriptors become catalog entries after every
//! field was checked, checked values become the snapshot that a call carries. Only with the feature `abi`.
//!
//! A descriptor may come from C, so nothing in it is trusted: pointers, lengths, texts, names and limits are checked
//! and an error names its location, for the plugin's author. What cannot be checked is whether a non-null pointer is
//! valid.

mod node_type;
mod validator;

use std::collections::HashSet;

use panoscope_abi as abi;
use panoscope_base::format::{FORMATS, IMAGE_FORMATS};
use thiserror::Error;

pub use self::node_type::whole;
pub use self::validator::problems_of;

use crate::catalog::{NodeType, Port};
use crate::packet::PacketType;
use crate::param::{Param, ParamKind, ParamValue, Pick};

/// Errors of a plugin's descriptor.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum FromAbiError {
    /// The entry function returned a null pointer.
    #[error("`panoscope_plugin` returned a null pointer")]
    NoDescriptor,
    /// The descriptor does not begin with the magic number.
    #[error("the descriptor opens with {found:#018x} instead of PANOSCOPE_MAGIC: this is not a Panoscope plugin")]
    Magic {
        /// Value found instead.
        found: u64,
    },
    /// Another major version of the contract.
    #[error("the plugin was built for ABI {found}, this host has ABI {supported}: rebuild the plugin")]
    AbiMajor {
        /// The plugin's.
        found: u32,
        /// The host's.
        supported: u32,
    },
    /// `struct_size` is too small, so fields are missing.
    #[error("{place}: struct_size is {found}; it must be at least {needed} (sizeof the struct)")]
    StructSize {
        /// Location of the error.
        place: String,
        /// As stated.
        found: u32,
        /// Size in this version of the contract, bytes.
        needed: usize,
    },
    /// A pointer is null or misaligned though its length is not 0.
    #[error("{place}: {field} is a {fault} pointer, its length is {len}")]
    Pointer {
        /// Location of the error.
        place: String,
        /// Which field.
        field: &'static str,
        /// `null` or `misaligned`.
        fault: &'static str,
        /// As stated.
        len: usize,
    },
    /// A length that only damaged memory explains.
    #[error("{place}: {field} has {len} entries, more than the {limit} allowed")]
    TooLong {
        /// Location of the error.
        place: String,
        /// Which field.
        field: &'static str,
        /// As stated.
        len: usize,
        /// Most that is accepted.
        limit: usize,
    },
    /// A text that is not UTF-8.
    #[error("{place}: {field} is not UTF-8 text")]
    NotUtf8 {
        /// Location of the error.
        place: String,
        /// Which field.
        field: &'static str,
    },
    /// A name that is not valid in graph files.
    #[error("{place}: `{name}` is not a valid name: names are letters, digits and `_`, and begin with a letter")]
    Name {
        /// Location of the error.
        place: String,
        /// As stated.
        name: String,
    },
    /// Two things of the same kind share a name.
    #[error("{place}: {what} `{name}` is declared twice")]
    Duplicate {
        /// Location of the error.
        place: String,
        /// `node type`, `input`, `output`, `parameter`, `choice`.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// A number outside its list of constants, or unknown flag bits.
    #[error("{place}: {field} is {found:#x}, which this host does not know")]
    Unknown {
        /// Location of the error.
        place: String,
        /// Which field.
        field: &'static str,
        /// As stated.
        found: u32,
    },
    /// A function that every node type needs is null.
    #[error("{place}: the function `{function}` is missing")]
    NoFunction {
        /// Location of the error.
        place: String,
        /// `open`, `process` or `close`.
        function: &'static str,
    },
    /// A declaration contradicts itself.
    #[error("{place}: {problem}")]
    Contradiction {
        /// Location of the error.
        place: String,
        /// Description of the problem.
        problem: String,
    },
}

type Result<T> = std::result::Result<T, FromAbiError>;

const MAX_NODE_TYPES: usize = 1024;
const MAX_PORTS: usize = 256;
const MAX_PARAMS: usize = 1024;
const MAX_CHOICES: usize = 1024;
const MAX_FLOATS: usize = 1 << 20;
const MAX_TEXT_BYTES: usize = 1 << 16;
/// Whole numbers cross as f64: beyond this they are not exact.
const MAX_INT: f64 = 9_007_199_254_740_992.0;

/// The node types that a plugin's descriptor declares, in its order.
///
/// # Errors
/// The first thing that is wrong with the descriptor.
///
/// # Safety
/// `plugin` is null or what a plugin's entry function returned: pointers in it that are neither null nor misaligned are
/// valid for their stated length. Nothing of it is referred to by the result.
pub unsafe fn node_types(plugin: *const abi::Plugin) -> Result<Vec<NodeType>> {
    if plugin.is_null() {
        return Err(FromAbiError::NoDescriptor);
    }
    let place = "the plugin's descriptor";
    if !plugin.is_aligned() {
        let place = place.to_owned();
        return Err(FromAbiError::Pointer { place, field: "panoscope_plugin()", fault: "misaligned", len: 1 });
    }
    // SAFETY: the caller's promise; the opening fields are in every version. Field by field, since the struct may be shorter.
    let (magic, major, size) = unsafe { ((*plugin).magic, (*plugin).abi_major, (*plugin).struct_size) };
    if magic != abi::MAGIC {
        return Err(FromAbiError::Magic { found: magic });
    }
    if major != abi::ABI_MAJOR {
        return Err(FromAbiError::AbiMajor { found: major, supported: abi::ABI_MAJOR });
    }
    struct_size(place, size, size_of::<abi::Plugin>())?;
    // SAFETY: the caller's promise, and the struct has all fields.
    let plugin = unsafe { &*plugin };
    // SAFETY: the caller's promise.
    let (name, _, _) = unsafe {
        (text(place, "name", plugin.name)?, text(place, "version", plugin.version)?, text(place, "doc", plugin.doc)?)
    };
    check_name(place, &name, true)?;
    let place = format!("plugin `{name}`");
    // SAFETY: the caller's promise.
    let pointers = unsafe { slice(&place, "node_types", plugin.node_types, plugin.node_types_len, MAX_NODE_TYPES)? };
    let mut types = Vec::with_capacity(pointers.len());
    let mut names = HashSet::new();
    for (index, &pointer) in pointers.iter().enumerate() {
        let at = format!("{place}, node type {}", index + 1);
        // SAFETY: the caller's promise.
        let found = unsafe { node_type::node_type(&place, at, &name, pointer)? };
        unique(&place, "node type", &found.name, &mut names)?;
        types.push(found);
    }
    Ok(types)
}

unsafe fn ports(node_place: &str, what: &'static str, ports: &[abi::Port]) -> Result<Vec<Port>> {
    let mut names = HashSet::new();
    let mut out = Vec::with_capacity(ports.len());
    for (index, port) in ports.iter().enumerate() {
        let place = format!("{node_place}, {what} {}", index + 1);
        // SAFETY: the caller's promise.
        let name = unsafe { text(&place, "name", port.name)? };
        check_name(&place, &name, false)?;
        unique(node_place, what, &name, &mut names)?;
        let place = format!("{node_place}, {what} `{name}`");
        // SAFETY: the caller's promise.
        let (packet, doc) = unsafe { (text(&place, "packet", port.packet)?, text(&place, "doc", port.doc)?) };
        check_name(&place, &packet, false)?;
        let flags = if what == "input" { abi::PORT_OPTIONAL | abi::PORT_LIST } else { 0 };
        known_bits(&place, "flags", port.flags, flags)?;
        let contradiction =
            |problem: &str| Err(FromAbiError::Contradiction { place: place.clone(), problem: problem.to_owned() });
        if packet == PacketType::ANY && what == "output" {
            return contradiction("an output says what it makes: only inputs may take `any` packet");
        }
        if let Some(format) = fixed_format(&packet)
            && port.formats != 0
            && port.formats != abi::format_bit(format)
        {
            return contradiction(&format!("its formats do not fit a `{packet}` packet"));
        }
        out.push(Port {
            name,
            doc,
            packet: PacketType {
                formats: formats(&place, &packet, port.formats)?,
                name: packet,
                layout_hash: port.layout_hash,
            },
            optional: port.flags & abi::PORT_OPTIONAL != 0,
            list: port.flags & abi::PORT_LIST != 0,
        });
    }
    Ok(out)
}

/// The only format of packets that are planes but not `image`.
fn fixed_format(packet: &str) -> Option<u32> {
    match packet {
        "mask" => Some(abi::FORMAT_GRAY8),
        "disparity" | "confidence" | "depth" => Some(abi::FORMAT_F32),
        "cloud" => Some(abi::FORMAT_CLOUD),
        _ => None,
    }
}

fn formats(place: &str, packet: &str, bits: u32) -> Result<Vec<String>> {
    if packet != "image" {
        return Ok(Vec::new());
    }
    known_bits(place, "formats", bits, IMAGE_FORMATS)?;
    if bits == 0 {
        let problem = "an `image` port names its formats, such as PANOSCOPE_FORMAT_BIT(PANOSCOPE_FORMAT_GRAY8)";
        return Err(FromAbiError::Contradiction { place: place.to_owned(), problem: problem.to_owned() });
    }
    let declared = FORMATS.iter().filter(|format| bits & abi::format_bit(format.id) != 0);
    Ok(declared.map(|format| format.name.to_owned()).collect())
}

unsafe fn params(node_place: &str, params: &[abi::Param]) -> Result<Vec<Param>> {
    let mut names = HashSet::new();
    let mut out = Vec::with_capacity(params.len());
    for (index, param) in params.iter().enumerate() {
        let place = format!("{node_place}, parameter {}", index + 1);
        // SAFETY: the caller's promise.
        let name = unsafe { text(&place, "name", param.name)? };
        check_name(&place, &name, false)?;
        unique(node_place, "parameter", &name, &mut names)?;
        let place = format!("{node_place}, parameter `{name}`");
        let picks = abi::PARAM_POINTS | abi::PARAM_RECTANGLES | abi::PARAM_FILE;
        let paths = abi::PARAM_MUST_EXIST | abi::PARAM_WRITES | abi::PARAM_SHIPPED;
        known_bits(&place, "flags", param.flags, abi::PARAM_REOPEN | paths | picks)?;
        // SAFETY: the caller's promise.
        out.push(unsafe {
            Param {
                doc: text(&place, "doc", param.doc)?,
                unit: text(&place, "unit", param.unit)?,
                kind: param_kind(&place, param)?,
                reopen: param.flags & abi::PARAM_REOPEN != 0,
                pick: pick(&place, param)?,
                writes: param.flags & abi::PARAM_WRITES != 0,
                shipped: param.flags & abi::PARAM_SHIPPED != 0,
                name,
            }
        });
    }
    Ok(out)
}

/// How a user picks the value; a path always names a file.
fn pick(place: &str, param: &abi::Param) -> Result<Pick> {
    let set = |flag: u32| param.flags & flag != 0;
    let (points, rectangles, file) = (set(abi::PARAM_POINTS), set(abi::PARAM_RECTANGLES), set(abi::PARAM_FILE));
    let problem = match param.kind {
        _ if u8::from(points) + u8::from(rectangles) + u8::from(file) > 1 => {
            "a value is picked as points, as rectangles or as a file"
        }
        abi::PARAM_FLOATS if file => "only a text or a path can name a file",
        abi::PARAM_FLOATS if points => return Ok(Pick::Points),
        abi::PARAM_FLOATS if rectangles => return Ok(Pick::Rectangles),
        _ if points || rectangles => "only a list of numbers can hold points or rectangles",
        abi::PARAM_PATH => return Ok(Pick::File),
        abi::PARAM_TEXT if file => return Ok(Pick::File),
        _ if file => "only a text or a path can name a file",
        _ => return Ok(Pick::None),
    };
    Err(FromAbiError::Contradiction { place: place.to_owned(), problem: problem.to_owned() })
}

/// Flags that contradict each other or the kind of the parameter.
fn contradiction_of_flags(param: &abi::Param) -> Option<String> {
    let of_paths = [
        (abi::PARAM_MUST_EXIST, "only a path can be asked to exist"),
        (abi::PARAM_WRITES, "only a path can name a file that is written"),
        (abi::PARAM_SHIPPED, "only a path can name a file that comes with the plugin"),
    ];
    if let Some((_, problem)) =
        of_paths.iter().find(|(flag, _)| param.flags & flag != 0 && param.kind != abi::PARAM_PATH)
    {
        return Some((*problem).to_owned());
    }
    if param.flags & abi::PARAM_WRITES != 0 && param.flags & (abi::PARAM_MUST_EXIST | abi::PARAM_SHIPPED) != 0 {
        return Some("a file that is written neither must exist nor comes with the plugin".to_owned());
    }
    None
}

/// Limits, step or default that contradict each other.
fn contradiction_of_numbers(param: &abi::Param) -> Option<String> {
    let (default, min, max, step) = (param.default_number, param.min, param.max, param.step);
    let numeric = matches!(param.kind, abi::PARAM_INT | abi::PARAM_FLOAT);
    if numeric || param.kind == abi::PARAM_FLOATS {
        if min.is_nan() || max.is_nan() || min > max {
            return Some(format!("the range {min} to {max} is empty"));
        }
        if step.is_nan() || step.is_infinite() || step < 0.0 {
            return Some(format!("{step} is no step"));
        }
    }
    if numeric && !(default >= min && default <= max) {
        return Some(format!("the default {default} lies outside the range {min} to {max}"));
    }
    None
}

/// A whole number with its limits, or what contradicts them.
fn int_kind(place: &str, param: &abi::Param) -> Result<ParamKind> {
    let contradiction = |problem: String| Err(FromAbiError::Contradiction { place: place.to_owned(), problem });
    let (default, min, max, step) = (param.default_number, param.min, param.max, param.step);
    let whole = |n: f64| n.fract() == 0.0 && n.abs() <= MAX_INT;
    let limit = |n: f64| if n.is_infinite() || whole(n) { Ok(n.is_finite().then_some(n as i64)) } else { Err(n) };
    let (min, max) = match (limit(min), limit(max)) {
        (Ok(min), Ok(max)) => (min, max),
        (Err(n), _) | (_, Err(n)) => return contradiction(format!("{n} is not a limit for a whole number")),
    };
    if !whole(default) || !whole(step) {
        return contradiction(format!("the default {default} and the step {step} must be whole numbers"));
    }
    let (default, step) = (default as i64, step as i64);
    if step > 1 && (default - min.unwrap_or(0)) % step != 0 {
        return contradiction(format!(
            "the default {default} is not on the steps of {step} that begin at {}",
            min.unwrap_or(0)
        ));
    }
    Ok(ParamKind::Int { default, min, max, step: (step > 0).then_some(step) })
}

unsafe fn param_kind(place: &str, param: &abi::Param) -> Result<ParamKind> {
    let contradiction = |problem: String| Err(FromAbiError::Contradiction { place: place.to_owned(), problem });
    let (default, min, max, step) = (param.default_number, param.min, param.max, param.step);
    if let Some(problem) = contradiction_of_flags(param).or_else(|| contradiction_of_numbers(param)) {
        return contradiction(problem);
    }
    Ok(match param.kind {
        abi::PARAM_BOOL => match default {
            0.0 => ParamKind::Bool { default: false },
            1.0 => ParamKind::Bool { default: true },
            other => return contradiction(format!("the default of a switch is 0 or 1, not {other}")),
        },
        abi::PARAM_INT => int_kind(place, param)?,
        abi::PARAM_FLOAT => {
            // A limit of the type itself says nothing.
            let limit = |n: f64| (n.abs() < f64::from(f32::MAX)).then_some(n);
            if !default.is_finite() {
                return contradiction(format!("the default {default} is not a number"));
            }
            ParamKind::Float { default, min: limit(min), max: limit(max), step: (step > 0.0).then_some(step) }
        }
        abi::PARAM_CHOICE => {
            // SAFETY: the caller's promise.
            let words = unsafe { slice(place, "choices", param.choices, param.choices_len, MAX_CHOICES)? };
            let mut choices = Vec::with_capacity(words.len());
            let mut seen = HashSet::new();
            for word in words {
                // SAFETY: the caller's promise.
                let word = unsafe { text(place, "choices", *word)? };
                if word.is_empty() || word.chars().any(char::is_control) {
                    return contradiction("a choice is an empty text or holds control characters".to_owned());
                }
                unique(place, "choice", &word, &mut seen)?;
                choices.push(word);
            }
            let index = default as usize;
            if default != index as f64 || index >= choices.len() {
                return contradiction(format!("the default is entry {default} of {} choices", choices.len()));
            }
            ParamKind::Choice { default: choices[index].clone(), choices }
        }
        // SAFETY: the caller's promise.
        abi::PARAM_TEXT => ParamKind::Text { default: unsafe { text(place, "default_text", param.default_text)? } },
        abi::PARAM_PATH => ParamKind::Path {
            // SAFETY: the caller's promise.
            default: unsafe { text(place, "default_text", param.default_text)? },
            must_exist: param.flags & abi::PARAM_MUST_EXIST != 0,
        },
        abi::PARAM_FLOATS => {
            let (from, len) = (param.default_floats, param.default_floats_len);
            // SAFETY: the caller's promise.
            let default = unsafe { slice(place, "default_floats", from, len, MAX_FLOATS)? }.to_vec();
            if default.iter().any(|n| !n.is_finite()) {
                return contradiction("the default holds a number that is not finite".to_owned());
            }
            if (default.len() as f64) < min || default.len() as f64 > max {
                return contradiction(format!("the default has {} numbers; allowed: {min} to {max}", default.len()));
            }
            let max_len = max.is_finite().then_some(max as usize);
            ParamKind::Floats { default, min_len: min.max(0.0) as usize, max_len }
        }
        found => return Err(FromAbiError::Unknown { place: place.to_owned(), field: "kind", found }),
    })
}

fn struct_size(place: &str, found: u32, needed: usize) -> Result<()> {
    if found as usize >= needed {
        return Ok(());
    }
    Err(FromAbiError::StructSize { place: place.to_owned(), found, needed })
}

fn known_bits(place: &str, field: &'static str, found: u32, known: u32) -> Result<()> {
    if found & !known == 0 {
        return Ok(());
    }
    Err(FromAbiError::Unknown { place: place.to_owned(), field, found: found & !known })
}

fn check_name(place: &str, name: &str, with_dash: bool) -> Result<()> {
    let mut chars = name.chars();
    let first = chars.next().is_some_and(|c| c.is_ascii_alphabetic());
    if first && chars.all(|c| c.is_ascii_alphanumeric() || c == '_' || (with_dash && c == '-')) {
        return Ok(());
    }
    Err(FromAbiError::Name { place: place.to_owned(), name: name.to_owned() })
}

fn unique(place: &str, what: &'static str, name: &str, seen: &mut HashSet<String>) -> Result<()> {
    if seen.insert(name.to_owned()) {
        return Ok(());
    }
    Err(FromAbiError::Duplicate { place: place.to_owned(), what, name: name.to_owned() })
}

/// # Safety
/// `from` is null, misaligned, or valid for `len` elements for as long as the result is used.
unsafe fn slice<'a, T>(place: &str, field: &'static str, from: *const T, len: usize, limit: usize) -> Result<&'a [T]> {
    if len == 0 {
        return Ok(&[]);
    }
    if len > limit {
        return Err(FromAbiError::TooLong { place: place.to_owned(), field, len, limit });
    }
    if from.is_null() || !from.is_aligned() {
        let fault = if from.is_null() { "null" } else { "misaligned" };
        return Err(FromAbiError::Pointer { place: place.to_owned(), field, fault, len });
    }
    // SAFETY: not null, aligned, a sane length; valid by the caller's promise.
    Ok(unsafe { std::slice::from_raw_parts(from, len) })
}

/// # Safety
/// As [`slice`].
unsafe fn text(place: &str, field: &'static str, text: abi::Str) -> Result<String> {
    // SAFETY: the caller's promise.
    let bytes = unsafe { slice(place, field, text.ptr, text.len, MAX_TEXT_BYTES)? };
    match std::str::from_utf8(bytes) {
        Ok(text) => Ok(text.to_owned()),
        Err(_) => Err(FromAbiError::NotUtf8 { place: place.to_owned(), field }),
    }
}

/// Values of a node's parameters in the form a call carries. Immutable; keeps alive what its values point to.
#[derive(Debug)]
pub struct ParamSnapshot {
    values: Box<[abi::ParamValue]>,
    // What `values` points into: heap blocks that do not move with this struct.
    _texts: Box<[Box<str>]>,
    _floats: Box<[Box<[f64]>]>,
}

impl ParamSnapshot {
    /// Lays out checked values. A path that is not UTF-8 is passed with its foreign bytes replaced.
    pub fn new(values: &[ParamValue]) -> Self {
        let mut texts: Vec<Box<str>> = Vec::new();
        let mut floats: Vec<Box<[f64]>> = Vec::new();
        let values = values
            .iter()
            .map(|value| {
                let mut out = abi::ParamValue {
                    kind: 0,
                    index: 0,
                    int_value: 0,
                    float_value: 0.0,
                    text: abi::Str::EMPTY,
                    floats: std::ptr::null(),
                    floats_len: 0,
                };
                let mut keep = |text: Box<str>| {
                    let kept = abi::Str::borrow(&text);
                    texts.push(text);
                    kept
                };
                match value {
                    ParamValue::Bool(flag) => (out.kind, out.int_value) = (abi::PARAM_BOOL, i64::from(*flag)),
                    ParamValue::Int(number) => (out.kind, out.int_value) = (abi::PARAM_INT, *number),
                    ParamValue::Float(number) => (out.kind, out.float_value) = (abi::PARAM_FLOAT, *number),
                    ParamValue::Choice { index, name } => {
                        (out.kind, out.index, out.text) =
                            (abi::PARAM_CHOICE, *index as u32, keep(name.as_str().into()));
                    }
                    ParamValue::Text(text) => (out.kind, out.text) = (abi::PARAM_TEXT, keep(text.as_str().into())),
                    ParamValue::Path(path) => {
                        (out.kind, out.text) = (abi::PARAM_PATH, keep(path.to_string_lossy().into()));
                    }
                    ParamValue::Floats(list) => {
                        let list: Box<[f64]> = list.as_slice().into();
                        (out.kind, out.floats, out.floats_len) = (abi::PARAM_FLOATS, list.as_ptr(), list.len());
                        floats.push(list);
                    }
                }
                out
            })
            .collect();
        Self { values, _texts: texts.into(), _floats: floats.into() }
    }

    /// The values, valid as long as the snapshot.
    pub fn values(&self) -> &[abi::ParamValue] {
        &self.values
    }
}
