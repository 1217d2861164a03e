//! Compares the emulated core with QEMU: the kernels of `kernels/kernels.rs` leave the same words
//! in memory as on QEMU's Cortex-M4. `kernels/generate.sh` built the image and recorded QEMU's
//! results, so this test needs neither a compiler for the target nor QEMU.

use std::sync::Arc;
use twin::image::Image;
use twin::mcu::{Board, FlashTiming, Mcu};
use twin::part::Part;

const IMAGE: &str = include_str!("../kernels/image.hex");
const RESULTS: &str = include_str!("../kernels/results.hex");

/// Where the kernels leave their results.
const RESULTS_AT: u32 = 0x2000_4000;

const NAMES: [&str; 9] = [
    "division",
    "crc",
    "sort",
    "floats",
    "doubles",
    "signal",
    "jumps",
    "memory",
    "exceptions",
];

fn words(hex: &str) -> Vec<u32> {
    hex.split_whitespace()
        .map(|word| u32::from_str_radix(word, 16).expect("a hexadecimal word"))
        .collect()
}

/// The results of the kernels by their number (from 1), split at their headers.
fn by_kernel(words: &[u32]) -> Vec<(u32, &[u32])> {
    let mut rest = words;
    let mut kernels = Vec::new();
    while let [head, tail @ ..] = rest {
        let (own, others) = tail.split_at((head & 0xFFFF) as usize);
        kernels.push((head >> 16, own));
        rest = others;
    }
    kernels
}

#[test]
fn the_kernels_compute_what_they_compute_on_qemu() {
    compare(FlashTiming::Immediate);
}

#[test]
fn waiting_for_the_flash_changes_no_result() {
    compare(FlashTiming::WaitStates);
}

fn compare(flash: FlashTiming) {
    let code: Vec<u8> = words(IMAGE)
        .into_iter()
        .flat_map(u32::to_le_bytes)
        .collect();
    let image = Image::from_code(Part::F446, &code).expect("the kernels fit");
    let board = Board {
        flash,
        ..Board::default()
    };
    let mut mcu = Mcu::new(Arc::new(image), &board, None);
    let expected = words(RESULTS);
    let (&count, expected) = expected.split_first().expect("results");
    assert_eq!(expected.len(), count as usize);

    let result = |mcu: &Mcu, index: u32| {
        let bytes = mcu.memory(RESULTS_AT + 4 * index, 4).expect("RAM");
        u32::from_le_bytes(bytes.try_into().expect("four bytes"))
    };
    for _ in 0..100 {
        mcu.run_for(can_bus::SimDuration::from_ticks(1_000_000_000));
        if result(&mcu, 0) != 0 {
            break;
        }
    }
    assert_eq!(
        result(&mcu, 0),
        count,
        "the program came to its end; bus faults {:x?}",
        mcu.bus_faults()
    );
    let seen: Vec<u32> = (1..=count).map(|k| result(&mcu, k)).collect();
    let (seen, expected) = (by_kernel(&seen), by_kernel(expected));
    assert_eq!(expected.len(), NAMES.len());
    let mut differences = Vec::new();
    for ((number, ours), (_, qemus)) in seen.iter().zip(&expected) {
        let name = NAMES[*number as usize - 1];
        assert_eq!(ours.len(), qemus.len(), "{name}");
        for (k, (a, b)) in ours.iter().zip(*qemus).enumerate() {
            if a != b {
                differences.push(format!("{name}[{k}]: {a:08x}, QEMU {b:08x}"));
            }
        }
    }
    assert!(differences.is_empty(), "{}", differences.join("\n"));
}
