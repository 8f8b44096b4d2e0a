//! The texts of each language, read once.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Mutex, OnceLock, PoisonError};

use fluent_bundle::concurrent::FluentBundle;
use fluent_bundle::types::{FluentNumber, FluentNumberOptions};
use fluent_bundle::{FluentArgs, FluentResource, FluentValue};
use fluent_syntax::ast::{Attribute, Entry, Expression, InlineExpression, Pattern, PatternElement};
use unic_langid::LanguageIdentifier;

use super::{DECLARED, FILES, Language, Value, added, number};

/// The texts of a language.
struct Catalog {
    bundle: FluentBundle<FluentResource>,
    /// Texts without variables, which are shown again and again.
    plain: OnceLock<HashMap<&'static str, &'static str>>,
    /// Texts that only put values between words: they need no evaluation, and most texts of a frame are of this kind.
    simple: OnceLock<HashMap<String, Vec<Piece>>>,
}

/// A part of a simple text.
enum Piece {
    Words(&'static str),
    Variable(&'static str),
}

/// The parts of a simple text; `None` for one that chooses between words.
fn pieces(pattern: &Pattern<&'static str>) -> Option<Vec<Piece>> {
    let piece = |element: &PatternElement<&'static str>| match element {
        PatternElement::TextElement { value } => Some(Piece::Words(value)),
        PatternElement::Placeable { expression: Expression::Inline(InlineExpression::VariableReference { id }) } => {
            Some(Piece::Variable(id.name))
        }
        PatternElement::Placeable { .. } => None,
    };
    pattern.elements.iter().map(piece).collect()
}

/// The simple texts of a language.
fn simple_texts(language: Language) -> HashMap<String, Vec<Piece>> {
    let mut all = HashMap::new();
    for (_, _, text) in FILES.iter().filter(|(code, ..)| *code == language.code()) {
        let resource = fluent_syntax::parser::parse(*text).unwrap_or_else(|(usable, _)| usable);
        for entry in &resource.body {
            let Entry::Message(message) = entry else { continue };
            let own = message.value.iter().map(|value| (message.id.name.to_owned(), value));
            let attribute = |one: &'_ Attribute<&'static str>| format!("{}.{}", message.id.name, one.id.name);
            let attributes = message.attributes.iter().map(|one| (attribute(one), &one.value));
            all.extend(own.chain(attributes).filter_map(|(name, pattern)| Some((name, pieces(pattern)?))));
        }
    }
    all
}

/// In the order of [`Language::ALL`].
static CATALOGS: [OnceLock<Catalog>; Language::ALL.len()] = [const { OnceLock::new() }; Language::ALL.len()];

impl Catalog {
    /// The texts of a language. What is wrong in its files is left out, and found by the tests.
    fn read<'a>(code: &str, files: impl Iterator<Item = &'a str>) -> Self {
        let locale: LanguageIdentifier = code.parse().unwrap_or_default();
        let mut bundle = FluentBundle::new_concurrent(vec![locale]);
        // All languages here are written from left to right.
        bundle.set_use_isolating(false);
        for text in files {
            let resource = FluentResource::try_new(text.to_owned()).unwrap_or_else(|(usable, _)| usable);
            let _ = bundle.add_resource(resource);
        }
        Self { bundle, plain: OnceLock::new(), simple: OnceLock::new() }
    }

    fn embedded(language: Language) -> Self {
        let own = FILES.iter().filter(|(code, ..)| *code == language.code());
        Self::read(language.code(), own.map(|(.., text)| *text))
    }

    fn of(language: Language) -> &'static Self {
        let at = match language {
            Language::Added(at) => return Self::added(at).unwrap_or_else(|| Self::of(Language::English)),
            Language::German => 1,
            Language::English => 0,
        };
        CATALOGS[at].get_or_init(|| Self::embedded(language))
    }

    /// That of a language that was added; read once.
    fn added(at: u8) -> Option<&'static Self> {
        static READ: Mutex<BTreeMap<u8, &'static Catalog>> = Mutex::new(BTreeMap::new());
        let mut read = READ.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = read.get(&at) {
            return Some(known);
        }
        let added = added::get(at)?;
        let catalog: &'static Self = Box::leak(Box::new(Self::read(added.code, [added.text].into_iter())));
        read.insert(at, catalog);
        Some(catalog)
    }

    /// A text, and whether all its variables have values; `None` where there is none.
    fn text(&self, id: &str, values: Option<&FluentArgs<'_>>) -> Option<(String, bool)> {
        let (id, attribute) = id.split_once('.').map_or((id, None), |(id, attribute)| (id, Some(attribute)));
        let message = self.bundle.get_message(id)?;
        let pattern = match attribute {
            Some(attribute) => message.get_attribute(attribute)?.value(),
            None => message.value()?,
        };
        let mut errors = Vec::new();
        let text = self.bundle.format_pattern(pattern, values, &mut errors).into_owned();
        Some((text, errors.is_empty()))
    }

    /// A simple text; `None` where it is not simple, or a variable has no value.
    fn simple<'a>(
        &self,
        language: Language,
        id: &str,
        values: impl Iterator<Item = (&'a str, &'a Value)> + Clone,
    ) -> Option<String> {
        let pieces = self.simple.get_or_init(|| simple_texts(language)).get(id)?;
        let mut out = String::with_capacity(64);
        for piece in pieces {
            match piece {
                Piece::Words(words) => out.push_str(words),
                Piece::Variable(name) => {
                    let (_, value) = values.clone().find(|(known, _)| known == name)?;
                    value.write(language, &mut out);
                }
            }
        }
        Some(out)
    }

    fn plain(&'static self) -> &'static HashMap<&'static str, &'static str> {
        self.plain.get_or_init(|| {
            let without = DECLARED.iter().filter(|(_, variables)| variables.is_empty());
            let found = without.filter_map(|(id, _)| {
                // Kept as long as the program runs, once for each language.
                let text: &'static str = Box::leak(self.text(id, None)?.0.into_boxed_str());
                Some((*id, text))
            });
            found.collect()
        })
    }
}

