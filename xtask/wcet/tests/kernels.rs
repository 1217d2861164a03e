//! Bounds of the kernels against the times on an emulated core.

mod common;
#[path = "kernels/ends.rs"]
mod ends;
#[path = "kernels/flow.rs"]
mod flow;
#[path = "kernels/lasting.rs"]
mod lasting;
#[path = "kernels/masked.rs"]
mod masked;
#[path = "kernels/received.rs"]
mod received;

use std::collections::HashMap;
use std::path::Path;

use common::{Emulator, PART, SMALL_PART, image_path, kernel, small_image_path};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use wcet::analysis::Analysis;
use wcet::annotation::Annotations;
use wcet::bound::{Bound, Entry, Problem};
use wcet::image::Image;
use wcet::kernels::{self, INPUT};
use wcet::register::Register;

use wcet::watch::{Refuted, Watch};

/// Runs of each kernel: the full check takes ten thousand.
fn runs() -> u64 {
    std::env::var("KERNEL_RUNS")
        .ok()
        .and_then(|runs| runs.parse().ok())
        .unwrap_or(60)
}

fn analyse(analysis: &mut Analysis<'_>, name: &str) -> Bound {
    let entry = kernel(analysis.image(), name);
    analysis.run_with(entry, Entry::Function, &[(Register::R0, INPUT)])
}

/// The path must be in the graph, and no block may run more often than the analysis found
/// possible.
fn check_path(
    analysis: &mut Analysis<'_>,
    bound: &Bound,
    executed: &HashMap<u32, u64>,
    name: &str,
) {
    let mut allowed: HashMap<u32, u64> = HashMap::new();
    for (id, visits) in &bound.facts.visits {
        let graph = analysis.graph(id.function).unwrap();
        for instruction in &graph.blocks[id.block].instructions {
            *allowed.entry(instruction.address).or_default() += visits;
        }
    }
    for (address, count) in executed {
        let most = allowed.get(address).copied().unwrap_or(0);
        assert!(
            *count <= most,
            "{name}: {} runs {count} times, {most} allowed",
            analysis.image().describe(*address)
        );
    }
}

#[test]
fn bounds_hold_on_the_emulator() {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    let emulator = Emulator::new(&image);
    let mut ratios = Vec::new();
    let mut unbounded = Vec::new();
    println!(
        "{:32} {:>8} {:>8} {:>6} {:>8}",
        "kernel", "seen", "bound", "ratio", "flash"
    );
    for name in kernels::NAMES {
        let bound = analyse(&mut analysis, name);
        if !bound.problems.is_empty() {
            unbounded.push((name, bound.problems));
            continue;
        }
        let entry = kernel(&image, name);
        let watch = Watch::new(&mut analysis, entry, &bound);
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let mut longest = 0;
        for run in 0..runs() {
            let words = kernels::input(|| random.next_u32(), run);
            // The path itself is checked on the first runs only.
            let mut executed: HashMap<u32, u64> = HashMap::new();
            let cycles = if run < 60 {
                let mut activation = watch.activation();
                let cycles = emulator.call(entry, &words, |pc| {
                    *executed.entry(pc).or_default() += 1;
                    let seen = watch.see(&mut activation, pc);
                    assert_eq!(seen, Ok(()), "{name}");
                });
                check_path(&mut analysis, &bound, &executed, name);
                cycles
            } else {
                emulator.call(entry, &words, |_| {})
            };
            longest = longest.max(cycles);
        }
        let ratio = bound.cycles.zero_wait as f64 / longest as f64;
        println!(
            "{name:32} {longest:8} {:8} {ratio:6.3} {:8}",
            bound.cycles.zero_wait, bound.cycles.flashed
        );
        assert!(
            longest <= bound.cycles.zero_wait,
            "{name}: {longest} cycles seen, bound {}",
            bound.cycles.zero_wait
        );
        assert!(bound.cycles.flashed >= bound.cycles.zero_wait, "{name}");
        ratios.push(ratio);
    }
    assert!(unbounded.is_empty(), "{unbounded:?}");
    ratios.sort_by(f64::total_cmp);
    let median = ratios[ratios.len() / 2];
    println!("median of bound over longest seen: {median:.3}");
    assert!(median <= 1.25, "{median}");
}

