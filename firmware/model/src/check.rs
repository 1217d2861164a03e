//! Checks of a manifest beyond its syntax.

use std::collections::BTreeSet;
use std::fmt::Display;

use network_model::{Message, Network, SendType};
use parts::Sled;

use crate::manifest::{
    BackupMaster, BusGuardian, Calibration, Command, CropRows, Device, DistanceSensors,
    DistanceSignals, Inertial, Law, Machine, Manifest, Mission, Node, Planner, Protocol, Receiver,
    RegulatorWeights, Rover, RowGuidance, SelfTest, Sessions, SignalPath, SteeringGains, ThesisLaw,
};
use crate::units::{CountKind, Kind, LengthKind, Quantity, RateKind, SpeedKind, factor, units_of};

/// Full scale of the boards' converters, counts.
pub const FULL_SCALE: f64 = 4095.0;

/// Checks a manifest, by itself and against its network.
///
/// # Errors
/// Names the field at fault, its value and what is accepted.
pub fn check(manifest: &Manifest, network: &Network) -> Result<(), String> {
    nodes(manifest, network)?;
    devices(manifest)?;
    protocol(manifest)?;
    backup_master(manifest.safety.backup_master, network)?;
    if let Some(mode) = &manifest.mode {
        mode_signal(mode, network)?;
    }
    if let Some(command) = &manifest.command {
        self::command(command, manifest, network)?;
    }
    if let Some(self_test) = &manifest.self_test {
        self::self_test(self_test, manifest, network)?;
    }
    if let Some(calibration) = &manifest.calibration {
        self::calibration(calibration, manifest, network)?;
    }
    if let Some(signals) = &manifest.distances {
        distances(signals, manifest, network)?;
    }
    if let Some(receiver) = &manifest.receiver {
        self::receiver(receiver)?;
    }
    if let Some(rover) = &manifest.rover {
        self::rover(rover)?;
    }
    if let Some(rows) = &manifest.row_guidance {
        row_guidance(rows, manifest, network)?;
    }
    if let Some(planner) = &manifest.planner {
        self::planner(planner, manifest, network)?;
    }
    if let Some(mission) = &manifest.mission {
        self::mission(mission, manifest, network)?;
    }
    if let Some(tilt) = &manifest.tilt {
        inertial(tilt, manifest, network)?;
    }
    if let Some(sessions) = &manifest.sessions {
        self::sessions(sessions, manifest, network)?;
    }
    if let Some(guardian) = &manifest.guardian {
        self::guardian(guardian, manifest, network)?;
    }
    match &manifest.machine {
        Some(_) if manifest.rover.is_some() => {
            Err("there are a [machine] and a [rover]: one of the two is accepted".into())
        }
        Some(machine) => {
            self::machine(machine)?;
            waypoints(manifest)
        }
        None => Ok(()),
    }
}

fn nodes(manifest: &Manifest, network: &Network) -> Result<(), String> {
    let mut names = BTreeSet::new();
    for node in &manifest.nodes {
        let name = &node.name;
        if !names.insert(name) {
            return Err(format!("node {name:?} stands twice"));
        }
        if Sled::named(&node.board).is_none() {
            return Err(format!(
                "node {name:?}: there is no board {:?}: {} are accepted",
                node.board,
                Sled::ALL.map(|sled| sled.name).join(" and ")
            ));
        }
        let is_guardian = manifest.is_guardian(node);
        if !is_guardian && !network.nodes.iter().any(|other| other.name == *name) {
            return Err(format!("node {name:?} is not in the network file"));
        }
    }
    // A network file may also name programs on the bus: one that only listens, such as a logger,
    // or one that sends event messages, such as a tester. A window of its own would stay empty.
    let mut messages = network.messages.iter();
    // The planner has no board, but it sends in each cycle.
    let planner = manifest.leading_planner().map(|planner| &planner.name);
    let foreign = |message: &&Message| {
        !names.contains(&message.sender)
            && planner != Some(&message.sender)
            && !matches!(message.send_type, SendType::Event { .. })
    };
    match messages.find(foreign) {
        Some(Message { name, sender, .. }) => Err(format!(
            "the network file has a message {name:?} of a node {sender:?} that the manifest does \
             not have: only event messages are accepted from it"
        )),
        None => Ok(()),
    }
}

/// Signals of a request for the self-test, and of a report.
const REQUEST: [&str; 3] = ["Round", "StartAgain", "Key"];
const REPORT: [&str; 14] = [
    "Round",
    "Reset",
    "Memory",
    "Program",
    "Oscillators",
    "LoopBack",
    "Bus",
    "Reference",
    "Supply",
    "Relay",
    "Stack",
    "ClockError",
    "SupplyVoltage",
    "StackFree",
];

