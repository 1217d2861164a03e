//! The command on little applications in several shapes, and on what must be refused.

mod common;

use std::fs;

use common::{Said, Target, deadlines, package, run, shape, table, with_table};

/// The number before ` us` in the column of this heading, in the row of a task.
fn column(said: &Said, task: &str, heading: &str) -> f64 {
    let lines: Vec<&str> = said.out.lines().collect();
    let head = lines
        .iter()
        .find(|line| line.contains("interrupt"))
        .unwrap();
    let end = head.find(heading).unwrap() + heading.len();
    let is_row = |line: &&&str| line.trim_start_matches('!').trim_start().starts_with(task);
    let row = lines.iter().find(is_row).unwrap();
    let words: Vec<&str> = row[..end].split_whitespace().collect();
    let [.., number, unit] = words.as_slice() else {
        panic!("{row}");
    };
    let factor = if *unit == "ms" { 1000.0 } else { 1.0 };
    number.parse::<f64>().unwrap() * factor
}

#[test]
fn each_shape_of_an_application_has_its_report() {
    for (name, target) in [
        ("blink", Target::V7),
        ("blink", Target::V6),
        ("modules", Target::V7),
        ("modules", Target::V6),
        ("timed", Target::V7),
        ("timed", Target::V6),
        ("menu", Target::V7),
        ("menu", Target::V6),
        ("compare", Target::V7),
        ("masks", Target::V6),
        ("pump", Target::V7),
    ] {
        let part: &[&str] = match (name, target) {
            ("blink", Target::V6) => &["--part", "stm32f0", "--core-hz", "48000000"],
            ("modules", Target::V6) => &["--part", "stm32g0", "--core-hz", "64000000"],
            _ => &[],
        };
        let table = match (name, target) {
            ("timed", Target::V6) => "timed_v6",
            ("menu", Target::V6) => "menu_v6",
            _ => name,
        };
        let said = with_table(name, target, table, part);
        assert_eq!(said.code, 0, "{name} {target:?}: {said:?}");
        insta::assert_snapshot!(
            format!("{name}_{target:?}").to_lowercase(),
            shape(&said.out)
        );
    }
}

/// The tick of the emulated part comes by itself; what nothing releases there is pended.
#[cfg(feature = "emulator")]
#[test]
fn a_run_is_held_against_the_analysis() {
    for (name, changes, pended) in [
        ("timed", &[][..], None),
        ("menu", &[], None),
        (
            "blink",
            &[("100_000_000", "16_000_000"), ("48_000_000", "16_000_000")],
            Some("pended in the second as often as their rows allow for ever: watch, report."),
        ),
    ] {
        let said = common::with_changed(name, name, changes, &["--run", "2"]);
        assert_eq!(said.code, 0, "{name}: {said:?}");
        let run = "The image was run for 2 s on an emulated STM32F446RE";
        assert!(said.out.contains(run), "{name}: {said:?}");
        assert!(
            pended.is_none_or(|pended| said.out.contains(pended)),
            "{name}: {said:?}"
        );
        let tasks: &[&str] = match name {
            "timed" => &["SysTick", "fast", "slow"],
            "menu" => &["SysTick", "step"],
            _ => &["sample", "watch", "report"],
        };
        for task in tasks {
            let (seen, bound) = (column(&said, task, " seen"), column(&said, task, " bound"));
            assert!(0.0 < seen && seen <= bound, "{name} {task}: {said:?}");
        }
    }
}

