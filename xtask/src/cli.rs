//! Definition and parsing of the command line.

use std::{ffi::OsString, path::PathBuf, time::Duration};

use clap::{
    ArgMatches, Args, CommandFactory, FromArgMatches, Parser, Subcommand, error::ErrorKind,
};

use schedulability::{can::ErrorRate, foreign::Foreign};
use vehicle_model::{Override, Overrides, Protocol, manifest::Law};
use world::{DURATIONS, SimDuration, time::from_seconds};

use crate::{
    monitor::Source,
    selftest::Bus,
    sim::{Can, SPEEDS, Speed},
    vehicle::{DEFAULT, SMALLEST},
};

/// Builds, flashes, simulates and tests the nodes of the vehicle.
#[derive(Debug, Parser)]
#[command(
    name = "cargo xtask",
    bin_name = "cargo xtask",
    version,
    subcommand_required = true,
    after_help = "Examples:\n  \
        cargo xtask build             all images, with their sizes\n  \
        cargo xtask sim               drive the virtual vehicle down the line\n  \
        cargo xtask flash gps         write the gps image to the connected board\n  \
        cargo xtask run gps           the same, then show its log\n  \
        cargo xtask selftest          ask all nodes on a bus for their self-test\n  \
        cargo xtask test              everything that CI checks\n  \
        cargo xtask build --help      options and examples of one command"
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// A command and its options.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Build release images and compare their sizes with the boards' memories.
    Build(Build),
    /// Write a node's release image to a board with probe-rs.
    Flash(Flash),
    /// Show the log of the node that runs on a board with probe-rs.
    Attach(Attach),
    /// Write a node's release image to a board with probe-rs and show the node's log.
    Run(Run),
    /// Run the release images in the virtual vehicle and report the results.
    Sim(Sim),
    /// Put the parts of a campaign of random faults or attacks together, or let machines run them.
    #[command(subcommand)]
    Campaign(Campaign),
    /// Ask the nodes on a bus for their self-test and show the results.
    Selftest(Selftest),
    /// Make the key of a network, and write it to the nodes.
    Keys(Keys),
    /// Write the folder of a new vehicle.
    New(New),
    /// Draw the figures of the thesis from runs of the release images.
    Figures(Figures),
    /// Show what happened in the log of a CAN bus.
    Analyse(Analyse),
    /// Watch a bus against its schedule, as it happens.
    Monitor(Monitor),
    /// Make missions, and check whether a vehicle can drive them.
    #[command(subcommand)]
    Mission(Mission),
    /// Compute the steering's calibration from a recorded drive.
    Calibrate(Calibrate),
    /// Measure the cycles, code and RAM of the protocol stack and the control step.
    Bench(Bench),
    /// Show the system matrix of a network file, or find another one.
    Schedule(Schedule),
    /// Analyse sources and images: does every task and message meet its deadline?
    Schedulability(Schedulability),
    /// Propose priorities by deadlines and show where the sources differ.
    Priorities(Priorities),
    /// Check everything: format, lints, tests, images, documentation.
    Test(Test),
}

/// Values in place of those of a vehicle's manifest.
#[derive(Debug, Default, Clone, Args)]
pub struct Changes {
    /// Value in place of the manifest's, as rover.law=thesis; may be given again for another one
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// Protocol of the bus: short for --set bus.protocol=PROTOCOL
    #[arg(long, value_name = "PROTOCOL", value_parser = Protocol::named)]
    pub bus: Option<Protocol>,
}

impl Changes {
    /// All of them. [`parse`] sees to it that each has one value.
    #[must_use]
    pub fn overrides(&self) -> Overrides {
        let set: Overrides = self.set.iter().cloned().collect();
        match self.bus {
            Some(protocol) => set.on(protocol),
            None => set,
        }
    }
}

/// Options of `build`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask build                  all nodes\n  \
    cargo xtask build steering drive   two of them\n  \
    cargo xtask build --json           the table as JSON, sizes in bytes\n  \
    cargo xtask build --vehicle two-boards --bus event-triggered\n  \
    cargo xtask build --vehicle row-follower --set rover.law=thesis --set rover.cruise=0.8\n\n\
    The target thumbv7em-none-eabihf is installed when it is missing.")]
