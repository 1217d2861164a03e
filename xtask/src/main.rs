//! `cargo xtask`: builds, flashes, simulates and analyses the nodes. See `cargo xtask --help`.

use std::process::ExitCode;

fn main() -> ExitCode {
    xtask::interrupt::clean_up_on_signals();
    xtask::run(std::env::args_os())
}
