//! Parameters: names, types, limits; the file's own and those of `--set`.

use super::Checker;
use crate::args::absolute_files;
use crate::catalog::NodeType;
use crate::file::NodeText;
use crate::installed;
use crate::nearest::{list, nearest};
use crate::param::{Param, ParamKind, ParamValue, Pick};
use crate::parse::parse_value;
use crate::text::Override;
use crate::value::{Kind, Value};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A problem of a value.
struct Wrong {
    code: &'static str,
    span: Range<usize>,
    message: String,
    label: String,
    help: String,
}

impl<'a> Checker<'a> {
    /// Values of all nodes, each in its type's declaration order; a mistake leaves the default.
    pub(super) fn params(&mut self) -> Vec<Vec<ParamValue>> {
        let mut all = Vec::with_capacity(self.text.flat.nodes.len());
        for (index, node) in self.text.flat.nodes.iter().enumerate() {
            let Some(node_type) = self.type_of(index) else {
                all.push(Vec::new());
                continue;
            };
            let errors = self.diagnostics.errors();
            all.push(self.node_params(index, node, node_type));
            self.sound[index] &= self.diagnostics.errors() == errors;
        }
        for over in &self.text.overrides {
            let errors = self.diagnostics.errors();
            let given = self.set(over);
            if self.diagnostics.errors() > errors
                && let Some(&index) = self.ids.get(over.node.value.as_str())
            {
                self.sound[index] = false;
            }
            if let Some((node, param, value)) = given
                && let Some(slot) = all[node].get_mut(param)
            {
                *slot = value;
            }
        }
        all
    }

    fn node_params(&mut self, index: usize, node: &'a NodeText, node_type: &'a NodeType) -> Vec<ParamValue> {
        let mut given: Vec<Option<ParamValue>> = vec![None; node_type.params.len()];
        for (key, value) in &node.params {
            let Some(position) = node_type.param(&key.value) else {
                self.unknown_param(&key.span, node_type, &key.value);
                continue;
            };
            let param = &node_type.params[position];
            if value.value == Kind::Missing {
                // The argument has no value; that is said once, at the argument.
                given[position] = Some(self.default(node_type, param));
                let is_set = |o: &Override| o.node.value == node.id.value && o.param.value == key.value;
                self.sound[index] &= self.text.overrides.iter().any(is_set);
                continue;
            }
            match self.value(param, value) {
                Ok(value) => given[position] = Some(value),
                Err(wrong) => {
                    // A default stands in, so that it is not reported as missing too.
                    given[position] = Some(self.default(node_type, param));
                    self.wrong(wrong);
                }
            }
        }
        let mut values = Vec::with_capacity(given.len());
        for (param, value) in node_type.params.iter().zip(given) {
            let value = value.unwrap_or_else(|| {
                self.default_file(index, node, node_type, param);
                self.default(node_type, param)
            });
            values.push(value);
        }
        values
    }

    /// Reports a missing default file, unless `--set` gives another.
    fn default_file(&mut self, index: usize, node: &'a NodeText, node_type: &NodeType, param: &Param) {
        let ParamKind::Path { default, must_exist: true } = &param.kind else { return };
        let replaced =
            |o: &Override| self.ids.get(o.node.value.as_str()) == Some(&index) && o.param.value == param.name;
        let path = self.default_path(node_type, param, default);
        if default.is_empty() || path.exists() || self.text.overrides.iter().any(replaced) {
            return;
        }
        let message = format!("`{}` of this node is `{default}` unless given, and there is no such file", param.name);
        let mut help = format!("give one, as in params = {{ {} = \"...\" }}, relative to the graph file", param.name);
        if param.shipped {
            help = format!("it comes with plugin `{}`, as {}\n{help}", node_type.plugin, path.display());
        }
        self.error("missing-file", &node.id.span, message).help(help);
    }

    pub(super) fn unknown_param(&mut self, span: &Range<usize>, node_type: &NodeType, name: &str) {
        let names = || node_type.params.iter().map(|p| p.name.as_str());
        let label = match nearest(name, names()) {
            Some(near) => format!("did you mean `{near}`?"),
            None if node_type.input(name).is_some() => "an input: it belongs under `inputs`".to_owned(),
            None => String::new(),
        };
        let help = if node_type.params.is_empty() {
            format!("`{}` has no parameters", node_type.name)
        } else {
            format!("parameters: {}", list(names(), 20, "and"))
        };
        let message = format!("`{}` has no parameter `{name}`", node_type.name);
        self.error("unknown-param", span, message).label(label).help(help);
    }

    fn wrong(&mut self, wrong: Wrong) {
        self.error(wrong.code, &wrong.span, wrong.message).label(wrong.label).help(wrong.help);
    }

