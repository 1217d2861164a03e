//! Checks the ranges of a scenario's values.

use vehicle_model::{Device, Vehicle};

use super::file::without;
use super::{BrownOut, BusEvent, Button, DURATIONS, LARGEST_ERROR, Scenario};
use crate::units::{
    Angle, Compliance, Count, CountSlope, Drift, Kind, Length, Ppm, Quantity, Rate, Ratio, Speed,
    Time, Voltage,
};
use crate::vehicle::Parameters;

/// The range of values that a field accepts.
pub(crate) struct Range<K> {
    least: Quantity<K>,
    most: Quantity<K>,
    /// True if `least` itself is not allowed.
    open: bool,
}

pub(crate) fn between<K>(least: Quantity<K>, most: Quantity<K>) -> Range<K> {
    Range {
        least,
        most,
        open: false,
    }
}

pub(crate) fn above<K>(least: Quantity<K>, most: Quantity<K>) -> Range<K> {
    Range {
        least,
        most,
        open: true,
    }
}

type Outcome = Result<(), String>;

pub(crate) fn within<K: Kind>(field: &str, value: Quantity<K>, range: Range<K>) -> Outcome {
    let low = if range.open {
        value <= range.least
    } else {
        value < range.least
    };
    if low || value > range.most {
        let from = if range.open { "above " } else { "" };
        return Err(format!(
            "{field}: {value} is out of range, it takes {from}{} to {}",
            range.least, range.most
        ));
    }
    Ok(())
}

pub(super) fn whole(field: &str, value: u64, least: u64, most: u64) -> Outcome {
    if (least..=most).contains(&value) {
        Ok(())
    } else {
        Err(format!(
            "{field}: {value} is out of range, it takes {least} to {most}"
        ))
    }
}

pub(super) fn times() -> Range<crate::units::TimeKind> {
    between(Time::new(0.0), Time::new(86_400.0))
}

fn coordinates() -> Range<crate::units::LengthKind> {
    between(Length::new(-10_000.0), Length::new(10_000.0))
}

pub(super) fn later(field: &str, from: Time, until: Option<Time>) -> Outcome {
    let Some(until) = until else { return Ok(()) };
    within(&format!("{field}.until"), until, times())?;
    if until <= from {
        return Err(format!(
            "{field}.until: {until} is not after the beginning at {from}"
        ));
    }
    Ok(())
}

/// Returns the first error: a value out of its range, as `field: value is out of range, it takes
/// ...`, or a table for a device that the vehicle does not have.
pub(super) fn check(scenario: &Scenario, vehicle: &Vehicle) -> Outcome {
    within(
        "duration",
        scenario.duration,
        between(Time::new(*DURATIONS.start()), Time::new(*DURATIONS.end())),
    )?;
    if scenario.key && vehicle.is_event_triggered() {
        return Err(
            "key: the nodes are event-triggered and have no system time, so with a key they would obey no \
             command; false is accepted"
                .into(),
        );
    }
    if let Some(machine) = &scenario.vehicle {
        self::machine(machine)?;
        start(scenario, machine)?;
    }
    ground(scenario)?;
    if let Some(crop) = &scenario.crop {
        crop.check()?;
    }
    if let Some(setting) = &scenario.row {
        setting.check()?;
    }
    super::rover::faults(&scenario.distance_fault)?;
    super::expect::check(scenario, vehicle)?;
    receiver(scenario)?;
    within(
        "lcd.delay",
        scenario.lcd.delay,
        between(Time::new(0.0), Time::new(0.1)),
    )?;
    for (node, clock) in vehicle.nodes().zip(&scenario.nodes) {
        let node = &vehicle.node(node).name;
        for (name, ppm, most) in [
            ("crystal", clock.crystal, 100.0),
            ("internal", clock.internal, LARGEST_ERROR),
        ] {
            if let Some(ppm) = ppm {
                let range = between(Ppm::new(-most), Ppm::new(most));
                within(&format!("nodes.{node}.{name}"), ppm, range)?;
            }
        }
        let drifts = between(Drift::new(-5_000.0), Drift::new(5_000.0));
        within(&format!("nodes.{node}.drift"), clock.drift, drifts)?;
    }
    operator(scenario)?;
    knobs(scenario, vehicle)?;
    wires(scenario, vehicle)?;
    faults(scenario)?;
    devices(scenario, vehicle)?;
    ends(scenario)
}