#[cfg(feature = "emulator")]
#[test]
fn a_run_that_refutes_the_table_or_an_annotation_is_told() {
    let said = |name: &str, of: &str, changes: &[common::Change], more: &[&str]| {
        let said = common::with_changed(name, of, changes, &[&["--run", "2"], more].concat());
        (said.code, said.error)
    };
    let slow = [("every_us = 1000\n", "every_us = 2000\n")];
    let (code, error) = said("menu", "menu", &slow, &[]);
    assert_eq!(code, 1);
    assert!(
        error.contains("SysTick") && error.contains("in the emulated run"),
        "{error}"
    );
    let clock = [("16_000_000", "32_000_000")];
    assert_eq!(
        said("menu", "menu", &clock, &[]),
        (
            2,
            "the program sets the core to 16000000 Hz, and the task table says `core_hz` = 32000000: correct the \
             table, or say by --external-hz which clock is at the part's input"
                .to_owned()
        )
    );
    let slower = [("100_000_000", "16_000_000"), ("48_000_000", "16_000_000")];
    let (code, error) = said("lies", "blink", &slower, &[]);
    assert_eq!(code, 1);
    assert!(
        error.contains("lies.watch") && error.contains("the loop at src/bin/lies.rs:43 took"),
        "{error}"
    );
    let (code, error) = said("stuck", "blink", &slower, &[]);
    assert_eq!(code, 1);
    let start = "the run is not as analysed: a job of watch that began ";
    let end = "did not end within its deadline of 200.00 us, nor in the run";
    assert!(error.contains(start) && error.ends_with(end), "{error}");
    let (code, error) = said("blink", "blink", &slower, &["--part", "nrf52840"]);
    assert_eq!(code, 2);
    assert!(
        error.starts_with(
            "--run: the nRF52840 is not emulated: accepted are parts whose file has `emulated`, as"
        ),
        "{error}"
    );
}

/// The package has several binaries, so a table is of one of them.
#[test]
fn a_first_table_is_named_after_its_binary() {
    let path = package().join("deadlines-masks.toml");
    let _ = fs::remove_file(&path);
    let said = deadlines("masks", Target::V7, &["init"]);
    assert_eq!(said.code, 0, "{said:?}");
    assert!(
        said.out.starts_with("Wrote deadlines-masks.toml with "),
        "{said:?}"
    );
    fs::remove_file(&path).unwrap();
}

/// On a Cortex-M0+ a priority is set by a read and a write of the word that has it.
#[test]
fn a_store_to_an_unknown_address_leaves_the_priorities() {
    let part = ["--part", "stm32g0", "--core-hz", "48000000"];
    let said = with_table("stores", Target::V6, "compare", &part);
    assert_eq!(said.code, 0, "{said:?}");
}

/// A logger masks all interrupts in `init`, where they are masked already, and notes that in a variable. Start-up has
/// not ended when it gives back what it noted.
#[test]
fn a_log_in_init_leaves_the_priorities() {
    let part = ["--part", "stm32g0", "--core-hz", "48000000"];
    let said = with_table("early", Target::V6, "compare", &part);
    assert_eq!(said.code, 0, "{said:?}");
}

/// Start-up left the address of the log, which a task does not change, and idle code does not either.
#[test]
fn idle_code_knows_the_addresses_that_start_up_left() {
    for target in [Target::V7, Target::V6] {
        let part: &[&str] = match target {
            Target::V6 => &["--part", "stm32f0", "--core-hz", "48000000"],
            Target::V7 => &[],
        };
        let said = with_table("idle_logs", target, "blink", part);
        assert_eq!(said.code, 0, "{target:?}: {said:?}");
    }
}

/// A Cortex-M3 has no floating-point unit, and no part has more priorities than its bits say.
#[test]
fn an_image_must_fit_its_part() {
    let on = |name: &str, part: &str| {
        let said = with_table(
            name,
            Target::V7,
            "blink",
            &["--part", part, "--core-hz", "48000000"],
        );
        (said.code, said.error)
    };
    assert_eq!(on("blink", "stm32f1").0, 0);
    assert_eq!(on("float", "stm32f303").0, 0);
    let (code, error) = on("float", "stm32f1");
    assert_eq!(code, 1);
    assert!(
        error.ends_with(", where there is no instruction of this core")
            && error.contains("float.watch has no bound: control reaches src/"),
        "{error}"
    );
    assert_eq!(
        on("blink", "nrf52832"),
        (
            2,
            "task sample of blink has priority 3, but the image gives TIM_A priority 2".to_owned()
        )
    );
    let (code, error) = on("blink", "rp2350");
    assert_eq!(code, 2);
    assert!(
        error.starts_with("the RP2350 has a cortex-m33, which is not analysed: "),
        "{error}"
    );
}

