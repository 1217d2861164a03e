use std::{fs, path::PathBuf};

use network_model::{Network, WindowKind};

use super::*;
use crate::cli::Method;

/// A network without any window, and with a comment that looks like attributes.
const UNSCHEDULED: &str = r#"VERSION "1"
NS_ :
	BA_
	BA_DEF_
BS_:
BU_: master slave
BO_ 96 Reference: 1 master
 SG_ CycleCount : 0|6@1+ (1,0) [0|63] "" slave
 SG_ Discontinuity : 6|1@1+ (1,0) [0|1] "" slave
 SG_ NextIsGap : 7|1@1+ (1,0) [0|1] "" slave
BO_ 200 Speed: 8 slave
 SG_ Left : 0|16@1- (1,0) [-100|100] "mm/s" master
BO_ 300 Distance: 4 slave
 SG_ Ahead : 0|16@1- (1,0) [-100|100] "mm" master
BO_ 301 Angle: 4 master
 SG_ Wheel : 0|16@1- (1,0) [-100|100] "" slave
BO_ 600 Alarm: 1 slave
 SG_ Kind : 0|8@1+ (1,0) [0|1] "" master
CM_ BO_ 200 "Not an attribute:
BA_ \"WindowStart\" BO_ 200 77;
VAL_ 1 nor this";
BA_DEF_ "Baudrate" INT 1 1000000;
BA_DEF_ "SyncUncertainty" INT 0 1000;
BA_DEF_ "TransmitEnable" INT 1 16;
BA_DEF_ BU_ "MasterRank" INT -1 7;
BA_DEF_ BO_ "GenMsgSendType" ENUM "Cyclic","Event";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "GenMsgDelayTime" INT 0 65535;
BA_DEF_DEF_ "Baudrate" 250000;
BA_DEF_DEF_ "SyncUncertainty" 20;
BA_DEF_DEF_ "TransmitEnable" 16;
BA_DEF_DEF_ "MasterRank" -1;
BA_DEF_DEF_ "GenMsgSendType" "Cyclic";
BA_DEF_DEF_ "GenMsgCycleTime" 20;
BA_DEF_DEF_ "GenMsgDelayTime" 100;
BA_ "MasterRank" BU_ master 0;
BA_ "GenMsgCycleTime" BO_ 300 50;
BA_ "GenMsgCycleTime" BO_ 301 100;
BA_ "GenMsgSendType" BO_ 600 1;
VAL_ 600 Kind 1 "Fire" 0 "Water" ;
"#;

fn workspace() -> Workspace {
    Workspace::find().unwrap()
}

fn options(method: Option<Method>) -> Schedule {
    Schedule {
        file: Some(PathBuf::from("test.dbc")),
        vehicle: String::from("uagv"),
        set: Vec::new(),
        method,
        write: false,
        json: false,
        arbitrating: None,
        free: 0,
        grain: 1,
        longest_cycle: None,
    }
}

fn unscheduled() -> String {
    UNSCHEDULED.replace(
        "VAL_ 600 Kind 1 \"Fire\"",
        "VAL_TABLE_ Kind 1 \"Fire\" 0 \"Water\" ;\nVAL_ 600 Kind 1 \"Fire\"",
    )
}

fn vehicle() -> String {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../firmware/vehicles/uagv/network.dbc"
    );
    fs::read_to_string(path).unwrap()
}

fn refusal(text: &str, options: &Schedule) -> String {
    match schedule(text, options) {
        Ok(_) => panic!("there is a schedule"),
        Err(what) => what,
    }
}

