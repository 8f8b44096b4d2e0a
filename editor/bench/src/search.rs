//! Finding things by a few typed letters: what fits, the field for the letters, the row that is chosen.

use eframe::egui::{Rect, Response, TextEdit, Ui, vec2};

use panoscope_editor_widgets::theme;

/// The field for the letters, called `name` by readers of the screen; takes the keyboard the first time. Whether the letters changed.
pub fn field(ui: &mut Ui, typed: &mut String, fresh: &mut bool, hint: &str, name: &str) -> bool {
    let field = TextEdit::singleline(typed).hint_text(hint).desired_width(f32::INFINITY);
    let field = ui.add(field.margin(vec2(8.0, 6.0)));
    ui.ctx().accesskit_node_builder(field.id, |n| n.set_label(name));
    if std::mem::take(fresh) {
        field.request_focus();
    }
    field.changed()
}

/// Shows which row of a list is chosen, and which one is pointed at; the chosen one is brought into sight.
pub fn mark_row(ui: &Ui, rect: Rect, row: &Response, chosen: bool) {
    if chosen {
        row.scroll_to_me(None);
        ui.painter().rect_filled(rect, 4.0, theme::ACCENT.gamma_multiply(0.18));
    } else if row.hovered() {
        ui.painter().rect_filled(rect, 4.0, theme::RAISED);
    }
}

/// How well `typed` fits `text`, higher is better; `None` when its letters do not occur in order. Starts of words count most, runs of letters
/// next.
pub fn score(typed: &str, text: &str) -> Option<i32> {
    let text: Vec<char> = text.to_lowercase().chars().collect();
    let (mut at, mut score, mut run) = (0, 0, 0);
    for letter in typed.to_lowercase().chars().filter(|c| !c.is_whitespace()) {
        let found = (at..text.len()).find(|&i| text[i] == letter)?;
        // A later start of a word may be meant rather than the first such letter.
        let starts = |i: usize| i == 0 || !text[i - 1].is_alphanumeric();
        let better = (found..text.len()).find(|&i| text[i] == letter && starts(i));
        let place = if found == at && run > 0 { found } else { better.unwrap_or(found) };
        run = if place == at { run + 1 } else { 1 };
        score += 2 * run + if starts(place) { 8 } else { 0 } - ((place - at).min(8) as i32) / 2;
        at = place + 1;
    }
    Some(score - (text.len() as i32) / 16)
}

/// Positions of the candidates that fit, best first. A candidate has a name, which counts more, and further words.
pub fn rank<'t>(typed: &str, candidates: impl Iterator<Item = (&'t str, &'t str)>) -> Vec<usize> {
    let mut found: Vec<(i32, usize)> = Vec::new();
    for (index, (name, words)) in candidates.enumerate() {
        let by_name = score(typed, name).map(|s| s + 20);
        // In longer texts letters that lie apart mean nothing: whole words only.
        let low = words.to_lowercase();
        let all = typed.split_whitespace().all(|word| low.contains(&word.to_lowercase()));
        let by_words = (all && !typed.trim().is_empty()).then_some(4);
        if let Some(best) = by_name.max(by_words) {
            found.push((best, index));
        }
    }
    found.sort_by_key(|&(score, index)| (-score, index));
    found.into_iter().map(|(_, index)| index).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_of_words_win() {
        let types = [("disparity_wls", ""), ("write_raw", "files"), ("rectify", ""), ("register_surf", "finds")];
        let best = |typed: &str| types[rank(typed, types.iter().copied())[0]].0;
        assert_eq!(best("wls"), "disparity_wls");
        assert_eq!(best("rs"), "register_surf");
        assert_eq!(best("wr"), "write_raw");
        assert_eq!(best("finds"), "register_surf");
    }

    #[test]
    fn what_does_not_fit_is_left_out() {
        assert_eq!(score("xyz", "rectify"), None);
        assert_eq!(rank("", [("a", ""), ("b", "")].into_iter()), [0, 1]);
        assert!(rank("q", [("a", "none"), ("b", "")].into_iter()).is_empty());
    }
}
