//! An invalid matrix fails the build, and the compiler's message names the window.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Changes that make a valid matrix invalid: name, text to replace, replacement,
/// message of the compiler.
const GOOD: &str = r#"
use ttcan::{Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window};

const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: Micros::millis(10),
    cycles: 4,
    reference: Id::constant::<96>(),
    reference_format: ReferenceFormat::LEVEL_2,
    masters: &[NodeId(0), NodeId(1)],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::micros(0),
    windows: &[
        Window::exclusive("speed", Micros::millis(1), Micros::millis(1), Id::constant::<200>(), 8, NodeId(0)),
        Window::exclusive("angle", Micros::millis(2), Micros::millis(1), Id::constant::<201>(), 8, NodeId(1)),
    ],
    events: &[],
});

ttcan::schedule!(static SCHEDULE = MATRIX);

fn main() {
    let _ = SCHEDULE.view();
}
"#;

const BAD: [(&str, &str, &str, &str); 9] = [
    (
        "too_short",
        "Micros::millis(2), Micros::millis(1)",
        "Micros::millis(2), Micros::micros(623)",
        "window `angle`: is 623 us long, but its longest frame with the transmit enable window \
         and the synchronisation uncertainty needs 624 us",
    ),
    (
        "overlapping",
        "Micros::millis(2), Micros::millis(1)",
        "Micros::micros(1999), Micros::millis(1)",
        "window `angle`: overlaps `speed` in basic cycle 0",
    ),
    (
        "two_senders",
        "<201>(), 8, NodeId(1)",
        "<200>(), 8, NodeId(1)",
        "window `angle`: and `speed` give one identifier two senders, lengths or kinds",
    ),
    (
        "two_lengths",
        "<201>(), 8, NodeId(1)",
        "<200>(), 7, NodeId(0)",
        "window `angle`: and `speed` give one identifier two senders, lengths or kinds",
    ),
    (
        "two_ranks",
        "&[NodeId(0), NodeId(1)]",
        "&[NodeId(1), NodeId(1)]",
        "node 1 has two ranks among the potential masters",
    ),
    (
        "three_cycles",
        "cycles: 4",
        "cycles: 3",
        "3 basic cycles, but the count must be 1, 2, 4, 8, 16, 32 or 64",
    ),
    (
        "out_of_order",
        "Micros::millis(1), Micros::millis(1)",
        "Micros::millis(3), Micros::millis(1)",
        "window `angle`: begins before `speed`, which stands before it in the list",
    ),
    (
        "repeat_factor",
        "<201>(), 8, NodeId(1))",
        "<201>(), 8, NodeId(1)).every(8, 0)",
        "window `angle`: repeat factor 8 is no power of two of at most the number of basic cycles",
    ),
    (
        "past_the_end",
        "Micros::millis(2), Micros::millis(1)",
        "Micros::millis(9), Micros::millis(1)",
        "window `angle`: ends when the next reference message may begin",
    ),
];

fn check(package: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO"))
        .current_dir(package)
        .args(["check", "--offline", "--quiet", "--color=never"])
        .args(arguments)
        .env("CARGO_TARGET_DIR", package.join("target"))
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        .output()
        .expect("cargo runs")
}

#[test]
fn a_bad_matrix_fails_the_build_and_the_message_names_the_window() {
    let package = Path::new(env!("CARGO_TARGET_TMPDIR")).join("build_fails");
    let programs = package.join("src/bin");
    fs::create_dir_all(&programs).unwrap();
    let manifest = format!(
        "[package]\nname = \"bad\"\nversion = \"0.0.0\"\nedition = \"2024\"\n\
         [dependencies]\nttcan = {{ path = {:?} }}\n[workspace]\n",
        env!("CARGO_MANIFEST_DIR")
    );
    fs::write(package.join("Cargo.toml"), manifest).unwrap();
    fs::write(programs.join("good.rs"), GOOD).unwrap();
    for (name, from, to, _) in BAD {
        assert_eq!(GOOD.matches(from).count(), 1, "{name}");
        fs::write(programs.join(format!("{name}.rs")), GOOD.replace(from, to)).unwrap();
    }

    let good = check(&package, &["--bin", "good"]);
    let said = String::from_utf8_lossy(&good.stderr);
    assert!(good.status.success(), "{said}");

    for (name, _, _, message) in BAD {
        let bad = check(&package, &["--bin", name]);
        let said = String::from_utf8_lossy(&bad.stderr);
        assert!(!bad.status.success(), "{name} builds");
        assert!(said.contains(message), "{name}: {said}");
    }
}
