//! Passes the linker script to the linker and writes the settings of the control law: those of
//! the file that `CONTROL_SETTINGS` names, or the example vehicle's.

use control::vehicle::source;

#[path = "../../tests/common/example.rs"]
mod example;

fn main() {
    let variable = |name| std::env::var(name).expect("cargo sets its variables");
    let here = variable("CARGO_MANIFEST_DIR");
    println!("cargo:rerun-if-changed=image.x");
    println!("cargo:rerun-if-changed=../../tests/common/example.rs");
    println!("cargo:rustc-link-arg-bins=-T{here}/image.x");
    println!("cargo:rerun-if-env-changed=CONTROL_SETTINGS");
    let settings = match std::env::var("CONTROL_SETTINGS") {
        Ok(file) => {
            println!("cargo:rerun-if-changed={file}");
            std::fs::read_to_string(file).expect("the settings can be read")
        }
        Err(_) => source(&example::settings()).to_string(),
    };
    let settings = format!("const SETTINGS: Settings<f32> = {settings};");
    std::fs::write(variable("OUT_DIR") + "/settings.rs", settings)
        .expect("cargo's folder can be written");
}
