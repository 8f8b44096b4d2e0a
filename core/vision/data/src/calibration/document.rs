//! A YAML document as a tree whose nodes know their line and column.

use saphyr_parser::{Event, Parser};

use crate::calibration::error::Mistake;

/// Deepest nesting accepted; real files need four levels.
const MAX_DEPTH: usize = 16;

/// A node of the tree.
#[derive(Clone, Debug)]
pub(crate) struct Node {
    pub line: usize,
    pub column: usize,
    pub value: Value,
}

#[derive(Clone, Debug)]
pub(crate) enum Value {
    Scalar(String),
    List(Vec<Node>),
    Map(Vec<(String, Node)>),
}

impl Node {
    /// Parses the first document of a text; an empty one is an empty map.
    pub fn parse(text: &str) -> Result<Self, Mistake> {
        // OpenCV's header `%YAML:1.0` is no directive of YAML; as a comment it keeps all lines where they are.
        let text = match text.strip_prefix("%YAML") {
            Some(rest) => format!("#YAML{rest}"),
            None => text.to_owned(),
        };
        let mut stack: Vec<(Node, Option<String>)> = Vec::new();
        for event in Parser::new_from_str(&text) {
            let (event, span) = event.map_err(|error| Mistake {
                line: error.marker().line(),
                column: error.marker().col() + 1,
                what: format!("this is no YAML, or the file is cut off: {}", error.info()),
            })?;
            let (line, column) = (span.start.line(), span.start.col() + 1);
            let at = |value| Node { line, column, value };
            let done = match event {
                Event::Scalar(text, ..) => {
                    // In a map every other scalar is a key.
                    if let Some((Node { value: Value::Map(_), .. }, key @ None)) = stack.last_mut() {
                        *key = Some(text.into_owned());
                        continue;
                    }
                    at(Value::Scalar(text.into_owned()))
                }
                Event::SequenceStart(..) | Event::MappingStart(..) => {
                    if let Some((Node { value: Value::Map(_), .. }, None)) = stack.last() {
                        return Err(Mistake { line, column, what: "a key is a list or a map".into() });
                    }
                    if stack.len() >= MAX_DEPTH {
                        return Err(Mistake { line, column, what: "lists and maps are nested too deeply".into() });
                    }
                    let is_list = matches!(event, Event::SequenceStart(..));
                    stack.push((at(if is_list { Value::List(Vec::new()) } else { Value::Map(Vec::new()) }), None));
                    continue;
                }
                Event::SequenceEnd | Event::MappingEnd => match stack.pop() {
                    Some((node, _)) => node,
                    None => continue,
                },
                Event::Alias(_) => {
                    return Err(Mistake { line, column, what: "aliases are not understood here".into() });
                }
                _ => continue,
            };
            match stack.last_mut() {
                None => return Ok(done),
                Some((Node { value: Value::List(items), .. }, _)) => items.push(done),
                Some((Node { value: Value::Map(entries), .. }, key)) => {
                    entries.push((key.take().unwrap_or_default(), done));
                }
                Some(_) => {}
            }
        }
        Ok(Self { line: 1, column: 1, value: Value::Map(Vec::new()) })
    }

    pub fn mistake(&self, what: impl Into<String>) -> Mistake {
        Mistake { line: self.line, column: self.column, what: what.into() }
    }

    /// The value of a key, if this is a map that has it.
    pub fn get(&self, key: &str) -> Option<&Self> {
        match &self.value {
            Value::Map(entries) => entries.iter().find(|(k, _)| k == key).map(|(_, node)| node),
            _ => None,
        }
    }

    /// The value of the first of several keys that exists, with that key.
    pub fn any<'k>(&self, keys: &[&'k str]) -> Option<(&'k str, &Self)> {
        keys.iter().find_map(|key| Some((*key, self.get(key)?)))
    }

    pub fn text(&self) -> Option<&str> {
        match &self.value {
            Value::Scalar(text) => Some(text),
            _ => None,
        }
    }

    /// Reads a finite number; OpenCV's `1.` and `.5` are accepted.
    pub fn number(&self, name: &str) -> Result<f64, Mistake> {
        let Some(text) = self.text() else { return Err(self.mistake(format!("`{name}` is not a number"))) };
        match text.trim().parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ if [".nan", ".inf", "-.inf", "+.inf"].contains(&text.to_ascii_lowercase().as_str()) => {
                Err(self.mistake(format!("`{name}` holds {text}: a finite number is needed")))
            }
            Ok(_) => Err(self.mistake(format!("`{name}` holds {text}: a finite number is needed"))),
            Err(_) => Err(self.mistake(format!("`{name}` holds `{text}`, which is not a number"))),
        }
    }

    /// Reads a whole number of pixels.
    pub fn pixels(&self, name: &str) -> Result<u32, Mistake> {
        let number = self.number(name)?;
        if number.fract() != 0.0 || !(2.0..=65536.0).contains(&number) {
            return Err(self.mistake(format!("`{name}` is {number}: a whole number of px from 2 to 65536 is needed")));
        }
        Ok(number as u32)
    }

    /// Reads all numbers of a list, of nested lists, or of a map `rows`, `cols`, `data` as OpenCV and ROS write matrices.
    pub fn numbers(&self, name: &str) -> Result<Vec<f64>, Mistake> {
        match &self.value {
            Value::Scalar(_) => Ok(vec![self.number(name)?]),
            Value::List(items) => {
                let mut all = Vec::new();
                for item in items {
                    all.extend(item.numbers(name)?);
                }
                Ok(all)
            }
            Value::Map(_) => {
                let data = self.get("data").ok_or_else(|| self.mistake(format!("`{name}` has no `data`")))?;
                let all = data.numbers(name)?;
                if let (Some(rows), Some(columns)) = (self.get("rows"), self.any(&["cols", "columns"])) {
                    let (rows, columns) = (rows.number(name)?, columns.1.number(name)?);
                    if rows * columns != all.len() as f64 {
                        return Err(data.mistake(format!(
                            "`{name}` is said to be {rows}x{columns} and holds {} numbers",
                            all.len()
                        )));
                    }
                }
                Ok(all)
            }
        }
    }

    /// Reads exactly `N` numbers.
    pub fn exactly<const N: usize>(&self, name: &str) -> Result<[f64; N], Mistake> {
        let all = self.numbers(name)?;
        let found = all.len();
        all.try_into().map_err(|_| self.mistake(format!("`{name}` holds {found} numbers, {N} are needed")))
    }
}