pub struct Build {
    /// Nodes to build [default: all]
    #[arg(value_name = "NODE")]
    pub nodes: Vec<String>,
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// Values in place of the manifest's.
    #[command(flatten)]
    pub changes: Changes,
    /// Print the table as JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `flash`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask flash gps                         build, write, verify, start\n  \
    cargo xtask flash motor --vehicle two-boards  a node of another vehicle\n  \
    cargo xtask flash gps --probe 066EFF57        with several boards connected\n  \
    cargo xtask flash feedback --set rover.law=thesis\n  \
    \x20                                             with another law than the manifest's\n  \
    cargo xtask flash gps --dry-run               only print the commands\n\n\
    `probe-rs list` lists the serial numbers of the connected probes.")]
pub struct Flash {
    /// The board.
    #[command(flatten)]
    pub board: OnBoard,
}

/// Options of `attach`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask attach gps                         the log of the running node, until Ctrl-C\n  \
    cargo xtask attach motor --vehicle two-boards  a node of another vehicle\n  \
    cargo xtask attach gps --probe 066EFF57        with several boards connected\n  \
    cargo xtask attach gps --dry-run               only print the command\n\n\
    The node is not reset, but probe-rs halts it for a moment: attach only while the vehicle\n\
    stands. Its image must be that of this tree: the texts of the log are taken from there.\n\
    `probe-rs list` lists the serial numbers of the connected probes.")]
pub struct Attach {
    /// The board.
    #[command(flatten)]
    pub board: OnBoard,
}

/// Options of `run`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask run gps                         build, write, verify, start, log until Ctrl-C\n  \
    cargo xtask run motor --vehicle two-boards  a node of another vehicle\n  \
    cargo xtask run gps --probe 066EFF57        with several boards connected\n  \
    cargo xtask run gps --dry-run               only print the command\n\n\
    `probe-rs list` lists the serial numbers of the connected probes.")]
pub struct Run {
    /// The board.
    #[command(flatten)]
    pub board: OnBoard,
}

/// Options of the commands for a connected board.
#[derive(Debug, Args)]
pub struct OnBoard {
    /// Node whose image is or goes on the board
    #[arg(value_name = "NODE")]
    pub node: String,
    /// Vehicle, when several have a node of that name
    #[arg(long, value_name = "NAME")]
    pub vehicle: Option<String>,
    /// Values in place of the manifest's.
    #[command(flatten)]
    pub changes: Changes,
    /// Serial number of the board's debug probe, when several are connected
    #[arg(long, value_name = "SERIAL")]
    pub probe: Option<String>,
    /// Print the commands instead of running them
    #[arg(long)]
    pub dry_run: bool,
}

/// Options of `keys`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask keys new                   make a key for the UAGV, in .furrow/uagv.key of your home\n  \
    cargo xtask keys flash drive           write it to the connected board, whose image stays\n  \
    cargo xtask keys flash motor --vehicle two-boards --probe 066EFF57\n  \
    cargo xtask keys rotate                another key in its place; then flash every node again\n  \
    cargo xtask keys show --json           the key's number and file as JSON\n  \
    cargo xtask keys erase drive           a node without a key again\n\n\
    With a key the nodes obey only commands of a node that has the same one. A node without a key\n\
    beside nodes with one neither commands nor obeys. No command shows a key.")]
pub struct Keys {
    /// What to do.
    #[command(subcommand)]
    pub action: KeyAction,
}

/// What `keys` does.
#[derive(Debug, Subcommand)]
pub enum KeyAction {
    /// Make a key from the system's random numbers.
    #[command(after_help = "Examples:\n  \
        cargo xtask keys new                        for the UAGV, in .furrow/uagv.key of your home\n  \
        cargo xtask keys new --vehicle sentry       for a variant, which has a key file of its own\n  \
        cargo xtask keys new --file /media/stick/uagv.key\n\n\
        Then write it to every node with `keys flash`.")]
    New(KeyFile),
    /// Replace the key by another one.
    #[command(after_help = "Examples:\n  \
        cargo xtask keys rotate\n  \
        cargo xtask keys rotate --vehicle two-boards\n\n\
        Old and new do not go together: write the new one to every node with `keys flash`.")]
    Rotate(KeyFile),
    /// Show the number of the key and its file, not the key.
    #[command(after_help = "Examples:\n  \
        cargo xtask keys show\n  \
        cargo xtask keys show --vehicle two-boards --json")]
    Show(KeyFile),
    /// Write the key to a node's board with probe-rs.
    #[command(after_help = "Examples:\n  \
        cargo xtask keys flash drive              the connected board; its image stays\n  \
        cargo xtask keys flash motor --vehicle two-boards --probe 066EFF57\n  \
        cargo xtask keys flash drive --file /media/stick/uagv.key\n  \
        cargo xtask keys flash rows --set row_guidance.enabled=true\n  \
        \x20                                         a node that is off in the manifest\n  \
        cargo xtask keys flash drive --dry-run    only print the commands")]
    Flash(KeyNode),
    /// Erase the key on a node's board with probe-rs.
    #[command(after_help = "Examples:\n  \
        cargo xtask keys erase drive              a node without a key again; its image stays\n  \
        cargo xtask keys erase motor --vehicle two-boards --probe 066EFF57\n  \
        cargo xtask keys erase drive --dry-run    only print the commands")]
    Erase(KeyNode),
}

/// The file of a key.
#[derive(Debug, Args)]
pub struct KeyFile {
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// File of the key, outside the workspace [default: .furrow/VEHICLE.key in your home directory]
    #[arg(long, value_name = "FILE")]
    pub file: Option<PathBuf>,
    /// Print number and file as JSON
    #[arg(long)]
    pub json: bool,
}

/// The board whose key is written.
#[derive(Debug, Args)]
pub struct KeyNode {
    /// Node on the board
    #[arg(value_name = "NODE")]
    pub node: String,
    /// Vehicle, when several have a node of that name
    #[arg(long, value_name = "NAME")]
    pub vehicle: Option<String>,
    /// Values in place of the manifest's.
    #[command(flatten)]
    pub changes: Changes,
    /// File of the key [default: .furrow/VEHICLE.key in your home directory]
    #[arg(long, value_name = "FILE")]
    pub file: Option<PathBuf>,
    /// Serial number of the board's debug probe, when several are connected
    #[arg(long, value_name = "SERIAL")]
    pub probe: Option<String>,
    /// Print the commands instead of running them
    #[arg(long)]
    pub dry_run: bool,
}

/// Options of `selftest`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask selftest                                      the nodes of the virtual vehicle\n  \
    cargo xtask selftest --vehicle uagv --bus socketcan:can0  those of a real one, by SocketCAN\n  \
    cargo xtask selftest --vehicle two-boards --bus slcan:/dev/ttyACM0\n  \
    \x20                                                         by a serial adapter\n  \
    cargo xtask selftest --running                            without a start\n  \
    cargo xtask selftest --node drive steering --json         two nodes, as JSON\n  \
    cargo xtask selftest --set row_guidance.enabled=true      also the node that finds crop rows\n\n\
    All nodes whose motor does not turn start again and do all checks. With --running, with a key, or\n\
    while its motor may turn, a node repeats the results of its last start and checks the rest.\n\
    The request is sent in its window of the schedule, so a time master must lead the bus.\n\
    For SocketCAN: sudo ip link set can0 up type can bitrate 250000\n\n\
    Exit code 0: every node reported, and no check failed; 1: a check failed or a node is silent,\n\
    and what to look at first is shown; 2: wrong input.")]
pub struct Selftest {
    /// Vehicle, a folder below firmware/vehicles [default on the virtual bus: uagv]; a real bus
    /// needs it when there are several
    #[arg(long, value_name = "NAME")]
    pub vehicle: Option<String>,
    /// Value in place of the manifest's, as row_guidance.enabled=true; may be given again for another one
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// Nodes that must report; the others may be absent [default: all]
    #[arg(long = "node", value_name = "NODE", num_args = 1..)]
    pub nodes: Vec<String>,
    /// Where the nodes are.
    #[arg(
        long,
        value_name = "BUS",
        default_value = "twin",
        help = "Where the nodes are: twin, socketcan:INTERFACE or slcan:PORT[@BAUD]"
    )]
    pub bus: Bus,
    /// Ask without a start: the start-up checks are not done again
    #[arg(long)]
    pub running: bool,
    /// Print the results as JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `new`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask new vehicle sprayer                two boards on a bench, without a machine\n  \
    cargo xtask new vehicle sprayer --like uagv    four nodes, a steered and driven machine\n  \
    cargo xtask new vehicle scout --like row-follower\n  \
    \x20                                              three nodes, a robot between crop rows\n  \
    cargo xtask new vehicle sprayer --like uagv --variant\n  \
    \x20                                              a machine of other numbers with the UAGV's nodes\n\n\
    The folder firmware/vehicles/NAME builds and runs at once; see firmware/PORTING.md for what\n\
    to do next.")]
pub struct New {
    /// What to make
    #[arg(value_name = "KIND", value_enum)]
    pub kind: Kind,
    /// Name of the vehicle, its folder and its package
    #[arg(value_name = "NAME")]
    pub name: String,
    /// Vehicle to copy, a folder below firmware/vehicles
    #[arg(long, value_name = "VEHICLE", default_value = SMALLEST)]
    pub like: String,
    /// Copy the numbers of its machine only: nodes, network, tasks and scenarios stay those of --like
    #[arg(long)]
    pub variant: bool,
    /// Print folder and nodes as JSON
    #[arg(long)]
    pub json: bool,
}

/// What `new` makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// A vehicle's folder.
    Vehicle,
}

