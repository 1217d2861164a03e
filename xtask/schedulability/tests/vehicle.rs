//! The vehicle's sources, task table and network file with given execution times: a report without a
//! miss, and each kind of miss.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use network_model::{Network, worst_case_bits};
use parts::Sled;
use schedulability::arbitrating::Reaction;
use schedulability::arrivals::{Job, Kind};
use schedulability::bus::Reactions;
use schedulability::can::ErrorRate;
use schedulability::execution::{Execution, Handler, Section};
use schedulability::model::NodeModel;
use schedulability::models::{Files, Models, Supplements};
use schedulability::node::{Observed, Seen, schedule};
use schedulability::priorities;
use schedulability::releases::Bus;
use schedulability::results::{NodeReport, Report, TaskReport, Tolerance};
use schedulability::table::{NodeTable, Table};
use schedulability::tasks::App;
use schedulability::units::time;
use schedulability::{bus, chains, report};
use vehicle_model::Vehicle;
use wcet::bound::{Problem, Problems};
use wcet::cycles::{Cycles, Model};

const NODES: [&str; 4] = ["controller", "drive", "gps", "steering"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn text(file: &str) -> String {
    std::fs::read_to_string(root().join(file)).unwrap()
}

fn source(node: &str) -> String {
    text(&format!("firmware/vehicles/uagv/nodes/{node}.rs"))
}

fn table() -> Table {
    let table = Table::parse("tasks.toml", &text("firmware/vehicles/uagv/tasks.toml")).unwrap();
    resolved(table)
}

fn resolved(table: Table) -> Table {
    let period = uagv().receiver_period_us();
    table.resolve("tasks.toml", &network(), period).unwrap()
}

fn uagv() -> Vehicle {
    Vehicle::read(&root().join("firmware/vehicles/uagv")).unwrap()
}

/// The board of a node, as the manifest says.
fn board(node: &str) -> &'static Sled {
    let vehicle = uagv();
    vehicle.board(vehicle.find_node(node).unwrap())
}

fn network() -> Network {
    Network::parse(&text("firmware/vehicles/uagv/network.dbc")).unwrap()
}

/// The model of `node` from this source, with disturbed frames as the task table says.
fn model(node: &str, source: &str) -> Result<(NodeModel, NodeTable), String> {
    model_with(node, source, table().bus.errors())
}

fn model_with(
    node: &str,
    source: &str,
    errors: ErrorRate,
) -> Result<(NodeModel, NodeTable), String> {
    let app = App::parse("node.rs", source).map_err(|error| error.to_string())?;
    let table = table().node[node].on(board(node));
    NodeModel::new(node, &app, &table, (&network(), errors), "tasks.toml")
        .map(|model| (model, table))
        .map_err(|error| error.to_string())
}

/// Every job takes `us` microseconds; one that sends a byte to the display, which has the priority
/// of the bus, takes a fifth of that.
fn execution(model: &NodeModel, table: &NodeTable, us: u64) -> Execution {
    let handlers = model.tasks.iter().map(|task| {
        let tenths = if task.name == "display_rx" { 2 } else { 10 };
        let cycles = tenths * us * table.core_hz() / 10_000_000;
        let handler = Handler {
            cycles: Cycles::both(cycles),
            overhead: cycles_of(22, 24),
            ..Handler::default()
        };
        (task.interrupt.clone(), handler)
    });
    Execution {
        handlers: handlers.collect(),
        sections: vec![section("EXTI3", 6, 5, table)],
        stack: 1000,
        ..Execution::default()
    }
}

fn section(holder: &str, ceiling: u32, us: u64, table: &NodeTable) -> Section {
    Section {
        open: Vec::new(),
        holder: holder.to_owned(),
        priority: 1,
        ceiling,
        cycles: us * table.core_hz() / 1_000_000,
        place: "link.rs:7".to_owned(),
    }
}

/// The answers for one node after `change`.
fn node(node: &str, change: impl FnOnce(&mut Execution, &NodeTable)) -> NodeReport {
    let (model, table) = model(node, &source(node)).unwrap();
    let mut execution = execution(&model, &table, 10);
    change(&mut execution, &table);
    schedule(&model, &table, &execution, None)
}

fn task<'a>(node: &'a NodeReport, name: &str) -> &'a TaskReport {
    node.tasks.iter().find(|task| task.name == name).unwrap()
}

fn cycles_of(zero_wait: u64, flashed: u64) -> Cycles {
    Cycles { zero_wait, flashed }
}

fn seen(longest: Cycles) -> Seen {
    Seen {
        longest,
        ..Seen::default()
    }
}

fn interrupt(node: &NodeReport, name: &str) -> String {
    task(node, name).interrupt.clone()
}

/// The answers for the vehicle as it is. They take seconds, so they are found once.
fn vehicle() -> Report {
    static REPORT: LazyLock<Report> = LazyLock::new(analysed);
    REPORT.clone()
}

fn analysed() -> Report {
    let nodes: Vec<NodeReport> = NODES.iter().map(|name| node(name, |_, _| {})).collect();
    let table = table();
    let messages = bus::messages(
        &network(),
        table.bus.errors(),
        &table.supervised,
        &Reactions::new(),
    );
    let errors = chains::Errors {
        rate: table.bus.errors(),
        late: Bus::new(&network(), "", 0)
            .with_errors(table.bus.errors())
            .reference_delay(),
    };
    let chains = table
        .chain
        .iter()
        .filter_map(|chain| chains::follow(chain, &nodes, &messages, 100_000_000_000, errors));
    Report {
        chains: chains.collect(),
        nodes,
        messages,
        left_out: Vec::new(),
        kernels: Vec::new(),
        basic_cycle: 100_000_000_000,
        assumptions: vec!["Nobody presses <all> buttons at once.".to_owned()],
        errors: table.bus.errors(),
    }
}