fn self_test(test: &SelfTest, manifest: &Manifest, network: &Network) -> Result<(), String> {
    let find = |key: &str, name: &str, signals: &[&str]| {
        let message = network.messages.iter().find(|message| message.name == name);
        let message = message.ok_or_else(|| {
            format!("[self_test] {key}: there is no message {name:?} in the network file")
        })?;
        if !matches!(message.send_type, SendType::Event { .. }) {
            return Err(format!(
                "[self_test] {key}: the message {name:?} is cyclic: an event message is accepted"
            ));
        }
        let has = |signal: &&&str| message.signals.iter().any(|its| its.name == ***signal);
        match signals.iter().find(|signal| !has(signal)) {
            Some(signal) => Err(format!(
                "[self_test] {key}: the message {name:?} has no signal {signal:?}"
            )),
            None => Ok(message),
        }
    };
    let request = find("request", &test.request, &REQUEST)?;
    if manifest
        .nodes
        .iter()
        .any(|node| node.name == request.sender)
    {
        return Err(format!(
            "[self_test] request: the message {:?} is one of node {:?}: a message of a node that \
             the manifest does not have is accepted",
            request.name, request.sender
        ));
    }
    let nodes = manifest.nodes.iter();
    for node in nodes.filter(|node| !manifest.is_guardian(node)) {
        let key = format!("report, node {:?}", node.name);
        let name = test
            .report
            .get(&node.name)
            .ok_or_else(|| format!("[self_test] {key}: there is no message for it"))?;
        let report = find(&key, name, &REPORT)?;
        if report.sender != node.name {
            return Err(format!(
                "[self_test] {key}: the message {name:?} is one of node {:?}",
                report.sender
            ));
        }
    }
    let unknown = test
        .report
        .keys()
        .find(|name| manifest.nodes.iter().all(|node| node.name != **name));
    match unknown {
        Some(name) => Err(format!("[self_test] report: there is no node {name:?}")),
        None => Ok(()),
    }
}

/// Checks that the boards' bit timing makes the bit rate of the network.
///
/// # Errors
/// Names the attribute of the network file, its value and what is accepted.
pub fn bit_rate(manifest: &Manifest, network: &Network) -> Result<(), String> {
    for node in &manifest.nodes {
        let sled = Sled::named(&node.board).filter(|sled| !sled.has_bit_rate(network.bit_rate));
        if let Some(sled) = sled {
            let rates: Vec<String> = sled.bit_rates.iter().map(u32::to_string).collect();
            return Err(format!(
                "Baudrate is {} bit/s: {} are accepted, the bit rates of the board {} of node {:?}",
                network.bit_rate,
                rates.join(", "),
                sled.name,
                node.name
            ));
        }
    }
    Ok(())
}

fn devices(manifest: &Manifest) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    for node in &manifest.nodes {
        for (connector, &device) in &node.wiring {
            let at = format!("node {:?}, connector {connector:?}", node.name);
            if device.connector() != connector {
                return Err(format!(
                    "{at}: {} {} to the connector {:?}",
                    device.with_article(),
                    if device.is_plural() { "go" } else { "goes" },
                    device.connector()
                ));
            }
            let sled = Sled::named(&node.board);
            if let Some(sled) = sled.filter(|sled| sled.connector(connector).is_none()) {
                let there: Vec<&str> = sled.connectors.iter().map(|place| place.name).collect();
                return Err(format!(
                    "{at}: the board {} has no such connector: it has {}",
                    sled.name,
                    there.join(", ")
                ));
            }
            let many = matches!(device, Device::BenchMotor | Device::Knob);
            if !seen.insert(device) && !many {
                let set = if device.is_plural() { "set of " } else { "" };
                return Err(format!("{at}: there is a second {set}{}", device.name()));
            }
            let needed = match device {
                _ if device.needs_machine() && manifest.machine.is_none() => "machine",
                Device::DistanceSensors if manifest.guidance_by_rows().is_some() => continue,
                _ if device.needs_rover() && manifest.rover.is_none() => "rover",
                _ => continue,
            };
            return Err(format!(
                "{at}: {} needs a [{needed}], which the manifest does not have",
                device.with_article()
            ));
        }
        converter(node)?;
    }
    let moving = [
        Device::SteeringMotor,
        Device::DriveMotor,
        Device::SteeringPotentiometer,
    ];
    let driving = [
        Device::DistanceSensors,
        Device::DriveMotors,
        Device::PinRemote,
    ];
    for (section, there, needed) in [
        ("machine", manifest.machine.is_some(), moving),
        ("rover", manifest.rover.is_some(), driving),
    ] {
        let missing = needed.into_iter().find(|device| !seen.contains(device));
        if let Some(device) = missing.filter(|_| there) {
            return Err(format!(
                "[{section}] needs {}, which no node has in its wiring",
                device.with_article()
            ));
        }
    }
    if seen.contains(&Device::SatelliteReceiver) && manifest.receiver.is_none() {
        return Err("[receiver] is missing: a satellite-receiver is wired".into());
    }
    Ok(())
}

/// The converter of a board serves one connector.
fn converter(node: &Node) -> Result<(), String> {
    let Some(sled) = Sled::named(&node.board) else {
        return Ok(());
    };
    let wired = node.wiring.keys();
    let mut analogue = wired.filter(|name| {
        let connector = sled.connector(name);
        connector.is_some_and(parts::Connector::uses_converter)
    });
    match (analogue.next(), analogue.next()) {
        (Some(first), Some(second)) => Err(format!(
            "node {:?}: the connectors {first:?} and {second:?} use the same converter: one of \
             the two is accepted",
            node.name
        )),
        _ => Ok(()),
    }
}

