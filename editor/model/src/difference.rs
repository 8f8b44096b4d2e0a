//! The difference of two texts, line by line.

/// A line of a difference.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// Both texts have it.
    Same(String),
    /// Only the first text has it.
    Ours(String),
    /// Only the second text has it.
    Theirs(String),
    /// This number of lines that both texts have.
    Skipped(usize),
}

/// Largest product of the numbers of lines for which the least difference is searched; larger texts differ as a whole.
const MAX_CELLS: usize = 4_000_000;

/// Lines that differ between two texts, each change with up to `around` lines before and after it. Cost O(lines x lines) between the first and the
/// last line that differ.
pub fn lines(ours: &str, theirs: &str, around: usize) -> Vec<Line> {
    let (a, b): (Vec<&str>, Vec<&str>) = (ours.lines().collect(), theirs.lines().collect());
    let before = a.iter().zip(&b).take_while(|(a, b)| a == b).count();
    let most = a.len().min(b.len()) - before;
    let after = a.iter().rev().zip(b.iter().rev()).take(most).take_while(|(a, b)| a == b).count();
    let (middle_a, middle_b) = (&a[before..a.len() - after], &b[before..b.len() - after]);
    let owned = |line: &&str| (*line).to_owned();
    let mut all: Vec<Line> = a[..before].iter().map(owned).map(Line::Same).collect();
    all.extend(changed(middle_a, middle_b));
    all.extend(a[a.len() - after..].iter().map(owned).map(Line::Same));
    folded(all, around)
}

/// The least difference of two lists of lines.
fn changed(a: &[&str], b: &[&str]) -> Vec<Line> {
    let (ours, theirs) = (|k: usize| Line::Ours(a[k].to_owned()), |k: usize| Line::Theirs(b[k].to_owned()));
    if a.len().saturating_mul(b.len()) > MAX_CELLS {
        return (0..a.len()).map(ours).chain((0..b.len()).map(theirs)).collect();
    }
    // Length of the longest common subsequence of what follows.
    let width = b.len() + 1;
    let mut common = vec![0u32; (a.len() + 1) * width];
    for i in (0..a.len()).rev() {
        for j in (0..b.len()).rev() {
            common[i * width + j] = if a[i] == b[j] {
                common[(i + 1) * width + j + 1] + 1
            } else {
                common[(i + 1) * width + j].max(common[i * width + j + 1])
            };
        }
    }
    let (mut i, mut j, mut found) = (0, 0, Vec::new());
    while i < a.len() || j < b.len() {
        if i < a.len() && j < b.len() && a[i] == b[j] {
            found.push(Line::Same(a[i].to_owned()));
            (i, j) = (i + 1, j + 1);
        } else if j == b.len() || (i < a.len() && common[(i + 1) * width + j] >= common[i * width + j + 1]) {
            found.push(ours(i));
            i += 1;
        } else {
            found.push(theirs(j));
            j += 1;
        }
    }
    found
}

/// Folds runs of equal lines that are far from a change.
fn folded(all: Vec<Line>, around: usize) -> Vec<Line> {
    let is_change = |line: &Line| !matches!(line, Line::Same(_));
    let changes: Vec<usize> = (0..all.len()).filter(|&n| is_change(&all[n])).collect();
    let near = |n: usize| {
        let next = changes.partition_point(|&change| change < n);
        changes.get(next).is_some_and(|change| change - n <= around)
            || next.checked_sub(1).is_some_and(|last| n - changes[last] <= around)
    };
    let mut found: Vec<Line> = Vec::new();
    for (n, line) in all.into_iter().enumerate() {
        if is_change(&line) || near(n) {
            found.push(line);
        } else if let Some(Line::Skipped(count)) = found.last_mut() {
            *count += 1;
        } else {
            found.push(Line::Skipped(1));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_shown_with_the_lines_around_them() {
        let ours = "a\nb\nc\nd\ne\nf\ng\nh\n";
        let theirs = "a\nb\nc\nD\ne\nf\ng\nh\ni\n";
        let text = |line: &Line| match line {
            Line::Same(text) => format!("  {text}"),
            Line::Ours(text) => format!("- {text}"),
            Line::Theirs(text) => format!("+ {text}"),
            Line::Skipped(count) => format!("({count})"),
        };
        let shown: Vec<String> = lines(ours, theirs, 1).iter().map(text).collect();
        assert_eq!(shown, ["(2)", "  c", "- d", "+ D", "  e", "(2)", "  h", "+ i"]);
        assert_eq!(lines(ours, ours, 3), [Line::Skipped(8)]);
        assert!(lines("", "", 3).is_empty());
        assert_eq!(lines("", "x", 3), [Line::Theirs("x".to_owned())]);
    }

    #[test]
    fn either_text_can_be_rebuilt_from_the_difference() {
        let mut random = 7u32;
        let mut text = |lines: usize| -> String {
            let line = |_| {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                format!("{}\n", (random >> 24) % 6)
            };
            (0..lines).map(line).collect()
        };
        for round in 0..50 {
            let (ours, theirs) = (text(round % 17), text(round % 13));
            if ours == theirs {
                continue;
            }
            let (mut a, mut b) = (String::new(), String::new());
            for line in lines(&ours, &theirs, usize::MAX) {
                match line {
                    Line::Same(line) => [&mut a, &mut b].into_iter().for_each(|text| *text += &format!("{line}\n")),
                    Line::Ours(line) => a += &format!("{line}\n"),
                    Line::Theirs(line) => b += &format!("{line}\n"),
                    Line::Skipped(_) => unreachable!("nothing is folded"),
                }
            }
            assert_eq!((a, b), (ours, theirs));
        }
    }

    #[test]
    fn huge_texts_differ_as_a_whole() {
        let (ours, theirs) = ("x\n".repeat(3000) + "y", "z\n".repeat(3000) + "w");
        assert_eq!(lines(&ours, &theirs, 0).len(), 6002);
    }
}
