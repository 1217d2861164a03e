//! Runs a scenario with the images of a folder and prints what happened, frame by frame
//! if wanted: `cargo run --profile host -p twin --example vehicle -- FOLDER SCENARIO
//! SECONDS [frames] [wait]`; with `wait` the flash takes its time

use can_bus::{RecordKind, SimDuration};
use twin::mcu::FlashTiming;
use twin::{Images, Options};
use world::{Node, Scenario};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (folder, name, seconds) = match &arguments[..] {
        [folder, name, seconds, ..] => (folder, name, seconds),
        _ => {
            eprintln!("wanted: the folder of the ELF files, a scenario, seconds to run");
            std::process::exit(2);
        }
    };
    let elf = |node: Node| {
        let path = std::path::Path::new(folder).join(node.name());
        std::fs::read(&path).unwrap_or_else(|error| {
            eprintln!("{}: {error}", path.display());
            std::process::exit(2);
        })
    };
    let images = Images {
        gps: elf(Node::Gps),
        controller: elf(Node::Controller),
        steering: elf(Node::Steering),
        drive: elf(Node::Drive),
    };
    let scenario = Scenario::find(name).unwrap_or_else(|error| {
        eprintln!("{error}");
        std::process::exit(2);
    });
    let seconds: f64 = seconds.parse().unwrap_or(1.0);
    let options = Options {
        duration: Some(SimDuration::from_ticks((seconds * 1e12) as u64)),
        flash: if arguments.iter().any(|word| word == "wait") {
            FlashTiming::WaitStates
        } else {
            FlashTiming::Immediate
        },
        ..Options::default()
    };
    let begin = std::time::Instant::now();
    let outcome = match twin::run(&scenario, &images, &options, |_| {}) {
        Ok(outcome) => outcome,
        Err(error) => {
            eprintln!("{error}");
            std::process::exit(2);
        }
    };
    let wall = begin.elapsed().as_secs_f64();
    for record in &outcome.records {
        let ms = record.at.as_ticks() as f64 / 1e9;
        let node = outcome.node_at(record.node).map_or("foreign", Node::name);
        match &record.kind {
            RecordKind::FrameEnd { frame, start, .. }
                if arguments.iter().any(|word| word == "frames") =>
            {
                println!(
                    "{ms:12.4} ms {node:10} {:?} {:02x?} started {:.4}",
                    frame.id(),
                    frame.data(),
                    start.as_ticks() as f64 / 1e9
                )
            }
            RecordKind::FrameEnd { .. } | RecordKind::FrameStart { .. } => {}
            other => println!("{ms:12.4} ms {node:10} {other:?}"),
        }
    }
    for node in &outcome.nodes {
        println!(
            "{:10} {} MHz, awake {:.2} %, resets {:?}, locked up {}, unmodelled {:x?}",
            node.node.name(),
            node.core_hz / 1_000_000,
            100.0 * node.load.utilisation(),
            node.resets,
            node.locked_up,
            node.unmodelled
        );
        for task in &node.load.tasks {
            println!(
                "    {:16} {:8} times, longest {:6}, response {:6}",
                task.name, task.activations, task.longest, task.longest_response
            );
        }
        let console = String::from_utf8_lossy(&node.console);
        for line in console.lines().rev().take(3) {
            println!("    | {line}");
        }
    }
    println!("world: {:?}", outcome.world.counters());
    println!(
        "{seconds} s simulated in {wall:.2} s: {:.2} times real time",
        seconds / wall
    );
}
