//! From sources, images and tables to answers.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use network_model::{Network, SendType, WindowKind, worst_case_bits};

use crate::can;
use crate::response::{self, CriticalSection};
use crate::stack::{FRAME, FRAME_FPU, Stacks};
use crate::table::{BusEvent, Chain, NodeTable, Part, Table};
use crate::tasks::App;
use crate::wcet::analysis::{Analysis, Bound, Entry, Problem};
use crate::wcet::annotation::Annotations;
use crate::wcet::image::Image;
use crate::wcet::timing::Timing;

/// Picoseconds.
pub type Picoseconds = u64;
/// Picoseconds in a microsecond.
pub const MICROSECOND: Picoseconds = 1_000_000;

/// What to analyse.
#[derive(Debug, Clone)]
pub struct Inputs {
    /// Folder that relative source paths of the images start from.
    pub root: PathBuf,
    /// The task table.
    pub table: PathBuf,
    /// The network file.
    pub network: PathBuf,
    /// Source and image of each node, by its name in the table.
    pub nodes: BTreeMap<String, (PathBuf, PathBuf)>,
    /// Longest times seen, in core cycles: node, then interrupt.
    pub observed: BTreeMap<String, BTreeMap<String, u64>>,
}

/// The inputs are wrong: one sentence.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct InputError(pub String);

/// The answer for one task.
#[derive(Debug, Clone)]
pub struct TaskReport {
    /// Its name.
    pub name: String,
    /// Interrupt that runs it.
    pub interrupt: String,
    /// Its priority.
    pub priority: u32,
    /// Bound in cycles: zero wait states, then as flashed.
    pub cycles: [u64; 2],
    /// Longest time seen in cycles at zero wait states.
    pub observed: Option<u64>,
    /// Bound as flashed.
    pub cost: Picoseconds,
    /// Minimum time between releases.
    pub period: Picoseconds,
    /// Deadline.
    pub deadline: Picoseconds,
    /// Blocking.
    pub blocking: Picoseconds,
    /// Worst response, if there is one.
    pub response: Option<Picoseconds>,
    /// How much longer one job may take before something misses.
    pub slack: Option<Picoseconds>,
    /// Why the bound is none.
    pub problems: BTreeSet<Problem>,
    /// Panics not proven impossible.
    pub panics: Vec<String>,
    /// Loop bounds taken from annotations.
    pub annotated: BTreeMap<String, u64>,
    /// Worst path by source line: cycles as flashed, times executed, place.
    pub path: Vec<(u64, u64, String)>,
    /// Bound of the integer program, cycles as above.
    pub program: Option<[u64; 2]>,
}

impl TaskReport {
    /// Whether its deadline holds.
    #[must_use]
    pub fn meets(&self) -> bool {
        self.problems.is_empty() && self.response.is_some_and(|r| r <= self.deadline)
    }
}

/// The answer for one node.
#[derive(Debug, Clone)]
pub struct NodeReport {
    /// Its name.
    pub name: String,
    /// Tasks, most urgent first.
    pub tasks: Vec<TaskReport>,
    /// Deepest stack with all preemptions, in bytes.
    pub stack: u32,
    /// Bytes set aside.
    pub stack_size: u32,
    /// What the stack figure does not hold.
    pub stack_unknown: BTreeSet<String>,
    /// Share of the processor that is asked for, in thousandths.
    pub utilisation_permille: u64,
    /// Where the start-up and idle code could not be followed.
    pub idle_problems: BTreeSet<Problem>,
}

/// The answer for one message.
#[derive(Debug, Clone)]
pub struct MessageReport {
    /// Its name.
    pub name: String,
    /// Its identifier.
    pub id: u16,
    /// Longest frame on the wire with what the window must also hold.
    pub need: Picoseconds,
    /// The window, or the deadline of an event.
    pub room: Picoseconds,
    /// Start of its window in the basic cycle.
    pub start: Picoseconds,
    /// Whether it shares its window.
    pub arbitrating: bool,
}

impl MessageReport {
    /// Whether it fits.
    #[must_use]
    pub fn meets(&self) -> bool {
        self.need <= self.room
    }
}

/// The answer for one chain.
#[derive(Debug, Clone)]
pub struct ChainReport {
    /// Its name.
    pub name: String,
    /// Steps with the longest time at the end of each.
    pub steps: Vec<(String, Picoseconds)>,
    /// Longest time from end to end; `None` if a step has no bound.
    pub latency: Option<Picoseconds>,
    /// Deadline.
    pub deadline: Picoseconds,
}

