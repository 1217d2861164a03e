//! What a scenario lets happen, in words.

use vehicle_model::NodeIndex;

use super::Scenario;
use super::events::BusEvent;
use super::rover::DistanceFault;
use super::row::Side;
use crate::distance::Fault;
use crate::receiver::{StreamFault, StreamFaultKind};
use crate::units::Time;

/// When something begins, and what.
type Told = (Time, String);

/// Something that a scenario lets happen.
#[derive(Clone, Debug, PartialEq)]
pub struct Happening {
    /// Its table in the file, such as `press[0]`.
    pub table: String,
    /// When it begins.
    pub at: Time,
    /// What it is, such as `button C pressed`.
    pub words: String,
}

impl Scenario {
    /// All that happens, table by table. `name` gives the names of nodes.
    #[must_use]
    pub fn happenings(&self, name: &dyn Fn(NodeIndex) -> String) -> Vec<Happening> {
        let mut all = Vec::new();
        let mut add = |table: &str, happenings: Vec<Told>| {
            let numbered = happenings.into_iter().enumerate();
            all.extend(numbered.map(|(i, (at, words))| Happening {
                table: format!("{table}[{i}]"),
                at,
                words,
            }));
        };
        add(
            "fix",
            told(&self.fix, |it| {
                (it.at, format!("fix is {}", it.state.name()))
            }),
        );
        add(
            "inertial",
            told(&self.inertial, |it| {
                (
                    it.at,
                    format!("roll and pitch of the receiver are {}", it.state.name()),
                )
            }),
        );
        add("stream", told(&self.stream, stream));
        add(
            "press",
            told(&self.press, |it| {
                (it.at, format!("button {} pressed", it.button.name()))
            }),
        );
        add(
            "supply",
            told(&self.supply, |it| {
                let state = if it.on { "on" } else { "off" };
                (it.at, format!("remote's receiver {state}"))
            }),
        );
        add(
            "joystick",
            told(&self.joystick, |it| {
                let (right, forward) = (it.right, it.forward);
                (
                    it.at,
                    format!("joystick at {right} right, {forward} forward"),
                )
            }),
        );
        add(
            "knob",
            told(&self.knob, |it| {
                let node = name(it.node);
                (it.at, format!("knob of {node} at {}", it.position))
            }),
        );
        add(
            "stop_loop",
            told(&self.stop_loop, |it| {
                let state = if it.open { "opened" } else { "closed" };
                (it.at, format!("stop loop {state}"))
            }),
        );
        self.of_nodes(name, &mut add);
        add("bus", told(&self.bus, on_the_bus));
        add("distance_fault", told(&self.distance_fault, distance));
        all
    }

    fn of_nodes(&self, name: &dyn Fn(NodeIndex) -> String, add: &mut dyn FnMut(&str, Vec<Told>)) {
        add(
            "reset",
            told(&self.reset, |it| {
                let what = if it.until.is_some() { "held" } else { "kept" };
                (it.at, format!("{} {what} in reset", name(it.node)))
            }),
        );
        add(
            "clock",
            told(&self.clock, |it| {
                let what = if it.present { "comes" } else { "stops" };
                (it.at, format!("clock of {} {what}", name(it.node)))
            }),
        );
        add(
            "brownout",
            told(&self.brownout, |it| {
                let (node, lowest) = (name(it.node), it.lowest);
                (it.at, format!("supply of {node} falls to {lowest}"))
            }),
        );
        add(
            "wire",
            told(&self.wire, |it| {
                let (node, byte) = (name(it.node), it.byte);
                (it.at, format!("noise to driver of {node}: 0x{byte:02X}"))
            }),
        );
        add(
            "relay",
            told(&self.relay, |it| {
                (it.at, format!("relay of {} sticks", name(it.node)))
            }),
        );
        add(
            "babble",
            told(&self.babble, |it| {
                let how = match it.id {
                    Some(id) => format!("babbles {id}"),
                    None => "holds the bus dominant".to_owned(),
                };
                (it.at, format!("{} {how}", name(it.node)))
            }),
        );
    }
}

/// Each event with its time.
fn told<E>(events: &[E], tell: impl Fn(&E) -> Told) -> Vec<Told> {
    events.iter().map(tell).collect()
}

fn stream(it: &StreamFault) -> Told {
    let share = it.rate;
    let what = match it.fault {
        StreamFaultKind::Flip => format!("flips bits of {share} of the bytes"),
        StreamFaultKind::Truncate => format!("cuts {share} of its frames"),
        StreamFaultKind::Length => format!("gives {share} of its frames a wrong length"),
        StreamFaultKind::Flood => "sends random bytes without pause".to_owned(),
        StreamFaultKind::Preambles => "sends preambles without pause".to_owned(),
        StreamFaultKind::Silence => "sends nothing".to_owned(),
    };
    (it.from, format!("receiver {what}"))
}

fn on_the_bus(it: &BusEvent) -> Told {
    let words = match it {
        BusEvent::Frame { id, every, .. } => match every {
            Some(every) => format!("foreign frame {id} every {every}"),
            None => format!("foreign frame {id}"),
        },
        BusEvent::Corrupt { id, count, .. } => {
            let which = id.map_or_else(String::new, |id| format!(" of {id}"));
            match count {
                1 => format!("a frame{which} is disturbed"),
                count => format!("{count} frames{which} are disturbed"),
            }
        }
        BusEvent::Dominant { id: None, hold, .. } => format!("bus held dominant for {hold}"),
        BusEvent::Dominant {
            id: Some(id), hold, ..
        } => format!("bus held dominant for {hold} in the next frame of {id}"),
    };
    (it.at(), words)
}

fn distance(it: &DistanceFault) -> Told {
    let which = match it.side {
        Side::Left => "left distance sensor",
        Side::Right => "right distance sensor",
        Side::Both => "both distance sensors",
    };
    let what = match it.fault {
        Fault::Open => "open",
        Fault::ShortedToGround => "shorted to ground",
        Fault::ShortedToSupply => "shorted to supply",
        Fault::Frozen => "frozen",
        Fault::Blind => "blind",
    };
    (it.at, format!("{which} {what}"))
}