/// What a function notes in a variable while all interrupts are masked is known in another one.
#[test]
fn a_mask_may_be_noted_in_a_variable() {
    for target in [Target::V7, Target::V6] {
        let part: &[&str] = match target {
            Target::V6 => &["--part", "stm32f0", "--core-hz", "48000000"],
            Target::V7 => &[],
        };
        let said = with_table("logs", target, "blink", part);
        assert_eq!(said.code, 0, "{target:?}: {said:?}");
        let said = with_table("forgets", target, "blink", part);
        assert_eq!(said.code, 1, "{target:?}: {said:?}");
        assert!(
            said.error.starts_with(
                "not schedulable: forgets.watch has no bound: the mask that is set at "
            ),
            "{target:?}: {said:?}"
        );
    }
}

#[test]
fn output_that_goes_nowhere_has_its_sentence() {
    let parts = || {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_cargo-deadlines"));
        command.args(["deadlines", "parts"]);
        command
    };
    let full = fs::OpenOptions::new()
        .write(true)
        .open("/dev/full")
        .unwrap();
    let output = parts().stdout(full).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.starts_with("error: cannot write the report to standard output: "),
        "{said}"
    );
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let output = parts().stdout(writer).output().unwrap();
    assert_eq!((output.status.code(), output.stderr), (Some(0), Vec::new()));
}

#[test]
fn a_loop_may_be_bounded_by_its_name() {
    let table = |bounds: &str| {
        let path = package().join("bounds.toml");
        let blink = std::fs::read_to_string(common::table("blink")).unwrap();
        std::fs::write(&path, blink + "\n[bounds]\n" + bounds).unwrap();
        let path = path.display().to_string();
        deadlines("spin", Target::V7, &["--table", &path])
    };
    for name in ["src/bin/spin.rs:41", "src/bin/spin.rs:41 (TIM_B)", "TIM_B"] {
        let said = table(&format!(
            "\"{name}\" = {{ turns = 20, because = \"the bit toggles\" }}"
        ));
        assert_eq!(said.code, 0, "{name}: {said:?}");
        let sentence = format!(
            "The loop at {name} takes at most 20 turns: the bit toggles. Who writes the task table makes sure."
        );
        assert!(said.out.contains(&sentence), "{name}: {said:?}");
    }
    let said = table("\"src/bin/spin.rs:40\" = { turns = 20, because = \"the bit toggles\" }");
    assert_eq!(said.code, 2, "{said:?}");
    assert!(
        said.error.contains(
            "[bounds] has \"src/bin/spin.rs:40\", but no task reaches a loop of that name"
        ),
        "{said:?}"
    );
}

#[test]
fn each_way_of_breaking_it_has_its_sentence() {
    for (name, target, of, code, sentence) in [
        (
            "spin",
            Target::V7,
            "blink",
            1,
            "not schedulable: spin.watch has no bound: the loop at src/bin/spin.rs:41 (TIM_B) has no bound: \
             write `// loop-bound: N` on the line above it, where N is the most turns that it takes",
        ),
        (
            "handler",
            Target::V7,
            "blink",
            2,
            "vector 21 (interrupt 5) of the image of handler leads to src/bin/handler.rs:55 (SOFT_A), which is \
             neither a task nor a handler that ends in a reset: add [task.SOFT_A] with its `priority` to the task \
             table, or remove the handler",
        ),
        (
            "asks",
            Target::V7,
            "blink",
            1,
            "not schedulable: asks.watch has no bound: the request to the debugger at src/bin/asks.rs:41 (TIM_B) \
             (semihosting) takes as long as the debugger likes: write no log by semihosting in a task, or where \
             interrupts are masked",
        ),
        (
            "disables",
            Target::V7,
            "blink",
            1,
            "not schedulable: disables.watch has no bound: an interrupt is disabled in the interrupt controller at \
             src/bin/disables.rs:41 (TIM_B), and how long it stays so is not analysed: mask it by a lock, or by \
             `interrupt::free`",
        ),
        (
            "calls",
            Target::V7,
            "calls",
            2,
            "calls.toml: watch of calls pends call at src/bin/calls.rs:41 (TIM_B), which the task table omits: write \
             `pended_by.watch = { every_us = N, because = \"...\" }` under [task.call], or `\"each\"` in place of the \
             braces if every job of watch may",
        ),
        (
            "late_timer",
            Target::V7,
            "late_timer",
            1,
            "not schedulable: late_timer.SysTick has no bound: the timer's interrupt at priority 1 does not preempt the \
             software tasks at priority 2, so tasks may enter its queue while it empties it, and its turns have no \
             bound: give the timer the higher priority",
        ),
        (
            "stays",
            Target::V6,
            "masks",
            1,
            "not schedulable: stays.middle has no bound: the mask that is set at src/bin/stays.rs:35 (TIM_B) is still \
             set when the handler returns, so its section has no end: clear it before",
        ),
        (
            "guess",
            Target::V6,
            "masks",
            1,
            "not schedulable: guess.middle has no bound: the mask that is set at src/bin/guess.rs:35 (TIM_B) is still \
             set when the handler returns, so its section has no end: clear it before",
        ),
    ] {
        let said = with_table(name, target, of, &[]);
        let error = said.error.rsplit("/tables/").next().unwrap_or_default();
        // The line of a call may be that of what is inlined into it.
        assert_eq!((said.code, error), (code, sentence), "{name}");
    }
}