impl ChainReport {
    /// Whether its deadline holds.
    #[must_use]
    pub fn meets(&self) -> bool {
        self.latency.is_some_and(|latency| latency <= self.deadline)
    }
}

/// All answers.
#[derive(Debug, Clone)]
pub struct Report {
    /// By node.
    pub nodes: Vec<NodeReport>,
    /// By message, in order of the cycle.
    pub messages: Vec<MessageReport>,
    /// By chain.
    pub chains: Vec<ChainReport>,
    /// Length of the basic cycle.
    pub basic_cycle: Picoseconds,
}

impl Report {
    /// Whether everything holds.
    #[must_use]
    pub fn schedulable(&self) -> bool {
        self.first_miss().is_none()
    }

    /// The first thing that does not hold, in one sentence.
    #[must_use]
    pub fn first_miss(&self) -> Option<String> {
        for node in &self.nodes {
            for task in &node.tasks {
                if let Some(problem) = task.problems.first() {
                    return Some(format!("{}.{}: {problem}", node.name, task.name));
                }
                match task.response {
                    None => {
                        return Some(format!(
                            "{}.{} has no worst response time: the processor is asked for {} per mille at its priority and above",
                            node.name, task.name, node.utilisation_permille
                        ));
                    }
                    Some(response) if response > task.deadline => {
                        return Some(format!(
                            "{}.{} misses its deadline of {} by {}",
                            node.name,
                            task.name,
                            time(task.deadline),
                            time(response - task.deadline)
                        ));
                    }
                    Some(_) => {}
                }
                if let Some(seen) = task.observed
                    && seen > task.cycles[0]
                {
                    return Some(format!(
                        "{}.{} took {seen} cycles, more than its bound of {}: the bound is wrong",
                        node.name, task.name, task.cycles[0]
                    ));
                }
            }
            if let Some(problem) = node.idle_problems.first() {
                return Some(format!(
                    "the start-up and idle code of {} is not followed to its end, so its critical sections are not all known: {problem}",
                    node.name
                ));
            }
            if node.stack > node.stack_size {
                return Some(format!(
                    "the stack of {} may take {} bytes of {}",
                    node.name, node.stack, node.stack_size
                ));
            }
        }
        for message in &self.messages {
            if !message.meets() {
                return Some(format!(
                    "message {} needs {} and has {}",
                    message.name,
                    time(message.need),
                    time(message.room)
                ));
            }
        }
        self.chains
            .iter()
            .find(|chain| !chain.meets())
            .map(|chain| match chain.latency {
                Some(latency) => format!(
                    "chain {} takes up to {}, its deadline is {}",
                    chain.name,
                    time(latency),
                    time(chain.deadline)
                ),
                None => format!("chain {} has a step without bound", chain.name),
            })
    }
}

/// A time for people.
#[must_use]
pub fn time(ps: Picoseconds) -> String {
    if ps >= 10_000 * MICROSECOND {
        format!("{:.2} ms", ps as f64 / 1e9)
    } else {
        format!("{:.2} us", ps as f64 / 1e6)
    }
}

fn read(path: &Path) -> Result<String, InputError> {
    std::fs::read_to_string(path)
        .map_err(|error| InputError(format!("cannot read {}: {error}", path.display())))
}

/// Analyses everything.
///
/// # Errors
/// When an input is missing or wrong; that something is not schedulable is an
/// answer, not an error.
pub fn run(inputs: &Inputs) -> Result<Report, InputError> {
    let name = |path: &Path| {
        path.strip_prefix(&inputs.root)
            .unwrap_or(path)
            .display()
            .to_string()
    };
    let table = Table::parse(&name(&inputs.table), &read(&inputs.table)?).map_err(InputError)?;
    let network = Network::parse(&read(&inputs.network)?)
        .map_err(|problems| InputError(format!("{}: {problems}", name(&inputs.network))))?;
    let annotations = Annotations::new(&inputs.root);
    let mut nodes = Vec::new();
    for (node, (source, elf)) in &inputs.nodes {
        let of_node = table
            .node
            .get(node)
            .ok_or_else(|| InputError(format!("{} has no node {node}", name(&inputs.table))))?;
        let app = App::parse(&name(source), &read(source)?)
            .map_err(|error| InputError(error.to_string()))?;
        let image = Image::read(elf).map_err(|error| InputError(error.to_string()))?;
        let observed = inputs.observed.get(node);
        nodes.push(analyse_node(
            node,
            of_node,
            &app,
            &image,
            &annotations,
            &network,
            observed,
            &name(&inputs.table),
        )?);
    }
    if let Some(misplaced) = annotations.misplaced().first() {
        return Err(InputError(misplaced.to_string()));
    }
    let messages = messages(&network, &table);
    let chains = table
        .chain
        .iter()
        .map(|c| chain(c, &nodes, &messages, &network))
        .collect::<Result<_, _>>()?;
    Ok(Report {
        nodes,
        messages,
        chains,
        basic_cycle: u64::from(network.basic_cycle_us) * MICROSECOND,
    })
}

