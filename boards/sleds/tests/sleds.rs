//! The drawings of the sleds are sound, and their pictures show them.

use std::{env, fs};

use parts::Sled;
use sleds::bill::{self, Item};
use sleds::netlist::Netlist;
use sleds::rules::{self, Board};
use sleds::{DRAWINGS, header, path, picture, read};

/// A netlist with its bill of materials.
struct Drawing {
    netlist: Netlist,
    items: Vec<Item>,
}

impl Drawing {
    fn of(name: &str) -> Self {
        Self::changed(name, &[])
    }

    /// The drawing with texts of its netlist replaced, each of which is in it once.
    fn changed(name: &str, changes: &[(&str, &str)]) -> Self {
        let (net, bill) = (format!("{name}.net"), format!("{name}.csv"));
        let mut text = read(&net).unwrap();
        for (from, to) in changes {
            assert_eq!(text.matches(from).count(), 1, "{from}");
            text = text.replace(from, to);
        }
        Self {
            netlist: Netlist::parse(&net, &text).unwrap(),
            items: bill::parse(&bill, &read(&bill).unwrap()).unwrap(),
        }
    }

    /// What the rules find in the drawing of a sled.
    fn findings(&self, sled: &'static Sled) -> Vec<String> {
        let board = board(sled, "");
        let mut findings = rules::headers(&self.netlist, &board);
        findings.extend(rules::lines(&self.netlist, &board, true));
        findings.extend(rules::nets(&self.netlist));
        findings.extend(rules::bill(&self.netlist, &self.items));
        findings.extend(rules::bus(&self.netlist, &board, 1));
        findings.extend(rules::supply(&self.netlist, &board));
        findings.extend(rules::gate(&self.netlist, &board));
        if sled.connector("motor").is_some() {
            findings.extend(rules::relay(&self.netlist, &board));
            findings.extend(rules::read_back(&self.netlist, &board));
        }
        if sled.connector("distances").is_some() {
            findings.extend(rules::distances(&self.netlist, &board));
            findings.extend(rules::pulled_down(&self.netlist, &board));
        }
        findings
    }
}

fn board(sled: &'static Sled, prefix: &'static str) -> Board {
    Board {
        sled,
        headers: header::of(sled).unwrap(),
        prefix,
    }
}

const NONE: [String; 0] = [];

#[test]
fn the_sleds_are_wired_as_the_code_says() {
    for sled in Sled::ALL {
        assert_eq!(Drawing::of(sled.name).findings(sled), NONE, "{}", sled.name);
    }
}

/// Two boards need less: neither supply nor terminals, and not every line. Each of the two
/// transceiver modules terminates the bus.
#[test]
fn the_bench_is_wired_as_the_code_says() {
    let Drawing { netlist, items } = Drawing::of("bench");
    let mut findings = rules::nets(&netlist);
    findings.extend(rules::bill(&netlist, &items));
    for (sled, prefix) in [(Sled::F446, "f446."), (Sled::F303, "f303.")] {
        let board = board(sled, prefix);
        findings.extend(rules::headers(&netlist, &board));
        findings.extend(rules::lines(&netlist, &board, false));
        findings.extend(rules::bus(&netlist, &board, 2));
    }
    findings.extend(rules::relay(&netlist, &board(Sled::F303, "f303.")));
    assert_eq!(findings, NONE);
    for line in ["f303.pot.wiper", "f303.motor.tx", "f303.motor.relay"] {
        assert!(netlist.nets.iter().any(|net| net.name == line), "{line}");
    }
}

/// Only what the vehicle or a module brings along is not to be bought.
#[test]
fn what_is_not_in_the_bills_is_listed() {
    let left_out = |name: &str| {
        let components = Drawing::of(name).netlist.components;
        let left_out = components
            .into_iter()
            .filter(|component| !component.in_bill);
        left_out
            .map(|component| component.reference)
            .collect::<Vec<_>>()
    };
    assert_eq!(left_out("f446"), NONE);
    assert_eq!(left_out("f303"), ["BT1", "M1"]);
    assert_eq!(left_out("bench"), ["CN7", "CN10", "CN3", "CN4", "R1", "R2"]);
}

