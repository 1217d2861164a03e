//! The rules of runs with attacks.

use can_bus::NodeId;
use network_model::{Condition, Message, SendType, Signal};
use twin::Outcome;
use vehicle_model::{Device, NodeIndex, Vehicle};
use world::SimTime;

use super::{
    END, INSTANT, Judge, REACTION, REFERENCE_REACTION, SERVO_REACTION, Sequence, Violation,
    enabling, seconds, uncovered,
};
use crate::attack::{Example, Foreign, Planned, Tally, command, foreign};
use crate::traffic::{Begin, Misplaced, Sent};

/// Longest time from the end of the attacks until the frames of every node come again, s.
const RECOVERY: f64 = 1.0;

/// Most by which a master that follows the satellite receiver's epochs moves the next basic cycle, with the errors of
/// crystals; s.
const FOLLOWS: f64 = 200e-6;

/// How much larger an effort may be than its command asks for: two steps of a motor driver's byte, of
/// which 127 are the full effort.
const EFFORT_STEP: f64 = 2.0 / 127.0;

/// Basic cycles from the last foreign reference until a node that has followed it has measured its master's rate again. A
/// master that has followed it, too, forgets its rate after five that it leads; a step of the rate is gone after five.
const MEASURED: f64 = 10.0;

/// Largest difference of rates that a node with a crystal follows.
const LARGEST_RATE: f64 = firmware::design::DRIFT_LIMIT_PPM as f64 * 1e-6;

/// Number of forged and replayed frames, while the nodes are in schedule, of which they must have
/// noticed one.
const NOTICED: usize = 20;

/// Which rules a run with attacks broke, and what the attacks did. `plan` is that of the attacker.
pub(crate) fn attacked(
    vehicle: &Vehicle,
    sequence: &Sequence,
    outcome: &Outcome,
    plan: &([NodeId; 2], Vec<Planned>),
) -> (Vec<Violation>, Tally) {
    let mut judge = Judge::new(vehicle, sequence, outcome);
    let foreign = foreign(&outcome.records, &sequence.attacks, plan);
    let mut spoofed = foreign.iter().map(|frame| frame.sent.id);
    judge.shifted = spoofed.any(|id| judge.matrix.is_reference(id)) || judge.was_held_off();
    let mut tally = judge.count(&foreign);
    let mut violations = judge.places(&foreign, &mut tally);
    let mut movements = Vec::new();
    for node in vehicle.nodes() {
        let own = judge.movements_of(node);
        let first = own.first().map(|movement| movement.violation.clone());
        violations.extend(first);
        movements.extend(own);
    }
    tally.moved_a_motor = judge.culprits(&movements, &foreign);
    violations.extend(judge.recovery(&foreign, &mut tally));
    violations.extend(judge.notice(&foreign, &mut tally));
    violations.retain(|violation| {
        let known = judge.is_known(violation, &foreign);
        if known {
            tally.note(violation.rule.clone(), judge.example(violation));
        }
        !known
    });
    (violations, tally)
}

/// A movement that no genuine command asks for.
struct Movement {
    at: f64,
    violation: Violation,
}

/// What a signal of the command may ask of a motor.
struct Demand<'a> {
    message: &'a Message,
    enable: &'a Signal,
    value: &'a Signal,
    /// Value at full effort, in the signal's unit.
    full: f64,
    /// Effort that moves nothing.
    dead_band: f64,
}

impl Demand<'_> {
    /// Most effort in either direction, negative and positive, for a command's value.
    fn efforts(&self, frame: &Sent) -> (f64, f64) {
        let bytes = frame.bytes();
        let value = self.value.physical(self.value.extract(&bytes)) / self.full;
        let most = self.dead_band + (1.0 - self.dead_band) * value.abs().min(1.0) + EFFORT_STEP;
        match value.total_cmp(&0.0) {
            _ if self.enable.extract(&bytes) == 0 || value == 0.0 => (0.0, 0.0),
            std::cmp::Ordering::Less => (most, 0.0),
            _ => (0.0, most),
        }
    }
}