/// Checks that everything begins before the run ends.
fn ends(scenario: &Scenario) -> Outcome {
    let end = scenario.duration;
    match scenario.beginnings().into_iter().find(|(_, at)| *at >= end) {
        Some((table, at)) => Err(format!(
            "{table}: it begins at {at}, but the duration of the run is {end}"
        )),
        None => Ok(()),
    }
}

/// Checks that the vehicle has the devices that the scenario uses.
fn devices(scenario: &Scenario, vehicle: &Vehicle) -> Outcome {
    let tables = [
        ("fix", !scenario.fix.is_empty(), Device::SatelliteReceiver),
        (
            "inertial",
            !scenario.inertial.is_empty(),
            Device::SatelliteReceiver,
        ),
        (
            "stream",
            !scenario.stream.is_empty(),
            Device::SatelliteReceiver,
        ),
        ("joystick", !scenario.joystick.is_empty(), Device::Joystick),
        (
            "stop_loop",
            !scenario.stop_loop.is_empty(),
            Device::OperatorSwitches,
        ),
        (
            "distance_fault",
            !scenario.distance_fault.is_empty(),
            Device::DistanceSensors,
        ),
    ];
    for (table, given, device) in tables {
        if given && vehicle.node_of(device).is_none() {
            let what = format!("a device {:?}", device.name());
            return Err(without(vehicle, table, &what));
        }
    }
    presses(scenario, vehicle)?;
    let remotes = [Device::OperatorSwitches, Device::PinRemote];
    let remote = remotes.iter().any(|&one| vehicle.node_of(one).is_some());
    let tables = [
        ("remote", scenario.remote.kind.is_some()),
        ("supply", !scenario.supply.is_empty()),
    ];
    match tables.iter().find(|(_, given)| *given) {
        Some((table, _)) if !remote => Err(without(vehicle, table, "a remote control")),
        _ => Ok(()),
    }
}

/// Checks that the vehicle has the buttons that are pressed.
fn presses(scenario: &Scenario, vehicle: &Vehicle) -> Outcome {
    let wired = |button: &Button| vehicle.node_of(button.input().device()).is_some();
    for (i, press) in scenario.press.iter().enumerate() {
        if !wired(&press.button) {
            let known = Button::ALL.iter().filter(|button| wired(button));
            let known: Vec<&str> = known.map(|button| button.name()).collect();
            let accepted = match known.as_slice() {
                [] => "nor another one, leave it out".into(),
                known => format!("it takes {}", known.join(", ")),
            };
            return Err(format!(
                "press[{i}].button: vehicle {:?} has no button {}, {accepted}",
                vehicle.name(),
                press.button.name()
            ));
        }
    }
    Ok(())
}

fn knobs(scenario: &Scenario, vehicle: &Vehicle) -> Outcome {
    for (i, turn) in scenario.knob.iter().enumerate() {
        within(&format!("knob[{i}].at"), turn.at, times())?;
        let ways = between(Ratio::new(0.0), Ratio::new(1.0));
        within(&format!("knob[{i}].position"), turn.position, ways)?;
        let node = vehicle.node(turn.node);
        if node.connector(Device::Knob).is_none() {
            return Err(format!(
                "knob[{i}].node: no knob is wired to {:?}",
                node.name
            ));
        }
    }
    Ok(())
}

fn wires(scenario: &Scenario, vehicle: &Vehicle) -> Outcome {
    let wires = scenario.wire.iter().map(|noise| noise.node);
    let relays = scenario.relay.iter().map(|fault| fault.node);
    let named = wires.enumerate().map(|event| ("wire", event));
    for (field, (i, node)) in named.chain(relays.enumerate().map(|event| ("relay", event))) {
        let node = vehicle.node(node);
        if !node.wiring.values().any(|device| device.has_relay()) {
            return Err(format!(
                "{field}[{i}].node: no motor is wired to {:?}",
                node.name
            ));
        }
    }
    Ok(())
}

