//! Texts of one name and its numbers a line, as data sets write their calibrations.

use crate::calibration::error::Mistake;

/// Maximum number of entries of a text; real files have up to 80.
const MAX_ENTRIES: usize = 10_000;

/// A name and what stands behind it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry<'t> {
    pub name: &'t str,
    value: &'t str,
    /// Line and column of the value, from 1.
    line: usize,
    column: usize,
}

impl<'t> Entry<'t> {
    /// An entry for the value that begins at byte `at` of line number `line`.
    fn new(name: &'t str, line: (usize, &'t str), at: usize, end: usize) -> Self {
        let (number, text) = line;
        let value = &text[at..end];
        let start = at + (value.len() - value.trim_start().len());
        Self { name, value: value.trim(), line: number + 1, column: text[..start].chars().count() + 1 }
    }

    pub fn mistake(&self, what: impl Into<String>) -> Mistake {
        Mistake { line: self.line, column: self.column, what: what.into() }
    }

    /// All numbers; brackets, commas and semicolons divide them as spaces do.
    pub fn numbers(&self) -> Result<Vec<f64>, Mistake> {
        let words = self.value.split(|c: char| c.is_whitespace() || "[];,".contains(c)).filter(|word| !word.is_empty());
        words
            .map(|word| match word.parse::<f64>() {
                Ok(number) if number.is_finite() => Ok(number),
                Ok(_) => Err(self.mistake(format!("`{}` holds {word}: a finite number is needed", self.name))),
                Err(_) => Err(self.mistake(format!("`{}` holds `{word}`, which is not a number", self.name))),
            })
            .collect()
    }

    /// Whether the value is at least one number.
    pub fn begins_with_number(&self) -> bool {
        self.value.split_whitespace().next().is_some_and(|word| word.parse::<f64>().is_ok())
    }

    /// Exactly `N` numbers.
    pub fn exactly<const N: usize>(&self) -> Result<[f64; N], Mistake> {
        let all = self.numbers()?;
        let count = all.len();
        all.try_into().map_err(|_| self.mistake(format!("`{}` holds {count} numbers, {N} are needed", self.name)))
    }

    /// One number.
    pub fn number(&self) -> Result<f64, Mistake> {
        Ok(self.exactly::<1>()?[0])
    }

    /// A whole number of pixels.
    pub fn pixels(&self) -> Result<u32, Mistake> {
        self.whole_pixels(self.number()?)
    }

    /// `number` as a size in px.
    pub fn whole_pixels(&self, number: f64) -> Result<u32, Mistake> {
        if number.fract() != 0.0 || !(2.0..=65536.0).contains(&number) {
            let what = format!("`{}` is {number}: a whole number of px from 2 to 65536 is needed", self.name);
            return Err(self.mistake(what));
        }
        Ok(number as u32)
    }
}

/// The entries of a text in their order.
#[derive(Debug)]
pub(crate) struct Entries<'t>(Vec<Entry<'t>>);

impl<'t> Entries<'t> {
    /// Lines of a name, `separator` and numbers; what follows `comment` counts as nothing. Other lines are left out.
    pub fn parse(text: &'t str, separator: char, comment: &str) -> Self {
        let lines = text.lines().enumerate().filter_map(|(number, line)| {
            let end = line.find(comment).unwrap_or(line.len());
            let at = line[..end].find(separator)?;
            let name = line[..at].trim();
            (!name.is_empty()).then(|| Entry::new(name, (number, line), at + separator.len_utf8(), end))
        });
        Self(lines.take(MAX_ENTRIES).collect())
    }

    /// The entries of one `[section]` of an INI file.
    pub fn section(text: &'t str, section: &str) -> Option<Self> {
        let mut inside = false;
        let mut is_there = false;
        let mut entries = Vec::new();
        for (number, line) in text.lines().enumerate() {
            let trimmed = line.trim();
            if let Some(name) = trimmed.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
                inside = name.trim() == section;
                is_there |= inside;
            } else if inside
                && !trimmed.starts_with(['#', ';'])
                && let Some(at) = line.find('=')
                && entries.len() < MAX_ENTRIES
            {
                entries.push(Entry::new(line[..at].trim(), (number, line), at + 1, line.len()));
            }
        }
        is_there.then_some(Self(entries))
    }

    /// The first entry of a name.
    pub fn get(&self, name: &str) -> Option<&Entry<'t>> {
        self.0.iter().find(|entry| entry.name == name)
    }

    /// As [`Self::get`], for an entry without which there is no calibration.
    pub fn needed(&self, name: &str) -> Result<&Entry<'t>, Mistake> {
        self.get(name)
            .ok_or_else(|| Mistake::whole(format!("`{name}` is missing: the file is cut off or of another kind")))
    }

    /// Numbers of the entries `PREFIX0` to `PREFIX(N-1)`; those missing from `needed` on are 0.
    pub fn numbered<const N: usize>(&self, prefix: &str, needed: usize) -> Result<[f64; N], Mistake> {
        let mut out = [0.0; N];
        for (index, out) in out.iter_mut().enumerate() {
            let name = format!("{prefix}{index}");
            match self.get(&name) {
                Some(entry) => *out = entry.number()?,
                None if index < needed => drop(self.needed(&name)?),
                None => {}
            }
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::Entries;

    #[test]
    fn entries_know_where_they_stand() {
        let entries = Entries::parse("a: 1 2\nno entry\n  bé :  x3 // 4\n", ':', "//");
        assert_eq!(entries.get("a").unwrap().exactly::<2>().unwrap(), [1.0, 2.0]);
        let mistake = entries.get("bé").unwrap().number().unwrap_err();
        assert_eq!(
            (mistake.line, mistake.column, mistake.what.as_str()),
            (3, 9, "`bé` holds `x3`, which is not a number")
        );
        assert!(entries.needed("c").unwrap_err().what.contains("`c` is missing"));
    }

    #[test]
    fn sections_are_kept_apart() {
        let text = "[One]\nk_0 = 1\nk_1=2\n; k_2 = 9\n[Two]\nk_0=3\n";
        let one = Entries::section(text, "One").unwrap();
        assert_eq!(one.numbered::<3>("k_", 2).unwrap(), [1.0, 2.0, 0.0]);
        assert!(Entries::section(text, "Two").unwrap().numbered::<2>("k_", 2).is_err());
        assert!(Entries::section(text, "Three").is_none());
    }
}