impl Judge<'_> {
    fn example(&self, violation: &Violation) -> Example {
        Example {
            seed: self.sequence.seed,
            at: violation.at,
            what: violation.what.clone(),
        }
    }

    /// The numbers of the run, those apart that the rules find.
    fn count(&self, foreign: &[Foreign]) -> Tally {
        let attacks = &self.sequence.attacks;
        let mut tally = Tally::default();
        for attack in attacks {
            let kind = || attack.kind.name().into();
            *tally.attacks.entry(kind()).or_default() += 1;
            if attack.kind.destroys() {
                tally.suppressed.entry(kind()).or_default();
            } else if !attack.kind.is_attempt() {
                tally.floods.entry(kind()).or_default();
            }
        }
        for frame in foreign {
            let kind = &attacks[frame.attack].kind;
            if kind.is_attempt() {
                *tally.attempts.entry(kind.name().into()).or_default() += 1;
            } else {
                tally.flood_frames += 1;
                *tally.floods.entry(kind.name().into()).or_default() += 1;
            }
        }
        tally.attempts_in_command_window = self.in_command_window(foreign).len() as u64;
        let destroyed = self.traffic.frames.iter();
        let destroyed = destroyed.filter(|frame| frame.node.is_some() && !frame.complete);
        for frame in destroyed {
            let at = seconds(frame.start);
            let mut attacks = attacks.iter();
            let hit = attacks
                .find(|one| one.kind.aims_at(frame.id) && (one.from..one.until).contains(&at));
            if let Some(attack) = hit {
                tally.suppressed_frames += 1;
                *tally
                    .suppressed
                    .entry(attack.kind.name().into())
                    .or_default() += 1;
            }
        }
        tally
    }

    /// Those of the frames that carry the command's identifier and began in its window.
    fn in_command_window<'f>(&self, foreign: &'f [Foreign]) -> Vec<&'f Sent> {
        let Some(command) = command(self.vehicle) else {
            return Vec::new();
        };
        let references = self.matrix.references(&self.traffic);
        let length = i64::from(command.window.length_us) * 1_000_000;
        let uncertain = i64::from(self.vehicle.network().sync_uncertainty_us) * 1_000_000;
        let sent = foreign.iter().map(|frame| &frame.sent);
        let inside = sent.filter(|sent| {
            let late = self.matrix.lateness(sent, &references);
            sent.id == command.id && late.is_some_and(|late| (-uncertain..length).contains(&late))
        });
        inside.collect()
    }

    /// The rules of every run. A frame in a window that began with a foreign reference is known.
    fn places(&self, foreign: &[Foreign], tally: &mut Tally) -> Vec<Violation> {
        let misplaced = self.matrix.misplaced(&self.traffic);
        let follows = |one: &&Misplaced| self.follows_foreign(&one.frame, foreign);
        if let Some(known) = misplaced.iter().find(follows) {
            let violation = Violation {
                rule: "place".into(),
                at: seconds(known.frame.start),
                what: known.to_string(),
            };
            tally.note(violation.rule.clone(), self.example(&violation));
        }
        let other = misplaced.iter().find(|one| !follows(one));
        self.broken(other)
    }

    /// Whether a frame is in its window by a foreign reference of the last basic cycles, or by one of the vehicle's own
    /// that a foreign one has followed, at a rate that its sender may have measured by the foreign one.
    fn follows_foreign(&self, frame: &Sent, foreign: &[Foreign]) -> bool {
        let lately = MEASURED * self.period();
        let is_near = |start: SimTime| {
            let age = seconds(frame.start) - seconds(start);
            (0.0..lately).contains(&age)
        };
        let foreign = foreign.iter().map(|foreign| &foreign.sent);
        let is_reference = |sent: &&Sent| self.matrix.is_reference(sent.id) && is_near(sent.start);
        let mut spoofed = foreign.filter(is_reference).peekable();
        if spoofed.peek().is_none() {
            return false;
        }
        let genuine = self.traffic.frames.iter();
        let genuine = genuine.filter(|sent| sent.complete && sent.node.is_some());
        let mut begins = spoofed.chain(genuine.filter(is_reference));
        begins.any(|sent| {
            [-LARGEST_RATE, LARGEST_RATE].into_iter().any(|faster| {
                let begin = Begin {
                    start: sent.start,
                    rate: 1.0 + faster,
                };
                self.matrix.in_place(frame, &[begin])
            })
        })
    }

    /// What the command may ask of a motor with a motor driver of its own.
    fn demand(&self, motor: Device) -> Option<Demand<'_>> {
        let machine = self.vehicle.manifest().machine.as_ref()?;
        let (unit, full, dead_band) = match motor {
            Device::SteeringMotor => {
                let (right, left) = (&machine.steering.right, &machine.steering.left);
                let full = right.full_rate.get().min(left.full_rate.get()).to_degrees();
                let dead_band = right.dead_band.get().max(left.dead_band.get());
                ("deg/s", full, dead_band)
            }
            Device::DriveMotor => {
                let drive = &machine.drive;
                (
                    "cm/s",
                    drive.full_speed.get() * 100.0,
                    drive.dead_band.get(),
                )
            }
            _ => return None,
        };
        let (message, enable) = enabling(self.vehicle, motor)?;
        let value = message.signals.iter().find(|signal| signal.unit == unit)?;
        Some(Demand {
            message,
            enable,
            value,
            full,
            dead_band,
        })
    }

    /// Movements of a node's motors that no genuine command of the last two basic periods asks for, in
    /// order of time.
    fn movements_of(&self, node: NodeIndex) -> Vec<Movement> {
        let mut devices = self.vehicle.node(node).wiring.values().copied();
        if self
            .vehicle
            .node(node)
            .connector(Device::DriveMotors)
            .is_some()
        {
            return self.servo_movements(node);
        }
        let noise = self.sequence.scenario.wire.iter();
        let is_noisy = noise.map(|noise| noise.node).any(|noisy| noisy == node);
        let demand = devices.find_map(|device| self.demand(device));
        let (Some(demand), false) = (demand, is_noisy) else {
            return Vec::new();
        };
        let commands: Vec<&Sent> = self.traffic.genuine(demand.message.id).collect();
        let stalled = self.sequence.stalled(node);
        let efforts = self.outcome.world.efforts().iter();
        let changes = efforts.filter(|change| change.node == node && change.effort != 0.0);
        let age = 2.0 * self.period() + REACTION;
        let unasked = changes.filter(|change| {
            let at = seconds(change.at);
            let valid = commands.iter().filter(|frame| {
                let end = seconds(frame.end);
                (at - age..=at).contains(&end)
            });
            let most = valid.map(|frame| demand.efforts(frame));
            let most = most.fold((0.0_f64, 0.0_f64), |(left, right), (to_left, to_right)| {
                (left.max(to_left), right.max(to_right))
            });
            let is_stalled = uncovered((at, at + INSTANT), &[], &stalled).is_none();
            !is_stalled && !(-most.0..=most.1).contains(&change.effort)
        });
        unasked
            .map(|change| self.movement(node, seconds(change.at), &format!("{:.2}", change.effort)))
            .collect()
    }

    /// The same for motors on servo lines: driven without an enabling command.
    fn servo_movements(&self, node: NodeIndex) -> Vec<Movement> {
        let enabling = enabling(self.vehicle, Device::DriveMotors);
        let (Some((message, signal)), Some(drive)) = (enabling, self.outcome.world.drive()) else {
            return Vec::new();
        };
        let enables = |frame: &&Sent| signal.extract(&frame.bytes()) != 0;
        let commands = self.traffic.genuine(message.id).filter(enables);
        let allowed = self.spans(commands, SERVO_REACTION);
        let silent = self.sequence.silences(node);
        let unasked = drive.samples().iter().filter(|sample| {
            let at = seconds(sample.at);
            sample.efforts.iter().any(|effort| *effort != 0.0)
                && uncovered((at, at + INSTANT), &allowed, &silent).is_some()
        });
        unasked
            .map(|sample| {
                self.movement(node, seconds(sample.at), &format!("{:.2?}", sample.efforts))
            })
            .collect()
    }

    fn movement(&self, node: NodeIndex, at: f64, effort: &str) -> Movement {
        let violation = Violation {
            rule: "forged".into(),
            at,
            what: format!(
                "the motor of {} is driven with {effort}, which no genuine command of the last two basic periods asks for",
                self.name(node)
            ),
        };
        Movement { at, violation }
    }

    /// Number of foreign commands that caused such movements: for each the last one before it that began
    /// in the command's window, or else at any time.
    fn culprits(&self, movements: &[Movement], foreign: &[Foreign]) -> u64 {
        let ends = |frames: Vec<&Sent>| -> Vec<f64> {
            frames.into_iter().map(|frame| seconds(frame.end)).collect()
        };
        let id = command(self.vehicle).map(|command| command.id);
        let commands = foreign.iter().map(|frame| &frame.sent);
        let commands = ends(commands.filter(|sent| Some(sent.id) == id).collect());
        let inside = ends(self.in_command_window(foreign));
        let age = 2.0 * self.period() + SERVO_REACTION;
        let last = |of: &[f64], at: f64| {
            let before = of.partition_point(|end| *end <= at);
            let last = of.get(before.checked_sub(1)?).copied()?;
            (at - last <= age).then_some(last)
        };
        let mut guilty: Vec<f64> = movements
            .iter()
            .filter_map(|one| last(&inside, one.at).or_else(|| last(&commands, one.at)))
            .collect();
        guilty.sort_by(f64::total_cmp);
        guilty.dedup();
        guilty.len() as u64
    }

    /// Whether an attack kept a reference off the bus, so that the basic cycles began anew at another time.
    fn was_held_off(&self) -> bool {
        let first = self.sequence.attacks.iter().map(|attack| attack.from);
        let first = first.fold(END, f64::min);
        let references = self.matrix.references(&self.traffic);
        references.array_windows().any(|[before, next]| {
            let gap = seconds(next.start) - seconds(before.start);
            let cycles = (gap / self.period()).round().max(1.0);
            let moved = (gap - cycles * self.period()).abs();
            seconds(next.start) > first && moved > cycles * FOLLOWS
        })
    }

    /// When the attacks are over, s.
    fn over(&self, foreign: &[Foreign]) -> f64 {
        let ends = self.sequence.attacks.iter().map(|attack| attack.until);
        let last = foreign.iter().map(|frame| seconds(frame.sent.end));
        ends.chain(last).fold(0.0, f64::max)
    }

    /// The frames of every node come again when the attacks are over. A fault beside them may take
    /// longer, so that such a run is judged by the rules of every run only.
    fn recovery(&self, foreign: &[Foreign], tally: &mut Tally) -> Vec<Violation> {
        if self.sequence.faults > 0 {
            return Vec::new();
        }
        let over = self.over(foreign);
        let asynchronous = self.asynchronous();
        let leader = self.leader();
        let messages = self.matrix.messages().iter();
        let due = messages.filter_map(|message| {
            let period = steady_period(message)?;
            let sender = self.matrix.sender(message)?;
            let is_other = leader.is_none_or(|leader| leader.id != message.id);
            if self.matrix.is_reference(message.id) {
                return (!is_other).then_some((message, period, false));
            }
            Some((message, period, Some(sender) == asynchronous))
        });
        let mut late = Vec::new();
        let mut known = None;
        for (message, period, is_asynchronous) in due {
            let starts = self.traffic.genuine(message.id);
            let starts: Vec<f64> = starts.map(|frame| seconds(frame.start)).collect();
            let took = |gaps: f64| returns(&starts, over, gaps * period);
            let late_by = |took: f64| Violation {
                rule: "recovery".into(),
                at: over,
                what: format!(
                    "{} {} came again {took:.3} s after the end of the attacks",
                    message.sender, message.id
                ),
            };
            // Every other window of a receiver's message may be empty; see the rule of presence.
            let (steady, loose) = (took(1.5), took(2.5));
            let accepted = if is_asynchronous { loose } else { steady };
            tally.worst_recovery_seconds = tally.worst_recovery_seconds.max(accepted);
            tally.worst_recovery_seed = Some(self.sequence.seed);
            if accepted > RECOVERY {
                late.push(late_by(accepted));
            } else if steady > RECOVERY {
                known.get_or_insert(late_by(steady));
            }
        }
        if let Some(known) = known {
            tally.note(known.rule.clone(), self.example(&known));
        }
        late
    }

    /// The consoles count foreign frames, or commands that were refused. They do not count foreign
    /// references that their nodes refuse, so that a run with nothing else is known.
    fn notice(&self, foreign: &[Foreign], tally: &mut Tally) -> Option<Violation> {
        let attacks = &self.sequence.attacks;
        let references = self.matrix.references(&self.traffic);
        let is_countable = |frame: &&Foreign| {
            let is_attempt = attacks[frame.attack].kind.is_attempt();
            is_attempt && self.is_in_schedule(&references, frame.sent.start)
        };
        let attempts = foreign.iter().filter(is_countable);
        let (time, others): (Vec<_>, Vec<_>) =
            attempts.partition(|frame| self.matrix.is_reference(frame.sent.id));
        let mut nodes = self.vehicle.nodes();
        let is_quiet = time.len().max(others.len()) < NOTICED || self.sequence.faults > 0;
        if is_quiet || nodes.any(|node| has_noticed(&self.console(node))) {
            return None;
        }
        let violation = |frames: &[&Foreign], what: &str| Violation {
            rule: "notice".into(),
            at: self.over(foreign),
            what: format!("no console counts any of {} foreign {what}", frames.len()),
        };
        if others.len() < NOTICED {
            let known = violation(&time, "references");
            tally.note(known.rule.clone(), self.example(&known));
            return None;
        }
        Some(violation(&others, "frames"))
    }

    /// Whether the nodes are in schedule at an instant: the last three references came in time.
    fn is_in_schedule(&self, references: &[Begin], at: SimTime) -> bool {
        let before = references.partition_point(|reference| reference.start <= at);
        let last = before.checked_sub(3).map(|third| references[third].start);
        last.is_some_and(|third| seconds(at) - seconds(third) < 3.5 * self.period())
    }

    /// Whether a rule is broken because a reference is proven only by the next one: an actuator is driven under a
    /// foreign reference of the first time master.
    fn is_known(&self, violation: &Violation, foreign: &[Foreign]) -> bool {
        let age = 2.0 * self.period() + REFERENCE_REACTION;
        let spoofed = foreign.iter().any(|frame| {
            let since = violation.at - seconds(frame.sent.end);
            self.matrix.is_reference(frame.sent.id) && (0.0..age).contains(&since)
        });
        violation.rule == "master" && spoofed
    }
}