/// Options of `sim`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask sim                                straight-line, figures on the terminal\n  \
    cargo xtask sim gps-lost --seed 7 --out run    and run/run.html, which plays the run; bus.log, states.csv, ...\n  \
    cargo xtask sim my.toml --seconds 30 --json    a scenario of your own, figures as JSON\n  \
    cargo xtask sim departures/steering-reversed   a vehicle that does not do what it is told, and is stopped\n  \
    cargo xtask sim --list                         the scenarios of the vehicle\n  \
    cargo xtask sim poles --vehicle row-follower --law thesis --out run\n                                                 \
    \x20 a robot between rows; run/row.svg shows its way\n  \
    cargo xtask sim straight-line --law thesis --gain-scale 0.5\n                                                 \
    \x20 under the thesis's law, with half its gains\n  \
    cargo xtask sim --vehicle two-boards --bus event-triggered\n                                                 \
    \x20 messages are sent at once instead of in their windows\n  \
    cargo xtask sim --mission field.toml --seconds 300   a mission, with headland turns\n  \
    cargo xtask sim --experiment thesis-7          many runs, checked against aims; --quick: no images\n  \
    cargo xtask sim --experiment thesis-7 --out thesis --resume\n                                                 \
    \x20 goes on with it where it was interrupted\n  \
    cargo xtask sim --can slcan:target/bus           other programs join the bus: slcand, python-can, SavvyCAN,\n                                                 \
    \x20 cargo xtask selftest --bus slcan:target/bus\n  \
    cargo xtask sim --watch                        the run on the terminal, as it happens; --watch=10 faster\n  \
    cargo xtask sim --faults 200                   random faults\n  \
    cargo xtask sim --faults 800 --shard 1/8 --out parts --resume\n                                                 \
    \x20 an eighth of them, which goes on where it was interrupted; see campaign merge\n  \
    cargo xtask sim --faults 200 --attacker        a node that knows the sources, but not the key: floods,\n                                                 \
    \x20 forged and replayed frames, destroyed ones\n  \
    cargo xtask sim --gdb controller               gdb debugs the controller, forwards and backwards:\n                                                 \
    \x20 it prints the command for gdb-multiarch; then `monitor help`\n  \
    cargo xtask sim gps-lost --gdb steering:4444 --until mode:Idle\n                                                 \
    \x20 runs until the mode changes to Idle before gdb is let in\n\n\
    Experiments:\n  \
    thesis-7   the track tests of the thesis, chapter 7, with its control law for comparison;\n             \
    exit code 1 and the names of the aims that are missed\n  \
    thesis-machine\n             \
    the same on a machine fitted to the thesis's: its law has the thesis's figures there\n  \
    row-limits how long a gap and how many leaves a row follower drives through, with its\n             \
    law alone; with --out also the picture row-limits.svg\n  \
    thesis-2   its rows, chapter 2 (--vehicle row-follower), under its law and under Furrow's; exit\n             \
    code 1 if its law does not have its figures\n  \
    field      one hectare in 34 swaths with headland turns, at 1 and 2 m/s (and as fast as the vehicle\n             \
    drives), from the flash of the images; exit code 1 if a limit is missed; --seeds 5 --out DIR\n             \
    with pictures of the field; an hour for each run, --quick a minute\n  \
    event-or-time\n             \
    the time from sample to motor on an event-triggered and on a time-triggered bus (--vehicle\n             \
    row-follower), beside foreign load; exit code 1 if a bound of the analysis does not hold\n\n\
    Exit code 0: the run shows what its scenario expects, and an experiment reaches its aims; 1: it does\n\
    not, and the first is named; 2: wrong input.")]
pub struct Sim {
    /// Name of one of the vehicle's scenarios, or the path of a TOML file [default: the
    /// vehicle's straight-line, or its first scenario]
    #[arg(value_name = "SCENARIO")]
    pub scenario: Option<String>,
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// Values in place of the manifest's.
    #[command(flatten)]
    pub changes: Changes,
    /// Simulated time in seconds [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = seconds, allow_hyphen_values = true)]
    pub seconds: Option<SimDuration>,
    /// Seed of all random numbers: noise, clock errors
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = whole::<u64>(0..=u64::MAX),
        allow_hyphen_values = true
    )]
    pub seed: u64,
    /// The law that steers: furrow or thesis [default: the scenario's, or else the manifest's]
    #[arg(long, value_name = "LAW", value_parser = law, conflicts_with_all = ["experiment", "faults", "list"])]
    pub law: Option<Law>,
    /// Multiply the gains of the thesis's law by this number
    #[arg(long, value_name = "FACTOR", value_parser = factor, allow_hyphen_values = true,
        conflicts_with_all = ["experiment", "faults", "list"])]
    pub gain_scale: Option<f64>,
    /// Mission that the vehicle has in its flash [default: none, it drives the line of its waypoints]
    #[arg(long, value_name = "FILE", conflicts_with_all = ["experiment", "faults", "list", "gdb", "law"])]
    pub mission: Option<PathBuf>,
    /// Run an experiment instead: scenarios with many seeds, checked against aims
    #[arg(long, value_name = "NAME", group = "many", conflicts_with_all = ["scenario", "seconds", "list"])]
    pub experiment: Option<String>,
    /// Number of seeds of an experiment, from --seed upwards
    #[arg(long, value_name = "N", default_value_t = 20, requires = "experiment",
        conflicts_with_all = ["scenario", "seconds", "faults"],
        value_parser = whole::<u64>(1..=1000))]
    pub seeds: u64,
    /// Run an experiment with the control law alone, without images and bus: seconds
    /// instead of an hour
    #[arg(long, requires = "experiment", conflicts_with_all = ["scenario", "seconds", "faults"])]
    pub quick: bool,
    /// Run N random fault sequences instead, with seeds from --seed upwards, and report
    /// those that broke a rule
    #[arg(long, value_name = "N", group = "many",
        conflicts_with_all = ["scenario", "seconds", "list", "experiment"],
        allow_hyphen_values = true, value_parser = whole::<u64>(1..=100_000_000))]
    pub faults: Option<u64>,
    /// In the fault sequences, an attacker on the bus of a vehicle with a key: it floods, forges, replays
    /// and destroys frames, and forges the time
    #[arg(long, requires = "faults", conflicts_with_all = ["scenario", "seconds", "experiment"])]
    pub attacker: bool,
    /// Run only the I-th of N parts of the fault sequences
    #[arg(long, value_name = "I/N", requires = "faults",
        conflicts_with_all = ["scenario", "seconds", "experiment"])]
    pub shard: Option<campaign::Shard>,
    /// Go on with fault sequences or with an experiment that was interrupted: what is done stands in the folder of
    /// --out
    #[arg(long, requires_all = ["many", "out"], conflicts_with = "quick")]
    pub resume: bool,
    /// Exit with 0 if the fault sequences were run, even if one broke a rule: `campaign merge` judges them
    #[arg(long, requires = "shard")]
    pub collect: bool,
    /// Run at the pace of real time, or with =SPEED at so many times that
    #[arg(long, value_name = "SPEED", num_args = 0..=1, require_equals = true, default_missing_value = "1",
        value_parser = speed, conflicts_with_all = ["faults", "experiment", "list"])]
    pub real_time: Option<f64>,
    /// Show the run on the terminal at the pace of real time, with =SPEED at so many times that, or with =max as
    /// fast as it can: track, errors, display, nodes, bus and events; the key ? tells the keys
    #[arg(long, value_name = "SPEED", num_args = 0..=1, require_equals = true, default_missing_value = "1",
        conflicts_with_all = ["faults", "experiment", "list", "json", "gdb", "real_time"])]
    pub watch: Option<Speed>,
    /// Let other programs join the virtual bus, at the pace of real time: slcan, slcan:LINK or
    /// socketcan:INTERFACE
    #[arg(long, value_name = "BUS", conflicts_with_all = ["faults", "experiment", "list"])]
    pub can: Option<Can>,
    /// Folder for a run's run.html, run.mcap, bus.log, states.csv, consoles, logs, display.txt, motors.csv,
    /// summary.json and pictures, an experiment's experiment.json, runs.csv and, for --resume, experiment.journal
    /// while it runs and experiment.runs when it is done, or the fault sequences'
    /// faults.json (faults-I-of-N.json of a shard) [default: no files]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the figures as JSON
    #[arg(long)]
    pub json: bool,
    /// Let gdb debug a node, forwards and backwards, at localhost:PORT [default: 3333]; the other nodes, bus and
    /// world stand still with it
    #[arg(long, value_name = "NODE[:PORT]",
        conflicts_with_all = ["experiment", "faults", "json", "list", "can", "real_time"])]
    pub gdb: Option<crate::sim::Place>,
    /// Run so far before gdb is let in: "12.5 s", frame:0x12C, frame:MESSAGE, mode:NAME or reset:NODE
    #[arg(long, value_name = "WHERE", requires = "gdb")]
    pub until: Option<String>,
    /// List the scenarios instead of running one
    #[arg(long, conflicts_with_all = ["scenario", "seconds", "seed", "seeds", "quick", "shard", "attacker", "out"])]
    pub list: bool,
}

