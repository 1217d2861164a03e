//! Who pends whom: what the task table may say, what it adds to the releases, and what is refused.

use std::collections::BTreeSet;
use std::path::Path;

use network_model::Network;
use parts::Sled;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use schedulability::arrivals::{Arrivals, Job, Kind, Sporadic, Timetable};
use schedulability::can::ErrorRate;
use schedulability::model::NodeModel;
use schedulability::pends::{self, Found, Pender};
use schedulability::table::{NodeTable, Table};
use schedulability::tasks::App;
use schedulability::units::MICROSECOND;

const SOURCE: &str = r"
#[rtic::app(device = part)]
mod app {
    #[task(binds = EXTI0, priority = 3)]
    fn sample(_: sample::Context) {}
    #[task(binds = EXTI1, priority = 2)]
    fn filter(_: filter::Context) {}
    #[task(binds = EXTI2, priority = 1)]
    fn report(_: report::Context) {}
}
";

/// The table of the three tasks, with these lines under each.
fn text(sample: &str, filter: &str, report: &str) -> String {
    format!(
        "[node.node.task.sample]\nevery_us = 1000\ndeadline_us = 200\n{sample}\n\
         [node.node.task.filter]\nevery_us = 5000\ndeadline_us = 2000\n{filter}\n\
         [node.node.task.report]\nevery_us = 50_000\ndeadline_us = 5000\n{report}\n"
    )
}

/// The model of the node with this table.
fn model(table: &str) -> Result<(NodeModel, NodeTable), String> {
    of_source(SOURCE, table)
}

/// The model of a node with this source and this table.
fn of_source(source: &str, table: &str) -> Result<(NodeModel, NodeTable), String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let network = root.join("firmware/vehicles/uagv/network.dbc");
    let network = Network::parse(&std::fs::read_to_string(network).unwrap()).unwrap();
    let table = Table::parse("tasks.toml", table).map_err(|error| error.to_string())?;
    let table = table.resolve("tasks.toml", &network, None);
    let table = table.map_err(|error| error.to_string())?.node["node"].on(Sled::F446);
    let app = App::parse("node.rs", source).unwrap();
    let model = NodeModel::new(
        "node",
        &app,
        &table,
        (&network, ErrorRate::NONE),
        "tasks.toml",
    );
    Ok((model.map_err(|error| error.to_string())?, table))
}

/// Releases of a task in windows of these lengths in microseconds.
fn releases<const N: usize>(model: &NodeModel, task: &str, windows: [u64; N]) -> [u64; N] {
    let mut tasks = model.tasks.iter();
    let task = tasks.find(|one| one.name == task).unwrap();
    windows.map(|window| task.arrivals.count(window * MICROSECOND, task.jitter))
}

#[test]
fn each_pend_is_a_release_until_the_deadline_of_its_job() {
    let (model, _) = model(&text("pended_by.report = \"each\"", "", "")).unwrap();
    // Two jobs of `report`, 50 ms apart, pend `sample` 45 ms apart if the first does so at its end.
    let windows = [1, 1000, 1001, 45_000, 45_001];
    assert_eq!(releases(&model, "sample", windows), [2, 2, 3, 46, 48]);
    assert_eq!(releases(&model, "report", [1, 50_001]), [1, 2]);
}

#[test]
fn pends_are_passed_on() {
    let table = text(
        "pended_by.filter = \"each\"",
        "pended_by.report = \"each\"",
        "pended_by.init = \"once\"",
    );
    let (model, _) = model(&table).unwrap();
    assert_eq!(releases(&model, "report", [0, 1, 1_000_000]), [0, 2, 21]);
    assert_eq!(releases(&model, "filter", [0, 1]), [0, 3]);
    assert_eq!(releases(&model, "sample", [0, 1]), [0, 4]);
}

#[test]
fn a_bound_of_pends_counts_instead_of_the_jobs() {
    let entry = "pended_by.report = { every_us = [100_000, 70_000], because = \"every other\" }";
    let (model, _) = self::model(&text(entry, "", "")).unwrap();
    assert_eq!(releases(&model, "sample", [1, 1001, 70_001]), [3, 4, 74]);
    // Without a distance they are among the other releases.
    let entry = "pended_by.report = { because = \"it waits for the tick\" }";
    let (model, _) = self::model(&text(entry, "", "")).unwrap();
    assert_eq!(releases(&model, "sample", [1, 1001]), [1, 2]);
}

