//! A fact stands once: changed in its one place, it changes what is built, what the virtual
//! vehicle does and what the analysis answers.
//!
//! The facts of boards and parts are values of the crate `parts`; those of a vehicle are texts
//! of its folder. Each test changes one of them and asks those that read it. What the images
//! take from `parts` as constants is not built again; instead, the last test looks for a second
//! place: a source that writes such a number itself.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use campaign::traffic::Matrix;
use can_bus::SimDuration;
use firmware::design;
use network_model::{Network, generate};
use parts::{Clocks, Memory, Part, Sled};
use schedulability::arrivals::{Kind, Sporadic};
use schedulability::board::Board as Analysed;
use schedulability::can::ErrorRate;
use schedulability::execution::{Execution, Handler};
use schedulability::model::{NodeModel, TaskModel};
use schedulability::node::schedule;
use schedulability::results::NodeReport;
use schedulability::table::{Delay, NodeEntry, NodeTable, PendedBy, Table};
use schedulability::tasks::App;
use sled_common::clock::Oscillator;
use syn::visit::Visit;
use twin::image::Image;
use twin::mcu::{Board, Mcu};
use twin::{Images, Twin};
use vehicle_model::{NodeIndex, Vehicle, VehicleError};
use wcet::annotation::Annotations;
use wcet::cycles::Cycles;
use world::Scenario;
use xtask::{Workspace, build, size};

/// A node on the F446 sled, with a receiver.
const GPS: NodeIndex = NodeIndex(0);
/// The node whose image the emulated board runs; its board is the F303 sled.
const DRIVE: NodeIndex = NodeIndex(3);

fn workspace() -> Workspace {
    Workspace::find().unwrap()
}

fn vehicle() -> Vehicle {
    xtask::vehicle::find(&workspace(), "uagv").unwrap()
}

/// The vehicle with one text of its folder changed.
fn vehicle_with(file: &str, from: &str, to: &str) -> Vehicle {
    changed(file, from, to).unwrap()
}

/// What is read from the vehicle's folder when one text of it is changed.
fn changed(file: &str, from: &str, to: &str) -> Result<Vehicle, VehicleError> {
    let folder = vehicle().folder().to_owned();
    let read = |name: &str| {
        let text = fs::read_to_string(folder.join(name)).unwrap();
        if name == file {
            assert!(text.contains(from), "{file} has no {from:?}");
            text.replacen(from, to, 1)
        } else {
            text
        }
    };
    let (manifest, network) = (read("vehicle.toml"), read("network.dbc"));
    Vehicle::parse("uagv", &folder, &manifest, &network)
}

/// A board after a change.
fn board(change: impl FnOnce(&mut Sled)) -> &'static Sled {
    let mut board = *Sled::F303;
    change(&mut board);
    Box::leak(Box::new(board))
}

/// A part after a change.
fn part(change: impl FnOnce(&mut Part)) -> &'static Part {
    let mut part = *Part::F303;
    change(&mut part);
    Box::leak(Box::new(part))
}

/// The image of the drive node; built once.
fn elf() -> &'static (PathBuf, Vec<u8>) {
    static ELF: OnceLock<(PathBuf, Vec<u8>)> = OnceLock::new();
    ELF.get_or_init(|| {
        let images = build::images(&workspace(), &vehicle(), &[DRIVE]);
        let path = images.unwrap_or_else(|failure| panic!("{failure}"))[0]
            .path
            .clone();
        let bytes = fs::read(&path).unwrap();
        (path, bytes)
    })
}

/// The drive node's image on an emulated board, 100 ms after its start.
fn run(sled: &'static Sled) -> Mcu {
    let image = Image::from_elf(sled.part, &elf().1).unwrap();
    let around = Board {
        external_clock: Some(sled.external_hz),
        ..Board::default()
    };
    let mut mcu = Mcu::new(Arc::new(image), &around, None);
    mcu.run_for(SimDuration::from_ticks(100_000_000_000));
    mcu
}

/// A node of a vehicle on a board, as the analysis sees it. `change` is what is done to the task
/// table's text.
fn model(
    vehicle: &Vehicle,
    node: NodeIndex,
    board: &'static Sled,
    change: impl FnOnce(String) -> String,
) -> (NodeModel, NodeTable) {
    model_in(vehicle, vehicle.network(), node, board, change)
}

