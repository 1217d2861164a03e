//! Passes the linker script to the linker and writes the settings of the example vehicle.

use control::vehicle::source;

#[path = "../../tests/common/example.rs"]
mod example;

fn main() {
    let variable = |name| std::env::var(name).expect("cargo sets its variables");
    let here = variable("CARGO_MANIFEST_DIR");
    println!("cargo:rerun-if-changed=image.x");
    println!("cargo:rerun-if-changed=../../tests/common/example.rs");
    println!("cargo:rustc-link-arg-bins=-T{here}/image.x");
    let settings = format!(
        "const SETTINGS: Settings<f32> = {};",
        source(&example::settings())
    );
    std::fs::write(variable("OUT_DIR") + "/settings.rs", settings)
        .expect("cargo's folder can be written");
}
