//! How handlers end that do not return.

use std::path::Path;

use crate::common::{PART, image_path, kernel};
use wcet::analysis::Analysis;
use wcet::annotation::Annotations;
use wcet::bound::{End, Entry};
use wcet::image::Image;

#[test]
fn the_end_of_a_handler_is_known() {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    for (name, returns, end) in [
        ("reset", false, "ends in a reset"),
        (
            "group",
            false,
            "ends in the endless loop at xtask/wcet/kernels/src/ends.rs:",
        ),
        (
            "stop",
            false,
            "ends at the breakpoint or undefined instruction at xtask/wcet/kernels/src/ends.rs:",
        ),
        (
            "maybe_return",
            true,
            "ends in the endless loop at xtask/wcet/kernels/src/ends.rs:",
        ),
    ] {
        let bound = analysis.run(kernel(&image, &format!("ends::{name}")), Entry::Fault);
        assert!(bound.problems.is_empty(), "{name}: {:?}", bound.problems);
        assert_eq!(bound.returns, returns, "{name}");
        let ends: Vec<&End> = bound.ends.iter().collect();
        let [one] = ends[..] else {
            panic!("{name}: {ends:?}")
        };
        let one = one.to_string();
        assert!(one.starts_with(end), "{name}: {one}");
    }
}