/// Checks that the nodes can use the bus as the manifest says.
///
/// # Errors
/// Names what needs the schedule.
fn protocol(manifest: &Manifest) -> Result<(), String> {
    if manifest.bus.protocol == Protocol::TimeTriggered {
        return Ok(());
    }
    let reason = if manifest.machine.is_some() {
        "the commands to a [machine] carry the time of their basic cycle"
    } else if manifest.receiver.is_some() {
        "a [receiver] sets the time of the schedule"
    } else if manifest.safety.backup_master == BackupMaster::Drive {
        "safety.backup_master is \"drive\", and without a schedule there is no time master"
    } else {
        return Ok(());
    };
    Err(format!(
        "bus.protocol is \"event-triggered\": \"time-triggered\" is accepted, as {reason}"
    ))
}

/// A vehicle drives on under a backup master only if its network has one.
fn backup_master(backup: BackupMaster, network: &Network) -> Result<(), String> {
    let mut nodes = network.nodes.iter();
    if backup == BackupMaster::Drive && !nodes.any(|node| node.master_rank > Some(0)) {
        return Err(
            "safety.backup_master is \"drive\": \"stop\" is accepted, as no node of the network \
             file has a MasterRank above 0"
                .into(),
        );
    }
    Ok(())
}

fn mode_signal(mode: &crate::manifest::ModeSignal, network: &Network) -> Result<(), String> {
    let message = network
        .messages
        .iter()
        .find(|message| message.name == mode.message)
        .ok_or_else(|| format!("mode.message: there is no message {:?}", mode.message))?;
    let signal = message
        .signals
        .iter()
        .find(|signal| signal.name == mode.signal)
        .ok_or_else(|| {
            format!(
                "mode.signal: message {:?} has no signal {:?}",
                mode.message, mode.signal
            )
        })?;
    let table = network
        .value_tables
        .iter()
        .find(|table| Some(&table.name) == signal.values.as_ref());
    let known = table.is_some_and(|table| {
        let mut values = table.values.iter();
        values.any(|value| value.name == mode.autonomous)
    });
    if known {
        Ok(())
    } else {
        Err(format!(
            "mode.autonomous: signal {:?} has no value {:?}",
            mode.signal, mode.autonomous
        ))
    }
}

/// Checks that a command message has the places of the sequence counter and of the check value by
/// which a motor's node tells a sound command: the last two of its eight bytes.
fn protected(message: &Message) -> Result<(), String> {
    for (name, start) in [("Counter", 48), ("Check", 56)] {
        let mut signals = message.signals.iter();
        let signal = signals.find(|signal| signal.name == name);
        let whole_byte =
            |signal: &&network_model::Signal| signal.start_bit == start && signal.size == 8;
        if message.length != 8 || signal.filter(whole_byte).is_none() {
            return Err(format!(
                "command.message: message {:?} has no signal {name:?} in its byte {}: a message of 8 bytes \
                 with the signals \"Counter\" and \"Check\" in its last two is accepted, by which a node \
                 with a motor tells old and damaged commands from sound ones",
                message.name,
                start / 8
            ));
        }
    }
    Ok(())
}

fn command(command: &Command, manifest: &Manifest, network: &Network) -> Result<(), String> {
    let message = network
        .messages
        .iter()
        .find(|message| message.name == command.message)
        .ok_or_else(|| format!("command.message: there is no message {:?}", command.message))?;
    protected(message)?;
    let mut signals = BTreeSet::new();
    for (&device, name) in &command.enable {
        let field = format!("command.enable.{}", device.name());
        let mut nodes = manifest.nodes.iter();
        if !device.is_motor() || !nodes.any(|node| node.connector(device).is_some()) {
            return Err(format!("{field}: no such motor is wired"));
        }
        match message.signals.iter().find(|signal| signal.name == *name) {
            None => {
                return Err(format!(
                    "{field}: message {:?} has no signal {name:?}",
                    command.message
                ));
            }
            Some(signal) if signal.size != 1 => {
                return Err(format!("{field}: signal {name:?} is not of one bit"));
            }
            Some(_) => {}
        }
        if !signals.insert(name) {
            return Err(format!(
                "{field}: signal {name:?} enables another motor already: each motor needs its own"
            ));
        }
    }
    Ok(())
}

fn calibration(
    calibration: &Calibration,
    manifest: &Manifest,
    network: &Network,
) -> Result<(), String> {
    if manifest.machine.is_none() {
        return Err("calibration: the manifest has no [machine]".into());
    }
    let commands = manifest.command.as_ref().filter(|command| {
        let enables = command.enable.contains_key(&Device::SteeringMotor);
        enables && command.message == calibration.steering_rate.message
    });
    if commands.is_none() {
        return Err(format!(
            "calibration.steering_rate: message {:?} is not the [command] that enables a \
             steering-motor",
            calibration.steering_rate.message
        ));
    }
    if calibration.north.message != calibration.east.message {
        return Err("calibration.east is not in the message of calibration.north".into());
    }
    signal::<CountKind>(
        "calibration.potentiometer",
        &calibration.potentiometer,
        network,
    )?;
    signal::<RateKind>(
        "calibration.steering_rate",
        &calibration.steering_rate,
        network,
    )?;
    signal::<LengthKind>("calibration.north", &calibration.north, network)?;
    signal::<LengthKind>("calibration.east", &calibration.east, network)
}

