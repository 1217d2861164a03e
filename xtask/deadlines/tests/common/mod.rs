//! The applications, built for their targets, and the command on them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// A change of a source: what it replaces, and by what.
pub(crate) type Change = (&'static str, &'static str);

/// Applications that are others with a change: name, that of the other, changes.
const CHANGED: [(&str, &str, &[Change]); 22] = [
    (
        "logs",
        "blink",
        &[(
            "output(input() >> 3);",
            "apps::mask();\n        output(input() >> 3);\n        apps::unmask();",
        )],
    ),
    // Idle code that logs by a pointer.
    (
        "idle_logs",
        "blink",
        &[(
            "    #[cfg(feature = \"extra\")]",
            "    #[idle]\n    fn idle(_: idle::Context) -> ! {\n        loop {\n            apps::mask();\n            \
             apps::record(input() as u8);\n            apps::unmask();\n        }\n    }\n\n    \
             #[cfg(feature = \"extra\")]",
        )],
    ),
    (
        "forgets",
        "blink",
        &[(
            "output(input() >> 3);",
            "apps::mask();\n        apps::forget();\n        apps::unmask();",
        )],
    ),
    (
        "asks",
        "blink",
        &[(
            "output(input() >> 3);",
            "unsafe { core::arch::asm!(\"bkpt 0xab\", inout(\"r0\") input() => _, in(\"r1\") 0) };",
        )],
    ),
    // That the command itself builds, also with another feature.
    ("project", "blink", &[]),
    (
        "spin",
        "blink",
        &[("output(input() >> 3);", "while input() & 1 == 0 {}")],
    ),
    // A wait without a bound, and a count behind it.
    (
        "waits",
        "blink",
        &[(
            "output(input() >> 3);",
            "apps::wait();\n        for turn in 0..2000 {\n            output(input() ^ turn);\n        }",
        )],
    ),
    // An annotation that is not true.
    (
        "lies",
        "blink",
        &[(
            "output(input() >> 3);",
            "let mut left = input();\n        // loop-bound: 2. So it says.\n        \
             while left != 0 {\n            left &= left - 1;\n            output(left | 1);\n        }",
        )],
    ),
    // A wait that no run ends, whatever its annotation says.
    (
        "stuck",
        "blink",
        &[(
            "output(input() >> 3);",
            "output(0);\n        // loop-bound: 2. So it says.\n        while input() != 7 {}",
        )],
    ),
    // A store to an unknown address before a priority is set by a read and a write.
    (
        "stores",
        "compare",
        &[
            ("output(input() / 3);", "output(input() >> 3);"),
            (
                "Mono::start(&mut cx.core.NVIC);",
                "unsafe { core::ptr::with_exposed_provenance_mut::<u32>(input() as usize).write_volatile(1) };\n        \
             Mono::start(&mut cx.core.NVIC);",
            ),
        ],
    ),
    // A log before a priority is set by a read and a write.
    (
        "early",
        "compare",
        &[
            ("output(input() / 3);", "output(input() >> 3);"),
            (
                "Mono::start(&mut cx.core.NVIC);",
                "apps::mask();\n        apps::unmask();\n        Mono::start(&mut cx.core.NVIC);",
            ),
        ],
    ),
    (
        "handler",
        "blink",
        &[(
            "    #[cfg(feature = \"extra\")]",
            "    #[unsafe(no_mangle)]\n    unsafe extern \"C\" fn SOFT_A() {\n        output(1);\n    }\n\n    \
             #[cfg(feature = \"extra\")]",
        )],
    ),
    // The instruction that calls a supervisor, here a task.
    (
        "calls",
        "blink",
        &[
            (
                "output(input() >> 3);",
                "unsafe { core::arch::asm!(\"svc 0\") };",
            ),
            (
                "    #[cfg(feature = \"extra\")]",
                "    #[task(binds = SVCall, priority = 3)]\n    fn call(_: call::Context) {\n        output(1);\n    }\n\n    \
                 #[cfg(feature = \"extra\")]",
            ),
        ],
    ),
    // A timer that its tasks preempt.
    (
        "late_timer",
        "timed",
        &[(
            "Mono::start(cx.core.SYST, apps::CORE_HZ);",
            "Mono::start(cx.core.SYST, apps::CORE_HZ);\n        let mut system = cx.core.SCB;\n        \
             unsafe { system.set_priority(cortex_m::peripheral::scb::SystemHandler::SysTick, 0xf0) };",
        )],
    ),
    (
        "float",
        "blink",
        &[(
            "output(input() >> 3);",
            "output((input() as f32 * 1.5) as u32);",
        )],
    ),
    (
        "disables",
        "blink",
        &[(
            "output(input() >> 3);",
            "cortex_m::peripheral::NVIC::mask(Interrupt::TIM_A);",
        )],
    ),
    // Two tasks on one dispatcher.
    (
        "shared",
        "pump",
        &[
            (
                "let _ = display::spawn();",
                "let _ = display::spawn();\n        let _ = heartbeat::spawn();",
            ),
            (
                "    /// Shows the level.",
                "    #[task(priority = 1)]\n    async fn heartbeat(_: heartbeat::Context) {\n        \
                 // loop-bound: 1. Each turn ends in a delay.\n        loop {\n            \
                 output(1);\n            Mono::delay(250.millis()).await;\n        }\n    }\n\n    \
                 /// Shows the level.",
            ),
        ],
    ),
    (
        "longer",
        "masks",
        &[("ROUNDS: u32 = 3", "ROUNDS: u32 = 30")],
    ),
    (
        "unlocked",
        "masks",
        &[
            ("slow.lock(|slow| *slow = *fast);", ""),
            ("let (mut fast, mut slow)", "let (mut fast, _)"),
        ],
    ),
    (
        "stays",
        "masks",
        &[(
            "cx.shared.slow.lock(|slow| *slow = input());",
            "cx.shared.slow.lock(|slow| *slow = input());\n        \
             cortex_m::peripheral::NVIC::mask(apps::Interrupt::TIM_A);",
        )],
    ),
    (
        "guess",
        "masks",
        &[(
            "cx.shared.slow.lock(|slow| *slow = input());",
            "cx.shared.slow.lock(|slow| *slow = input());\n        \
             cortex_m::peripheral::NVIC::mask(apps::Interrupt::TIM_A);\n        \
             unsafe { (*cortex_m::peripheral::NVIC::PTR).iser[0].write(input()) };",
        )],
    ),
    (
        "given_back",
        "masks",
        &[(
            "cx.shared.slow.lock(|slow| *slow = input());",
            "cx.shared.slow.lock(|slow| *slow = input());\n        \
             cortex_m::peripheral::NVIC::mask(apps::Interrupt::TIM_A);\n        \
             unsafe { cortex_m::peripheral::NVIC::unmask(apps::Interrupt::TIM_A) };",
        )],
    ),
];

