//! The debugger of `sim --gdb`: a run with stops is the run without them, and earlier places are reached again.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Seek, Write};
use std::net::TcpStream;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::OnceLock;

use object::{Object, ObjectSymbol};
use twin::replay::{Halt, Replay};
use twin::stops::{Stop, Stops, Watch, Watched};
use twin::{Images, Twin};
use vehicle_model::{NodeIndex, Vehicle};
use world::{Scenario, SimDuration, SimTime};
use xtask::{Workspace, build, vehicle};

/// As `sim` cuts its runs.
const SPAN: SimDuration = campaign::agreement::SPAN;

struct Subject {
    vehicle: Vehicle,
    images: Images,
    scenario: Scenario,
}

fn subject() -> &'static Subject {
    static SUBJECT: OnceLock<Subject> = OnceLock::new();
    SUBJECT.get_or_init(|| {
        let workspace = Workspace::find().unwrap();
        let vehicle = vehicle::find(&workspace, "uagv").unwrap();
        let nodes: Vec<_> = vehicle.nodes().collect();
        let images = build::images(&workspace, &vehicle, &nodes).unwrap();
        let images = build::read(&images).unwrap();
        let scenario = Scenario::find(&vehicle, "straight-line").unwrap();
        Subject {
            vehicle,
            images,
            scenario,
        }
    })
}

impl Subject {
    fn twin(&self) -> Twin {
        Twin::new(&self.vehicle, &self.scenario, 1, &self.images).unwrap()
    }

    fn node(&self, name: &str) -> NodeIndex {
        self.vehicle.find_node(name).unwrap()
    }

    fn replay(&self, node: &str, end: f64) -> Replay<()> {
        let node = self.node(node);
        Replay::new(self.twin(), (), node, seconds(end), SPAN).unwrap()
    }

    /// Address of a function or a static of a node.
    fn symbol(&self, node: &str, name: &str) -> u32 {
        let file = object::File::parse(self.images.of(self.node(node))).unwrap();
        let symbol = file.symbols().find(|symbol| symbol.name() == Ok(name));
        let symbol = symbol.unwrap_or_else(|| panic!("{node} has no symbol {name}"));
        symbol.address() as u32 & !1
    }
}

fn seconds(seconds: f64) -> SimTime {
    SimTime::from_ticks((seconds * 1e12) as u64)
}

fn never(_: &Replay<()>) -> bool {
    false
}

fn breakpoint(at: u32) -> Stops {
    Stops {
        breakpoints: BTreeSet::from([at]),
        ..Stops::default()
    }
}

/// Where a run is: steps of the node, its time, program counter and all of its memory.
fn place(replay: &Replay<()>) -> (u64, SimTime, u32, Vec<u8>) {
    let mcu = replay.mcu();
    let memory = mcu.memory(0x2000_0000, 12 * 1024).unwrap();
    (mcu.steps(), mcu.now(), mcu.pc(), memory)
}

#[test]
fn a_run_with_stops_and_returns_is_the_run_without_them() {
    let subject = subject();
    let end = seconds(1.5);
    let mut plain = subject.twin();
    while plain.now() < end {
        let next = (plain.now() + SPAN).min(end);
        plain.run_until(next).unwrap();
    }

    let mut replay = subject.replay("steering", 1.5);
    let stops = breakpoint(subject.symbol("steering", "USB_LP_CAN_RX0"));
    let mut places = Vec::new();
    while replay.forwards(stops.clone(), &mut never) == Halt::Stop(Stop::Breakpoint) {
        places.push(place(&replay));
    }
    assert!(places.len() > 20, "{}", places.len());
    assert!(plain.records() == replay.records());

    // The same places, from the last one to the first, and once more forwards.
    for wanted in places.iter().rev() {
        let halt = replay.backwards(&stops, &mut never);
        assert_eq!(halt, Halt::Stop(Stop::Breakpoint));
        assert!(place(&replay) == *wanted, "at {} s", wanted.1.as_ticks());
    }
    assert_eq!(replay.backwards(&stops, &mut never), Halt::Beginning);
    for wanted in &places {
        let halt = replay.forwards(stops.clone(), &mut never);
        assert_eq!(halt, Halt::Stop(Stop::Breakpoint));
        assert!(place(&replay) == *wanted);
    }
    assert_eq!(replay.forwards(stops, &mut never), Halt::End);
    assert!(plain.records() == replay.records());

    // Over spans that are known, the way is short.
    let last = places.last().unwrap();
    assert_eq!(
        replay.backwards(&breakpoint(0), &mut never),
        Halt::Beginning
    );
    assert!(replay.records().is_empty());
    replay.go_to(last.1, &mut never);
    assert!(place(&replay) == *last);
    assert!(plain.records().starts_with(replay.records()));
    assert!(replay.records().len() > plain.records().len() / 2);
    assert_eq!(replay.forwards(breakpoint(0), &mut never), Halt::End);
    assert!(plain.records() == replay.records());
}

