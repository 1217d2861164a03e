//! The rules that every run keeps, whatever goes wrong in it.
//!
//! | rule | source |
//! | --- | --- |
//! | a motor is driven only while a genuine command that enables it is not older than two basic periods | thesis 6.2.4.4 |
//! | the steering angle stays within its limits | thesis 5.3 |
//! | no node's frame outside of its own window | ISO 11898-4: exclusive windows |
//! | every node that can is back in schedule at the end | |
//! | no node resets itself for any other reason than its stalled core | |
//!
//! Resets are no exception: a node that stands still lets go of its motor's relay. A core that
//! stalls holds it closed until the watchdog bites; the first two rules do not count in that
//! tenth of a second, nor the second until the wheels are back within their limits.

use twin::{Outcome, ResetCause};
use world::{Node, SimTime};

use crate::sequence::{END, SETTLED, Sequence};
use crate::traffic::{Matrix, Sent, Traffic};

/// A broken rule.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Violation {
    /// The rule, in a word.
    pub rule: &'static str,
    /// When, s since power-on.
    pub at: f64,
    /// What happened.
    pub what: String,
}

/// Age of a command at which the motors stand still: two basic periods, and 1 ms for the frame
/// that is missing, the reaction to it and the byte to the motor driver (260 us).
const COMMAND_AGE: f64 = 0.201;

/// The steering limit of 25 degrees (thesis 5.3), and half a degree for the noise of the
/// potentiometer and its sampling period at full rate (0.125 degrees).
const STEERING_LIMIT: f64 = 25.5;

/// Basic period, s.
const PERIOD: f64 = 0.1;

/// Bits of the command's flags that enable a node's motor: offset 5 of message 300.
const fn enabling(node: Node) -> u8 {
    match node {
        Node::Steering => 1,
        _ => 2,
    }
}

/// Which rules a run of a sequence broke; of each rule and node the first time.
#[must_use]
pub fn judge(sequence: &Sequence, outcome: &Outcome) -> Vec<Violation> {
    let traffic = Traffic::of(outcome);
    let matrix = Matrix::uagv();
    let mut violations = Vec::new();
    for node in [Node::Steering, Node::Drive] {
        violations.extend(motor(sequence, outcome, &traffic, node));
    }
    violations.extend(steering(sequence, outcome));
    violations.extend(matrix.misplaced(&traffic).first().map(|first| Violation {
        rule: "place",
        at: seconds(first.frame.start),
        what: first.to_string(),
    }));
    violations.extend(presence(sequence, outcome, &traffic, &matrix));
    for node in Node::ALL {
        violations.extend(resets(sequence, outcome, node));
    }
    violations
}

/// A motor is driven for no longer than a genuine command allows.
fn motor(
    sequence: &Sequence,
    outcome: &Outcome,
    traffic: &Traffic,
    node: Node,
) -> Option<Violation> {
    let stalled = sequence.stalled(node);
    let commands = allowed(traffic, node);
    let efforts: Vec<(f64, f64)> = outcome
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
        if let Some(at) = uncovered((from, until), &commands, &stalled) {
            return Some(Violation {
                rule: "stop",
                at,
                what: format!(
                    "the motor of {node} is driven with {effort:.2}, its last enabling command is older than two basic periods"
                ),
            });
        }
    }
    None
}

