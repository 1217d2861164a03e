//! The folders of the vehicles in this repository, and errors that are refused.

use std::path::{Path, PathBuf};

use proptest::prelude::*;
use vehicle_model::manifest::Law;
use vehicle_model::{Device, NodeIndex, Override, Overrides, Protocol, Vehicle};

fn vehicles() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../vehicles")
}

/// A file of the UAGV.
fn text_of(file: &str) -> String {
    std::fs::read_to_string(vehicles().join("uagv").join(file)).unwrap()
}

#[test]
fn a_bit_rate_that_no_board_makes_is_refused() {
    let folder = vehicles().join("uagv");
    let text = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
    let rate = "BA_ \"Baudrate\" 250000;";
    let network = text("network.dbc");
    assert!(network.contains(rate));
    let faster = network.replacen(rate, "BA_ \"Baudrate\" 400000;", 1);
    let vehicle = Vehicle::parse("uagv", Path::new("uagv"), &text("vehicle.toml"), &faster);
    assert_eq!(
        vehicle.unwrap_err().to_string(),
        "uagv/network.dbc: Baudrate is 400000 bit/s: 125000, 250000, 500000 are accepted, the \
         bit rates of the board f446 of node \"gps\""
    );
}

fn refusal(from: &str, to: &str) -> String {
    let folder = vehicles().join("uagv");
    let manifest = std::fs::read_to_string(folder.join("vehicle.toml")).unwrap();
    let network = std::fs::read_to_string(folder.join("network.dbc")).unwrap();
    assert!(manifest.contains(from), "{from}");
    let changed = manifest.replacen(from, to, 1);
    Vehicle::parse("uagv", Path::new("uagv"), &changed, &network)
        .unwrap_err()
        .to_string()
}

#[test]
fn every_vehicle_that_comes_along_is_sound() {
    let names = Vehicle::names(&vehicles()).unwrap();
    assert!(names.contains(&"uagv".to_owned()));
    for name in names {
        let vehicle = Vehicle::find(&vehicles(), &name).unwrap();
        assert_eq!(vehicle.name(), name);
        for node in vehicle.nodes() {
            assert_eq!(vehicle.find_node(&vehicle.node(node).name), Some(node));
        }
    }
}

#[test]
fn devices_are_found_at_their_nodes() {
    let uagv = Vehicle::find(&vehicles(), "uagv").unwrap();
    let node = uagv.node_of(Device::SteeringMotor).unwrap();
    assert_eq!(uagv.node(node).name, "steering");
    assert_eq!(
        uagv.node(node).connector(Device::SteeringMotor),
        Some("motor")
    );
    assert_eq!(uagv.node_of(Device::Knob), None);
}

#[test]
fn an_unknown_vehicle_is_told_with_those_there_are() {
    let error = Vehicle::find(&vehicles(), "plough").unwrap_err();
    let sentence = error.to_string();
    assert!(sentence.starts_with("there is no vehicle \"plough\": there are "));
    assert!(sentence.contains("uagv"), "{sentence}");
}

#[test]
fn a_node_without_a_source_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let copy = |file: &str| {
        let to = folder.path().join(file);
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::copy(vehicles().join("two-boards").join(file), to).unwrap();
    };
    for file in ["vehicle.toml", "network.dbc", "nodes/master.rs"] {
        copy(file);
    }
    let said = Vehicle::read(folder.path()).unwrap_err().to_string();
    let sentence = "vehicle.toml: node \"motor\" has no source: nodes/motor.rs is missing";
    assert!(said.ends_with(sentence), "{said}");
    copy("nodes/motor.rs");
    Vehicle::read(folder.path()).unwrap();
}

/// Asserts what each change of the manifest, from one text to another, is refused with.
fn assert_refused(cases: &[(&str, &str, &str)]) {
    for (from, to, sentence) in cases {
        let said = refusal(from, to);
        assert!(said.contains(sentence), "{said}");
        assert!(!said.contains('\n'), "{said}");
    }
}

#[test]
fn what_makes_no_sense_is_refused_in_one_sentence() {
    assert_refused(&[
        (
            "cruise = \"1 m/s\"",
            "cruise = \"1 m\"",
            "machine.cruise: \"1 m\" is not a speed: write a number, a blank and the unit m/s, \
             cm/s, mm/s or km/h, such as \"1 m/s\"",
        ),
        (
            "cruise = \"1 m/s\"",
            "speed = \"1 m/s\"",
            "machine.speed: unknown field `speed`",
        ),
        (
            "autonomous = \"AutonomousRun\"",
            "autonomous = \"Run\"",
            "mode.autonomous: signal \"Mode\" has no value \"Run\"",
        ),
        (
            "steering_rate = \"Command.SteeringRate\"",
            "steering_rate = \"Command.Speed\"",
            "calibration.steering_rate: the unit of signal \"Speed\" is \"cm/s\": deg/s or rad/s \
             is accepted",
        ),
        (
            "potentiometer = \"SteeringPot.Count\"",
            "potentiometer = \"SteeringPot\"",
            "calibration.potentiometer: \"SteeringPot\" is no signal: write",
        ),
        (
            "east = \"Position.East\"",
            "east = \"Velocity.East\"",
            "calibration.east is not in the message of calibration.north",
        ),
        (
            "north = \"243 m\"",
            "north = \"0.5 m\"",
            "waypoint: the run is 0.500 m long: 1 m or more is accepted",
        ),
    ]);
}

