//! `selftest`: asks the nodes on a bus for their self-test and shows the results.
//!
//! The bus is that of the virtual vehicle, or a real one behind a SocketCAN interface or an
//! adapter on a serial port: a [`Transport`]. On each of them [`ask`] sends the request in its
//! window of the schedule, after a reference message.

mod ask;
mod bus;
mod messages;
mod on_twin;
mod report;
pub(crate) mod schedule;
mod serial;
#[cfg(target_os = "linux")]
mod socket;
mod transport;

pub use ask::{Answers, Question, Told, Unsent, ask};
pub use bus::Bus;
pub use messages::{Check, Messages, Outcome, Report, Value};
pub use on_twin::OnTwin;
pub use report::Results;
pub use serial::{Line, Port, Slcan};
pub use transport::{Error as TransportError, Received, Transport};

use vehicle_model::{NodeIndex, Override, Vehicle};

use crate::{Failure, Workspace, cli::Selftest, progress::Display, sim, vehicle};

/// Why a self-test fails.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The vehicle has no self-test.
    #[error(
        "vehicle {0:?} has no self-test: [self_test] in its vehicle.toml names the messages of one"
    )]
    NoMessages(String),
    /// The bus cannot be reached.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The nodes could not be asked, or something is wrong with them.
    #[error("the self-test failed: {}", .0.join("; "))]
    Failed(Vec<String>),
}

impl Error {
    /// Whether the command line or an input file is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        match self {
            Self::NoMessages(_) => true,
            Self::Transport(error) => error.is_usage(),
            Self::Failed(_) => false,
        }
    }
}

/// Runs the command.
///
/// # Errors
///
/// There is no such vehicle, node or bus, the vehicle has no self-test, or there are several
/// vehicles and a real bus, and none is named (exit code 2). A check failed, or a node did not
/// report.
pub fn run(workspace: &Workspace, options: &Selftest) -> Result<(), Failure> {
    let vehicle = of_bus(
        workspace,
        options.vehicle.as_deref(),
        &options.bus,
        &options.set,
    )?;
    let nodes = vehicle::participants(&vehicle, &options.nodes, "has no self-test")?;
    let messages =
        Messages::of(&vehicle).ok_or_else(|| Error::NoMessages(vehicle.name().into()))?;
    let bit_rate = messages.bit_rate();
    let mut transport = open(workspace, &vehicle, &options.bus, bit_rate, Slcan::open)?;

    let names = vehicle::node_names(&vehicle);
    let wanted: Vec<usize> = nodes.into_iter().map(|NodeIndex(node)| node).collect();
    let question = Question {
        messages: &messages,
        names: &names,
        wanted: &wanted,
        start_again: !options.running,
    };
    let mut display = Display::new();
    let asked = ask(transport.as_mut(), &question, &mut |told| match told {
        Told::Note(note) => {
            display.end();
            eprintln!("{note}");
        }
        Told::Waits { now, what } => {
            display.show(|_| format!("{:5.1} s: waiting for {what}", now.as_secs_f64()));
        }
    });
    display.end();
    let answers = asked.map_err(Error::from)?;

    let results = Results {
        vehicle: &vehicle,
        bus: options.bus.to_string(),
        nodes: &wanted,
        answers: &answers,
    };
    if options.json {
        println!("{:#}", results.json());
    } else {
        print!("{}", results.text());
    }
    Ok(results.outcome()?)
}

/// The vehicle on a bus: the one that is named, or the only one that can be there.
///
/// # Errors
/// There is no such vehicle, or none is named and several may be there.
pub(crate) fn of_bus(
    workspace: &Workspace,
    name: Option<&str>,
    bus: &Bus,
    set: &[Override],
) -> Result<Vehicle, vehicle::Error> {
    let set = set.iter().cloned().collect();
    match (name, bus) {
        (Some(name), _) => vehicle::with(workspace, name, &set),
        (None, Bus::Twin) => vehicle::with(workspace, vehicle::DEFAULT, &set),
        (None, bus) => vehicle::on_bus(workspace, &bus.to_string(), &set),
    }
}

/// How an adapter is opened: with its time stamps or without.
pub(crate) type OpenAdapter = fn(Port, &str, u32) -> Result<Slcan<Port>, TransportError>;

/// Opens a bus.
pub(crate) fn open(
    workspace: &Workspace,
    vehicle: &Vehicle,
    bus: &Bus,
    bit_rate: u32,
    adapter: OpenAdapter,
) -> Result<Box<dyn Transport>, Failure> {
    match bus {
        Bus::Twin => {
            let images = sim::images(workspace, vehicle)?;
            eprintln!("Starting {} on the virtual vehicle.", vehicle.name());
            Ok(Box::new(
                OnTwin::new(vehicle, &images).map_err(Error::from)?,
            ))
        }
        Bus::SocketCan(name) => Ok(socketcan(name, bit_rate).map_err(Error::from)?),
        Bus::Slcan { port, baud } => {
            let line = Port::open(port, *baud).map_err(Error::from)?;
            let adapter = adapter(line, port, bit_rate).map_err(Error::from)?;
            if !adapter.speaks() {
                eprintln!(
                    "Nothing has answered at {port}. Some adapters acknowledge no command; so does \
                     a port without an adapter."
                );
            }
            Ok(Box::new(adapter))
        }
    }
}

#[cfg(target_os = "linux")]
pub(crate) fn socketcan(name: &str, bit_rate: u32) -> Result<Box<dyn Transport>, TransportError> {
    Ok(Box::new(socket::SocketCan::open(name, bit_rate)?))
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn socketcan(_: &str, _: u32) -> Result<Box<dyn Transport>, TransportError> {
    Err(TransportError::NoSocketCan)
}