    fn set(&mut self, over: &'a Override) -> Option<(usize, usize, ParamValue)> {
        if self.doubled.contains(over.node.value.as_str()) {
            return None;
        }
        let Some(&node) = self.ids.get(over.node.value.as_str()) else {
            let ids = || self.text.flat.nodes.iter().map(|n| n.id.value.as_str());
            let near = nearest(&over.node.value, ids()).map(|n| format!("did you mean `{n}`?"));
            let message = format!("there is no node `{}`", over.node.value);
            let help = format!("nodes: {}", list(ids(), 12, "and"));
            self.error("unknown-node", &over.node.span, message).label(near.unwrap_or_default()).help(help);
            return None;
        };
        let node_type = self.type_of(node)?;
        let Some(position) = node_type.param(&over.param.value) else {
            self.unknown_param(&over.param.span, node_type, &over.param.value);
            return None;
        };
        let param = &node_type.params[position];
        let kind = match (&param.kind, parse_value(&over.value.value).map(|v| v.value)) {
            // A shell eats quotes, so words need none here.
            (ParamKind::Text { .. } | ParamKind::Path { .. } | ParamKind::Choice { .. }, parsed) => match parsed {
                Some(Kind::Text(text)) => Kind::Text(text),
                _ => Kind::Text(over.value.value.clone()),
            },
            (_, Some(kind)) => kind,
            (_, None) => Kind::Text(over.value.value.clone()),
        };
        match self.value(param, &Value::new(kind, over.value.span.clone())) {
            Ok(value) => Some((node, position, value)),
            Err(mut wrong) => {
                // Spans inside a list are those of the value alone.
                wrong.span = over.value.span.clone();
                self.wrong(wrong);
                None
            }
        }
    }

    fn default(&self, node_type: &NodeType, param: &Param) -> ParamValue {
        match &param.kind {
            ParamKind::Bool { default } => ParamValue::Bool(*default),
            ParamKind::Int { default, .. } => ParamValue::Int(*default),
            ParamKind::Float { default, .. } => ParamValue::Float(*default),
            ParamKind::Choice { default, choices } => {
                let index = choices.iter().position(|c| c == default).unwrap_or(0);
                ParamValue::Choice { index, name: default.clone() }
            }
            ParamKind::Text { default } => ParamValue::Text(default.clone()),
            ParamKind::Path { default, .. } => ParamValue::Path(self.default_path(node_type, param, default)),
            ParamKind::Floats { default, .. } => ParamValue::Floats(default.clone()),
        }
    }

    /// Path of a default: next to the plugin when it is shipped with it, else next to the graph file.
    fn default_path(&self, node_type: &NodeType, param: &Param, default: &str) -> PathBuf {
        match param.shipped && !default.is_empty() {
            true => node_type.shipped_dir.join(default),
            false => self.resolve_param(&(0..0), param, default),
        }
    }

    /// The path of a parameter: relative to the file that contains the span; for written paths of installed graphs, to
    /// the folder for outputs.
    fn resolve_param(&self, span: &Range<usize>, param: &Param, path: &str) -> PathBuf {
        let is_relative = !path.is_empty() && Path::new(path).is_relative();
        if param.writes && is_relative && installed::data_dir(&self.text.sources.of(span).dir).is_some() {
            return installed::output(path);
        }
        self.resolve_at(span, path)
    }

    /// A path that is relative to the graph file.
    pub(super) fn resolve(&self, path: &str) -> PathBuf {
        self.resolve_at(&(0..0), path)
    }

    /// A path that is relative to the file that contains a span.
    pub(super) fn resolve_at(&self, span: &Range<usize>, path: &str) -> PathBuf {
        if path.is_empty() { PathBuf::new() } else { self.text.sources.of(span).dir.join(path) }
    }