/// Checks that a signal exists and has a unit of `K`.
fn signal<K: Kind>(field: &str, path: &SignalPath, network: &Network) -> Result<(), String> {
    let SignalPath { message, signal } = path;
    let mut messages = network.messages.iter();
    let found = messages
        .find(|other| other.name == *message)
        .ok_or_else(|| format!("{field}: there is no message {message:?}"))?;
    let mut signals = found.signals.iter();
    let found = signals
        .find(|other| other.name == *signal)
        .ok_or_else(|| format!("{field}: message {message:?} has no signal {signal:?}"))?;
    match factor::<K>(&found.unit) {
        Some(_) => Ok(()),
        None => Err(format!(
            "{field}: the unit of signal {signal:?} is {:?}: {} is accepted",
            found.unit,
            units_of::<K>()
        )),
    }
}

fn distances(
    signals: &DistanceSignals,
    manifest: &Manifest,
    network: &Network,
) -> Result<(), String> {
    if manifest.rover.is_none() {
        return Err("distances: the manifest has no [rover]".into());
    }
    signal::<LengthKind>("distances.left", &signals.left, network)?;
    signal::<LengthKind>("distances.right", &signals.right, network)
}

fn receiver(receiver: &Receiver) -> Result<(), String> {
    within("receiver.latency", receiver.latency, 0.0, 0.25)?;
    above("receiver.burst", receiver.burst, 0.09)?;
    within("receiver.period", receiver.period, 0.05, 1.0)?;
    within("receiver.lead", receiver.lead, 0.0, 0.05)
}

/// Checks those numbers of a machine that its control law does not depend on;
/// [`crate::design::check`] checks the others.
fn machine(machine: &Machine) -> Result<(), String> {
    let degrees = |value: f64| value.to_radians();
    above(
        "machine.limits.acceleration",
        machine.limits.acceleration,
        20.0,
    )?;
    if let Some(weights) = &machine.weights {
        regulator("firm", &weights.firm)?;
        regulator("gentle", &weights.gentle)?;
    }
    steering_gains(machine.thesis)?;
    potentiometer(machine)?;
    for (name, direction) in [
        ("right", machine.steering.right),
        ("left", machine.steering.left),
    ] {
        let field = |what: &str| format!("machine.steering.{name}.{what}");
        within(&field("dead_band"), direction.dead_band, 0.0, 0.5)?;
        within(
            &field("full_rate"),
            direction.full_rate,
            degrees(1.0),
            degrees(180.0),
        )?;
    }
    let (limits, steering) = (&machine.limits, &machine.steering);
    above("machine.steering.travel", steering.travel, degrees(60.0))?;
    at_most(
        "machine.limits.steering_angle",
        limits.steering_angle,
        "machine.steering.travel",
        steering.travel,
    )?;
    within("machine.drive.dead_band", machine.drive.dead_band, 0.0, 0.5)?;
    above("machine.drive.full_speed", machine.drive.full_speed, 10.0)?;
    at_most(
        "machine.limits.speed",
        limits.speed,
        "machine.drive.full_speed",
        machine.drive.full_speed,
    )
}

/// Checks the gains of the thesis's law. The firmware has them in single precision.
fn steering_gains(gains: SteeringGains) -> Result<(), String> {
    let largest = 1000.0;
    let field = |key: &str| format!("machine.thesis.{key}");
    number(&field("cross_track"), gains.cross_track, 1e-6, largest)?;
    number(&field("heading"), gains.heading, 0.0, largest)?;
    number(&field("steering_angle"), gains.steering_angle, 0.0, largest)
}

/// Checks those numbers of a rover that [`crate::design::check`] does not check.
fn rover(rover: &Rover) -> Result<(), String> {
    within("rover.length", rover.length, 0.1, 5.0)?;
    within("rover.width", rover.width, 0.1, 3.0)?;
    within("rover.track", rover.track, 0.05, 3.0)?;
    within("rover.turning_track", rover.turning_track, 0.05, 10.0)?;
    within("rover.axle_spacing", rover.axle_spacing, 0.02, 2.0)?;
    let motors = &rover.motors;
    within("rover.motors.dead_band", motors.dead_band, 0.0, 0.5)?;
    above("rover.motors.full_speed", motors.full_speed, 10.0)?;
    within("rover.motors.lag", motors.lag, 0.0, 1.0)?;
    above("rover.cruise", rover.cruise, motors.full_speed.get() * 0.5)?;
    distance_sensors("rover", &rover.sensors)?;
    crop_rows("rover", &rover.rows, ("width", rover.width))?;
    rows_in_range("rover", &rover.sensors, &rover.rows)?;
    thesis_law(&rover.thesis)
}

