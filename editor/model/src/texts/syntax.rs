// Names and variables of the texts in a file. Shared by the build script and the tests.

use std::collections::BTreeSet;

use fluent_syntax::ast::{Entry, Expression, InlineExpression, Pattern, PatternElement};

/// The texts of a file in its order: the name (`message`, or `message.attribute`) and the variables of each.
///
/// # Errors
/// The file has a mistake; with its text.
pub fn texts(file: &str) -> Result<Vec<(String, BTreeSet<String>)>, String> {
    let resource = fluent_syntax::parser::parse(file).map_err(|(_, errors)| format!("{errors:?}"))?;
    let mut all = Vec::new();
    for entry in resource.body {
        match entry {
            Entry::Message(message) => {
                if let Some(value) = &message.value {
                    all.push((message.id.name.to_owned(), variables(value)?));
                }
                for attribute in &message.attributes {
                    let name = format!("{}.{}", message.id.name, attribute.id.name);
                    all.push((name, variables(&attribute.value)?));
                }
            }
            Entry::Term(term) => return Err(format!("`-{}`: terms are not used here", term.id.name)),
            Entry::Junk { content } => return Err(format!("no text: {content}")),
            Entry::Comment(_) | Entry::GroupComment(_) | Entry::ResourceComment(_) => {}
        }
    }
    Ok(all)
}

fn variables(pattern: &Pattern<&str>) -> Result<BTreeSet<String>, String> {
    let mut found = BTreeSet::new();
    collect(pattern, &mut found)?;
    Ok(found)
}

fn collect(pattern: &Pattern<&str>, found: &mut BTreeSet<String>) -> Result<(), String> {
    for element in &pattern.elements {
        let PatternElement::Placeable { expression } = element else { continue };
        match expression {
            Expression::Inline(inner) => collect_inline(inner, found)?,
            Expression::Select { selector, variants } => {
                collect_inline(selector, found)?;
                variants.iter().try_for_each(|variant| collect(&variant.value, found))?;
            }
        }
    }
    Ok(())
}

fn collect_inline(inner: &InlineExpression<&str>, found: &mut BTreeSet<String>) -> Result<(), String> {
    match inner {
        InlineExpression::VariableReference { id } => {
            found.insert(id.name.to_owned());
            Ok(())
        }
        InlineExpression::StringLiteral { .. } | InlineExpression::NumberLiteral { .. } => Ok(()),
        other => Err(format!("only variables and literals are used here: {other:?}")),
    }
}
