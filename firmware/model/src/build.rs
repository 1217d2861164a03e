//! The build script of a vehicle's crate.

use std::error::Error;
use std::path::Path;
use std::process::ExitCode;
use std::{env, fs};

use network_model::generate;

use crate::design;
use crate::overrides::Overrides;
use crate::source::variants_of;
use crate::vehicle::Vehicle;

/// Environment variable with values in place of the manifest's: `KEY=VALUE`, separated by semicolons.
pub const OVERRIDES: &str = "FURROW_SET";

/// Environment variable with the name of the variant whose values count.
pub const VARIANT: &str = "FURROW_VARIANT";

/// Generates the files that a vehicle's crate includes. The crate's folder is the vehicle's
/// folder, or has that of the variant that the environment names.
///
/// | file | what is in it |
/// | --- | --- |
/// | `messages.rs` | message types |
/// | `matrix.rs` | nodes, windows and system matrix |
/// | `safety.rs` | what the manifest says about stops |
/// | `design.rs` | the machine's numbers and the settings of its control law |
/// | `guarded.rs` | the nodes that the bus guardian guards; none if the manifest has no guardian |
///
/// Also passes the linker scripts of the images to the linker, sets the log level, and sets the
/// configuration `event_triggered` where the nodes send at once, `row_guidance` where rows guide a
/// run without a fix, `planner` where a planner may lead runs, `mission` where runs drive missions, and `tilt` where an
/// inertial sensor measures roll and pitch. Reports an error in the folder in one sentence.
#[must_use]
pub fn run() -> ExitCode {
    match write() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            println!("cargo::error={}", error.to_string().replace('\n', "; "));
            ExitCode::FAILURE
        }
    }
}

/// The values that the environment names.
fn overrides() -> Result<Overrides, String> {
    let text = env::var(OVERRIDES).unwrap_or_default();
    Overrides::parse(&text).map_err(|error| format!("{OVERRIDES}: {error}"))
}

fn write() -> Result<(), Box<dyn Error>> {
    let of = |name: &str| env::var_os(name).ok_or(format!("cargo sets no {name}"));
    let (folder, out) = (of("CARGO_MANIFEST_DIR")?, of("OUT_DIR")?);
    let (folder, out) = (Path::new(&folder), Path::new(&out));
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=vehicle.toml");
    println!("cargo::rerun-if-changed=network.dbc");
    println!("cargo::rerun-if-env-changed={OVERRIDES}");
    println!("cargo::rerun-if-env-changed={VARIANT}");
    println!(
        "cargo::rustc-check-cfg=cfg(event_triggered, row_guidance, planner, mission, sessions, tilt)"
    );
    let variant = env::var(VARIANT).ok().filter(|name| !name.is_empty());
    let folder = match variant {
        None => folder.to_owned(),
        Some(name) => variants_of(folder).join(name),
    };
    let vehicle = Vehicle::read_with(&folder, &overrides()?)?;
    println!(
        "cargo::rerun-if-changed={}",
        vehicle.manifest_file().display()
    );
    if vehicle.is_event_triggered() {
        println!("cargo::rustc-cfg=event_triggered");
    }
    if vehicle.manifest().guidance_by_rows().is_some() {
        println!("cargo::rustc-cfg=row_guidance");
    }
    if vehicle.manifest().leading_planner().is_some() {
        println!("cargo::rustc-cfg=planner");
    }
    if vehicle.manifest().missions().is_some() {
        println!("cargo::rustc-cfg=mission");
    }
    if vehicle.manifest().inertial().is_some() {
        println!("cargo::rustc-cfg=tilt");
    }
    if vehicle.manifest().has_sessions() {
        println!("cargo::rustc-cfg=sessions");
    }
    for file in vehicle.network_supplements() {
        println!("cargo::rerun-if-changed={}", file.display());
    }
    let guardian = vehicle.manifest().guardian.as_ref();
    fs::write(out.join("guarded.rs"), design::guarded(guardian))?;
    let network = vehicle.network();
    fs::write(out.join("messages.rs"), generate::messages(network))?;
    fs::write(out.join("matrix.rs"), generate::matrix(network))?;
    fs::write(
        out.join("safety.rs"),
        design::safety(vehicle.manifest().safety),
    )?;
    fs::write(out.join("design.rs"), design::source(&vehicle)?)?;
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        // The scripts of cortex-m-rt and defmt.
        for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
            println!("cargo::rustc-link-arg-bins={argument}");
        }
    }
    println!("cargo::rerun-if-env-changed=DEFMT_LOG");
    if env::var_os("DEFMT_LOG").is_none() {
        println!("cargo::rustc-env=DEFMT_LOG=info");
    }
    Ok(())
}