/// Period of a message that its sender sends whatever happens, s.
fn steady_period(message: &Message) -> Option<f64> {
    match message.send_type {
        SendType::Cyclic { period_ms } if message.condition == Condition::Always => {
            Some(f64::from(period_ms) * 1e-3)
        }
        _ => None,
    }
}

/// Time from `over` until the first of the frames that began at `starts`, in order, after which all came,
/// at most `longest` apart, to the end of the run; s.
fn returns(starts: &[f64], over: f64, longest: f64) -> f64 {
    let mut next = END;
    for start in starts.iter().rev().filter(|start| **start >= over) {
        if next - start > longest {
            break;
        }
        next = *start;
    }
    next - over
}

/// Whether the last lines of a console count frames out of place, or commands that were refused.
fn has_noticed(console: &str) -> bool {
    let count = |word: &str| {
        let (_, behind) = console.rsplit_once(word)?;
        let number: String = behind.chars().take_while(char::is_ascii_digit).collect();
        number.parse::<u32>().ok()
    };
    let mut counts = [" odd ", " refused "].into_iter().map(count);
    counts.any(|count| count > Some(0))
}

#[cfg(test)]
mod tests {
    use super::{END, has_noticed, returns};

    #[test]
    fn a_message_has_returned_when_no_gap_follows() {
        let every = |from: f64, until: f64| {
            let count = ((until - from) / 0.1).round() as u32;
            (0..count).map(move |k| from + 0.1 * f64::from(k))
        };
        let starts: Vec<f64> = every(3.0, END).collect();
        assert!((returns(&starts, 4.05, 0.15) - 0.05).abs() < 1e-9);
        // It came once, and not again before 4.8 s.
        let starts: Vec<f64> = [4.1].into_iter().chain(every(4.8, END)).collect();
        assert!((returns(&starts, 4.0, 0.15) - 0.8).abs() < 1e-9);
        let starts: Vec<f64> = every(4.0, 5.0).collect();
        assert!((returns(&starts, 4.0, 0.15) - (END - 4.0)).abs() < 1e-9);
        assert!((returns(&[], 4.0, 0.15) - (END - 4.0)).abs() < 1e-9);
    }

    #[test]
    fn a_console_tells_whether_its_node_has_noticed_something() {
        assert!(!has_noticed(""));
        assert!(!has_noticed(
            "bus run S0 own-0 odd 0 tec 0\ndrive no cmd out 127 refused 0\n"
        ));
        assert!(has_noticed(
            "drive no cmd out 127 refused 12\nbus run own-0 odd 0\n"
        ));
        assert!(has_noticed("bus run S0 own-0 odd 3 tec 0\n"));
    }
}