#[test]
fn what_bounds_nothing_is_refused() {
    let loops = text(
        "pended_by.filter = \"each\"",
        "pended_by.sample = \"each\"",
        "",
    );
    let itself = text("", "", "pended_by.report = \"each\"");
    for (table, sentence) in [
        (
            text(
                "pended_by.report = { every_us = 10, because = \" \" }",
                "",
                "",
            ),
            "tasks.toml: task sample of node is pended by report, but `because` gives no reason",
        ),
        (
            text("pended_by.idle = \"each\"", "", ""),
            "tasks.toml: task sample of node is pended by idle \"each\", but \"each\" is for other tasks \
             and \"once\" for init: write { every_us = N, because = \"...\" }",
        ),
        (
            text("pended_by.report = \"once\"", "", ""),
            "tasks.toml: task sample of node is pended by report \"once\", but \"each\" is for other tasks \
             and \"once\" for init: write { every_us = N, because = \"...\" }",
        ),
        (
            text("pended_by.report = { every_us = 10 }", "", ""),
            "tasks.toml:4: `pended_by` takes \"each\", \"once\" or { every_us = N, because = \"...\" }",
        ),
        (
            text("pended_by.rudder = \"each\"", "", ""),
            "tasks.toml: task sample of node: `pended_by` names rudder, which is neither a task nor init \
             or idle",
        ),
        (
            text(
                "pended_by.report = { every_us = 0, because = \"x\" }",
                "",
                "",
            ),
            "tasks.toml: task sample of node has `every_us` = 0: 1 to 3600000000 is accepted",
        ),
        (
            loops,
            "tasks.toml: task filter of node: `pended_by` says \"each\" in a loop (sample -> filter -> \
             sample), so nothing bounds how often it runs: one of them needs { every_us = N, because = \
             \"...\" }",
        ),
        (
            itself,
            "tasks.toml: task report of node: `pended_by` says \"each\" in a loop (report -> report), so \
             nothing bounds how often it runs: one of them needs { every_us = N, because = \"...\" }",
        ),
    ] {
        assert_eq!(model(&table).unwrap_err(), sentence);
    }
}

/// A loop with a bound is none any more: the bound is what its first task counts.
#[test]
fn a_loop_with_a_bound_is_accepted() {
    let bound = "pended_by.filter = { every_us = 3000, because = \"it waits three samples\" }";
    let (model, table) = self::model(&text(bound, "pended_by.sample = \"each\"", "")).unwrap();
    assert_eq!(releases(&model, "sample", [1]), [2]);
    assert_eq!(releases(&model, "filter", [1]), [3]);
    let found = [found("EXTI0", "EXTI1", true), found("EXTI1", "EXTI0", true)];
    assert_eq!(
        pends::check(&model, &table, &BTreeSet::from(found), "tasks.toml"),
        Ok(())
    );
}

fn found(pender: &str, pended: &str, exact: bool) -> Found {
    let pender = match pender {
        "init" => Pender::Init,
        "idle" => Pender::Idle,
        interrupt => Pender::Handler(interrupt.to_owned()),
    };
    Found {
        pender,
        pended: pended.to_owned(),
        place: "node.rs:7 (f)".to_owned(),
        exact,
    }
}

#[test]
fn what_the_table_omits_has_its_sentence() {
    let (model, table) = model(&text("pended_by.report = \"each\"", "", "")).unwrap();
    let bounded = "= { every_us = N, because = \"...\" }` under [node.node.task.";
    for (all, sentence) in [
        (vec![found("EXTI2", "EXTI0", true)], None),
        (
            vec![found("EXTI1", "EXTI2", true)],
            Some(format!(
                "filter of node pends report at node.rs:7 (f), which the task table omits: write \
                 `pended_by.filter {bounded}report], or `\"each\"` in place of the braces if every job of \
                 filter may"
            )),
        ),
        (
            vec![found("init", "EXTI2", true)],
            Some(
                "init of node pends report at node.rs:7 (f), which the task table omits: write \
                 `pended_by.init = \"once\"` under [node.node.task.report]"
                    .to_owned(),
            ),
        ),
        (
            vec![found("idle", "EXTI2", true)],
            Some(format!(
                "idle of node pends report at node.rs:7 (f), which the task table omits: write \
                 `pended_by.idle {bounded}report]"
            )),
        ),
        (
            vec![found("EXTI2", "EXTI2", true), found("EXTI1", "EXTI0", true)],
            Some(format!(
                "report of node pends itself at node.rs:7 (f), and nothing in the task table bounds how \
                 often: write `pended_by.report {bounded}report]"
            )),
        ),
        (
            vec![
                found("EXTI2", "EXTI0", true),
                found("EXTI0", "EXTI1", true),
                found("EXTI1", "EXTI2", true),
            ],
            Some(format!(
                "sample of node pends filter at node.rs:7 (f), and filter pends report, and report pends \
                 sample, and nothing in the task table bounds how often: write `pended_by.sample \
                 {bounded}filter]"
            )),
        ),
        (
            vec![found("EXTI0", "EXTI2", false)],
            Some(format!(
                "sample of node may pend report at node.rs:7 (f), because the interrupt is not known \
                 there, which the task table omits: name the interrupt there, or write `pended_by.sample \
                 {bounded}report], or `\"each\"` in place of the braces if every job of sample may"
            )),
        ),
    ] {
        let all = all.into_iter().collect();
        let error = pends::check(&model, &table, &all, "tasks.toml").map_err(|e| e.to_string());
        let expected = sentence.map_or(Ok(()), |sentence| Err(format!("tasks.toml: {sentence}")));
        assert_eq!(error, expected);
    }
}