/// A change of a netlist, and a finding that it brings.
type Fault = (&'static [(&'static str, &'static str)], &'static str);

const FAULTS: [Fault; 34] = [
    (
        &[(
            "(ref \"CN3\") (pin \"13\") (pinfunction \"PA11\")",
            "(ref \"CN3\") (pin \"12\") (pinfunction \"PA11\")",
        )],
        "CN3-13 is not in the netlist",
    ),
    (
        &[(
            "(pin \"12\") (pinfunction \"PA8\")",
            "(pin \"12\") (pinfunction \"PA9\")",
        )],
        "CN3-12 is PA8 and not PA9",
    ),
    (
        &[("(name \"pot.wiper\")", "(name \"pot.viper\")")],
        "pot.wiper is not wired",
    ),
    (
        &[
            ("(name \"can.tx\")", "(name \"other\")"),
            ("(name \"can.rx\")", "(name \"can.tx\")"),
            ("(name \"other\")", "(name \"can.rx\")"),
        ],
        "can.tx is not on PA12",
    ),
    (
        &[("(value \"pot\")", "(value \"poti\")")],
        "pot.wiper does not reach pot",
    ),
    (
        &[("(name \"unconnected-(CN4-Pad1)\")", "(name \"VIN\")")],
        "two nets are named VIN",
    ),
    (
        &[(
            "(node (ref \"BT1\") (pin \"1\") (pinfunction \"+\") (pintype \"passive\"))",
            "",
        )],
        "battery/unfused joins nothing",
    ),
    (
        &[(
            "(node (ref \"C4\") (pin \"1\")",
            "(node (ref \"C99\") (pin \"1\")",
        )],
        "C99-1 is on +3V3, but no component",
    ),
    (
        &[("(ref \"RV1\")\n", "(ref \"RV2\")\n")],
        "RV1 is in the bill only",
    ),
    (
        &[("(value \"AO3400A\")", "(value \"BC547\")")],
        "Q1 is BC547 in the netlist and AO3400A in the bill",
    ),
    (
        &[("(value \"SN65HVD230\")", "(value \"SN65HVD251\")")],
        "U1 is SN65HVD251 and needs 5 V",
    ),
    (
        &[("(value \"120\")", "(value \"1k\")")],
        "0 resistors of 120 ohm terminate the bus",
    ),
    (
        &[("(ref \"PS1\") (pin \"1\")", "(ref \"PS1\") (pin \"4\")")],
        "the switching supply is not behind the fuse",
    ),
    (
        &[("(node (ref \"R4\") (pin \"2\") (pintype \"passive\"))", "")],
        "the relay's line floats in reset",
    ),
    (
        &[
            ("(ref \"K2\") (pin \"1\")", "(ref \"K2\") (pin \"9\")"),
            ("(ref \"K2\") (pin \"2\")", "(ref \"K2\") (pin \"1\")"),
            ("(ref \"K2\") (pin \"9\")", "(ref \"K2\") (pin \"2\")"),
        ],
        "the relay conducts in one direction while it is open",
    ),
    (
        &[
            ("(ref \"K1\") (pin \"1\")", "(ref \"K1\") (pin \"9\")"),
            ("(ref \"K1\") (pin \"2\")", "(ref \"K1\") (pin \"1\")"),
            ("(ref \"K1\") (pin \"9\")", "(ref \"K1\") (pin \"2\")"),
            ("(ref \"K2\") (pin \"1\")", "(ref \"K2\") (pin \"9\")"),
            ("(ref \"K2\") (pin \"2\")", "(ref \"K2\") (pin \"1\")"),
            ("(ref \"K2\") (pin \"9\")", "(ref \"K2\") (pin \"2\")"),
        ],
        "the relays are not joined at their + sides",
    ),
    (
        &[
            ("(ref \"D4\") (pin \"1\")", "(ref \"D4\") (pin \"9\")"),
            ("(ref \"D4\") (pin \"2\")", "(ref \"D4\") (pin \"1\")"),
            ("(ref \"D4\") (pin \"9\")", "(ref \"D4\") (pin \"2\")"),
        ],
        "no diode conducts from the read-back into the relays' joint",
    ),
    (
        &[("(node (ref \"R6\") (pin \"2\") (pintype \"passive\"))", "")],
        "the read-back has no pull-up",
    ),
    (
        &[("(node (ref \"R7\") (pin \"2\") (pintype \"passive\"))", "")],
        "motor/driver floats with the driver's output",
    ),
    (
        &[("(node (ref \"R8\") (pin \"2\") (pintype \"passive\"))", "")],
        "motor/switched floats with the driver's output",
    ),
    (
        &[(
            "(ref \"R8\")\n      (value \"1k 1W\")",
            "(ref \"R8\")\n      (value \"4.7k 1W\")",
        )],
        "the low level by motor/switched is 1.61 V",
    ),
    (
        &[
            ("(ref \"D5\") (pin \"1\")", "(ref \"D5\") (pin \"9\")"),
            ("(ref \"D5\") (pin \"2\")", "(ref \"D5\") (pin \"1\")"),
            ("(ref \"D5\") (pin \"9\")", "(ref \"D5\") (pin \"2\")"),
        ],
        "nothing clamps the read-back to its supply",
    ),
    (
        &[
            ("(node (ref \"R7\") (pin \"1\") (pintype \"passive\"))", ""),
            (
                "(node (ref \"J6\") (pin \"3\") (pintype \"passive\"))",
                "(node (ref \"R7\") (pin \"1\") (pintype \"passive\"))",
            ),
            ("(node (ref \"R7\") (pin \"2\") (pintype \"passive\"))", ""),
            (
                "(node (ref \"F2\") (pin \"2\") (pintype \"passive\"))",
                "(node (ref \"R7\") (pin \"2\") (pintype \"passive\"))",
            ),
        ],
        "R7 can lift motor.sense/wire",
    ),
    (
        &[(
            "(ref \"R11\")\n      (value \"3.3k\")",
            "(ref \"R11\")\n      (value \"1k\")",
        )],
        "distances.left is not divided by three",
    ),
    (
        &[(
            "(ref \"R17\")\n      (value \"1k\")",
            "(ref \"R17\")\n      (value \"wire\")",
        )],
        "nothing limits the current into distances.right",
    ),
    (
        &[(
            "(ref \"C8\")\n      (value \"100n\")",
            "(ref \"C8\")\n      (value \"10u\")",
        )],
        "distances.right has no filter",
    ),
    (
        &[
            ("(ref \"D6\") (pin \"1\")", "(ref \"D6\") (pin \"9\")"),
            ("(ref \"D6\") (pin \"2\")", "(ref \"D6\") (pin \"1\")"),
            ("(ref \"D6\") (pin \"9\")", "(ref \"D6\") (pin \"2\")"),
        ],
        "nothing clamps distances.left to its supply",
    ),
    (
        &[("(node (ref \"R18\") (pin \"2\") (pintype \"passive\"))", "")],
        "servos.left floats",
    ),
    (
        &[("(node (ref \"R23\") (pin \"2\") (pintype \"passive\"))", "")],
        "remote.stop/in floats",
    ),
    (
        &[("(node (ref \"R24\") (pin \"2\") (pintype \"passive\"))", "")],
        "the gate's input floats without a guardian",
    ),
    (
        &[
            ("(ref \"U2\") (pin \"1\")", "(ref \"U2\") (pin \"9\")"),
            (
                "(pin \"2\") (pinfunction \"B\")",
                "(pin \"1\") (pinfunction \"A\")",
            ),
            (
                "(pin \"9\") (pinfunction \"A\")",
                "(pin \"2\") (pinfunction \"B\")",
            ),
        ],
        "A of the gate is not on can.tx",
    ),
    (
        &[(
            "(node (ref \"U1\") (pin \"1\") (pinfunction \"D\") (pintype \"passive\"))",
            "(node (ref \"J3\") (pin \"9\") (pinfunction \"D\") (pintype \"passive\"))",
        )],
        "can.tx does not reach can",
    ),
    (
        &[(
            "(ref \"R25\")\n      (value \"1k\")",
            "(ref \"R25\")\n      (value \"wire\")",
        )],
        "guard.tx is not can.tx behind a resistor",
    ),
    (
        &[("(value \"guard\")", "(value \"spare\")")],
        "guard.gate is not at the terminals guard",
    ),
];