/// A message of a shared window waits for others there, whose nodes may be slow.
#[test]
fn what_depends_on_a_node_that_is_not_analysed_is_left_out() {
    let network = network();
    assert!(bus::waiting_for(&network, &[]).is_empty());
    let waiting = bus::waiting_for(&network, &["controller"]);
    let shared = |message: &&network_model::Message| {
        message.window.kind == network_model::WindowKind::Arbitrating
    };
    let shared: Vec<_> = network.messages.iter().filter(shared).collect();
    assert!(waiting.len() > 1, "{waiting:?}");
    assert!(
        waiting
            .iter()
            .all(|id| shared.iter().any(|one| one.id == *id))
    );
    let own = shared.iter().filter(|one| one.sender == "controller");
    assert!(own.clone().count() > 0);
    assert!(own.clone().all(|one| waiting.contains(&one.id)));
    let mut report = vehicle();
    let text = report::table(&report);
    assert!(!text.contains("left out"), "{text}");
    report.left_out = vec!["StateReport".into(), "ErrorReport".into()];
    for text in [report::table(&report), report::html(&report)] {
        assert!(
            text.contains("left out: StateReport, ErrorReport;"),
            "{text}"
        );
    }
}

#[test]
fn the_table_fits_the_sources() {
    let root = root();
    let sources: Vec<(&str, PathBuf)> = NODES
        .iter()
        .map(|node| {
            (
                *node,
                root.join(format!("firmware/vehicles/uagv/nodes/{node}.rs")),
            )
        })
        .collect();
    let models = Models::read(
        &Files {
            root: &root,
            table: &root.join("firmware/vehicles/uagv/tasks.toml"),
            network: &root.join("firmware/vehicles/uagv/network.dbc"),
            supplements: &Supplements::default(),
        },
        uagv().receiver_period_us(),
        false,
        &[],
        None,
        sources
            .iter()
            .map(|(node, path)| (*node, board(node), path.as_path())),
    )
    .unwrap();
    assert_eq!(models.nodes.len(), 4);
    assert_eq!(models.errors, models.table.bus.errors());
    for (node, table) in &models.nodes {
        assert_eq!(node.tasks.len(), table.task.len(), "{}", node.name);
    }
}

#[test]
fn the_jobs_of_a_kind_receive_the_messages_of_the_other_nodes() {
    let (gps, _) = model_with("gps", &source("gps"), ErrorRate::NONE).unwrap();
    let of = |name: &str| {
        &gps.tasks
            .iter()
            .find(|task| task.name == name)
            .unwrap()
            .received
    };
    assert_eq!(of("can_rx")[&Kind::Reference], [101]);
    let exclusive = &of("can_rx")[&Kind::Exclusive];
    assert!(
        exclusive.contains(&300) && !exclusive.contains(&200),
        "{exclusive:?}"
    );
    let arbitrating = &of("can_rx")[&Kind::Arbitrating];
    assert!(
        arbitrating.contains(&512) && !arbitrating.contains(&511),
        "{arbitrating:?}"
    );
    // Its jobs are released by other events, too.
    assert!(of("window_timer").is_empty());
}

#[test]
fn releases_come_from_the_network_file() {
    let (steering, _) = model_with("steering", &source("steering"), ErrorRate::NONE).unwrap();
    let find = |name: &str| {
        steering
            .tasks
            .iter()
            .find(|task| task.name == name)
            .unwrap()
    };
    // One reference, twelve windows without its own, and six events of other nodes.
    let jobs = |task: &str, kind: Kind| -> Vec<Job> {
        let tables = find(task).arrivals.timed.iter();
        let of_kind = tables.filter(|table| table.kind == kind);
        of_kind.flat_map(|table| table.jobs.clone()).collect()
    };
    let references = jobs("can_rx", Kind::Reference);
    let single = jobs("can_rx", Kind::Exclusive);
    let events = jobs("can_rx", Kind::Arbitrating);
    assert_eq!((references.len(), single.len(), events.len()), (1, 11, 6));
    // The three-deep FIFO holds events of two bytes or more.
    assert!(events.iter().all(|job| job.deadline.is_some()));
    let command = single.iter().find(|job| job.label == "Command").unwrap();
    // Window at 7 ms; 43 bits and eight bytes less 20 us at the earliest; 64 us
    // of transmit enable, 135 bits and 20 us at the latest.
    assert_eq!(
        command.earliest,
        7_000_000_000 + (43 + 64) * 4_000_000 - 20_000_000
    );
    assert_eq!(
        command.latest,
        7_000_000_000 + 64_000_000 + 135 * 4_000_000 + 20_000_000
    );
    // The deadline in its own window is the transmit enable window plus the lead, less a bit.
    let edges = jobs("window_timer", Kind::Exclusive);
    let own: Vec<_> = edges.iter().filter(|job| job.transmits).collect();
    assert_eq!(own.len(), 1);
    assert_eq!(
        (own[0].label.as_str(), own[0].earliest),
        ("SteeringPot", 5_991_000_000)
    );
    assert_eq!(own[0].deadline, Some((64 + 9 - 4) * 1_000_000));
    // The deadline at another edge is the earliest end of the frame in the window that begins there.
    let heading = edges.iter().find(|job| job.earliest == 4_991_000_000);
    let first = 43 + 8 * 4;
    assert_eq!(
        heading.unwrap().deadline,
        Some((first * 4 - 20) * 1_000_000)
    );
    // Event messages: its own, lost against six others, withdrawn, enqueued.
    let events = jobs("window_timer", Kind::Arbitrating);
    let count = |what: &str| {
        events
            .iter()
            .filter(|job| job.label.starts_with(what))
            .count()
    };
    assert_eq!(
        [
            "sent",
            "lost against",
            "last instant",
            "SteeringStatus is",
            "arbitrating"
        ]
        .map(count),
        [1, 6, 2, 1, 1]
    );
    // 1000 us less 64, 540, 20 and the lead of 9.
    assert_eq!(time(find("can_rx").deadline), "367.00 us");
}

