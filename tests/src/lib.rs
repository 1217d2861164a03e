//! Tests across the crates: what the release images do on emulated microcontrollers.

mod journey;
pub mod time;

pub use journey::{Journey, scenario};

use std::sync::OnceLock;
use twin::Images;
use world::Node;

/// The release images of the four nodes, built once for each test program as `cargo xtask
/// build` builds them.
///
/// # Panics
/// When they do not build; the sentence says why.
pub fn images() -> &'static Images {
    static IMAGES: OnceLock<Images> = OnceLock::new();
    IMAGES.get_or_init(|| {
        let workspace = xtask::Workspace::find().unwrap_or_else(|failure| panic!("{failure}"));
        let built = xtask::build::images(&workspace, &xtask::Node::ALL)
            .unwrap_or_else(|failure| panic!("{failure}"));
        let elf = |node: Node| {
            let image = built.iter().find(|image| image.node.name() == node.name());
            let image = image.unwrap_or_else(|| panic!("no image of {}", node.name()));
            std::fs::read(&image.path)
                .unwrap_or_else(|error| panic!("{}: {error}", image.path.display()))
        };
        Images {
            gps: elf(Node::Gps),
            controller: elf(Node::Controller),
            steering: elf(Node::Steering),
            drive: elf(Node::Drive),
        }
    })
}
