//! The walks of `firmware/PORTING.md`: each is applied to a copy of a vehicle, built for the
//! boards and run on the virtual vehicle.
//!
//! The copies stand in a workspace of their own below cargo's target folder. It stays there,
//! and files are written only when they change: a second run builds nothing anew.

use std::{
    collections::BTreeMap,
    ffi::OsString,
    fs,
    path::{Path, PathBuf},
    sync::{Mutex, OnceLock, PoisonError},
};

use campaign::traffic::{Sent, Traffic};
use control::controller::Settings;
use schedulability::table::Table;
use twin::{Options, Outcome};
use vehicle_model::{NodeIndex, Vehicle};
use world::{Scenario, time::from_seconds};
use xtask::{Failure, Workspace, build, cli, experiment, new, vehicle};

/// The folder of a copy, as the walks change it.
struct Folder {
    path: PathBuf,
}

impl Folder {
    fn text(&self, file: &str) -> String {
        let path = self.path.join(file);
        fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    fn write(&self, file: &str, text: &str) {
        fs::write(self.path.join(file), text).unwrap();
    }

    /// Replaces one place of a file, which must be there.
    fn replace(&self, file: &str, from: &str, to: &str) {
        let text = self.text(file);
        assert!(text.contains(from), "{file}: {from}");
        self.write(file, &text.replacen(from, to, 1));
    }

    /// Inserts lines in front of a place, which stays.
    fn before(&self, file: &str, place: &str, lines: &str) {
        self.replace(file, place, &format!("{lines}{place}"));
    }
}

/// Longer, the antenna further ahead. Without weights, which were found for another machine.
fn wheelbase(folder: &Folder) {
    let manifest = "vehicle.toml";
    folder.replace(
        manifest,
        "rear_to_antenna = \"0.255 m\"",
        "rear_to_antenna = \"0.4 m\"",
    );
    folder.replace(
        manifest,
        "antenna_to_front = \"0.845 m\"",
        "antenna_to_front = \"1.3 m\"",
    );
    let text = folder.text(manifest);
    let (before, weights) = text.split_once("[machine.weights.firm]").unwrap();
    let (_, after) = weights.split_once("[receiver]").unwrap();
    folder.write(manifest, &format!("{before}[receiver]{after}"));
}

/// Other limits, another steering actuator, and motor drivers that turn the other way.
fn actuator(folder: &Folder) {
    let manifest = "vehicle.toml";
    for (from, to) in [
        (
            "steering_rate = \"25 deg/s\"",
            "steering_rate = \"18 deg/s\"",
        ),
        (
            "dead_band = \"10 %\"\nfull_rate = \"25 deg/s\"",
            "dead_band = \"6 %\"\nfull_rate = \"32 deg/s\"",
        ),
        (
            "dead_band = \"12 %\"\nfull_rate = \"25 deg/s\"",
            "dead_band = \"8 %\"\nfull_rate = \"30 deg/s\"",
        ),
        (
            "full_byte_is_forward = true",
            "full_byte_is_forward = false",
        ),
    ] {
        folder.replace(manifest, from, to);
    }
}

/// Wider rows of thicker stalks, a larger and faster robot, and sensors that look more to the side.
fn rows(folder: &Folder) {
    let manifest = "vehicle.toml";
    for (from, to) in [
        ("length = \"0.4572 m\"", "length = \"0.6 m\""),
        ("width = \"0.3048 m\"", "width = \"0.4 m\""),
        ("track = \"0.25 m\"", "track = \"0.33 m\""),
        ("turning_track = \"0.38 m\"", "turning_track = \"0.5 m\""),
        ("cruise = \"0.4 m/s\"", "cruise = \"0.6 m/s\""),
        ("ahead = \"0.2546 m\"", "ahead = \"0.3 m\""),
        ("beside = \"0.152 m\"", "beside = \"0.18 m\""),
        ("angle = \"45 deg\"", "angle = \"60 deg\""),
        ("width = \"76.2 cm\"", "width = \"95 cm\""),
        ("stalk = \"2.5 cm\"", "stalk = \"4 cm\""),
    ] {
        folder.replace(manifest, from, to);
    }
}

/// The motor's node tells what it does, and the master shows it on its console.
fn message(folder: &Folder) {
    let network = "network.dbc";
    folder.before(
        network,
        "BO_ 511 ",
        "BO_ 400 Effort: 1 motor\n SG_ Byte : 0|8@1+ (1,0) [0|255] \"\" master,logger\n\n",
    );
    folder.before(
        network,
        "CM_ BO_ 511 ",
        "CM_ BO_ 400 \"What the motor does.\";\n",
    );
    folder.before(
        network,
        "BA_ \"GenMsgSendType\" BO_ 511 1;",
        "BA_ \"GenMsgCycleTime\" BO_ 400 20;\n\
         BA_ \"WindowKind\" BO_ 400 2;\n\
         BA_ \"WindowStart\" BO_ 400 11000;\n\
         BA_ \"WindowLength\" BO_ 400 1000;\n",
    );
    let sender = "nodes/motor.rs";
    folder.replace(sender, "{AdcCount, Knob,", "{AdcCount, Effort, Knob,");
    folder.replace(
        sender,
        "            output.set(circuit.byte(obeyed.command(), now));\n            accepted\n",
        "            output.set(circuit.byte(obeyed.command(), now));\n            \
         (accepted, output.last())\n",
    );
    folder.replace(
        sender,
        "let accepted = (cx.shared",
        "let (accepted, byte) = (cx.shared",
    );
    folder.before(
        sender,
        "        if accepted {\n            link.lock(|link| link.release_in(COMMAND_TIMEOUT));",
        "        let data = padded(Effort { byte }.encode());\n        \
         link.lock(|link| link.put(window::EFFORT, data));\n",
    );
    let receiver = "nodes/master.rs";
    folder.replace(receiver, "messages::{Knob,", "messages::{Effort, Knob,");
    folder.before(
        receiver,
        "        let (knob, commands) = cx",
        "        let effort = cx.shared.link.lock(|link| link.message::<Effort>(window::EFFORT));\n",
    );
    folder.replace(
        receiver,
        ".unsigned(commands).str(\"\\r\\n\");",
        ".unsigned(commands);\n                \
         if let Some(Effort { byte }) = effort {\n                    \
         line.str(\" motor \").unsigned(u32::from(byte));\n                }\n                \
         line.str(\"\\r\\n\");",
    );
}

/// The status and the self-test of a second motor's node in the network file.
fn follower_messages(folder: &Folder) {
    let network = "network.dbc";
    folder.replace(network, "BU_: master motor", "BU_: master motor follower");
    let mut text = folder.text(network);
    let copy = |of: &str, to: &str| {
        let message = text.split_once(of).unwrap().1;
        let message = message.split("\n\n").next().unwrap();
        format!("{to}{message}\n\n")
            .replace("MotorStatus: 8 motor", "FollowerStatus: 8 follower")
            .replace("MotorSelfTest: 8 motor", "FollowerSelfTest: 8 follower")
    };
    let status = copy("BO_ 512 ", "BO_ 513 ") + &copy("BO_ 522 ", "BO_ 523 ");
    text = text.replace("motor,logger", "motor,follower,logger");
    text = text.replacen("CM_ \"Two boards", &format!("{status}CM_ \"Two boards"), 1);
    let lines: Vec<String> = text
        .lines()
        .flat_map(|line| {
            let attribute = !line.starts_with("BO_");
            let copy =
                (attribute && (line.contains(" 512 ") || line.contains(" 522 "))).then(|| {
                    line.replacen(" 512 ", " 513 ", 1)
                        .replacen(" 522 ", " 523 ", 1)
                        .replacen("\"MotorStatus\"", "\"FollowerStatus\"", 1)
                });
            [Some(line.to_owned()), copy]
        })
        .flatten()
        .collect();
    folder.write(network, &format!("{}\n", lines.join("\n")));
}

/// A second motor's node, which obeys the same command.
fn node(folder: &Folder) {
    follower_messages(folder);
    folder.replace(
        "vehicle.toml",
        "motor = \"MotorSelfTest\"\n",
        "motor = \"MotorSelfTest\"\nfollower = \"FollowerSelfTest\"\n",
    );
    let manifest = folder.text("vehicle.toml");
    folder.write(
        "vehicle.toml",
        &format!(
            "{manifest}\n[[node]]\nname = \"follower\"\nboard = \"f303\"\n\
             wiring = {{ motor = \"bench-motor\" }}\n"
        ),
    );

    let application = folder.text("nodes/motor.rs");
    let (before, task) = application
        .split_once("    #[task(binds = DMA1_CH1")
        .unwrap();
    let (_, after) = task.split_once("    #[task(binds = EXTI1").unwrap();
    let (header, body) = before.split_once("use defmt_rtt").unwrap();
    let header = header.replace(
        "//! | `knob` | DMA1 channel 1 | 5 | 200 Hz: sample, message 200 |\n",
        "",
    );
    let mut application = format!("{header}use defmt_rtt{body}    #[task(binds = EXTI1{after}");
    for (from, to) in [
        ("    use firmware::link::padded;\n", ""),
        ("    use network::Message as _;\n", ""),
        (", pot::Pot", ""),
        ("{AdcCount, Knob, MotorStatus}", "FollowerStatus"),
        ("matrix::{MOTOR, window}", "matrix::{FOLLOWER, window}"),
        ("        pot: Pot,\n", ""),
        (
            "        let Some(pot) = sled.rest.pot() else {\n            fault::stop(Fault::Start)\n        };\n",
            "",
        ),
        ("                pot,\n", ""),
        ("identity(MOTOR)", "identity(FOLLOWER)"),
        ("MotorStatus", "FollowerStatus"),
        ("\"motor\"", "\"follower\""),
    ] {
        assert!(application.contains(from), "{from}");
        application = application.replacen(from, to, 1);
    }
    folder.write("nodes/follower.rs", &application);

    folder.before(
        "Cargo.toml",
        "[features]",
        "[[bin]]\nname = \"follower\"\npath = \"nodes/follower.rs\"\n\
         required-features = [\"f303\"]\ntest = false\nbench = false\n\n",
    );
    folder.replace(
        "src/lib.rs",
        "    self as named, Command,",
        "    self as named, Command, FollowerSelfTest, FollowerStatus,",
    );
    folder.before(
        "src/lib.rs",
        "    MotorStatus, MotorSelfTest;",
        "    FollowerStatus, FollowerSelfTest;\n",
    );
    folder.replace(
        "src/lib.rs",
        "(MasterSelfTest, MotorSelfTest)",
        "(FollowerSelfTest, MasterSelfTest, MotorSelfTest)",
    );
    tasks(folder);
}

/// The second motor's node in the task table: as the first one, without a knob.
fn tasks(folder: &Folder) {
    let table = folder.text("tasks.toml");
    let (_, node) = table.split_once("[node.motor]").unwrap();
    let (node, _) = node.split_once("# From the knob").unwrap();
    let (before, knob) = node.split_once("# 200 Hz by TIM3.").unwrap();
    let (_, after) = knob.split_once("# Pended when").unwrap();
    let (clocks, knob) = before.split_once("# The potentiometer").unwrap();
    let (_, tasks) = knob.split_once("\n\n").unwrap();
    let before = format!("{clocks}\n{tasks}");
    let node = format!("[node.follower]{before}# Pended when{after}");
    let node = node.replace("node.motor.", "node.follower.");
    folder.before("tasks.toml", "# From the knob", &node);
    let table = Table::parse("tasks.toml", &folder.text("tasks.toml")).unwrap();
    assert!(table.node.contains_key("follower"));
}

/// Drives on by joystick under the backup master, in a scenario of its own.
fn backup(folder: &Folder) {
    folder.replace(
        "vehicle.toml",
        "backup_master = \"stop\"",
        "backup_master = \"drive\"",
    );
    folder.write(
        "scenarios/manual-master-dead.toml",
        r#"
        [[press]]
        at = "1 s"
        button = "B"
        [[joystick]]
        at = "1.2 s"
        forward = "50 %"
        [[reset]]
        node = "gps"
        at = "4.03 s"
        "#,
    );
}

/// The receiver of the thesis's remote control, which toggles its outputs.
fn toggle(folder: &Folder) {
    remote(folder, "toggle");
}

/// A remote control whose receiver keeps the output of the last button high.
fn latched(folder: &Folder) {
    remote(folder, "latched");
}

/// Another remote control, and a scenario in which each press is 0.5 s after the one before, the
/// outputs bounce, and the receiver loses its supply.
fn remote(folder: &Folder, kind: &str) {
    folder.replace(
        "vehicle.toml",
        "remote = \"momentary\"",
        &format!("remote = {kind:?}"),
    );
    let (presses, off) = match kind {
        "toggle" => (TOGGLE, &[5.75, 7.75][..]),
        _ => (LATCHED, &[6.75][..]),
    };
    let mut text = String::from("remote.bounce = \"8 ms\"\n");
    for (index, (button, _)) in presses.iter().enumerate() {
        if *button != ' ' {
            let at = FIRST + PAUSE * index as f64;
            text += &format!("[[press]]\nat = \"{at} s\"\nbutton = \"{button}\"\n");
        }
    }
    for off in off {
        text += &format!("[[supply]]\nat = \"{off} s\"\non = false\n");
        text += &format!("[[supply]]\nat = \"{} s\"\non = true\n", off + 0.2);
    }
    folder.write("scenarios/remote.toml", &text);
}

/// The first press of a remote control, and the time between two, s.
const FIRST: f64 = 1.0;
const PAUSE: f64 = 0.5;

/// Presses of a toggling remote control, each with the mode that follows within 0.2 s. A blank is
/// none.
const TOGGLE: [(char, u8); 16] = [
    ('C', 2), // rises: ready
    ('C', 2), // falls: not a start
    ('C', 3), // rises: run
    ('C', 0), // falls: stops
    ('B', 1), // rises: manual
    ('D', 4), // rises: emergency stop
    ('A', 0), // rises: release
    ('C', 2), // rises: ready
    ('D', 4), // falls: emergency stop, too
    (' ', 4), // A, B and C lose their supply: nothing is released or started
    ('A', 0), // rises: release
    ('C', 2), // rises: ready
    ('D', 4), // rises: emergency stop
    ('A', 4), // falls: releases nothing; then the supply fails
    (' ', 4),
    ('A', 0), // rises: release
];

/// The same of a latching remote control.
const LATCHED: [(char, u8); 16] = [
    ('C', 2), // ready
    ('C', 2), // no edge
    ('A', 0), // idle
    ('C', 3), // C, A, C: run
    ('B', 1), // manual
    ('D', 4), // emergency stop
    ('B', 4),
    ('A', 0), // release
    ('C', 2), // ready
    ('A', 0),
    ('C', 3), // run; 0.75 s later the supply fails
    (' ', 3),
    ('C', 4), // the lost receiver was a stop
    ('A', 0), // release
    ('B', 1),
    ('D', 4),
];

/// Another vehicle, as it is written.
fn unchanged(_: &Folder) {}

/// Changes a copy as a walk says.
type Walk = fn(&Folder);

/// Name of the copy, vehicle that is copied, walk.
const WALKS: [(&str, &str, Walk); 9] = [
    ("walk-wheelbase", "uagv", wheelbase),
    ("walk-actuator", "uagv", actuator),
    ("walk-backup", "uagv", backup),
    ("walk-toggle", "uagv", toggle),
    ("walk-latched", "uagv", latched),
    ("walk-rows", "row-follower", rows),
    ("walk-message", "two-boards", message),
    ("walk-node", "two-boards", node),
    ("walk-vehicle", "two-boards", unchanged),
];

/// The workspace of the copies, with every walk applied.
fn workspace() -> &'static Workspace {
    static WORKSPACE: OnceLock<Workspace> = OnceLock::new();
    WORKSPACE.get_or_init(|| {
        let own = Workspace::find().unwrap();
        let temporary = tempfile::tempdir().unwrap();
        let draft = Workspace::at(temporary.path());
        fs::create_dir_all(draft.vehicles()).unwrap();
        for (name, like, walk) in WALKS {
            let model = vehicle::find(&own, like).unwrap();
            let copy = new::create(&draft, &model, name).unwrap();
            walk(&Folder {
                path: copy.folder().to_owned(),
            });
        }
        fs::write(draft.root().join("Cargo.toml"), workspace_manifest(&own)).unwrap();
        for file in ["Cargo.lock", "rust-toolchain.toml"] {
            fs::copy(own.root().join(file), draft.root().join(file)).unwrap();
        }
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("porting");
        synchronise(draft.root(), &folder);
        // Libraries are those of the images that other tests build.
        let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
        Workspace::at(&folder).with_target_folder(target)
    })
}

