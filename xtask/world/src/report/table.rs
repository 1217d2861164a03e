//! A table with one row for each recorded instant.

use core::fmt::Write;

use super::figures::rounded;

/// A column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Its name, which ends with the unit: `speed_m_s`.
    pub name: String,
    /// What is in it.
    pub what: &'static str,
    /// Its unit; empty for words and shares.
    pub unit: &'static str,
    /// Decimals of its numbers.
    pub digits: usize,
}

impl Column {
    /// A column of numbers.
    #[must_use]
    pub fn new(name: &str, unit: &'static str, digits: usize, what: &'static str) -> Self {
        Self {
            name: name.to_owned(),
            what,
            unit,
            digits,
        }
    }
}

/// What is in a row and column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cell {
    /// A number in the unit of its column.
    Number(f64),
    /// A word.
    Word(&'static str),
    /// Nothing: there was no value.
    Empty,
}

impl From<Option<f64>> for Cell {
    fn from(value: Option<f64>) -> Self {
        value.map_or(Self::Empty, Self::Number)
    }
}

/// Values over time. The first column is the time in seconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// The columns.
    pub columns: Vec<Column>,
    /// The rows, in order of time, each as long as the columns.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// The table as comma-separated text with a heading.
    #[must_use]
    pub fn csv(&self) -> String {
        let names: Vec<&str> = self.columns.iter().map(|one| one.name.as_str()).collect();
        let mut text = names.join(",");
        text.push('\n');
        for row in &self.rows {
            for (index, (cell, column)) in row.iter().zip(&self.columns).enumerate() {
                if index > 0 {
                    text.push(',');
                }
                // Writing to a string cannot fail.
                let _ = match *cell {
                    Cell::Number(value) => {
                        let value = rounded(value, column.digits as i32);
                        write!(text, "{value:.*}", column.digits)
                    }
                    Cell::Word(word) => write!(text, "{word}"),
                    Cell::Empty => Ok(()),
                };
            }
            text.push('\n');
        }
        text
    }

    /// The time of a row, s.
    #[must_use]
    pub fn seconds(row: &[Cell]) -> f64 {
        match row.first() {
            Some(Cell::Number(seconds)) => *seconds,
            _ => 0.0,
        }
    }

    /// Adds a column with the last of these values at the time of each row: `values` are seconds and
    /// value, in order of time. One older than `stale` seconds is no longer shown.
    pub fn join(&mut self, column: Column, values: &[(f64, f64)], stale: f64) {
        self.columns.push(column);
        for row in &mut self.rows {
            let now = Self::seconds(row);
            let known = values.partition_point(|(at, _)| *at <= now);
            let last = known.checked_sub(1).and_then(|last| values.get(last));
            let last = last.filter(|(at, _)| now - at <= stale);
            row.push(last.map(|(_, value)| *value).into());
        }
    }

    /// The place of the column of that name.
    #[must_use]
    pub fn place(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column.name == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joined_value_holds_until_the_next_or_until_it_is_stale() {
        let mut table = Table {
            columns: vec![Column::new("time_s", "s", 1, "time")],
            rows: (0..6)
                .map(|i| vec![Cell::Number(f64::from(i) * 0.5)])
                .collect(),
        };
        let column = Column::new("speed_m_s", "m/s", 2, "speed");
        table.join(column, &[(0.5, -1.0), (1.2, 2.0)], 1.0);
        assert_eq!(
            table.csv(),
            "time_s,speed_m_s\n0.0,\n0.5,-1.00\n1.0,-1.00\n1.5,2.00\n2.0,2.00\n2.5,\n"
        );
        assert_eq!(table.place("speed_m_s"), Some(1));
        assert_eq!(table.place("speed"), None);
    }
}