/// The count behind the wait ends after 2000 turns, whatever the wait does.
#[test]
fn behind_a_loop_without_a_bound_a_count_has_one() {
    let said = with_table("waits", Target::V7, "blink", &[]);
    assert_eq!(said.code, 1);
    let start = "not schedulable: waits.watch has no bound: the loop at src/lib.rs:";
    assert!(said.error.starts_with(start), "{said:?}");
    assert!(!said.out.contains("loop at src/bin/waits.rs"), "{said:?}");
}

/// A task that waits alone finds no other link in the timer queue, and its bound has no search.
#[test]
fn a_task_that_waits_alone_searches_no_queue() {
    for (target, table, most) in [(Target::V7, "menu", 45.0), (Target::V6, "menu_v6", 25.0)] {
        let said = with_table("menu", target, table, &[]);
        assert_eq!(said.code, 0, "{target:?}: {said:?}");
        let bound = column(&said, "step", "bound");
        assert!(bound < most, "{target:?}: {bound}");
    }
}

/// On a core without BASEPRI a lock masks single interrupts, and lasts until what it found is given back.
#[test]
fn a_lock_that_masks_single_interrupts_blocks_for_as_long_as_it_is_held() {
    let blocked = |name: &str, task: &str| {
        let said = with_table(name, Target::V6, "masks", &[]);
        assert_eq!(said.code, 0, "{name}: {said:?}");
        column(&said, task, "blocked")
    };
    let high = blocked("masks", "high");
    assert!(blocked("longer", "high") > 4.0 * high);
    // The end of the inner lock does not end the outer one.
    let one = blocked("unlocked", "high");
    assert!(one > 3.0 && high > one, "{high} {one}");
    // Both tasks above are masked, and the lowest is blocked by nobody.
    assert!(blocked("masks", "middle") >= high);
    assert!(blocked("masks", "low") == 0.0);
    // What a task of a middle priority disables and enables again by name is a section, too.
    assert!(blocked("given_back", "high") > 0.0);
}

