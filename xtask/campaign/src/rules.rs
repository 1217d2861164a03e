//! The rules that every run keeps, whatever goes wrong in it.
//!
//! | rule | source |
//! | --- | --- |
//! | a motor is driven only while a genuine command that enables it is not older than two basic periods | thesis 6.2.4.4 |
//! | a motor is driven only while a reference of the first time master is not older than two basic periods, unless the manifest lets a backup drive | thesis 6.2.4.4 |
//! | no motor is driven from a third of a second after a press of D or of the joystick's switch until another button is pressed, with every type of remote | thesis 5.2.5 |
//! | the steering angle stays within its limits | thesis 5.3 |
//! | a motor driver whose relay is closed reads only bytes that were sent to it | thesis 6.2.4.4 |
//! | no node's frame outside of its own window | ISO 11898-4: exclusive windows |
//! | every node that can is back in schedule at the end | |
//! | no node resets itself except for its stalled core, its clock, its supply, or to lead as the last resort | |
//! | no program does what its microcontroller does not allow | RM0390, RM0316, see [`twin::Violation`] |
//!
//! A run with attacks keeps these as well:
//!
//! | rule | source |
//! | --- | --- |
//! | a motor does nothing that no genuine command of the last two basic periods asks for (`forged`) | boards/GETTING_STARTED.md, a key for the network |
//! | when the attacks are over, every node's frames come again within a second (`recovery`) | `ttcan/tests/spoofing.rs` |
//! | of many forged and replayed frames some node's console counts one as out of place, or as refused (`notice`) | |
//!
//! A reference is proven only by the one that follows it. So a node may follow a foreign reference, and send in the windows that
//! begin with it, and for some basic cycles more at the rate that it tells (`place`); an actuator may take it
//! for that of the first time master (`master`); and it may move the schedule against the satellite receiver's epochs, so that up to half of the windows of their
//! messages are empty for more than a second (`recovery`). Nor does a console count foreign references that its node refuses (`notice`). These are counted as known,
//! apart from the broken rules.
//!
//! Resets are no exception: a node that stands still lets go of its motor's relay. A core that
//! stalls holds it closed until the watchdog bites; the first four rules do not count in that
//! tenth of a second, nor the last of them until the wheels are back within their limits.

mod attacks;

use network_model::{Condition, Message, SendType, Signal};
use twin::{Outcome, ResetCause};
use vehicle_model::{BackupMaster, Device, NodeIndex, Vehicle};
use world::SimTime;
use world::scenario::Button;

use crate::Word;
use crate::sequence::{END, SETTLED, Sequence};
use crate::traffic::{Matrix, Misplaced, Oscillator, Sent, Traffic};

pub(crate) use attacks::attacked;

/// The rules that a report may name, and what it calls a fault of the simulation itself.
pub(crate) const RULES: [&str; 14] = [
    "stop", "master", "remote", "button", "steering", "wire", "place", "presence", "masters",
    "reset", "silicon", "forged", "recovery", "notice",
];
pub(crate) const SIMULATION: &str = "simulation";

/// A broken rule.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Violation {
    /// The rule, in a word.
    pub rule: Word,
    /// When, s since power-on.
    pub at: f64,
    /// What happened.
    pub what: String,
}

/// A command is too old after two basic periods, and this for the frame that is missing, the
/// reaction to it and the byte to the motor driver (260 us), s.
const REACTION: f64 = 0.001;

/// The same with servo pulses: the pulses that end a command begin 1 ms after it has expired at the
/// latest, and their drivers read them at their end, s.
const SERVO_REACTION: f64 = 0.004;

/// The same for a reference. It counts as missing when two longest references, 1.1 ms, could have
/// been sent in its place, s.
const REFERENCE_REACTION: f64 = 0.003;

/// Longest time from a change of a pin remote's line until the command that stops the motors, s: the
/// line bounces for 3 ms, and the line is read once in each step of 5 ms.
const STOP_LINE: f64 = 0.02;

/// An instant as a span, s.
const INSTANT: f64 = 1e-9;

/// Longest time from a press of a stop button until the motors stand still, s: debouncing, the
/// next control step, and two commands that may be lost.
const STOP_BUTTON: f64 = 0.34;

/// Shortest time without references after which a master without its clock starts again to lead as
/// the last resort, s: 3 s of an oscillator that is 5 % fast.
const LAST_RESORT: f64 = 2.85;