/// The same in another network.
fn model_in(
    vehicle: &Vehicle,
    network: &Network,
    node: NodeIndex,
    board: &'static Sled,
    change: impl FnOnce(String) -> String,
) -> (NodeModel, NodeTable) {
    let text = change(fs::read_to_string(vehicle.task_table()).unwrap());
    let table = Table::parse("tasks.toml", &text)
        .and_then(|table| table.resolve("tasks.toml", network, vehicle.receiver_period_us()))
        .unwrap();
    let name = &vehicle.node(node).name;
    let source = fs::read_to_string(vehicle.source(node)).unwrap();
    let app = App::parse("node.rs", &source).unwrap();
    let on_board = table.node[name].on(board);
    let model = NodeModel::new(
        name,
        &app,
        &on_board,
        (network, ErrorRate::NONE),
        "tasks.toml",
    )
    .unwrap();
    (model, on_board)
}

/// Releases and deadlines of the drive node's tasks.
fn tasks(vehicle: &Vehicle, board: &'static Sled) -> Vec<TaskModel> {
    model(vehicle, DRIVE, board, |text| text).0.tasks
}

/// What the analysis answers for the drive node on a board when every job takes 1000 cycles.
fn report(board: &'static Sled) -> NodeReport {
    let (model, on_board) = model(&vehicle(), DRIVE, board, |text| text);
    let handlers = model.tasks.iter().map(|task| {
        let handler = Handler {
            cycles: Cycles::both(1000),
            ..Handler::default()
        };
        (task.interrupt.clone(), handler)
    });
    let execution = Execution {
        handlers: handlers.collect(),
        ..Execution::default()
    };
    schedule(&model, &on_board, &execution, None)
}

/// A folder that is refused must not stop the commands for other vehicles.
#[test]
fn no_command_depends_on_a_vehicle() {
    let packages: Vec<String> = xtask::vehicle::names(&workspace())
        .unwrap()
        .iter()
        .map(|name| xtask::vehicle::find(&workspace(), name).unwrap())
        .map(|vehicle| xtask::vehicle::package(&vehicle).unwrap())
        .collect();
    let root = workspace().root().join("xtask");
    let entries = fs::read_dir(&root).unwrap().flatten();
    let folders = entries.map(|entry| entry.path()).chain([root]);
    for manifest in folders.map(|folder| folder.join("Cargo.toml")) {
        let Ok(text) = fs::read_to_string(&manifest) else {
            continue;
        };
        let manifest: toml::Table = text.parse().unwrap();
        for kind in ["dependencies", "build-dependencies"] {
            let Some(dependencies) = manifest.get(kind).and_then(toml::Value::as_table) else {
                continue;
            };
            for package in &packages {
                assert!(!dependencies.contains_key(package), "{package}");
            }
        }
    }
}

#[test]
fn oscillator_and_core_clock() {
    let slower = board(|board| {
        // Start-up refuses a clock that is off by more than a tenth.
        board.external_hz -= board.external_hz / 16;
        board.external = Clocks {
            core: board.external.core / 16 * 15,
            apb1: board.external.apb1 / 16 * 15,
            apb2: board.external.apb2 / 16 * 15,
            ticks_per_us: board.external.ticks_per_us,
        };
    });
    for board in [Sled::F303, slower] {
        let built = sled_common::clock::Clocks::of(board, Oscillator::External).core;
        assert_eq!(built, board.external.core);
        assert_eq!(run(board).core_hz(), u64::from(built));
    }
    let (before, after) = (report(Sled::F303), report(slower));
    assert_eq!(15 * before.core_hz, 16 * after.core_hz);
    let costs = before.tasks.iter().zip(&after.tasks);
    assert!(costs.clone().count() > 0);
    for (before, after) in costs {
        assert!(before.cost < after.cost, "{}", before.name);
    }
}

#[test]
fn wait_states_of_the_flash() {
    let hz = Sled::F303.external.core;
    let slow_part = part(|part| {
        part.flash_access.limits_hz = &[12_000_000, 24_000_000, 48_000_000, 72_000_000];
    });
    let slow = board(|board| board.part = slow_part);
    // What the boards' crates set. The emulated core waits as its program has set.
    let built = |board: &Sled| board.part.flash_access.wait_states(hz);
    assert_eq!((built(Sled::F303), built(slow)), (Some(2), Some(3)));
    assert_ne!(Analysed::from(Sled::F303), Analysed::from(slow));
}

#[test]
fn attempts_of_an_event_triggered_node() {
    let of_firmware = firmware::event::ATTEMPTS;
    assert_eq!(schedulability::event::ATTEMPTS, u64::from(of_firmware));
}