/// A text without variables; the English one where the language has none.
pub(crate) fn plain(language: Language, id: &'static str) -> &'static str {
    let of = |language| Catalog::of(language).plain().get(id).copied();
    of(language).or_else(|| of(Language::English)).unwrap_or(id)
}

/// A text with variables; the English one where the language has none.
pub(crate) fn filled<'a>(
    language: Language,
    id: &str,
    values: impl Iterator<Item = (&'a str, &'a Value)> + Clone,
) -> String {
    if let Some(text) = Catalog::of(language).simple(language, id, values.clone()) {
        return text;
    }
    let of = |of: Language| {
        let mut args = FluentArgs::new();
        for (name, value) in values.clone() {
            args.set(name.to_owned(), fluent(of, value));
        }
        Catalog::of(of).text(id, Some(&args))
    };
    best(of(language), || of(Language::English), id)
}

/// The text to show: whole in the language, else whole in English, else what there is.
fn best(own: Option<(String, bool)>, english: impl FnOnce() -> Option<(String, bool)>, id: &str) -> String {
    match own {
        Some((text, true)) => text,
        own => match (own, english()) {
            (_, Some((text, true))) | (Some((text, _)), _) | (None, Some((text, _))) => text,
            (None, None) => id.to_owned(),
        },
    }
}

/// A value for Fluent. Whole numbers select a plural; others are words already, because Fluent knows no decimal signs.
fn fluent(language: Language, value: &Value) -> FluentValue<'static> {
    match value {
        Value::Text(text) => FluentValue::from(text.clone()),
        Value::Number { value, places: 0 } if value.fract() == 0.0 => {
            FluentValue::Number(FluentNumber::new(*value, FluentNumberOptions::default()))
        }
        Value::Number { value, places } => FluentValue::from(number::written(language, *value, *places)),
        Value::Phrase(phrase) => FluentValue::from(phrase.in_language(language)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn simple_texts_are_as_fluent_writes_them() {
        let number = |value, places| Value::Number { value, places };
        let samples = [number(1234.0, 0), number(-0.25, 2), number(1e15, 0), Value::Text("a {b} ß".to_owned())];
        let mut count = 0;
        for language in Language::ALL {
            for (id, variables) in DECLARED.iter().filter(|(_, variables)| !variables.is_empty()) {
                let values = || variables.iter().zip(samples.iter().cycle()).map(|(name, value)| (*name, value));
                let mut args = FluentArgs::new();
                values().for_each(|(name, value)| args.set(name, fluent(language, value)));
                let catalog = Catalog::of(language);
                let Some(simple) = catalog.simple(language, id, values()) else { continue };
                count += 1;
                assert_eq!(catalog.text(id, Some(&args)), Some((simple, true)), "{id}");
            }
        }
        assert!(count > 200, "most texts are simple: {count}");
    }

    #[test]
    fn a_text_is_never_lacking() {
        let english = Catalog::read("en", ["a = Stop { $node }\nb = Held\n    .name = Held for long\n"].into_iter());
        let german = Catalog::read("de", ["a = Stopp { $knoten }\n{ this is no text\nc = Rest\n"].into_iter());
        let mut args = FluentArgs::new();
        args.set("node", "arm");
        let shown = |id: &str| best(german.text(id, Some(&args)), || english.text(id, Some(&args)), id);
        assert_eq!(shown("a"), "Stop arm", "a variable that the language does not know");
        assert_eq!((shown("b"), shown("b.name")), ("Held".to_owned(), "Held for long".to_owned()));
        assert_eq!(shown("c"), "Rest", "a mistake in a file costs no other text");
        assert_eq!(shown("d"), "d");
        let nothing = FluentArgs::new();
        let lacking = best(None, || english.text("a", Some(&nothing)), "a");
        assert!(lacking.starts_with("Stop "), "{lacking}");
    }
}
