//! A little RTIC node through the whole analysis: as it is, and broken on
//! purpose in each way that the analysis must name.

#[path = "broken/handlers.rs"]
mod handlers;
#[path = "broken/stores.rs"]
mod stores;
#[path = "broken/ways.rs"]
mod ways;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use parts::Sled;
use schedulability::models::{Files, InputError, Models, Supplements};
use schedulability::node::{Entered, Observed, Seen};
use schedulability::priorities;
use schedulability::report;
use schedulability::results::Report;
use schedulability::system::{Inputs, Program, Programs};
use twin::mcu::{Board, Mcu};
use twin::part::Part;
use wcet::cycles::{Cycles, Model};
use wcet::image::Image;

/// A change of the source: what it replaces, and by what.
type Change = (&'static str, &'static str);

/// The programs: the node as it is, and what is done to it.
const PROGRAMS: [(&str, &[Change]); 14] = [
    ("sound", &[]),
    (
        "loop",
        &[(
            "let mut level = *cx.local.level;",
            "let mut level = *cx.local.level;\n        while input() & 1 == 0 {}",
        )],
    ),
    (
        "recursion",
        &[(
            "let mut level = *cx.local.level;",
            "let mut level = part::ackermann(*cx.local.level & 3, input() & 7);",
        )],
    ),
    (
        "pointer",
        &[
            (
                "level: u32,",
                "level: u32,\n        weigh: [fn(u32) -> u32; 2],",
            ),
            (
                "level: 0xFFFF,",
                "level: 0xFFFF,\n            weigh: [|x| x / 3, |x| x / 5],",
            ),
            ("local = [level]", "local = [level, weigh]"),
            (
                "let mut level = *cx.local.level;",
                "cx.local.weigh.swap(0, input() as usize % 2);\n        \
                 let mut level = cx.local.weigh[0](*cx.local.level);",
            ),
        ],
    ),
    ("longer", &[("ROUNDS: u32 = 20", "ROUNDS: u32 = 200")]),
    (
        "lock",
        &[(
            "let samples = cx.shared.samples.lock(|samples| *samples);\n        \
             output(checksum(&samples, ROUNDS));",
            "output(cx.shared.samples.lock(|samples| checksum(samples, ROUNDS)));",
        )],
    ),
    (
        "swapped",
        &[
            ("EXTI0, priority = 3", "EXTI0, priority = 1"),
            ("EXTI2, priority = 1", "EXTI2, priority = 3"),
        ],
    ),
    (
        "annotation",
        &[(
            "let mut level = *cx.local.level;",
            "let mut level = *cx.local.level;\n        \
             let mut bits = level | 0xFFFF;\n        \
             // loop-bound: 1 there are sixteen and more\n        \
             while bits != 0 {\n            bits &= bits - 1;\n            level ^= bits;\n        }",
        )],
    ),
    (
        "omitted",
        &[(
            "output(level);",
            "output(level);\n        rtic::pend(Interrupt::EXTI2);",
        )],
    ),
    (
        "itself",
        &[
            (
                "output(checksum(&samples, ROUNDS));",
                "output(checksum(&samples, ROUNDS));\n        again();",
            ),
            (
                "    #[task(binds = EXTI2",
                "    #[inline(never)]\n    fn again() {\n        \
             if input() & 1 == 0 {\n            rtic::pend(Interrupt::EXTI2);\n        }\n    }\n\n    \
             #[task(binds = EXTI2",
            ),
        ],
    ),
    (
        "circle",
        &[
            (
                "cx.shared.samples.lock(|samples| samples[next] = input());",
                "cx.shared.samples.lock(|samples| samples[next] = input());\n        \
                 if input() & 1 == 0 {\n            rtic::pend(Interrupt::EXTI1);\n        }",
            ),
            (
                "output(level);",
                "output(level);\n        rtic::pend(Interrupt::EXTI2);",
            ),
        ],
    ),
    (
        "unknown",
        &[
            ("level: u32,", "level: u32,\n        whom: Interrupt,"),
            (
                "level: 0xFFFF,",
                "level: 0xFFFF,\n            whom: Interrupt::EXTI0,",
            ),
            ("local = [level]", "local = [level, whom]"),
            (
                "output(level);",
                "output(level);\n        rtic::pend(*cx.local.whom);\n        \
                 if input() & 1 == 0 {\n            *cx.local.whom = Interrupt::EXTI2;\n        }",
            ),
        ],
    ),
    (
        "often",
        &[
            ("level: u32,", "level: u32,\n        rounds: u32,"),
            ("level: 0xFFFF,", "level: 0xFFFF,\n            rounds: 0,"),
            (
                "binds = EXTI2, priority = 1, shared = [samples]",
                "binds = EXTI2, priority = 1, shared = [samples], local = [rounds]",
            ),
            (
                "output(checksum(&samples, ROUNDS));",
                "output(checksum(&samples, ROUNDS));\n        \
                 if *cx.local.rounds < 5 {\n            *cx.local.rounds += 1;\n            \
                 rtic::pend(Interrupt::EXTI2);\n        }",
            ),
        ],
    ),
    ("unsaid", &[("EXTI1, priority = 2", "EXTI1")]),
];