/// The jobs of a task of the UAGV by their kind, with disturbed frames.
fn jobs_with(errors: &str, node: &str, task: &str, kind: Kind) -> Vec<Job> {
    let (model, _) = model_with(node, &source(node), errors.parse().unwrap()).unwrap();
    let found = model.tasks.iter().find(|of_node| of_node.name == task);
    let tables = found.unwrap().arrivals.timed.clone().into_iter();
    let of_kind = tables.filter(|table| table.kind == kind);
    of_kind.flat_map(|table| table.jobs).collect()
}

#[test]
fn a_disturbed_reference_releases_what_repeats_it() {
    let us = 1_000_000;
    // 31 bits, 138 of the reference, and four transmit enable windows until it is requested again.
    let rate = "1/100ms".parse().unwrap();
    let network = network();
    let bus = Bus::new(&network, "gps", 5 * us).with_errors(rate);
    let late = (124 + 552 + 256) * us;
    assert_eq!(bus.reference_delay(), late);
    let count = |errors: &str, node: &str, task: &str, kind: Kind| {
        let jobs = jobs_with(errors, node, task, kind);
        let known = jobs_with("none", node, task, kind).len();
        jobs.len() - known
    };
    // Either time master: the end and the request of the reference that is repeated, and those of the other
    // master if it lost arbitration against that one and misses it.
    for node in ["gps", "controller"] {
        assert_eq!(count("1/100ms", node, "can_tx", Kind::Reference), 2);
        assert_eq!(count("1/100ms", node, "window_timer", Kind::Reference), 2);
        // It withdraws both, and notes that one is missing.
        assert_eq!(count("1/100ms", node, "window_timer", Kind::Exclusive), 3);
    }
    // The others may take a reference that is repeated, open the first window by it, or miss it.
    assert_eq!(count("1/100ms", "drive", "can_rx", Kind::Reference), 1);
    assert_eq!(
        count("1/100ms", "drive", "window_timer", Kind::Exclusive),
        2
    );
    assert_eq!(count("2/100ms", "drive", "can_rx", Kind::Reference), 2);
    // All of it comes between the first reference and the time in which the one that arrives is handled.
    let cycle = 100_000 * us;
    let handled = (552 + 40 + 256) * us;
    let of_timer = jobs_with("1/100ms", "drive", "window_timer", Kind::Exclusive);
    let again: Vec<&Job> = of_timer
        .iter()
        .filter(|job| job.earliest > cycle / 10 * 9)
        .collect();
    assert_eq!(again.len(), 2);
    for job in again {
        assert!(
            job.earliest >= cycle - late && job.latest == cycle + handled,
            "{job:?}"
        );
    }
}

#[test]
fn a_disturbed_frame_ends_attempts_and_may_come_twice() {
    let us = 1_000_000;
    let rates = ["none", "1/100ms"];
    let [clean, disturbed] =
        rates.map(|rate| jobs_with(rate, "steering", "can_rx", Kind::Exclusive));
    assert_eq!(clean, disturbed);
    // The own frame ends as early as in its first bit, and as late as an error frame behind it.
    let [clean, disturbed] =
        rates.map(|rate| jobs_with(rate, "steering", "can_tx", Kind::Exclusive));
    let (clean, disturbed) = (&clean[0], &disturbed[0]);
    assert_eq!(disturbed.earliest, (6000 + 4 - 20) * us);
    assert_eq!(disturbed.latest, clean.latest + 20 * 4 * us);
    // In the arbitrating window, one more attempt ends, the timer requests one more frame, and one more frame
    // is received.
    for task in ["can_tx", "window_timer", "can_rx"] {
        let [clean, disturbed] =
            rates.map(|rate| jobs_with(rate, "steering", task, Kind::Arbitrating));
        assert_eq!(disturbed.len(), clean.len() + 1, "{task}");
    }
}

#[test]
fn each_of_two_adjacent_arbitrating_windows_has_its_own_jobs() {
    let one = text("firmware/vehicles/uagv/network.dbc");
    let moved = one.replace(
        "BA_ \"WindowStart\" BO_ 502 12000;",
        "BA_ \"WindowStart\" BO_ 502 18000;",
    );
    assert_ne!(one, moved);
    let network = Network::parse(&moved).unwrap();
    let bus = Bus::new(&network, "controller", 0);
    let edges: Vec<Job> = bus
        .window_edges()
        .into_iter()
        .flat_map(|t| t.jobs)
        .collect();
    let opening = |us: u64| {
        let mut at = edges.iter().filter(|job| job.earliest == us * 1_000_000);
        at.find_map(|job| job.id).unwrap()
    };
    let (first, second) = (opening(12_000), opening(18_000));
    assert_ne!(first, second);
    // An attempt in the first window may end behind the first edge of the second one.
    let attempts = bus.attempts().unwrap().jobs;
    let late = attempts
        .iter()
        .find(|job| job.cause == Some(first))
        .unwrap();
    assert!(late.latest > 18_000 * 1_000_000);
    assert!(attempts.iter().any(|job| job.cause == Some(second)));
    // The timer withdraws an attempt in each of them.
    let causes = |jobs: &[Job]| -> Vec<_> { jobs.iter().map(|job| job.cause).collect() };
    let withdrawn = bus.withdrawn().unwrap();
    assert_eq!(causes(&withdrawn.jobs), [Some(first), Some(second)]);
    let timer = edges
        .iter()
        .filter(|job| job.label.starts_with("last instant"));
    assert_eq!(timer.count(), 2);
}