/// The manifest of the workspace with the copies for members, and all else by its path.
fn workspace_manifest(own: &Workspace) -> String {
    let text = fs::read_to_string(own.root().join("Cargo.toml")).unwrap();
    let mut manifest: toml::Table = text.parse().unwrap();
    let workspace = manifest["workspace"].as_table_mut().unwrap();
    workspace.remove("default-members");
    workspace.insert("members".into(), vec!["firmware/vehicles/*"].into());
    for (_, dependency) in workspace["dependencies"].as_table_mut().unwrap() {
        if let Some(path) = dependency.get_mut("path") {
            let absolute = own.root().join(path.as_str().unwrap());
            *path = absolute.to_str().unwrap().into();
        }
    }
    let profiles = manifest["profile"].as_table_mut().unwrap();
    profiles.retain(|name, _| name == "release");
    toml::to_string(&manifest).unwrap()
}

/// Makes one folder equal to another, without touching files that are equal. The lock file
/// is cargo's as soon as it is there.
fn synchronise(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    let names = |folder: &Path| -> BTreeMap<_, _> {
        let entries = fs::read_dir(folder).unwrap();
        let entries = entries.map(|entry| entry.unwrap());
        entries
            .map(|entry| (entry.file_name(), entry.path()))
            .collect()
    };
    let wanted = names(from);
    for (name, path) in names(to) {
        if !wanted.contains_key(&name) {
            let removed = if path.is_dir() {
                fs::remove_dir_all(path)
            } else {
                fs::remove_file(path)
            };
            removed.unwrap();
        }
    }
    for (name, path) in wanted {
        let there = to.join(&name);
        if path.is_dir() {
            synchronise(&path, &there);
        } else if fs::read(&path).ok() != fs::read(&there).ok() {
            fs::copy(path, there).unwrap();
        }
    }
}

