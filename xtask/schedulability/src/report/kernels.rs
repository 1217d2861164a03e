//! The table of kernels: small programs that show how tight the analysis is.

use crate::results::KernelReport;
use wcet::cycles::Model;

use super::columns::Align::{Left, Right};
use super::columns::columns;
use super::summary::median;

/// The kernels' bounds beside the longest observed times, in cycles.
#[must_use]
pub fn kernels(all: &[KernelReport]) -> String {
    let rows = all.iter().map(|kernel| {
        let figures = |model: Model| {
            let ratio = format!("{:.2}", kernel.ratio(model));
            [
                kernel.bound[model].to_string(),
                kernel.seen[model].to_string(),
                ratio,
            ]
        };
        let [bound, seen, ratio] = figures(Model::ZeroWait);
        let [flash, seen_flash, ratio_flash] = figures(Model::Flashed);
        let name = kernel.name.clone();
        [name, bound, seen, ratio, flash, seen_flash, ratio_flash]
    });
    let of = |model| median(all.iter().map(|kernel| kernel.ratio(model)));
    let medians = of(Model::ZeroWait)
        .zip(of(Model::Flashed))
        .map(|(zero, flash)| {
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