/// The frame of the window before ends 396 us before the events' window at the latest. A node that begins
/// so long before its window may find that frame in its FIFO as one of the three.
#[test]
fn the_enqueuing_of_an_event_waits_for_event_messages_alone() {
    let network = network();
    let deadlines = |lead: u64| {
        let bus = Bus::new(&network, "steering", lead * 1_000_000);
        let jobs = bus.events_queued().unwrap().jobs;
        let deadlines: Vec<_> = jobs.iter().filter_map(|job| job.deadline).collect();
        assert_eq!(deadlines.len(), jobs.len());
        (deadlines, bus.event_margin(), bus.fifo_margin())
    };
    let (own, events, frames) = deadlines(9);
    assert!(events > frames, "{events} {frames}");
    assert!(own.iter().all(|&deadline| deadline == events), "{own:?}");
    let (own, ..) = deadlines(400);
    assert!(own.iter().all(|&deadline| deadline == frames), "{own:?}");
}

#[test]
fn a_vehicle_of_ten_microseconds_holds() {
    let report = vehicle();
    assert_eq!(report.first_miss(), None);
    for node in &report.nodes {
        for task in &node.tasks {
            assert!(task.sensitivity.is_some(), "{}.{}", node.name, task.name);
            // The parts of each response make it up.
            assert!(task.before_release().is_some(), "{task:?}");
        }
    }
    // Only jobs that may coincide by the time table delay the node's own window.
    let timer = task(&report.nodes[3], "window_timer");
    assert_eq!(timer.job.as_deref(), Some("SteeringPot"));
    assert!(timer.response.unwrap() < 69_000_000, "{timer:?}");
    let chains = &report.chains;
    assert_eq!(chains.len(), 2);
    // It just misses a window and waits one cycle; the command follows three windows later.
    let receiver = &chains[0];
    assert!(receiver.latency.unwrap() > 100_000_000_000);
    let command = receiver
        .steps
        .iter()
        .find(|step| step.name == "Command")
        .unwrap();
    assert_eq!(time(command.phase.unwrap()), "7624.00 us");
}

#[test]
fn a_lost_frame_costs_a_chain_one_period_of_its_message() {
    let report = vehicle();
    let table = table();
    let follow = |errors: chains::Errors| {
        let chain = &table.chain[0];
        let cycle = 100_000_000_000;
        chains::follow(chain, &report.nodes, &report.messages, cycle, errors).unwrap()
    };
    let clean = follow(chains::Errors::NONE);
    assert_eq!(clean.lost, None);
    let late = 1_000_000_000;
    let rate = "1/100ms".parse().unwrap();
    let disturbed = follow(chains::Errors { rate, late });
    // It waits for the next cycle, and takes longer than 100 ms: two cycles may begin late.
    let latency = clean.latency.unwrap() + 2 * late;
    assert_eq!(disturbed.latency, Some(latency));
    // The rows add up: the last one has what the errors add.
    assert_eq!(clean.steps.last().unwrap().done, clean.latency);
    let (last, before) = disturbed.steps.split_last().unwrap();
    assert_eq!(before, clean.steps);
    assert_eq!(
        (last.name.as_str(), last.done, last.phase),
        (
            "late begin of 2 basic cycles (disturbed references)",
            Some(latency),
            clean.steps.last().unwrap().phase
        )
    );
    let mut shown = report.clone();
    shown.chains = vec![disturbed.clone()];
    assert!(report::table(&shown).contains(&format!("{}  ", last.name)));
    assert!(report::html(&shown).contains(&last.name));
    let steps = &report::json(&shown)["chains"][0]["steps"];
    assert_eq!(steps[before.len()]["done_ps"], latency);
    let lost = disturbed.lost.unwrap();
    assert_eq!(lost.messages, ["Velocity", "Command"]);
    assert_eq!(lost.latency, Some(latency + 100_000_000_000));
    assert_eq!(lost.clause(), "with a frame of Velocity or Command lost");
    // Without an own deadline for that, the chain's counts, and is missed.
    let mut strict = table.chain[0].clone();
    strict.lost_deadline_us = None;
    let errors = chains::Errors { rate, late };
    let cycle = 100_000_000_000;
    let strict = chains::follow(&strict, &report.nodes, &report.messages, cycle, errors);
    assert!(!strict.clone().unwrap().meets());
    let mut missed = report;
    missed.chains = strict.into_iter().collect();
    let miss = missed.first_miss().unwrap();
    assert!(
        miss.contains("with a frame of Velocity or Command lost, its deadline is 200.00 ms"),
        "{miss}"
    );
}

#[test]
fn a_task_ten_times_longer_misses() {
    let control = interrupt(&node("controller", |_, _| {}), "control");
    let report = node("controller", |execution, _| {
        let handler = execution.handlers.get_mut(&control).unwrap();
        handler.cycles = handler.cycles * 60;
    });
    let miss = report.first_miss().unwrap();
    assert!(
        miss.starts_with(
            "controller.control (6400 us of the cycle) misses its deadline of 595.00 us by"
        ),
        "{miss}"
    );
    assert!(miss.contains("it takes 600.00 us itself"), "{miss}");
    assert!(task(&report, "scan").sensitivity.is_none());
}