/// Minimum time between releases by an event of the bus.
fn bus_period(network: &Network, node: &str, event: BusEvent) -> Picoseconds {
    let own = |sender: &str| sender.eq_ignore_ascii_case(node);
    // No frame is shorter than one without stuff bits: 44 bits and its data,
    // and three bits of interframe space.
    let shortest = |sent: bool| {
        network
            .messages
            .iter()
            .filter(|message| own(&message.sender) == sent)
            .map(|message| 47 + 8 * u64::from(message.shortest))
            .min()
            .unwrap_or(47)
            * u64::from(network.bit_time_ns())
            * 1000
    };
    match event {
        BusEvent::FrameReceived => shortest(false),
        BusEvent::FrameSent => shortest(true),
        BusEvent::BasicCycle => u64::from(network.basic_cycle_us) * MICROSECOND,
        BusEvent::WindowEdge => {
            let windows = network.windows();
            let mut edges: BTreeSet<u32> = windows
                .iter()
                .flat_map(|window| [window.start_us, window.end_us()])
                .collect();
            edges.insert(network.basic_cycle_us);
            let edges: Vec<u32> = edges.into_iter().collect();
            let least = edges.windows(2).map(|pair| pair[1] - pair[0]).min();
            u64::from(least.unwrap_or(network.basic_cycle_us)) * MICROSECOND
        }
    }
}