/// Reads a whole number of a range.
fn whole<N: TryFrom<u64> + 'static>(
    range: std::ops::RangeInclusive<u64>,
) -> impl Fn(&str) -> Result<N, String> + Clone + Send + Sync {
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        let number = number.and_then(|number| N::try_from(number).ok());
        let (from, to) = (range.start(), range.end());
        number.ok_or_else(|| format!("a whole number from {from} to {to} is accepted"))
    }
}

fn wall_seconds(text: &str) -> Result<Duration, String> {
    let simulated = seconds(text)?;
    Ok(Duration::from_nanos(simulated.as_ticks() / 1000))
}

fn speed(text: &str) -> Result<f64, String> {
    let number = text.parse().ok();
    let speed = number.filter(|speed| SPEEDS.contains(speed));
    speed.ok_or_else(|| {
        let (from, to) = (SPEEDS.start(), SPEEDS.end());
        format!("a number from {from} to {to} is accepted")
    })
}

fn law(text: &str) -> Result<Law, String> {
    let law = Law::ALL.into_iter().find(|law| law.name() == text);
    law.ok_or_else(|| "furrow or thesis is accepted".to_owned())
}

fn factor(text: &str) -> Result<f64, String> {
    let factor = text
        .parse()
        .ok()
        .filter(|factor| (0.01..=100.0).contains(factor));
    factor.ok_or_else(|| "a number from 0.01 to 100 is accepted".to_owned())
}

fn seconds(text: &str) -> Result<SimDuration, String> {
    match text.parse::<f64>() {
        Ok(seconds) if DURATIONS.contains(&seconds) => Ok(from_seconds(seconds)),
        _ => Err(format!(
            "a number of seconds from {} to {} is accepted",
            DURATIONS.start(),
            DURATIONS.end()
        )),
    }
}

/// What `campaign` does.
#[derive(Debug, Subcommand)]
#[command(after_help = "Examples:\n  \
    cargo xtask sim --faults 800 --shard 1/8 --out parts       on each machine with its number\n  \
    cargo xtask campaign merge parts/faults-*-of-8.json        the report of all 800\n  \
    cargo xtask campaign batch --engine parallel --faults 800 --shards 8 --out campaign.sh\n  \
    cargo xtask campaign batch --engine slurm --faults 100000 --shards 200 --attacker > campaign.slurm")]
pub enum Campaign {
    /// Report the whole campaign from the files of its parts: as if one machine had run it.
    Merge(Merge),
    /// Write the file with which an engine runs the parts and collects them.
    Batch(Batch),
}

/// Options of `campaign merge`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask campaign merge parts/faults-*-of-8.json\n  \
    cargo xtask campaign merge parts/faults-*-of-8.json --out parts/faults.json --json\n\n\
    Exit code 1 if a sequence broke a rule, 2 if the files are not all the parts of one campaign: same\n\
    vehicle, sequences, seed and images.")]
pub struct Merge {
    /// The files of all parts, as `sim --faults --shard I/N --out` writes them
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// File for the report of the whole campaign, equal to that of one run
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// What runs the parts of a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Engine {
    /// GNU parallel, on one machine or several.
    Parallel,
    /// A job array of Slurm.
    Slurm,
    /// Indexed Jobs of Kubernetes, 1.33 or newer.
    Kubernetes,
}

/// Options of `campaign batch`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask campaign batch --engine parallel --faults 800 --shards 8 --out campaign.sh; sh campaign.sh\n  \
    cargo xtask campaign batch --engine slurm --faults 100000 --shards 200 --attacker --dir /shared/parts\n  \
    cargo xtask campaign batch --engine kubernetes --faults 100000 --shards 200 --dir /parts \\\n      \
    --image lab/furrow:1 --claim results\n\n\
    A part that fails is tried three times, and each try goes on where the last one ended. The file's first\n\
    lines say how it is run.")]
pub struct Batch {
    /// What runs the parts
    #[arg(long, value_name = "ENGINE")]
    pub engine: Engine,
    /// Sequences of all parts
    #[arg(long, value_name = "N", value_parser = whole::<u64>(1..=100_000_000))]
    pub faults: u64,
    /// Parts
    #[arg(long, value_name = "N", value_parser = whole::<u64>(1..=100_000))]
    pub shards: u64,
    /// Attacks in place of faults
    #[arg(long)]
    pub attacker: bool,
    /// Seed of the first sequence
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX), allow_hyphen_values = true)]
    pub seed: u64,
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// Values in place of the manifest's.
    #[command(flatten)]
    pub changes: Changes,
    /// Folder for the files of the parts, which all machines share
    #[arg(long, value_name = "DIR", default_value = "campaign")]
    pub dir: String,
    /// Container for Kubernetes
    #[arg(long, value_name = "NAME")]
    pub image: Option<String>,
    /// Volume claim for the results, for Kubernetes
    #[arg(long, value_name = "NAME")]
    pub claim: Option<String>,
    /// File to write [default: print it]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Options of `monitor`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask monitor --vehicle uagv socketcan:can0      nodes, messages and windows, until Ctrl-C\n  \
    cargo xtask monitor --vehicle uagv slcan:/dev/ttyACM0 --record drive.log\n  \
    cargo xtask monitor --vehicle uagv slcan:target/bus --seconds 5 --json    beside cargo xtask sim --can slcan:target/bus\n  \
    cargo xtask monitor twin --seconds 5                   the virtual vehicle\n  \
    cargo xtask monitor --vehicle uagv drive.log           what a log tells of its nodes, at its end and on the way\n\n\
    A node is dead when nothing has come of it for three basic cycles, lost when half of its frames are out of\n\
    their windows, and babbles when it sends more than twice what is planned. Adapters report a frame up to some\n\
    milliseconds late, so a frame counts as outside its window only if it is more than 4 ms away from it.\n\
    cargo xtask analyse reads the record, and any other log.")]