/// What is wrong in a table: a text of that of `blink`, what replaces it, and the sentence.
const WRONG: &[(&str, &str, &str)] = &[
    (
        "pended_by.init = \"once\"\n",
        "",
        "broken.toml: init of blink pends sample at src/bin/blink.rs:25 (blink::app::main::__rtic_init_resources), \
             which the task table omits: write `pended_by.init = \"once\"` under [task.sample]",
    ),
    (
        "every_us = 500",
        "every_us = \"?\" # how often?",
        "broken.toml:11: `every_us` of task watch is still a question: write a value in place of \"?\"",
    ),
    (
        "[task.watch]\nevery_us = 500\ndeadline_us = 200\n",
        "",
        "broken.toml: task watch (src/bin/blink.rs:39) has no row: add [task.watch] with `every_us` or another \
             release, and `deadline_us`; or write `/// deadline: every 10 ms, within 5 ms` above it",
    ),
    (
        "[task.watch]",
        "[task.report]\nevery_us = 1\ndeadline_us = 1\n[task.watch]",
        "task report has a `deadline:` comment at src/bin/blink.rs:45 and a row in broken.toml: keep one of them",
    ),
    (
        "[task.watch]",
        "[task.none]\nevery_us = 1000\ndeadline_us = 1000\n[task.watch]",
        "broken.toml: [task.none] is a row of no task: the tasks of src/bin/blink.rs are sample, watch, report",
    ),
    (
        "every_us = 500",
        "every_us = 500\nafter = \"watch\"",
        "broken.toml: task watch of blink: `after` leads back to it (watch after watch), so nothing releases it: \
             name the task that pends it",
    ),
    (
        "pended_by.init = \"once\"\ndeadline_us = 100\n\n[task.watch]\n",
        "deadline_us = 100\nafter = \"watch\"\n\n[task.watch]\nafter = \"sample\"\n",
        "broken.toml: task sample of blink: `after` leads back to it (sample after watch after sample), so nothing \
             releases it: name the task that pends it",
    ),
    (
        "bus_hz = 48_000_000",
        "stack_bytes = 131_073",
        "broken.toml: `stack_bytes` = 131073: 1 to 131072 is accepted for the STM32F411, by its RAM",
    ),
    (
        "bus_hz = 48_000_000",
        "stack_bytes = 0",
        "broken.toml: `stack_bytes` = 0: 1 to 131072 is accepted for the STM32F411, by its RAM",
    ),
    (
        "deadline_us = 200",
        "",
        "broken.toml: task watch has no `deadline_us`",
    ),
    (
        "part = \"stm32f411\"\n",
        "",
        "broken.toml has no `part`: `cargo deadlines init` writes it, or `--part` says it on the command line",
    ),
];

#[test]
fn a_table_that_is_wrong_has_its_sentence() {
    let blink = fs::read_to_string(table("blink")).unwrap();
    for (from, to, sentence) in WRONG {
        assert!(blink.contains(from), "{from}");
        fs::write(package().join("broken.toml"), blink.replace(from, to)).unwrap();
        let said = deadlines("blink", Target::V7, &["--table", "broken.toml"]);
        assert_eq!((said.code, said.error.as_str()), (2, *sentence));
    }
    fs::write(
        package().join("broken.toml"),
        blink.replace("deadline_us = 200", "deadline_us = 1"),
    )
    .unwrap();
    let said = deadlines("blink", Target::V7, &["--table", "broken.toml"]);
    assert_eq!(said.code, 1);
    assert!(
        said.error
            .starts_with("not schedulable: blink.watch misses its deadline of 1.00 us by "),
        "{}",
        said.error
    );
}

/// The first table has what can be found and asks for the rest; the analysis does not run before it is answered.
#[test]
fn a_first_table_asks_for_what_cannot_be_found() {
    for (name, part) in [
        (
            "blink",
            &["--part", "stm32f411", "--core-hz", "100000000"][..],
        ),
        ("timed", &[]),
        ("compare", &[]),
        ("pump", &["--part", "stm32f411", "--core-hz", "16000000"]),
        ("shared", &["--part", "stm32f411", "--core-hz", "16000000"]),
    ] {
        let path = package().join(format!("first-{name}.toml"));
        let _ = fs::remove_file(&path);
        let file = path.display().to_string();
        let more = [&["init", "--table", &file], part].concat();
        let said = deadlines(name, Target::V7, &more);
        assert_eq!(said.code, 0, "{said:?}");
        assert!(
            said.out
                .starts_with(&format!("Wrote first-{name}.toml with ")),
            "{said:?}"
        );
        // Places in the compiler's library differ between compilers.
        let text = fs::read_to_string(&path).unwrap();
        let text: Vec<String> = text
            .lines()
            .map(|line| match line.find("# at core/") {
                Some(at) => format!("{}# at core/...", &line[..at]),
                None => line.to_owned(),
            })
            .collect();
        insta::assert_snapshot!(format!("first_{name}"), text.join("\n"));
        let again = deadlines(name, Target::V7, &more);
        assert_eq!(again.code, 2);
        assert_eq!(
            again.error,
            format!(
                "first-{name}.toml exists, and is not overwritten: remove it, or name another file by --table"
            )
        );
        let said = deadlines(name, Target::V7, &["--table", &file]);
        assert_eq!(said.code, 2);
        assert!(said.error.contains(" is still a question: "), "{said:?}");
    }
}

