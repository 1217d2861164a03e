//! Writes the message types and the system matrix from the network file.

use std::{env, error::Error, fs, path::Path, process::ExitCode};

use network_model::{Network, generate};

const FILE: &str = "../vehicles/uagv/network.dbc";

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            for line in error.to_string().lines() {
                println!("cargo::error={FILE}: {line}");
            }
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed={FILE}");
    let network = Network::parse(&fs::read_to_string(FILE)?)?;
    let out = env::var_os("OUT_DIR").ok_or("cargo sets no OUT_DIR")?;
    let out = Path::new(&out);
    fs::write(out.join("messages.rs"), generate::messages(&network))?;
    fs::write(out.join("matrix.rs"), generate::matrix(&network))?;
    Ok(())
}
