//! What must hold of a netlist and its bill of materials.
//!
//! Each rule returns its findings, one sentence each; a sound drawing has none.

use std::collections::{BTreeMap, BTreeSet};

use parts::{Connector, Signal, Sled};

use crate::bill::Item;
use crate::header::HeaderPin;
use crate::netlist::{Net, Netlist, Node};

/// Connectors that are on the Nucleo board itself. The console is wired to the ST-LINK (on the
/// Nucleo-64 by SB13 and SB14, on the Nucleo-32 by SB2 and SB3), the LED to the processor.
pub const ON_NUCLEO: [&str; 2] = ["console", "led"];

/// The clock input of the Nucleo-F303K8, which the pin tables do not list. A sled may drive it;
/// that of the Nucleo-F446RE is left to the ST-LINK.
const CLOCK: &str = "PF0";

/// Components that no net joins: the Nucleo boards stand on their headers, a holder and a shunt
/// on what they hold.
const WITHOUT_NETS: [&str; 3] = ["A", "XF", "XJP"];

/// A Nucleo board in a netlist.
#[derive(Debug, Clone)]
pub struct Board {
    /// The board.
    pub sled: &'static Sled,
    /// The pins of its headers.
    pub headers: Vec<HeaderPin>,
    /// What the names of its nets begin with.
    pub prefix: &'static str,
}

impl Board {
    /// Name of the net of a line of a connector.
    fn net(&self, connector: &Connector, signal: &Signal) -> String {
        format!("{}{}.{}", self.prefix, connector.name, signal.name)
    }

    /// Name of the net of a supply.
    fn supply(&self, name: &str) -> String {
        match self.prefix.strip_suffix('.') {
            None => name.to_owned(),
            Some(board) => format!("{board}:{name}"),
        }
    }

    /// The line that a pin of a header is.
    fn line(&self, pin: &HeaderPin) -> Option<(&'static Connector, &'static Signal)> {
        let mcu = pin.mcu()?;
        let lines = |place: &'static Connector| place.signals.iter().map(move |line| (place, line));
        let mut lines = self.sled.connectors.iter().flat_map(lines);
        lines.find(|(_, line)| line.pin == mcu)
    }

    /// The names that the net of a pin of a header may have. Without a name the pin is open.
    fn names(&self, pin: &HeaderPin) -> Vec<String> {
        match self.line(pin) {
            Some((place, _)) if ON_NUCLEO.contains(&place.name) => Vec::new(),
            Some((place, line)) => vec![self.net(place, line)],
            None => match pin.signal.as_str() {
                "GND" | "AGND" => vec!["GND".into()],
                "+3V3" => vec![self.supply("+3V3")],
                "+5V" | "E5V" => vec![self.supply("+5V")],
                CLOCK if self.sled.name == "f303" => vec!["clock".into()],
                _ => Vec::new(),
            },
        }
    }
}

/// Every pin of a header is in the netlist, under the name that the maker gives it, and joined to
/// what the code uses it for, or is open.
#[must_use]
pub fn headers(netlist: &Netlist, board: &Board) -> Vec<String> {
    let mut findings = Vec::new();
    for pin in &board.headers {
        let place = format!("{}-{}", pin.header, pin.pin);
        let Some(net) = netlist.net_of(&pin.header, &pin.pin) else {
            findings.push(format!("{place} is not in the netlist"));
            continue;
        };
        let node = net
            .nodes
            .iter()
            .find(|node| node.component == pin.header && node.pin == pin.pin);
        let function = node.map_or("", |node| node.function.as_str());
        if function != pin.signal {
            findings.push(format!("{place} is {} and not {function}", pin.signal));
        }
        if !net.is_open() && !board.names(pin).contains(&net.name) {
            findings.push(format!(
                "{place} ({}) may not be on {}",
                pin.signal, net.name
            ));
        }
    }
    findings
}

/// Every line of the code is joined to a pin of a header and to the terminals, transceiver or
/// device of its connector. Lines on the Nucleo itself are none of the sled's.
///
/// A bench needs not wire `all` of them.
#[must_use]
pub fn lines(netlist: &Netlist, board: &Board, all: bool) -> Vec<String> {
    let mut findings = Vec::new();
    let places = board.sled.connectors.iter();
    for place in places.filter(|place| !ON_NUCLEO.contains(&place.name)) {
        for line in place.signals {
            let name = board.net(place, line);
            let Some(net) = netlist.nets.iter().find(|net| net.name == name) else {
                if all || place.name == "can" {
                    findings.push(format!("{name} is not wired"));
                }
                continue;
            };
            let mut pins = board.headers.iter();
            if !pins.any(|pin| pin.mcu() == Some(line.pin) && net.has(&pin.header, &pin.pin)) {
                findings.push(format!("{name} is not on {}", line.pin));
            }
            let reached = reached(netlist, net);
            let ends = |node: &&Node| {
                let component = netlist.component(&node.component);
                component.is_some_and(|component| match place.name {
                    "can" => component.value.starts_with("SN65HVD230"),
                    connector => component.value == connector,
                })
            };
            if all && !reached.iter().any(ends) {
                findings.push(format!("{name} does not reach {}", place.name));
            }
        }
    }
    findings
}

