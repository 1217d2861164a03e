//! Passes the linker scripts of the image to the linker and sets the log level.

use std::env;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        // The scripts of cortex-m-rt, defmt and embedded-test.
        for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x", "-Tembedded-test.x"] {
            println!("cargo::rustc-link-arg-bins={argument}");
        }
    }
    println!("cargo::rustc-check-cfg=cfg(rust_analyzer)");
    println!("cargo::rerun-if-env-changed=DEFMT_LOG");
    if env::var_os("DEFMT_LOG").is_none() {
        println!("cargo::rustc-env=DEFMT_LOG=info");
    }
}