#[test]
fn nodes_and_their_wiring_must_be_there() {
    assert_refused(&[
        (
            "drive-motor = \"DriveEnabled\"",
            "drive-motor = \"SteeringEnabled\"",
            "command.enable.drive-motor: signal \"SteeringEnabled\" enables another motor \
             already: each motor needs its own",
        ),
        (
            "wiring = { motor = \"drive-motor\" }",
            "wiring = {}",
            "[machine] needs a drive-motor, which no node has in its wiring",
        ),
        (
            "motor = \"steering-motor\", pot = \"steering-potentiometer\"",
            "motor = \"steering-motor\"",
            "[machine] needs a steering-potentiometer, which no node has in its wiring",
        ),
        (
            "board = \"f446\"",
            "board = \"f407\"",
            "node \"gps\": there is no board \"f407\": f446 and f303 are accepted",
        ),
        (
            "name = \"gps\"",
            "name = \"receiver\"",
            "node \"receiver\" is not in the network file",
        ),
        (
            "motor = \"drive-motor\"",
            "motor = \"steering-motor\"",
            "node \"drive\", connector \"motor\": there is a second steering-motor",
        ),
        (
            "motor = \"drive-motor\"",
            "motor = \"lk204-7t-1u\"",
            "node \"drive\", connector \"motor\": a lk204-7t-1u goes to the connector \"display\"",
        ),
        (
            "name = \"gps\"\nboard = \"f446\"",
            "name = \"gps\"\nboard = \"f303\"",
            "node \"gps\", connector \"receiver\": the board f303 has no such connector: it has \
             can, console, led, motor, pot",
        ),
    ]);
}

#[test]
fn a_vehicle_drives_under_a_backup_only_if_there_is_one() {
    let stop = "backup_master = \"stop\"";
    assert_refused(&[(
        stop,
        "backup_master = \"on\"",
        "line 56, safety.backup_master: unknown variant `on`, expected `stop` or `drive`",
    )]);
    let folder = vehicles().join("two-boards");
    let text = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
    let network = text("network.dbc");
    let manifest = |choice: &str| {
        let own = text("vehicle.toml");
        format!("{own}\n[safety]\nbackup_master = {choice:?}\n")
    };
    let parse = |choice| Vehicle::parse("two", Path::new("two"), &manifest(choice), &network);
    assert!(parse("stop").is_ok());
    assert_eq!(
        parse("drive").unwrap_err().to_string(),
        "two/vehicle.toml: safety.backup_master is \"drive\": \"stop\" is accepted, as no node of \
         the network file has a MasterRank above 0"
    );
}

#[test]
fn the_numbers_of_the_control_law_are_named_by_their_keys() {
    assert_refused(&[
        (
            "cruise = \"1 m/s\"",
            "cruise = \"3 m/s\"",
            "machine.limits.speed, which machine.cruise must not exceed, is 2 m/s: 3 m/s to 10 m/s \
             is accepted",
        ),
        (
            "cruise = \"1 m/s\"",
            "cruise = \"4 m/s\"",
            "machine.cruise is 4 m/s: 0.3 m/s to 3 m/s is accepted",
        ),
        (
            "rear_to_antenna = \"0.255 m\"",
            "rear_to_antenna = \"-1 m\"",
            "the wheelbase, machine.rear_to_antenna plus machine.antenna_to_front, is -0.155 m: \
             0.4 m to 4 m is accepted",
        ),
        (
            "rear_to_antenna = \"0.255 m\"",
            "rear_to_antenna = \"-0.4 m\"",
            "machine.rear_to_antenna is -0.4 m: -0.178 m to 0.89 m is accepted",
        ),
        (
            "steering_angle = \"25 deg\"",
            "steering_angle = \"10 deg\"",
            "machine.limits.steering_angle is 10 deg: 15 deg to 45 deg is accepted",
        ),
        (
            "steering = \"2 deg\"",
            "steering = \"6 deg\"",
            "machine.misalignment.steering is 6 deg: 0.1 deg to 5 deg is accepted",
        ),
        (
            "cornering = 4.0",
            "cornering = nan",
            "machine.cornering is NaN 1/rad: 2 1/rad to 20 1/rad is accepted",
        ),
        (
            "cross_track = 84.0",
            "cross_track = nan",
            "machine.weights.firm.cross_track is NaN: a number above 0 is accepted",
        ),
        (
            "heading = 1.28",
            "heading = -1.28",
            "machine.weights.gentle.heading is -1.28: 0 or a number above it is accepted",
        ),
        (
            "lag = \"300 ms\"",
            "lag = \"300 s\"",
            "machine.drive.lag is 300 s: 0.05 s to 1 s is accepted",
        ),
    ]);
}

#[test]
fn limits_beyond_the_actuators_are_refused() {
    assert_refused(&[
        (
            "steering_angle = \"25 deg\"",
            "steering_angle = \"40 deg\"",
            "machine.limits.steering_angle is 40 deg: up to machine.steering.travel, 35 deg, is \
             accepted",
        ),
        (
            "travel = \"35 deg\"",
            "travel = \"52 deg\"",
            "machine.potentiometer: 2048 counts straight ahead and 40 counts for a degree do \
             not cover 52 degrees to each side",
        ),
        (
            "full_speed = \"2 m/s\"",
            "full_speed = \"1.5 m/s\"",
            "machine.limits.speed is 2 m/s: up to machine.drive.full_speed, 1.5 m/s, is accepted",
        ),
        (
            "slope = \"40 counts/deg\"",
            "slope = \"60 counts/deg\"",
            "machine.potentiometer: 2048 counts straight ahead and 60 counts for a degree do \
             not cover 35 degrees to each side",
        ),
    ]);
}

