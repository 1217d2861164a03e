//! Makes the crate's constants from the vehicle's folder.

fn main() -> std::process::ExitCode {
    vehicle_model::build::run()
}
