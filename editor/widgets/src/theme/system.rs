//! Which theme a window has: chosen, or that of the desktop.

use eframe::egui::{Context, Theme};

/// The theme that the user asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Choice {
    /// As the desktop is; dark where that is not known.
    System,
    /// Dark.
    #[default]
    Dark,
    /// Light.
    Light,
}

impl Choice {
    /// Whether a window is light.
    pub fn is_light(self, ctx: &Context) -> bool {
        match self {
            Self::Dark => false,
            Self::Light => true,
            Self::System => match ctx.system_theme() {
                Some(theme) => theme == Theme::Light,
                None => desktop().unwrap_or(false),
            },
        }
    }
}

/// Whether the desktop is set to be light, as GTK programs know it: `GTK_THEME`, else the user's `settings.ini`. X11 itself does not say.
fn desktop() -> Option<bool> {
    if let Ok(theme) = std::env::var("GTK_THEME") {
        return Some(!theme.to_lowercase().contains("dark"));
    }
    let home = || Some(std::path::PathBuf::from(std::env::var_os("HOME")?).join(".config"));
    let config = std::env::var_os("XDG_CONFIG_HOME").map(std::path::PathBuf::from).or_else(home)?;
    let settings = ["gtk-4.0", "gtk-3.0"]
        .iter()
        .find_map(|gtk| std::fs::read_to_string(config.join(gtk).join("settings.ini")).ok());
    of_settings(&settings?)
}

/// What a `settings.ini` of GTK says.
fn of_settings(settings: &str) -> Option<bool> {
    let value = |key: &str| {
        let line = settings.lines().filter_map(|line| line.split_once('=')).find(|(name, _)| name.trim() == key);
        line.map(|(_, value)| value.trim().to_lowercase())
    };
    if let Some(dark) = value("gtk-application-prefer-dark-theme") {
        return Some(!matches!(dark.as_str(), "1" | "true" | "yes"));
    }
    value("gtk-theme-name").map(|name| !name.contains("dark"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_of_the_desktop_are_understood() {
        assert_eq!(of_settings("[Settings]\ngtk-application-prefer-dark-theme=1\n"), Some(false));
        assert_eq!(of_settings("[Settings]\ngtk-theme-name = Adwaita-dark\n"), Some(false));
        assert_eq!(of_settings("gtk-theme-name=Adwaita\ngtk-application-prefer-dark-theme = false"), Some(true));
        assert_eq!(of_settings("gtk-theme-name=Adwaita"), Some(true));
        assert_eq!(of_settings("\u{0}no settings"), None);
    }

    #[test]
    fn a_choice_is_stronger_than_the_desktop() {
        let ctx = Context::default();
        assert!(Choice::Light.is_light(&ctx) && !Choice::Dark.is_light(&ctx));
    }
}