/// The package with all programs in it; built once.
fn package() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let template = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/node");
        let package = Path::new(env!("CARGO_TARGET_TMPDIR")).join("node");
        let programs = package.join("src/bin");
        fs::create_dir_all(&programs).unwrap();
        let files = [
            "Cargo.toml",
            "Cargo.lock",
            "build.rs",
            "device.x",
            "memory.x",
            "src/lib.rs",
        ];
        for file in files {
            update(
                &package.join(file),
                &fs::read_to_string(template.join(file)).unwrap(),
            );
        }
        let source = fs::read_to_string(template.join("src/node.rs")).unwrap();
        let more = handlers::PROGRAMS.into_iter().chain(stores::PROGRAMS);
        let more = more.chain(ways::PROGRAMS);
        for (program, changes) in PROGRAMS.into_iter().chain(more) {
            let changed = changes.iter().fold(source.clone(), |source, (from, to)| {
                assert!(source.contains(from), "{program}: {from}");
                source.replace(from, to)
            });
            update(&programs.join(format!("{program}.rs")), &changed);
        }
        let workspace = xtask::Workspace::find().unwrap();
        xtask::target::ensure(&workspace).unwrap();
        let status = xtask::target::cargo(&workspace, "build")
            .current_dir(&package)
            .args(["--quiet", "--release", "--bins"])
            .env("CARGO_TARGET_DIR", package.join("target"))
            .env_remove("RUSTFLAGS")
            .env_remove("CARGO_ENCODED_RUSTFLAGS")
            .status()
            .unwrap();
        assert!(status.success(), "the node does not build");
        package
    })
}

/// Writes a file unless it is so already, which spares a build.
fn update(path: &Path, text: &str) {
    if fs::read_to_string(path).is_ok_and(|known| known == text) {
        return;
    }
    fs::write(path, text).unwrap();
}

fn image(program: &str) -> PathBuf {
    let target = package().join("target").join(xtask::target::TRIPLE);
    target.join("release").join(program)
}

fn workspace() -> &'static Path {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here)
}

/// What the image's line tables are read against: the package, or the workspace when the
/// package lies in it.
fn root() -> &'static Path {
    if package().starts_with(workspace()) {
        workspace()
    } else {
        package()
    }
}

/// A sentence with the places in it as from the package.
fn from_package(sentence: &str) -> String {
    let inside = package().strip_prefix(root()).unwrap_or(package());
    let sentence = sentence.replace(&format!("{}/", package().display()), "");
    if inside.as_os_str().is_empty() {
        sentence
    } else {
        sentence.replace(&format!("{}/", inside.display()), "")
    }
}

fn inputs(program: &str) -> Inputs {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let source = package().join(format!("src/bin/{program}.rs"));
    Inputs {
        root: root().to_owned(),
        table: here.join("tests/node/tasks.toml"),
        // It has no part in this network, and the network none in its answer.
        network: here.join("../firmware/vehicles/uagv/network.dbc"),
        supplements: Supplements::default(),
        receiver_period_us: None,
        event_triggered: false,
        foreign: Vec::new(),
        errors: None,
        nodes: BTreeMap::from([(
            "node".to_owned(),
            Program {
                board: Sled::F446,
                source,
                image: image(program),
            },
        )]),
    }
}

/// What the whole analysis says, a run on the emulated part included.
fn answer(program: &str) -> Result<Report, InputError> {
    answer_to(program, &inputs(program))
}

/// The same for other inputs of the program.
fn answer_to(program: &str, inputs: &Inputs) -> Result<Report, InputError> {
    let programs = Programs::read(inputs, &|_| {})?;
    let observed = BTreeMap::from([("node".to_owned(), observed(program, &programs))]);
    programs.report(&observed, &|_| {})
}

/// The answer for a program whose task table has these rows in addition.
fn with_rows(program: &str, rows: &str) -> Result<Report, InputError> {
    let mut inputs = inputs(program);
    let table = fs::read_to_string(&inputs.table).unwrap() + rows;
    let name = format!("{program}-{}.toml", rows.len());
    inputs.table = package().join(name);
    fs::write(&inputs.table, table).unwrap();
    answer_to(program, &inputs)
}