#[test]
fn the_vehicles_own_matrix_stays_as_it_is() {
    let text = vehicle();
    let own = schedule(&text, &options(None)).unwrap();
    assert_eq!(own.text, text);
    assert_eq!(Assignment::of(&own.network).write(&text), text);
    let table = table::text(&own.network, &own.notes);
    for row in [
        "  1000 us   2000 us  X       gps         401 Latitude, every 100 ms",
        " 12000 us  18000 us  A       controller  501 ModeChange",
        "time masters by rank: gps, controller",
        "R reference 1.0 %, X exclusive 12.0 %, A arbitrating 6.0 %, free 81.0 % of all time",
    ] {
        assert!(table.contains(row), "`{row}` is not in\n{table}");
    }
}

#[test]
fn the_file_is_left_alone_unless_its_schedule_changes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("uagv.dbc");
    fs::write(&path, vehicle()).unwrap();
    let mut options = options(None);
    options.file = Some(path.clone());
    options.write = true;
    run(&workspace(), &options).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), vehicle());

    options.method = Some(Method::PowerOfTwo);
    run(&workspace(), &options).unwrap();
    let written = fs::read_to_string(&path).unwrap();
    assert_ne!(written, vehicle());
    let expected = schedule(&vehicle(), &options).unwrap();
    assert_eq!(written, expected.text);
    assert_eq!(Network::parse(&written).unwrap(), expected.network);
    // A second run changes nothing.
    run(&workspace(), &options).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), written);
}

#[test]
fn the_power_of_two_method_keeps_the_vehicles_basic_cycle() {
    let planned = schedule(&vehicle(), &options(Some(Method::PowerOfTwo))).unwrap();
    assert_eq!(planned.network.basic_cycle_us, 100_000);
    assert_eq!(planned.network.basic_cycles, 1);
    let share = plan::share(&planned.network, WindowKind::Arbitrating);
    assert!((58.0..62.0).contains(&share), "{share}");
    let exclusive = |network: &Network| {
        let messages = network.messages.iter();
        messages
            .filter(|message| message.window.kind == WindowKind::Exclusive)
            .count()
    };
    assert_eq!(exclusive(&planned.network), 12);
}

/// The command follows the sensors late enough for the control step, so that the vehicle can drive
/// with the new matrix.
#[test]
fn both_methods_keep_the_command_behind_the_sensors() {
    for method in [Method::PowerOfTwo, Method::LeastJitter] {
        let planned = schedule(&vehicle(), &options(Some(method))).unwrap();
        // Reading the written file back fails if the command comes too early.
        let network = Network::parse(&planned.text).unwrap();
        let mut messages = network.messages.iter();
        let command = messages.find(|message| message.name == "Command").unwrap();
        assert_eq!(command.after, ["Position", "Velocity", "SteeringPot"]);
        let release = network.release_us(command).unwrap();
        assert!(release + command.preparation_us <= command.window.start_us);
    }
}

#[test]
fn a_network_without_windows_gets_them() {
    let text = unscheduled();
    let own = refusal(&text, &options(None));
    assert!(own.contains("Reference (96) has no window"), "{own}");
    assert!(own.contains("--method power-of-two"), "{own}");

    let power = schedule(&text, &options(Some(Method::PowerOfTwo))).unwrap();
    let periods: Vec<_> = power
        .notes
        .iter()
        .map(|note| (note.id, note.wanted_ms, note.jitter_us))
        .collect();
    assert_eq!(periods, [(200, 20, 0), (300, 50, 0), (301, 100, 0)]);
    let network = &power.network;
    assert_eq!((network.basic_cycle_us, network.basic_cycles), (20_000, 4));
    let every = |id: u16| network.message(id).unwrap().window.repeat;
    assert_eq!((every(200), every(300), every(301)), (1, 2, 4));
    let table = table::text(network, &power.notes);
    assert!(table.contains("every 40 ms instead of 50 ms"), "{table}");

    let least = schedule(&text, &options(Some(Method::LeastJitter))).unwrap();
    let matrix = u32::from(least.network.basic_cycles) * least.network.basic_cycle_us;
    assert_eq!(matrix % 100_000, 0);
    for note in &least.notes {
        assert_eq!(note.jitter_us, 0, "{}", note.id);
    }
    // A period that is not another one times a power of two needs several windows.
    assert!(least.text.contains("FurtherWindows"), "{}", least.text);
}

