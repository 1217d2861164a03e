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

    /// Name of the net of the pin that closes the gate of a guarded node, counted from 0, and its terminals. That may be the
    /// output of another node.
    fn gate(&self, place: usize) -> (String, &'static str) {
        let lines = |connector: &'static Connector| {
            let lines = connector.signals.iter();
            lines.map(move |line| (connector, line))
        };
        let mut lines = self.sled.connectors.iter().flat_map(lines);
        let gate = self.sled.taps.get(place).map(|tap| tap.gate);
        match lines.find(|(_, line)| Some(line.pin) == gate) {
            Some((connector, line)) => (self.net(connector, line), connector.name),
            None => (format!("{}gates.{}", self.prefix, place + 1), "gates"),
        }
    }

    /// The names that the net of a pin of a header may have. Without a name the pin is open.
    fn names(&self, pin: &HeaderPin) -> Vec<String> {
        let mut taps = self.sled.taps.iter();
        if let Some(place) = taps.position(|tap| Some(tap.gate) == pin.mcu()) {
            return vec![self.gate(place).0];
        }
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

/// The pins that are joined to a net, through resistors, from the gate of a transistor to its
/// drain, and through the gate of a bus guardian.
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
                ("U", "1") if is_gate(netlist, &node.component) => Some("4"),
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

/// The OR gate by which a bus guardian keeps a node off the bus.
const GATE: &str = "74LVC1G32";

fn is_gate(netlist: &Netlist, reference: &str) -> bool {
    let component = netlist.component(reference);
    component.is_some_and(|component| component.value == GATE)
}

/// The net of a pin of the guardian's gate, by the name of the pin; `None` without a gate.
fn at_gate<'n>(netlist: &'n Netlist, pin: &str) -> Option<&'n str> {
    let mut parts = netlist.components.iter();
    let gate = parts.find(|part| is_gate(netlist, &part.reference))?;
    let pins = netlist.pins_of(&gate.reference);
    let mut pins = pins.into_iter().filter(|(node, _)| node.function == pin);
    pins.next().map(|(_, net)| net.name.as_str())
}

