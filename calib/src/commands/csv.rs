//! Tables with a head line, separated by commas.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use super::explain::Explain;

/// A table; every line has as many cells as the head.
#[derive(Debug)]
pub(crate) struct Table {
    file: PathBuf,
    head: Vec<String>,
    /// Number in the file and cells of each line.
    lines: Vec<(usize, Vec<String>)>,
}

/// Why a file is no such table.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TableError {
    #[error("cannot read `{}`", file.display())]
    Read {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("`{}` has no column `{column}` (there are: {present})", file.display())]
    NoColumn {
        file: PathBuf,
        column: String,
        present: String,
    },
    #[error("`{}`, line {line}: `{found}` cells (the head has `{expected}`)", file.display())]
    Cells {
        file: PathBuf,
        line: usize,
        found: usize,
        expected: usize,
    },
    #[error("`{}`, line {line}: `{column}` is `{found}` (allowed: {allowed})", file.display())]
    Value {
        file: PathBuf,
        line: usize,
        column: String,
        found: String,
        allowed: &'static str,
    },
}

impl Explain for TableError {
    fn is_bad_input(&self) -> bool {
        true
    }

    fn hint(&self) -> Option<&str> {
        Some("the first line names the columns, all others hold numbers separated by commas")
    }
}

impl Table {
    /// Reads a file; empty lines and lines that begin with `#` are skipped.
    pub(crate) fn read(file: &Path) -> Result<Self, TableError> {
        let text = fs::read_to_string(file).map_err(|source| TableError::Read {
            file: file.to_owned(),
            source,
        })?;
        Self::parse(&text, file)
    }

    fn parse(text: &str, file: &Path) -> Result<Self, TableError> {
        let mut lines = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
        let mut lines = lines
            .by_ref()
            .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        let cells = |line: &str| line.split(',').map(|cell| cell.trim().to_owned()).collect::<Vec<_>>();
        let head = lines.next().map_or(Vec::new(), |(_, line)| cells(line));
        let mut table = Self {
            file: file.to_owned(),
            head,
            lines: Vec::new(),
        };
        for (line, text) in lines {
            let cells = cells(text);
            if cells.len() != table.head.len() {
                return Err(TableError::Cells {
                    file: file.to_owned(),
                    line,
                    found: cells.len(),
                    expected: table.head.len(),
                });
            }
            table.lines.push((line, cells));
        }
        Ok(table)
    }

    /// Whether there is a column of this name.
    pub(crate) fn has(&self, column: &str) -> bool {
        self.head.iter().any(|name| name == column)
    }

    /// Number of lines below the head.
    pub(crate) fn len(&self) -> usize {
        self.lines.len()
    }

    /// Numbers of these columns in a line, from 0.
    pub(crate) fn numbers<const N: usize>(&self, index: usize, columns: [&str; N]) -> Result<[f64; N], TableError> {
        let mut numbers = [0.0; N];
        for (number, column) in numbers.iter_mut().zip(columns) {
            let cell = self.cell(index, column)?;
            let parsed = cell.parse::<f64>().ok().filter(|x| x.is_finite());
            *number = parsed.ok_or_else(|| self.value(index, column, "a finite number"))?;
        }
        Ok(numbers)
    }

    /// A whole number.
    pub(crate) fn whole(&self, index: usize, column: &str) -> Result<u64, TableError> {
        let cell = self.cell(index, column)?;
        cell.parse()
            .map_err(|_| self.value(index, column, "a whole number, 0 or more"))
    }

    /// A text.
    pub(crate) fn cell(&self, index: usize, column: &str) -> Result<&str, TableError> {
        let place = self.head.iter().position(|name| name == column);
        let place = place.ok_or_else(|| TableError::NoColumn {
            file: self.file.clone(),
            column: column.to_owned(),
            present: self
                .head
                .iter()
                .map(|name| format!("`{name}`"))
                .collect::<Vec<_>>()
                .join(", "),
        })?;
        Ok(&self.lines[index].1[place])
    }

    /// The error of a cell that is there and cannot be what it is.
    pub(crate) fn value(&self, index: usize, column: &str, allowed: &'static str) -> TableError {
        TableError::Value {
            file: self.file.clone(),
            line: self.lines[index].0,
            column: column.to_owned(),
            found: self.cell(index, column).unwrap_or_default().to_owned(),
            allowed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name() {
        let table = Table::parse("# poses\nb, a\n1.5,2\n\n-3,7\n", Path::new("t.csv")).unwrap();
        assert_eq!(table.len(), 2);
        assert_eq!(table.numbers(1, ["a", "b"]).unwrap(), [7.0, -3.0]);
        assert_eq!(table.whole(0, "a").unwrap(), 2);
        assert!(table.has("b") && !table.has("c"));
        let said = |error: TableError| error.to_string();
        assert_eq!(
            said(table.numbers(0, ["c"]).unwrap_err()),
            "`t.csv` has no column `c` (there are: `b`, `a`)"
        );
        assert_eq!(
            said(table.whole(1, "b").unwrap_err()),
            "`t.csv`, line 5: `b` is `-3` (allowed: a whole number, 0 or more)"
        );
        let error = Table::parse("a,b\n1\n", Path::new("t.csv")).unwrap_err();
        assert_eq!(said(error), "`t.csv`, line 2: `1` cells (the head has `2`)");
    }
}