#[test]
fn accesses_are_met_forwards_before_and_backwards_behind_them() {
    let subject = subject();
    let mut replay = subject.replay("steering", 1.0);
    // The program's place in the buffer of its log.
    let word = subject.symbol("steering", "_SEGGER_RTT") + 36;
    let stops = |kind| Stops {
        watches: BTreeSet::from([Watch {
            first: word,
            last: word + 3,
            kind,
        }]),
        ..Stops::default()
    };
    let mut written = Vec::new();
    while let Halt::Stop(stop) = replay.forwards(stops(Watched::Writes), &mut never) {
        assert!(matches!(stop, Stop::Access(_)), "{stop:?}");
        let held = replay.mcu().memory(word, 4);
        assert_eq!(replay.step_back(), Halt::Stop(Stop::Step));
        assert_eq!(replay.mcu().memory(word, 4), held);
        let halt = replay.forwards(stops(Watched::Writes), &mut never);
        assert_eq!(halt, Halt::Stop(stop));
        written.push(replay.steps());
    }
    let mut changes = 0;
    for before in written.iter().rev() {
        let halt = replay.backwards(&stops(Watched::Writes), &mut never);
        assert!(matches!(halt, Halt::Stop(Stop::Access(_))), "{halt:?}");
        assert_eq!(replay.steps(), before + 1);
        let new = replay.mcu().memory(word, 4);
        replay.step_back();
        changes += usize::from(replay.mcu().memory(word, 4) != new);
    }
    // The test of the memory, and each line of the log.
    assert!(changes > 3, "{changes} of {}", written.len());
    let halt = replay.backwards(&stops(Watched::Writes), &mut never);
    assert_eq!(halt, Halt::Beginning);
    let halt = replay.forwards(stops(Watched::Reads), &mut never);
    assert!(matches!(halt, Halt::Stop(Stop::Access(_))), "{halt:?}");
}

#[test]
fn a_place_is_found_by_its_time_and_left_by_steps() {
    let mut replay = subject().replay("controller", 2.0);
    let time = seconds(1.234_567);
    assert_eq!(replay.go_to(time, &mut never), Halt::Stop(Stop::Time));
    let late = replay.mcu().now().as_ticks() - time.as_ticks();
    assert!(late <= 1_001_000_000, "{late} ps");
    let run_to = |replay: &mut Replay<()>, steps| {
        let stops = Stops {
            step: Some(steps),
            ..Stops::default()
        };
        let halt = replay.forwards(stops, &mut never);
        assert_eq!(halt, Halt::Stop(Stop::Step));
    };
    // The node may sleep; its next step is a place.
    let next = replay.steps() + 1;
    run_to(&mut replay, next);
    let at = place(&replay);
    for _ in 0..300 {
        assert_eq!(replay.step_back(), Halt::Stop(Stop::Step));
    }
    assert_eq!(replay.steps(), at.0 - 300);
    run_to(&mut replay, at.0);
    assert!(place(&replay) == at);
    replay.go_to(seconds(1.9), &mut never);
    assert!(replay.mcu().now() >= seconds(1.9));
    replay.go_to(at.1, &mut never);
    assert!(place(&replay) == at);
    let mut once = |_: &Replay<()>| true;
    assert_eq!(
        replay.forwards(Stops::default(), &mut once),
        Halt::Interrupted
    );
    let halt = replay.backwards(&breakpoint(0), &mut once);
    assert_eq!(halt, Halt::Interrupted);
    assert!(replay.mcu().now() > time, "it is where it was");
}