/// The receive interrupt handles a message by a shorter path than a reference, and which one a frame is follows from
/// its identifier in the network file.
#[test]
fn identifier_of_a_frame() {
    let (path, _) = elf();
    let image = wcet::image::Image::read(path).unwrap();
    let annotations = Annotations::new(workspace().root());
    let (mut model, on_board) = model(&vehicle(), DRIVE, Sled::F303, |text| text);
    let kinds = |model: &NodeModel| {
        let execution = Execution::of(model, &on_board, &image, &annotations, &|_| {});
        let handler = execution.unwrap().handlers["USB_LP_CAN_RX0"].clone();
        let of = |kind| handler.kinds[&kind].flashed;
        (of(Kind::Reference), of(Kind::Exclusive))
    };
    let (reference, message) = kinds(&model);
    assert!(3 * message < 2 * reference, "{message} of {reference}");
    let mut tasks = model.tasks.iter_mut();
    let can_rx = tasks.find(|task| task.name == "can_rx").unwrap();
    let received = &mut can_rx.received;
    let references = received[&Kind::Reference].clone();
    received
        .get_mut(&Kind::Exclusive)
        .unwrap()
        .extend(references);
    assert_eq!(kinds(&model), (reference, reference));
}

#[test]
fn size_of_the_stack() {
    let (path, _) = elf();
    let smaller = board(|board| board.stack.size /= 2);
    let built = |board: &Sled| board.linker_script().to_string();
    assert!(built(Sled::F303).contains("LENGTH = 4096"));
    assert!(built(smaller).contains("LENGTH = 2048"));
    assert_eq!(report(smaller).stack_size, smaller.stack.size);
    // The image's own symbols, which the check of its size reads, say what the script said.
    let image = size::measure(path, Sled::F303).unwrap();
    assert_eq!(image.stack, u64::from(Sled::F303.stack.size));
    let emulated = Image::from_elf(Part::F303, &elf().1).unwrap();
    let top = emulated.symbol("_stack_start");
    assert_eq!(top, Some(Sled::F303.stack.end()));
}

#[test]
fn map_of_the_memories() {
    let (path, bytes) = elf();
    let small_part = part(|part| {
        part.flash.size = 16 * 1024;
        part.ram = &[Memory {
            name: "RAM",
            base: 0x2000_0000,
            size: 8 * 1024,
            dma: true,
        }];
    });
    let small = board(|board| {
        board.part = small_part;
        board.secret.base = small_part.flash.base + 14 * 1024;
        board.starts = board.starts.map(|starts| Memory {
            base: small_part.flash.base + 10 * 1024,
            ..starts
        });
    });
    let script = small.linker_script().to_string();
    // The last pages of the flash hold starts and the key of the network, and no program.
    assert!(script.contains("LENGTH = 10240") && script.contains("LENGTH = 8192"));
    assert_ne!(script, Sled::F303.linker_script().to_string());
    // The image does not fit any more: neither into the board nor into the emulated part.
    assert!(size::measure(path, Sled::F303).is_ok());
    assert!(size::measure(path, small).is_err());
    assert!(Image::from_elf(Part::F303, bytes).is_ok());
    assert!(Image::from_elf(small_part, bytes).is_err());
}

#[test]
fn transmit_lead() {
    let earlier = board(|board| board.transmit_lead_ticks *= 2);
    assert_eq!(
        earlier.transmit_lead_ps(),
        2 * Sled::F303.transmit_lead_ps()
    );
    // What the nodes' protocol stacks are configured with; the timer goes off that much earlier.
    assert_ne!(tasks(&vehicle(), earlier), tasks(&vehicle(), Sled::F303));
}

#[test]
fn time_mark() {
    let later = vehicle_with(
        "network.dbc",
        "\"WindowStart\" BO_ 453 11000;",
        "\"WindowStart\" BO_ 453 20000;",
    );
    let built = |vehicle: &Vehicle| generate::matrix(vehicle.network());
    assert_ne!(built(&vehicle()), built(&later));
    // What a run is judged by.
    let start = |vehicle: &Vehicle| {
        let judge = Matrix::new(vehicle);
        let mut messages = judge.messages().iter();
        let message = messages.find(|message| message.id == 453).unwrap();
        message.window.start_us
    };
    assert_eq!(start(&later) - start(&vehicle()), 9000);
    assert_ne!(tasks(&vehicle(), Sled::F303), tasks(&later, Sled::F303));
}