/// Spans in which the commands of the controller allow a motor to turn.
fn allowed(traffic: &Traffic, node: Node) -> Vec<(f64, f64)> {
    let enables = |frame: &&Sent| frame.bytes()[5] & enabling(node) != 0;
    let commands = traffic.genuine(300).filter(enables);
    commands
        .map(|frame| (seconds(frame.end), seconds(frame.end) + COMMAND_AGE))
        .collect()
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

/// The steering angle stays within its limits.
fn steering(sequence: &Sequence, outcome: &Outcome) -> Option<Violation> {
    let stalled = sequence.stalled(Node::Steering);
    let mut excused = false;
    for state in outcome.world.states() {
        let (at, angle) = (seconds(state.at), state.steering.to_degrees());
        let beyond = angle.abs() > STEERING_LIMIT;
        let away = stalled
            .iter()
            .any(|(from, until)| (*from..*until).contains(&at));
        excused = beyond && (away || excused);
        if beyond && !excused {
            return Some(Violation {
                rule: "steering",
                at,
                what: format!("the steering angle is {angle:.2} degrees"),
            });
        }
    }
    None
}

/// Who can be is back in schedule at the end.
fn presence(
    sequence: &Sequence,
    outcome: &Outcome,
    traffic: &Traffic,
    matrix: &Matrix,
) -> Vec<Violation> {
    let lost = |node| sequence.is_lost(node);
    let leads = |node| sequence.can_lead(node);
    if !leads(Node::Gps) && !leads(Node::Controller) {
        // No time master is left.
        return Vec::new();
    }
    let mut due = vec![
        (Node::Controller, 300),
        (Node::Controller, 453),
        (Node::Steering, 206),
    ];
    due.push(if leads(Node::Gps) {
        (Node::Gps, 100)
    } else {
        (Node::Controller, 101)
    });
    let cycles = ((END - SETTLED) / PERIOD).floor() as usize;
    let mut violations = Vec::new();
    for (node, id) in due.into_iter().filter(|(node, _)| !lost(*node)) {
        let seen = traffic
            .genuine(id)
            .filter(|frame| seconds(frame.start) >= SETTLED)
            .count();
        if seen + 1 < cycles {
            violations.push(Violation {
                rule: "presence",
                at: SETTLED,
                what: format!("{node} sent {id} {seen} times in the last {cycles} cycles"),
            });
        }
    }
    // The drive node sends nothing of its own; it says on its console what it does.
    let drive = outcome.nodes.iter().find(|of| of.node == Node::Drive);
    let console = drive.map_or_else(String::new, |of| {
        String::from_utf8_lossy(&of.console).into_owned()
    });
    let last = console.lines().rev().find(|line| line.starts_with("bus "));
    if !lost(Node::Drive) && !last.is_some_and(|line| line.starts_with("bus run")) {
        violations.push(Violation {
            rule: "presence",
            at: END,
            what: format!("drive is not in schedule: {}", last.unwrap_or("silent")),
        });
    }
    // One master at the end.
    let masters = matrix
        .messages()
        .iter()
        .filter(|message| matrix.is_reference(message.id))
        .filter(|message| {
            let mut frames = traffic.genuine(message.id);
            frames.any(|frame| seconds(frame.start) >= SETTLED)
        });
    if masters.count() > 1 {
        violations.push(Violation {
            rule: "masters",
            at: SETTLED,
            what: "two time masters send references".into(),
        });
    }
    violations
}

/// Every reset has its cause in the sequence.
fn resets(sequence: &Sequence, outcome: &Outcome, node: Node) -> Option<Violation> {
    let of = outcome.nodes.iter().find(|of| of.node == node)?;
    if of.locked_up {
        return Some(Violation {
            rule: "reset",
            at: END,
            what: format!("{node} is locked up"),
        });
    }
    let upset = |at| sequence.upsets.iter().any(|u| u.node == node && u.at < at);
    let stopped = |at| {
        let mut losses = sequence.clock_losses.iter();
        losses.any(|loss| loss.node == node && loss.at < at)
    };
    let strange = of.resets.iter().find(|(at, cause)| match cause {
        ResetCause::PowerOn | ResetCause::Pin => false,
        ResetCause::Watchdog => !upset(seconds(*at)),
        ResetCause::Software => !stopped(seconds(*at)),
    });
    strange.map(|(at, cause)| Violation {
        rule: "reset",
        at: seconds(*at),
        what: format!("{node} was reset by {cause:?}"),
    })
}

fn seconds(time: SimTime) -> f64 {
    time.as_ticks() as f64 * 1e-12
}

#[cfg(test)]
mod tests {
    use super::uncovered;

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
