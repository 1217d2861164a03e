//! The commands of `monitor`: they show the vehicle around the node.

use std::fmt::Write as _;

use can_bus::RecordKind;
use embedded_can::Id;
use world::time;

use super::{
    machine::Machine,
    until::{FORMS, Until},
};

const HELP: &str = "\
monitor time            the time, and the number of steps of the node
monitor until WHERE     the next continue or reverse-continue halts there at the latest;
                        monitor until never takes it back
monitor bus [N]         the last N frames of the bus (10)
monitor nodes           what each node does
monitor world           where the vehicle is, and its actuators
monitor log [N]         the last N lines of the node's log (10)
";

/// Lines of a list unless another number is given.
const LINES: usize = 10;

/// The answer to a command.
pub(super) fn answer(machine: &mut Machine<'_>, command: &str) -> String {
    let mut words = command.splitn(2, char::is_whitespace);
    let (name, rest) = (
        words.next().unwrap_or_default(),
        words.next().unwrap_or_default().trim(),
    );
    let count = match rest {
        "" => Ok(LINES),
        rest => rest.parse::<usize>(),
    };
    match (name, count) {
        ("bus" | "log", Err(_)) => format!("{rest:?} is no number of lines\n"),
        ("bus", Ok(count)) => bus(machine, count),
        ("log", Ok(count)) => log(machine, count),
        ("time", _) => time_of(machine),
        ("nodes", _) => nodes(machine),
        ("world", _) => world(machine),
        ("until", _) => until(machine, rest),
        ("" | "help", _) => HELP.to_owned(),
        _ => format!("monitor has no command {name:?}, but these:\n{HELP}"),
    }
}

fn time_of(machine: &Machine<'_>) -> String {
    let mcu = machine.replay.mcu();
    format!(
        "{:.9} s of {} s, {} steps of the node, {} cycles of its core\n",
        time::seconds(mcu.now()),
        time::seconds(machine.replay.end()),
        mcu.steps(),
        mcu.cycles()
    )
}

fn until(machine: &mut Machine<'_>, text: &str) -> String {
    if text == "never" {
        machine.until = None;
        return "No halt is set.\n".into();
    }
    if text.is_empty() {
        return format!("monitor until WHERE: {FORMS} is accepted\n");
    }
    match Until::parse(text, machine.vehicle) {
        Ok(until) => {
            let direction = match &until {
                Until::Time(time) if *time <= machine.replay.mcu().now() => "reverse-continue",
                _ => "continue",
            };
            machine.until = Some(until);
            format!("The next {direction} halts there at the latest.\n")
        }
        Err(why) => format!("{why}\n"),
    }
}

fn bus(machine: &Machine<'_>, count: usize) -> String {
    let twin = machine.replay.twin();
    // The bus hands its records over at the end of each step of the vehicle.
    let latest = twin.copy().network().bus().drain_records();
    let frames = machine.replay.records().iter().chain(&latest).rev();
    let mut lines: Vec<String> = frames
        .filter_map(|record| {
            let RecordKind::FrameEnd { frame, start, .. } = &record.kind else {
                return None;
            };
            let node = twin
                .node_at(record.node)
                .map_or("foreign", |node| twin.name(node));
            let (id, message) = match frame.id() {
                Id::Standard(id) => {
                    let message = machine.vehicle.network().message(id.as_raw());
                    (
                        u32::from(id.as_raw()),
                        message.map(|message| message.name.as_str()),
                    )
                }
                Id::Extended(id) => (id.as_raw(), None),
            };
            let mut line = format!(
                "{:11.6} s  {node:12} {id:#05x} {:20}",
                time::seconds(*start),
                message.unwrap_or_default()
            );
            for byte in frame.data() {
                // Writing to a string cannot fail.
                let _ = write!(line, " {byte:02x}");
            }
            Some(line)
        })
        .take(count)
        .collect();
    lines.reverse();
    list(&lines, "There was no frame yet.")
}

fn log(machine: &Machine<'_>, count: usize) -> String {
    list(
        machine.replay.companion().last(count),
        "The node has said nothing yet.",
    )
}

fn list(lines: &[String], none: &str) -> String {
    if lines.is_empty() {
        return format!("{none}\n");
    }
    lines
        .iter()
        .fold(String::new(), |text, line| text + line + "\n")
}

fn nodes(machine: &Machine<'_>) -> String {
    let twin = machine.replay.twin();
    let mut text = String::new();
    for node in twin.nodes() {
        let mcu = twin.node(node);
        let doing = match mcu.exception() {
            _ if mcu.is_held() => "held in reset".to_owned(),
            _ if mcu.is_locked_up() => "in lockup".to_owned(),
            0 if mcu.is_asleep() => "asleep".to_owned(),
            0 => "in thread mode".to_owned(),
            number => {
                let handler = mcu.image().handler(number);
                let name = handler.map_or_else(
                    || format!("exception {number}"),
                    |(_, name)| name.to_string(),
                );
                format!("in {name}")
            }
        };
        let resets = mcu.resets();
        let last = resets.last().map(|(at, cause)| (time::seconds(*at), cause));
        let (at, cause) = last.map_or((0.0, String::new()), |(at, cause)| {
            (at, format!("{cause:?}"))
        });
        let _ = writeln!(
            text,
            "{:12} {:11.6} s  pc {:#010x}  {doing}; started {} times, last at {at} s: {cause}",
            twin.name(node),
            time::seconds(mcu.now()),
            mcu.pc(),
            resets.len()
        );
    }
    text
}

fn world(machine: &Machine<'_>) -> String {
    let world = machine.replay.twin().world();
    let mut text = format!("at {:.6} s\n", time::seconds(world.now()));
    if let Some(state) = world.states().last() {
        let _ = writeln!(
            text,
            "north {:.3} m, east {:.3} m, heading {:.2} deg, steering {:.2} deg, speed {:.3} m/s\n\
             effort of the steering motor {:.2}, of the drive motor {:.2}; fix {:?}",
            state.north,
            state.east,
            state.heading.to_degrees(),
            state.steering.to_degrees(),
            state.speed,
            state.steering_effort,
            state.drive_effort,
            state.fix
        );
    }
    if let Some(sample) = world.drive().and_then(|drive| drive.samples().last()) {
        let [left, right] = sample.distances.map(|distance| match distance {
            Some(metres) => format!("{metres:.3} m"),
            None => "nothing".to_owned(),
        });
        let _ = writeln!(
            text,
            "{:.3} m along the row, {:.3} m right of its middle, heading {:.2} deg right of it\n\
             efforts of the motors {:.2} and {:.2}; the sensors see {left} on the left, {right} on the right",
            sample.station,
            sample.right,
            sample.heading.to_degrees(),
            sample.efforts[0],
            sample.efforts[1]
        );
    }
    text
}