#[test]
fn what_is_not_toml_is_refused_with_its_line_and_key() {
    let cruise = "cruise = \"1 m/s\"";
    let limits = "[machine.limits]";
    let line_of = |text| {
        let manifest = include_str!("../../vehicles/uagv/vehicle.toml");
        let before = manifest.find(text).expect("in the manifest");
        1 + manifest[..before].matches('\n').count()
    };
    for (from, to, sentence) in [
        (
            cruise,
            "cruise = 1 m/s",
            format!("line {}, cruise: this is not TOML: ", line_of(cruise)),
        ),
        (
            limits,
            "[machine.limits",
            format!("line {}: this is not TOML: ", line_of(limits)),
        ),
        (
            cruise,
            "cruise = 1",
            format!("line {}, machine.cruise: ", line_of(cruise)),
        ),
    ] {
        let said = refusal(from, to);
        assert!(
            said.contains(&format!("vehicle.toml: {sentence}")),
            "{said}"
        );
        assert!(!said.contains('\n'), "{said}");
    }
}

#[test]
fn messages_of_the_self_test_are_checked() {
    for (from, to, why) in [
        (
            "request = \"SelfTestRequest\"",
            "request = \"Ask\"",
            "[self_test] request: there is no message \"Ask\" in the network file",
        ),
        (
            "request = \"SelfTestRequest\"",
            "request = \"Command\"",
            "[self_test] request: the message \"Command\" is cyclic: an event message is accepted",
        ),
        (
            "request = \"SelfTestRequest\"",
            "request = \"DriveStatus\"",
            "[self_test] request: the message \"DriveStatus\" has no signal \"Round\"",
        ),
        (
            "drive = \"DriveSelfTest\"",
            "",
            "[self_test] report, node \"drive\": there is no message for it",
        ),
        (
            "drive = \"DriveSelfTest\"",
            "drive = \"GpsSelfTest\"",
            "[self_test] report, node \"drive\": the message \"GpsSelfTest\" is one of node \"gps\"",
        ),
        (
            "drive = \"DriveSelfTest\"",
            "drive = \"DriveSelfTest\"\nrudder = \"GpsSelfTest\"",
            "[self_test] report: there is no node \"rudder\"",
        ),
    ] {
        assert!(refusal(from, to).ends_with(why), "{}", refusal(from, to));
    }
}

/// The manifest of boards with a rover's devices, in the UAGV's network, with the signals of its
/// distances.
fn distances(manifest: &str, left: &str, right: &str) -> Result<Vehicle, String> {
    let boards = include_str!("../../../xtask/world/tests/boards_in_row/vehicle.toml");
    let manifest = if manifest.is_empty() {
        boards
    } else {
        manifest
    };
    let text = format!("{manifest}\n[distances]\nleft = {left:?}\nright = {right:?}\n");
    Vehicle::parse("rover", "rover".as_ref(), &text, &text_of("network.dbc"))
        .map_err(|error| error.to_string())
}

#[test]
fn the_signals_of_distances_are_lengths_of_a_rover() {
    let vehicle = distances("", "LogPosition.X", "Position.East").unwrap();
    let signals = vehicle.manifest().distances.as_ref().unwrap();
    assert_eq!(signals.left.signal, "X");
    for (left, right, sentence) in [
        (
            "Range.Left",
            "Position.East",
            "distances.left: there is no message \"Range\"",
        ),
        (
            "Position.North",
            "Position.Up",
            "distances.right: message \"Position\" has no signal \"Up\"",
        ),
        (
            "Position.North",
            "Command.SteeringRate",
            "distances.right: the unit of signal \"SteeringRate\" is",
        ),
    ] {
        let refused = distances("", left, right).unwrap_err();
        assert!(refused.contains(sentence), "{refused}");
    }
    let uagv = text_of("vehicle.toml");
    let refused = distances(&uagv, "Position.North", "Position.East").unwrap_err();
    assert!(
        refused.contains("distances: the manifest has no [rover]"),
        "{refused}"
    );
}

/// Asserts what each change of the row follower's manifest, from one text to another, is refused with.
fn assert_row_follower_refused(cases: &[(&str, &str, &str)]) {
    let folder = vehicles().join("row-follower");
    let text = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
    let (manifest, network) = (text("vehicle.toml"), text("network.dbc"));
    for (from, to, sentence) in cases {
        assert!(manifest.contains(from), "{from}");
        let changed = manifest.replacen(from, to, 1);
        let path = Path::new("row-follower");
        let vehicle = Vehicle::parse("row-follower", path, &changed, &network);
        let said = vehicle.unwrap_err().to_string();
        assert!(said.contains(sentence), "{said}");
        assert!(!said.contains('\n'), "{said}");
    }
}