/// The pins that are joined to a net, through resistors and from the gate of a transistor to its
/// drain.
fn reached<'n>(netlist: &'n Netlist, from: &'n Net) -> Vec<&'n Node> {
    let mut names = BTreeSet::from([from.name.as_str()]);
    let mut waiting = vec![from];
    let mut nodes = Vec::new();
    while let Some(net) = waiting.pop() {
        for node in &net.nodes {
            nodes.push(node);
            let through = match (kind(&node.component), node.pin.as_str()) {
                ("R" | "Q", "1") => Some(if kind(&node.component) == "Q" {
                    "3"
                } else {
                    "2"
                }),
                ("R", "2") => Some("1"),
                _ => None,
            };
            let next = through.and_then(|pin| netlist.net_of(&node.component, pin));
            if let Some(next) = next.filter(|net| !net.is_supply())
                && names.insert(next.name.as_str())
            {
                waiting.push(next);
            }
        }
    }
    nodes
}

/// The letters of a reference designator.
fn kind(reference: &str) -> &str {
    reference.trim_end_matches(|c: char| c.is_ascii_digit())
}

/// Nets join at least two pins, pins that are left open one, and no pin is on two nets. All that
/// is joined is listed, and all that is listed is joined.
#[must_use]
pub fn nets(netlist: &Netlist) -> Vec<String> {
    let mut findings = Vec::new();
    let mut seen = BTreeSet::new();
    let mut names = BTreeSet::new();
    let mut joined = BTreeSet::new();
    for net in &netlist.nets {
        if !names.insert(&net.name) {
            findings.push(format!("two nets are named {}", net.name));
        }
        if net.nodes.len() < 2 && !net.is_open() {
            findings.push(format!("{} joins nothing", net.name));
        }
        for node in &net.nodes {
            let pin = format!("{}-{}", node.component, node.pin);
            if netlist.component(&node.component).is_none() {
                findings.push(format!("{pin} is on {}, but no component", net.name));
            }
            if node.open && !net.is_open() {
                findings.push(format!("{pin} is on {}, but to be left open", net.name));
            }
            if !seen.insert(pin.clone()) {
                findings.push(format!("{pin} is on two nets"));
            }
            joined.insert(node.component.as_str());
        }
    }
    let mut references = BTreeSet::new();
    for component in &netlist.components {
        let reference = component.reference.as_str();
        if !references.insert(reference) {
            findings.push(format!("two components are named {reference}"));
        }
        if !joined.contains(reference) && !WITHOUT_NETS.contains(&kind(reference)) {
            findings.push(format!("{reference} is on no net"));
        }
    }
    findings
}

/// Every component that has to be bought is in the bill once, with its value, a maker and a part
/// number; and the reverse.
#[must_use]
pub fn bill(netlist: &Netlist, items: &[Item]) -> Vec<String> {
    let mut findings = Vec::new();
    let mut listed: BTreeMap<&str, usize> = BTreeMap::new();
    for item in items {
        let all = item.references.join(" ");
        if item.maker.is_empty() || item.number.is_empty() {
            findings.push(format!("{all} has no maker or part number"));
        }
        if item.quantity != item.references.len().to_string() {
            findings.push(format!("{all} are not {}", item.quantity));
        }
        for reference in &item.references {
            *listed.entry(reference).or_default() += 1;
            match netlist.component(reference) {
                None => findings.push(format!("{reference} is in the bill only")),
                Some(component) if !component.in_bill => {
                    findings.push(format!("{reference} is not to be bought"));
                }
                Some(component) if component.value != item.value => findings.push(format!(
                    "{reference} is {} in the netlist and {} in the bill",
                    component.value, item.value
                )),
                Some(_) => (),
            }
        }
    }
    for component in netlist
        .components
        .iter()
        .filter(|component| component.in_bill)
    {
        match listed.get(component.reference.as_str()) {
            None => findings.push(format!("{} is not in the bill", component.reference)),
            Some(1) => (),
            Some(_) => findings.push(format!("{} is in the bill twice", component.reference)),
        }
    }
    findings
}