pub struct Monitor {
    /// Bus: twin, socketcan:INTERFACE, or slcan:PORT with @BAUD if it has one; or the file of a log
    #[arg(value_name = "BUS|LOG")]
    pub source: Source,
    /// Vehicle, a folder below firmware/vehicles [default: uagv on the twin and of a log]
    #[arg(long, value_name = "NAME")]
    pub vehicle: Option<String>,
    /// Value in place of the manifest's, as rover.law=thesis; may be given again for another one
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// Stop after N seconds [default: at Ctrl-C, or at the end of the log]
    #[arg(long, value_name = "N", value_parser = wall_seconds, allow_hyphen_values = true)]
    pub seconds: Option<Duration>,
    /// File for the frames, in the format of candump -l; one that is there is not replaced
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Print the last picture as JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `figures`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask figures --out figures              all of them; figures/figures.html shows them\n  \
    cargo xtask figures 7.17 7.22 --out figures    two of them, and the runs that these need\n  \
    cargo xtask figures --list                     the figures of the thesis that show data\n  \
    cargo xtask figures --json                     their numbers beside those of the thesis as JSON\n\n\
    Each figure names the commands that make its runs one by one. All of them take some minutes.")]
pub struct Figures {
    /// Numbers of figures, as in the thesis [default: all that show data]
    #[arg(value_name = "NUMBER")]
    pub only: Vec<String>,
    /// Folder for the page, the numbers, and a picture of each chart [default: no files]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the numbers, or the list, as JSON
    #[arg(long)]
    pub json: bool,
    /// List the figures instead of drawing them
    #[arg(long, conflicts_with = "out")]
    pub list: bool,
}

/// What `mission` does.
#[derive(Debug, Subcommand)]
#[command(after_help = "Examples:\n  \
    cargo xtask mission new --from field.geojson --width 3 --section 1 --picture field.svg --out field.toml\n  \
    cargo xtask mission check field.toml\n  \
    cargo xtask sim --mission field.toml --seconds 420            drive it with the release images\n  \
    cargo xtask mission upload field.toml --bus socketcan:can0    send it to a vehicle, which checks and keeps it\n  \
    cargo xtask mission pause --bus socketcan:can0                the vehicle stops on its path until `resume`")]
pub enum Mission {
    /// Make a mission file from a field's boundary, from guidance lines, or from the vehicle's waypoints
    New(NewMission),
    /// Check whether a vehicle can drive a mission
    Check(CheckMission),
    /// Send a mission to a vehicle by its bus; the next run drives it
    Upload(UploadMission),
    /// Let the next run begin with the first leg
    Start(OnMissionBus),
    /// Let the vehicle stop on its path
    Pause(OnMissionBus),
    /// Let a paused run go on
    Resume(OnMissionBus),
    /// Let the vehicle forget its mission
    Drop(OnMissionBus),
    /// Ask what the vehicle does of its mission
    State(OnMissionBus),
    /// Write a mission to the controller's board with probe-rs
    Flash(FlashMission),
}

/// The bus of a vehicle that has missions.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask mission state --bus socketcan:can0\n  \
    cargo xtask mission pause --bus slcan:/dev/ttyACM0\n  \
    cargo xtask mission resume --bus slcan:target/bus    the link of `cargo xtask sim --can slcan:target/bus`\n\n\
    A request sets no vehicle in motion that its operator has not set to a run.")]
pub struct OnMissionBus {
    /// Where the vehicle is.
    #[arg(
        long,
        value_name = "BUS",
        value_parser = real_bus,
        help = "Where the vehicle is: socketcan:INTERFACE or slcan:PORT[@BAUD]"
    )]
    pub bus: Bus,
    /// Vehicle, a folder below firmware/vehicles [default: uagv]
    #[arg(long, value_name = "NAME")]
    pub vehicle: Option<String>,
    /// Value in place of the manifest's, as in its images; may be given again for another one
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
}

/// Reads a bus that is there already.
fn real_bus(text: &str) -> Result<Bus, String> {
    match text.parse() {
        Ok(bus) if bus != Bus::Twin => Ok(bus),
        _ => Err(
            "socketcan:INTERFACE or slcan:PORT[@BAUD] is accepted, for the virtual vehicle the link of a run with --can"
                .into(),
        ),
    }
}

/// Options of `mission upload`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask mission upload field.toml --bus socketcan:can0\n  \
    cargo xtask mission upload field.toml --bus slcan:/dev/ttyACM0 --check    let the vehicle check it only\n  \
    cargo xtask sim --set mission.enabled=true --can slcan:target/bus         and beside it\n  \
    cargo xtask mission upload field.toml --bus slcan:target/bus              to the virtual vehicle\n\n\
    The vehicle checks the mission, which takes a second or so for each swath, leaves the bus for up to\n\
    three seconds to write its flash, and starts anew. It takes a mission only while it stands and no run\n\
    goes, and refuses one that it cannot drive. Whatever goes wrong, it keeps the mission that it had.")]
pub struct UploadMission {
    /// The mission file
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Let the vehicle check the mission, and not keep it
    #[arg(long)]
    pub check: bool,
    /// The bus.
    #[command(flatten)]
    pub on: OnMissionBus,
}

/// Options of `mission flash`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask mission flash field.toml\n  \
    cargo xtask mission flash field.toml --dry-run    show the commands\n\n\
    For vehicles whose nodes have a key, and for missions that are longer than an upload may be.")]
pub struct FlashMission {
    /// The mission file
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// Serial number of the board's debug probe, when several are connected
    #[arg(long, value_name = "SERIAL")]
    pub probe: Option<String>,
    /// Print the commands instead of running them
    #[arg(long)]
    pub dry_run: bool,
}

/// Options of `mission new`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask mission new --out line.toml                      the line of the vehicle's waypoints\n  \
    cargo xtask mission new --from field.geojson --width 3 --section 1 --picture field.svg --out field.toml\n                                                               \
    \x20 swaths of 3 m in a field, with headland turns\n  \
    cargo xtask mission new --from guidance.csv --lines --out lines.toml\n                                                               \
    \x20 a leg along each line, with turns between them\n  \
    cargo xtask mission new --from farm.geojson --field \"North\" --origin 40.83,-96.66,330 --rounds last --out north.toml\n                                                               \
    \x20 one field of several, for the base station there, its headland too\n\n\
    GeoJSON, CSV with headings, the folder of an AgOpenGPS field, ISOXML (TASKDATA.XML or its folder);\n\
    xtask/mission/MISSIONS.md says what is read of them and what a mission file is.")]
pub struct NewMission {
    /// Boundary or lines to make it from [default: the vehicle's waypoints]
    #[arg(long, value_name = "FILE")]
    pub from: Option<PathBuf>,
    /// The mission file
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace the mission file if it is there
    #[arg(long)]
    pub force: bool,
    /// Take the lines of the file instead of dividing a field; a boundary round them becomes the fence
    #[arg(long, requires = "from")]
    pub lines: bool,
    /// With --lines: leave the boundary out, so there is no fence
    #[arg(long, requires = "lines")]
    pub no_fence: bool,
    /// With --lines: drive each line in the direction of the file [default: turned round if the way to it is shorter]
    #[arg(long, requires = "lines")]
    pub keep_directions: bool,
    /// With --lines: make the points of curves even first, which have noise of this standard deviation, m
    #[arg(long, value_name = "M", value_parser = metres, requires = "lines")]
    pub noise: Option<f64>,
    /// Field to divide, or whose lines are taken, by its name in the file [default: the first one]
    #[arg(long, value_name = "NAME", requires = "from")]
    pub field: Option<String>,
    /// Working width, m: the distance between swaths
    #[arg(long, value_name = "M", default_value_t = 3.0, value_parser = metres)]
    pub width: f64,
    /// Width of the headland, m; lines of which a file has only a beginning and a direction end there
    /// [default: twice the working width]
    #[arg(long, value_name = "M", value_parser = metres, requires = "from")]
    pub headland: Option<f64>,
    /// Work the headland, too, in rounds along the edge and round every hole, before or after the swaths [default: not]
    #[arg(long, value_name = "WHEN", requires = "from", conflicts_with = "lines")]
    pub rounds: Option<Rounds>,
    /// Where swaths end: where their middle or all of their width has left the inner area
    #[arg(
        long,
        value_name = "WHERE",
        default_value = "whole",
        requires = "from",
        conflicts_with = "lines"
    )]
    pub ends: SwathEnds,
    /// Direction of the swaths, degrees clockwise from north [default: the one with the fewest swaths]
    #[arg(long, value_name = "DEG", value_parser = degrees, allow_hyphen_values = true, requires = "from",
        conflicts_with = "lines")]
    pub direction: Option<f64>,
    /// Leave swaths out and drive them later, so that no turn is tighter than a half circle
    #[arg(long, requires = "from", conflicts_with = "lines")]
    pub skip: bool,
    /// Speed on the swaths or lines, m/s [default: the vehicle's cruise speed]
    #[arg(long, value_name = "M/S", value_parser = metres, requires = "from")]
    pub speed: Option<f64>,
    /// Section of the implement that works there, 1 to 8; may be given again for another one
    #[arg(long, value_name = "N", requires = "from")]
    pub section: Vec<u8>,
    /// The antenna of the vehicle's base station, from which all metres count: LATITUDE,LONGITUDE or
    /// LATITUDE,LONGITUDE,HEIGHT, degrees and metres [default: what the file measures from, or else where its first shape
    /// begins, which is right on the virtual vehicle only]
    #[arg(long, value_name = "PLACE", value_parser = crate::mission::origin_of, allow_hyphen_values = true)]
    pub origin: Option<mission::place::Origin>,
    /// Name of the mission [default: that of the field]
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Draw it from above
    #[arg(long, value_name = "SVG")]
    pub picture: Option<PathBuf>,
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
}

