//! Runs one image alone and reports what it did:
//!
//! `cargo run --profile host -p twin --example one_node -- f446 path/to/gps 2 [internal] [wait]`.
//!
//! With `internal` its OSC_IN is not connected; with `wait` its flash has wait states.

use can_bus::SimTime;
use std::sync::Arc;
use twin::image::Image;
use twin::mcu::{Board, FlashTiming, Mcu};
use twin::part::Part;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [part, path, seconds, others @ ..] = &arguments[..] else {
        refuse("wanted: f446|f303, the ELF file, seconds to run");
    };
    let part = match part.as_str() {
        "f446" => Part::F446,
        "f303" => Part::F303,
        other => refuse(&format!("{other} is neither f446 nor f303")),
    };
    let elf = std::fs::read(path).unwrap_or_else(|error| refuse(&format!("{path}: {error}")));
    let image =
        Image::from_elf(part, &elf).unwrap_or_else(|error| refuse(&format!("{path}: {error}")));
    let image = Arc::new(image);
    let bus = Arc::new(std::sync::Mutex::new(can_bus::Bus::new()));
    let wanted = |word: &str| others.iter().any(|other| other == word);
    let board = Board {
        external_clock: (!wanted("internal")).then_some(8_000_000),
        flash: if wanted("wait") {
            FlashTiming::WaitStates
        } else {
            FlashTiming::Immediate
        },
        ..Board::default()
    };
    let mut mcu = Mcu::new(image, &board, Some(&bus));
    let begin = std::time::Instant::now();
    let milliseconds = match seconds.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 => (seconds * 1000.0) as u64,
        _ => refuse(&format!("{seconds} is no number of seconds")),
    };
    for ms in 0..milliseconds {
        let until = SimTime::from_ticks((ms + 1) * 1_000_000_000);
        while mcu.now() < until {
            mcu.run_until(until);
        }
        bus.lock().unwrap().advance_to(until);
        mcu.bus_moved();
    }
    report(&mut mcu, milliseconds, begin.elapsed());
}

fn report(mcu: &mut Mcu, milliseconds: u64, wall: std::time::Duration) {
    println!(
        "{} s in {:.3} s wall; core at {} Hz, pc {:#x} in {:?}, exception {}, asleep {}, locked up {}",
        milliseconds as f64 / 1000.0,
        wall.as_secs_f64(),
        mcu.core_hz(),
        mcu.pc(),
        mcu.image().function_at(mcu.pc()),
        mcu.exception(),
        mcu.is_asleep(),
        mcu.is_locked_up()
    );
    println!(
        "bus faults {:x?}, unmodelled {:x?}",
        mcu.bus_faults(),
        mcu.unmodelled()
    );
    println!("resets {:?}", mcu.resets());
    for change in mcu.drain_pins().iter().take(20) {
        println!(
            "{} us {} {}",
            change.at.as_ticks() / 1_000_000,
            change.pin,
            change.high
        );
    }
    let bytes = mcu.drain_uart();
    println!("{} bytes on UARTs", bytes.len());
    for n in 1..=3 {
        let line: Vec<u8> = bytes
            .iter()
            .filter(|b| b.usart == n)
            .map(|b| b.byte)
            .collect();
        if !line.is_empty() {
            let baud = bytes.iter().find(|b| b.usart == n).map(|b| b.baud);
            println!(
                "USART{n} at {baud:?}: {}",
                String::from_utf8_lossy(&line[..line.len().min(1000)])
            );
        }
    }
    let load = mcu.load();
    for task in &load.tasks {
        println!("{task:?}");
    }
    println!(
        "thread {} asleep {} switching {}: {:.3} %",
        load.thread,
        load.asleep,
        load.switching,
        100.0 * load.utilisation()
    );
}

fn refuse(why: &str) -> ! {
    eprintln!("error: {why}");
    std::process::exit(2)
}