/// How far the steering angle may be beyond its limit, degrees: noise of the potentiometer, and
/// its sampling period at full rate (0.125 degrees).
const STEERING_MARGIN: f64 = 0.5;

/// A run, with the data by which it is judged.
struct Judge<'a> {
    vehicle: &'a Vehicle,
    sequence: &'a Sequence,
    outcome: &'a Outcome,
    traffic: Traffic,
    matrix: Matrix,
    /// An attack may have moved the schedule against the satellite receiver's epochs.
    shifted: bool,
}

/// Which rules a run of a sequence broke; of each rule and node the first time.
#[must_use]
pub fn judge(vehicle: &Vehicle, sequence: &Sequence, outcome: &Outcome) -> Vec<Violation> {
    let judge = Judge::new(vehicle, sequence, outcome);
    let misplaced = judge.matrix.misplaced(&judge.traffic);
    judge.broken(misplaced.first())
}

/// The matrix of the vehicle, with the oscillators of a run.
fn matrix(vehicle: &Vehicle, sequence: &Sequence, outcome: &Outcome) -> Matrix {
    let mut matrix = Matrix::new(vehicle);
    for node in vehicle.nodes() {
        let oscillator = Oscillator {
            ppm: outcome.world.internal_ppm(node),
            at: outcome.world.now(),
            drift: sequence.scenario.nodes[node.0].drift.get(),
        };
        matrix.set_oscillator(node, oscillator);
    }
    matrix
}

/// The message that commands motors, and its signal that lets this one turn.
fn enabling(vehicle: &Vehicle, motor: Device) -> Option<(&Message, &Signal)> {
    let command = vehicle.manifest().command.as_ref()?;
    let name = command.enable.get(&motor)?;
    let mut messages = vehicle.network().messages.iter();
    let message = messages.find(|message| message.name == command.message)?;
    let signal = message.signals.iter().find(|signal| signal.name == *name)?;
    Some((message, signal))
}

impl<'a> Judge<'a> {
    fn new(vehicle: &'a Vehicle, sequence: &'a Sequence, outcome: &'a Outcome) -> Self {
        Self {
            vehicle,
            sequence,
            outcome,
            traffic: Traffic::of(outcome),
            matrix: matrix(vehicle, sequence, outcome),
            shifted: false,
        }
    }

    /// The node of the satellite receiver if its epochs may come at any time of the basic cycle.
    ///
    /// The receiver keeps its own time. Only if its node leads does the schedule follow its epochs, by
    /// 100 us at most in each cycle: a foreign reference that nodes have followed shows for many cycles, and so does
    /// a reference that a flood has kept off the bus.
    fn asynchronous(&self) -> Option<NodeIndex> {
        let receiver = self.vehicle.node_of(Device::SatelliteReceiver);
        let leader = self.leader().and_then(|leader| self.matrix.sender(leader));
        receiver.filter(|_| self.shifted || leader != receiver)
    }
}