/// When the headland of a field is worked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Rounds {
    /// Before the swaths.
    First,
    /// After the swaths.
    Last,
}

/// Where the swaths of a field end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum SwathEnds {
    /// Where their middle leaves the inner area.
    Middle,
    /// Where all of their width has left it.
    Whole,
}

/// Options of `mission check`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask mission check field.toml --picture field.svg\n  \
    cargo xtask mission check field.toml --set mission.width=\"2 m\" --json\n\n\
    The check is the one that the vehicle makes of a mission before it drives it.")]
pub struct CheckMission {
    /// The mission file
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Values in place of the manifest's.
    #[command(flatten)]
    pub changes: Changes,
    /// Draw it from above, with its curvature
    #[arg(long, value_name = "SVG")]
    pub picture: Option<PathBuf>,
    /// Print the figures as JSON
    #[arg(long)]
    pub json: bool,
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
}

/// Reads a length in metres or a speed in metres per second, above 0 to 1000.
fn metres(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 1000.0 => Ok(value),
        _ => Err("a number above 0 to 1000 is accepted".into()),
    }
}

/// Reads an angle in degrees.
fn degrees(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (-360.0..=360.0).contains(&value) => Ok(value),
        _ => Err("a number from -360 to 360 is accepted".into()),
    }
}

/// Options of `analyse`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask analyse run/bus.log               the log of a run of `sim --out run`\n  \
    cargo xtask analyse drive.log --out drive     and drive/analysis.html, a page with tracks and timing\n  \
    cargo xtask analyse run/run.mcap              the recording of a run, or one of a robot with ROS\n  \
    cargo xtask analyse one.log two.log           a drive whose log was split, in order of time\n  \
    cargo xtask analyse bench.log --vehicle two-boards --interface can1\n  \
    cargo xtask analyse drive.log --json          everything as JSON, times in seconds\n\n\
    Formats, recognised by the lines: candump (-l, -L, and its screen with -t a, z or A),\n\
    Vector ASC, Kvaser CanKing text, Kvaser Memorator text and CSV.\n\
    MCAP, whole, with chunks that are packed by zstd, lz4 or not at all: channels with the schemas\n\
    furrow.Frame (JSON, of `sim --out`), can_msgs/msg/Frame (CDR of ROS 2) and can_msgs/Frame (ROS 1).\n\
    A channel's topic is its interface; the stamp of the driver counts before that of the recorder.\n\
    CAN FD frames, error frames and lines that cannot be read are skipped and counted. Loggers stamp\n\
    the end of a frame; its start is taken to be its length in bits earlier.\n\n\
    A frame is in its window if it starts in it, or early by up to half of it. A window is missed if it\n\
    stays empty after its message has come once. Where the time stamps go back, the time goes on; behind\n\
    a gap nothing is known until it is told again.\n\n\
    --out writes analysis.html, analysis.json, events.csv and messages.csv (a row for each signal of\n\
    each frame), both tables as Parquet (events.parquet, messages.parquet), and a picture of each\n\
    chart: analysis-track.svg, ...")]
pub struct Analyse {
    /// Logs of one drive, in order of time
    #[arg(value_name = "LOG", required = true)]
    pub logs: Vec<PathBuf>,
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// Values in place of the manifest's.
    #[command(flatten)]
    pub changes: Changes,
    /// Interface of the vehicle's bus [default: the one with most frames of its messages]
    #[arg(long, value_name = "NAME")]
    pub interface: Option<String>,
    /// Folder for the page, tables and figures [default: no files]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the figures as JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `calibrate`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask calibrate bus.log              results, and the changes they would make in vehicle.toml\n  \
    cargo xtask calibrate bus.log --write      the same, and make the changes\n  \
    cargo xtask sim calibration --out drive    record such a drive in the virtual vehicle\n\n\
    The drive: in manual mode with an RTK-fixed solution, drive circles to both sides with the\n\
    steering held, and move the steering to both sides at several rates. The images of the\n\
    drive must have the calibration of this tree, as it was before --write.")]
pub struct Calibrate {
    /// The log of a drive, as `candump -l` writes it
    #[arg(value_name = "LOG")]
    pub log: PathBuf,
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// Write the figures into the vehicle's manifest
    #[arg(long)]
    pub write: bool,
    /// Print the figures as JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `bench`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask bench                     tables of cycles and bytes\n  \
    cargo xtask bench --vehicle sprayer    the control step with another vehicle's settings\n  \
    cargo xtask bench --set machine.weights.firm.heading=30.0\n  \
    cargo xtask bench --elf other.elf     the events of another stack, made as ttcan/benches/peers says\n  \
    cargo xtask bench --json              the same as JSON")]
pub struct Bench {
    /// Program with another protocol stack, whose events alone are measured
    #[arg(long, value_name = "FILE", conflicts_with_all = ["vehicle", "set"])]
    pub elf: Option<PathBuf>,
    /// Vehicle whose control law is measured, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// Values in place of the manifest's.
    #[command(flatten)]
    pub changes: Changes,
    /// Print the figures as JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `schedule`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask schedule                                 the matrix of the file, checked\n  \
    cargo xtask schedule --method least-jitter           a new one, on the terminal\n  \
    cargo xtask schedule --vehicle two-boards --method power-of-two --write\n  \
    cargo xtask schedule --set row_guidance.enabled=true with the messages of the node that finds crop rows\n  \
    cargo xtask schedule my.dbc                          the matrix of a file without a vehicle\n\n\
    Methods:\n  \
    power-of-two   every period becomes the shortest one times a power of two; no jitter\n             \
    (thesis, 4.3.6.3)\n  \
    least-jitter   periods stay; a search minimises the jitter\n\n\
    Without a method the file's windows stay as they are, and --write changes nothing.")]
pub struct Schedule {
    /// Network file (DBC) [default: the vehicle's]
    #[arg(value_name = "FILE", conflicts_with = "vehicle")]
    pub file: Option<PathBuf>,
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// Value in place of the manifest's, as row_guidance.enabled=true; may be given again for another one
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse, conflicts_with = "file")]
    pub set: Vec<Override>,
    /// Find windows for all messages from their lengths, periods and deadlines
    #[arg(long, value_enum)]
    pub method: Option<Method>,
    /// Write the windows into the file
    #[arg(long)]
    pub write: bool,
    /// Print the matrix as JSON
    #[arg(long)]
    pub json: bool,
    /// Share of time for arbitrating windows, in thousandths [default: that of the file, or one window]
    #[arg(long, value_name = "N", requires = "method",
        value_parser = whole::<u16>(0..=1000))]
    pub arbitrating: Option<u16>,
    /// Share of time that must stay free, in thousandths
    #[arg(long, value_name = "N", requires = "method", default_value_t = 0,
        value_parser = whole::<u16>(0..=1000))]
    pub free: u16,
    /// Starts and lengths of windows are multiples of this, in microseconds
    #[arg(long, value_name = "US", requires = "method", default_value_t = 1,
        value_parser = whole::<u32>(1..=100_000))]
    pub grain: u32,
    /// Longest basic cycle to consider, in milliseconds [default: the reference's period in the file]
    #[arg(long, value_name = "MS", requires = "method",
        value_parser = whole::<u32>(1..=1000))]
    pub longest_cycle: Option<u32>,
}