#[test]
fn what_does_not_change_stays_byte_for_byte() {
    for end in ["\n", "\r\n"] {
        let text = unscheduled().replace('\n', end);
        for method in [Method::PowerOfTwo, Method::LeastJitter] {
            let planned = schedule(&text, &options(Some(method))).unwrap();
            // Only whole lines are added, and only the lines of changed periods are removed.
            let mut old = text.split_inclusive('\n').peekable();
            for line in planned.text.split_inclusive('\n') {
                assert!(line.ends_with(end), "{line:?}");
                if old.peek() == Some(&line) {
                    old.next();
                    continue;
                }
                assert!(line.starts_with("BA_"), "{line:?}");
                // A changed line differs from its old version only in its value.
                let attribute = |line: &str| line.rsplit_once(' ').map(|(of, _)| of.to_owned());
                if old.peek().and_then(|old| attribute(old)) == attribute(line) {
                    old.next();
                }
            }
            assert_eq!(old.next(), None);
        }
    }
}

#[test]
fn the_message_that_makes_a_set_infeasible_is_named() {
    let text = unscheduled();
    let hasty = text.replace(
        "BA_ \"GenMsgCycleTime\" BO_ 301 100;",
        "BA_ \"GenMsgCycleTime\" BO_ 301 1;",
    );
    for method in [Method::PowerOfTwo, Method::LeastJitter] {
        let said = refusal(&hasty, &options(Some(method)));
        assert!(said.contains('`'), "{said}");
    }
    // Two windows and the reference do not fit into 1 ms.
    let said = refusal(&hasty, &options(Some(Method::PowerOfTwo)));
    assert!(said.contains("finds no room among the others"), "{said}");

    let late = text.replace(
        "BA_ \"GenMsgCycleTime\" BO_ 301 100;",
        "BA_ \"GenMsgCycleTime\" BO_ 301 100;\nBA_ \"Deadline\" BO_ 301 300;",
    );
    let said = refusal(&late, &options(Some(Method::PowerOfTwo)));
    assert!(said.contains("`Angle` needs a window of"), "{said}");

    let odd = text.replace("BO_ 301 100;", "BO_ 301 64999;");
    let said = refusal(&odd, &options(Some(Method::LeastJitter)));
    assert!(said.contains("the period of message `"), "{said}");
}

#[test]
fn shares_that_cannot_be_had_are_said() {
    let text = unscheduled();
    let mut options = options(Some(Method::PowerOfTwo));
    options.free = 999;
    assert!(refusal(&text, &options).contains("per mille of the time is left free"));
    options.free = 0;
    options.arbitrating = Some(990);
    assert!(refusal(&text, &options).contains("left for arbitrating windows"));
    options.arbitrating = Some(0);
    assert!(refusal(&text, &options).contains("need an arbitrating window"));
    options.arbitrating = Some(300);
    let planned = schedule(&text, &options).unwrap();
    assert!(plan::share(&planned.network, WindowKind::Arbitrating) >= 300.0);
}

#[test]
fn the_protocols_own_rules_hold_for_a_files_windows() {
    // The check of the network file ignores that a backup's reference may be early.
    let text = vehicle().replace(
        "BA_ \"WindowStart\" BO_ 453 11000;",
        "BA_ \"WindowStart\" BO_ 453 99000;",
    );
    let said = refusal(&text, &options(None));
    assert!(said.contains("LogControl"), "{said}");
    assert!(said.contains("next reference message may begin"), "{said}");
}