impl Judge<'_> {
    /// The broken rules; `misplaced` is the first frame outside of its window.
    fn broken(&self, misplaced: Option<&Misplaced>) -> Vec<Violation> {
        let mut violations = Vec::new();
        for node in self.vehicle.nodes() {
            violations.extend(self.motor(node));
            violations.extend(self.servos(node));
            violations.extend(self.pin_remote(node));
            violations.extend(self.wire(node));
            violations.extend(self.led(node));
            violations.extend(self.button(node));
        }
        violations.extend(self.steering());
        violations.extend(misplaced.map(|first| Violation {
            rule: "place".into(),
            at: seconds(first.frame.start),
            what: first.to_string(),
        }));
        violations.extend(self.presence());
        violations.extend(self.masters());
        for node in self.vehicle.nodes() {
            violations.extend(self.resets(node));
        }
        violations
    }

    fn name(&self, node: NodeIndex) -> &str {
        &self.vehicle.node(node).name
    }

    /// Basic period, s.
    fn period(&self) -> f64 {
        self.matrix.basic_cycle().as_ticks() as f64 * 1e-12
    }

    /// The motor of a node is driven for no longer than a genuine command allows.
    fn motor(&self, node: NodeIndex) -> Option<Violation> {
        let devices = self.vehicle.node(node).wiring.values();
        let motor = devices.copied().find(|device| device.has_relay())?;
        let (message, signal) = enabling(self.vehicle, motor)?;
        let commands = self.allowed(message, signal);
        self.driven(node, &commands).map(|(at, effort)| Violation {
            rule: "stop".into(),
            at,
            what: format!(
                "the motor of {} is driven with {effort:.2}, its last enabling command is older than two basic periods",
                self.name(node)
            ),
        })
    }

    /// The motors on the servo lines of a node are driven for no longer than a genuine command allows.
    fn servos(&self, node: NodeIndex) -> Option<Violation> {
        let motor = Device::DriveMotors;
        self.vehicle.node(node).connector(motor)?;
        let (message, signal) = enabling(self.vehicle, motor)?;
        let enables = |frame: &&Sent| signal.extract(&frame.bytes()) != 0;
        let allowed = self.spans(
            self.traffic.genuine(message.id).filter(enables),
            SERVO_REACTION,
        );
        let silent = self.sequence.silences(node);
        let mut samples = self.outcome.world.drive()?.samples().iter();
        let driven = samples.find(|sample| {
            let at = seconds(sample.at);
            let is_driven = sample.efforts.iter().any(|effort| *effort != 0.0);
            is_driven && uncovered((at, at + INSTANT), &allowed, &silent).is_some()
        })?;
        Some(Violation {
            rule: "stop".into(),
            at: seconds(driven.at),
            what: format!(
                "the motors of {} are driven with {:.2?}, their last enabling command is older than two basic periods",
                self.name(node),
                driven.efforts
            ),
        })
    }

    /// No command lets the motors turn once a pin remote has stopped the robot: by a press of stop, or
    /// by a receiver without supply. Only another press of run, which no sequence has, sets it in
    /// motion again.
    fn pin_remote(&self, node: NodeIndex) -> Option<Violation> {
        self.vehicle.node(node).connector(Device::PinRemote)?;
        let (message, signal) = enabling(self.vehicle, Device::DriveMotors)?;
        let scenario = &self.sequence.scenario;
        let presses = scenario.press.iter();
        let presses = presses.filter(|press| press.button == Button::Stop);
        let cuts = scenario.supply.iter().filter(|change| !change.on);
        let stops = presses.map(|press| press.at.get());
        let stop = stops.chain(cuts.map(|cut| cut.at.get())).reduce(f64::min)?;
        let enables = |frame: &&Sent| signal.extract(&frame.bytes()) != 0;
        let mut commands = self.traffic.genuine(message.id).filter(enables);
        let late = commands.find(|frame| seconds(frame.end) > stop + STOP_LINE)?;
        Some(Violation {
            rule: "remote".into(),
            at: seconds(late.end),
            what: format!(
                "{} lets the motors turn, the remote control has stopped them at {stop:.6} s",
                self.name(node)
            ),
        })
    }

    /// The motor of a node is driven under the first time master only.
    fn led(&self, node: NodeIndex) -> Option<Violation> {
        if self.vehicle.manifest().safety.backup_master == BackupMaster::Drive {
            return None;
        }
        let messages = self.matrix.messages().iter();
        let references = messages.filter(|message| self.matrix.is_reference(message.id));
        let first = references.min_by_key(|message| message.id)?;
        let led = self.spans(self.traffic.genuine(first.id), REFERENCE_REACTION);
        self.driven(node, &led).map(|(at, effort)| Violation {
            rule: "master".into(),
            at,
            what: format!(
                "the motor of {} is driven with {effort:.2}, the last reference of {} is older than two basic periods",
                self.name(node),
                first.sender
            ),
        })
    }

    /// The motor of a node stands still after button D or the joystick's switch.
    fn button(&self, node: NodeIndex) -> Option<Violation> {
        let devices = self.vehicle.node(node).wiring.values();
        devices.copied().find(|device| device.has_relay())?;
        let presses = &self.sequence.scenario.press;
        let stops = |button| matches!(button, Button::D | Button::J);
        let heard = |at: f64| {
            // Without supply of its receiver the remote says nothing.
            let changes = self.sequence.scenario.supply.iter();
            let last = changes.filter(|change| change.at.get() <= at);
            last.max_by(|a, b| a.at.get().total_cmp(&b.at.get()))
                .is_none_or(|change| change.on)
        };
        let mut free = Vec::new();
        let mut from = Some(0.0);
        let mut presses: Vec<_> = presses.iter().collect();
        presses.sort_by(|a, b| a.at.get().total_cmp(&b.at.get()));
        for press in presses {
            let at = press.at.get();
            if !stops(press.button) {
                from = from.or(Some(at));
            } else if press.button == Button::J || heard(at) {
                free.extend(from.take().map(|from| (from, at + STOP_BUTTON)));
            }
        }
        free.extend(from.map(|from| (from, END)));
        self.driven(node, &free).map(|(at, effort)| Violation {
            rule: "button".into(),
            at,
            what: format!(
                "the motor of {} is driven with {effort:.2} after the stop button",
                self.name(node)
            ),
        })
    }

    /// When and with which effort the motor of a node is driven outside of these spans, for the
    /// first time.
    fn driven(&self, node: NodeIndex, allowed: &[(f64, f64)]) -> Option<(f64, f64)> {
        let stalled = self.sequence.stalled(node);
        let efforts: Vec<(f64, f64)> = self
            .outcome
            .world
            .efforts()
            .iter()
            .filter(|change| change.node == node)
            .map(|change| (seconds(change.at), change.effort))
            .collect();
        for (index, &(from, effort)) in efforts.iter().enumerate() {
            if effort == 0.0 {
                continue;
            }
            let until = efforts.get(index + 1).map_or(END, |next| next.0);
            if let Some(at) = uncovered((from, until), allowed, &stalled) {
                return Some((at, effort));
            }
        }
        None
    }

    /// The driver of a motor whose relay is closed reads only what was sent.
    fn wire(&self, node: NodeIndex) -> Option<Violation> {
        let mut garbles = self.outcome.world.garbles().iter();
        let garble = garbles.find(|garble| garble.node == node && garble.closed)?;
        let read = match garble.byte {
            Some(byte) => format!("{byte:#04X}"),
            None => "a framing error".into(),
        };
        Some(Violation {
            rule: "wire".into(),
            at: seconds(garble.at),
            what: format!(
                "the motor driver of {} reads {read}, which was not sent",
                self.name(node)
            ),
        })
    }

    /// Spans in which commands allow a motor to turn.
    fn allowed(&self, message: &Message, signal: &Signal) -> Vec<(f64, f64)> {
        let enables = |frame: &&Sent| signal.extract(&frame.bytes()) != 0;
        self.spans(self.traffic.genuine(message.id).filter(enables), REACTION)
    }

    /// The spans of two basic periods and `reaction` that begin with these frames.
    fn spans<'b>(&self, frames: impl Iterator<Item = &'b Sent>, reaction: f64) -> Vec<(f64, f64)> {
        let age = 2.0 * self.period() + reaction;
        frames
            .map(|frame| (seconds(frame.end), seconds(frame.end) + age))
            .collect()
    }

    /// The steering angle stays within its limits.
    fn steering(&self) -> Option<Violation> {
        let machine = self.vehicle.manifest().machine.as_ref()?;
        let node = self.vehicle.node_of(Device::SteeringMotor)?;
        let limit = machine.limits.steering_angle.get().to_degrees() + STEERING_MARGIN;
        let stalled = self.sequence.stalled(node);
        let mut excused = false;
        for state in self.outcome.world.states() {
            let (at, angle) = (seconds(state.at), state.steering.to_degrees());
            let beyond = angle.abs() > limit;
            let away = stalled
                .iter()
                .any(|(from, until)| (*from..*until).contains(&at));
            excused = beyond && (away || excused);
            if beyond && !excused {
                return Some(Violation {
                    rule: "steering".into(),
                    at,
                    what: format!("the steering angle is {angle:.2} degrees"),
                });
            }
        }
        None
    }

    /// The best master that can lead at the end, by its reference message.
    fn leader(&self) -> Option<&Message> {
        let messages = self.matrix.messages().iter();
        let references = messages.filter(|message| self.matrix.is_reference(message.id));
        let able = references.filter(|message| {
            let sender = self.matrix.sender(message);
            sender.is_some_and(|node| self.sequence.can_lead(node))
        });
        able.min_by_key(|message| message.id)
    }

    /// Whether a message is sent in every basic cycle.
    fn is_steady(&self, message: &Message) -> bool {
        let cycle = self.vehicle.network().basic_cycle_us;
        let every = SendType::Cyclic {
            period_ms: cycle / 1000,
        };
        message.send_type == every
            && message.condition == Condition::Always
            && !self.matrix.is_reference(message.id)
    }

    /// Every node that can be back in schedule at the end of the run is.
    fn presence(&self) -> Vec<Violation> {
        let Some(leader) = self.leader() else {
            // No time master is left.
            return Vec::new();
        };
        let messages = self.matrix.messages().iter();
        let steady = messages.filter(|message| self.is_steady(message));
        let steady = steady.filter(|message| {
            let sender = self.matrix.sender(message);
            sender.is_none_or(|node| !self.is_barred(node))
        });
        let due = steady.chain([leader]).filter(|message| {
            let sender = self.matrix.sender(message);
            sender.is_some_and(|node| !self.sequence.is_lost(node))
        });
        let cycles = ((END - SETTLED) / self.period()).floor() as usize;
        // An epoch may come near a window: now before it and now behind it. Each window without a new
        // epoch comes after one with it, so that at most half of them are empty.
        let asynchronous = self.asynchronous();
        let mut violations = Vec::new();
        for message in due {
            let seen = self
                .traffic
                .genuine(message.id)
                .filter(|frame| seconds(frame.start) >= SETTLED)
                .count();
            let sender = self.matrix.sender(message);
            let least = if sender == asynchronous {
                cycles / 2
            } else {
                cycles - 1
            };
            if seen < least {
                violations.push(Violation {
                    rule: "presence".into(),
                    at: SETTLED,
                    what: format!(
                        "{} sent {} {seen} times in the last {cycles} cycles",
                        message.sender, message.id
                    ),
                });
            }
        }
        for node in self.vehicle.nodes() {
            violations.extend(self.silent(node));
        }
        violations
    }

    /// Whether a node's self-test has found its relay stuck and barred its motor. Then it withholds the
    /// messages by which others would count on the motor. It looks when another fault stops the vehicle.
    fn is_barred(&self, node: NodeIndex) -> bool {
        let mut relays = self.sequence.scenario.relay.iter();
        let failed = |line: &str| {
            let failed = line.strip_prefix("test FAILED ");
            failed.is_some_and(|checks| {
                let end = checks.find([',', '|']).unwrap_or(checks.len());
                checks[..end].split(' ').any(|check| check == "relay")
            })
        };
        relays.any(|fault| fault.node == node) && self.console(node).lines().any(failed)
    }

    /// What a node wrote to its console, to the end of its last whole line.
    fn console(&self, node: NodeIndex) -> String {
        let mut nodes = self.outcome.nodes.iter();
        let console = nodes.find(|of| of.node == node).map(|of| &of.console);
        let console = String::from_utf8_lossy(console.map_or(&[], |text| text.as_slice()));
        let whole = console.rsplit_once('\n').map_or("", |(whole, _)| whole);
        whole.to_owned()
    }

    /// The state of a node that sends no periodic message, as a bus guardian, or withholds it, is read from its console.
    fn silent(&self, node: NodeIndex) -> Option<Violation> {
        let mut messages = self.matrix.messages().iter();
        let speaks = messages.any(|message| {
            self.matrix.sender(message) == Some(node)
                && matches!(message.send_type, SendType::Cyclic { .. })
        });
        let speaks = speaks && !self.is_barred(node);
        if speaks || self.sequence.is_lost(node) {
            return None;
        }
        // A bus guardian has no state of the bus to tell, but whether it follows the time of the network, or leaves its gates
        // open without a crystal.
        let manifest = self.vehicle.manifest();
        let teller = match manifest.is_guardian(self.vehicle.node(node)) {
            true => "guardian",
            false => "bus",
        };
        let last = unscheduled(&self.console(node), teller)?;
        Some(Violation {
            rule: "presence".into(),
            at: END,
            what: format!("{} is not in schedule: {last}", self.name(node)),
        })
    }

    /// One master at the end.
    fn masters(&self) -> Option<Violation> {
        let messages = self.matrix.messages().iter();
        let references = messages.filter(|message| self.matrix.is_reference(message.id));
        let masters = references.filter(|message| {
            let mut frames = self.traffic.genuine(message.id);
            frames.any(|frame| seconds(frame.start) >= SETTLED)
        });
        (self.leader().is_some() && masters.count() > 1).then(|| Violation {
            rule: "masters".into(),
            at: SETTLED,
            what: "two time masters send references".into(),
        })
    }

    /// Every reset is caused by an event of the sequence.
    fn resets(&self, node: NodeIndex) -> Option<Violation> {
        let of = self.outcome.nodes.iter().find(|of| of.node == node)?;
        let name = &of.name;
        if of.locked_up {
            return Some(Violation {
                rule: "reset".into(),
                at: END,
                what: format!("{name} is locked up"),
            });
        }
        let sequence = self.sequence;
        let upset = |at| sequence.upsets.iter().any(|u| u.node == node && u.at < at);
        let stopped = |at| {
            let mut losses = sequence.clock_losses.iter();
            losses.any(|loss| loss.node == node && loss.at < at)
        };
        // A part that watches its supply starts anew until the supply is good again.
        let dipped = |at: f64| {
            let mut dips = sequence.scenario.brownout.iter();
            dips.any(|dip| {
                dip.node == node && (dip.at.get()..dip.until.get() + 0.001).contains(&at)
            })
        };
        let strange = of.resets.iter().find(|(at, cause)| match cause {
            ResetCause::PowerOn | ResetCause::Pin => false,
            ResetCause::Watchdog => !upset(seconds(*at)),
            ResetCause::Software => {
                let own = stopped(seconds(*at)) || dipped(seconds(*at)) || sequence.is_late(node);
                !own && !self.is_last_resort(node, *at)
            }
        });
        strange.map(|(at, cause)| Violation {
            rule: "reset".into(),
            at: seconds(*at),
            what: format!("{name} was reset by {cause:?}"),
        })
    }

    /// Whether a node may start again at this instant to lead as the last resort: it is a time master
    /// without its clock, and nobody leads.
    fn is_last_resort(&self, node: NodeIndex, at: SimTime) -> bool {
        let mut messages = self.matrix.messages().iter();
        let master = messages.any(|message| {
            self.matrix.is_reference(message.id) && self.matrix.sender(message) == Some(node)
        });
        let references = self.matrix.references(&self.traffic);
        let before = references.iter().rev().find(|begin| begin.start < at);
        let led = before.map_or(0.0, |begin| seconds(begin.start));
        master && !self.sequence.can_lead(node) && seconds(at) - led >= LAST_RESORT
    }
}

