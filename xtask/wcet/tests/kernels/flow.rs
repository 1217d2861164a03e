//! Control flow, longest path and stack depth of kernels whose shape is known.

use std::collections::BTreeSet;

use crate::common::{PART, image_path, kernel};
use wcet::analysis::Analysis;
use wcet::annotation::Annotations;
use wcet::bound::Entry;
use wcet::cycles::Model;
use wcet::graph::{Graph, Returning, Targets};
use wcet::image::Image;
use wcet::kernels::INPUT;
use wcet::register::Register;
use wcet::stack::Stacks;

fn image() -> Image {
    Image::read(image_path()).unwrap()
}

fn annotations() -> Annotations {
    Annotations::new(std::path::Path::new(env!("CARGO_MANIFEST_DIR")))
}

fn graph(image: &Image, name: &str) -> Graph {
    let entry = kernel(image, name);
    Graph::build(image, entry, &Targets::new(), &mut Returning::default()).unwrap()
}

/// Blocks do not overlap, edges lead to first instructions of blocks, and a loop holds its header
/// and every loop inside it.
#[test]
fn graphs_are_consistent() {
    let image = image();
    for (entry, function) in image.functions() {
        let built = Graph::build(&image, entry, &Targets::new(), &mut Returning::default());
        let Ok(graph) = built else { continue };
        let name = &function.name;
        let mut seen = BTreeSet::new();
        for block in &graph.blocks {
            for instruction in &block.instructions {
                assert!(seen.insert(instruction.address), "{name}: in two blocks");
            }
            assert!(
                block
                    .successors
                    .iter()
                    .all(|next| *next < graph.blocks.len())
            );
        }
        for l in &graph.loops {
            assert!(l.blocks.contains(&l.header), "{name}");
            let first = l.blocks.first();
            assert_eq!(first, Some(&l.header), "{name}: nothing comes before it");
            let closes = |block: &usize| graph.blocks[*block].successors.contains(&l.header);
            assert!(l.blocks.iter().any(closes), "{name}: nothing leads back");
            if let Some(parent) = l.parent {
                assert!(l.blocks.is_subset(&graph.loops[parent].blocks), "{name}");
            }
        }
    }
}

/// Nested loops are found as such.
#[test]
fn nested_loops_are_found() {
    let image = image();
    let graph = graph(&image, "arrays::insertion_sort");
    assert!(graph.loops.iter().any(|l| l.parent.is_some()));
    let straight = self::graph(&image, "arithmetic::polynomial_f32");
    assert!(straight.loops.is_empty());
}

/// The integer program knows totals only, so its length is at least the clock of the abstract
/// machine. On code without choices the two are equal.
#[test]
fn the_longest_path_is_no_shorter_than_the_clock() {
    let image = image();
    let annotations = annotations();
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    for (name, exact) in [
        ("arithmetic::polynomial_f32", true),
        ("arrays::nested", true),
        ("arrays::matrix_i32", true),
        ("arrays::triangular", false),
        ("control::choices", false),
        ("text::decimal", false),
    ] {
        let entry = kernel(&image, name);
        let bound = analysis.run_with(entry, Entry::Function, &[(Register::R0, INPUT)]);
        let longest = analysis.longest_path(&bound, entry).unwrap();
        for model in Model::ALL {
            let (clock, path) = (bound.cycles[model], longest.cycles[model]);
            assert!(path >= clock, "{name}: {path} below {clock}");
            // Sums of real numbers are rounded up.
            assert!(
                !exact || model == Model::Flashed || path <= clock + clock / 50 + 2,
                "{name}: {path} above {clock}"
            );
        }
        assert!(!longest.path.is_empty(), "{name}");
    }
}

/// There is no longest path without a bound.
#[test]
fn no_path_without_a_bound() {
    let image = image();
    let annotations = annotations();
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    let entry = kernel(&image, "broken::endless_wait");
    let bound = analysis.run_with(entry, Entry::Function, &[(Register::R0, INPUT)]);
    assert!(!bound.problems.is_empty());
    assert!(analysis.longest_path(&bound, entry).is_none());
}

/// The depth by the call graph is at least the depth that the abstract machine reaches, and
/// recursion and calls through pointers are reported.
#[test]
fn stack_depth_covers_every_path() {
    let image = image();
    let annotations = annotations();
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    let mut stacks = Stacks::new(&image);
    for name in [
        "arrays::copy_all",
        "arrays::median",
        "arithmetic::polynomial_f64",
        "text::decimal",
        "control::state_machine",
    ] {
        let entry = kernel(&image, name);
        let bound = analysis.run_with(entry, Entry::Function, &[(Register::R0, INPUT)]);
        let depth = stacks.depth(entry);
        assert!(depth.unknown.is_empty(), "{name}: {:?}", depth.unknown);
        assert!(
            depth.bytes >= bound.stack,
            "{name}: {} below {}",
            depth.bytes,
            bound.stack
        );
    }
    // A copy of the input is on the stack.
    let copy = stacks.depth(kernel(&image, "arrays::copy_all"));
    assert!(copy.bytes >= 256, "{}", copy.bytes);
    let recursion = stacks.depth(kernel(&image, "broken::recursion"));
    assert!(
        recursion
            .unknown
            .iter()
            .any(|unknown| unknown.contains("recursion"))
    );
    let pointer = stacks.depth(kernel(&image, "broken::pointer_from_memory"));
    assert!(
        pointer
            .unknown
            .iter()
            .any(|unknown| unknown.contains("call through a pointer"))
    );
}
