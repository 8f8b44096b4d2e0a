//! The language of a window: chosen, or that of the system.

use std::sync::Once;

use clap::builder::PossibleValuesParser;
use panoscope_editor_model::arguments::config_folder;
use panoscope_editor_model::texts::{self, Language, set_language};

/// The choice that stands for the system's language.
const SYSTEM: &str = "system";

/// Adds the languages of the folder `texts` of the user's settings, once.
fn add_languages() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let folder = config_folder().map(|folder| folder.join("texts"));
        for problem in folder.iter().flat_map(|folder| texts::add_languages(folder)) {
            eprintln!("warning: {problem}");
        }
    });
}

/// The values of `--language`.
pub(crate) fn choices() -> PossibleValuesParser {
    add_languages();
    PossibleValuesParser::new(Language::all().map(Language::code).chain([SYSTEM]))
}

/// Makes the windows of this thread speak the chosen language.
pub(crate) fn apply(choice: &str) {
    let of_system = || Language::of_environment(|name| std::env::var(name).ok());
    add_languages();
    set_language(Language::all().find(|language| language.code() == choice).unwrap_or_else(of_system));
}
