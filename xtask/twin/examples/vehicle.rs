//! Runs a scenario of a vehicle with the images of a folder and prints what happened:
//! `cargo run --profile host -p twin --example vehicle -- VEHICLE FOLDER SCENARIO SECONDS
//! [frames] [wait]`. `frames` prints each frame, with `wait` the flash has wait states.

use can_bus::{RecordKind, SimDuration};
use twin::mcu::FlashTiming;
use twin::{Images, Options};
use vehicle_model::Vehicle;
use world::Scenario;

fn refuse(why: impl std::fmt::Display) -> ! {
    eprintln!("{why}");
    std::process::exit(2);
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [vehicle, folder, name, seconds, ..] = &arguments[..] else {
        refuse("wanted: a vehicle's folder, the folder of the ELF files, a scenario, seconds");
    };
    let vehicle = Vehicle::read(vehicle.as_ref()).unwrap_or_else(|error| refuse(error));
    let files = vehicle.manifest().nodes.iter().map(|node| {
        let path = std::path::Path::new(folder).join(&node.name);
        let file = std::fs::read(&path);
        file.unwrap_or_else(|error| refuse(format!("{}: {error}", path.display())))
    });
    let images = Images::new(files.collect());
    let scenario = Scenario::find(&vehicle, name).unwrap_or_else(|error| refuse(error));
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
    let outcome = twin::run(&vehicle, &scenario, &images, &options, |_| {});
    let outcome = outcome.unwrap_or_else(|error| refuse(error));
    let wall = begin.elapsed().as_secs_f64();
    for record in &outcome.records {
        let ms = record.at.as_ticks() as f64 / 1e9;
        let node = outcome.node_at(record.node);
        let node = node.map_or("foreign", |node| outcome.nodes[node.0].name.as_str());
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
            node.name,
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