/// Runs the program: each of its tasks is pended once.
fn observed(program: &str, programs: &Programs) -> Observed {
    let elf = fs::read(image(program)).unwrap();
    let on_part = twin::image::Image::from_elf(Part::F446, &elf).unwrap();
    let mut mcu = Mcu::new(Arc::new(on_part), &Board::default(), None);
    let watches = programs.watches("node").map(|(_, watch)| watch);
    let findings = observer::follow(&mut mcu, watches, programs.known("node"), 0);
    mcu.run_for(can_bus::SimDuration::from_ticks(100_000_000_000));
    let image = Image::read(&image(program)).unwrap();
    let findings = observer::follower::lock(&findings);
    let tasks = mcu.load().tasks.into_iter();
    tasks
        .map(|task| {
            let found = findings
                .handlers
                .get(&task.exception)
                .cloned()
                .unwrap_or_default();
            let seen = Seen {
                longest: Cycles::both(task.longest),
                preempted: BTreeMap::new(),
                followed: found.activations,
                entered: entered(&found.entered),
                refuted: found
                    .refuted
                    .iter()
                    .map(|refuted| refuted.sentence(&image))
                    .collect(),
            };
            (task.name, seen)
        })
        .collect()
}

fn entered(runs: &[Vec<u64>]) -> Vec<Entered> {
    let runs = runs.iter().cloned();
    runs.map(|at| Entered {
        scenario: "a run".into(),
        at,
    })
    .collect()
}

/// A sentence with its times and counts left out, which are the compiler's.
fn said(program: &str) -> String {
    let sentence = answer(program).unwrap().first_miss().unwrap_or_default();
    let sentence = from_package(&sentence);
    let mut text = String::new();
    for word in sentence.split(' ') {
        let number = word.trim_start_matches('(');
        let left_out = number.contains('.') || word.starts_with('(');
        if left_out && number.parse::<f64>().is_ok() {
            text.push_str(&word.replace(number, "#"));
        } else {
            text.push_str(word);
        }
        text.push(' ');
    }
    text.trim_end().to_owned()
}

/// The cycles of each row of a path.
fn explained(text: &str) -> Vec<i64> {
    let rows = text
        .lines()
        .skip_while(|line| !line.contains("cycles times"));
    let cycles = |line: &str| line.split_whitespace().next()?.parse().ok();
    rows.skip(1).map_while(cycles).collect()
}

#[test]
fn the_node_as_it_is_is_schedulable() {
    let report = answer("sound").unwrap();
    assert_eq!(report.first_miss(), None, "{:?}", report.nodes);
    for task in &report.nodes[0].tasks {
        let activations = if task.name == "sample" { 2 } else { 1 };
        assert_eq!(task.followed, activations, "{}", task.name);
        let ratio = task.ratio(Model::ZeroWait).unwrap();
        assert!((1.0..1.25).contains(&ratio), "{}: {ratio}", task.name);
        assert!(task.before_release().is_some(), "{task:?}");
        let rows = explained(&report::explain(&report.nodes[0], task));
        let (bound, rows) = rows.split_last().unwrap();
        assert!(rows.len() > 1, "{rows:?}");
        assert_eq!(rows.iter().sum::<i64>(), *bound, "{}", task.name);
        assert_eq!(bound.cast_unsigned(), task.cycles.flashed, "{}", task.name);
    }
}

#[test]
fn each_way_of_breaking_it_has_its_sentence() {
    for (program, sentence) in [
        (
            "loop",
            "node.filter has no bound: the loop at src/bin/loop.rs:48 (EXTI1) has no bound: \
             write `// loop-bound: N` on the line above it, where N is the most \
             turns that it takes",
        ),
        (
            "recursion",
            "node.filter has no bound: recursion: part::ackermann calls part::ackermann; \
             its depth, and so its time and stack, has no bound",
        ),
        (
            "pointer",
            "node.filter has no bound: the call through a pointer at src/bin/pointer.rs:50 \
             (EXTI1) may go anywhere: call the function by name, or take the pointer from \
             a constant table",
        ),
        (
            "longer",
            "node.report misses its deadline of # us by # us: it takes # us itself, \
             waits # us for report, waits # us for sample (# times) and waits # us for filter (# times)",
        ),
        (
            "lock",
            "node.sample misses its deadline of # us by # us: it takes # us itself, is blocked # us by \
             report at src/bin/lock.rs:6 (EXTI2) and waits # us for sample (# times)",
        ),
        (
            "swapped",
            "node.sample misses its deadline of # us by # us: it takes # us itself, waits # us for report \
             (# times), waits # us for filter (# times) and waits # us for sample (# times)",
        ),
        (
            "annotation",
            "node.filter does not behave as analysed, so it has no bound: the loop at \
             src/bin/annotation.rs:50 took 3 turns, its annotation says at most 1",
        ),
    ] {
        assert_eq!(said(program), sentence, "{program}");
    }
}