#[test]
fn a_rover_that_makes_no_sense_is_refused_in_one_sentence() {
    assert_row_follower_refused(&[
        (
            "wiring = { servos = \"drive-motors\" }",
            "wiring = {}",
            "[rover] needs drive-motors, which no node has in its wiring",
        ),
        (
            "wiring = { remote = \"pin-remote\" }",
            "wiring = {}",
            "[rover] needs a pin-remote, which no node has in its wiring",
        ),
        (
            "wiring = { distances = \"distance-sensors\" }",
            "wiring = { distances = \"distance-sensors\", pot = \"knob\" }",
            "node \"sensors\": the connectors \"distances\" and \"pot\" use the same converter: \
             one of the two is accepted",
        ),
        (
            "wiring = { distances = \"distance-sensors\" }",
            "wiring = { pot = \"distance-sensors\" }",
            "node \"sensors\", connector \"pot\": distance-sensors go to the connector \
             \"distances\"",
        ),
        (
            "cruise = \"0.4 m/s\"",
            "cruise = \"1.2 m/s\"",
            "rover.cruise is 1.2 m/s: above 0 to 1 m/s is accepted",
        ),
        (
            "angle = \"45 deg\"",
            "angle = \"95 deg\"",
            "rover.sensors.angle is 95 deg: 10 deg to 90 deg is accepted",
        ),
        (
            "open = \"2.25 m\"",
            "open = \"3 m\"",
            "rover.sensors.open is 3 m: 0.22 m to 2.5 m is accepted",
        ),
        (
            "width = \"76.2 cm\"",
            "width = \"30 cm\"",
            "rover.rows.width is 0.3 m: 0.5298 m to 5 m is accepted: rover.width, 0.3048 m, \
             rover.rows.stalk, 0.025 m, and 0.1 m of room on either side",
        ),
        (
            "width = \"76.2 cm\"",
            "width = \"3 m\"",
            "rover.rows.width is 3 m: with rover.sensors.beside and angle the rows are 2.336 m away along \
             the beams, but more than 0.22 m (rover.sensors.least) and less than 2.25 m (open) is accepted",
        ),
        (
            "law = \"furrow\"",
            "law = \"best\"",
            "unknown variant `best`, expected `furrow` or `thesis`",
        ),
        (
            "width = \"76.2 cm\"",
            "width = \"52.9 cm\"",
            "rover.rows.width is 0.529 m: 0.5298 m to 5 m is accepted",
        ),
        (
            "message = \"Command\"",
            "message = \"RowLog\"",
            "command.message: message \"RowLog\" has no signal \"Counter\" in its byte 6: a message \
             of 8 bytes with the signals \"Counter\" and \"Check\" in its last two is accepted",
        ),
        (
            "tolerance = \"4 cm\"",
            "tolerance = \"90 cm\"",
            "rover: the tolerance of the width is not a positive number below half the width",
        ),
    ]);
}

#[test]
fn numbers_of_the_thesis_s_law_are_those_of_the_firmware() {
    assert_row_follower_refused(&[
        (
            "[rover.motors]",
            "[rover.thesis]\nproportional = -1.0\n\n[rover.motors]",
            "rover.thesis.proportional is -1.0: 1e-6 to 1.0 is accepted",
        ),
        (
            "[rover.motors]",
            "[rover.thesis]\nprocess = 1e300\n\n[rover.motors]",
            "rover.thesis.process is 1e300: 1e-6 to 100.0 is accepted",
        ),
        (
            "[rover.motors]",
            "[rover.thesis]\nintegral = 1e-50\n\n[rover.motors]",
            "rover.thesis.integral is 1e-50: 1e-6 to 1.0 and 0 are accepted",
        ),
        (
            "[rover.motors]",
            "[rover.thesis]\nleast = \"80 cm\"\nmost = \"80 cm\"\n\n[rover.motors]",
            "rover.thesis.most is 0.8 m: 0.81 m to 1.5 m is accepted",
        ),
        (
            "[rover.motors]",
            "[rover.thesis]\neffort = \"0.1 %\"\n\n[rover.motors]",
            "rover.thesis.effort is 0.1 %: 0.2 % to 100 % is accepted",
        ),
    ]);
}

/// `two-boards` with this text at the end of its manifest.
fn two_boards(more: &str) -> Result<Vehicle, String> {
    let folder = vehicles().join("two-boards");
    let text = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
    let manifest = text("vehicle.toml") + more;
    Vehicle::parse(
        "boards",
        Path::new("boards"),
        &manifest,
        &text("network.dbc"),
    )
    .map_err(|error| error.to_string())
}

#[test]
fn a_vehicle_is_time_triggered_unless_its_manifest_says_otherwise() {
    assert_eq!(two_boards("").unwrap().protocol(), Protocol::TimeTriggered);
    let event = two_boards("[bus]\nprotocol = \"event-triggered\"\n").unwrap();
    assert!(event.is_event_triggered() && event.overrides().is_empty());
    let wrong = two_boards("[bus]\nprotocol = \"both\"\n").unwrap_err();
    assert!(
        wrong.contains("bus.protocol: unknown variant `both`")
            && wrong.contains("`time-triggered`")
            && wrong.contains("`event-triggered`"),
        "{wrong}"
    );
    assert!(!wrong.contains('\n'));
}

/// `two-boards` with these values in place of its manifest's.
fn two_boards_with(overrides: &str) -> Result<Vehicle, String> {
    let folder = vehicles().join("two-boards");
    let text = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
    let (manifest, network) = (text("vehicle.toml"), text("network.dbc"));
    let overrides = Overrides::parse(overrides)?;
    Vehicle::parse_with(
        "boards",
        Path::new("boards"),
        &manifest,
        &network,
        &overrides,
    )
    .map_err(|error| error.to_string())
}

#[test]
fn another_value_than_the_manifests_is_noted() {
    let event = two_boards_with("bus.protocol=event-triggered").unwrap();
    assert!(event.is_event_triggered());
    assert_eq!(
        event.overrides().to_string(),
        "bus.protocol=event-triggered"
    );
    let named = Overrides::default().on(Protocol::EventTriggered);
    assert_eq!(event.overrides(), &named);
    // The manifest has no table of the bus, but that is its protocol.
    let same = two_boards_with("bus.protocol=time-triggered").unwrap();
    assert!(same.overrides().is_empty() && !same.is_event_triggered());
}