#[test]
fn a_lock_held_too_long_is_named() {
    let report = node("steering", |execution, table| {
        execution.sections.push(section("EXTI3", 6, 60, table));
    });
    let miss = report.first_miss().unwrap();
    assert!(
        miss.starts_with("steering.window_timer (SteeringPot) misses"),
        "{miss}"
    );
    assert!(
        miss.contains("is blocked 60.00 us by console at link.rs:7"),
        "{miss}"
    );
    // A ceiling below the timer's priority does not block it.
    let report = node("steering", |execution, table| {
        execution.sections.push(section("EXTI3", 5, 60, table));
    });
    assert_eq!(report.first_miss(), None);
}

#[test]
fn swapped_priorities_miss_and_are_proposed_otherwise() {
    let swapped = source("steering")
        .replace("binds = TIM2, priority = 6", "binds = TIM2, priority = 1")
        .replace("binds = EXTI3, priority = 1", "binds = EXTI3, priority = 6");
    let (model, table) = model("steering", &swapped).unwrap();
    let report = schedule(&model, &table, &execution(&model, &table, 10), None);
    let miss = task(&report, "window_timer").miss("steering").unwrap();
    assert!(
        miss.starts_with("steering.window_timer (SteeringPot) misses"),
        "{miss}"
    );
    assert!(miss.contains("waits"), "{miss}");
    let text = priorities::show([(&model, None)]);
    assert!(
        text.contains("window_timer has the shorter deadline but a lower priority than console"),
        "{text}"
    );
}

#[test]
fn a_priority_unsaid_is_refused() {
    let unsaid = source("drive").replace("binds = TIM2, priority = 6", "binds = TIM2");
    let error = model("drive", &unsaid).unwrap_err();
    assert!(
        error.ends_with("task window_timer does not say its priority: write `priority = N`"),
        "{error}"
    );
}

#[test]
fn table_and_source_must_fit() {
    let renamed = source("drive").replace("fn actuate(", "fn act(");
    assert_eq!(
        model("drive", &renamed).unwrap_err(),
        "tasks.toml: drive has no task actuate (a handler that is no task of the source needs a \
         `priority`)"
    );
    let refused = |from: &str, to: &str| {
        Table::parse(
            "tasks.toml",
            &text("firmware/vehicles/uagv/tasks.toml").replacen(from, to, 1),
        )
        .unwrap_err()
        .to_string()
    };
    let both = refused("deadline_us = 5000", "deadline_us = 5000\nby = \"window\"");
    assert!(
        both.ends_with("needs either `deadline_us` or `by`"),
        "{both}"
    );
    let none = refused("every_us = 500\n", "");
    assert!(none.contains("does not say what releases it"), "{none}");
    let word = refused("by = \"window-end\"", "by = \"noon\"");
    assert!(
        word.starts_with("tasks.toml:") && word.contains("noon"),
        "{word}"
    );
    let mut of_drive = table().node["drive"].on(board("drive"));
    let actuate = text("firmware/vehicles/uagv/tasks.toml")
        .replace("receives = \"Command\"", "receives = \"Order\"");
    let actuate = Table::parse("tasks.toml", &actuate).unwrap();
    let of_order = resolved(actuate.clone());
    of_drive.task.clone_from(&of_order.node["drive"].task);
    let app = App::parse("drive.rs", &source("drive")).unwrap();
    let error = NodeModel::new(
        "drive",
        &app,
        &of_drive,
        (&network(), ErrorRate::NONE),
        "tasks.toml",
    )
    .unwrap_err();
    assert_eq!(
        error.to_string(),
        "tasks.toml: task window_timer of drive: no other node sends a message Order"
    );
    // A table whose times are not resolved has no answer.
    of_drive.task.clone_from(&actuate.node["drive"].task);
    let error = NodeModel::new(
        "drive",
        &app,
        &of_drive,
        (&network(), ErrorRate::NONE),
        "tasks.toml",
    )
    .unwrap_err();
    assert_eq!(
        error.to_string(),
        "tasks.toml: task can_error of drive: the distance of its releases is not resolved"
    );
}

#[test]
fn releases_that_follow_from_other_files_must_be_there() {
    let text = text("firmware/vehicles/uagv/tasks.toml");
    let refused = |from: &str, to: &str, period: Option<u64>| {
        assert!(text.contains(from), "{from}");
        let table = Table::parse("tasks.toml", &text.replacen(from, to, 1));
        let table = table.and_then(|table| table.resolve("tasks.toml", &network(), period));
        table.unwrap_err().to_string()
    };
    assert_eq!(
        refused("", "", None),
        "tasks.toml: task parse of gps has a `receiver-burst`, but vehicle.toml has no \
         [receiver]"
    );
    let period = uagv().receiver_period_us();
    assert_eq!(
        refused(
            "{ receiver-burst = { jobs = 12, apart_us = 100 } }",
            "{ task = \"idle\" }",
            period
        ),
        "tasks.toml: task ring of gps has `every` with a task that is not in its node or has \
         itself such an `every`"
    );
    assert_eq!(
        refused("jobs = 12", "jobs = 0", period),
        "tasks.toml: task ring of gps has `jobs` = 0: 1 to 10000 is accepted"
    );
}

