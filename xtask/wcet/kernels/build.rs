//! Passes the linker script to the linker.

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").expect("cargo names the package's folder");
    println!("cargo:rerun-if-changed=kernels.x");
    println!("cargo:rustc-link-arg-bins=-T{here}/kernels.x");
}
