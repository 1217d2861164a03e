//! `cargo deadlines`.

use std::process::ExitCode;

fn main() -> ExitCode {
    deadlines::run(std::env::args_os())
}