#[allow(clippy::too_many_arguments)]
fn analyse_node(
    name: &str,
    table: &NodeTable,
    app: &App,
    image: &Image,
    annotations: &Annotations,
    network: &Network,
    observed: Option<&BTreeMap<String, u64>>,
    table_name: &str,
) -> Result<NodeReport, InputError> {
    let part = match table.part {
        Part::F446 => Timing::f446(),
        Part::F303 => Timing::f303(),
    };
    let picoseconds = |cycles: u64| {
        (u128::from(cycles) * 1_000_000_000_000).div_ceil(u128::from(table.core_hz)) as u64
    };
    let mut analysis = Analysis::new(image, annotations, part);
    let mut stacks = Stacks::new(image);
    let exceptions = part.exceptions();

    // Tasks of the source, and the timer of the software tasks.
    let mut wanted: Vec<(String, String, u32)> = Vec::new();
    for task in &app.tasks {
        let interrupt = app.interrupt(task).unwrap_or(&task.name).to_owned();
        wanted.push((task.name.clone(), interrupt, task.priority));
    }
    for timer in table.task.keys().filter(|task| *task == "SysTick") {
        wanted.push((timer.clone(), timer.clone(), app.timer_priority()));
    }
    if let Some(extra) = table
        .task
        .keys()
        .find(|task| !wanted.iter().any(|(name, ..)| name == *task))
    {
        return Err(InputError(format!(
            "{table_name}: {name} has no task {extra}"
        )));
    }

    let mut bounds: BTreeMap<String, Bound> = BTreeMap::new();
    let mut sections = Vec::new();
    let mut by_priority: BTreeMap<u32, (u32, bool)> = BTreeMap::new();
    let mut stack_unknown = BTreeSet::new();
    for (_, interrupt, priority) in &wanted {
        if bounds.contains_key(interrupt) {
            continue;
        }
        let entry = image.symbol(interrupt).ok_or_else(|| {
            InputError(format!(
                "the image of {name} has no handler {interrupt}: is it built from this source?"
            ))
        })?;
        let bound = analysis.run(entry, Entry::Handler);
        add_sections(&bound, *priority, &picoseconds, &mut sections);
        let depth = stacks.depth(entry);
        stack_unknown.extend(depth.unknown);
        let level = by_priority.entry(*priority).or_default();
        level.0 = level.0.max(depth.bytes).max(bound.stack);
        level.1 |= bound.uses_fpu;
        bounds.insert(interrupt.clone(), bound);
    }
    let mut idle_problems = BTreeSet::new();
    let mut stack = 0;
    let mut main_uses_fpu = false;
    if let Some(main) = image.symbol("main") {
        let bound = analysis.run(main, Entry::Program);
        add_sections(&bound, 0, &picoseconds, &mut sections);
        let depth = stacks.depth(main);
        stack_unknown.extend(depth.unknown);
        stack = depth.bytes.max(bound.stack);
        main_uses_fpu = bound.uses_fpu;
        idle_problems = bound
            .problems
            .into_iter()
            // Start-up waits for hardware; only what hides a critical
            // section of idle matters here.
            .filter(|problem| !matches!(problem, Problem::LoopWithoutBound(_)))
            .collect();
    }
    // Every priority may preempt every lower one once. A frame holds the
    // floating-point registers if anything below uses them.
    let any_fpu = main_uses_fpu || by_priority.values().any(|(_, fpu)| *fpu);
    for (bytes, _) in by_priority.values() {
        stack += bytes + if any_fpu { FRAME_FPU } else { FRAME };
    }

    let mut set = Vec::new();
    let mut of_set = Vec::new();
    for (task, interrupt, priority) in &wanted {
        let entry = table.task.get(task).ok_or_else(|| {
            InputError(format!(
                "{table_name}: task {task} of {name} has no inter-arrival time and deadline"
            ))
        })?;
        let period = match (entry.every_us, entry.on) {
            (Some(every), _) => every * MICROSECOND,
            (None, Some(event)) => bus_period(network, name, event),
            (None, None) => 0,
        };
        let bound = &bounds[interrupt];
        let preemption = exceptions.restart
            + if bound.uses_fpu {
                exceptions.lazy_stacking
            } else {
                0
            };
        let model = response::Task {
            name: task.clone(),
            priority: *priority,
            cost: picoseconds(bound.cycles[1]),
            period,
            deadline: entry.deadline_us * MICROSECOND,
            jitter: entry.jitter_us * MICROSECOND,
            blocking: response::blocking(&sections, *priority),
            preemption: picoseconds(preemption),
        };
        // Software tasks of one priority share a dispatcher: its bound holds
        // all of them, so it interferes once, at the highest rate.
        set.push(model);
        of_set.push(interrupt.clone());
    }
    let mut merged: Vec<response::Task> = Vec::new();
    let mut merged_of: Vec<String> = Vec::new();
    for (model, interrupt) in set.iter().zip(&of_set) {
        match merged_of.iter().position(|other| other == interrupt) {
            Some(at) => {
                merged[at].period = merged[at].period.min(model.period);
                merged[at].deadline = merged[at].deadline.min(model.deadline);
                merged[at].jitter = merged[at].jitter.max(model.jitter);
            }
            None => {
                merged.push(model.clone());
                merged_of.push(interrupt.clone());
            }
        }
    }
    let mut tasks = Vec::new();
    for (model, interrupt) in set.iter().zip(&of_set) {
        let at = merged_of
            .iter()
            .position(|other| other == interrupt)
            .unwrap_or(0);
        let bound = &bounds[interrupt];
        let program =
            crate::wcet::ipet::solve(&mut analysis, bound, image.symbol(interrupt).unwrap_or(0));
        let overhead =
            [Timing::zero_wait().exceptions(), part.exceptions()].map(|e| e.entry + e.exit);
        tasks.push(TaskReport {
            name: model.name.clone(),
            interrupt: interrupt.clone(),
            priority: model.priority,
            cycles: bound.cycles,
            observed: observed.and_then(|seen| seen.get(interrupt)).copied(),
            cost: model.cost,
            period: model.period,
            deadline: model.deadline,
            blocking: model.blocking,
            response: response::response(&merged, at).ok().map(|r| r.worst),
            slack: response::slack(&merged, at),
            problems: bound.problems.clone(),
            panics: bound
                .panics
                .iter()
                .map(|site| format!("{} -> {}", image.describe(site.at), site.callee))
                .collect(),
            annotated: bound.annotated.clone(),
            path: program.as_ref().map(|p| p.path.clone()).unwrap_or_default(),
            program: program.map(|p| [p.cycles[0] + overhead[0], p.cycles[1] + overhead[1]]),
        });
    }
    tasks.sort_by_key(|task| std::cmp::Reverse(task.priority));
    Ok(NodeReport {
        name: name.to_owned(),
        tasks,
        stack,
        stack_size: table.stack,
        stack_unknown,
        utilisation_permille: response::utilisation_permille(&merged),
        idle_problems,
    })
}

/// Priority bits of both parts.
const PRIORITIES: u32 = 16;

fn add_sections(
    bound: &Bound,
    holder: u32,
    picoseconds: &impl Fn(u64) -> u64,
    sections: &mut Vec<CriticalSection>,
) {
    for section in &bound.sections {
        let ceiling = match section.level {
            0 => u32::MAX,
            level => PRIORITIES - u32::from(level >> 4),
        };
        sections.push(CriticalSection {
            holder,
            ceiling,
            length: picoseconds(section.cycles[1]),
        });
    }
}

