//! The language of a window: chosen, or that of the system.

use clap::builder::PossibleValuesParser;
use panoscope_editor_model::texts::{Language, set_language};

/// The choice that stands for the system's language.
const SYSTEM: &str = "system";

/// The values of `--language`.
pub(crate) fn choices() -> PossibleValuesParser {
    PossibleValuesParser::new(Language::ALL.map(Language::code).into_iter().chain([SYSTEM]))
}

/// Makes the windows of this thread speak the chosen language.
pub(crate) fn apply(choice: &str) {
    let of_system = || Language::of_environment(|name| std::env::var(name).ok());
    set_language(Language::ALL.into_iter().find(|language| language.code() == choice).unwrap_or_else(of_system));
}