#[test]
fn a_priority_unsaid_is_wrong_input() {
    let error = answer("unsaid").unwrap_err();
    assert_eq!(
        from_package(&error.to_string()),
        "src/bin/unsaid.rs:44: task filter does not say its priority: write `priority = N`"
    );
}

#[test]
fn a_loop_may_be_bounded_in_the_task_table() {
    let bounds = |name: &str, turns: u64| {
        with_rows(
            "register",
            &format!(
                "[bounds]\n\"{name}\" = {{ turns = {turns}, because = \"the bit comes soon.\" }}\n"
            ),
        )
    };
    let report = bounds("EXTI1", 20).unwrap();
    assert_eq!(report.first_miss(), None);
    let sentence = "The loop at EXTI1 takes at most 20 turns: the bit comes soon. Who writes the task table makes \
                    sure; an observed run with more fails.";
    let mut assumptions = report.assumptions.iter();
    assert!(assumptions.any(|one| one == sentence), "{report:?}");
    let error = bounds("EXTI0", 20).unwrap_err().to_string();
    assert!(
        error.contains("[bounds] has \"EXTI0\", but no task reaches a loop of that name"),
        "{error}"
    );
    let error = bounds("EXTI1", 0).unwrap_err().to_string();
    assert!(
        error.ends_with("the bound of EXTI1 has `turns` = 0: 1 to 999999999 is accepted"),
        "{error}"
    );
}

/// The task table says that `init` pends all three tasks, and `report` pends `sample`.
#[test]
fn a_pend_that_the_task_table_omits_is_refused() {
    for (program, sentence) in [
        (
            "omitted",
            "filter of node pends report at src/bin/omitted.rs:53 (EXTI1), which the task table omits: write \
             `pended_by.filter = { every_us = N, because = \"...\" }` under [node.node.task.report], or \
             `\"each\"` in place of the braces if every job of filter may",
        ),
        (
            "itself",
            "report of node pends itself at src/bin/itself.rs:58 (itself::app::again), and nothing in the \
             task table bounds how often: write `pended_by.report = { every_us = N, because = \"...\" }` \
             under [node.node.task.report]",
        ),
        (
            "circle",
            "sample of node pends filter at src/bin/circle.rs:43 (EXTI0), and filter pends report, and \
             report pends sample, and nothing in the task table bounds how often: write \
             `pended_by.sample = { every_us = N, because = \"...\" }` under [node.node.task.filter]",
        ),
        (
            "unknown",
            "filter of node may pend itself at src/bin/unknown.rs:55 (EXTI1), because the interrupt is not \
             known there, and nothing in the task table bounds how often: name the interrupt there, or \
             write `pended_by.filter = { every_us = N, because = \"...\" }` under [node.node.task.filter]",
        ),
    ] {
        let error = from_package(&answer(program).unwrap_err().to_string());
        let (_, said) = error.split_once("tests/node/tasks.toml: ").unwrap();
        assert_eq!(said, sentence, "{program}");
    }
}

/// The task pends itself five times in a row; the table says that it does so once in 40 ms. Nothing in
/// the image contradicts that, but the run does.
#[test]
fn a_rate_in_the_task_table_that_a_run_refutes_has_no_bound() {
    let row = "pended_by.report = { every_us = 40_000, because = \"the test says so\" }\n";
    let sentence = with_rows("often", row)
        .unwrap()
        .first_miss()
        .unwrap_or_default();
    let (refuted, counted) = sentence.split_once(" times within ").unwrap();
    let (_, allowed) = counted
        .split_once(" in a run, and the task table allows ")
        .unwrap();
    assert_eq!(
        (refuted, allowed),
        (
            "node.report does not behave as analysed, so it has no bound: it was released 4",
            "3"
        )
    );
}

#[test]
fn the_swap_is_seen_without_an_image() {
    let Inputs {
        root,
        table,
        network,
        supplements,
        receiver_period_us,
        event_triggered,
        foreign,
        errors,
        nodes,
    } = inputs("swapped");
    let sources = nodes
        .iter()
        .map(|(node, program)| (node.as_str(), program.board, program.source.as_path()));
    let models = Models::read(
        &Files {
            root: &root,
            table: &table,
            network: &network,
            supplements: &supplements,
        },
        receiver_period_us,
        event_triggered,
        &foreign,
        errors,
        sources,
    )
    .unwrap();
    let shown = priorities::show(models.nodes.iter().map(|(node, _)| (node, None)));
    let text = from_package(&shown);
    for wanted in [
        "sample has the shorter deadline but a lower priority than report",
        "to change, src/bin/swapped.rs:37: sample: `priority = 3` instead of 1",
    ] {
        assert!(text.contains(wanted), "{text}");
    }
}