/// A core that the applications are built for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Target {
    /// With BASEPRI: Cortex-M3 and Cortex-M4.
    V7,
    /// Without it: Cortex-M0 and Cortex-M0+.
    V6,
}

impl Target {
    const fn feature(self) -> &'static str {
        match self {
            Self::V7 => "v7",
            Self::V6 => "v6",
        }
    }

    pub(crate) const fn triple(self) -> &'static str {
        match self {
            Self::V7 => "thumbv7em-none-eabihf",
            Self::V6 => "thumbv6m-none-eabi",
        }
    }
}

fn here() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests"))
}

/// The package with all applications, built once for both targets.
pub(crate) fn package() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let template = here().join("apps");
        let package = Path::new(env!("CARGO_TARGET_TMPDIR")).join("apps");
        copy(&template, &package);
        let programs = package.join("src/bin");
        for (name, of, changes) in CHANGED {
            let source = fs::read_to_string(template.join(format!("src/bin/{of}.rs"))).unwrap();
            let changed = changes.iter().fold(source, |source, (from, to)| {
                assert!(source.contains(from), "{name}: {from}");
                source.replace(from, to)
            });
            update(&programs.join(format!("{name}.rs")), &changed);
        }
        for target in [Target::V7, Target::V6] {
            let status = cargo()
                .current_dir(&package)
                .args(["build", "--quiet", "--release", "--bins"])
                .env("CARGO_PROFILE_RELEASE_STRIP", "none")
                .args(["--features", target.feature()])
                .args(["--target", target.triple()])
                .status()
                .unwrap();
            assert!(
                status.success(),
                "the applications do not build for {target:?}"
            );
        }
        package
    })
}

