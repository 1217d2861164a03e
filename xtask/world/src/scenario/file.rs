//! The contents of a scenario file. Missing values come from the vehicle's manifest.

use std::collections::BTreeMap;

use serde::Deserialize;
use vehicle_model::{Device, NodeIndex, Override, Overrides, Vehicle};

use super::rover::{self, DistanceFault};
use super::{
    Babble, BrownOut, BusEvent, ButtonPress, Clock, ClockChange, Expectation, JoystickMove,
    KnobTurn, Lcd, Line, Point, Receiver, RelayFault, ResetEvent, Row, Scenario, Start,
    StartChanges, StopLoopChange, SupplyChange, WireNoise,
};
use crate::distance;
use crate::receiver::{self, FixChange, InertialChange, StreamFault};
use crate::rover::Terrain;
use crate::units::{Ratio, Time, Voltage};
use crate::vehicle;

/// The values that a scenario puts in place of the manifest's, each as `--set` takes it.
fn overrides(set: &[String]) -> Result<Overrides, String> {
    let all = set
        .iter()
        .map(|one| Override::parse(one).map_err(|error| format!("{one:?}: {error}")));
    Overrides::each_once(all.collect::<Result<Vec<_>, _>>()?)
}

/// The tables and fields of a file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct File {
    summary: String,
    set: Vec<String>,
    duration: Time,
    start: Option<StartChanges>,
    line: Option<Line>,
    vehicle: Option<vehicle::Changes>,
    ground: vehicle::Ground,
    receiver: Option<receiver::Changes>,
    key: bool,
    lcd: Lcd,
    remote: Receiver,
    nodes: BTreeMap<String, Clock>,
    fix: Vec<FixChange>,
    inertial: Vec<InertialChange>,
    stream: Vec<StreamFault>,
    press: Vec<ButtonPress>,
    supply: Vec<SupplyChange>,
    joystick: Vec<JoystickMove>,
    knob: Vec<Turn>,
    stop_loop: Vec<StopLoopChange>,
    reset: Vec<Reset>,
    clock: Vec<Change>,
    brownout: Vec<Dip>,
    wire: Vec<Noise>,
    relay: Vec<Stuck>,
    babble: Vec<Babbler>,
    bus: Vec<BusEvent>,
    row: Option<Row>,
    terrain: Option<Terrain>,
    distance: Option<distance::Parameters>,
    distance_fault: Vec<DistanceFault>,
    expect: Vec<Expectation>,
}

impl Default for File {
    fn default() -> Self {
        Self {
            summary: String::new(),
            set: Vec::new(),
            duration: Time::new(60.0),
            start: None,
            line: None,
            vehicle: None,
            ground: vehicle::Ground::default(),
            receiver: None,
            key: false,
            lcd: Lcd::default(),
            remote: Receiver::default(),
            nodes: BTreeMap::new(),
            fix: Vec::new(),
            inertial: Vec::new(),
            stream: Vec::new(),
            press: Vec::new(),
            supply: Vec::new(),
            joystick: Vec::new(),
            knob: Vec::new(),
            stop_loop: Vec::new(),
            reset: Vec::new(),
            clock: Vec::new(),
            brownout: Vec::new(),
            wire: Vec::new(),
            relay: Vec::new(),
            babble: Vec::new(),
            bus: Vec::new(),
            row: None,
            terrain: None,
            distance: None,
            distance_fault: Vec::new(),
            expect: Vec::new(),
        }
    }
}

/// A [`KnobTurn`] as written in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Turn {
    node: String,
    at: Time,
    position: Ratio,
}

/// A [`ResetEvent`] as written in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Reset {
    node: String,
    at: Time,
    until: Option<Time>,
}

/// A [`Babble`] as written in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Babbler {
    node: String,
    at: Time,
    until: Time,
    id: Option<u16>,
}

/// A [`ClockChange`] as written in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Change {
    node: String,
    at: Time,
    present: bool,
}

/// A [`BrownOut`] as written in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Dip {
    node: String,
    at: Time,
    until: Time,
    #[serde(default)]
    lowest: Voltage,
}

/// A [`WireNoise`] as written in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Noise {
    node: String,
    at: Time,
    byte: u8,
}

/// A [`RelayFault`] as written in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stuck {
    node: String,
    at: Time,
}

/// The nodes' clocks, in the order of the manifest's nodes.
fn clocks(vehicle: &Vehicle, named: BTreeMap<String, Clock>) -> Result<Vec<Clock>, String> {
    let mut clocks = vec![Clock::default(); vehicle.manifest().nodes.len()];
    for (name, clock) in named {
        clocks[find(vehicle, "nodes", &name)?.0] = clock;
    }
    Ok(clocks)
}

fn babblers(vehicle: &Vehicle, babblers: Vec<Babbler>) -> Result<Vec<Babble>, String> {
    let babblers = babblers.into_iter().enumerate();
    babblers
        .map(|(i, babbler)| {
            Ok(Babble {
                node: find(vehicle, &format!("babble[{i}].node"), &babbler.node)?,
                at: babbler.at,
                until: babbler.until,
                id: babbler.id,
            })
        })
        .collect()
}

fn dips(vehicle: &Vehicle, dips: Vec<Dip>) -> Result<Vec<BrownOut>, String> {
    let dips = dips.into_iter().enumerate();
    dips.map(|(i, dip)| {
        Ok(BrownOut {
            node: find(vehicle, &format!("brownout[{i}].node"), &dip.node)?,
            at: dip.at,
            until: dip.until,
            lowest: dip.lowest,
        })
    })
    .collect()
}