#[test]
fn a_change_holds_until_one_goes_back_behind_it() {
    const FREE: u32 = 0x2000_2000;
    let mut replay = subject().replay("steering", 2.0);
    replay.go_to(seconds(0.5), &mut never);
    let (at, now) = (replay.steps(), replay.mcu().now());
    let held = replay.mcu().memory(FREE, 4).unwrap();
    assert!(replay.change(|mcu| mcu.set_memory(FREE, b"mark")));
    assert!(replay.change(|mcu| mcu.set_memory(FREE, b"more")));
    let has = |replay: &Replay<()>| replay.mcu().memory(FREE, 4).unwrap();
    replay.go_to(seconds(1.5), &mut never);
    assert_eq!(has(&replay), b"more");
    replay.go_to(now, &mut never);
    assert_eq!((replay.steps(), has(&replay)), (at, b"more".to_vec()));
    assert_eq!(replay.step_back(), Halt::Stop(Stop::Step));
    assert_eq!(has(&replay), held);
    replay.go_to(seconds(1.5), &mut never);
    assert_eq!(has(&replay), held);
}

/// `sim --gdb`, waiting for gdb.
struct Waiting {
    child: Child,
    messages: BufReader<ChildStderr>,
    /// The image for gdb, and where gdb connects to.
    image: String,
    address: String,
}

impl Waiting {
    fn new(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_xtask"));
        command.args(["sim", "--gdb"]).args(arguments);
        command.current_dir(Workspace::find().unwrap().root());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut messages = BufReader::new(child.stderr.take().unwrap());
        let mut seen = String::new();
        // The command for gdb: its program, the image, and "target remote" with the address.
        let words: Vec<String> = loop {
            let before = seen.len();
            assert!(messages.read_line(&mut seen).unwrap() > 0, "{seen}");
            let line = &seen[before..];
            if line.trim().starts_with("gdb-multiarch") {
                break line.split_whitespace().map(String::from).collect();
            }
        };
        Self {
            child,
            messages,
            image: words[1].clone(),
            address: words[5].trim_matches('\'').to_owned(),
        }
    }

    /// What it prints until its end, which is orderly.
    fn end(mut self) -> (String, String) {
        let (mut report, mut messages) = (String::new(), String::new());
        let stdout = self.child.stdout.as_mut().unwrap();
        stdout.read_to_string(&mut report).unwrap();
        self.messages.read_to_string(&mut messages).unwrap();
        assert!(self.child.wait().unwrap().success(), "{messages}");
        (report, messages)
    }
}

