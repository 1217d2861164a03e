//! Text in aligned columns.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ColumnConstraint, ContentArrangement, Table, Width};

/// To which side a column is aligned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Align {
    Left,
    Right,
}

/// A table without borders. Each row begins with `!` if its first part is false.
///
/// Every line ends with a line feed and has no trailing blanks.
pub(crate) fn columns<const N: usize>(
    headings: [(&str, Align); N],
    rows: impl IntoIterator<Item = (bool, [String; N])>,
) -> String {
    let mut table = Table::new();
    table
        .load_style(NOTHING)
        .set_content_arrangement(ContentArrangement::Disabled)
        .add_row([""].into_iter().chain(headings.map(|(heading, _)| heading)));
    for (meets, cells) in rows {
        let mark = if meets { "" } else { "!" }.to_owned();
        table.add_row([mark].into_iter().chain(cells));
    }
    let alignments = [Align::Left]
        .into_iter()
        .chain(headings.map(|(_, align)| align));
    for (column, align) in table.column_iter_mut().zip(alignments) {
        column.set_padding((0, 1)).set_cell_alignment(match align {
            Align::Left => CellAlignment::Left,
            Align::Right => CellAlignment::Right,
        });
    }
    if let Some(marks) = table.column_mut(0) {
        marks.set_constraint(ColumnConstraint::LowerBoundary(Width::Fixed(2)));
    }
    let mut text = table.trim_fmt();
    text.push('\n');
    text
}

#[cfg(test)]
mod tests {
    use super::{Align, columns};

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let row = |meets, name: &str, time: &str| (meets, [name.to_owned(), time.to_owned()]);
        assert_eq!(
            columns(
                [("task", Align::Left), ("takes", Align::Right)],
                [row(true, "scan", "1.5 us"), row(false, "display", "-")],
            ),
            concat!(
                "  task     takes\n",
                "  scan    1.5 us\n",
                "! display      -\n"
            )
        );
    }
}