#[test]
fn a_step_of_a_chain_must_exist() {
    let text = text("firmware/vehicles/uagv/tasks.toml");
    for (from, to, told) in [
        (
            "task = \"gps.look\"",
            "task = \"gpz.look\"",
            "chain `satellite receiver to steering motor`, step 2: `task` is \"gpz.look\": \
             the nodes are controller, drive, gps, steering",
        ),
        (
            "task = \"controller.scan\"",
            "task = \"controller.skan\"",
            "chain `stop button to drive motor`, step 2: `task` is \"controller.skan\": the tasks \
             of controller are ",
        ),
        (
            "task = \"controller.scan\"",
            "task = \"scan\"",
            "chain `stop button to drive motor`, step 2: `task` is \"scan\": the form NODE.TASK \
             is accepted",
        ),
        (
            "message = \"Velocity\"",
            "message = \"Speed\"",
            "chain `satellite receiver to steering motor`, step 5: `message` is \"Speed\": the \
             messages of the network file are TimeReference, ",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        let table = Table::parse("tasks.toml", &text.replacen(from, to, 1)).unwrap();
        let period = uagv().receiver_period_us();
        let error = table.resolve("tasks.toml", &network(), period).unwrap_err();
        let error = error.to_string();
        assert!(error.starts_with(&format!("tasks.toml: {told}")), "{error}");
    }
}

#[test]
fn a_time_that_would_overflow_is_refused() {
    let text = text("firmware/vehicles/uagv/tasks.toml");
    for (from, to, place) in [
        (
            "every_us = 500\n",
            "every_us = 9000000000000000000\n",
            "task console_dma of gps has `every_us`",
        ),
        (
            "deadline_us = 10_240",
            "deadline_us = 9000000000000000000",
            "task parse of gps has `deadline_us`",
        ),
        (
            "at = \"Command\"\nevery_us",
            "at_us = 9000000000000000000\nevery_us",
            "task control of controller has `at_us`",
        ),
        (
            "wait_us = 400\n",
            "wait_us = 9000000000000000000\n",
            "chain `satellite receiver to steering motor` has `wait_us`",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        let error = Table::parse("tasks.toml", &text.replacen(from, to, 1)).unwrap_err();
        let told = error.to_string();
        let range = "= 9000000000000000000: ";
        assert!(
            told.starts_with(&format!("tasks.toml: {place} {range}")),
            "{told}"
        );
        assert!(told.ends_with("to 3600000000 is accepted"), "{told}");
    }
}

#[test]
fn a_bound_below_the_longest_time_seen_is_unsound() {
    // As a false annotation causes it.
    let (model, table) = model("gps", &source("gps")).unwrap();
    let execution = execution(&model, &table, 10);
    let seen = Observed::from([("DMA2_STREAM2".to_owned(), seen(cycles_of(1700, 1800)))]);
    let report = schedule(&model, &table, &execution, Some(&seen));
    let ring = task(&report, "ring");
    assert_eq!(
        report.first_miss().unwrap(),
        "gps.ring took 1800 cycles as flashed, more than its bound of 1776: the bound is unsound"
    );
    assert!(!ring.meets());
    assert!(
        ring.ratio(Model::ZeroWait).unwrap() > 1.0 && ring.ratio(Model::Flashed).unwrap() < 1.0
    );
}

#[test]
fn a_bound_that_a_run_contradicts_is_no_bound() {
    let (model, table) = model("gps", &source("gps")).unwrap();
    let execution = execution(&model, &table, 10);
    let mut ring = seen(Cycles::both(10));
    ring.refuted
        .insert("the loop at crc.rs:41 took 5 turns, its annotation says at most 4".to_owned());
    let seen = Observed::from([("DMA2_STREAM2".to_owned(), ring)]);
    let report = schedule(&model, &table, &execution, Some(&seen));
    assert_eq!(
        report.first_miss().unwrap(),
        "gps.ring does not behave as analysed, so it has no bound: the loop at crc.rs:41 took 5 turns, its annotation says at most 4"
    );
    assert!(!task(&report, "ring").meets());
}

#[test]
fn a_task_without_bound_leaves_lower_priorities_without_answer() {
    let report = node("gps", |execution, _| {
        let ring = execution.handlers.get_mut("DMA2_STREAM2").unwrap();
        ring.problems = Problems::from_iter([Problem::Recursion("parse".to_owned())]);
    });
    let miss = report.first_miss().unwrap();
    assert!(miss.starts_with("gps.ring has no bound: "), "{miss}");
    assert!(task(&report, "can_rx").response.is_some());
    assert_eq!(task(&report, "console").response, None);
    assert_eq!(
        task(&report, "console").miss("gps").unwrap(),
        "gps.console has no worst response time: ring may delay it and has no bound"
    );
}

#[test]
fn code_without_bound_comes_before_a_deadline_on_another_node_and_once_for_its_function() {
    let mut report = vehicle();
    let control = interrupt(&report.nodes[0], "control");
    report.nodes[0] = node("controller", |execution, _| {
        let handler = execution.handlers.get_mut(&control).unwrap();
        handler.cycles = handler.cycles * 60;
    });
    let endless = Problem::LoopWithoutBound("queue.rs:7 (queue::drain::<T, 4>)".to_owned());
    report.nodes[1] = node("drive", |execution, _| {
        for handler in ["TIM2", "EXTI1"] {
            let handler = execution.handlers.get_mut(handler).unwrap();
            handler.problems = Problems::from_iter([endless.clone()]);
        }
    });
    let miss = report.first_miss().unwrap();
    assert!(
        miss.starts_with("drive.window_timer has no bound: the loop at queue.rs:7"),
        "{miss}"
    );
    let whose = vec!["drive.window_timer".to_owned(), "drive.actuate".to_owned()];
    let problems = BTreeMap::from([(&endless, whose)]);
    assert_eq!(
        report.unbounded(),
        BTreeMap::from([("queue::drain::<T, 4>", problems)])
    );
    let text = report::table(&report);
    assert!(
        text.starts_with(
            "without a bound\n  queue::drain::<T, 4>\n    ! drive.window_timer, drive.actuate: the loop"
        ),
        "{text}"
    );
    assert!(report::html(&report).contains("Without a bound"));
    assert_eq!(
        report::json(&report)["unbounded"][0]["problems"][0]["of"][1],
        "drive.actuate"
    );
}

#[test]
fn an_unproven_node_is_accepted_unless_a_bound_is_unsound() {
    let mut report = vehicle();
    report.nodes[1] = node("drive", |execution, _| execution.stack = 5000);
    assert_eq!(report.regressions(&[]).len(), 1);
    let drive = ["drive".to_owned()];
    assert_eq!(report.regressions(&drive), [""; 0]);
    report.nodes[1].tasks[0].observed = Some(Cycles::both(1_000_000));
    let wrong = report.regressions(&drive);
    assert!(wrong[0].ends_with("the bound is unsound"), "{wrong:?}");
    let error = Table::parse("tasks.toml", "unproven = [\"rudder\"]\n[node]\n").unwrap_err();
    assert!(error.to_string().contains("rudder"), "{error}");
}

#[test]
fn a_stack_too_deep_and_a_chain_too_long_are_reported() {
    let report = node("drive", |execution, _| execution.stack = 5000);
    assert_eq!(
        report.first_miss().unwrap(),
        "the stack of drive may take 5000 bytes of 4096"
    );
    let mut report = vehicle();
    report.chains[1].deadline = 1_000_000_000;
    let miss = report.first_miss().unwrap();
    assert!(
        miss.starts_with("chain `stop button to drive motor` takes up to"),
        "{miss}"
    );
    let table = table();
    let only = [node("gps", |_, _| {})];
    let messages = bus::messages(
        &network(),
        table.bus.errors(),
        &table.supervised,
        &Reactions::new(),
    );
    // A chain through nodes that are not analysed has no answer.
    assert_eq!(
        chains::follow(&table.chain[0], &only, &messages, 1, chains::Errors::NONE),
        None
    );
}

#[test]
fn every_window_holds_its_message_and_a_short_one_does_not() {
    let network = network();
    let messages = bus::messages(
        &network,
        table().bus.errors(),
        &table().supervised,
        &Reactions::new(),
    );
    assert!(messages.iter().all(|message| message.meets()));
    let command = messages
        .iter()
        .find(|message| message.name == "Command")
        .unwrap();
    assert_eq!(time(command.need.unwrap()), "624.00 us");
    let mut tight = network;
    for message in &mut tight.messages {
        message.window.length_us = message.window.length_us.min(600);
    }
    assert!(
        bus::messages(
            &tight,
            table().bus.errors(),
            &table().supervised,
            &Reactions::new()
        )
        .iter()
        .any(|message| !message.meets())
    );
}

/// The vehicle's network, in which the command may be sent late.
fn with_a_late_command() -> Network {
    let mut network = network();
    for message in &mut network.messages {
        message.retry_late = message.name == "Command";
    }
    network.with_late_messages()
}

#[test]
fn a_late_message_competes_with_the_event_messages() {
    let need = |network: &Network, name: &str| {
        let all = bus::messages(
            network,
            ErrorRate::NONE,
            &BTreeSet::new(),
            &Reactions::new(),
        );
        let found = all.into_iter().find(|one| one.name == name).unwrap();
        found.need.unwrap()
    };
    let (before, late) = (network(), with_a_late_command());
    // 135 bits of 4 us: it is more urgent than all of them.
    let frame = 4 * u64::from(worst_case_bits(8)) * 1_000_000;
    for name in ["ModeChange", "DriveStatus", "SelfTestRequest"] {
        assert_eq!(need(&late, name), need(&before, name) + frame, "{name}");
    }
    // Itself, one less urgent frame, three bits, and twice the clocks' difference.
    let own = 4 * (2 * u64::from(worst_case_bits(8)) + 3) + 40;
    assert_eq!(need(&late, "Command (late)"), own * 1_000_000);
    assert_eq!(need(&late, "Command"), need(&before, "Command"));
}

#[test]
fn a_late_message_releases_its_receivers_and_its_sender_once_more() {
    let (before, late) = (network(), with_a_late_command());
    let jobs = |network: &Network, node: &str| {
        let table = Bus::new(network, node, 0).message("Command").unwrap();
        let ends = table.jobs.iter().map(|job| job.latest / 1_000_000);
        ends.collect::<Vec<_>>()
    };
    assert_eq!(jobs(&before, "drive").len(), 1);
    // The second one comes until the end of the arbitrating window.
    assert_eq!(jobs(&late, "drive")[1..], [18_020]);
    let attempts = |network: &Network| {
        let table = Bus::new(network, "controller", 0).attempts().unwrap();
        table.jobs.len()
    };
    assert_eq!(attempts(&late), attempts(&before) + 1);
}

#[test]
fn a_message_in_an_arbitrating_window_waits_for_the_requests_of_its_node() {
    let network = network();
    let of = |name: &str, reactions: &Reactions| {
        let all = bus::messages(&network, ErrorRate::NONE, &BTreeSet::new(), reactions);
        all.into_iter().find(|one| one.name == name).unwrap().need
    };
    let length = |name: &str| {
        let message = network.messages.iter().find(|one| one.name == name);
        u64::from(worst_case_bits(message.unwrap().length))
    };
    // Each status counts with the self-test that is sent in its place, which is as long. One less urgent
    // frame, three bits, and twice the clocks' difference.
    let urgent = [
        "ModeChange",
        "ButtonEvent",
        "GpsStatus",
        "ControllerStatus",
        "SteeringStatus",
    ];
    let urgent: u64 = urgent.iter().map(|name| length(name)).sum();
    let bits = urgent + length("DriveStatus") + length("SelfTestRequest") + 3;
    let at_once = (4 * bits + 40) * 1_000_000;
    assert_eq!(of("DriveStatus", &Reactions::new()), Some(at_once));
    assert_eq!(of("DriveSelfTest", &Reactions::new()), Some(at_once));
    // Its node requests the first frame 70 us late, and is ready again when each winner has ended.
    let reaction = |first, next| Some(Reaction { first, next });
    let slow = |reaction| Reactions::from([("DRIVE".to_owned(), reaction)]);
    let late = slow(reaction(70_000, 100_000));
    assert_eq!(of("DriveStatus", &late), Some(at_once + 70_000_000));
    // It is not: behind each of the five winners, of which the shortest have two bytes and pass 50 bits behind
    // the arbitration at the latest.
    let later = of("DriveStatus", &slow(reaction(0, 1_000_000))).unwrap();
    assert!(later > at_once + 5 * 500_000_000, "{later}");
    assert_eq!(of("DriveStatus", &slow(None)), None);
}

#[test]
fn the_report_has_each_form() {
    let report = vehicle();
    let text = report::table(&report);
    for wanted in [
        "controller: processor",
        "control ",
        "EXTI1",
        "chain satellite receiver to steering motor:",
        "shared",
        "schedulable: every deadline holds, with 1 disturbed frame in any 100 ms",
        "tolerates",
        "receivers stop after 2 in a row",
    ] {
        assert!(text.contains(wanted), "{wanted} is not in {text}");
    }
    assert!(text.lines().all(|line| line.trim_end() == line));

    assert!(!text.contains("without a bound"), "{text}");

    let json = report::json(&report);
    assert_eq!(json["schedulable"], true);
    let messages = json["messages"].as_array().unwrap();
    let tolerance = |name: &str| {
        let mut all = messages.iter();
        all.find(|one| one["name"] == name).unwrap()["tolerance"].clone()
    };
    assert_eq!(tolerance("Command")["acted_on_losses"], 2);
    assert!(tolerance("DriveStatus")["errors"].is_u64());
    assert_eq!(json["nodes"].as_array().unwrap().len(), 4);
    let tasks = json["nodes"][0]["tasks"].as_array().unwrap();
    assert!(tasks.iter().all(|task| task["sensitivity_ps"].is_u64()));

    let page = report::html(&report);
    assert!(page.contains("Nobody presses &lt;all&gt; buttons at once."));
    // The page loads nothing.
    for foreign in ["http:", "https:", "src=", "<script", "@import", "url("] {
        assert!(!page.contains(foreign), "{foreign}");
    }
    let begin = page.find("<svg").unwrap();
    let end = page.find("</svg>").unwrap() + "</svg>".len();
    let picture = roxmltree::Document::parse(&page[begin..end]).unwrap();
    let bars = picture
        .descendants()
        .filter(|node| node.has_tag_name("rect"));
    let bars: Vec<_> = bars.collect();
    assert!(bars.len() > 200, "{}", bars.len());
    for bar in bars {
        assert!(bar.attribute("width").unwrap().parse::<f64>().unwrap() > 0.0);
    }

    let of_control = report::explain(&report.nodes[0], task(&report.nodes[0], "control"));
    assert!(
        of_control.contains("controller.control (EXTI1): bound 1800 cycles"),
        "{of_control}"
    );
    assert!(of_control.contains("response "), "{of_control}");
}

#[test]
fn a_ratio_is_of_the_handler_alone() {
    let seen = Observed::from([("TIM2".to_owned(), seen(cycles_of(1000, 2000)))]);
    let (model, table) = model("steering", &source("steering")).unwrap();
    let report = schedule(&model, &table, &execution(&model, &table, 50), Some(&seen));
    let timer = task(&report, "window_timer");
    assert_eq!(timer.ratio(Model::ZeroWait), Some((3600.0 - 22.0) / 1000.0));
    assert_eq!(timer.ratio(Model::Flashed), Some((3600.0 - 24.0) / 2000.0));
}

#[test]
fn each_message_says_how_many_disturbed_frames_it_tolerates() {
    let (network, table) = (network(), table());
    let of = |errors: &str, name: &str| {
        let errors = errors.parse().unwrap();
        let all = bus::messages(&network, errors, &table.supervised, &Reactions::new());
        all.into_iter().find(|one| one.name == name).unwrap()
    };
    for name in ["ModeChange", "DriveStatus", "DriveSelfTest"] {
        let Tolerance::Repeated(Some(most)) = of("none", name).tolerance else {
            panic!("{name} is sent again");
        };
        // The figure is that of the analysis at that rate.
        let holds = |burst: u64| of(&format!("{burst}/100ms"), name).meets();
        assert!(most == 0 || holds(most), "{name} holds with {most}");
        assert!(
            !holds(most + 1),
            "{name} does not hold with more than {most}"
        );
    }
    assert_eq!(
        of("2/100ms", "Command").tolerance.to_string(),
        "lost, next in 100 ms; receivers stop after 2 in a row"
    );
    let velocity = of("2/100ms", "Velocity");
    assert_eq!(velocity.tolerance.to_string(), "lost, next in 100 ms");
    assert_eq!(velocity.need, of("none", "Velocity").need);
    assert_eq!(
        of("none", "TimeReference").tolerance.to_string(),
        "repeated, cycle later by 664.00 us each"
    );
}