/// Checks the numbers of the thesis's law. The firmware has them in single precision.
fn thesis_law(law: &ThesisLaw) -> Result<(), String> {
    let field = |key: &str| format!("rover.thesis.{key}");
    // Distances are whole centimetres: a range without two of them holds every sample.
    let step = 0.01;
    let largest = LARGEST_OF_THESIS;
    within(&field("least"), law.least, 0.0, largest - step)?;
    within(&field("most"), law.most, law.least.get() + step, largest)?;
    within(&field("difference"), law.difference, step, largest)?;
    // The command has steps of 1/500.
    within(&field("effort"), law.effort, 0.002, 1.0)?;
    number(&field("process"), law.process, 1e-6, 100.0)?;
    number(&field("proportional"), law.proportional, 1e-6, 1.0)?;
    if law.integral == 0.0 {
        return Ok(());
    }
    number(&field("integral"), law.integral, 1e-6, 1.0)
        .map_err(|refused| refused.replace(" is accepted", " and 0 are accepted"))
}

/// Refuses a number without a unit out of its range.
fn number(field: &str, value: f64, least: f64, most: f64) -> Result<(), String> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    // Written as a manifest takes them: an exponent instead of 300 digits.
    Err(format!(
        "{field} is {value:?}: {least:?} to {most:?} is accepted"
    ))
}

/// Checks the distance sensors of a section.
fn distance_sensors(section: &str, sensors: &DistanceSensors) -> Result<(), String> {
    let field = |key: &str| format!("{section}.sensors.{key}");
    within(&field("ahead"), sensors.ahead, -5.0, 5.0)?;
    above(&field("beside"), sensors.beside, 3.0)?;
    let right = core::f64::consts::FRAC_PI_2;
    within(&field("angle"), sensors.angle, right / 9.0, right)?;
    within(&field("least"), sensors.least, 0.0, 1.5)?;
    let least = sensors.least.get();
    within(&field("open"), sensors.open, least, LARGEST_DISTANCE)
}

/// Room that the rows leave on either side of a robot in their middle, at least, metres. Where there
/// is less, the virtual row follower touches plants even in a row without leaves and gaps, at 0.4 m/s.
const ROOM: f64 = 0.1;

/// Checks the rows of a section, for a robot of the width that the key `of` has.
fn crop_rows(
    section: &str,
    rows: &CropRows,
    (of, robot): (&str, Quantity<LengthKind>),
) -> Result<(), String> {
    let field = |key: &str| format!("{section}.rows.{key}");
    within(&field("stalk"), rows.stalk, 0.004, 0.2)?;
    let needed = rounded(robot.get() + rows.stalk.get() + 2.0 * ROOM);
    within(&field("width"), rows.width, needed.get(), 5.0).map_err(|refused| {
        if rows.width > needed {
            return refused;
        }
        format!(
            "{refused}: {section}.{of}, {robot}, {section}.rows.stalk, {}, and {} of room on either side",
            rows.stalk,
            Quantity::<LengthKind>::new(ROOM),
        )
    })?;
    above(&field("tolerance"), rows.tolerance, 1.0)?;
    above(&field("gap"), rows.gap, 5.0)
}

/// A length in whole tenths of a millimetre: a sum has further digits that mean nothing.
fn rounded(metres: f64) -> Quantity<LengthKind> {
    Quantity::new((metres * 1e4).round() / 1e4)
}

/// Checks that the sensors of a section measure its rows when the robot is in the middle of them.
fn rows_in_range(section: &str, sensors: &DistanceSensors, rows: &CropRows) -> Result<(), String> {
    let across = rows.width.get() / 2.0 + sensors.beside.get();
    let along = across / sensors.angle.get().sin();
    if along > sensors.least.get() && along < sensors.open.get() {
        return Ok(());
    }
    Err(format!(
        "{section}.rows.width is {}: with {section}.sensors.beside and angle the rows are {along:.3} m away \
         along the beams, but more than {} ({section}.sensors.least) and less than {} (open) is accepted",
        rows.width, sensors.least, sensors.open
    ))
}

/// Checks those numbers of a guidance by rows that [`crate::design::check`] does not check, be it
/// on or off.
fn row_guidance(rows: &RowGuidance, manifest: &Manifest, network: &Network) -> Result<(), String> {
    let Some(machine) = &manifest.machine else {
        return Err("[row_guidance] needs a [machine], which the manifest does not have".into());
    };
    above("row_guidance.speed", rows.speed, machine.cruise.get())?;
    let cycle = f64::from(network.basic_cycle_us) * 1e-6;
    let age = rows.longest_age;
    within("row_guidance.longest_age", age, 2.0 * cycle, 1.0)?;
    within("row_guidance.longest_way", rows.longest_way, 1.0, 1e3)?;
    within("row_guidance.settle", rows.settle, 0.0, 60.0)?;
    within("row_guidance.take_back", rows.take_back, 0.01, 0.2)?;
    let width = rows.vehicle_width;
    within("row_guidance.vehicle_width", width, 0.1, 3.0)?;
    distance_sensors("row_guidance", &rows.sensors)?;
    crop_rows("row_guidance", &rows.rows, ("vehicle_width", width))?;
    rows_in_range("row_guidance", &rows.sensors, &rows.rows)?;
    if rows.node.connector(Device::DistanceSensors).is_none() {
        return Err(
            "row_guidance.node needs distance-sensors, which it does not have in its wiring".into(),
        );
    }
    if rows.enabled {
        named_values("row_guidance.guide", &rows.guide, network)?;
    }
    Ok(())
}