/// Builds a copy's images and runs one of its scenarios.
fn drive(name: &str, scenario: &str, seconds: f64) -> (Vehicle, Outcome) {
    static BUILDING: Mutex<()> = Mutex::new(());
    let vehicle = vehicle::find(workspace(), name).unwrap();
    let nodes: Vec<NodeIndex> = vehicle.nodes().collect();
    let images = {
        // Images of one name replace one another in cargo's folder.
        let _building = BUILDING.lock().unwrap_or_else(PoisonError::into_inner);
        let images = build::images(workspace(), &vehicle, &nodes).unwrap();
        let build::Checked { complaints, .. } = build::check(&vehicle, &images).unwrap();
        assert!(complaints.is_empty(), "{complaints:?}");
        build::read(&images).unwrap()
    };
    let scenario = Scenario::find(&vehicle, scenario).unwrap();
    let options = Options {
        duration: Some(from_seconds(seconds)),
        ..Options::default()
    };
    let outcome = twin::run(&vehicle, &scenario, &images, &options, |_| {}).unwrap();
    for node in &outcome.nodes {
        assert!(!node.locked_up, "{}", node.name);
        assert_eq!(node.resets.len(), 1, "{}", node.name);
    }
    (vehicle, outcome)
}

/// The effort at a node's motor, as it changed.
fn efforts(vehicle: &Vehicle, outcome: &Outcome, node: &str) -> Vec<f64> {
    let node = vehicle.find_node(node).unwrap();
    let changes = outcome.world.efforts().iter();
    let changes = changes.filter(|change| change.node == node);
    changes.map(|change| change.effort).collect()
}

