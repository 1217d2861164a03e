//! Asks for the linker scripts of the images, cortex-m-rt's and defmt's, sets what is
//! logged, and turns the vehicle file into constants.

use std::{env, fs, path::Path};

use control::controller::Settings;
use toml::{Table, Value};

#[path = "src/vehicle.rs"]
mod description;

fn main() {
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        println!("cargo:rustc-link-arg-bins=--nmagic");
        println!("cargo:rustc-link-arg-bins=-Tlink.x");
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
    // What a listening probe is told, unless the builder asks for more or less.
    println!("cargo:rerun-if-env-changed=DEFMT_LOG");
    if env::var_os("DEFMT_LOG").is_none() {
        println!("cargo:rustc-env=DEFMT_LOG=info");
    }
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed={VEHICLE}");
    println!("cargo:rerun-if-changed=src/vehicle.rs");
    match vehicle().and_then(|constants| Ok(constants + &settings()?)) {
        Ok(constants) => {
            let folder = env::var_os("OUT_DIR").expect("cargo names the folder for what is made");
            fs::write(Path::new(&folder).join("vehicle.rs"), constants)
                .expect("cargo's folder can be written");
        }
        Err(what) => {
            eprintln!("error: {VEHICLE}: {what}");
            std::process::exit(1);
        }
    }
}

/// The settings of the control law, derived from the vehicle's description.
fn settings() -> Result<String, String> {
    let settings =
        Settings::for_vehicle(&description::VEHICLE).map_err(|refusal| refusal.to_string())?;
    Ok(format!(
        "/// Settings of the control law for [`VEHICLE`].\n\
         pub const SETTINGS: ::control::controller::Settings<f32> = {};\n",
        control::vehicle::source(&settings)
    ))
}

/// The vehicle file, beside this program.
const VEHICLE: &str = "vehicle.toml";
/// Farthest that an intact steering can be from straight ahead, degrees.
const MECHANICAL_RANGE: f64 = 35.0;
/// Full scale of the converter.
const FULL_SCALE: f64 = 4095.0;

/// The constants of the vehicle file.
fn vehicle() -> Result<String, String> {
    let text = fs::read_to_string(VEHICLE).map_err(|error| error.to_string())?;
    let file: Table = text
        .parse()
        .map_err(|error: toml::de::Error| error.to_string())?;
    let centre = number(&file, "potentiometer.centre", 0.0..=FULL_SCALE)?;
    let slope = number(&file, "potentiometer.counts_per_degree", -80.0..=80.0)?;
    let range = (slope * MECHANICAL_RANGE).abs();
    if range < MECHANICAL_RANGE || centre < range || centre + range > FULL_SCALE {
        return Err(format!(
            "a potentiometer with {centre} counts straight ahead and {slope} counts for a \
             degree does not cover {MECHANICAL_RANGE} degrees to each side"
        ));
    }
    let direction = |name: &str| {
        let band = number(&file, &format!("steering.{name}.dead_band"), 0.0..=0.5)?;
        let rate = number(&file, &format!("steering.{name}.full_rate"), 1.0..=180.0)?;
        Ok::<_, String>(format!(
            "Direction {{ dead_band: {band:?}, full_rate: {rate:?} * DEGREE }}"
        ))
    };
    let (right, left) = (direction("right")?, direction("left")?);
    Ok(format!(
        "/// The steering potentiometer (thesis 5.2.6, Figure 5.18). An intact one cannot leave\n\
         /// the mechanical range of some {MECHANICAL_RANGE} degrees to each side.\n\
         pub const POTENTIOMETER: Potentiometer<f32> = Potentiometer {{\n\
         centre: {centre:?},\ncounts_per_radian: {slope:?} / DEGREE,\n\
         lowest: {},\nhighest: {},\n}};\n\
         /// The steering actuator on its motor driver (thesis 5.2.6, Figure 5.20).\n\
         pub const STEERING_ACTUATOR: Actuator<f32> = Actuator {{\n\
         positive: {right},\nnegative: {left},\n}};\n",
        (centre - range).round() as u16,
        (centre + range).round() as u16,
    ))
}

/// The number at `path`, which must be in `range`.
fn number(file: &Table, path: &str, range: std::ops::RangeInclusive<f64>) -> Result<f64, String> {
    let mut parts = path.split('.');
    let mut value = parts.next().and_then(|part| file.get(part));
    for part in parts {
        value = value.and_then(|value| value.get(part));
    }
    let number = match value {
        Some(Value::Float(number)) => *number,
        Some(Value::Integer(number)) => *number as f64,
        Some(_) => return Err(format!("{path} is not a number")),
        None => return Err(format!("{path} is missing")),
    };
    if range.contains(&number) {
        Ok(number)
    } else {
        let (least, most) = range.into_inner();
        Err(format!("{path} is {number}: {least} to {most} is accepted"))
    }
}