fn start(scenario: &Scenario, machine: &Parameters) -> Outcome {
    let start = &scenario.start;
    within("start.north", start.north, coordinates())?;
    within("start.east", start.east, coordinates())?;
    let turn = between(Angle::degrees(-360.0), Angle::degrees(360.0));
    within("start.heading", start.heading, turn)?;
    let limit = machine.steering_limit.get();
    let stops = between(Angle::new(-limit), Angle::new(limit));
    within("start.steering", start.steering, stops)?;
    let speeds = between(Speed::new(0.0), machine.top_speed);
    within("start.speed", start.speed, speeds)?;
    let Some(line) = &scenario.line else {
        return Ok(());
    };
    for (name, point) in [("from", line.from), ("to", line.to)] {
        within(&format!("line.{name}.north"), point.north, coordinates())?;
        within(&format!("line.{name}.east"), point.east, coordinates())?;
    }
    if line.length() < 1.0 {
        return Err("line: the two waypoints coincide, they must be at least 1 m apart".into());
    }
    Ok(())
}

fn machine(v: &Parameters) -> Outcome {
    let lengths = |least: f64, most: f64| between(Length::new(least), Length::new(most));
    let bands = || between(Ratio::new(0.0), Ratio::new(0.5));
    within(
        "vehicle.rear_to_antenna",
        v.rear_to_antenna,
        lengths(-10.0, 10.0),
    )?;
    let wheelbase = v.wheelbase();
    if !(0.1..=10.0).contains(&wheelbase) {
        return Err(format!(
            "vehicle: the wheelbase is {wheelbase:.3} m, rear_to_antenna and antenna_to_front \
             must sum up to 0.1 to 10 m"
        ));
    }
    within("vehicle.antenna_right", v.antenna_right, lengths(-5.0, 5.0))?;
    within(
        "vehicle.antenna_height",
        v.antenna_height,
        lengths(0.0, 10.0),
    )?;
    within(
        "vehicle.top_speed",
        v.top_speed,
        above(Speed::new(0.0), Speed::new(10.0)),
    )?;
    within("vehicle.drive_dead_band", v.drive_dead_band, bands())?;
    within(
        "vehicle.drive_lag",
        v.drive_lag,
        between(Time::new(0.0), Time::new(10.0)),
    )?;
    let limits = above(Angle::degrees(0.0), Angle::degrees(60.0));
    within("vehicle.steering_limit", v.steering_limit, limits)?;
    let rates = || above(Rate::degrees(0.0), Rate::degrees(180.0));
    within("vehicle.rate_right", v.rate_right, rates())?;
    within("vehicle.rate_left", v.rate_left, rates())?;
    let gains = between(Ratio::new(0.1), Ratio::new(2.0));
    within("vehicle.actuator_gain", v.actuator_gain, gains)?;
    within("vehicle.dead_band_right", v.dead_band_right, bands())?;
    within("vehicle.dead_band_left", v.dead_band_left, bands())?;
    let biases = between(Angle::degrees(-10.0), Angle::degrees(10.0));
    within("vehicle.steering_bias", v.steering_bias, biases)?;
    let readings = between(Count::new(0.0), Count::new(4095.0));
    within("vehicle.pot_centre", v.pot_centre, readings)?;
    let steepest = 80.0 / Angle::degrees(1.0).get();
    let slopes = between(CountSlope::new(-steepest), CountSlope::new(steepest));
    within("vehicle.pot_slope", v.pot_slope, slopes)?;
    if v.pot_slope.get() == 0.0 {
        return Err("vehicle.pot_slope: 0 counts/deg would hide the steering angle".into());
    }
    within(
        "vehicle.pot_noise",
        v.pot_noise,
        between(Count::new(0.0), Count::new(100.0)),
    )
}

fn ground(scenario: &Scenario) -> Outcome {
    let g = &scenario.ground;
    within(
        "ground.slope",
        g.slope,
        between(Angle::degrees(0.0), Angle::degrees(30.0)),
    )?;
    let turn = between(Angle::degrees(-360.0), Angle::degrees(360.0));
    within("ground.downhill", g.downhill, turn)?;
    let softest = Angle::degrees(60.0).get();
    let slips = || between(Compliance::new(0.0), Compliance::new(softest));
    within("ground.front_slip", g.front_slip, slips())?;
    within("ground.rear_slip", g.rear_slip, slips())?;
    within(
        "ground.wheel_slip",
        g.wheel_slip,
        between(Ratio::new(0.0), Ratio::new(0.9)),
    )
}

