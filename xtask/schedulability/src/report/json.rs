//! The report for programs.

use serde_json::{Value, json};

use crate::results::{NodeReport, Report, TaskReport, Tolerance};

use super::summary::median_ratio;
use wcet::cycles::{Cycles, Model};

/// The whole report; times in picoseconds.
#[must_use]
pub fn json(report: &Report) -> Value {
    let median = |model, tasks, kernels| median_ratio(report, model, tasks, kernels);
    json!({
        "schedulable": report.schedulable(),
        "first_miss": report.first_miss(),
        "unbounded": report.unbounded().into_iter().map(|(function, problems)| json!({
            "function": function,
            "problems": problems.into_iter().map(|(problem, whose)| json!({
                "problem": problem.to_string(),
                "of": whose,
            })).collect::<Vec<_>>(),
        })).collect::<Vec<_>>(),
        "basic_cycle_ps": report.basic_cycle,
        "assumptions": report.assumptions,
        "errors": {
            "burst": report.errors.burst,
            "interval_ps": report.errors.interval * 1000,
        },
        "median_ratio": {
            "zero_wait": median(Model::ZeroWait, true, false),
            "as_flashed": median(Model::Flashed, true, false),
            "kernels_zero_wait": median(Model::ZeroWait, false, true),
            "kernels_as_flashed": median(Model::Flashed, false, true),
            "both_zero_wait": median(Model::ZeroWait, true, true),
            "both_as_flashed": median(Model::Flashed, true, true),
        },
        "kernels": report.kernels.iter().map(|kernel| json!({
            "name": kernel.name,
            "bound_cycles": kernel.bound.zero_wait,
            "bound_cycles_flash": kernel.bound.flashed,
            "observed_cycles": kernel.seen.zero_wait,
            "observed_cycles_flash": kernel.seen.flashed,
        })).collect::<Vec<_>>(),
        "nodes": report.nodes.iter().map(node).collect::<Vec<_>>(),
        "messages": report.messages.iter().map(|message| json!({
            "name": message.name,
            "id": message.id,
            "start_ps": message.start,
            "need_ps": message.need,
            "room_ps": message.room,
            "arbitrating": message.arbitrating,
            "tolerance": tolerance(message.tolerance),
            "meets": message.meets(),
        })).collect::<Vec<_>>(),
        "messages_left_out": report.left_out,
        "chains": report.chains.iter().map(|chain| json!({
            "name": chain.name,
            "latency_ps": chain.latency,
            "deadline_ps": chain.deadline,
            "lost": chain.lost.as_ref().map(|lost| json!({
                "messages": lost.messages,
                "frames": lost.frames,
                "latency_ps": lost.latency,
                "deadline_ps": lost.deadline,
            })),
            "steps": chain.steps.iter().map(|step| json!({
                "step": step.name,
                "done_ps": step.done,
                "phase_ps": step.phase,
            })).collect::<Vec<_>>(),
            "meets": chain.meets(),
        })).collect::<Vec<_>>(),
    })
}

fn tolerance(tolerance: Tolerance) -> Value {
    match tolerance {
        Tolerance::Repeated(errors) => json!({ "repeated": true, "errors": errors }),
        Tolerance::Lost { next, acted_on } => {
            json!({ "repeated": false, "next_ps": next, "acted_on_losses": acted_on })
        }
        Tolerance::Reference(delay) => json!({ "repeated": true, "cycle_later_ps": delay }),
    }
}

/// One node; times in picoseconds.
#[must_use]
pub fn node(node: &NodeReport) -> Value {
    json!({
        "name": node.name,
        "core_hz": node.core_hz,
        "stack_bytes": node.stack,
        "stack_size_bytes": node.stack_size,
        "stack_unknown": node.stack_unknown,
        "utilisation_permille": node.utilisation_permille,
        "idle_problems": node.idle_problems.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "idle_annotated": node.idle_annotated,
        "idle_summarised": node.idle_summarised,
        "outside": node.outside.iter().map(|one| json!({
            "name": one.name,
            "vectors": one.vectors,
            "ends": one.ends.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "stack_bytes": one.stack,
            "discards_stack": one.begins_anew,
        })).collect::<Vec<_>>(),
        "tasks": node.tasks.iter().map(|of| task(node, of)).collect::<Vec<_>>(),
    })
}

fn task(node: &NodeReport, task: &TaskReport) -> Value {
    let bounded = |value: u64| task.is_bounded().then_some(value);
    json!({
        "name": task.name,
        "interrupt": task.interrupt,
        "priority": task.priority,
        "bound_cycles": bounded(task.cycles.zero_wait),
        "bound_cycles_flash": bounded(task.cycles.flashed),
        "entry_and_return_cycles": task.overhead.to_array(),
        "program_cycles": task.program.map(Cycles::to_array),
        "observed_cycles": task.observed.map(|seen| seen.zero_wait),
        "observed_cycles_flash": task.observed.map(|seen| seen.flashed),
        "ratio": task.ratio(Model::ZeroWait),
        "ratio_flash": task.ratio(Model::Flashed),
        "cost_ps": bounded(task.cost),
        "period_ps": task.period,
        "at_once": task.at_once,
        "jitter_ps": task.jitter,
        "blocking_ps": task.blocking,
        "blocked_by": task.blocked_by,
        "release": task.job,
        "deadline_ps": task.deadline,
        "response_ps": task.response,
        "slack_ps": task.slack(),
        "sensitivity_ps": task.sensitivity,
        "itself_ps": task.itself,
        "before_release_ps": task.before_release(),
        "delayed_by": task.delayed_by.iter().map(|(other, jobs, time)| json!({
            "task": other, "jobs": jobs, "time_ps": time,
        })).collect::<Vec<_>>(),
        "meets": task.meets(),
        "miss": task.miss(&node.name),
        "problems": task.problems.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "panics": task.panics,
        "annotated": task.annotated,
        "summarised": task.summarised,
        "followed": task.followed,
        "refuted": task.refuted,
    })
}