/// The TX line goes through an OR gate to the transceiver. It is open while nothing drives its other input:
/// a node without a guardian, and one whose guardian has no supply, is on the bus as without a gate. A short
/// circuit of the wires to the guardian does not stop the node.
///
/// On a sled that can be a guardian's, the lines of all guarded nodes and their gates are on terminals.
#[must_use]
pub fn gate(netlist: &Netlist, board: &Board) -> Vec<String> {
    let [tx, tap, input] =
        ["can.tx", "guard.tx", "guard.gate"].map(|name| format!("{}{name}", board.prefix));
    let mut findings = Vec::new();
    let supply = board.supply("+3V3");
    for (pin, wanted) in [("A", &tx), ("B", &input), ("VCC", &supply)] {
        if at_gate(netlist, pin) != Some(wanted) {
            findings.push(format!("{pin} of the gate is not on {wanted}"));
        }
    }
    if !between(netlist, "R", "10k", &input, "GND") {
        findings.push("the gate's input floats without a guardian".into());
    }
    if resistance(netlist, &tx, &tap).is_none() {
        findings.push(format!("{tap} is not {tx} behind a resistor"));
    }
    let mut ask = |net: String, terminal: &str| {
        let found = netlist.nets.iter().find(|found| found.name == net);
        let nodes = found.map(|found| found.nodes.as_slice());
        let ends = |node: &Node| {
            let component = netlist.component(&node.component);
            component.is_some_and(|component| component.value == terminal)
        };
        if !nodes.unwrap_or_default().iter().any(ends) {
            findings.push(format!("{net} is not at the terminals {terminal}"));
        }
    };
    ask(tap, "guard");
    ask(input, "guard");
    for (place, tap) in board.sled.taps.iter().enumerate() {
        let (gate, terminal) = board.gate(place);
        ask(gate, terminal);
        // The guardian has its taps where another node has its switches or its remote control.
        let lines = board.sled.connectors.iter();
        for connector in lines {
            for line in connector.signals.iter().filter(|line| line.pin == tap.line) {
                let line = board.net(connector, line);
                let outside = format!("{line}/in");
                let is_behind = resistance(netlist, &outside, &line).is_some();
                ask(if is_behind { outside } else { line }, connector.name);
            }
        }
    }
    findings
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
    let [tx, rx] = ["tx", "rx"].map(|line| format!("{}can.{line}", board.prefix));
    // Behind the gate, if there is one.
    let tx = at_gate(netlist, "Y").map_or(tx, str::to_owned);
    let lines = [tx, rx];
    let transceivers = netlist.components.iter().filter(|component| {
        let pins = netlist.pins_of(&component.reference);
        kind(&component.reference) == "U"
            && !is_gate(netlist, &component.reference)
            && pins.iter().any(|(_, net)| lines.contains(&net.name))
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
    let jumpers = netlist
        .components
        .iter()
        .filter(|part| kind(&part.reference) == "JP");
    let behind: Vec<Vec<&str>> = jumpers
        .map(|jumper| netlist.ends(&jumper.reference))
        .collect();
    let closes = |net: &str| {
        net == "CANL"
            || behind
                .iter()
                .any(|ends| ends.contains(&net) && ends.contains(&"CANL"))
    };
    let across = netlist.components.iter().filter(|part| {
        let [a, b] = netlist.ends(&part.reference)[..] else {
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
    // A relay for direct current is a transistor, whose body diode conducts from - to +.
    let opposed = match relays(netlist).as_slice() {
        [] => true,
        [one, other] => {
            let same = [0, 1].map(|pin| one[pin] == other[pin]);
            same[0] != same[1] && one[2..] == other[2..]
        }
        _ => false,
    };
    if !opposed {
        findings.push("the relay conducts in one direction while it is open".into());
    }
    findings
}

/// Nets of the pins of each relay: +, -, and its input.
fn relays(netlist: &Netlist) -> Vec<Vec<&str>> {
    let relays = netlist.components.iter();
    relays
        .filter(|part| kind(&part.reference) == "K")
        .map(|part| netlist.ends(&part.reference))
        .collect()
}

/// Supply of the processor, V.
const SUPPLY: f64 = 3.3;

/// Voltage at the input below which it counts as low, V: 0.3 of the supply (DS9866, I/O static
/// characteristics).
const LOW: f64 = 0.3 * SUPPLY;

/// Smallest pull-up in the processor, which the firmware switches on, ohm (DS9866, the same table).
const INTERNAL_PULL_UP: f64 = 25e3;

/// Forward voltage of the diode at 0.4 mA, V (BAT46 data sheet: 0.25 V at 0.1 mA, 0.45 V at 10 mA).
const FORWARD: f64 = 0.4;

/// The input of the relays' read-back is high while both relays are open, low while one of them
/// conducts, and never sees the battery.
///
/// The relays are joined at their + sides: their body diodes conduct into the joint, so nothing
/// holds the joint while both are open and the driver is stopped. A pull-up lifts it through a
/// diode. A relay that conducts joins it to M1 or to the motor's lead, which a resistor holds near
/// ground even if the driver's output floats.
#[must_use]
pub fn read_back(netlist: &Netlist, board: &Board) -> Vec<String> {
    let line = format!("{}motor.sense", board.prefix);
    let wire = format!("{line}/wire");
    let supply = board.supply("+3V3");
    let mut findings = Vec::new();
    let relays = relays(netlist);
    let [one, other] = relays.as_slice() else {
        return vec!["there are not two relays to read back".into()];
    };
    let joint = one[0];
    if joint != other[0] || one[1] == other[1] {
        findings.push("the relays are not joined at their + sides".into());
    }
    let mut diodes = netlist.components.iter();
    if !diodes.any(|part| {
        kind(&part.reference) == "D" && netlist.ends(&part.reference) == [joint, wire.as_str()]
    }) {
        findings.push("no diode conducts from the read-back into the relays' joint".into());
    }
    let [pull_up, series] = [&supply, &line].map(|end| resistance(netlist, &wire, end));
    if pull_up.is_none() {
        findings.push("the read-back has no pull-up".into());
    }
    for lead in [one[1], other[1]] {
        match resistance(netlist, lead, "GND") {
            None => findings.push(format!("{lead} floats with the driver's output")),
            Some(lead_ohm) => {
                let level = low_level(pull_up, series.unwrap_or(0.0), lead_ohm);
                if level >= LOW {
                    findings.push(format!("the low level by {lead} is {level:.2} V"));
                }
            }
        }
    }
    if !clamped(netlist, &line, &supply) {
        findings.push("nothing clamps the read-back to its supply".into());
    }
    // Everything else on the two nets of the input must not lift it above its supply.
    for name in [&line, &wire] {
        let net = netlist.nets.iter().find(|net| net.name == *name);
        for node in net.into_iter().flat_map(|net| &net.nodes) {
            let ends = netlist.ends(&node.component);
            let quiet = [name.as_str(), &line, &wire, &supply, "GND"];
            let harmless = match kind(&node.component) {
                "CN" | "J" => true,
                "R" | "C" => ends.iter().all(|end| quiet.contains(end)),
                "D" if ends.len() == 2 => node.pin == "2",
                "D" => ends.iter().all(|end| quiet.contains(end)),
                _ => false,
            };
            if !harmless {
                findings.push(format!("{} can lift {name}", node.component));
            }
        }
    }
    findings
}

/// Parts of the divider of a distance sensor's voltage, all alike: the input gets what is across the
/// last one (thesis 2.2.4.2).
const DIVIDER: usize = 3;

/// Each line of the distance sensors is divided by three, filtered, and clamped to the supply of the
/// processor (thesis, Figure 2.9).
#[must_use]
pub fn distances(netlist: &Netlist, board: &Board) -> Vec<String> {
    let supply = board.supply("+3V3");
    let mut findings = Vec::new();
    for side in ["left", "right"] {
        let line = format!("{}distances.{side}", board.prefix);
        let [input, half, third] = ["in", "half", "third"].map(|at| format!("{line}/{at}"));
        let chain = [&input, &half, &third, "GND"];
        let parts: Vec<f64> = (0..DIVIDER)
            .filter_map(|part| resistance(netlist, chain[part], chain[part + 1]))
            .collect();
        if parts.len() != DIVIDER || parts.iter().any(|part| *part != parts[0]) {
            findings.push(format!("{line} is not divided by three"));
        }
        if resistance(netlist, &third, &line).is_none() {
            findings.push(format!("nothing limits the current into {line}"));
        }
        if !between(netlist, "C", "100n", &line, "GND") {
            findings.push(format!("{line} has no filter"));
        }
        if !clamped(netlist, &line, &supply) {
            findings.push(format!("nothing clamps {line} to its supply"));
        }
    }
    findings
}

/// While the part is in reset, its servo outputs are low: the motor drivers get no pulse. Open
/// inputs of the remote control are low.
#[must_use]
pub fn pulled_down(netlist: &Netlist, board: &Board) -> Vec<String> {
    [
        "servos.left",
        "servos.right",
        "remote.run/in",
        "remote.stop/in",
    ]
    .into_iter()
    .map(|name| format!("{}{name}", board.prefix))
    .filter(|line| !between(netlist, "R", "10k", line, "GND"))
    .map(|line| format!("{line} floats"))
    .collect()
}

/// Level at the input while a lead is held at ground by `lead` ohm only, V. The pull-ups, that of
/// the wire and the processor's own behind the `series` resistor, feed it through the diode.
fn low_level(pull_up: Option<f64>, series: f64, lead: f64) -> f64 {
    let own = INTERNAL_PULL_UP + series;
    let both = 1.0 / (pull_up.map_or(0.0, |ohm| 1.0 / ohm) + 1.0 / own);
    let wire = FORWARD + (SUPPLY - FORWARD) * lead / (lead + both);
    wire + (SUPPLY - wire) * series / own
}

/// Whether a pair of diodes clamps a net between ground and a supply.
fn clamped(netlist: &Netlist, net: &str, supply: &str) -> bool {
    let mut parts = netlist.components.iter();
    parts.any(|part| {
        kind(&part.reference) == "D" && netlist.ends(&part.reference) == ["GND", supply, net]
    })
}

/// Resistance of the component that joins two nets, ohm.
fn resistance(netlist: &Netlist, one: &str, other: &str) -> Option<f64> {
    let joins = |reference: &str| {
        let ends: BTreeSet<&str> = netlist.ends(reference).into_iter().collect();
        kind(reference) == "R" && ends == BTreeSet::from([one, other])
    };
    let mut parts = netlist.components.iter();
    let part = parts.find(|part| joins(&part.reference))?;
    let value = part.value.split_whitespace().next()?;
    match value.strip_suffix('k') {
        Some(kilo) => kilo.parse::<f64>().ok().map(|kilo| 1e3 * kilo),
        None => value.parse().ok(),
    }
}

/// Whether a component of this kind and value joins two nets.
fn between(netlist: &Netlist, what: &str, value: &str, one: &str, other: &str) -> bool {
    let mut parts = netlist.components.iter();
    parts.any(|part| {
        let ends: BTreeSet<&str> = netlist.ends(&part.reference).into_iter().collect();
        kind(&part.reference) == what && part.value == value && ends == BTreeSet::from([one, other])
    })
}
