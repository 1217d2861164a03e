//! Sentences about the whole report.

use std::collections::BTreeMap;

use crate::results::Report;
use wcet::cycles::Model;

/// Median of bound over longest observed time under one timing model, over tasks, kernels or
/// both.
pub(super) fn median_ratio(
    report: &Report,
    model: Model,
    tasks: bool,
    kernels: bool,
) -> Option<f64> {
    let nodes = report.nodes.iter().filter(|_| tasks);
    let of_tasks = nodes
        .flat_map(|node| &node.tasks)
        .filter_map(|task| task.ratio(model));
    let of_kernels = report.kernels.iter().filter(|_| kernels);
    median(of_tasks.chain(of_kernels.map(|kernel| kernel.ratio(model))))
}

pub(super) fn median(ratios: impl Iterator<Item = f64>) -> Option<f64> {
    let mut ratios: Vec<f64> = ratios.collect();
    ratios.sort_by(f64::total_cmp);
    match ratios.len() {
        0 => None,
        n if n % 2 == 1 => Some(ratios[n / 2]),
        n => Some((ratios[n / 2 - 1] + ratios[n / 2]) / 2.0),
    }
}

/// How tight the bounds are: medians over tasks, kernels and both, each at zero wait states
/// and as flashed. `None` without any observation.
pub(super) fn tightness(report: &Report) -> Option<String> {
    let of = |what: &str, tasks, kernels| {
        let zero = median_ratio(report, Model::ZeroWait, tasks, kernels)?;
        let flash = median_ratio(report, Model::Flashed, tasks, kernels)?;
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
            "median of bound over seen, by the emulator's model and as flashed: {}",
            all.join(", ")
        )
    })
}

/// Which messages are left out, and why; `None` if none is.
pub(super) fn left_out(report: &Report) -> Option<String> {
    let names = report.left_out.join(", ");
    (!names.is_empty()).then(|| {
        format!("left out: {names}; what they need depends on nodes that are not analysed here")
    })
}

/// How far emulated runs confirm the analysed paths; `None` without a run.
pub(super) fn followed(report: &Report) -> Option<String> {
    let tasks = report.nodes.iter().flat_map(|node| {
        let name = &node.name;
        node.tasks
            .iter()
            .map(move |task| ((name, &task.interrupt), task))
    });
    // Software tasks of one priority share a handler, so the map holds each handler once.
    let handlers: BTreeMap<_, _> = tasks.collect();
    let activations: u64 = handlers.values().map(|task| task.followed).sum();
    let refuted: usize = handlers.values().map(|task| task.refuted.len()).sum();
    let silent: Vec<String> = handlers
        .iter()
        .filter(|(_, task)| task.followed == 0)
        .map(|((node, _), task)| format!("{node}.{}", task.name))
        .collect();
    let outcome = match refuted {
        0 => "none left its control-flow graph or exceeded a loop bound".to_owned(),
        1 => "one of them contradicts the analysis".to_owned(),
        refuted => format!("{refuted} contradictions to the analysis"),
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

/// The answer in one line, with the rate of disturbed frames for which it holds.
pub(super) fn verdict(report: &Report) -> String {
    let errors = report.errors;
    match report.first_miss() {
        None => format!("schedulable: every deadline holds, with {errors}"),
        Some(miss) => format!("not schedulable: {miss} (with {errors})"),
    }
}