/// Each transceiver is an SN65HVD230 at 3.3 V in its fast mode, on the CAN lines of a board, and
/// its bus is terminated. `terminations` is the number of resistors of 120 ohm across the bus,
/// closed or with a jumper.
#[must_use]
pub fn bus(netlist: &Netlist, board: &Board, terminations: usize) -> Vec<String> {
    let mut findings = Vec::new();
    let lines = ["tx", "rx"].map(|line| format!("{}can.{line}", board.prefix));
    let transceivers = netlist.components.iter().filter(|component| {
        let pins = netlist.pins_of(&component.reference);
        kind(&component.reference) == "U" && pins.iter().any(|(_, net)| lines.contains(&net.name))
    });
    let mut count = 0;
    for transceiver in transceivers {
        count += 1;
        let reference = &transceiver.reference;
        if !transceiver.value.starts_with("SN65HVD230") {
            findings.push(format!(
                "{reference} is {} and needs 5 V",
                transceiver.value
            ));
        }
        for (node, net) in netlist.pins_of(reference) {
            let wanted = match node.function.as_str() {
                "D" | "CAN TX" => lines[0].clone(),
                "R" | "CAN RX" => lines[1].clone(),
                "VCC" | "3V3" => board.supply("+3V3"),
                "GND" | "Rs" => "GND".into(),
                "CANH" | "CANL" => node.function.clone(),
                _ => continue,
            };
            if net.name != wanted {
                findings.push(format!("{reference} has {} on {}", node.function, net.name));
            }
        }
    }
    if count != 1 {
        findings.push(format!("{count} transceivers are on {}", lines[0]));
    }
    let ends = |reference: &str| -> Vec<&str> {
        let pins = netlist.pins_of(reference);
        pins.iter().map(|(_, net)| net.name.as_str()).collect()
    };
    let jumpers = netlist
        .components
        .iter()
        .filter(|part| kind(&part.reference) == "JP");
    let behind: Vec<Vec<&str>> = jumpers.map(|jumper| ends(&jumper.reference)).collect();
    let closes = |net: &str| {
        net == "CANL"
            || behind
                .iter()
                .any(|ends| ends.contains(&net) && ends.contains(&"CANL"))
    };
    let across = netlist.components.iter().filter(|part| {
        let [a, b] = ends(&part.reference)[..] else {
            return false;
        };
        kind(&part.reference) == "R" && part.value == "120" && a == "CANH" && closes(b)
    });
    let across = across.count();
    if across != terminations {
        findings.push(format!("{across} resistors of 120 ohm terminate the bus"));
    }
    findings
}

/// The supply of a sled comes through a fuse and the switching supply to the Nucleo; 3.3 V come
/// back from there, with a capacitor for each transceiver.
#[must_use]
pub fn supply(netlist: &Netlist, board: &Board) -> Vec<String> {
    let mut findings = Vec::new();
    let on = |component: &str, pin: &str, net: &str| {
        netlist
            .net_of(component, pin)
            .is_some_and(|found| found.name == net)
    };
    let mut ask = |holds: bool, finding: &str| {
        if !holds {
            findings.push(finding.to_owned());
        }
    };
    ask(
        on("J1", "1", "VIN") && on("J1", "2", "GND"),
        "J1 is not the supply",
    );
    ask(on("F1", "1", "VIN"), "the fuse is not in the supply");
    ask(
        on("F1", "2", "fused") && on("PS1", "1", "fused"),
        "the switching supply is not behind the fuse",
    );
    ask(
        on("PS1", "2", "GND") && on("PS1", "3", "+5V"),
        "the switching supply makes no 5 V",
    );
    let fed = |signal: &str, net: &str| {
        let mut pins = board.headers.iter().filter(|pin| pin.signal == signal);
        pins.any(|pin| on(&pin.header, &pin.pin, net))
    };
    ask(
        fed("E5V", "+5V") || fed("+5V", "+5V"),
        "the Nucleo gets no 5 V",
    );
    ask(fed("+3V3", "+3V3"), "the Nucleo gives no 3.3 V");
    let grounds = board.headers.iter().filter(|pin| pin.signal == "GND");
    let grounds: Vec<_> = grounds.collect();
    ask(
        !grounds.is_empty() && grounds.iter().all(|pin| on(&pin.header, &pin.pin, "GND")),
        "a ground of the Nucleo is open",
    );
    ask(
        between(netlist, "C", "100n", "+3V3", "GND"),
        "3.3 V have no capacitor",
    );
    findings
}

/// While the part is in reset, the relay's line is at ground by 10 kohm, and the relay blocks the
/// motor's current in both directions.
#[must_use]
pub fn relay(netlist: &Netlist, board: &Board) -> Vec<String> {
    let line = format!("{}motor.relay", board.prefix);
    let mut findings = Vec::new();
    if !between(netlist, "R", "10k", &line, "GND") {
        findings.push("the relay's line floats in reset".into());
    }
    let relays: Vec<Vec<&str>> = netlist
        .components
        .iter()
        .filter(|part| kind(&part.reference) == "K")
        .map(|part| {
            let pins = netlist.pins_of(&part.reference);
            pins.iter().map(|(_, net)| net.name.as_str()).collect()
        })
        .collect();
    // A relay for direct current is a transistor, whose body diode conducts from - to +.
    let opposed = match relays.as_slice() {
        [] => true,
        [one, other] => one[1] == other[1] && one[0] != other[0] && one[2..] == other[2..],
        _ => false,
    };
    if !opposed {
        findings.push("the relay conducts in one direction while it is open".into());
    }
    findings
}

/// Whether a component of this kind and value joins two nets.
fn between(netlist: &Netlist, what: &str, value: &str, one: &str, other: &str) -> bool {
    let mut parts = netlist.components.iter();
    parts.any(|part| {
        let pins = netlist.pins_of(&part.reference);
        let ends: BTreeSet<&str> = pins.iter().map(|(_, net)| net.name.as_str()).collect();
        kind(&part.reference) == what && part.value == value && ends == BTreeSet::from([one, other])
    })
}
