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

/// What can be found.
#[derive(Clone, Copy, Debug, Default)]
pub struct Candidate<'t> {
    /// Its name, which counts most.
    pub name: &'t str,
    /// What describes it: documentation, ports.
    pub words: &'t str,
    /// How often it is used; decides between candidates that match alike.
    pub uses: usize,
}

/// Points of a typed word, by where it occurs: as a whole word, at the start of one, inside one.
const IN_NAME: [i32; 3] = [100, 80, 50];
const IN_WORDS: [i32; 3] = [40, 30, 8];
/// Points of a word that means the same as the typed one, in the name and in the description.
const SYNONYM: [i32; 2] = [36, 20];
/// Points of every match of whole typed words; single letters never reach them.
const WORDS: i32 = 1000;
/// Most points for uses.
const USES: usize = 24;

/// Where a word occurs in a text, both in small letters: 0 as a whole word, 1 at the start of a word, 2 inside one.
fn occurrence(word: &str, text: &str) -> Option<usize> {
    let joins = |c: Option<char>| c.is_some_and(char::is_alphanumeric);
    let found = text.match_indices(word).map(|(at, _)| {
        let (before, after) = (text[..at].chars().next_back(), text[at + word.len()..].chars().next());
        if joins(before) { 2 } else { usize::from(joins(after)) }
    });
    found.min()
}

/// How well typed words match a candidate, higher is better; `None` when one of them does not occur.
fn by_words(typed: &[String], synonyms: &[Vec<&str>], name: &str, words: &str) -> Option<i32> {
    let points = |word: &String| {
        let in_name = occurrence(word, name).map(|at| IN_NAME[at]);
        let in_words = occurrence(word, words).filter(|at| *at < 2 || word.len() > 2).map(|at| IN_WORDS[at]);
        let groups = synonyms.iter().filter(|group| group.iter().any(|known| known.starts_with(word.as_str())));
        let others = groups.flatten().filter(|_| word.len() > 2);
        let meant = others.filter_map(|other| {
            let starts = |text: &str| occurrence(other, text).is_some_and(|at| at < 2);
            if starts(name) { Some(SYNONYM[0]) } else { starts(words).then_some(SYNONYM[1]) }
        });
        in_name.max(in_words).max(meant.max())
    };
    let all: Option<Vec<i32>> = typed.iter().map(points).collect();
    let all = all.filter(|all| !all.is_empty())?;
    Some(WORDS + 4 * all.iter().sum::<i32>() / all.len() as i32)
}

/// How well the letters of `typed` occur in `text` in this order, higher is better; `None` when they do not. Starts of words count most, then
/// consecutive letters.
fn by_letters(typed: &str, text: &str) -> Option<i32> {
    let text: Vec<char> = text.to_lowercase().chars().collect();
    if typed.trim().is_empty() {
        return Some(0);
    }
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
    Some((score - (text.len() as i32) / 16).min(WORDS / 2))
}

/// Indices of the matching candidates, best first: those with all typed words before those with only the letters. Of equal ones the more used comes
/// first. `synonyms` are groups of words of one meaning, in small letters, separated by `;`.
pub fn rank<'t>(typed: &str, synonyms: &str, candidates: impl Iterator<Item = Candidate<'t>>) -> Vec<usize> {
    let words: Vec<String> = typed.split_whitespace().map(str::to_lowercase).collect();
    let synonyms: Vec<Vec<&str>> = synonyms.split(';').map(|group| group.split_whitespace().collect()).collect();
    let mut found: Vec<(i32, usize)> = Vec::new();
    for (index, candidate) in candidates.enumerate() {
        let (name, described) = (candidate.name.to_lowercase(), candidate.words.to_lowercase());
        let score = by_words(&words, &synonyms, &name, &described);
        let Some(score) = score.or_else(|| by_letters(typed, &name)) else { continue };
        let uses = candidate.uses.min(USES) as i32;
        let length = if words.is_empty() { 0 } else { name.len() as i32 / 8 };
        found.push((score + uses - length, index));
    }
    found.sort_by_key(|&(score, index)| (-score, index));
    found.into_iter().map(|(_, index)| index).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ranked(typed: &str, all: &[(&str, &str)]) -> Vec<usize> {
        let candidates = all.iter().map(|(name, words)| Candidate { name, words, uses: 0 });
        rank(typed, "wide panorama stitch; tidy arrange", candidates)
    }

    #[test]
    fn starts_of_words_win() {
        let types = [("disparity_wls", ""), ("write_raw", "files"), ("rectify", ""), ("register_surf", "finds")];
        let best = |typed: &str| types[ranked(typed, &types)[0]].0;
        assert_eq!(best("wls"), "disparity_wls");
        assert_eq!(best("rs"), "register_surf");
        assert_eq!(best("wr"), "write_raw");
        assert_eq!(best("finds"), "register_surf");
    }

    #[test]
    fn a_word_wins_over_scattered_letters() {
        let names =
            [("Presets and snapshots", ""), ("Paths of dropped and late ticks", ""), ("mean/mean.past_weight", "")];
        assert_eq!(ranked("past", &names)[0], 2);
        // Also a word of the description, and one inside a word, over letters that start words.
        let names = [("Panels and help", ""), ("smooth", "sums the past")];
        assert_eq!(ranked("pah", &names), [0]);
        let names = [("p.a.s.t", ""), ("smooth", "sums the past"), ("repaste", "")];
        assert_eq!(ranked("past", &names), [2, 1, 0]);
    }

    #[test]
    fn ports_synonyms_and_uses_count() {
        let types =
            [("evaluate_stitch", "compares"), ("composite", "inputs left right, outputs panorama"), ("resize", "")];
        assert_eq!(ranked("panorama", &types)[..2], [1, 0], "a port before a word of the same meaning");
        assert_eq!(ranked("wide", &types)[0], 0, "`wide` means stitch");
        assert_eq!(ranked("left pano", &types), [1], "all typed words count");
        let used = [("a_view", 0), ("b_view", 7)].map(|(name, uses)| Candidate { name, words: "", uses });
        assert_eq!(rank("view", "", used.into_iter()), [1, 0]);
        assert_eq!(rank("", "", used.into_iter()), [1, 0]);
    }

    #[test]
    fn candidates_without_match_are_skipped() {
        assert_eq!(by_letters("xyz", "rectify"), None);
        assert_eq!(ranked("", &[("a name that is much longer than the others", ""), ("b", "")]), [0, 1]);
        assert!(ranked("q", &[("a", "none"), ("b", "")]).is_empty());
    }
}