impl File {
    /// The scenario, completed with the manifest's values.
    pub(super) fn complete(self, vehicle: &Vehicle, name: &str) -> Result<Scenario, String> {
        let node = |field: String, name: &str| find(vehicle, &field, name);
        let reset = self.reset.into_iter().enumerate().map(|(i, reset)| {
            Ok(ResetEvent {
                node: node(format!("reset[{i}].node"), &reset.node)?,
                at: reset.at,
                until: reset.until,
            })
        });
        let knob = self.knob.into_iter().enumerate().map(|(i, turn)| {
            Ok(KnobTurn {
                node: node(format!("knob[{i}].node"), &turn.node)?,
                at: turn.at,
                position: turn.position,
            })
        });
        let clock = self.clock.into_iter().enumerate().map(|(i, change)| {
            Ok(ClockChange {
                node: node(format!("clock[{i}].node"), &change.node)?,
                at: change.at,
                present: change.present,
            })
        });
        let wire = self.wire.into_iter().enumerate().map(|(i, noise)| {
            Ok(WireNoise {
                node: node(format!("wire[{i}].node"), &noise.node)?,
                at: noise.at,
                byte: noise.byte,
            })
        });
        let relay = self.relay.into_iter().enumerate().map(|(i, stuck)| {
            Ok(RelayFault {
                node: node(format!("relay[{i}].node"), &stuck.node)?,
                at: stuck.at,
            })
        });
        let line = line(vehicle, self.line)?;
        let (mut row, mut distance) = (self.row, self.distance);
        let crop = rover::crop(vehicle, line.as_ref(), &mut row, &mut distance);
        Ok(Scenario {
            name: name.into(),
            summary: self.summary,
            set: overrides(&self.set).map_err(|error| format!("set: {error}"))?,
            duration: self.duration,
            start: start(vehicle, line.as_ref(), self.start)?,
            line,
            vehicle: machine(vehicle, self.vehicle)?,
            ground: self.ground,
            receiver: receiver(vehicle, self.receiver)?,
            key: self.key,
            lcd: self.lcd,
            remote: self.remote,
            nodes: clocks(vehicle, self.nodes)?,
            fix: self.fix,
            inertial: self.inertial,
            stream: self.stream,
            press: self.press,
            supply: self.supply,
            joystick: self.joystick,
            knob: knob.collect::<Result<_, String>>()?,
            stop_loop: self.stop_loop,
            reset: reset.collect::<Result<_, String>>()?,
            clock: clock.collect::<Result<_, String>>()?,
            brownout: dips(vehicle, self.brownout)?,
            wire: wire.collect::<Result<_, String>>()?,
            relay: relay.collect::<Result<_, String>>()?,
            babble: babblers(vehicle, self.babble)?,
            bus: self.bus,
            row: rover::setting(vehicle, row, self.terrain, distance)?,
            crop,
            distance_fault: self.distance_fault,
            expect: self.expect,
        })
    }
}

fn find(vehicle: &Vehicle, field: &str, name: &str) -> Result<NodeIndex, String> {
    vehicle.find_node(name).ok_or_else(|| {
        let nodes = vehicle.manifest().nodes.iter();
        let names: Vec<&str> = nodes.map(|node| node.name.as_str()).collect();
        format!("{field}: there is no node {name:?}: {}", names.join(", "))
    })
}

fn line(vehicle: &Vehicle, line: Option<Line>) -> Result<Option<Line>, String> {
    let manifest = vehicle.manifest();
    if manifest.machine.is_none() {
        return match line {
            None => Ok(None),
            Some(_) => Err(without(vehicle, "line", "a machine")),
        };
    }
    let point = |point: &vehicle_model::manifest::Waypoint| Point {
        north: point.north,
        east: point.east,
    };
    let ends = manifest.waypoints.first().zip(manifest.waypoints.last());
    Ok(line.or_else(|| {
        ends.map(|(from, to)| Line {
            from: point(from),
            to: point(to),
        })
    }))
}

fn start(
    vehicle: &Vehicle,
    line: Option<&Line>,
    changes: Option<StartChanges>,
) -> Result<Start, String> {
    let mut start = Start::of(line);
    match changes {
        Some(_) if vehicle.manifest().machine.is_none() => {
            return Err(without(vehicle, "start", "a machine"));
        }
        Some(changes) => changes.apply(&mut start),
        None => {}
    }
    Ok(start)
}

fn machine(
    vehicle: &Vehicle,
    changes: Option<vehicle::Changes>,
) -> Result<Option<vehicle::Parameters>, String> {
    let Some(machine) = &vehicle.manifest().machine else {
        return match changes {
            None => Ok(None),
            Some(_) => Err(without(vehicle, "vehicle", "a machine")),
        };
    };
    let mut parameters = vehicle::Parameters::from(machine);
    changes.unwrap_or_default().apply(&mut parameters);
    Ok(Some(parameters))
}

fn receiver(
    vehicle: &Vehicle,
    changes: Option<receiver::Changes>,
) -> Result<Option<receiver::Parameters>, String> {
    let wired = vehicle.node_of(Device::SatelliteReceiver);
    let Some((receiver, _)) = vehicle.manifest().receiver.as_ref().zip(wired) else {
        return match changes {
            None => Ok(None),
            Some(_) => Err(without(vehicle, "receiver", "a satellite receiver")),
        };
    };
    let mut parameters = receiver::Parameters::of(receiver);
    parameters.inertial = vehicle.manifest().inertial().is_some();
    changes.unwrap_or_default().apply(&mut parameters);
    Ok(Some(parameters))
}

/// The error message about a table for a device that the vehicle does not have.
pub(super) fn without(vehicle: &Vehicle, table: &str, what: &str) -> String {
    format!("{table}: vehicle {:?} is without {what}", vehicle.name())
}
