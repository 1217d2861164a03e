//! `bench`: what protocol stack and control step cost on a Cortex-M4: cycles of an
//! emulated core, bytes of code, bytes of RAM.

pub mod control;
pub mod cycles;
pub mod kernels;
pub mod row;
pub mod size;

use std::{env, fmt::Write, io, path::PathBuf, process::Stdio};

use ::control::{
    controller::Settings,
    vehicle::{Refusal, source},
};
use schedulability::results::KernelReport;
use serde_json::{Value, json};
use twin::image::ImageError;
use vehicle_model::Vehicle;

use crate::{Failure, ReadError, Workspace, build, cli::Bench, target, vehicle};

/// Why a measurement fails.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A program does not build.
    #[error("the program `{program}` ({parts}) did not build")]
    NotBuilt {
        /// Its name.
        program: String,
        /// The choice of its parts.
        parts: &'static str,
    },
    /// A program is no image.
    #[error("{program}: {error}")]
    Image {
        /// What it is.
        program: &'static str,
        /// What is wrong with it.
        #[source]
        error: ImageError,
    },
    /// A program does not reach its waiting place.
    #[error("{program} does not start")]
    NoStart {
        /// What it is.
        program: &'static str,
    },
    /// A program lacks a function.
    #[error("the program has no function `{name}`")]
    NoFunction {
        /// Its name.
        name: String,
    },
    /// A function does not return.
    #[error("no return from {address:#010x}")]
    NoReturn {
        /// Where it is.
        address: u32,
    },
    /// An event did not happen.
    #[error("the event `{event}` ({size} windows) did not come about")]
    NoEvent {
        /// The event.
        event: String,
        /// How many windows the schedule has.
        size: String,
    },
    /// A part of the control step did nothing.
    #[error("the part `{part}` of the control step did not do its work")]
    Idle {
        /// The part.
        part: String,
    },
    /// A part of the step between two rows has no bound.
    #[error("the part `{part}` of the step between two rows has no bound: {problem}")]
    NoBound {
        /// The part.
        part: String,
        /// What the analysis cannot follow.
        problem: String,
    },
    /// A part of the step between two rows ran for longer than its bound.
    #[error("the part `{part}` takes more than its bound: the analysis is unsound")]
    Unsound {
        /// The part.
        part: String,
    },
    /// The program whose bytes are counted has another shape.
    #[error("the program `node` ({parts}) is not as expected")]
    Unexpected {
        /// The choice of its parts.
        parts: &'static str,
    },
    /// A program with another protocol stack cannot be measured.
    #[error("{} cannot be measured: {error} (ttcan/benches/peers/README.md says what it must have)", path.display())]
    Elf {
        /// The file.
        path: PathBuf,
        /// Why not.
        #[source]
        error: Box<Error>,
    },
    /// A file cannot be read.
    #[error("it cannot be read: {0}")]
    Unreadable(io::Error),
    /// A file is no image.
    #[error("{0}")]
    NoImage(ImageError),
    /// A file is larger than a program for a microcontroller can be.
    #[error("it is larger than {most} bytes")]
    Large {
        /// How large it may be.
        most: u64,
    },
    /// A file cannot be written.
    #[error("{} cannot be written: {error}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why not.
        #[source]
        error: io::Error,
    },
    /// The vehicle has no settings of a control law.
    #[error("{}: {error}", path.display())]
    Settings {
        /// Its manifest.
        path: PathBuf,
        /// What is wrong with it.
        #[source]
        error: Refusal,
    },
    /// The kernels of the execution-time analysis.
    #[error(transparent)]
    Kernels(#[from] kernels::Error),
}

impl Error {
    /// Whether the command line or an input file is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        matches!(self, Self::Settings { .. } | Self::Elf { .. })
    }
}

/// The package with the stack's programs, from the root of the workspace.
const STACK: &str = "ttcan/benches/image/Cargo.toml";
/// The package with the programs of the control step.
const CONTROL: &str = "control/benches/image/Cargo.toml";

/// A choice of the optional parts of the stack.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Parts {
    /// What a node with it can do.
    pub name: &'static str,
    /// Features of `ttcan`, with commas.
    pub features: &'static str,
}

/// Everything, as by default.
pub const EVERYTHING: Parts = Parts {
    name: "everything",
    features: "counters,events,gaps,global-time,master,peers",
};
/// A node of level 1 that is never master.
pub const LEAST: Parts = Parts {
    name: "level 1, never master, nothing else",
    features: "",
};
/// The choices whose sizes are measured.
pub const CHOICES: [Parts; 7] = [
    EVERYTHING,
    Parts {
        name: "everything but counters",
        features: "events,gaps,global-time,master,peers",
    },
    Parts {
        name: "never master, level 2, events, peers, counters",
        features: "counters,events,global-time,peers",
    },
    Parts {
        name: "master, level 2",
        features: "global-time,master",
    },
    Parts {
        name: "master, level 1",
        features: "master",
    },
    Parts {
        name: "never master, level 2",
        features: "global-time",
    },
    LEAST,
];