/// Cargo without what a test run adds to its environment.
fn cargo() -> Command {
    let mut cargo = Command::new(env!("CARGO"));
    clean(&mut cargo);
    cargo
}

fn clean(command: &mut Command) {
    command
        .env_remove("CARGO_TARGET_DIR")
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS");
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let (path, at) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() {
            if entry.file_name() != "target" {
                copy(&path, &at);
            }
        } else {
            update(&at, &fs::read_to_string(&path).unwrap());
        }
    }
}

/// Writes a file unless it is so already, which spares a build.
pub(crate) fn update(path: &Path, text: &str) {
    if fs::read_to_string(path).is_ok_and(|known| known == text) {
        return;
    }
    fs::write(path, text).unwrap();
}

/// The task table of an application of this name.
pub(crate) fn table(name: &str) -> PathBuf {
    here().join(format!("tables/{name}.toml"))
}

/// What a run of the command said.
#[derive(Debug)]
pub(crate) struct Said {
    pub(crate) code: i32,
    pub(crate) out: String,
    /// What it complained of, without the `error: ` before.
    pub(crate) error: String,
}

/// The image of an application.
pub(crate) fn image(name: &str, target: Target) -> PathBuf {
    let target = package().join("target").join(target.triple());
    target.join("release").join(name)
}

/// Runs the command on an application, built already, with further arguments.
pub(crate) fn deadlines(name: &str, target: Target, more: &[&str]) -> Said {
    let image = image(name, target).display().to_string();
    let mut arguments = vec!["--bin", name, "--image", &image];
    // Those of a subcommand follow it.
    let (command, more) = match more.first() {
        Some(&"init") => (&more[..1], &more[1..]),
        _ => (&more[..0], more),
    };
    arguments.splice(0..0, command.iter().copied());
    arguments.extend(more);
    run(&arguments)
}

/// The same with the task table of application `of`.
pub(crate) fn with_table(name: &str, target: Target, of: &str, more: &[&str]) -> Said {
    let table = table(of).display().to_string();
    deadlines(name, target, &[&["--table", &table], more].concat())
}

/// The same with the task table of application `of` after a change.
#[cfg(feature = "emulator")]
pub(crate) fn with_changed(name: &str, of: &str, changes: &[Change], more: &[&str]) -> Said {
    let text = fs::read_to_string(table(of)).unwrap();
    let text = changes.iter().fold(text, |text, (from, to)| {
        assert!(text.contains(from), "{of}: {from}");
        text.replace(from, to)
    });
    let mut file = tempfile::NamedTempFile::with_suffix(".toml").unwrap();
    std::io::Write::write_all(&mut file, text.as_bytes()).unwrap();
    let path = file.path().display().to_string();
    deadlines(name, Target::V7, &[&["--table", &path], more].concat())
}

/// Runs the command with these arguments in the package.
pub(crate) fn run(arguments: &[&str]) -> Said {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cargo-deadlines"));
    clean(&mut command);
    let output = command
        .current_dir(package())
        .arg("deadlines")
        .args(arguments)
        .output()
        .unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    let error = error.trim().strip_prefix("error: ").unwrap_or(error.trim());
    Said {
        code: output.status.code().unwrap(),
        out: String::from_utf8(output.stdout).unwrap(),
        error: error.to_owned(),
    }
}

/// A text with its times and counts left out, which are the compiler's.
pub(crate) fn shape(text: &str) -> String {
    let mut shaped = String::new();
    for line in text.lines() {
        let mut words: Vec<String> = Vec::new();
        for word in line.split_whitespace() {
            let number = word
                .trim_end_matches(['%', ',', ':'])
                .trim_start_matches('(');
            let is_time = number.parse::<f64>().is_ok() && number.contains('.');
            let last = words.last().map(String::as_str);
            let counts = matches!(last, Some("stack" | "of" | "takes" | "bound"))
                && number.parse::<u64>().is_ok();
            if is_time || counts {
                words.push(word.replace(number, "#"));
            } else {
                words.push(word.to_owned());
            }
        }
        shaped.push_str(&words.join(" "));
        shaped.push('\n');
    }
    shaped
}