/// How `schedule` finds windows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// Every period becomes the shortest one times a power of two.
    PowerOfTwo,
    /// Periods stay; a search minimises the jitter.
    LeastJitter,
}

/// Options of `schedulability`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask schedulability                       all nodes, the bus, and the paths from end to end\n  \
    cargo xtask schedulability steering drive        two nodes\n  \
    cargo xtask schedulability --html report.html    also a page with a drawing of one basic cycle\n  \
    cargo xtask schedulability --explain steering.can_rx   its longest path, by source line\n  \
    cargo xtask schedulability --json                everything as JSON, times in ps\n  \
    cargo xtask schedulability --vehicle row-follower --bus event-triggered --foreign 150:8:2700\n                                                   \
    \x20 beside a foreign node with 8 bytes each 2.7 ms\n  \
    cargo xtask schedulability --errors 2/100ms      two disturbed frames in any 100 ms; none: a clean bus\n\n\
    Exit code 0: every deadline holds; 1: one does not, and the first is named; 2: wrong input.\n\
    Periods and deadlines that the sources do not state are in tasks.toml of the vehicle's folder.")]
pub struct Schedulability {
    /// Nodes to analyse [default: all]
    #[arg(value_name = "NODE")]
    pub nodes: Vec<String>,
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// Values in place of the manifest's.
    #[command(flatten)]
    pub changes: Changes,
    /// Message of a foreign node on the bus, times in microseconds; may be given again for another one
    #[arg(long, value_name = "ID:BYTES:PERIOD[:JITTER]")]
    pub foreign: Vec<Foreign>,
    /// Disturbed frames: N in any M milliseconds, or none [default: as in the vehicle's tasks.toml]
    #[arg(long, value_name = "N/Mms")]
    pub errors: Option<ErrorRate>,
    /// Print the results as JSON
    #[arg(long)]
    pub json: bool,
    /// Write the results as one self-contained HTML page
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Show the worst-case path of one task as source lines instead of the table
    #[arg(long, value_name = "NODE.TASK", conflicts_with = "json")]
    pub explain: Option<String>,
}

/// Options of `priorities`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask priorities           deadline-monotonic priorities next to those of the sources\n  \
    cargo xtask priorities --json    the same as JSON\n\n\
    Where they differ, the command says what to change. It also builds the image and analyses\n\
    whether all deadlines hold with the priorities of the source.")]
pub struct Priorities {
    /// Vehicle, a folder below firmware/vehicles
    #[arg(long, value_name = "NAME", default_value = DEFAULT)]
    pub vehicle: String,
    /// Values in place of the manifest's.
    #[command(flatten)]
    pub changes: Changes,
    /// Print the proposal as JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `test`.
#[derive(Debug, Default, Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask test           all steps; exit code 1 if any of them fails\n  \
    cargo xtask test --long    a whole night: the slow tests too, and more faults\n  \
    cargo xtask test --random  the property tests try new inputs\n  \
    cargo xtask test --list    list the steps and their commands\n  \
    cargo xtask test --board steering                      the tests of the node's board\n  \
    cargo xtask test --board motor --vehicle two-boards    a node of another vehicle\n  \
    cargo xtask test --board gps --probe 066EFF57          with several boards connected\n  \
    cargo xtask test --board gps --twin --json             on the twin in any case, as JSON\n\n\
    The tests of a board run on it by probe-rs if a debug probe is connected, otherwise on the\n\
    virtual microcontroller. They need the image's place in the flash: `flash` brings the node\n\
    back. boards/GETTING_STARTED.md says what must be wired for them, and what must not.\n\
    Exit code 0: all passed; 1: one failed, or a step; 2: wrong input.\n\n\
    One step runs the first 30 random fault sequences, and one 40 with an attacker, who makes\n\
    about 10 000 attempts; with --long 1000 each. `cargo xtask sim --faults N`, perhaps with\n\
    --attacker, runs as many as you like.")]
pub struct Test {
    /// List the steps instead of running them
    #[arg(long)]
    pub list: bool,
    /// Run the slow tests too, and more random fault and attack sequences
    #[arg(long)]
    pub long: bool,
    /// Give the property tests new random inputs; by default they use the same inputs every
    /// time
    #[arg(long)]
    pub random: bool,
    /// Run the tests of this node's board instead
    #[arg(long, value_name = "NODE", conflicts_with_all = ["list", "long", "random"])]
    pub board: Option<String>,
    /// Vehicle of the node, when several have a node of that name
    #[arg(long, value_name = "NAME", requires = "board")]
    pub vehicle: Option<String>,
    /// Value in place of the manifest's, as row_guidance.enabled=true; may be given again for another one
    #[arg(long, value_name = "KEY=VALUE", value_parser = Override::parse, requires = "board")]
    pub set: Vec<Override>,
    /// Serial number of the board's debug probe, when several are connected
    #[arg(long, value_name = "SERIAL", requires = "board")]
    pub probe: Option<String>,
    /// Run on the virtual microcontroller even if a debug probe is connected
    #[arg(long, requires = "board", conflicts_with = "probe")]
    pub twin: bool,
    /// Print the outcomes as JSON
    #[arg(long, requires = "board")]
    pub json: bool,
}

/// An error in the command line.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no command.
    #[error(
        "no command is given: {} are accepted; see `cargo xtask {}--help`",
        commands(command.as_deref()).join(", "),
        word(command)
    )]
    NoCommand {
        /// The command that has further ones; `None` if there is none at all.
        command: Option<String>,
    },
    /// An argument is not accepted, or one is missing.
    #[error("{}; see `cargo xtask {}--help`", sentence(error), word(command))]
    Words {
        /// What is wrong.
        error: clap::Error,
        /// The command that it was given to; `None` if there is no such command.
        command: Option<String>,
    },
    /// A value of the manifest is given twice.
    #[error("{what}; see `cargo xtask {}--help`", word(command))]
    Values {
        /// Which one.
        what: String,
        /// The command that it was given to.
        command: Option<String>,
    },
}

/// The request of a command line.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is one in a run of the program"
)]
pub enum Request {
    /// Run a command.
    Run(Command),
    /// Show a text: help or version.
    Show(String),
}

/// Parses the command line. The first argument is the program's name.
///
/// # Errors
///
/// One sentence that says what is wrong and what is accepted.
pub fn parse(arguments: impl IntoIterator<Item = OsString>) -> Result<Request, Error> {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let command = named(&arguments);
    let read = Cli::command().try_get_matches_from(arguments);
    match read.and_then(|words| Ok((Cli::from_arg_matches(&words)?, words))) {
        Ok((cli, words)) => match values_once(&words) {
            Ok(()) => Ok(Request::Run(cli.command)),
            Err(what) => Err(Error::Values { what, command }),
        },
        Err(error) => match error.kind() {
            ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
                Ok(Request::Show(error.render().to_string()))
            }
            ErrorKind::MissingSubcommand | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
                Err(Error::NoCommand { command })
            }
            _ => Err(Error::Words { error, command }),
        },
    }
}

/// Checks that no value of the manifest is given twice, be it by --bus or by --set.
fn values_once(words: &ArgMatches) -> Result<(), String> {
    if let Some((_, words)) = words.subcommand() {
        return values_once(words);
    }
    // Not every command has --set, and the --bus of `selftest` is a place.
    let set = words.try_get_many::<Override>("set").ok().flatten();
    let set = Overrides::each_once(set.into_iter().flatten().cloned())?;
    let bus = words.try_get_one::<Protocol>("bus").ok().flatten();
    if bus.is_some() && set.name_protocol() {
        return Err(
            "--bus and --set bus.protocol both name the bus's protocol: one of the two is accepted"
                .into(),
        );
    }
    Ok(())
}

