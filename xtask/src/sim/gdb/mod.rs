//! `sim --gdb`: a debugger attaches to one node, and the other nodes, the bus and the world stand still with it.

mod journal;
mod machine;
mod monitor;
mod registers;
mod until;
mod wire;

use std::{
    convert::Infallible,
    io,
    net::{Ipv4Addr, TcpListener, TcpStream},
    path::Path,
    str::FromStr,
};

use gdbstub::{
    common::Signal,
    stub::{
        DisconnectReason, GdbStub, GdbStubError,
        state_machine::{GdbStubStateMachine as State, GdbStubStateMachineInner, state::Running},
    },
};
use twin::{
    Images, Twin,
    replay::{Halt, Replay},
};
use vehicle_model::{NodeIndex, Vehicle};
use world::{Scenario, time};

use super::{Error, Wish, recording::STEP};
use crate::{Failure, Workspace, build, progress::Display, vehicle};
use journal::Journal;
use machine::{Machine, Reason};
use until::Until;
use wire::Wire;

/// The port that gdb connects to unless another one is named.
const PORT: u16 = 3333;

/// The node that is debugged, and the port that gdb connects to; 0 is any free one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    node: String,
    port: u16,
}

impl FromStr for Place {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (node, port) = match text.split_once(':') {
            None => (text, Some(PORT)),
            Some((node, port)) => (node, port.parse().ok()),
        };
        match port {
            Some(port) if !node.is_empty() => Ok(Self {
                node: node.to_owned(),
                port,
            }),
            _ => Err("NODE or NODE:PORT is accepted, with a port from 0 to 65535".into()),
        }
    }
}

/// How a session ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// gdb has let the node go: the run goes on.
    Detached,
    /// gdb has ended the run.
    Killed,
    /// The connection broke.
    Lost,
}

/// What is wrong with a session, checked before anything is built.
#[derive(Debug)]
pub(super) struct Session {
    node: NodeIndex,
    until: Option<Until>,
    listener: TcpListener,
}

impl Session {
    /// Takes the port.
    ///
    /// # Errors
    ///
    /// The vehicle has no such node, the place to halt is wrong, or the port cannot be taken.
    pub(super) fn new(
        vehicle: &Vehicle,
        place: &Place,
        until: Option<&str>,
    ) -> Result<Self, Failure> {
        let names = std::slice::from_ref(&place.node);
        let node = vehicle::nodes(vehicle, names)?[0];
        let until = until.map(|text| Until::parse(text, vehicle)).transpose();
        let until = until.map_err(|why| Error::Until { why })?;
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, place.port));
        let listener = listener.map_err(|error| Error::Port {
            port: place.port,
            error,
        })?;
        Ok(Self {
            node,
            until,
            listener,
        })
    }

    /// Lets gdb drive a run. Returns the vehicle if the run is to go on without it.
    ///
    /// # Errors
    ///
    /// An image does not build or run, or the connection cannot be waited for.
    pub(super) fn run(
        self,
        workspace: &Workspace,
        vehicle: &Vehicle,
        scenario: &Scenario,
        wish: &Wish,
    ) -> Result<Option<(Twin, Images)>, Failure> {
        let nodes: Vec<_> = vehicle.nodes().collect();
        let files = build::images(workspace, vehicle, &nodes)?;
        let images = build::read(&files)?;
        let twin = Twin::new(vehicle, scenario, wish.seed, &images).map_err(Error::from)?;
        let journal = Journal::new(self.node, images.of(self.node));
        let replay =
            Replay::new(twin, journal, self.node, wish.end(scenario), STEP).map_err(Error::from)?;
        let mut machine = Machine::new(replay, vehicle, self.node);
        if let Some(until) = self.until {
            approach(&mut machine, until);
        }
        let port = self
            .listener
            .local_addr()
            .map_err(Error::Connection)?
            .port();
        let image = &files[self.node.0].path;
        wait(&machine, &workspace_path(workspace, image), port);
        loop {
            let (stream, _) = self.listener.accept().map_err(Error::Connection)?;
            eprintln!("gdb is there.");
            match serve(&mut machine, stream) {
                Ok(End::Detached) => {
                    eprintln!("gdb has let the node go: the run goes on.");
                    let twin = machine.replay.into_twin().map_err(Error::from)?;
                    return Ok(Some((twin, images)));
                }
                Ok(End::Killed) => {
                    eprintln!("gdb has ended the run.");
                    return Ok(None);
                }
                Ok(End::Lost) => eprintln!("The connection has ended; another gdb may attach."),
                Err(why) => eprintln!("The connection has failed ({why}); another gdb may attach."),
            }
            machine.disarm();
        }
    }
}

/// A path as a user in the workspace's folder writes it.
fn workspace_path(workspace: &Workspace, path: &Path) -> String {
    let inside = path.strip_prefix(workspace.root()).unwrap_or(path);
    inside.display().to_string()
}