#[test]
fn each_rule_finds_its_fault() {
    for (changes, finding) in FAULTS {
        let findings = Drawing::changed("f303", changes).findings(Sled::F303);
        assert!(
            findings.iter().any(|found| found == finding),
            "{changes:?} {findings:?}"
        );
    }
}

/// The sled of a bus guardian has the gates of all nodes at its terminals.
#[test]
fn a_gate_that_is_not_wired_is_found() {
    let faults = [
        (
            "(node (ref \"J13\") (pin \"4\")",
            "gates.4 is not at the terminals gates",
        ),
        (
            "(node (ref \"J8\") (pin \"2\")",
            "inputs.b is not at the terminals inputs",
        ),
    ];
    for (end, finding) in faults {
        let changes = [(end, "(node (ref \"J9\") (pin \"7\")")];
        let findings = Drawing::changed("f446", &changes).findings(Sled::F446);
        assert!(
            findings.iter().any(|found| found == finding),
            "{findings:?}"
        );
    }
    // Gates of two nodes that are exchanged would stop the wrong one.
    let changes = [
        ("(name \"gates.1\")", "(name \"other\")"),
        ("(name \"gates.2\")", "(name \"gates.1\")"),
        ("(name \"other\")", "(name \"gates.2\")"),
    ];
    let findings = Drawing::changed("f446", &changes).findings(Sled::F446);
    let finding = "CN10-4 (PC6) may not be on gates.2";
    assert!(
        findings.iter().any(|found| found == finding),
        "{findings:?}"
    );
}