/// The command that a command line names, with the one of its own that follows, as in `keys new`.
fn named(arguments: &[OsString]) -> Option<String> {
    let mut words = arguments.iter().skip(1).map_while(|word| word.to_str());
    let first = words
        .next()
        .filter(|&word| commands(None).iter().any(|one| one == word))?;
    let own = commands(Some(first));
    let second = words
        .next()
        .filter(|&word| own.iter().any(|one| one == word));
    Some(second.map_or_else(|| first.to_owned(), |second| format!("{first} {second}")))
}

/// The names of all commands, or of those that a command has itself.
fn commands(of: Option<&str>) -> Vec<String> {
    let cli = Cli::command();
    let command = match of {
        Some(name) => cli.find_subcommand(name),
        None => Some(&cli),
    };
    let own = command.into_iter().flat_map(clap::Command::get_subcommands);
    own.map(|command| command.get_name().to_owned()).collect()
}

/// The first paragraph of a clap error, which describes the error, on one line.
fn sentence(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let paragraph = text.split("\n\n").next().unwrap_or_default();
    let line: Vec<&str> = paragraph.split_whitespace().collect();
    let line = line.join(" ");
    line.strip_prefix("error: ").unwrap_or(&line).to_owned()
}

/// A command in front of a further word.
fn word(command: &Option<String>) -> String {
    let command = command.as_ref();
    command.map_or(String::new(), |command| format!("{command} "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Failure;

    fn words(line: &str) -> Result<Request, Error> {
        parse(line.split(' ').map(OsString::from))
    }

    fn refused(line: &str) -> String {
        let failure = Failure::from(words(line).unwrap_err());
        assert_eq!(failure.exit_code(), 2);
        failure.to_string()
    }

    #[test]
    fn the_definitions_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn nodes_are_named_in_any_number() {
        let Ok(Request::Run(Command::Build(build))) = words("xtask build drive gps --json") else {
            panic!("not read");
        };
        assert_eq!(build.nodes, ["drive", "gps"]);
        assert_eq!(build.vehicle, DEFAULT);
        assert!(build.json);
    }

    #[test]
    fn values_of_the_manifest_are_collected() {
        let line =
            "xtask build --set rover.law=thesis --bus event-triggered --set rover.cruise=0.8";
        let Ok(Request::Run(Command::Build(build))) = words(line) else {
            panic!("not read");
        };
        assert_eq!(
            build.changes.overrides().to_string(),
            "bus.protocol=event-triggered, rover.cruise=0.8, rover.law=thesis"
        );
    }

    #[test]
    fn a_value_that_is_given_twice_is_named() {
        for (line, sentence) in [
            (
                "xtask sim --set rover.cruise=0.8 --set rover.cruise=0.4",
                "rover.cruise is given twice, as 0.8 and as 0.4: one value of a key is accepted; see \
                 `cargo xtask sim --help`",
            ),
            (
                "xtask selftest --set row_guidance.enabled=true --bus twin --set row_guidance.enabled=false",
                "row_guidance.enabled is given twice",
            ),
            (
                "xtask schedulability --bus event-triggered --set bus.protocol=time-triggered",
                "--bus and --set bus.protocol both name the bus's protocol",
            ),
            (
                "xtask flash gps --set bus.protocol=time-triggered --bus time-triggered",
                "one of the two is accepted; see `cargo xtask flash --help`",
            ),
        ] {
            let text = refused(line);
            assert!(text.contains(sentence), "{text}");
            assert!(!text.contains('\n'), "{text}");
        }
        for line in [
            "xtask selftest --set rover.law=thesis --bus twin",
            "xtask sim --set rover.law=thesis --set rover.cruise=0.8",
        ] {
            assert!(words(line).is_ok(), "{line}");
        }
    }

    #[test]
    fn what_is_wrong_is_said_in_one_sentence() {
        for line in [
            "xtask flash",
            "xtask attach",
            "xtask run gps --probe",
            "xtask run gps drive",
            "xtask paint",
            "xtask build --colour",
            "xtask sim --seconds -1",
            "xtask sim --seconds soon",
            "xtask sim --seed 1.5",
            "xtask sim --seeds 3",
            "xtask sim --experiment thesis-7 --seeds 0",
            "xtask sim --experiment thesis-7 gps-lost",
            "xtask sim --quick",
            "xtask schedulability --explain a.b --json",
            "xtask schedulability --foreign 150:8",
            "xtask priorities gps",
            "xtask selftest gps",
            "xtask selftest --bus can0",
            "xtask selftest --bus slcan:/dev/ttyACM0@fast",
            "xtask new",
            "xtask schedule my.dbc --vehicle uagv",
            "xtask new node rudder",
            "xtask new vehicle",
            "xtask sim --faults 0",
            "xtask sim --faults many",
            "xtask sim --faults 8 gps-lost",
            "xtask sim --faults 8 --shard 9/8",
            "xtask sim --shard 1/8",
            "xtask sim --attacker",
            "xtask sim --list --attacker",
            "xtask sim gps-lost --attacker",
            "xtask sim --set",
            "xtask build --set rover.law",
            "xtask schedulability --set rover.law= --bus event-triggered",
            "xtask sim --list gps-lost",
            "xtask sim --list --seconds 3",
            "xtask sim --list --seed 3",
            "xtask sim --list --out run",
            "xtask sim --list --quick",
            "xtask sim --list --seeds 3",
            "xtask sim --list --shard 1/8",
            "xtask sim gps-lost --quick",
            "xtask sim gps-lost --seeds 3",
            "xtask sim gps-lost --shard 1/8",
            "xtask sim --faults 8 --quick",
            "xtask sim --experiment thesis-7 --shard 1/8",
            "xtask help paint",
            "xtask",
        ] {
            let text = refused(line);
            assert!(!text.contains('\n'), "{text}");
            assert!(text.len() > 30, "{text}");
        }
    }

    #[test]
    fn the_help_of_the_command_is_named() {
        for (line, help) in [
            ("xtask sim --seconds -1", "see `cargo xtask sim --help`"),
            ("xtask flash", "see `cargo xtask flash --help`"),
            ("xtask paint", "see `cargo xtask --help`"),
        ] {
            let text = refused(line);
            assert!(text.ends_with(help), "{text}");
        }
    }

    #[test]
    fn help_is_a_command_too() {
        let shown = |line| match words(line) {
            Ok(Request::Show(text)) => text,
            other => panic!("no help: {other:?}"),
        };
        assert_eq!(shown("xtask help sim"), shown("xtask sim --help"));
        assert_eq!(shown("xtask help"), shown("xtask --help"));
    }

    #[test]
    fn numbers_out_of_range_are_told_what_is_accepted() {
        let seconds = refused("xtask sim --seconds -1");
        let accepted = "a number of seconds from 0.001 to 86400 is accepted";
        assert!(seconds.contains(accepted), "{seconds}");
        // In no time at all there is no load of the bus.
        let moment = refused("xtask sim --seconds 1e-13");
        assert!(moment.contains(accepted), "{moment}");
        let seed = refused("xtask sim --seed -1");
        assert!(seed.contains("'-1' for '--seed <N>'"), "{seed}");
    }

    #[test]
    fn without_a_command_they_are_named() {
        let text = refused("xtask");
        assert!(text.contains("build, flash, attach, run, sim"), "{text}");
    }

    #[test]
    fn every_command_has_help_with_examples() {
        for command in std::iter::once(String::new()).chain(commands(None)) {
            let line = format!("xtask {command} --help").replace("  ", " ");
            let Ok(Request::Show(text)) = words(&line) else {
                panic!("no help: {line}");
            };
            assert!(text.contains("Examples:"), "{text}");
        }
    }
}
