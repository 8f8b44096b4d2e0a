//! Fuzzy search: the search field, the ranking of candidates, the chosen row.

use eframe::egui::{Rect, Response, TextEdit, Ui, vec2};

use panoscope_editor_widgets::theme;

/// Shows the search field, labelled `name` for screen readers; requests the focus while `fresh`. Returns whether the text changed.
pub fn field(ui: &mut Ui, typed: &mut String, fresh: &mut bool, hint: &str, name: &str) -> bool {
    let field = TextEdit::singleline(typed).hint_text(hint).desired_width(f32::INFINITY);
    let field = ui.add(field.margin(vec2(8.0, 6.0)));
    ui.ctx().accesskit_node_builder(field.id, |n| n.set_label(name));
    if std::mem::take(fresh) {
        field.request_focus();
    }
    field.changed()
}

/// Highlights a row that is chosen or under the pointer, and scrolls to the chosen one.
pub fn mark_row(ui: &Ui, rect: Rect, row: &Response, chosen: bool) {
    if chosen {
        row.scroll_to_me(None);
        ui.painter().rect_filled(rect, 4.0, theme::accent().gamma_multiply(0.18));
    } else if row.hovered() {
        ui.painter().rect_filled(rect, 4.0, theme::raised());
    }
}

/// How well `typed` matches `text`, higher is better; `None` when its letters do not occur in this order. Starts of words count most, then
/// consecutive letters.
pub fn score(typed: &str, text: &str) -> Option<i32> {
    let text: Vec<char> = text.to_lowercase().chars().collect();
    let (mut at, mut score, mut run) = (0, 0, 0);
    for letter in typed.to_lowercase().chars().filter(|c| !c.is_whitespace()) {
        let found = (at..text.len()).find(|&i| text[i] == letter)?;
        // Prefers a later start of a word to the first occurrence of the letter.
        let starts = |i: usize| i == 0 || !text[i - 1].is_alphanumeric();
        let better = (found..text.len()).find(|&i| text[i] == letter && starts(i));
        let place = if found == at && run > 0 { found } else { better.unwrap_or(found) };
        run = if place == at { run + 1 } else { 1 };
        score += 2 * run + if starts(place) { 8 } else { 0 } - ((place - at).min(8) as i32) / 2;
        at = place + 1;
    }
    Some(score + whole(typed, &text) - (text.len() as i32) / 16)
}

/// What it counts that `typed` occurs as it is: more at the start of a word. Scattered letters that start words must not win over that.
fn whole(typed: &str, text: &[char]) -> i32 {
    let typed: Vec<char> = typed.to_lowercase().chars().filter(|c| !c.is_whitespace()).collect();
    if typed.len() < 2 {
        return 0;
    }
    let at = |(n, part): (usize, &[char])| (part == typed).then(|| n == 0 || !text[n - 1].is_alphanumeric());
    let occurrences = text.windows(typed.len()).enumerate().filter_map(at);
    occurrences.map(|starts| if starts { 16 } else { 6 }).max().unwrap_or(0)
}

/// Indices of the matching candidates, best first. A candidate has a name, which counts more, and a description.
pub fn rank<'t>(typed: &str, candidates: impl Iterator<Item = (&'t str, &'t str)>) -> Vec<usize> {
    let mut found: Vec<(i32, usize)> = Vec::new();
    for (index, (name, description)) in candidates.enumerate() {
        let by_name = score(typed, name).map(|s| s + 20);
        // In descriptions only whole words count.
        let low = description.to_lowercase();
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
    fn a_word_wins_over_scattered_letters() {
        let names = ["Presets and snapshots", "Paths of dropped and late ticks", "mean/mean.past_weight"];
        assert_eq!(rank("past", names.iter().map(|name| (*name, "")))[0], 2);
    }

    #[test]
    fn candidates_without_match_are_skipped() {
        assert_eq!(score("xyz", "rectify"), None);
        assert_eq!(rank("", [("a", ""), ("b", "")].into_iter()), [0, 1]);
        assert!(rank("q", [("a", "none"), ("b", "")].into_iter()).is_empty());
    }
}