#[test]
fn board_of_a_node() {
    let (node, receiver) = (
        "name = \"gps\"\nboard = \"f446\"",
        "\nwiring = { receiver = \"satellite-receiver\" }",
    );
    let on_f303 = node.replace("f446", "f303");
    // The F303 sled has no connector for a receiver.
    let refused = changed("vehicle.toml", node, &on_f303).unwrap_err();
    let sentence = refused.to_string();
    assert!(sentence.contains("the board f303 has no such connector"));
    let moved = vehicle_with("vehicle.toml", &format!("{node}{receiver}"), &on_f303);
    let command = |vehicle: &Vehicle| {
        let command = build::command(&workspace(), vehicle, &[GPS]).unwrap();
        format!("{command:?}")
    };
    assert!(command(&vehicle()).contains("\"f446\""));
    assert!(command(&moved).contains("\"f303\""));
    let emulated = |vehicle: &Vehicle| {
        let scenario = Scenario::parse(vehicle, "t", "t", "").unwrap();
        let images = Images::new(vec![elf().1.clone(); vehicle.nodes().len()]);
        let twin = Twin::new(vehicle, &scenario, 1, &images).unwrap();
        (twin.sled(GPS), twin.node(GPS).part())
    };
    assert_eq!(emulated(&vehicle()), (Sled::F446, Part::F446));
    assert_eq!(emulated(&moved), (Sled::F303, Part::F303));
    let proven = |vehicle: &Vehicle| model(vehicle, GPS, vehicle.board(GPS), |text| text).1;
    assert_eq!(proven(&vehicle()).board, Sled::F446.into());
    assert_eq!(proven(&moved).board, Sled::F303.into());
}

#[test]
fn deadline_of_a_task() {
    let deadline = |to: &str| {
        let change = |text: String| text.replace("deadline_us = 100_000", to);
        let (model, _) = model(&vehicle(), DRIVE, Sled::F303, change);
        let mut tasks = model.tasks.iter();
        let console = tasks.find(|task| task.name == "console").unwrap();
        console.deadline
    };
    let before = deadline("deadline_us = 100_000");
    assert_eq!(before, 2 * deadline("deadline_us = 50_000"));
}

#[test]
fn expiry_of_a_command() {
    let network = vehicle().network().clone();
    let expiry = |network: &Network| {
        let mut messages = network.messages.iter();
        let command = messages.find(|message| message.name == "Command").unwrap();
        let us = network.overdue_us(command);
        let built = format!("pub const COMMAND: Micros = Micros::micros({us});");
        assert!(generate::matrix(network).contains(&built));
        us
    };
    let longer = Network {
        basic_cycle_us: 2 * network.basic_cycle_us,
        ..network.clone()
    };
    let added = network::MISSED_PERIODS * network.basic_cycle_us;
    assert_eq!(expiry(&longer), expiry(&network) + added);
    // The analysis expects the expiry when the nodes' timers go off.
    let text = fs::read_to_string(vehicle().task_table()).unwrap();
    let delay = |network: &Network| {
        let table = Table::parse("tasks.toml", &text).unwrap();
        let period = vehicle().receiver_period_us();
        let table = table.resolve("tasks.toml", network, period).unwrap();
        table.node["drive"].task["window_timer"].delay.clone()
    };
    for network in [&network, &longer] {
        let us = u64::from(expiry(network));
        assert_eq!(delay(network), Some(Delay::Us(us)));
    }
}

/// The sporadic releases of a node's task.
fn sporadic(vehicle: &Vehicle, node: NodeIndex, task: &str) -> Vec<Sporadic> {
    sporadic_in(vehicle, vehicle.network(), node, task)
}

/// The same in another network.
fn sporadic_in(vehicle: &Vehicle, network: &Network, node: NodeIndex, task: &str) -> Vec<Sporadic> {
    let (model, _) = model_in(vehicle, network, node, vehicle.board(node), |text| text);
    let mut tasks = model.tasks.into_iter();
    let found = tasks.find(|of_node| of_node.name == task).unwrap();
    found.arrivals.sporadic
}

#[test]
fn bit_rate_of_the_bus() {
    let vehicle = vehicle();
    let text = fs::read_to_string(vehicle.network_file()).unwrap();
    let rate = "BA_ \"Baudrate\" 250000;";
    assert!(text.contains(rate));
    let faster = Network::parse(&text.replacen(rate, "BA_ \"Baudrate\" 500000;", 1)).unwrap();
    let built = |network: &Network, rate: u32| {
        let constant = format!("pub const BIT_RATE: u32 = {rate};");
        assert!(generate::matrix(network).contains(&constant));
    };
    built(vehicle.network(), 250_000);
    built(&faster, 500_000);
    // The analysis expects a node back from bus-off that much earlier.
    let shortest = |network: &Network| {
        let streams = sporadic_in(&vehicle, network, DRIVE, "can_error").into_iter();
        streams.map(|stream| stream.period).max().unwrap()
    };
    assert_eq!(shortest(vehicle.network()), 5_632_000_000);
    assert_eq!(shortest(&faster), 2_816_000_000);
}

