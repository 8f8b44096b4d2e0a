//! Performs the steps of a `--do` script.

use eframe::egui::Context;
use panoscope_editor_model::texts::text;

use super::{Action, Theatre, actions};

impl Theatre {
    /// Performs the steps that are due: names of actions, `view:N`, `tap:X,Y`.
    pub(super) fn play_script(&mut self, ctx: &Context) {
        while let Some(step) = self.shot.step() {
            let (word, rest) = step.split_once(':').unwrap_or((&step, ""));
            let named = actions::KEYS.iter().find(|(action, _)| format!("{action:?}").eq_ignore_ascii_case(word));
            match (word, named) {
                (_, Some((action, _))) => self.perform(*action),
                ("view", _) => self.perform(Action::One(rest.parse::<usize>().unwrap_or(1).saturating_sub(1))),
                ("tap", _) => {
                    let at = rest.split_once(',').and_then(|(x, y)| Some((x.parse().ok()?, y.parse().ok()?)));
                    if let Some((x, y)) = at {
                        self.measure.tap(x, y);
                    }
                }
                _ => self.notify(text!("script-no-action", step = step), true),
            }
            ctx.request_repaint();
        }
    }
}