/// The frames of a message, which its node sent.
fn frames(vehicle: &Vehicle, outcome: &Outcome, node: &str, id: u16) -> Vec<Sent> {
    let frames = Traffic::of(outcome).frames.into_iter();
    let of_message = frames.filter(|frame| frame.id == id && frame.complete);
    let frames: Vec<Sent> = of_message.collect();
    let sender = vehicle.find_node(node);
    assert!(frames.iter().all(|frame| frame.node == sender));
    frames
}

/// Asserts that the vehicle drove down its line, which begins 1 m beside it, and settled.
fn assert_settled(outcome: &Outcome) {
    let states = outcome.world.states();
    let steered = states
        .iter()
        .map(|state| state.steering.abs())
        .fold(0.0, f64::max);
    assert!(steered.to_degrees() > 5.0, "{} deg", steered.to_degrees());
    let last = states.last().unwrap();
    assert!(last.north > 10.0, "{} m driven", last.north);
    let settled = &states[states.len() - 200..];
    let aside = settled
        .iter()
        .map(|state| state.east.abs())
        .fold(0.0, f64::max);
    assert!(aside < 0.1, "{aside} m beside the line");
}

/// Asserts that a motor of the bench turned to both sides.
fn assert_turned(efforts: &[f64]) {
    assert!(efforts.iter().any(|effort| *effort > 0.9), "{efforts:?}");
    assert!(efforts.iter().any(|effort| *effort < -0.9), "{efforts:?}");
}