fn messages(network: &Network, table: &Table) -> Vec<MessageReport> {
    let bit = u64::from(network.bit_time_ns());
    let errors = can::ErrorRate {
        burst: table.bus.error_burst,
        interval: table.bus.error_interval_ms * 1_000_000,
    };
    let mut events: Vec<&network_model::Message> = network
        .messages
        .iter()
        .filter(|m| m.window.kind == WindowKind::Arbitrating)
        .collect();
    events.sort_by_key(|m| m.id);
    let streams: Vec<can::Message> = events
        .iter()
        .map(|m| {
            let interval = match m.send_type {
                SendType::Event { interval_ms } => interval_ms,
                SendType::Cyclic { period_ms } => period_ms,
            };
            can::Message {
                name: m.name.clone(),
                length: u64::from(worst_case_bits(m.length)) * bit,
                period: u64::from(interval.max(1)) * 1_000_000,
                deadline: u64::from(m.window.length_us) * 1000,
                jitter: 0,
            }
        })
        .collect();
    let mut reports: Vec<MessageReport> = network
        .messages
        .iter()
        .map(|m| {
            let frame = u64::from(worst_case_bits(m.length)) * bit * 1000;
            let arbitrating = m.window.kind == WindowKind::Arbitrating;
            let need = if arbitrating {
                let at = events.iter().position(|e| e.id == m.id).unwrap_or(0);
                can::response(&streams, at, bit, errors).map_or(u64::MAX, |ns| ns * 1000)
            } else {
                // It may begin late by the transmit enable window, and its
                // sender's clock and the others' may differ.
                frame
                    + u64::from(network.transmit_enable_bits) * bit * 1000
                    + u64::from(network.sync_uncertainty_us) * MICROSECOND
            };
            MessageReport {
                name: m.name.clone(),
                id: m.id,
                need,
                room: u64::from(m.window.length_us) * MICROSECOND,
                start: u64::from(m.window.start_us) * MICROSECOND,
                arbitrating,
            }
        })
        .collect();
    reports.sort_by_key(|m| (m.start, m.id));
    reports
}

fn chain(
    chain: &Chain,
    nodes: &[NodeReport],
    messages: &[MessageReport],
    network: &Network,
) -> Result<ChainReport, InputError> {
    let cycle = u64::from(network.basic_cycle_us) * MICROSECOND;
    let mut total: Option<Picoseconds> = Some(0);
    // Where in the basic cycle the last step ends at the latest, once a
    // window or a release by the cycle has fixed it.
    let mut phase: Option<Picoseconds> = None;
    let mut steps = Vec::new();
    for step in &chain.steps {
        let mut add = step.wait_us * MICROSECOND;
        phase = phase.map(|p| p + add);
        let label;
        if let Some(task) = &step.task {
            let (node, name) = task.split_once('.').unwrap_or((task, ""));
            let found = nodes
                .iter()
                .find(|n| n.name == node)
                .map(|n| n.tasks.iter().find(|t| t.name == name));
            let found = match found {
                // The node is not analysed this time.
                None => {
                    total = None;
                    continue;
                }
                Some(found) => found.ok_or_else(|| {
                    InputError(format!("chain `{}`: there is no task {task}", chain.name))
                })?,
            };
            if let Some(at) = step.at_us {
                let at = at * MICROSECOND;
                add += match phase {
                    Some(p) => wait(p, at, cycle),
                    None => cycle,
                };
                phase = Some(at);
            }
            match found.response.filter(|_| found.problems.is_empty()) {
                Some(response) => {
                    add += response;
                    phase = phase.map(|p| p + response);
                }
                None => total = None,
            }
            label = task.clone();
        } else {
            let name = step.message.as_deref().unwrap_or_default();
            let message = messages.iter().find(|m| m.name == name).ok_or_else(|| {
                InputError(format!(
                    "chain `{}`: there is no message {name}",
                    chain.name
                ))
            })?;
            add += match phase {
                Some(p) if !message.arbitrating => wait(p, message.start, cycle),
                // Just too late for this cycle's window.
                _ => cycle,
            } + message.need;
            phase = Some(message.start + message.need);
            label = name.to_owned();
        }
        total = total.map(|t| t + add);
        steps.push((label, total.unwrap_or(0)));
    }
    Ok(ChainReport {
        name: chain.name.clone(),
        steps,
        latency: total,
        deadline: chain.deadline_us * MICROSECOND,
    })
}

/// From `phase` to the next `at` of the cycle.
fn wait(phase: Picoseconds, at: Picoseconds, cycle: Picoseconds) -> Picoseconds {
    (at + cycle - phase % cycle) % cycle
}