/// How the compiler optimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Profile {
    /// As the vehicle's images: `opt-level = 2`.
    Release,
    /// For size: `opt-level = "s"`.
    Small,
}

impl Profile {
    fn name(self) -> &'static str {
        match self {
            Self::Release => "release",
            Self::Small => "small",
        }
    }
}

/// Builds the programs.
#[derive(Debug)]
pub struct Builder<'w> {
    workspace: &'w Workspace,
    /// File with the settings of the control law; none: those of an example.
    settings: Option<PathBuf>,
}

impl<'w> Builder<'w> {
    /// Finds the target.
    ///
    /// # Errors
    ///
    /// It is not there and cannot be installed.
    pub fn new(workspace: &'w Workspace) -> Result<Self, Failure> {
        Ok(Self {
            workspace,
            settings: None,
        })
    }

    /// The target folder of the programs.
    fn folder(&self) -> PathBuf {
        env::var_os("CARGO_TARGET_DIR")
            .map_or_else(|| self.workspace.root().join("target"), PathBuf::from)
            .join("bench")
    }

    /// The same with the settings of a control law, as Rust source.
    fn with_settings(self, source: &str) -> Result<Self, Failure> {
        let file = self.folder().join("settings.rs");
        let written = std::fs::create_dir_all(self.folder())
            .and_then(|()| std::fs::write(&file, source))
            .and_then(|()| file.canonicalize());
        let file = written.map_err(|error| Error::Write { path: file, error })?;
        Ok(Self {
            settings: Some(file),
            ..self
        })
    }

    /// Builds the program whose events are measured. Returns the path of its ELF file.
    ///
    /// # Errors
    ///
    /// It does not build.
    pub fn events(&self, parts: Parts) -> Result<PathBuf, Failure> {
        self.file(STACK, "cycles", parts, Profile::Release)
    }

    /// Builds a program of the protocol stack. Returns its ELF file.
    fn program(&self, name: &str, parts: Parts, profile: Profile) -> Result<Vec<u8>, Failure> {
        self.build(STACK, name, parts, profile)
    }

    /// Builds a program of a package. Returns its ELF file.
    fn build(
        &self,
        package: &str,
        name: &str,
        parts: Parts,
        profile: Profile,
    ) -> Result<Vec<u8>, Failure> {
        let path = self.file(package, name, parts, profile)?;
        Ok(std::fs::read(&path).map_err(ReadError::of(path))?)
    }

    /// Builds a program of a package. Returns the path of its ELF file.
    fn file(
        &self,
        package: &str,
        name: &str,
        parts: Parts,
        profile: Profile,
    ) -> Result<PathBuf, Failure> {
        let mut cargo = target::cargo(self.workspace, "build");
        cargo.args(["--quiet", "--manifest-path", package, "--bin", name]);
        cargo.args(["--profile", profile.name(), "--features", parts.features]);
        cargo.arg("--target-dir").arg(self.folder());
        if let Some(settings) = &self.settings {
            cargo.env("CONTROL_SETTINGS", settings);
        }
        cargo.arg("--message-format=json-render-diagnostics");
        let output = cargo
            .stderr(Stdio::inherit())
            .output()
            .map_err(build::Error::NoCargo)?;
        let messages = String::from_utf8_lossy(&output.stdout);
        let path = build::executable(&messages, name).filter(|_| output.status.success());
        let not_built = || Error::NotBuilt {
            program: name.into(),
            parts: parts.name,
        };
        Ok(path.ok_or_else(not_built)?)
    }
}

/// Runs the command.
///
/// # Errors
///
/// A program does not build or does not do its work.
pub fn run(workspace: &Workspace, options: &Bench) -> Result<(), Failure> {
    if let Some(path) = &options.elf {
        let costs = cycles::foreign(path)?;
        if options.json {
            println!("{:#}", Value::from(events(&costs)));
        } else {
            print!("{}", foreign(&costs));
        }
        return Ok(());
    }
    let vehicle = vehicle::with(workspace, &options.vehicle, &options.changes.overrides())?;
    let settings = settings(&vehicle)?;
    let builder = Builder::new(workspace)?;
    let cycles = [EVERYTHING, LEAST]
        .into_iter()
        .map(|parts| Ok((parts, cycles::measure(&builder, parts)?)))
        .collect::<Result<Vec<_>, Failure>>()?;
    let guardian = cycles::guardian(&builder)?;
    let sizes = CHOICES
        .into_iter()
        .map(|parts| {
            let small = size::measure(&builder, parts, Profile::Small)?;
            let release = size::measure(&builder, parts, Profile::Release)?;
            Ok((parts, small, release))
        })
        .collect::<Result<Vec<_>, Failure>>()?;
    let kernels = kernels::measure(&builder)?;
    let row = row::measure(&builder)?;
    let step = match settings {
        Some(source) => control::measure(&builder.with_settings(&source)?)?,
        None => Vec::new(),
    };
    if options.json {
        let report = report_json(&cycles, &guardian, &sizes, &step, &row, &kernels);
        println!("{report}");
    } else {
        println!("{}", report(&cycles, &guardian, &sizes));
        if step.is_empty() {
            let name = vehicle.name();
            println!("Vehicle {name:?} has no machine, and no control step.");
        } else {
            print!("{}", control::report(&step));
        }
        print!("\n{}", row::report(&row));
        println!(
            "\nCycles of the execution-time analysis' kernels, without wait states and with five"
        );
        print!("{}", schedulability::report::kernels(&kernels));
    }
    Ok(())
}