/// With each question answered, the first table is accepted: it has who pends whom, and the timer's priority.
#[test]
fn a_first_table_with_its_answers_is_accepted() {
    for name in ["pump", "shared"] {
        let path = package().join(format!("answered-{name}.toml"));
        let _ = fs::remove_file(&path);
        let file = path.display().to_string();
        let part = ["--part", "stm32f411", "--core-hz", "16000000"];
        let said = deadlines(
            name,
            Target::V7,
            &[&["init", "--table", &file], &part[..]].concat(),
        );
        assert_eq!(said.code, 0, "{said:?}");
        let mut text = fs::read_to_string(&path).unwrap();
        for (key, answer) in [
            ("every_us", "8000"),
            ("deadline_us", "7000"),
            ("pended_by.filter", "\"each\""),
        ] {
            text = text.replace(&format!("{key} = \"?\""), &format!("{key} = {answer}"));
        }
        text = text.replace("# bus_hz = 42_000_000", "bus_hz = 16_000_000");
        fs::write(&path, text).unwrap();
        let said = deadlines(name, Target::V7, &["--table", &file]);
        assert_eq!(said.code, 0, "{said:?}");
    }
}

/// The table of the README is that of `pump`, whose report has its snapshot.
#[test]
fn the_readme_has_a_complete_table() {
    let readme = include_str!("../README.md");
    let pump = fs::read_to_string(table("pump")).unwrap();
    assert!(readme.contains(&format!("```toml\n{pump}```\n")));
}

/// SysTick of rtic-monotonics has no priority of its own, so it keeps the highest.
#[test]
fn the_refusal_of_a_priority_names_the_line_to_write() {
    let pump = fs::read_to_string(table("pump")).unwrap();
    for given in ["", "priority = 2\n"] {
        let text = pump.replace("priority = 16\n", given);
        fs::write(package().join("low.toml"), text).unwrap();
        let said = deadlines("pump", Target::V7, &["--table", "low.toml"]);
        assert_eq!(
            (said.code, said.error.as_str()),
            (
                2,
                "task SysTick of pump has priority 2, but the image gives SysTick priority 16: write `priority = 16` under \
                 [task.SysTick]"
            )
        );
    }
}

/// A table that names one of two tasks of a dispatcher is not accepted for both.
#[test]
fn each_task_of_a_dispatcher_is_asked_who_pends() {
    let pump = fs::read_to_string(table("pump")).unwrap();
    let alone = "[task.heartbeat]\nevery_us = 250_000\ndeadline_us = 50_000\n";
    let said = |text: &str| {
        fs::write(package().join("shared.toml"), text).unwrap();
        deadlines("shared", Target::V7, &["--table", "shared.toml"])
    };
    let first = said(&format!("{pump}\n{alone}"));
    assert_eq!(first.code, 2, "{first:?}");
    assert!(
        first.error.contains(" shares its handler with ") && first.error.contains("heartbeat"),
        "{first:?}"
    );
    let tick = pump.replace(
        "pended_by.display = \"each\"",
        "pended_by.heartbeat = \"each\"\npended_by.display = \"each\"",
    );
    let all = format!("{tick}\n{alone}after = \"SysTick\"\npended_by.init = \"once\"\n");
    assert_eq!(said(&all).code, 0, "{:?}", said(&all));
    for line in [
        "pended_by.heartbeat = \"each\"\n",
        "after = \"SysTick\"\n",
        "pended_by.init = \"once\"\n",
    ] {
        let at = all.rfind(line).unwrap();
        let without = format!("{}{}", &all[..at], &all[at + line.len()..]);
        let said = said(&without);
        assert!(
            said.code == 2
                && said.error.contains("heartbeat")
                && said.error.contains(" shares its handler with display"),
            "{line}: {said:?}"
        );
    }
}