fn settings(vehicle: &Vehicle) -> Settings<f32> {
    let description = vehicle_model::description(vehicle).unwrap();
    Settings::for_vehicle(&description).unwrap()
}

/// Time until the vehicle has come onto its line, from power-on, s.
const SETTLED: f64 = 22.0;

#[test]
fn another_wheelbase() {
    let (vehicle, outcome) = drive("walk-wheelbase", "straight-line", SETTLED);
    assert_settled(&outcome);
    let own = vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap();
    let (new, old) = (settings(&vehicle), settings(&own));
    assert_ne!(new.guidance, old.guidance);
    assert_ne!(new.estimator, old.estimator);
}

/// The options of `sim` on a command line, with a folder for its files.
fn simulation(line: &str, out: &Path) -> cli::Sim {
    let words = line.split(' ').map(OsString::from);
    let words = words.chain(["--out".into(), out.into()]);
    let Ok(cli::Request::Run(cli::Command::Sim(options))) = cli::parse(words) else {
        panic!("not read");
    };
    options
}

/// The law of a robot between other rows drives them, with what the copy's manifest says.
#[test]
fn another_robot_between_rows_drives_its_own_rows() {
    let folder = tempfile::tempdir().unwrap();
    let line = "xtask sim --vehicle walk-rows --experiment row-limits --seeds 1";
    let options = simulation(line, folder.path());
    experiment::run(workspace(), "row-limits", &options).unwrap();
    let report = fs::read_to_string(folder.path().join("experiment.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let cells = report["cells"].as_array().unwrap();
    let easy = |cell: &&serde_json::Value| cell["gap"] == 0.0 && cell["leaves"] == 0.0;
    assert_eq!(cells.iter().filter(easy).count(), 2);
    for cell in cells.iter().filter(easy) {
        assert_eq!(cell["failures"], 0, "{cell:#}");
        assert!(cell["offset_cm"].as_f64().unwrap() < 3.0, "{cell:#}");
    }
}

#[test]
#[ignore = "builds images of its own: `cargo xtask test --long`"]
fn another_robot_between_rows() {
    let (_, outcome) = drive("walk-rows", "poles", 14.0);
    let row = outcome.world.drive().unwrap();
    assert_eq!(row.contact(), None);
    let last = row.samples().last().unwrap();
    assert!(last.station > 5.0 && last.right.abs() < 0.06, "{last:?}");
    let fastest = row.samples().iter().map(|sample| sample.state.speed);
    assert!(fastest.fold(0.0, f64::max) > 0.5);
}

/// Nothing is compiled: the numbers come from the copy's manifest. The copy settles in each case;
/// the aims are those of another machine, so it may miss some.
#[test]
fn an_experiment_drives_with_the_law_of_a_copy() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["walk-wheelbase", "walk-actuator"] {
        let line = format!("xtask sim --vehicle {name} --experiment thesis-7 --quick --seeds 1");
        let out = folder.path().join(name);
        let options = simulation(&line, &out);
        match experiment::run(workspace(), "thesis-7", &options) {
            Ok(()) | Err(Failure::Experiment(experiment::Error::Missed(_))) => {}
            Err(failure) => panic!("{name}: {failure}"),
        }
        let report = fs::read_to_string(out.join("experiment.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        let cases = report["cases"].as_array().unwrap();
        assert_eq!(cases.len(), 5);
        for case in cases {
            assert_eq!(case["furrow"]["settled"], 1, "{name}: {case:#}");
        }
    }
}

#[test]
#[ignore = "builds images of its own: `cargo xtask test --long`"]
fn another_actuator() {
    let (vehicle, outcome) = drive("walk-actuator", "straight-line", SETTLED);
    assert_settled(&outcome);
    let node = vehicle.find_node("drive").unwrap();
    let changes = outcome.world.efforts().iter();
    let mut forwards = changes.filter(|change| change.node == node && change.effort > 0.1);
    assert!(forwards.all(|change| change.byte < 127));
    let limit = 18.0_f64.to_radians() * 1.05;
    let rate = |pair: &[world::StateSample]| (pair[1].steering - pair[0].steering).abs() / 0.01;
    let states = outcome.world.states();
    let fastest = states.windows(2).map(rate).fold(0.0, f64::max);
    assert!(fastest < limit, "{} deg/s", fastest.to_degrees());
}

#[test]
#[ignore = "builds images of its own: `cargo xtask test --long`"]
fn driving_on_under_the_backup_master() {
    let (vehicle, outcome) = drive("walk-backup", "manual-master-dead", 8.0);
    let last = outcome.world.states().last().unwrap();
    assert!(last.speed > 0.9, "{} m/s", last.speed);
    // It is the backup that leads.
    let references = frames(&vehicle, &outcome, "controller", 101);
    assert!(references.len() > 35, "{}", references.len());
    // An autonomous run ends nevertheless: it has no position.
    let (_, outcome) = drive("walk-backup", "master-dead", 23.0);
    let last = outcome.world.states().last().unwrap();
    assert!(last.speed.abs() < 0.01, "{} m/s", last.speed);
}

/// Asserts which mode the commands have 0.2 s after each press, and that the motors stand still in
/// modes that do not drive.
fn assert_modes(name: &str, presses: &[(char, u8)]) {
    let end = FIRST + PAUSE * presses.len() as f64;
    let (vehicle, outcome) = drive(name, "remote", end);
    let commands = frames(&vehicle, &outcome, "controller", 300);
    for (index, (button, mode)) in presses.iter().enumerate() {
        let then = from_seconds(FIRST + PAUSE * index as f64 + 0.2);
        let before = |frame: &&Sent| frame.end.as_ticks() <= then.as_ticks();
        let last = commands.iter().rfind(before).unwrap();
        assert_eq!(last.data[4], *mode, "press {index}, {button:?}");
        assert_eq!(
            last.data[5] & 3 != 0,
            matches!(mode, 1 | 3),
            "press {index}"
        );
    }
}

#[test]
#[ignore = "builds images of its own: `cargo xtask test --long`"]
fn a_toggling_remote_control() {
    assert_modes("walk-toggle", &TOGGLE);
}

#[test]
#[ignore = "builds images of its own: `cargo xtask test --long`"]
fn a_latching_remote_control() {
    assert_modes("walk-latched", &LATCHED);
}

#[test]
fn one_more_message() {
    let (vehicle, outcome) = drive("walk-message", "turn", 5.0);
    assert_turned(&efforts(&vehicle, &outcome, "motor"));
    let sent = frames(&vehicle, &outcome, "motor", 400);
    // One in each basic cycle of 20 ms, once commands come.
    assert!(sent.len() > 200, "{}", sent.len());
    for byte in [0, 127, 254] {
        assert!(sent.iter().any(|frame| frame.data == [byte]), "{byte}");
    }
    let master = vehicle.find_node("master").unwrap();
    let console = String::from_utf8_lossy(&outcome.nodes[master.0].console);
    assert!(console.contains(" motor 254\r\n"), "{console}");
}

#[test]
#[ignore = "builds images of its own: `cargo xtask test --long`"]
fn one_more_node() {
    let (vehicle, outcome) = drive("walk-node", "turn", 5.0);
    assert!(!frames(&vehicle, &outcome, "follower", 513).is_empty());
    assert_turned(&efforts(&vehicle, &outcome, "follower"));
    assert_turned(&efforts(&vehicle, &outcome, "motor"));
}

#[test]
fn another_vehicle() {
    let (vehicle, outcome) = drive("walk-vehicle", "turn", 5.0);
    assert_eq!(vehicle::package(&vehicle).unwrap(), "walk-vehicle");
    assert_turned(&efforts(&vehicle, &outcome, "motor"));
}
