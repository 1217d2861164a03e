//! Drives the vehicle in a circle: `cargo run -p planner --example circle -- PORT CURVATURE SPEED`.
//!
//! PORT is an slcan adapter on a real bus, or the link of `cargo xtask sim --set planner.enabled=true --can slcan:LINK`.
//! CURVATURE is in 1/m, positive to the right, SPEED in m/s. The operator starts and ends the run.

use std::process::ExitCode;
use std::thread::sleep;

use can_bus::slcan::{Answer, Decoder, OPEN, encode};
use planner::{Demand, Error, Heard, Planner, vehicle};
use serial2::SerialPort;

fn drive(port: &str, demand: Demand<f64>) -> Result<(), Box<dyn std::error::Error>> {
    let vehicle = vehicle("firmware/vehicles/uagv")?;
    let mut planner = Planner::of(&vehicle, None).map_err(|error: Error| error.to_string())?;
    let port = SerialPort::open(port, 115_200)?;
    if let Some(rate) = can_bus::slcan::bit_rate(vehicle.network().bit_rate) {
        port.write_all(rate.as_bytes())?;
    }
    port.write_all(OPEN.as_bytes())?;
    let mut decoder = Decoder::new();
    let mut bytes = [0; 256];
    let mut last = None;
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
            match planner.heard(&frame) {
                Heard::Begin(slot) => {
                    sleep(slot.earliest);
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
    let number = |word: &String| word.parse::<f64>().ok();
    let [port, curvature, speed] = words.as_slice() else {
        eprintln!("circle PORT CURVATURE SPEED");
        return ExitCode::from(2);
    };
    let (Some(curvature), Some(speed)) = (number(curvature), number(speed)) else {
        eprintln!("a curvature in 1/m and a speed in m/s are accepted");
        return ExitCode::from(2);
    };
    match drive(port, Demand { curvature, speed }) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