const SHARED: &str = r"
#[rtic::app(device = part, dispatchers = [EXTI5])]
mod app {
    #[task(priority = 1)]
    async fn show(_: show::Context) {}
    #[task(priority = 1)]
    async fn blink(_: blink::Context) {}
}
";

/// Two software tasks share a handler, whose code does not tell which of them pends or is pended.
#[test]
fn each_task_that_shares_a_handler_has_its_pends_in_the_table() {
    let said = |[tick, show, blink]: [&str; 3], all: &[Found]| {
        let row = |name: &str, lines: &str| {
            format!("[node.node.task.{name}]\nevery_us = 1000\ndeadline_us = 200\n{lines}\n")
        };
        let text = row("SysTick", tick) + &row("show", show) + &row("blink", blink);
        let (model, table) = of_source(SHARED, &text).unwrap();
        let all = all.iter().cloned().collect();
        pends::check(&model, &table, &all, "tasks.toml")
            .map_err(|error| error.to_string().replace("node.node.", ""))
    };
    let place = "at node.rs:7 (f), because blink shares its handler with";
    let bounded = "{ every_us = N, because = \"...\" }";
    let (which, whom) = (
        "and the image does not tell which of them",
        "{ because = \"...\" }` if it never does",
    );
    let of_show = "pended_by.show = \"each\"";
    let of_both = "pended_by.show = \"each\"\npended_by.blink = { because = \"it only waits\" }";
    let to_tick = [found("EXTI5", "SysTick", true)];
    let expected = format!(
        "tasks.toml: blink of node may pend SysTick {place} show, {which} pends: write \
         `pended_by.blink = {bounded}` under [task.SysTick], or \"each\" in place of the braces if every job of blink \
         may, or `pended_by.blink = {whom}"
    );
    assert_eq!(said([of_show, "", ""], &to_tick), Err(expected));
    assert_eq!(said([of_both, "", ""], &to_tick), Ok(()));
    let by_tick = [found("SysTick", "EXTI5", true)];
    let expected = format!(
        "tasks.toml: SysTick of node may pend blink {place} show, {which} is pended: write \
         `after = \"SysTick\"` under [task.blink], or `pended_by.SysTick = {whom}"
    );
    let after = "after = \"SysTick\"";
    assert_eq!(said(["", after, ""], &by_tick), Err(expected));
    assert_eq!(said(["", after, after], &by_tick), Ok(()));
    let by_init = [found("init", "EXTI5", true)];
    let once = "pended_by.init = \"once\"";
    let expected = format!(
        "tasks.toml: init of node may pend blink {place} show, {which} is pended: write \
         `pended_by.init = \"once\"` under [task.blink], or `pended_by.init = {whom}"
    );
    assert_eq!(said(["", once, ""], &by_init), Err(expected));
    assert_eq!(said(["", once, once], &by_init), Ok(()));
    let by_itself = [found("EXTI5", "EXTI5", true)];
    let expected = format!(
        "tasks.toml: blink of node may pend itself {place} show, {which} pends: write \
         `pended_by.blink = {bounded}` under [task.blink], or `pended_by.blink = {whom}"
    );
    let show = "pended_by.show = { because = \"it wakes nobody\" }";
    let blink = "pended_by.blink = { because = \"it wakes nobody\" }";
    assert_eq!(said(["", show, ""], &by_itself), Err(expected));
    assert_eq!(said(["", show, blink], &by_itself), Ok(()));
}

/// No window holds more late pends than are counted.
#[test]
fn late_pends_are_counted() {
    const CYCLE: u64 = 200;
    let mut random = ChaCha8Rng::seed_from_u64(2017);
    let mut below = |limit: u64| u64::from(random.next_u32()) % limit.max(1);
    for _ in 0..10_000 {
        let (period, late) = (1 + below(50), below(101));
        let jobs: Vec<Job> = (0..below(4))
            .map(|_| {
                let earliest = below(CYCLE);
                Job {
                    id: None,
                    cause: None,
                    label: String::new(),
                    earliest,
                    latest: earliest + below(100),
                    deadline: None,
                    transmits: false,
                }
            })
            .collect();
        let mut pends = Vec::new();
        let mut now = 0;
        for _ in 0..below(30) {
            now += period + below(2) * below(3 * period);
            pends.push(now + below(late + 1));
        }
        for cycle in 0..10 {
            for job in &jobs {
                let released = job.earliest + below(job.latest - job.earliest + 1);
                pends.push(cycle * CYCLE + released + below(late + 1));
            }
        }
        let arrivals = Arrivals {
            sporadic: vec![Sporadic::every(period)],
            timed: vec![Timetable {
                cycle: CYCLE,
                spacing: 0,
                burst: 0,
                kind: Kind::Any,
                cost: None,
                jobs,
            }],
            ..Arrivals::default()
        };
        let (begin, window) = (below(1000), below(400));
        let held = pends
            .iter()
            .filter(|at| (begin..begin + window).contains(*at));
        assert!(held.count() as u64 <= arrivals.delayed(late).count(window, 0));
    }
}