fn receiver(scenario: &Scenario) -> Outcome {
    let Some(r) = &scenario.receiver else {
        return Ok(());
    };
    within(
        "receiver.noise",
        r.noise,
        between(Length::new(0.0), Length::new(1.0)),
    )?;
    let speeds = between(Speed::new(0.0), Speed::new(1.0));
    within("receiver.velocity_noise", r.velocity_noise, speeds)?;
    let constants = between(Time::new(0.0), Time::new(600.0));
    within("receiver.correlation", r.correlation, constants)?;
    within(
        "receiver.latency",
        r.latency,
        between(Time::new(0.0), Time::new(0.25)),
    )?;
    let jitters = between(Time::new(0.0), Time::new(0.01));
    within("receiver.latency_jitter", r.latency_jitter, jitters)?;
    within(
        "receiver.frame_gap",
        r.frame_gap,
        between(Time::new(0.0), Time::new(1e-2)),
    )?;
    let biases = between(Angle::degrees(-10.0), Angle::degrees(10.0));
    within("receiver.heading_bias", r.heading_bias, biases)?;
    let noises = between(Angle::degrees(0.0), Angle::degrees(10.0));
    within("receiver.tilt_noise", r.tilt_noise, noises)?;
    for (field, error) in [
        ("receiver.roll_error", r.roll_error),
        ("receiver.pitch_error", r.pitch_error),
    ] {
        let errors = between(Angle::degrees(-10.0), Angle::degrees(10.0));
        within(field, error, errors)?;
    }
    if let Some(clock) = r.clock {
        within(
            "receiver.clock",
            clock,
            between(Ppm::new(-100.0), Ppm::new(100.0)),
        )?;
    }
    if let Some(phase) = r.phase {
        within("receiver.phase", phase, between(Time::new(0.0), r.period))?;
    }
    let latitudes = between(Angle::degrees(-89.0), Angle::degrees(89.0));
    within("receiver.base.latitude", r.base.latitude, latitudes)?;
    let longitudes = between(Angle::degrees(-180.0), Angle::degrees(180.0));
    within("receiver.base.longitude", r.base.longitude, longitudes)?;
    let heights = between(Length::new(-500.0), Length::new(9000.0));
    within("receiver.base.height", r.base.height, heights)?;
    for (i, change) in scenario.fix.iter().enumerate() {
        within(&format!("fix[{i}].at"), change.at, times())?;
    }
    for (i, change) in scenario.inertial.iter().enumerate() {
        within(&format!("inertial[{i}].at"), change.at, times())?;
    }
    for (i, fault) in scenario.stream.iter().enumerate() {
        within(&format!("stream[{i}].from"), fault.from, times())?;
        later(&format!("stream[{i}]"), fault.from, fault.until)?;
        let rates = between(Ratio::new(0.0), Ratio::new(1.0));
        within(&format!("stream[{i}].rate"), fault.rate, rates)?;
    }
    Ok(())
}

fn operator(scenario: &Scenario) -> Outcome {
    for (i, press) in scenario.press.iter().enumerate() {
        within(&format!("press[{i}].at"), press.at, times())?;
        let holds = between(Time::new(1e-3), Time::new(60.0));
        within(&format!("press[{i}].hold"), press.hold, holds)?;
        let bounces = between(Time::new(0.0), Time::new(0.05));
        within(&format!("press[{i}].bounce"), press.bounce, bounces)?;
        if press.bounce > press.hold {
            return Err(format!(
                "press[{i}].bounce: {} is longer than the button is held, {}",
                press.bounce, press.hold
            ));
        }
    }
    let bounces = between(Time::new(0.0), Time::new(0.05));
    within("remote.bounce", scenario.remote.bounce, bounces)?;
    for (i, change) in scenario.supply.iter().enumerate() {
        within(&format!("supply[{i}].at"), change.at, times())?;
    }
    for (i, joystick) in scenario.joystick.iter().enumerate() {
        within(&format!("joystick[{i}].at"), joystick.at, times())?;
        let shares = || between(Ratio::new(-1.0), Ratio::new(1.0));
        within(&format!("joystick[{i}].right"), joystick.right, shares())?;
        within(
            &format!("joystick[{i}].forward"),
            joystick.forward,
            shares(),
        )?;
    }
    for (i, change) in scenario.stop_loop.iter().enumerate() {
        within(&format!("stop_loop[{i}].at"), change.at, times())?;
    }
    Ok(())
}

