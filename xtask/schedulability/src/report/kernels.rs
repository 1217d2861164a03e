//! The table of kernels, by which the analysis itself is judged.

use crate::results::KernelReport;

use super::columns::Align::{Left, Right};
use super::columns::columns;
use super::summary::median;

/// The kernels' bounds beside the longest observed times, in cycles.
#[must_use]
pub fn kernels(all: &[KernelReport]) -> String {
    let rows = all.iter().map(|kernel| {
        let [bound, flash] = kernel.bound;
        let [seen, seen_flash] = kernel.seen;
        [
            kernel.name.clone(),
            bound.to_string(),
            seen.to_string(),
            format!("{:.2}", kernel.ratio(0)),
            flash.to_string(),
            seen_flash.to_string(),
            format!("{:.2}", kernel.ratio(1)),
        ]
    });
    let of = |model| median(all.iter().map(|kernel| kernel.ratio(model)));
    let medians = of(0).zip(of(1)).map(|(zero, flash)| {
        let [zero, flash] = [zero, flash].map(|median| format!("{median:.2}"));
        let empty = String::new;
        [
            "median".to_owned(),
            empty(),
            empty(),
            zero,
            empty(),
            empty(),
            flash,
        ]
    });
    columns(
        [
            ("kernel", Left),
            ("bound", Right),
            ("seen", Right),
            ("ratio", Right),
            ("as flashed", Right),
            ("seen", Right),
            ("ratio", Right),
        ],
        rows.chain(medians).map(|cells| (true, cells)),
    )
}
