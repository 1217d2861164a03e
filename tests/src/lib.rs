//! Tests across the crates: what the release images do on emulated microcontrollers.

mod journey;
pub mod nodes;
pub mod time;

pub use journey::{Journey, scenario};

use std::sync::OnceLock;
use twin::Images;
use vehicle_model::{Overrides, Vehicle};

/// The vehicle that is tested.
///
/// # Panics
/// When its folder has an error; the message names it.
pub fn vehicle() -> &'static Vehicle {
    static VEHICLE: OnceLock<Vehicle> = OnceLock::new();
    VEHICLE.get_or_init(|| {
        let workspace = xtask::Workspace::find().unwrap_or_else(|failure| panic!("{failure}"));
        let vehicle = xtask::vehicle::find(&workspace, "uagv");
        vehicle.unwrap_or_else(|failure| panic!("{failure}"))
    })
}

/// The release images of its nodes, as `cargo xtask build` makes them. Each test program builds
/// them only once.
///
/// # Panics
/// When they do not build; the message says why.
pub fn images() -> &'static Images {
    static IMAGES: OnceLock<Images> = OnceLock::new();
    IMAGES.get_or_init(|| {
        let workspace = xtask::Workspace::find().unwrap_or_else(|failure| panic!("{failure}"));
        let nodes: Vec<_> = vehicle().nodes().collect();
        let images = xtask::build::images(&workspace, vehicle(), &nodes)
            .and_then(|images| xtask::build::read(&images));
        images.unwrap_or_else(|failure| panic!("{failure}"))
    })
}

/// The vehicle that is tested with these values in place of its manifest's, as `mission.enabled=true`, and the release
/// images of that.
///
/// # Panics
/// When a value is not accepted or an image does not build; the message says why.
#[must_use]
pub fn with(set: &str) -> (Vehicle, Images) {
    of("uagv", set)
}

/// The same for another vehicle.
///
/// # Panics
/// As [`with`], or there is no such vehicle.
#[must_use]
pub fn of(name: &str, set: &str) -> (Vehicle, Images) {
    let build = || {
        let workspace = xtask::Workspace::find()?;
        let set = Overrides::parse(set).expect("values of the manifest");
        let vehicle = xtask::vehicle::with(&workspace, name, &set)?;
        let nodes: Vec<_> = vehicle.nodes().collect();
        let images = xtask::build::images(&workspace, &vehicle, &nodes)?;
        Ok((vehicle, xtask::build::read(&images)?))
    };
    build().unwrap_or_else(|failure: xtask::Failure| panic!("{failure}"))
}