/// The settings of a vehicle's control law, as Rust source; `None` without a machine.
fn settings(vehicle: &Vehicle) -> Result<Option<String>, Failure> {
    let Some(description) = vehicle_model::description(vehicle) else {
        return Ok(None);
    };
    let settings = Settings::<f32>::for_vehicle(&description);
    let settings = settings.map_err(|error| Error::Settings {
        path: vehicle.manifest_file(),
        error,
    })?;
    Ok(Some(source(&settings).to_string()))
}

type Cycles = [(Parts, Vec<cycles::Cost>)];
type Guarded = [(&'static str, u64)];
type Sizes = [(Parts, size::Size, size::Size)];

fn report(cycles: &Cycles, guardian: &Guarded, sizes: &Sizes) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_report(&mut out, cycles, guardian, sizes);
    out
}

/// The table of another stack's events.
fn foreign(costs: &[cycles::Cost]) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "Cycles of a Cortex-M4 without wait states")
        .and_then(|()| write_costs(&mut out, costs));
    out
}

fn write_costs(t: &mut String, costs: &[cycles::Cost]) -> std::fmt::Result {
    writeln!(t, "  {:<28}{:>12}{:>14}", "", "8 windows", "512 windows")?;
    for cost in costs {
        writeln!(t, "  {:<28}{:>12}{:>14}", cost.event, cost.few, cost.many)?;
    }
    Ok(())
}

/// Events and their cycles.
fn events(costs: &[cycles::Cost]) -> Vec<Value> {
    costs
        .iter()
        .map(|cost| json!({ "event": cost.event, "8": cost.few, "512": cost.many }))
        .collect()
}

fn write_report(
    t: &mut String,
    cycles: &Cycles,
    guardian: &Guarded,
    sizes: &Sizes,
) -> std::fmt::Result {
    for (parts, costs) in cycles {
        writeln!(
            t,
            "Cycles of a Cortex-M4 without wait states, opt-level 2: {}",
            parts.name
        )?;
        write_costs(t, costs)?;
        writeln!(t)?;
    }
    writeln!(t, "Cycles of a bus guardian of four senders, the same")?;
    for (event, cycles) in guardian {
        writeln!(t, "  {event:<28}{cycles:>12}")?;
    }
    writeln!(
        t,
        "\nBytes of code and constants, and of RAM for a node of 7 windows"
    )?;
    writeln!(t, "  {:<48}{:>6}{:>8}{:>8}", "", "opt s", "opt 2", "RAM")?;
    for (parts, small, release) in sizes {
        writeln!(
            t,
            "  {:<48}{:>6}{:>8}{:>8}",
            parts.name, small.code, release.code, small.ram
        )?;
    }
    if let [(_, small, _), ..] = sizes {
        writeln!(
            t,
            "Not counted: the schedule ({} bytes), memory copy and fill of the compiler ({} bytes).",
            small.schedule, small.runtime
        )?;
    }
    Ok(())
}

fn report_json(
    cycles: &Cycles,
    guardian: &Guarded,
    sizes: &Sizes,
    step: &[control::Cost],
    row: &[row::Cost],
    kernels: &[KernelReport],
) -> String {
    let cycles: Vec<Value> = cycles
        .iter()
        .map(|(parts, costs)| json!({ "features": parts.features, "events": events(costs) }))
        .collect();
    let sizes: Vec<Value> = sizes
        .iter()
        .map(|(parts, small, release)| {
            json!({
                "features": parts.features,
                "code_opt_s": small.code,
                "code_opt_2": release.code,
                "ram": small.ram,
                "schedule": small.schedule,
                "runtime_opt_s": small.runtime,
            })
        })
        .collect();
    let step: Vec<Value> = step
        .iter()
        .map(|cost| {
            json!({
                "part": cost.part,
                "coming": cost.coming.to_array(),
                "there": cost.there.map(wcet::cycles::Cycles::to_array),
                "bound": cost.bound.map(wcet::cycles::Cycles::to_array),
            })
        })
        .collect();
    let row: Vec<Value> = row
        .iter()
        .map(|cost| {
            json!({
                "part": cost.part,
                "seen": cost.seen,
                "bound": cost.bound.to_array(),
                "stack": cost.stack,
            })
        })
        .collect();
    format!(
        "{:#}",
        json!({
            "cycles": cycles,
            "guardian": guardian.iter().map(|(event, cycles)| json!({
                "event": event,
                "cycles": cycles,
            })).collect::<Vec<_>>(),
            "bytes": sizes,
            "control_step": step,
            "row_step": row,
            "kernels": kernels.iter().map(|kernel| json!({
                "name": kernel.name,
                "bound": kernel.bound.to_array(),
                "seen": kernel.seen.to_array(),
            })).collect::<Vec<_>>(),
        })
    )
}