#[test]
fn period_of_the_receiver() {
    let slower = vehicle_with("vehicle.toml", "period = \"100 ms\"", "period = \"200 ms\"");
    let built = |vehicle: &Vehicle| vehicle.receiver_period_us().unwrap();
    assert_eq!(2 * built(&vehicle()), built(&slower));
    // The analysis expects the frames of one burst in each period.
    for task in ["ring", "parse"] {
        let bursts = |vehicle: &Vehicle, window: u64| {
            let streams = sporadic(vehicle, GPS, task).into_iter();
            let mut limited = streams.filter(|stream| stream.limit.is_some());
            limited.next().unwrap().count(window)
        };
        let window = 200_000_000_000;
        assert_eq!(
            bursts(&vehicle(), window),
            2 * bursts(&slower, window),
            "{task}"
        );
    }
}

/// The task tables say by hand how often the shared tasks run; the firmware has the periods.
#[test]
fn periods_of_the_shared_tasks() {
    let workspace = workspace();
    for name in Vehicle::names(&workspace.vehicles()).unwrap() {
        let vehicle = xtask::vehicle::find(&workspace, &name).unwrap();
        let text = fs::read_to_string(vehicle.task_table()).unwrap();
        let table = Table::parse("tasks.toml", &text).unwrap();
        for node in table.node.values() {
            let every = |task: &str| node.task[task].every_us.as_slice()[0];
            let housekeeping = u64::from(design::HOUSEKEEPING_PERIOD.ticks()) * 1000;
            assert_eq!(every("SysTick"), housekeeping);
            assert_eq!(every("housekeeping"), housekeeping);
            let console = u64::from(design::CONSOLE_PERIOD.ticks()) * 1000;
            assert_eq!(every("console"), console);
            ends_are_apart(node);
        }
    }
}

/// The ends of commands are a pause apart, less the 100 us or less in which a job tells one.
fn ends_are_apart(node: &NodeEntry) {
    let Some(actuate) = node.task.get("actuate") else {
        return;
    };
    let Some(PendedBy::Bounded(ends)) = actuate.pended_by.get("window_timer") else {
        panic!("nothing bounds the ends of commands");
    };
    let pause = u64::from(design::END_PAUSE.ticks());
    assert_eq!(ends.every_us.as_slice(), [pause - 100]);
}

/// Integers of a source outside its tests.
#[derive(Default)]
struct Integers(Vec<u64>);

fn is_test(attributes: &[syn::Attribute]) -> bool {
    let mut attributes = attributes.iter();
    attributes.any(|attribute| match &attribute.meta {
        syn::Meta::List(list) => list.path.is_ident("cfg") && list.tokens.to_string() == "test",
        _ => false,
    })
}

impl<'ast> Visit<'ast> for Integers {
    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        if !is_test(&module.attrs) {
            syn::visit::visit_item_mod(self, module);
        }
    }

    fn visit_lit_int(&mut self, integer: &'ast syn::LitInt) {
        self.0.extend(integer.base10_parse::<u64>());
    }
}

/// All Rust sources below a folder, tests and examples left out.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if path.is_dir() {
            let left_out = ["tests", "examples", "benches", "kernels", "target", "parts"];
            if !left_out.contains(&name.as_ref()) {
                sources(&path, found);
            }
        } else if name.ends_with(".rs") {
            found.push(path);
        }
    }
}

#[test]
fn no_source_repeats_a_number_of_a_board() {
    let numbers: Vec<u32> = Sled::ALL
        .iter()
        .flat_map(|board| {
            [
                board.external_hz,
                board.part.hsi.hz,
                board.external.core,
                board.internal.core,
                board.part.flash.base,
            ]
        })
        .collect();
    let mut files = Vec::new();
    let root = workspace().root().to_owned();
    for folder in ["boards", "firmware", "xtask", "ttcan/src", "control/src"] {
        sources(&root.join(folder), &mut files);
    }
    assert!(files.len() > 100);
    // It holds the address map of the processor's architecture, the same for every part.
    let architecture = "xtask/wcet/src/layout.rs";
    for file in files {
        let name = file.strip_prefix(&root).unwrap().to_string_lossy();
        if name == architecture {
            continue;
        }
        let parsed = syn::parse_file(&fs::read_to_string(&file).unwrap()).unwrap();
        let mut integers = Integers::default();
        integers.visit_file(&parsed);
        for number in &numbers {
            let copy = integers.0.contains(&u64::from(*number));
            assert!(
                !copy,
                "{name} repeats {number} ({number:#x}) of the crate parts"
            );
        }
    }
}