#[test]
fn gdb_goes_forwards_and_backwards() {
    if Command::new("gdb-multiarch")
        .arg("--version")
        .output()
        .is_err()
    {
        eprintln!("skipped: there is no gdb-multiarch, the Debian package of this name");
        return;
    }
    let waiting = Waiting::new(&["steering:0", "--seconds", "3"]);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/gdb/session.gdb");
    let mut gdb = Command::new("gdb-multiarch");
    gdb.args(["-q", "-nx", "-batch", "-ex"]);
    gdb.arg(format!("target remote {}", waiting.address));
    gdb.args(["-x", script, &waiting.image]);
    gdb.current_dir(Workspace::find().unwrap().root());
    // Both outputs in their common order.
    let mut output = tempfile::tempfile().unwrap();
    gdb.stdout(output.try_clone().unwrap());
    gdb.stderr(output.try_clone().unwrap());
    gdb.status().unwrap();
    let (_, messages) = waiting.end();
    let mut text = String::new();
    output.rewind().unwrap();
    output.read_to_string(&mut text).unwrap();
    let mut rest = &text[..];
    for wanted in [
        "first 1",
        "INFO Start",
        "Breakpoint 1, ",
        "steps of the node",
        "exception 36",
        "back 1",
        "again 1",
        "The next continue halts there at the latest.",
        "Old value = ",
        "New value = ",
        "Old value = ",
        "New value = ",
        "written 1",
        "Old value = ",
        "before 1",
        "Program received signal SIGTRAP",
        "2.50",
        "steering        2.5",
        "north ",
        "  controller ",
        "INFO ",
        "set 77 4711",
        "undone 0",
        "float 8",
        "No more reverse-execution history.",
        "in Reset ()",
        "Program received signal SIGTRAP",
        "steps of the node",
        "[Inferior 1 (process 1) killed]",
    ] {
        let found = rest.find(wanted);
        let at = found.unwrap_or_else(|| panic!("no {wanted:?} in\n{rest}\nof\n{text}"));
        rest = &rest[at + wanted.len()..];
    }
    assert!(messages.ends_with("gdb has ended the run.\n"), "{messages}");
}

/// gdb's side of the connection.
struct Client(TcpStream);

impl Client {
    fn send(&mut self, packet: &str) {
        let sum = packet.bytes().fold(0_u8, u8::wrapping_add);
        let packet = format!("${packet}#{sum:02x}");
        self.0.write_all(packet.as_bytes()).unwrap();
    }

    /// The next packet that is no line for the console.
    fn answer(&mut self) -> String {
        loop {
            let mut text = Vec::new();
            while !text.contains(&b'#') {
                let mut byte = [0];
                self.0.read_exact(&mut byte).unwrap();
                text.push(byte[0]);
            }
            self.0.read_exact(&mut [0; 2]).unwrap();
            self.0.write_all(b"+").unwrap();
            let text = String::from_utf8(text).unwrap();
            let packet = text.trim_start_matches('+').trim_matches(['$', '#']);
            if !packet.starts_with('O') || packet == "OK" {
                return packet.to_owned();
            }
        }
    }

    fn ask(&mut self, packet: &str) -> String {
        self.send(packet);
        self.answer()
    }
}

#[test]
fn gdb_interrupts_reads_and_lets_go() {
    let waiting = Waiting::new(&["gps:0", "--seconds", "1.5", "--until", "200 ms"]);
    let mut gdb = Client(TcpStream::connect(&waiting.address).unwrap());
    let supported = gdb.ask("qSupported:swbreak+;hwbreak+");
    assert!(supported.contains("ReverseContinue+"), "{supported}");
    let map = gdb.ask("qXfer:memory-map:read::0,1000");
    // Repeated digits are sent as their number.
    assert!(map.contains(r#"<memory type="rom" start="0x80"#), "{map}");
    // An address and a register beyond the part, and the flash, which nothing writes.
    assert_eq!(gdb.ask("m70000000,4"), "E79");
    assert_eq!(gdb.ask("M8000000,1:00"), "E79");
    // TIM2 counts; the registers of the reset and clock control have no side effects either.
    let first = gdb.ask("m40000024,4");
    assert!(!first.starts_with('E'), "{first}");
    assert_eq!(gdb.ask("m40000024,4"), first);
    assert_eq!(gdb.ask("me000ed00,4"), "41c20f41");

    gdb.send("c");
    gdb.0.write_all(&[3]).unwrap();
    let stop = gdb.answer();
    assert!(stop.starts_with("S02") || stop.starts_with("T02"), "{stop}");
    // The rest of the run is that of `sim` without a debugger.
    assert_eq!(gdb.ask("D"), "OK");
    let (report, messages) = waiting.end();
    assert!(messages.contains("the run goes on"), "{messages}");
    assert!(
        report.contains("straight-line, seed 1, 1.5 s simulated"),
        "{report}"
    );
}