/// A symbol table and line tables are needed; the command's own builds keep them whatever the profile says.
#[test]
fn a_stripped_image_is_told() {
    let path = package().join("stripped.elf");
    let file = path.display().to_string();
    let table = table("blink").display().to_string();
    let image = fs::read(common::image("blink", Target::V7)).unwrap();
    for section in [&b".debug_line"[..], b".symtab"] {
        // Under another name no reader finds the section.
        let at = image
            .windows(section.len())
            .rposition(|bytes| bytes == section);
        let mut image = image.clone();
        image[at.unwrap() + 1] = b'x';
        if section == b".symtab" {
            // The symbols are found by the type of their section, so all headers go.
            image[0x20..0x24].fill(0);
            image[0x30..0x34].fill(0);
        }
        fs::write(&path, image).unwrap();
        let said = run(&["--bin", "blink", "--image", &file, "--table", &table]);
        assert_eq!(said.code, 2, "{said:?}");
        assert!(
            said.error
                .starts_with(&format!("the image {file} is stripped: ")),
            "{said:?}"
        );
    }
}

/// Built by the command itself, with the project's own settings; a feature adds a task.
#[test]
fn the_command_builds_the_project() {
    let table = table("blink").display().to_string();
    let target = Target::V7.triple();
    let build = ["--target", target, "--table", &table, "--features"];
    let said = run(&[&["--bin", "project"], &build[..], &["v7"]].concat());
    assert_eq!(said.code, 0, "{said:?}");
    assert!(!said.out.contains("convert"));
    let said = run(&[&["--bin", "project"], &build[..], &["v7,extra"]].concat());
    assert_eq!(said.code, 2, "{said:?}");
    assert!(
        said.error.contains("task convert (src/bin/project.rs:"),
        "{said:?}"
    );
    let said = run(&[&["--bin", "none"], &build[..], &["v7"]].concat());
    assert_eq!(said.code, 2);
    assert!(
        said.error.starts_with("there is no bin none: there are "),
        "{said:?}"
    );
    let said = run(&["--package", "none"]);
    assert_eq!(
        (said.code, said.error.as_str()),
        (2, "there is no package none: there are apps")
    );
    let said = run(&["--example", "none"]);
    assert_eq!(said.code, 2);
    assert!(
        said.error
            .starts_with("there is no example none: the package has none, but by --bin: "),
        "{said:?}"
    );
    let said = run(&[]);
    assert!(
        said.error
            .starts_with("there are several binaries: choose one by --bin: "),
        "{said:?}"
    );
}

/// Start-up pends `sample` beside its own release.
#[test]
fn no_interval_of_zero_is_shown() {
    let said = with_table("blink", Target::V7, "blink", &[]);
    assert!(said.out.contains("TIM_A      2 at once "), "{said:?}");
}

#[test]
fn a_lost_slack_fails_against_the_baseline() {
    let json = with_table("blink", Target::V7, "blink", &["--json"]);
    assert_eq!(json.code, 0);
    let mut report: serde_json::Value = serde_json::from_str(&json.out).unwrap();
    assert_eq!(report["schedulable"], true);
    let path = package().join("baseline.json");
    let mut against = |slack: f64, loss: &str| {
        for task in report["tasks"].as_array_mut().unwrap() {
            if task["name"] == "watch" {
                let now = task["slack_ps"].as_f64().unwrap();
                let mut former = task.clone();
                former["slack_ps"] = serde_json::json!((now * slack) as u64);
                let former = serde_json::json!({ "tasks": [former] });
                fs::write(&path, former.to_string()).unwrap();
            }
        }
        let path = path.display().to_string();
        with_table(
            "blink",
            Target::V7,
            "blink",
            &["--baseline", &path, "--loss", loss, "--format", "github"],
        )
    };
    assert_eq!(against(1.0, "0").code, 0);
    assert_eq!(against(1.2, "20").code, 0);
    let said = against(1.5, "20");
    assert_eq!(said.code, 1);
    assert!(
        said.error.starts_with("watch had ") && said.error.ends_with(": it may lose 20 %"),
        "{said:?}"
    );
    let annotation = said.out.lines().last().unwrap();
    assert!(
        said.out
            .contains("\nschedulable: every deadline holds\nslack is lost: watch had "),
        "{said:?}"
    );
    assert!(
        annotation.contains("src/bin/blink.rs,line=39,title=cargo deadlines: slack::watch had "),
        "{annotation}"
    );
}