/// The last line of a console that begins with the word `teller`, unless that line says that the node is in
/// schedule.
fn unscheduled(console: &str, teller: &str) -> Option<String> {
    let state = |line: &&str| line.split(' ').next() == Some(teller);
    let last = console.lines().rev().find(state);
    let known = |line: &str| matches!(line.split(' ').nth(1), Some("run" | "open"));
    let scheduled = last.is_some_and(known);
    (!scheduled).then(|| last.unwrap_or("silent").to_owned())
}

/// The first instant of `span` that is in none of the others.
fn uncovered(span: (f64, f64), allowed: &[(f64, f64)], stalled: &[(f64, f64)]) -> Option<f64> {
    let mut at = span.0;
    loop {
        let covering = allowed.iter().chain(stalled);
        let reach = covering
            .filter(|(from, until)| (*from..*until).contains(&at))
            .map(|(_, until)| *until)
            .fold(at, f64::max);
        if reach >= span.1 {
            return None;
        }
        if reach == at {
            return Some(at);
        }
        at = reach;
    }
}

fn seconds(time: SimTime) -> f64 {
    time.as_ticks() as f64 * 1e-12
}

#[cfg(test)]
mod tests {
    use super::{uncovered, unscheduled};

    #[test]
    fn a_console_tells_whether_its_node_is_in_schedule() {
        let node = "bus off S0\nsatellites 7\nbus run S0 own-0 odd 0\n";
        assert_eq!(unscheduled(node, "bus"), None);
        let guardian = "guardian run cuts drive 0\nguardian sync cuts drive 0\n";
        let last = unscheduled(guardian, "guardian");
        assert_eq!(last.as_deref(), Some("guardian sync cuts drive 0"));
        let later = format!("{guardian}guardian run cuts drive 0\ncut drive pulses times 1\n");
        assert_eq!(unscheduled(&later, "guardian"), None);
        assert_eq!(unscheduled(&later, "bus").as_deref(), Some("silent"));
    }

    #[test]
    fn the_first_uncovered_instant_is_found() {
        let allowed = [(1.0, 2.0), (1.5, 3.0), (5.0, 6.0)];
        assert_eq!(uncovered((1.0, 3.0), &allowed, &[]), None);
        assert_eq!(uncovered((1.2, 3.1), &allowed, &[]), Some(3.0));
        assert_eq!(uncovered((0.5, 1.5), &allowed, &[]), Some(0.5));
        assert_eq!(uncovered((1.2, 5.5), &allowed, &[(2.9, 5.0)]), None);
        assert_eq!(
            uncovered((1.2, 5.5), &allowed, &[(2.9, f64::INFINITY)]),
            None
        );
    }
}