    fn value(&self, param: &Param, value: &Value) -> Result<ParamValue, Wrong> {
        let name = &param.name;
        match (&param.kind, &value.value) {
            (ParamKind::Bool { .. }, Kind::Bool(b)) => Ok(ParamValue::Bool(*b)),
            (ParamKind::Int { min, max, step, .. }, Kind::Int(i)) => {
                in_range(param, value, min.is_none_or(|m| *i >= m) && max.is_none_or(|m| *i <= m), &i.to_string())?;
                on_step(param, value, *i, *min, *max, *step)?;
                Ok(ParamValue::Int(*i))
            }
            (ParamKind::Int { .. }, Kind::Float(f)) if f.fract() == 0.0 && f.abs() < 1e15 => {
                Err(Wrong { help: format!("write {}", *f as i64), ..wrong_type(param, value) })
            }
            (ParamKind::Int { .. } | ParamKind::Float { .. }, Kind::HugeInt(digits)) => {
                let shown = if digits.len() <= 24 { digits.as_str() } else { "too large" };
                Err(out_of_range(param, value, shown))
            }
            (ParamKind::Float { .. }, Kind::Float(f)) if !f.is_finite() => Err(not_finite(param, &value.span, *f)),
            (ParamKind::Float { min, max, .. }, Kind::Float(_) | Kind::Int(_)) => {
                let number = value.value.number().unwrap_or_default();
                let inside = min.is_none_or(|m| number >= m) && max.is_none_or(|m| number <= m);
                in_range(param, value, inside, &number.to_string())?;
                Ok(ParamValue::Float(number))
            }
            (ParamKind::Choice { choices, .. }, Kind::Text(text)) => match choices.iter().position(|c| c == text) {
                Some(index) => Ok(ParamValue::Choice { index, name: text.clone() }),
                None => {
                    let words = || choices.iter().map(String::as_str);
                    let near = nearest(text, words()).map(|n| format!("did you mean \"{n}\"?"));
                    let quoted: Vec<String> = words().map(|w| format!("\"{w}\"")).collect();
                    Err(Wrong {
                        code: "unknown-choice",
                        span: value.span.clone(),
                        message: format!("`{text}` is not a choice of `{name}`"),
                        label: near.unwrap_or_default(),
                        help: format!("choices: {}", quoted.join(", ")),
                    })
                }
            },
            (ParamKind::Text { .. }, Kind::Text(text)) => {
                let dir = &self.text.sources.of(&value.span).dir;
                // Nodes look for files from the folder of the graph file.
                let elsewhere = param.pick == Pick::File && *dir != self.text.sources.first().dir;
                Ok(ParamValue::Text(if elsewhere { absolute_files(text, dir) } else { text.clone() }))
            }
            (ParamKind::Path { must_exist, .. }, Kind::Text(text)) => {
                let path = self.resolve_param(&value.span, param, text);
                if *must_exist && !text.is_empty() && !path.exists() {
                    return Err(self.missing_file(param, value, text));
                }
                Ok(ParamValue::Path(path))
            }
            (ParamKind::Floats { min_len, max_len, .. }, Kind::List(items)) => {
                let mut numbers = Vec::with_capacity(items.len());
                floats(param, items, true, &mut numbers)?;
                if numbers.len() < *min_len || max_len.is_some_and(|m| numbers.len() > m) {
                    let count = count_words(*min_len, *max_len);
                    return Err(Wrong {
                        code: "param-length",
                        span: value.span.clone(),
                        message: format!("`{name}` has {} numbers; it must have {count}", numbers.len()),
                        label: format!("expected {count}"),
                        help: doc(param),
                    });
                }
                Ok(ParamValue::Floats(numbers))
            }
            _ => Err(wrong_type(param, value)),
        }
    }

    fn missing_file(&self, param: &Param, value: &Value, text: &str) -> Wrong {
        let path = self.resolve_at(&value.span, text);
        // The longest part of the path that exists shows where to look.
        let there = path.ancestors().skip(1).find(|p| p.as_os_str().is_empty() || p.exists());
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let same_folder = there.is_some_and(|t| Some(t) == path.parent());
        let near = there.filter(|_| same_folder).and_then(|folder| {
            let folder = if folder.as_os_str().is_empty() { std::path::Path::new(".") } else { folder };
            let mut names: Vec<String> =
                std::fs::read_dir(folder).ok()?.filter_map(|e| e.ok()?.file_name().into_string().ok()).collect();
            names.sort();
            nearest(&name, names.iter().map(String::as_str)).map(str::to_owned)
        });
        Wrong {
            code: "missing-file",
            span: value.span.clone(),
            message: format!("`{}` names a file that does not exist", param.name),
            label: near.map(|n| format!("did you mean \"{n}\"?")).unwrap_or_default(),
            help: format!("looked for {}; paths are relative to the graph file", path.display()),
        }
    }
}

/// Numbers of a list; one level of lists inside, as in `[[10, 20], [30, 40]]`, is flattened.
fn floats(param: &Param, items: &[Value], nested: bool, numbers: &mut Vec<f64>) -> Result<(), Wrong> {
    for item in items {
        match &item.value {
            Kind::Float(f) if !f.is_finite() => return Err(not_finite(param, &item.span, *f)),
            Kind::List(inner) if nested => floats(param, inner, false, numbers)?,
            kind => match kind.number() {
                Some(number) => numbers.push(number),
                None => {
                    let message = format!("`{}` must be a list of numbers, not {}", param.name, kind.found());
                    return Err(Wrong {
                        code: "param-type",
                        span: item.span.clone(),
                        message,
                        label: "expected a number".to_owned(),
                        help: String::new(),
                    });
                }
            },
        }
    }
    Ok(())
}