fn wait(machine: &Machine<'_>, image: &str, port: u16) {
    let mcu = machine.replay.mcu();
    eprintln!(
        "Node {} stands still at {:.6} s and waits for gdb at localhost:{port}:\n  \
         gdb-multiarch {image} -ex 'target remote localhost:{port}'",
        machine.replay.twin().name(machine.node),
        time::seconds(mcu.now())
    );
}

/// Runs up to the place at which the debugger is let in.
fn approach(machine: &mut Machine<'_>, until: Until) {
    let mut display = Display::new();
    let end = time::seconds(machine.replay.end());
    let halt = machine.run_until(until, &mut |replay| {
        let now = time::seconds(replay.twin().now());
        display.show(|_| format!("{now:5.0} of {end:.0} s simulated"));
    });
    display.end();
    for line in machine.take_lines() {
        eprintln!("{line}");
    }
    match halt {
        Halt::End => eprintln!("note: it did not happen until the end of the run at {end} s"),
        Halt::Failed(why) => eprintln!("note: the run cannot go on: {why}"),
        Halt::Stop(_) | Halt::Beginning | Halt::Interrupted => {}
    }
}

/// Serves gdb until it goes.
fn serve(machine: &mut Machine<'_>, stream: TcpStream) -> Result<End, Box<dyn std::error::Error>> {
    let wire = Wire::new(stream)?;
    let stub = GdbStub::new(wire);
    let mut state = stub.run_state_machine(machine).map_err(text)?;
    loop {
        state = match state {
            State::Idle(mut idle) => match idle.borrow_conn().read()? {
                Some(byte) => idle.incoming_data(machine, byte).map_err(text)?,
                None => return Ok(End::Lost),
            },
            State::Running(running) => match run(machine, running)? {
                Some(state) => state,
                None => return Ok(End::Lost),
            },
            State::CtrlCInterrupt(interrupt) => {
                machine.give_up();
                let reason = Reason::Signal(Signal::SIGINT);
                interrupt
                    .interrupt_handled(machine, Some(reason))
                    .map_err(text)?
            }
            State::Disconnected(mut gone) => {
                if gone.get_reason() == DisconnectReason::Disconnect {
                    return Ok(End::Detached);
                }
                // gdb waits for it, but the stub does not say it.
                gone.borrow_conn().send("OK")?;
                return Ok(End::Killed);
            }
        };
    }
}

type Stub<'a, 'v> = State<'a, Machine<'v>, Wire>;
type Runs<'a, 'v> = GdbStubStateMachineInner<'a, Running, Machine<'v>, Wire>;

/// Lets the node run until it stands still, or until gdb or the node says something. `None` if gdb is gone.
fn run<'a, 'v>(
    machine: &mut Machine<'v>,
    mut running: Runs<'a, 'v>,
) -> Result<Option<Stub<'a, 'v>>, Box<dyn std::error::Error>> {
    let wire = running.borrow_conn();
    let reason = machine.carry_out(&mut || wire.is_called());
    for line in machine.take_lines() {
        wire.show(&line)?;
    }
    if let Some(reason) = reason {
        return Ok(Some(running.report_stop(machine, reason).map_err(text)?));
    }
    if !wire.is_called() {
        return Ok(Some(running.into()));
    }
    Ok(match wire.read()? {
        Some(byte) => Some(running.incoming_data(machine, byte).map_err(text)?),
        None => None,
    })
}

/// The stub's errors borrow nothing, but have no common type.
fn text(error: GdbStubError<Infallible, io::Error>) -> String {
    error.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_a_node_with_or_without_a_port() {
        let place = |node: &str, port| Place {
            node: node.into(),
            port,
        };
        assert_eq!("gps".parse(), Ok(place("gps", 3333)));
        assert_eq!("gps:0".parse(), Ok(place("gps", 0)));
        for wrong in ["", ":3333", "gps:", "gps:65536", "gps:3333:1"] {
            let error = wrong.parse::<Place>().unwrap_err();
            assert!(error.contains("is accepted"), "{wrong}: {error}");
        }
    }

    #[test]
    fn a_port_in_use_and_an_unknown_node_are_a_sentence() {
        let workspace = Workspace::find().unwrap();
        let vehicle = crate::vehicle::find(&workspace, "uagv").unwrap();
        let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let port = taken.local_addr().unwrap().port();
        let refused = |place: &str, until| {
            let place = place.parse().unwrap();
            let failure = Session::new(&vehicle, &place, until).unwrap_err();
            assert_eq!(failure.exit_code(), 2, "{failure}");
            failure.to_string()
        };
        let error = refused(&format!("gps:{port}"), None);
        assert!(
            error.starts_with(&format!("port {port} of localhost cannot be used")),
            "{error}"
        );
        let error = refused("nobody:0", None);
        assert!(error.contains("has no node nobody, but gps, "), "{error}");
        let error = refused("gps:0", Some("soon"));
        assert!(
            error.starts_with("--until: \"soon\" is neither a time nor an event"),
            "{error}"
        );
    }
}
