//! What the answers rest on.

use std::collections::BTreeMap;

use crate::results::{MICROSECOND, NodeReport, time};
use crate::system::Models;

/// One sentence each.
#[must_use]
pub fn of(models: &Models, nodes: &[NodeReport]) -> Vec<String> {
    let network = &models.network;
    let mut all = vec![
        format!(
            "Every frame is in its window: it begins at most {} after the window's mark, and two clocks differ by at most {} us.",
            time(u64::from(network.transmit_enable_bits) * u64::from(network.bit_time_ns()) * 1000),
            network.sync_uncertainty_us
        ),
        "A word of memory in which start-up leaves an address, and which no store of any handler can reach, keeps it: an unknown index stays within its array, a pointer of which nothing is known (in a software task's future or the timer queue) leads to no such word, and DMA writes only to variables whose address a peripheral was told.".to_owned(),
        "Flash: a fetch pays its wait states unless its line is proven to be in the fetch buffer; no hit in a cache is claimed. Data in SRAM is reached without wait.".to_owned(),
        "DMA never holds the core off the bus matrix for longer than the wait states charged; a debugger is not connected.".to_owned(),
        "An interrupt that is pending twice runs once, and its handler serves all there is; those of the bus do one thing each and come again while there is more."
            .to_owned(),
        "An event message is sent at most once in each of its intervals; a task is not released more often than firmware/vehicles/uagv/tasks.toml says.".to_owned(),
    ];
    let bus = models.table.bus;
    all.push(if bus.error_burst == 0 && bus.error_interval_ms == 0 {
        "No frame is disturbed: an exclusive window has no repeat, and a disturbed frame is a lost one.".to_owned()
    } else {
        format!(
            "In arbitrating windows {} frames are disturbed at once and one more every {} ms; in an exclusive window a disturbed frame is a lost one.",
            bus.error_burst, bus.error_interval_ms
        )
    });
    let mut tasks = models.nodes.iter().flat_map(|(model, _)| &model.tasks);
    if tasks.any(|task| task.dispatched) {
        all.push("Executor and timer queue of the software tasks call only functions whose address stands in the image; a task waits for one instant at a time.".to_owned());
    }
    let mut never: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for (model, _) in &models.nodes {
        for task in &model.tasks {
            for (kind, functions) in &task.never {
                let what = format!(
                    "A job of {} for {} never calls {}.",
                    task.name,
                    kind.name(),
                    functions.join(" or ")
                );
                never.entry(what).or_default().push(&model.name);
            }
        }
    }
    all.extend(
        never
            .into_iter()
            .map(|(what, nodes)| format!("{} On {}.", what, nodes.join(", "))),
    );
    for (model, table) in &models.nodes {
        all.push(format!(
            "{} runs at {} MHz and begins to transmit {} before the mark.",
            model.name,
            table.core_hz as f64 / 1e6,
            time(table.transmit_lead_us * MICROSECOND)
        ));
    }
    let mut annotated: BTreeMap<&str, u64> = BTreeMap::new();
    let mut panics = 0;
    for task in nodes.iter().flat_map(|node| &node.tasks) {
        panics += task.panics.len();
        for (place, bound) in &task.annotated {
            annotated.insert(place, *bound);
        }
    }
    for (place, bound) in annotated {
        all.push(format!(
            "The loop at {place} takes at most {bound} turns, as its annotation says."
        ));
    }
    if panics > 0 {
        all.push(format!(
            "{panics} places may panic as far as the image tells; a path counts up to its panic, after which the motors are stopped."
        ));
    }
    all
}