/// What is to be wired and to be bought for the bench stands in the guide.
#[test]
fn the_guide_names_the_pins_and_the_parts_of_the_bench() {
    let guide = fs::read_to_string(path("../GETTING_STARTED.md")).unwrap();
    let Drawing { netlist, items } = Drawing::of("bench");
    for item in items {
        let named = guide.contains(&item.number);
        assert!(named && guide.contains(&item.maker), "{item:?}");
    }
    let nets = netlist
        .nets
        .iter()
        .filter(|net| !net.is_open() && !net.is_supply());
    let pins = nets
        .flat_map(|net| &net.nodes)
        .filter(|node| node.component.starts_with("CN"));
    for pin in pins {
        let name = format!("{}-{} ({})", pin.component, pin.pin, pin.function);
        assert!(guide.contains(&name), "{name}");
    }
}

/// The pins of a bus guardian stand in the table of the README.
#[test]
fn the_taps_of_a_guardian_are_those_of_the_code() {
    let text = fs::read_to_string(path("README.md")).unwrap();
    let taps = Sled::F446.taps.iter().chain(Sled::F303.taps);
    let rows = taps.map(|tap| {
        format!(
            "| P{}{} | P{}{} |",
            tap.line.port, tap.line.number, tap.gate.port, tap.gate.number
        )
    });
    let rows: Vec<String> = rows.collect();
    let places: Vec<_> = rows.iter().map(|row| text.find(row)).collect();
    assert!(
        places.iter().all(Option::is_some) && places.is_sorted(),
        "{rows:?} {places:?}"
    );
}

/// Set `PICTURES=renew` to write the pictures instead of comparing them.
#[test]
fn the_pictures_show_the_netlists() {
    for name in DRAWINGS {
        let drawn = picture::draw(&Drawing::of(name).netlist).unwrap();
        let file = format!("{name}.svg");
        if env::var("PICTURES").is_ok_and(|value| value == "renew") {
            fs::write(path(&file), drawn).unwrap();
            continue;
        }
        // Not `assert_eq!`, which would print both pictures.
        assert!(
            drawn == read(&file).unwrap(),
            "{file} shows another netlist: PICTURES=renew draws it anew"
        );
    }
}