#[test]
fn a_value_is_read_as_the_manifest_has_it() {
    let rover = |overrides: &str| {
        let overrides = Overrides::parse(overrides).unwrap();
        let vehicle = Vehicle::find_with(&vehicles(), "row-follower", &overrides);
        vehicle.map(|vehicle| *vehicle.manifest().rover.as_ref().unwrap())
    };
    let own = rover("").unwrap();
    let fast = rover("rover.cruise=0.8;rover.law=thesis;rover.thesis.integral=0.5").unwrap();
    assert_eq!((own.cruise.get(), own.law), (0.4, Law::Furrow));
    assert_eq!((fast.cruise.get(), fast.law), (0.8, Law::Thesis));
    assert_eq!(fast.thesis.integral, 0.5);
    let (units, quoted) = (
        rover("rover.cruise = 800 mm/s"),
        rover("rover.cruise=\"0.8 m/s\""),
    );
    assert_eq!(units.unwrap().cruise.get(), 0.8);
    assert_eq!(quoted.unwrap().cruise.get(), 0.8);
    let board = two_boards_with("node.1.board=f303").unwrap();
    assert_eq!(board.node(NodeIndex(1)).board, "f303");
}

#[test]
fn a_value_that_makes_no_sense_gets_one_sentence() {
    for (overrides, sentence) in [
        (
            "bus.protocol=both",
            "boards/vehicle.toml: with bus.protocol=both: bus.protocol: unknown variant `both`",
        ),
        (
            "bus.way=x",
            "boards/vehicle.toml: with bus.way=x: bus.way: unknown field `way`",
        ),
        ("summary.of.it=1", "summary.of.it=1: summary is no table"),
        (
            "node.7.board=f303",
            "node has no entry 7: it has 2, counted from 0",
        ),
        ("node.first.board=f303", "node has no entry first"),
        ("node.0.board=f407", "with node.0.board=f407: "),
        ("summary", "it has no ="),
        ("a b=1", "\"a b\" is no key"),
        ("summary=", "it has no value"),
        (
            "bus.protocol=time-triggered;bus.protocol=event-triggered",
            "bus.protocol is given twice, as time-triggered and as event-triggered: one value of a \
             key is accepted",
        ),
        (
            "row_guidance.enabled=true",
            "boards/vehicle.toml: with row_guidance.enabled=true: the manifest has no \
             [row_guidance], so no value of it can be set",
        ),
        (
            "rover.sensors.angle=45 deg",
            "with rover.sensors.angle=45 deg: the manifest has no [rover], so no value of it can \
             be set",
        ),
    ] {
        let error = two_boards_with(overrides).unwrap_err();
        assert!(error.contains(sentence), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn each_set_of_values_has_a_folder_name_of_its_own() {
    let name = |text: &str| Overrides::parse(text).unwrap().folder_name();
    assert_eq!(
        name("rover.law=thesis;rover.cruise=0.8"),
        "rover.cruise=0.8,rover.law=thesis"
    );
    let (slash, blank) = (name("rover.cruise=1 m/s"), name("rover.cruise=1/m s"));
    assert!(slash.starts_with("rover.cruise=1-m-s+"), "{slash}");
    assert_ne!(slash, blank);
    let long = |end: &str| name(&format!("summary={}{end}", "x".repeat(300)));
    assert!(long("a").len() < 120 && long("a") != long("b"));
}

proptest! {
    #[test]
    fn overrides_come_back_from_the_environment(
        all in proptest::collection::vec(("[a-z_]{1,8}(\\.[a-z0-9_-]{1,8}){0,3}", "[^;\\p{C}]{1,20}"), 0..5),
    ) {
        let all: Vec<_> = all.iter().filter(|(_, value)| !value.trim().is_empty()).collect();
        let all: Vec<_> = all
            .iter()
            .map(|(key, value)| Override::parse(&format!("{key}={value}")).unwrap())
            .collect();
        // Keys in random order are seldom alike.
        if let Ok(overrides) = Overrides::each_once(all) {
            prop_assert_eq!(Overrides::parse(&overrides.environment()).unwrap(), overrides);
        }
    }
}

#[test]
fn what_needs_the_schedule_is_refused_without_it() {
    let refused = "vehicle.toml: bus.protocol is \"event-triggered\": \"time-triggered\" is \
                   accepted, as ";
    assert_eq!(
        refusal(
            "[safety]",
            "[bus]\nprotocol = \"event-triggered\"\n\n[safety]"
        ),
        format!("uagv/{refused}the commands to a [machine] carry the time of their basic cycle")
    );
    let event = "[bus]\nprotocol = \"event-triggered\"\n";
    let receiver = "[receiver]\nlatency = \"50 ms\"\nburst = \"4 ms\"\nperiod = \"100 ms\"\n\
                    lead = \"5 ms\"\n";
    assert_eq!(
        two_boards(&format!("{event}{receiver}")).unwrap_err(),
        format!("boards/{refused}a [receiver] sets the time of the schedule")
    );
    let backup = "[safety]\nbackup_master = \"drive\"\n";
    assert_eq!(
        two_boards(&format!("{event}{backup}")).unwrap_err(),
        format!(
            "boards/{refused}safety.backup_master is \"drive\", and without a schedule there is \
             no time master"
        )
    );
}

#[test]
fn a_protocol_is_found_by_its_name() {
    for protocol in Protocol::ALL {
        assert_eq!(Protocol::named(protocol.name()), Ok(protocol));
    }
    assert_eq!(
        Protocol::named("both"),
        Err("time-triggered and event-triggered are accepted".to_owned())
    );
}

/// The UAGV with these values in place of its manifest's.
fn uagv_with(overrides: &str) -> Result<Vehicle, String> {
    let overrides = Overrides::parse(overrides)?;
    Vehicle::find_with(&vehicles(), "uagv", &overrides).map_err(|error| error.to_string())
}

#[test]
fn the_node_of_the_rows_is_there_only_while_they_may_guide() {
    let names = |vehicle: &Vehicle| {
        let nodes = vehicle.manifest().nodes.iter();
        nodes.map(|node| node.name.clone()).collect::<Vec<_>>()
    };
    let off = uagv_with("").unwrap();
    assert_eq!(names(&off), ["gps", "controller", "steering", "drive"]);
    assert!(off.network().message(207).is_none());
    assert!(off.network_supplements().is_empty() && off.task_supplements().is_empty());
    assert_eq!(off.node_of(Device::DistanceSensors), None);
    let on = uagv_with("row_guidance.enabled=true").unwrap();
    assert_eq!(names(&on).last().map(String::as_str), Some("rows"));
    assert_eq!(on.network().message(207).unwrap().sender, "rows");
    assert_eq!(on.node_of(Device::DistanceSensors), on.find_node("rows"));
    assert!(on.task_supplements()[0].is_file());
    let report = &on.manifest().self_test.as_ref().unwrap().report;
    assert_eq!(report.get("rows").map(String::as_str), Some("RowsSelfTest"));
}

#[test]
fn the_bus_guardian_is_there_only_while_it_is_on() {
    let off = uagv_with("").unwrap();
    assert!(off.guardian().is_none() && off.guarded().is_empty());
    assert_eq!(off.participants().count(), off.nodes().len());
    for (set, nodes) in [
        ("guardian.enabled=true", 5),
        ("guardian.enabled=true;row_guidance.enabled=true", 6),
    ] {
        let on = uagv_with(set).unwrap();
        assert_eq!(on.nodes().len(), nodes);
        let guardian = on.find_node("guardian");
        assert_eq!(on.guardian(), guardian);
        assert_eq!(guardian, on.nodes().last());
        assert!(on.participants().all(|node| Some(node) != guardian));
        assert_eq!(on.participants().count(), nodes - 1);
        let guarded = on.guarded().into_iter();
        let guarded: Vec<_> = guarded.map(|node| on.node(node).name.as_str()).collect();
        assert_eq!(guarded, ["gps", "controller", "steering", "drive"]);
        assert!(on.task_supplements().iter().all(|table| table.is_file()));
        // It cannot send: no message is its own, and the network does not know it.
        let mut messages = on.network().messages.iter();
        assert!(messages.all(|message| message.sender != "guardian"));
        assert!(
            on.network()
                .nodes
                .iter()
                .all(|node| node.name != "guardian")
        );
    }
}

#[test]
fn a_bus_guardian_that_makes_no_sense_is_refused_in_one_sentence() {
    for (overrides, sentence) in [
        ("guardian.enabled=perhaps", "guardian.enabled"),
        (
            "guardian.node.board=f303",
            "guardian.guards has 4 nodes, but the board f303 has 1 tap: a node for each tap is accepted",
        ),
        (
            "guardian.node.board=f303;guardian.guards=[\"gps\"]",
            "guardian.guards has \"gps\", a potential master, but a guardian on the board f303 sees no other line than \
             the guarded one: steering or drive is accepted",
        ),
        (
            "guardian.node.board=f303;guardian.guards=[\"guardian\"]",
            "guardian.guards: there is no node \"guardian\" to guard: steering or drive is accepted",
        ),
        (
            "guardian.node.board=f303;guardian.guards=[\"tester\"]",
            "guardian.guards: there is no node \"tester\" to guard: steering or drive is accepted",
        ),
        (
            "guardian.node.name=drive",
            "guardian.guards: there is no node \"drive\" to guard",
        ),
        (
            "guardian.node.name=logger",
            "guardian.node.name is \"logger\": a name that the network file does not have is accepted",
        ),
        (
            "guardian.enabled=true;guardian.node.name=watchman",
            "watchman",
        ),
        (
            "guardian.node.wiring.display=lk204-7t-1u",
            "guardian.node.wiring has \"display\"",
        ),
    ] {
        let error = uagv_with(overrides).unwrap_err();
        assert!(error.contains(sentence), "{overrides}: {error}");
        assert!(!error.contains('\n'), "{error}");
    }
    for (guards, sentence) in [
        (
            "[\"gps\", \"drive\"]",
            "guardian.guards has 2 nodes, but the board f446 has 4 taps: a node for each tap is accepted",
        ),
        (
            "[\"gps\", \"controller\", \"drive\", \"drive\"]",
            "guardian.guards: node \"drive\" stands twice",
        ),
        (
            "[\"gps\", \"controller\", \"drive\", \"plough\"]",
            "guardian.guards: there is no node \"plough\" to guard: gps or controller or steering or drive is accepted",
        ),
    ] {
        let error = refusal(
            "guards = [\"gps\", \"controller\", \"steering\", \"drive\"]",
            &format!("guards = {guards}"),
        );
        assert!(error.contains(sentence), "{guards}: {error}");
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn roll_and_pitch_are_on_the_bus_only_while_they_are_measured() {
    let off = uagv_with("").unwrap();
    assert!(off.network().message(203).is_none());
    let start = |vehicle: &Vehicle, id| vehicle.network().message(id).unwrap().window.start_us;
    assert_eq!(start(&off, 202), 5000);
    let on = uagv_with("tilt.enabled=true").unwrap();
    let message = on.network().message(203).unwrap();
    assert_eq!((message.sender.as_str(), start(&on, 203)), ("gps", 5000));
    assert_eq!(start(&on, 202), 26_000);
    // The control step waits for it.
    let command = on.network().message(300).unwrap();
    assert!(command.after.iter().any(|name| name == "Tilt"));
    assert!(on.task_supplements().iter().all(|table| table.is_file()));
    assert_eq!(on.task_supplements().len(), 1);
    // Besides everything else that may be on.
    for others in ["row_guidance.enabled=true", "planner.enabled=true"] {
        let all = "mission.enabled=true;sessions.enabled=true;tilt.enabled=true";
        uagv_with(&format!("{all};{others}")).unwrap();
    }
}

#[test]
fn roll_and_pitch_that_make_no_sense_are_refused_in_one_sentence() {
    for (overrides, sentence) in [
        (
            "tilt.longest_age=100 ms",
            "tilt.longest_age is 0.1 s: 0.2 s to 5 s is accepted",
        ),
        (
            "tilt.enabled=true;machine.law=thesis",
            "tilt.enabled with machine.law \"thesis\"",
        ),
    ] {
        let error = uagv_with(overrides).unwrap_err();
        assert!(error.contains(sentence), "{overrides}: {error}");
        assert!(!error.contains('\n'), "{error}");
    }
}

/// A turn slower than this would end the run. While missions are off, nobody drives one.
#[test]
fn a_turn_is_fast_enough_to_tell_the_heading() {
    let set = "mission.enabled=true;mission.turn_speed";
    let error = uagv_with(&format!("{set}=0.28 m/s"))
        .unwrap_err()
        .to_string();
    let sentence = "mission.turn_speed is 0.28 m/s: 0.29 m/s or more, where the receiver tells the heading, is accepted";
    assert!(error.ends_with(sentence), "{error}");
    uagv_with(&format!("{set}=0.29 m/s")).unwrap();
    uagv_with("mission.turn_speed=0.28 m/s").unwrap();
}

/// A vehicle without ground, or with its front axle before it, would pass through its fence.
#[test]
fn a_vehicle_covers_the_ground_up_to_its_front_axle() {
    for (overrides, sentence) in [
        (
            "mission.width=0 m",
            "mission.width is 0 m: above 0 to 20 m is accepted",
        ),
        (
            "mission.enabled=true;mission.ahead=0 m",
            "mission.ahead is 0 m: the wheelbase (",
        ),
        (
            "mission.enabled=true;mission.ahead=1 m",
            "mission.ahead is 1 m: the wheelbase (",
        ),
    ] {
        let error = uagv_with(overrides).unwrap_err().to_string();
        assert!(error.contains(sentence), "{overrides}: {error}");
    }
}

#[test]
fn the_message_about_sections_must_be_there_with_its_signals() {
    for (message, sentence) in [
        (
            "Nothing",
            "mission.sections: there is no message \"Nothing\"",
        ),
        (
            "MissionState",
            "mission.sections: \"MissionState\" has no signal \"State1\"",
        ),
    ] {
        let set = format!("mission.enabled=true;mission.sections={message}");
        let error = uagv_with(&set).unwrap_err().to_string();
        assert!(error.ends_with(sentence), "{error}");
        // While missions are off, nobody asks for it.
        uagv_with(&format!("mission.sections={message}")).unwrap();
    }
}

#[test]
fn a_guidance_by_rows_that_makes_no_sense_is_refused_in_one_sentence() {
    for (overrides, sentence) in [
        (
            "row_guidance.speed=1.5 m/s",
            "row_guidance.speed is 1.5 m/s: above 0 to 1 m/s is accepted",
        ),
        (
            "row_guidance.longest_age=100 ms",
            "row_guidance.longest_age is 0.1 s: 0.2 s to 1 s is accepted",
        ),
        (
            "row_guidance.longest_way=0 m",
            "row_guidance.longest_way is 0 m: ",
        ),
        (
            "row_guidance.settle=2 min",
            "row_guidance.settle is 120 s: 0 s to 60 s is accepted",
        ),
        (
            "row_guidance.take_back=1 m/s",
            "row_guidance.take_back is 1 m/s",
        ),
        (
            "row_guidance.rows.width=60 cm",
            "row_guidance.rows.width is 0.6 m: 0.925 m to 5 m is accepted: \
             row_guidance.vehicle_width, 0.7 m, row_guidance.rows.stalk, 0.025 m, and",
        ),
        (
            "row_guidance.rows.width=3 m",
            "the rows are 2.404 m away along the beams, but more than 0.22 m",
        ),
        (
            "row_guidance.sensors.open=3 m",
            "row_guidance.sensors.open is 3 m",
        ),
        (
            "row_guidance.node.wiring.distances=knob",
            "row_guidance.node needs distance-sensors",
        ),
        (
            "row_guidance.enabled=true;row_guidance.guide=RowGuidance.Way",
            "row_guidance.guide: there is no signal RowGuidance.Way with a value table",
        ),
        (
            "row_guidance.enabled=true;row_guidance.self_test=DriveSelfTest",
            "the message \"DriveSelfTest\" is one of node \"drive\"",
        ),
        (
            "row_guidance.enabled=true;row_guidance.node.name=beams",
            "beams.dbc",
        ),
    ] {
        let error = uagv_with(overrides).unwrap_err();
        assert!(error.contains(sentence), "{overrides}: {error}");
        assert!(!error.contains('\n'), "{error}");
    }
}

/// A folder with the UAGV's manifest and network, and a variant with this manifest.
fn with_variant(manifest: &str) -> tempfile::TempDir {
    let vehicles = tempfile::tempdir().unwrap();
    let folder = vehicles.path().join("uagv");
    std::fs::create_dir_all(folder.join("variants/long")).unwrap();
    std::fs::create_dir_all(folder.join("nodes")).unwrap();
    let uagv = Vehicle::find(&self::vehicles(), "uagv").unwrap();
    let files = [uagv.manifest_file(), uagv.network_file()];
    for file in files
        .into_iter()
        .chain(uagv.nodes().map(|node| uagv.source(node)))
    {
        let inside = file.strip_prefix(uagv.folder()).unwrap();
        std::fs::copy(&file, folder.join(inside)).unwrap();
    }
    std::fs::write(folder.join("variants/long/vehicle.toml"), manifest).unwrap();
    vehicles
}

#[test]
fn a_variant_has_its_own_values_and_everything_else_of_the_other_vehicle() {
    let text = "summary = \"long\"\nwithout = [\"machine.weights\", \"row_guidance\"]\n\
                [machine]\nantenna_to_front = \"1.5 m\"\n[[waypoint]]\nnorth = \"0 m\"\neast = \"0 m\"\n\
                [[waypoint]]\nnorth = \"0 m\"\neast = \"50 m\"\n";
    let vehicles = with_variant(text);
    assert_eq!(Vehicle::names(vehicles.path()).unwrap(), ["long", "uagv"]);
    let uagv = Vehicle::find(vehicles.path(), "uagv").unwrap();
    let long = Vehicle::find(vehicles.path(), "long").unwrap();
    assert_eq!((long.name(), long.variant_of()), ("long", Some("uagv")));
    assert_eq!(uagv.variant_of(), None);
    assert_eq!(long.manifest().summary, "long");
    let machine = |vehicle: &Vehicle| vehicle.manifest().machine.clone().unwrap();
    let (own, other) = (machine(&long), machine(&uagv));
    assert!((own.antenna_to_front.get() - 1.5).abs() < 1e-12);
    assert!(own.weights.is_none() && other.weights.is_some());
    assert_eq!(
        (own.limits, own.rear_to_antenna),
        (other.limits, other.rear_to_antenna)
    );
    assert!(long.manifest().row_guidance.is_none());
    assert!((long.manifest().waypoints[1].east.get() - 50.0).abs() < 1e-9);
    assert_eq!(long.nodes().len(), uagv.nodes().len());
    assert_eq!(long.network_file(), uagv.network_file());
    assert_eq!(long.task_table(), uagv.task_table());
    let values = Overrides::parse("machine.cruise=1.5").unwrap();
    let faster = Vehicle::find_with(vehicles.path(), "long", &values).unwrap();
    assert!((machine(&faster).cruise.get() - 1.5).abs() < 1e-12);
    assert!((machine(&faster).antenna_to_front.get() - 1.5).abs() < 1e-12);
}

#[test]
fn a_wrong_variant_is_told_in_one_sentence() {
    let cases = [
        (
            "without = [\"machine.weight\"]",
            "variants/long/vehicle.toml: without: the other vehicle has no \"machine.weight\"",
        ),
        ("without = \"machine\"", "without: a list of keys"),
        (
            "[machine]\nwheelbase = \"2 m\"",
            "variants/long/vehicle.toml: machine.wheelbase: unknown field",
        ),
        (
            "without = [\"machine.weights\"]\n[machine]\ncruise = \"fast\"",
            "variants/long/vehicle.toml: machine.cruise: ",
        ),
        // They were found for another machine.
        (
            "[machine]\ncruise = \"0.9 m/s\"",
            "variants/long/vehicle.toml: machine.cruise: the other vehicle's machine.weights were found for its own: \
             without = [\"machine.weights\"], or weights for this machine, are accepted",
        ),
        (
            "[machine\n",
            "variants/long/vehicle.toml: line 1: this is not TOML",
        ),
        (
            "without = [\"machine.weights\"]\n[machine]\ncruise = \"3 m/s\"",
            "machine.limits.speed, which machine.cruise must not exceed",
        ),
    ];
    for (text, sentence) in cases {
        let vehicles = with_variant(text);
        let said = Vehicle::find(vehicles.path(), "long").unwrap_err();
        let said = said.to_string();
        assert!(said.contains(sentence), "{said}");
        assert!(!said.contains('\n'), "{said}");
    }
    let vehicles = with_variant("summary = \"long\"");
    std::fs::write(vehicles.path().join("uagv/vehicle.toml"), "summary = 1\n").unwrap();
    let said = Vehicle::find(vehicles.path(), "long").unwrap_err();
    let said = said.to_string();
    assert!(said.contains("uagv/vehicle.toml: line 1"), "{said}");

    let twice = with_variant("summary = \"long\"");
    std::fs::create_dir(twice.path().join("long")).unwrap();
    std::fs::write(twice.path().join("long/vehicle.toml"), "").unwrap();
    let said = Vehicle::names(twice.path()).unwrap_err().to_string();
    assert!(
        said.starts_with("two vehicles have the name \"long\""),
        "{said}"
    );
}
