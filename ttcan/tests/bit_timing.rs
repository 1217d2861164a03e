//! Bit timings for the clocks of the boards, and for many others.

use proptest::prelude::*;
use ttcan::{BitTiming, NoBitTiming};

#[test]
fn the_usual_clocks_have_a_timing() {
    // APB1 of an F446 at 180 MHz, of an F303 at 72 MHz, and of one on HSI at
    // 64 MHz.
    for (clock, quanta, sample_point) in [
        (45_000_000, 20, 750),
        (36_000_000, 16, 750),
        (32_000_000, 16, 750),
    ] {
        let timing = BitTiming::bxcan(clock, 250_000).unwrap();
        assert_eq!(timing.bit_rate(clock), 250_000);
        assert_eq!(timing.quanta(), quanta, "{clock}");
        assert_eq!(timing.sample_point_per_mille(), sample_point, "{clock}");
    }
}

/// RM0390: BRP in bits 9..0, TS1 in 19..16, TS2 in 22..20, SJW in 25..24, each
/// less one.
#[test]
fn the_register_holds_each_setting_less_one() {
    let timing = BitTiming {
        prescaler: 9,
        segment_1: 14,
        segment_2: 5,
        jump_width: 4,
    };
    assert_eq!(timing.register(), 3 << 24 | 4 << 20 | 13 << 16 | 8);
}

#[test]
fn impossible_rates_are_refused() {
    assert_eq!(BitTiming::bxcan(45_000_000, 0), Err(NoBitTiming));
    assert_eq!(BitTiming::bxcan(45_000_000, 800_000), Err(NoBitTiming));
    assert_eq!(BitTiming::bxcan(1_000_000, 1_000_000), Err(NoBitTiming));
}

proptest! {
    #[test]
    fn what_is_found_is_exact_and_within_range(
        clock in 1_000_000u32..200_000_000,
        rate in prop::sample::select(vec![10_000, 50_000, 125_000, 250_000, 500_000, 1_000_000]),
    ) {
        // Only a clock that is a multiple of the bit rate has an exact timing.
        let clock = clock / rate * rate;
        if let Ok(timing) = BitTiming::bxcan(clock, rate) {
            let bit = u32::from(timing.prescaler) * timing.quanta();
            prop_assert_eq!(bit * rate, clock);
            prop_assert!((700..=800).contains(&timing.sample_point_per_mille()));
            prop_assert!((1..=1024).contains(&timing.prescaler));
            prop_assert!((1..=16).contains(&timing.segment_1));
            prop_assert!((1..=8).contains(&timing.segment_2));
            prop_assert!((1..=4).contains(&timing.jump_width));
            prop_assert!(timing.jump_width <= timing.segment_2);
        }
    }
}

/// The example of ISO 11898-1 for a segment 2 of a quarter of the bit: a good hundredth; a jump
/// width of one quantum halves what the edges allow and more.
#[test]
fn the_tolerance_of_an_oscillator_follows_from_jump_width_and_segments() {
    let timing = |segment_1, segment_2, jump_width| BitTiming {
        prescaler: 1,
        segment_1,
        segment_2,
        jump_width,
    };
    // 16 quanta: 4 / (20 * 16) = 1.25 %, 4 / (2 * (208 - 4)) = 0.98 %.
    assert_eq!(timing(11, 4, 4).tolerance_ppm(), 9803);
    // 1 / 320.
    assert_eq!(timing(11, 4, 1).tolerance_ppm(), 3125);
    // 8 quanta: 2 / 160 = 1.25 %, 2 / (2 * (104 - 2)) = 0.98 %.
    assert_eq!(timing(5, 2, 2).tolerance_ppm(), 9803);
}