/// Checks that a signal exists whose values have names.
fn named_values(key: &str, path: &SignalPath, network: &Network) -> Result<(), String> {
    let SignalPath { message, signal } = path;
    let mut messages = network.messages.iter();
    let found = messages.find(|other| other.name == *message);
    let found = found.and_then(|message| message.signals.iter().find(|its| its.name == *signal));
    match found {
        Some(signal) if signal.values.is_some() => Ok(()),
        _ => Err(format!(
            "{key}: there is no signal {message}.{signal} with a value table"
        )),
    }
}

/// Checks that one thing at most guides a run besides the path. Before the network file is put together: each brings
/// messages of its own.
///
/// # Errors
/// Names the two that are on.
pub fn guide(manifest: &Manifest) -> Result<(), String> {
    if manifest.leading_planner().is_none() || manifest.guidance_by_rows().is_none() {
        return Ok(());
    }
    Err(
        "row_guidance.enabled and planner.enabled: one of the two is accepted, which guides a run besides the path"
            .into(),
    )
}

/// Checks a planner, be it on or off.
fn planner(planner: &Planner, manifest: &Manifest, network: &Network) -> Result<(), String> {
    if manifest.machine.is_none() {
        return Err("[planner] needs a [machine], which the manifest does not have".into());
    }
    let cycle = f64::from(network.basic_cycle_us) * 1e-6;
    within("planner.longest_age", planner.longest_age, 2.0 * cycle, 1.0)?;
    let lateral = planner.lateral_acceleration;
    within("planner.lateral_acceleration", lateral, 0.1, 10.0)?;
    let Planner { name, command, .. } = planner;
    if manifest.nodes.iter().any(|node| node.name == *name) {
        return Err(format!(
            "planner.name is {name:?}, which a node with a board has: another name is accepted"
        ));
    }
    if !planner.enabled {
        return Ok(());
    }
    named_values("planner.lead", &planner.lead, network)?;
    let mut messages = network.messages.iter();
    let Some(message) = messages.find(|other| other.name == *command) else {
        return Err(format!("planner.command: there is no message {command:?}"));
    };
    if message.sender != *name {
        return Err(format!(
            "planner.command: {command:?} is a message of {:?}, not of planner.name, {name:?}",
            message.sender
        ));
    }
    let has = |signal: &str| message.signals.iter().any(|its| its.name == signal);
    match ["Curvature", "Speed"].into_iter().find(|name| !has(name)) {
        Some(missing) => Err(format!(
            "planner.command: {command:?} has no signal {missing:?}"
        )),
        None => Ok(()),
    }
}

/// Checks roll and pitch, be they on or off.
fn inertial(tilt: &Inertial, manifest: &Manifest, network: &Network) -> Result<(), String> {
    let Some(machine) = &manifest.machine else {
        return Err("[tilt] needs a [machine], which the manifest does not have".into());
    };
    if manifest.receiver.is_none() {
        return Err("[tilt] needs a [receiver], which the manifest does not have".into());
    }
    let cycle = f64::from(network.basic_cycle_us) * 1e-6;
    within("tilt.longest_age", tilt.longest_age, 2.0 * cycle, 5.0)?;
    if tilt.enabled && machine.law == Law::Thesis {
        return Err(
            "tilt.enabled with machine.law \"thesis\": that law takes the ground for level, so \"furrow\" is accepted"
                .into(),
        );
    }
    Ok(())
}

/// Checks sessions, if they are on.
fn sessions(sessions: &Sessions, manifest: &Manifest, network: &Network) -> Result<(), String> {
    if !sessions.enabled {
        return Ok(());
    }
    if sessions.starts.is_empty() {
        return Err(
            "sessions.starts is empty: the signal of a node that obeys commands is accepted".into(),
        );
    }
    for SignalPath { message, signal } in &sessions.starts {
        let mut messages = network.messages.iter();
        let Some(found) = messages.find(|other| other.name == *message) else {
            return Err(format!("sessions.starts: there is no message {message:?}"));
        };
        if !found.signals.iter().any(|its| its.name == *signal) {
            return Err(format!(
                "sessions.starts: {message:?} has no signal {signal:?}"
            ));
        }
        let sender = &found.sender;
        let mut nodes = manifest.nodes.iter();
        let board = nodes
            .find(|node| node.name == *sender)
            .map(|node| &node.board);
        let sled = board.and_then(|board| Sled::named(board));
        if sled.is_none_or(|sled| sled.starts.is_none()) {
            return Err(format!(
                "sessions.starts: {sender:?}, which sends {message:?}, has no board with room to count its starts: f303 has it"
            ));
        }
    }
    Ok(())
}