/// On a core that does not divide, the library does. The emulated core has all instructions of a Cortex-M0+, at other
/// costs; so no block may run more often than the analysis found possible, and the cycles are not compared.
#[test]
fn library_loops_take_no_more_turns_than_they_are_known_to() {
    let image = Image::read(small_image_path()).unwrap();
    let annotations = Annotations::new(Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, &SMALL_PART);
    let emulator = Emulator::new(&image);
    let mut unbounded = Vec::new();
    // Tables in which the analysis does not know the index: it takes a remainder by the library for any word, and the
    // end of a table of jumps only from an instruction that this core does not have.
    let refused = ["control::pointer_table", "control::state_machine"];
    let is_known = |name: &&&str| !refused.contains(*name);
    for name in kernels::NAMES.iter().filter(is_known) {
        let bound = analyse(&mut analysis, name);
        if !bound.problems.is_empty() {
            unbounded.push((name, bound.problems));
            continue;
        }
        let entry = kernel(&image, name);
        let mut random = ChaCha8Rng::seed_from_u64(12);
        for run in 0..runs() {
            let words = kernels::input(|| random.next_u32(), run);
            let mut executed: HashMap<u32, u64> = HashMap::new();
            emulator.call(entry, &words, |pc| *executed.entry(pc).or_default() += 1);
            check_path(&mut analysis, &bound, &executed, name);
        }
    }
    assert!(unbounded.is_empty(), "{unbounded:#?}");
}

/// Code without a bound is refused, in a sentence that says where and why.
#[test]
fn programs_without_bound_are_refused() {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    for (name, sentence) in [
        (
            "broken::endless_wait",
            "has no bound: write `// loop-bound: N`",
        ),
        (
            "broken::spin_lock",
            "has no bound: write `// loop-bound: N`",
        ),
        (
            "broken::recursion",
            "recursion: kernels::broken::recursion::ackermann calls",
        ),
        ("broken::pointer_from_memory", "may go anywhere"),
        (
            "broken::never_left",
            "within its bound (10): give as many turns as it takes",
        ),
        (
            "broken::without_end",
            "within its bound (1): give as many turns as it takes",
        ),
    ] {
        let bound = analyse(&mut analysis, name);
        assert_eq!(bound.problems.len(), 1, "{name}: {:?}", bound.problems);
        let problem = bound.problems.first().unwrap().to_string();
        assert!(problem.contains(sentence), "{name}: {problem}");
    }
}

/// A program whose folder was moved names sources that are not there, so that nothing in them bounds its loops.
#[test]
fn a_source_that_is_not_there_is_named() {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(2)
        .unwrap();
    let image = Image::read(image_path()).unwrap().relative_to(workspace);
    let elsewhere = Annotations::new(&workspace.join("elsewhere"));
    let mut analysis = Analysis::new(&image, &elsewhere, &PART);
    let bound = analyse(&mut analysis, "arithmetic::greatest_divisor");
    let file = "xtask/wcet/kernels/src/arithmetic.rs".to_owned();
    let problems: Vec<_> = bound.problems.iter().collect();
    let [Problem::LoopWithoutSource { file: absent, .. }] = problems[..] else {
        panic!("{problems:?}");
    };
    assert_eq!(*absent, file);
    let sentence = problems[0].to_string();
    assert!(
        sentence.contains("is not there: build the program anew"),
        "{sentence}"
    );
}

/// A false annotation gives a false bound, and a run contradicts it.
#[test]
fn a_false_annotation_is_found_out() {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    let name = "broken::annotated_too_low";
    let bound = analyse(&mut analysis, name);
    assert!(bound.problems.is_empty(), "{:?}", bound.problems);
    assert!(!bound.annotated.is_empty());
    let entry = kernel(&image, name);
    let watch = Watch::new(&mut analysis, entry, &bound);
    let emulator = Emulator::new(&image);
    let refuted = |word: u32| {
        let mut activation = watch.activation();
        let mut found = None;
        let mut words = [0; 64];
        words[0] = word;
        emulator.call(entry, &words, |pc| {
            if found.is_none() {
                found = watch.see(&mut activation, pc).err();
            }
        });
        found
    };
    assert_eq!(refuted(0b101), None);
    match refuted(u32::MAX) {
        Some(refuted @ Refuted::Turns { .. }) => {
            let sentence = refuted.sentence(&image);
            let says = "took 4 turns, its annotation says at most 3";
            assert!(sentence.ends_with(says), "{sentence}");
        }
        other => panic!("{other:?}"),
    }
}

/// Control outside the control-flow graph is reported with the place that it reached.
#[test]
fn a_path_outside_of_the_graph_is_found_out() {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    let name = "arrays::binary_search";
    let bound = analyse(&mut analysis, name);
    let entry = kernel(&image, name);
    let watch = Watch::new(&mut analysis, entry, &bound);
    let mut activation = watch.activation();
    assert_eq!(watch.see(&mut activation, entry), Ok(()));
    let elsewhere = kernel(&image, "arrays::median");
    let refuted = watch.see(&mut activation, elsewhere).unwrap_err();
    assert_eq!(refuted, Refuted::Outside(elsewhere));
    let sentence = refuted.sentence(&image);
    assert!(sentence.starts_with("control reached "), "{sentence}");
    assert!(sentence.contains("arrays.rs:"), "{sentence}");
}
