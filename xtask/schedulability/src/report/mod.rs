//! The answers for people, for programs and for a browser.

mod explain;
mod html;
mod json;
mod table;
mod timeline;

pub use explain::explain;
pub use html::html;
pub use json::json;
pub use table::table;

use std::collections::BTreeMap;

use crate::results::{KernelReport, Picoseconds, Report, TaskReport, time};

fn or_dash(value: Option<Picoseconds>) -> String {
    value.map_or_else(|| "-".to_owned(), time)
}

/// Headings of the table of tasks, the task's name first.
const HEADINGS: [&str; 13] = [
    "task",
    "prio",
    "interrupt",
    "every",
    "bound",
    "seen",
    "ratio",
    "ratio 0ws",
    "blocked",
    "response",
    "deadline",
    "slack",
    "may grow",
];

/// A row of that table.
fn row(task: &TaskReport, cycle_time: impl Fn(u64) -> Picoseconds) -> [String; 13] {
    let ratio = |model: usize| {
        let ratio = task.ratio(model);
        ratio.map_or_else(|| "-".to_owned(), |ratio| format!("{ratio:.2}"))
    };
    let bounded = |value: Picoseconds| or_dash(task.is_bounded().then_some(value));
    [
        task.name.clone(),
        task.priority.to_string(),
        task.interrupt.clone(),
        every(task),
        bounded(task.cost),
        or_dash(task.observed.map(|seen| cycle_time(seen[1]))),
        ratio(1),
        ratio(0),
        time(task.blocking),
        or_dash(task.response),
        time(task.deadline),
        or_dash(task.slack()),
        or_dash(task.sensitivity),
    ]
}

/// How often it may be released: by the time table, or its least distance.
fn every(task: &TaskReport) -> String {
    match task.releases.len() {
        0 => time(task.period),
        releases => format!("{releases} a cycle"),
    }
}

/// What the columns mean.
const LEGEND: &str = "every: least time between two releases, or how many of them the bus's time table has; bound, seen: longest time as flashed, without and with the emulator; ratio: \
    bound over seen as flashed and at zero wait states; blocked: longest critical section of a \
    lower priority; response: worst time from release to end of the release with the least room; \
    may grow: how much longer one job may take before anything on the node misses.";

/// Median of the ratios of a timing model, over the tasks and the kernels that
/// are wanted.
fn median_ratio(report: &Report, model: usize, tasks: bool, kernels: bool) -> Option<f64> {
    let nodes = report.nodes.iter().filter(|_| tasks);
    let of_tasks = nodes
        .flat_map(|node| &node.tasks)
        .filter_map(|task| task.ratio(model));
    let of_kernels = report.kernels.iter().filter(|_| kernels);
    median(of_tasks.chain(of_kernels.map(|kernel| kernel.ratio(model))))
}

fn median(ratios: impl Iterator<Item = f64>) -> Option<f64> {
    let mut ratios: Vec<f64> = ratios.collect();
    ratios.sort_by(f64::total_cmp);
    match ratios.len() {
        0 => None,
        n if n % 2 == 1 => Some(ratios[n / 2]),
        n => Some((ratios[n / 2 - 1] + ratios[n / 2]) / 2.0),
    }
}

/// How tight the bounds are: medians over tasks, kernels and both, each at zero
/// wait states and as flashed.
fn tightness(report: &Report) -> Option<String> {
    let of = |what: &str, tasks, kernels| {
        let zero = median_ratio(report, 0, tasks, kernels)?;
        let flash = median_ratio(report, 1, tasks, kernels)?;
        Some(format!("{what} {zero:.2} and {flash:.2}"))
    };
    let all = [
        of("tasks", true, false),
        of("kernels", false, true),
        of("both", true, true).filter(|_| !report.kernels.is_empty()),
    ];
    let all: Vec<String> = all.into_iter().flatten().collect();
    (!all.is_empty()).then(|| {
        format!(
            "median of bound over seen, at zero wait states and as flashed: {}",
            all.join(", ")
        )
    })
}

/// The kernels' bounds beside what was seen of them.
#[must_use]
pub fn kernels(all: &[KernelReport]) -> String {
    use std::fmt::Write as _;
    let mut text = format!(
        "{:30} {:>8} {:>8} {:>6} {:>10} {:>8} {:>6}\n",
        "kernel", "bound", "seen", "ratio", "as flashed", "seen", "ratio"
    );
    for kernel in all {
        let [bound, flash] = kernel.bound;
        let [seen, seen_flash] = kernel.seen;
        let _ = writeln!(
            text,
            "{:30} {bound:>8} {seen:>8} {:>6.2} {flash:>10} {seen_flash:>8} {:>6.2}",
            kernel.name,
            kernel.ratio(0),
            kernel.ratio(1)
        );
    }
    let of = |model| median(all.iter().map(|kernel| kernel.ratio(model)));
    if let (Some(zero), Some(flash)) = (of(0), of(1)) {
        let _ = writeln!(text, "{:30} {zero:>24.2} {flash:>26.2}", "median");
    }
    text
}

/// What the runs say of graph and loop bounds; `None` without a run.
fn followed(report: &Report) -> Option<String> {
    let tasks = report.nodes.iter().flat_map(|node| {
        let name = &node.name;
        node.tasks
            .iter()
            .map(move |task| ((name, &task.interrupt), task))
    });
    // Software tasks of one priority have one handler.
    let handlers: BTreeMap<_, _> = tasks.collect();
    let activations: u64 = handlers.values().map(|task| task.followed).sum();
    let refuted: usize = handlers.values().map(|task| task.refuted.len()).sum();
    let silent: Vec<String> = handlers
        .iter()
        .filter(|(_, task)| task.followed == 0)
        .map(|((node, _), task)| format!("{node}.{}", task.name))
        .collect();
    let outcome = match refuted {
        0 => "none left its graph or took more turns than allowed".to_owned(),
        1 => "one thing of the analysis is refuted".to_owned(),
        refuted => format!("{refuted} things of the analysis are refuted"),
    };
    let rest = match silent.as_slice() {
        [] => String::new(),
        silent => format!("; never released: {}", silent.join(", ")),
    };
    (activations > 0).then(|| {
        format!(
            "followed instruction by instruction: {activations} activations of {} handlers, {outcome}{rest}",
            handlers.len() - silent.len()
        )
    })
}

/// The answer in one line.
fn verdict(report: &Report) -> String {
    match report.first_miss() {
        None => "schedulable: every deadline holds".to_owned(),
        Some(miss) => format!("not schedulable: {miss}"),
    }
}