fn count_words(min: usize, max: Option<usize>) -> String {
    match max {
        Some(max) if max == min => format!("{max}"),
        Some(max) if min == 0 => format!("at most {max}"),
        Some(max) => format!("{min} to {max}"),
        None => format!("at least {min}"),
    }
}

fn wrong_type(param: &Param, value: &Value) -> Wrong {
    let expected = param.kind.expected();
    let help = match &param.kind {
        ParamKind::Choice { choices, .. } => {
            format!("choices: {}", choices.iter().map(|c| format!("\"{c}\"")).collect::<Vec<_>>().join(", "))
        }
        ParamKind::Int { .. } | ParamKind::Float { .. } => match limits(param) {
            limits if limits.is_empty() => String::new(),
            limits => format!("allowed are {limits}"),
        },
        _ => String::new(),
    };
    Wrong {
        code: "param-type",
        span: value.span.clone(),
        message: format!("`{}` must be {expected}, not {}", param.name, value.value.found()),
        label: format!("expected {expected}"),
        help,
    }
}

fn not_finite(param: &Param, span: &Range<usize>, number: f64) -> Wrong {
    Wrong {
        code: "param-range",
        span: span.clone(),
        message: format!("`{}` cannot be {}", param.name, if number.is_nan() { "nan" } else { "infinite" }),
        label: "expected a finite number".to_owned(),
        help: match limits(param) {
            limits if limits.is_empty() => String::new(),
            limits => format!("allowed are {limits}"),
        },
    }
}

fn out_of_range(param: &Param, value: &Value, shown: &str) -> Wrong {
    let limits = limits(param);
    let limits = if limits.is_empty() { "numbers of 64 bits".to_owned() } else { limits };
    Wrong {
        code: "param-range",
        span: value.span.clone(),
        message: match shown.ends_with(|c: char| c.is_ascii_digit()) {
            true => format!("`{}` is {}; allowed: {limits}", param.name, with_unit(shown, &param.unit)),
            false => format!("`{}` is {shown}; allowed: {limits}", param.name),
        },
        label: format!("expected {limits}"),
        help: doc(param),
    }
}

fn in_range(param: &Param, value: &Value, inside: bool, shown: &str) -> Result<(), Wrong> {
    if inside { Ok(()) } else { Err(out_of_range(param, value, shown)) }
}

fn on_step(
    param: &Param,
    value: &Value,
    number: i64,
    min: Option<i64>,
    max: Option<i64>,
    step: Option<i64>,
) -> Result<(), Wrong> {
    let Some(step) = step.filter(|s| *s > 1).map(i128::from) else { return Ok(()) };
    let (number, base) = (i128::from(number), i128::from(min.unwrap_or(0)));
    let over = (number - base).rem_euclid(step);
    if over == 0 {
        return Ok(());
    }
    let (below, above) = (number - over, number - over + step);
    let near =
        if max.is_some_and(|m| above > i128::from(m)) { format!("{below}") } else { format!("{below} or {above}") };
    Err(Wrong {
        code: "param-step",
        span: value.span.clone(),
        message: format!(
            "`{}` is {}; allowed: {}",
            param.name,
            with_unit(&number.to_string(), &param.unit),
            limits(param)
        ),
        label: format!("nearest allowed: {near}"),
        help: String::new(),
    })
}

/// First line of the documentation.
fn doc(param: &Param) -> String {
    match param.doc.lines().next() {
        Some(line) if !line.trim().is_empty() => format!("`{}`: {}", param.name, line.trim()),
        _ => String::new(),
    }
}

fn with_unit(number: &str, unit: &str) -> String {
    if unit.is_empty() { number.to_owned() } else { format!("{number} {unit}") }
}

/// `0 to 40 px`, `at least 0 mm`, `16 to 256 px in steps of 16`; empty without limits.
pub(super) fn limits(param: &Param) -> String {
    let (min, max, step) = match &param.kind {
        ParamKind::Int { min, max, step, .. } => {
            (min.map(|m| m.to_string()), max.map(|m| m.to_string()), step.filter(|s| *s > 1).map(|s| s.to_string()))
        }
        ParamKind::Float { min, max, .. } => (min.map(|m| m.to_string()), max.map(|m| m.to_string()), None),
        _ => return String::new(),
    };
    let range = match (min, max) {
        (Some(min), Some(max)) => with_unit(&format!("{min} to {max}"), &param.unit),
        (Some(min), None) => with_unit(&format!("at least {min}"), &param.unit),
        (None, Some(max)) => with_unit(&format!("at most {max}"), &param.unit),
        (None, None) => String::new(),
    };
    match step {
        Some(step) if range.is_empty() => format!("multiples of {}", with_unit(&step, &param.unit)),
        Some(step) => format!("{range} in steps of {step}"),
        None => range,
    }
}