/// Checks missions, be they on or off.
fn mission(mission: &Mission, manifest: &Manifest, network: &Network) -> Result<(), String> {
    let Some(machine) = &manifest.machine else {
        return Err("[mission] needs a [machine], which the manifest does not have".into());
    };
    above(
        "mission.turn_speed",
        mission.turn_speed,
        machine.limits.speed.get(),
    )?;
    within("mission.reserve", mission.reserve, 0.0, 0.5)?;
    above("mission.width", mission.width, 20.0)?;
    within("mission.ahead", mission.ahead, 0.0, 20.0)?;
    within("mission.behind", mission.behind, 0.0, 20.0)?;
    within("mission.clearance", mission.clearance, 0.0, 5.0)?;
    within("mission.aside", mission.aside, 0.0, 5.0)?;
    if !mission.enabled {
        return Ok(());
    }
    let noise = machine.sensors.velocity.get();
    let slowest = control::mission::slowest(control::vehicle::standstill(noise));
    // Rounded up, so that the number in the sentence is accepted.
    let least = Quantity::<SpeedKind>::new((slowest * 100.0).ceil() / 100.0);
    refuse(
        mission.turn_speed.get() >= slowest,
        "mission.turn_speed",
        mission.turn_speed,
        format_args!("{least} or more, where the receiver tells the heading,"),
    )?;
    // With its front axle before its ground, a vehicle would pass through its fence. A vehicle of another length that drives no
    // missions need not say what ground it covers.
    let wheelbase = machine.rear_to_antenna.get() + machine.antenna_to_front.get();
    refuse(
        mission.ahead.get() as f32 >= wheelbase as f32,
        "mission.ahead",
        mission.ahead,
        format_args!(
            "the wheelbase (machine.rear_to_antenna and machine.antenna_to_front together, {}) to 20 m",
            Quantity::<LengthKind>::new(wheelbase)
        ),
    )?;
    if machine.law == Law::Thesis {
        return Err(
            "mission.enabled with machine.law \"thesis\": that law follows one line, so \"furrow\" is accepted".into(),
        );
    }
    sections(&mission.sections, network)?;
    let operated = |node: &&Node| node.connector(Device::OperatorSwitches).is_some();
    let boards = manifest.nodes.iter().filter(operated);
    let room = |node: &Node| Sled::named(&node.board).is_some_and(|sled| sled.mission.is_some());
    match boards
        .filter(|node| !room(node))
        .map(|node| &node.board)
        .next()
    {
        Some(board) => Err(format!(
            "mission.enabled: the board {board:?} of the node with the operator's switches has no room for a mission"
        )),
        None => Ok(()),
    }
}

/// Checks the message about the sections of an implement.
fn sections(name: &str, network: &Network) -> Result<(), String> {
    let mut messages = network.messages.iter();
    let Some(message) = messages.find(|message| message.name == name) else {
        return Err(format!("mission.sections: there is no message {name:?}"));
    };
    let has = |signal: &String| message.signals.iter().any(|its| its.name == *signal);
    let signals =
        (1..=8).flat_map(|section| [format!("State{section}"), format!("After{section}")]);
    match signals.into_iter().find(|signal| !has(signal)) {
        Some(missing) => Err(format!(
            "mission.sections: {name:?} has no signal {missing:?}"
        )),
        None => Ok(()),
    }
}

/// Checks which nodes a bus guardian of this name guards on its board.
fn guarded(
    guards: &[String],
    guardian: &str,
    sled: &Sled,
    manifest: &Manifest,
    network: &Network,
) -> Result<(), String> {
    let taps = sled.taps.len();
    if guards.len() != taps {
        let count = |count: usize, what: &str| match count {
            1 => format!("1 {what}"),
            more => format!("{more} {what}s"),
        };
        return Err(format!(
            "guardian.guards has {}, but the board {} has {}: a node for each tap is accepted",
            count(guards.len(), "node"),
            sled.name,
            count(taps, "tap")
        ));
    }
    // A potential master repeats its reference when nobody acknowledges it, and that is not seen on its own line.
    let is_master = |name: &str| {
        let mut nodes = network.nodes.iter();
        nodes.any(|node| node.name == name && node.master_rank.is_some())
    };
    let nodes = manifest.nodes.iter().map(|node| node.name.as_str());
    let nodes: Vec<&str> = nodes.filter(|name| *name != guardian).collect();
    let accepted = nodes.iter().filter(|name| taps > 1 || !is_master(name));
    let accepted = accepted.copied().collect::<Vec<&str>>().join(" or ");
    for (at, name) in guards.iter().enumerate() {
        if !nodes.contains(&name.as_str()) {
            return Err(format!(
                "guardian.guards: there is no node {name:?} to guard: {accepted} is accepted"
            ));
        }
        if guards.iter().skip(at + 1).any(|other| other == name) {
            return Err(format!("guardian.guards: node {name:?} stands twice"));
        }
        if taps == 1 && is_master(name) {
            return Err(format!(
                "guardian.guards has {name:?}, a potential master, but a guardian on the board {} sees no other line than \
                 the guarded one: {accepted} is accepted",
                sled.name
            ));
        }
    }
    Ok(())
}

