//! The worst-case stack depth of a node.

use std::collections::BTreeMap;

use schedulability::tasks::App;
use wcet::{
    image::Image,
    stack::{FRAME_FPU, Stacks},
};

use super::calls::Calls;

/// The worst-case stack depth in bytes: that of the main program, and for each priority an
/// exception frame and the deepest task of that priority. Tasks of one priority do not preempt
/// each other, so only one of them is on the stack.
///
/// # Errors
///
/// The reasons why the depth is unknown, one sentence each.
pub(super) fn deepest(image: &Image, calls: &Calls, app: &App) -> Result<u64, Vec<String>> {
    let mut stacks = Stacks::new(image);
    let calls = calls.bodies().flat_map(|(_, body)| &body.calls);
    let mut unknown: Vec<String> = calls
        .filter(|call| call.callee.is_none())
        .map(|call| {
            let place = image.describe(call.at);
            format!("its stack is not known: call through a pointer at {place}")
        })
        .collect();
    let mut depth = |name: &str| {
        let Some(entry) = image.symbol(name) else {
            unknown.push(format!("its stack is not known: there is no {name} in it"));
            return 0;
        };
        let depth = stacks.depth(entry);
        unknown.extend(
            depth
                .unknown
                .iter()
                .map(|what| format!("its stack is not known: {what}")),
        );
        u64::from(depth.bytes)
    };
    let program = depth("main");
    let mut priorities: BTreeMap<u32, u64> = BTreeMap::new();
    let handlers = app.tasks.iter().map(|task| {
        let handler = app.interrupt(task).unwrap_or(&task.name);
        (handler, task.priority)
    });
    // The timer of the software tasks, which no source declares as a task.
    let timer = app.timer.as_ref();
    let timer = timer.map(|timer| (timer.interrupt.as_str(), timer.priority));
    for (handler, priority) in handlers.chain(timer) {
        let bytes = depth(handler) + u64::from(FRAME_FPU);
        let level = priorities.entry(priority).or_default();
        *level = bytes.max(*level);
    }
    if unknown.is_empty() {
        Ok(program + priorities.values().sum::<u64>())
    } else {
        unknown.sort();
        unknown.dedup();
        Err(unknown)
    }
}
