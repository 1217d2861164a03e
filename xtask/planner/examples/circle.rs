//! Drives the vehicle in a circle: `cargo run -p planner --example circle -- PORT CURVATURE SPEED`.
//!
//! PORT is an slcan adapter on a real bus, or the link of `cargo xtask sim --set planner.enabled=true --can slcan:LINK`.
//! CURVATURE is in 1/m, positive to the right, SPEED in m/s. The operator starts and ends the run.

use std::process::ExitCode;
use std::thread::sleep;
use std::time::Instant;

use can_bus::slcan::{Answer, Decoder, OPEN, encode};
use planner::{Demand, Error, Heard, Pace, Planner, vehicle};
use serial2::SerialPort;

/// Largest curvature that the message can say, 1/m.
const BEND: f64 = 2.0;

/// Largest speed that the message can say, m/s.
const FAST: f64 = 10.0;

/// The port and the demand of a command line.
///
/// # Errors
/// What is wrong with it, and what is accepted.
pub(crate) fn wanted(words: &[String]) -> Result<(&str, Demand<f64>), String> {
    let [port, curvature, speed] = words else {
        return Err(format!(
            "there are {} words, three are accepted: circle PORT CURVATURE SPEED",
            words.len()
        ));
    };
    let number = |name: &str, word: &String, least: f64, most: f64, unit: &str| {
        let number = word.parse::<f64>().ok();
        number
            .filter(|number| (least..=most).contains(number))
            .ok_or_else(|| format!("{name} is {word:?}, {least} to {most} {unit} is accepted"))
    };
    let demand = Demand {
        curvature: number("CURVATURE", curvature, -BEND, BEND, "1/m")?,
        speed: number("SPEED", speed, 0.0, FAST, "m/s")?,
    };
    Ok((port, demand))
}

/// Opens the port.
///
/// # Errors
/// Its name, and why it cannot be opened.
pub(crate) fn open(name: &str) -> Result<SerialPort, String> {
    SerialPort::open(name, 115_200).map_err(|error| {
        let why = match error.kind() {
            std::io::ErrorKind::WouldBlock | std::io::ErrorKind::ResourceBusy => {
                "another program has it".to_owned()
            }
            _ => error.to_string(),
        };
        format!(
            "PORT {name:?} cannot be opened: {why}; an slcan adapter or the link of `sim --can slcan:LINK` is accepted"
        )
    })
}

fn drive(port: &SerialPort, demand: Demand<f64>) -> Result<(), Box<dyn std::error::Error>> {
    let vehicle = vehicle("firmware/vehicles/uagv")?;
    let mut planner = Planner::of(&vehicle, None).map_err(|error: Error| error.to_string())?;
    if let Some(rate) = can_bus::slcan::bit_rate(vehicle.network().bit_rate) {
        port.write_all(rate.as_bytes())?;
    }
    port.write_all(OPEN.as_bytes())?;
    let mut decoder = Decoder::new();
    let mut bytes = [0; 256];
    let mut last = None;
    let (begin, mut pace) = (Instant::now(), Pace::default());
    loop {
        let count = match port.read(&mut bytes) {
            Ok(0) => return Ok(()),
            Ok(count) => count,
            Err(error) if error.kind() == std::io::ErrorKind::TimedOut => continue,
            Err(error) => return Err(error.into()),
        };
        for byte in &bytes[..count] {
            let Some(Answer::Frame { frame, .. }) = decoder.push(*byte) else {
                continue;
            };
            match planner.heard(&frame, begin.elapsed()) {
                Heard::Begin(slot) => {
                    let Some(wait) = pace.wait(begin.elapsed(), &slot) else {
                        continue;
                    };
                    sleep(wait);
                    if let Some(command) = planner.command::<can_bus::Frame>(demand) {
                        port.write_all(encode(&command).as_bytes())?;
                    }
                }
                Heard::Report(report) if last != Some(report.lead) => {
                    println!("{report:?}");
                    last = Some(report.lead);
                }
                Heard::Report(_) | Heard::Nothing => {}
            }
        }
    }
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let opened = wanted(&words).and_then(|(port, demand)| Ok((open(port)?, demand)));
    let (port, demand) = match opened {
        Ok(opened) => opened,
        Err(why) => {
            eprintln!("error: {why}");
            return ExitCode::from(2);
        }
    };
    match drive(&port, demand) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