#[test]
fn findings_are_annotations_and_sarif() {
    let said = with_table("spin", Target::V7, "blink", &["--format", "github"]);
    assert_eq!(said.code, 1);
    let lines: Vec<&str> = said
        .out
        .lines()
        .filter(|line| line.starts_with("::error "))
        .collect();
    assert!(lines[0].contains("src/bin/spin.rs,line="), "{lines:?}");
    assert!(
        lines
            .iter()
            .any(|line| line.contains("title=cargo deadlines: bound::spin.watch has no bound: "))
    );
    let said = with_table("spin", Target::V7, "blink", &["--format", "sarif"]);
    let sarif: serde_json::Value = serde_json::from_str(&said.out).unwrap();
    assert_eq!(sarif["version"], "2.1.0");
    let results = sarif["runs"][0]["results"].as_array().unwrap();
    let watch = results.iter().find(|one| one["ruleId"] == "bound").unwrap();
    assert_eq!(
        watch["locations"][0]["physicalLocation"]["region"]["startLine"],
        39
    );
    assert_eq!(watch["level"], "error");
}

#[test]
fn an_observation_above_its_bound_fails() {
    let path = package().join("seen.csv");
    let file = path.display().to_string();
    let seen = |text: &str| {
        fs::write(&path, text).unwrap();
        with_table("blink", Target::V7, "blink", &["--seen", &file])
    };
    let said = seen("# by DWT_CYCCNT\ntask,cycles\nwatch,20\nwatch, 25\nsample,40\n");
    assert_eq!(said.code, 0, "{said:?}");
    assert!((column(&said, "watch", "seen") - 0.25).abs() < 1e-9);
    let said = seen("watch,9000\n");
    assert_eq!(said.code, 1);
    assert!(said.error.starts_with(
        "not schedulable: blink.watch took 9000 cycles as flashed, more than its bound of "
    ));
    let said = seen("watch,20\n\nwtach,20\n");
    assert_eq!(
        (said.code, said.error.strip_prefix(&file).unwrap()),
        (
            2,
            ":3: there is no task wtach: there are sample, watch, report"
        )
    );
    assert!(
        seen("watch,many\n")
            .error
            .ends_with(":1: `many` is no number of cycles")
    );
}

#[test]
fn a_task_is_explained_and_the_page_is_whole() {
    let said = with_table("blink", Target::V7, "blink", &["--explain", "report"]);
    assert_eq!(said.code, 0);
    let rows = said
        .out
        .lines()
        .skip_while(|line| !line.contains("cycles times"))
        .skip(1);
    let rows: Vec<i64> = rows
        .map_while(|line| line.split_whitespace().next()?.parse().ok())
        .collect();
    let (bound, rows) = rows.split_last().unwrap();
    assert_eq!(rows.iter().sum::<i64>(), *bound);
    assert!(
        said.out
            .starts_with(&format!("blink.report (UART): bound {bound} cycles (")),
        "{}",
        said.out
    );
    let said = with_table("blink", Target::V7, "blink", &["--explain", "reprot"]);
    assert_eq!(
        (said.code, said.error.as_str()),
        (
            2,
            "there is no task reprot: there are sample, watch, report"
        )
    );
    let path = package().join("report.html");
    let file = path.display().to_string();
    assert_eq!(
        with_table("blink", Target::V7, "blink", &["--html", &file]).code,
        0
    );
    let page = fs::read_to_string(&path).unwrap();
    assert!(
        page.starts_with("<!DOCTYPE html>") && page.contains("schedulable: every deadline holds")
    );
    assert!(!page.contains("<script") && !page.contains("href"));
}