/// Checks a bus guardian, be it on or off.
fn guardian(guardian: &BusGuardian, manifest: &Manifest, network: &Network) -> Result<(), String> {
    let BusGuardian { guards, node, .. } = guardian;
    if manifest.bus.protocol == Protocol::EventTriggered {
        return Err(
            "[guardian] needs bus.protocol \"time-triggered\": it guards by the schedule".into(),
        );
    }
    let sled = Sled::named(&node.board).filter(|sled| !sled.taps.is_empty());
    let Some(sled) = sled else {
        let boards = Sled::ALL.iter().filter(|sled| !sled.taps.is_empty());
        let boards: Vec<&str> = boards.map(|sled| sled.name).collect();
        return Err(format!(
            "guardian.node.board is {:?}: {} is accepted, which has taps for TX lines",
            node.board,
            boards.join(" or ")
        ));
    };
    if let Some(connector) = node.wiring.keys().next() {
        return Err(format!(
            "guardian.node.wiring has {connector:?}: nothing but TX lines is accepted, and `guards` has those"
        ));
    }
    guarded(guards, &node.name, sled, manifest, network)?;
    // Nothing could make it send: no message is its own.
    if network.nodes.iter().any(|other| other.name == node.name) {
        return Err(format!(
            "guardian.node.name is {:?}: a name that the network file does not have is accepted, as a guardian sends nothing",
            node.name
        ));
    }
    Ok(())
}

/// Largest distance that a rover's nodes tell each other, metres.
const LARGEST_DISTANCE: f64 = 2.5;

/// Largest distance that the thesis's law gets, metres (thesis 2.2.4.2).
const LARGEST_OF_THESIS: f64 = 1.5;

/// Refuses a number that is not above 0 in single precision, unless it is 0 and `zero` is accepted
/// too.
fn positive(field: &str, value: f64, zero: bool) -> Result<(), String> {
    let single = value as f32;
    let sound = single >= f32::MIN_POSITIVE || zero && value == 0.0;
    if sound && single.is_finite() {
        return Ok(());
    }
    let range = if zero {
        "0 or a number above it"
    } else {
        "a number above 0"
    };
    Err(format!("{field} is {value:?}: {range} is accepted"))
}

/// Checks the weights of a regulator: `name` is its key in `machine.weights`.
fn regulator(name: &str, weights: &RegulatorWeights) -> Result<(), String> {
    let RegulatorWeights {
        integral,
        cross_track,
        heading,
        steering_angle,
        steering_rate,
    } = *weights;
    for (key, weight, accepts_zero) in [
        ("integral", integral, false),
        ("cross_track", cross_track, false),
        ("heading", heading, true),
        ("steering_angle", steering_angle, true),
        ("steering_rate", steering_rate, false),
    ] {
        positive(
            &format!("machine.weights.{name}.{key}"),
            weight,
            accepts_zero,
        )?;
    }
    Ok(())
}

fn potentiometer(machine: &Machine) -> Result<(), String> {
    let pot = &machine.potentiometer;
    within("machine.potentiometer.centre", pot.centre, 0.0, FULL_SCALE)?;
    let slope = pot.slope.get().to_radians();
    let travel = (machine.steering.travel.get().to_degrees() * 1e9).round() / 1e9;
    if !(-80.0..=80.0).contains(&slope) {
        return Err(format!(
            "machine.potentiometer.slope is {slope} counts/deg: -80 to 80 counts/deg is accepted"
        ));
    }
    let range = (slope * travel).abs();
    let centre = pot.centre.get();
    if slope.abs() < 1.0 || centre < range || centre + range > FULL_SCALE {
        return Err(format!(
            "machine.potentiometer: {centre} counts straight ahead and {slope} counts for a \
             degree do not cover {travel} degrees to each side"
        ));
    }
    Ok(())
}

fn waypoints(manifest: &Manifest) -> Result<(), String> {
    let [first, last] = manifest.waypoints.as_slice() else {
        return Err(format!(
            "waypoint: there are {}: a run is a line between two",
            manifest.waypoints.len()
        ));
    };
    for (index, point) in manifest.waypoints.iter().enumerate() {
        within(&format!("waypoint[{index}].north"), point.north, -1e4, 1e4)?;
        within(&format!("waypoint[{index}].east"), point.east, -1e4, 1e4)?;
    }
    let length = (last.north.get() - first.north.get()).hypot(last.east.get() - first.east.get());
    if length < 1.0 {
        return Err(format!(
            "waypoint: the run is {length:.3} m long: 1 m or more is accepted"
        ));
    }
    Ok(())
}

fn within<K: Kind>(field: &str, value: Quantity<K>, least: f64, most: f64) -> Result<(), String> {
    refuse(
        (least..=most).contains(&value.get()),
        field,
        value,
        format_args!(
            "{} to {}",
            Quantity::<K>::new(least),
            Quantity::<K>::new(most)
        ),
    )
}

/// Refuses a value that is not above 0 or too large. What is 0 in single precision, as the firmware
/// has it, is not above 0.
fn above<K: Kind>(field: &str, value: Quantity<K>, most: f64) -> Result<(), String> {
    refuse(
        value.get() as f32 >= f32::MIN_POSITIVE && value.get() <= most,
        field,
        value,
        format_args!("above 0 to {}", Quantity::<K>::new(most)),
    )
}

/// Refuses a value above the one of another key.
fn at_most<K: Kind>(
    field: &str,
    value: Quantity<K>,
    other: &str,
    most: Quantity<K>,
) -> Result<(), String> {
    refuse(
        value <= most,
        field,
        value,
        format_args!("up to {other}, {most},"),
    )
}

fn refuse<K: Kind>(
    accepted: bool,
    field: &str,
    value: Quantity<K>,
    range: impl Display,
) -> Result<(), String> {
    if accepted {
        Ok(())
    } else {
        Err(format!("{field} is {value}: {range} is accepted"))
    }
}