/// The analysis must not ask for more than the search gives.
#[test]
fn a_found_window_holds_its_frame() {
    for text in [vehicle(), unscheduled()] {
        for method in [Method::PowerOfTwo, Method::LeastJitter] {
            let planned = schedule(&text, &options(Some(method))).unwrap();
            let reports = schedulability::bus::messages(
                &planned.network,
                BusTable::default().errors(),
                &BTreeSet::new(),
                &schedulability::bus::Reactions::new(),
            );
            for report in reports.iter().filter(|report| !report.arbitrating) {
                assert_eq!(report.miss(), None);
            }
        }
    }
    let planned = schedule(&unscheduled(), &options(Some(Method::LeastJitter))).unwrap();
    let mut network = planned.network;
    let holds = "`cargo xtask schedulability` shows whether every deadline holds with it.";
    assert_eq!(verdict(&network), holds);
    for message in &mut network.messages {
        message.window.length_us = message.window.length_us.min(300);
    }
    let refused = "`cargo xtask schedulability` will refuse it: message ";
    assert!(
        verdict(&network).starts_with(refused),
        "{}",
        verdict(&network)
    );
}

/// A vehicle whose new message has no window yet.
#[test]
fn a_vehicle_without_a_window_gets_it() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("firmware/vehicles/uagv");
    fs::create_dir_all(&folder).unwrap();
    let own = crate::vehicle::find(&self::workspace(), "uagv").unwrap();
    fs::copy(own.manifest_file(), folder.join("vehicle.toml")).unwrap();
    let path = folder.join("network.dbc");
    fs::write(&path, unscheduled()).unwrap();
    let workspace = Workspace::at(root.path());
    let mut options = options(Some(Method::LeastJitter));
    options.file = None;
    options.write = true;
    run(&workspace, &options).unwrap();
    Network::parse(&fs::read_to_string(&path).unwrap()).unwrap();
    options.vehicle = "harvester".into();
    let said = run(&workspace, &options).unwrap_err().to_string();
    assert!(said.contains("there is no vehicle \"harvester\""), "{said}");
}

/// A node that a value of the manifest switches on has its messages in a file of its own.
#[test]
fn the_messages_of_a_switched_on_node_are_in_the_matrix() {
    let mut options = options(None);
    options.file = None;
    let names = |options: &Schedule| {
        let input = input(&workspace(), options).unwrap();
        let network = schedule(&input.text, options).unwrap().network;
        let names = network.messages.iter().map(|message| message.name.clone());
        names.collect::<Vec<_>>()
    };
    let without = names(&options);
    assert!(!without.contains(&"RowOffset".into()));
    options.set = vec![vehicle_model::Override::parse("row_guidance.enabled=true").unwrap()];
    let mut with = names(&options);
    assert_eq!(with.len(), without.len() + 4);
    with.retain(|name| !without.contains(name));
    with.sort();
    assert_eq!(
        with,
        ["RowGuidance", "RowOffset", "RowsSelfTest", "RowsStatus"]
    );
    // Other windows are found for all of them, but not written into one of the two files.
    options.method = Some(Method::LeastJitter);
    assert_eq!(names(&options).len(), without.len() + 4);
    options.write = true;
    let failure = run(&workspace(), &options).unwrap_err();
    assert_eq!(failure.exit_code(), 2);
    let said = failure.to_string();
    assert!(
        said.contains("network.dbc") && said.contains("rows.dbc"),
        "{said}"
    );
}

#[test]
fn a_bad_file_is_one_sentence_and_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.dbc");
    let mut options = options(Some(Method::PowerOfTwo));
    options.file = Some(path.clone());
    options.write = true;
    for text in [
        "",
        "nonsense",
        &vehicle().replace("BO_ 300 Command: 8", "BO_ 300 Command: 2"),
    ] {
        fs::write(&path, text).unwrap();
        let failure = run(&workspace(), &options).unwrap_err();
        assert_eq!(failure.exit_code(), 2);
        let said = failure.to_string();
        assert!(said.contains("bad.dbc") && !said.contains('\n'), "{said}");
        assert_eq!(fs::read_to_string(&path).unwrap(), text);
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}
