//! CSV files whose columns are known only after the last line.

use std::fmt::Write as _;

use panoscope_data::formats::fields::{CsvFields, csv_line};

/// Lines with named cells. Columns stand in the order in which they first appear.
#[derive(Debug, Default)]
pub struct TableFile {
    columns: Vec<String>,
    /// Cells of each line by the index of their column.
    lines: Vec<Vec<(usize, String)>>,
}

impl TableFile {
    /// Adds a line.
    pub fn push(&mut self, line: &CsvFields) {
        let mut cells: Vec<(usize, String)> = Vec::with_capacity(line.len());
        for (name, cell) in line.iter() {
            // A table may have two columns of one name.
            let mut number = 1;
            let column = loop {
                let name = if number == 1 { name.to_owned() } else { format!("{name}_{number}") };
                let column = self.columns.iter().position(|column| *column == name).unwrap_or_else(|| {
                    self.columns.push(name);
                    self.columns.len() - 1
                });
                if cells.iter().all(|(used, _)| *used != column) {
                    break column;
                }
                number += 1;
            };
            cells.push((column, cell.to_owned()));
        }
        self.lines.push(cells);
    }

    /// Number of lines below the names of the columns.
    pub fn len(&self) -> usize {
        self.lines.len()
    }

    /// The content of the file.
    pub fn text(&self) -> String {
        let mut out = String::new();
        csv_line(&mut out, &self.columns);
        let mut row = vec![""; self.columns.len()];
        for line in &self.lines {
            row.fill("");
            line.iter().for_each(|(column, cell)| row[*column] = cell);
            let _ = writeln!(out, "{}", row.join(","));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_data::formats::fields::Fields;

    fn line(cells: &[(&str, f64)]) -> CsvFields {
        let mut line = CsvFields::default();
        cells.iter().for_each(|(name, value)| line.number(name, *value));
        line
    }

    #[test]
    fn columns_are_those_of_all_lines() {
        let mut file = TableFile::default();
        file.push(&line(&[("tick", 0.0), ("x_mm", 1.5)]));
        file.push(&line(&[("tick", 1.0), ("a,b", 2.0), ("x_mm", 3.0), ("x_mm", 4.0)]));
        assert_eq!(file.text(), "tick,x_mm,\"a,b\",x_mm_2\n0,1.5,,\n1,3,2,4\n");
        assert_eq!(file.len(), 2);
    }
}