fn babblers(scenario: &Scenario) -> Outcome {
    for (i, babbler) in scenario.babble.iter().enumerate() {
        let field = format!("babble[{i}]");
        within(&format!("{field}.at"), babbler.at, times())?;
        later(&field, babbler.at, Some(babbler.until))?;
        let length = Time::new(babbler.until.get() - babbler.at.get());
        let lengths = above(Time::new(0.0), Time::new(10.0));
        within(&format!("time from {field}.at to until"), length, lengths)?;
        if let Some(id) = babbler.id {
            whole(&format!("{field}.id"), u64::from(id), 0, 2047)?;
        }
    }
    Ok(())
}

fn faults(scenario: &Scenario) -> Outcome {
    for (i, reset) in scenario.reset.iter().enumerate() {
        within(&format!("reset[{i}].at"), reset.at, times())?;
        later(&format!("reset[{i}]"), reset.at, reset.until)?;
    }
    for (i, change) in scenario.clock.iter().enumerate() {
        within(&format!("clock[{i}].at"), change.at, times())?;
    }
    for (i, noise) in scenario.wire.iter().enumerate() {
        within(&format!("wire[{i}].at"), noise.at, times())?;
    }
    for (i, fault) in scenario.relay.iter().enumerate() {
        within(&format!("relay[{i}].at"), fault.at, times())?;
    }
    for (i, dip) in scenario.brownout.iter().enumerate() {
        within(&format!("brownout[{i}].at"), dip.at, times())?;
        later(&format!("brownout[{i}]"), dip.at, Some(dip.until))?;
        let voltages = between(Voltage::new(0.0), Voltage::new(3.3));
        within(&format!("brownout[{i}].lowest"), dip.lowest, voltages)?;
        let mut others = scenario.brownout[..i].iter();
        let overlaps =
            |of: &BrownOut| of.node == dip.node && of.overlaps(dip.at.get(), dip.until.get());
        if let Some(k) = others.position(overlaps) {
            return Err(format!(
                "brownout[{i}] and brownout[{k}] of one node overlap: a dip begins 1 ms after the \
                 end of the one before, or later"
            ));
        }
    }
    babblers(scenario)?;
    for (i, event) in scenario.bus.iter().enumerate() {
        let field = format!("bus[{i}]");
        match event {
            BusEvent::Frame {
                at,
                id,
                data,
                every,
                until,
            } => {
                within(&format!("{field}.at"), *at, times())?;
                whole(&format!("{field}.id"), u64::from(*id), 0, 2047)?;
                whole(
                    &format!("number of bytes in {field}.data"),
                    data.len() as u64,
                    0,
                    8,
                )?;
                if let Some(every) = every {
                    let periods = between(Time::new(100e-6), Time::new(86_400.0));
                    within(&format!("{field}.every"), *every, periods)?;
                }
                later(&field, *at, *until)?;
            }
            BusEvent::Corrupt { at, id, count } => {
                within(&format!("{field}.at"), *at, times())?;
                if let Some(id) = id {
                    whole(&format!("{field}.id"), u64::from(*id), 0, 2047)?;
                }
                whole(&format!("{field}.count"), u64::from(*count), 1, 1000)?;
            }
            BusEvent::Dominant { at, id, hold } => {
                within(&format!("{field}.at"), *at, times())?;
                if let Some(id) = id {
                    whole(&format!("{field}.id"), u64::from(*id), 0, 2047)?;
                }
                let holds = above(Time::new(0.0), Time::new(1.0));
                within(&format!("{field}.hold"), *hold, holds)?;
            }
        }
    }
    Ok(())
}
