//! Schedule synthesis: every plan is a valid matrix and keeps periods and shares.

use proptest::prelude::*;
use ttcan::synthesis::{Infeasible, Message, Plan, Wishes, least_jitter, power_of_two};
use ttcan::{Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window};

const NETWORK: MatrixConfig = MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: Micros::millis(1),
    cycles: 1,
    reference: Id::constant::<0>(),
    reference_format: ReferenceFormat::LEVEL_2,
    masters: &[NodeId(0), NodeId(1)],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::micros(0),
    windows: &[],
    events: &[],
};

fn message(name: &str, number: u16, len: u8, period: u32) -> Message {
    Message {
        name: name.into(),
        id: Id::standard(16 + number).unwrap(),
        len,
        sender: NodeId(number % 5),
        period: Micros::millis(period),
        deadline: Micros::millis(period),
        after: Vec::new(),
        gap: Micros::micros(0),
    }
}

/// Both methods keep windows behind those of the messages that must come first, although a
/// short period and a long frame would place them before.
#[test]
fn windows_follow_those_of_the_messages_before_them() {
    let mut messages = [
        message("command", 0, 8, 10),
        message("sensor", 1, 2, 20),
        message("position", 2, 8, 10),
    ];
    messages[0].after = vec![1, 2];
    messages[0].gap = Micros::micros(600);
    for method in [power_of_two, least_jitter] {
        let plan = method(&NETWORK, &messages, &Wishes::NONE).unwrap();
        let starts = verify(&plan, &messages);
        let cycle = plan.basic_cycle.ticks();
        for first in [1, 2] {
            for start in &starts[first] {
                let mut commands = starts[0].iter();
                let command = commands.find(|other| *other / cycle == start / cycle);
                assert!(
                    command.is_none_or(|command| command >= &(start + 600)),
                    "{plan:?}"
                );
            }
        }
    }
    messages[1].after = vec![0];
    let refused = power_of_two(&NETWORK, &messages, &Wishes::NONE).unwrap_err();
    let message = "command".into();
    assert_eq!(refused, Infeasible::Sequence { message });
}

/// Checks the plan as a matrix. Returns the starts of each message in it.
fn verify(plan: &Plan, messages: &[Message]) -> Vec<Vec<u32>> {
    let windows: Vec<Window> = plan.windows(messages);
    let config = MatrixConfig {
        basic_cycle: plan.basic_cycle,
        cycles: plan.cycles,
        windows: &windows,
        ..NETWORK
    };
    if let Err(error) = SystemMatrix::new(config) {
        panic!("{error}");
    }
    (0..messages.len())
        .map(|index| {
            let mut starts: Vec<u32> = (0..plan.cycles)
                .flat_map(|cycle| {
                    plan.windows
                        .iter()
                        .filter(move |window| {
                            window.message == Some(index) && cycle % window.repeat == window.offset
                        })
                        .map(move |window| {
                            u32::from(cycle) * plan.basic_cycle.ticks() + window.start.ticks()
                        })
                })
                .collect();
            starts.sort_unstable();
            starts
        })
        .collect()
}

/// Checks that every time between two transmissions differs from the period by at
/// most the jitter, also across the end of the matrix.
fn assert_periodic(plan: &Plan, starts: &[Vec<u32>]) {
    let matrix = plan.basic_cycle.ticks() * u32::from(plan.cycles);
    for (index, starts) in starts.iter().enumerate() {
        let period = plan.periods[index].ticks();
        let jitter = plan.jitter[index].ticks();
        assert_eq!(starts.len() as u32, matrix / period);
        for (at, start) in starts.iter().enumerate() {
            let next = starts.get(at + 1).copied().unwrap_or(starts[0] + matrix);
            let gap = next - start;
            assert!(gap.abs_diff(period) <= jitter, "{gap} instead of {period}");
        }
    }
}

/// The example of thesis Figure 4.10: three frequencies with ratios of powers of
/// two.
fn figure_4_10() -> Vec<Message> {
    vec![
        message("A", 0, 8, 10),
        message("B", 1, 8, 10),
        message("C", 2, 8, 20),
        message("D", 3, 8, 20),
        message("E", 4, 8, 40),
    ]
}

#[test]
fn powers_of_two_as_in_the_thesis() {
    let messages = figure_4_10();
    let plan = power_of_two(&NETWORK, &messages, &Wishes::NONE).unwrap();
    assert_eq!(plan.basic_cycle, Micros::millis(10));
    assert_eq!(plan.cycles, 4, "the highest frequency by the lowest");
    let starts = verify(&plan, &messages);
    assert_periodic(&plan, &starts);
    assert!(plan.jitter.iter().all(|jitter| jitter.ticks() == 0));
    let repeats: Vec<u8> = plan.windows.iter().map(|window| window.repeat).collect();
    assert_eq!(plan.windows.len(), 5, "one window each: {repeats:?}");
}

#[test]
fn periods_that_are_no_powers_of_two_are_shortened_or_kept() {
    let messages = [message("fast", 0, 8, 10), message("odd", 1, 8, 30)];
    let plan = power_of_two(&NETWORK, &messages, &Wishes::NONE).unwrap();
    assert_eq!(plan.periods[1], Micros::millis(20));
    assert_periodic(&plan, &verify(&plan, &messages));
    let plan = least_jitter(&NETWORK, &messages, &Wishes::NONE).unwrap();
    assert_eq!(plan.periods[1], Micros::millis(30));
    assert_periodic(&plan, &verify(&plan, &messages));
    assert!(plan.jitter.iter().all(|jitter| jitter.ticks() == 0));
}

#[test]
fn shares_are_kept() {
    let messages = figure_4_10();
    let wishes = Wishes {
        arbitrating_per_mille: 200,
        free_per_mille: 300,
        ..Wishes::NONE
    };
    for plan in [
        power_of_two(&NETWORK, &messages, &wishes).unwrap(),
        least_jitter(&NETWORK, &messages, &wishes).unwrap(),
    ] {
        verify(&plan, &messages);
        assert!(plan.share_per_mille(true) >= 200);
    }
    let greedy = Wishes {
        arbitrating_per_mille: 900,
        ..Wishes::NONE
    };
    assert!(matches!(
        power_of_two(&NETWORK, &messages, &greedy),
        Err(Infeasible::Arbitrating { .. })
    ));
    let airy = Wishes {
        free_per_mille: 900,
        ..Wishes::NONE
    };
    assert!(matches!(
        least_jitter(&NETWORK, &messages, &airy),
        Err(Infeasible::Free { .. })
    ));
}

#[test]
fn the_message_that_does_not_fit_is_named() {
    // There is room for the reference and thirteen windows of eight bytes in 10 ms.
    let mut messages: Vec<Message> = (0..13)
        .map(|number| message("small", number, 8, 10))
        .collect();
    assert!(power_of_two(&NETWORK, &messages, &Wishes::NONE).is_ok());
    messages.push(message("one too many", 13, 8, 20));
    messages.push(message("two too many", 14, 8, 20));
    messages.push(message("three too many", 15, 8, 20));
    // With basic cycles of 20 ms the second method would need one reference less,
    // and would have room.
    let short = Wishes {
        longest_cycle: Micros::millis(10),
        ..Wishes::NONE
    };
    for error in [
        power_of_two(&NETWORK, &messages, &Wishes::NONE).unwrap_err(),
        least_jitter(&NETWORK, &messages, &short).unwrap_err(),
    ] {
        assert!(error.to_string().contains("too many"), "{error}");
    }
    let mut urgent = message("urgent", 0, 8, 10);
    urgent.deadline = Micros::micros(500);
    let error = power_of_two(&NETWORK, &[urgent], &Wishes::NONE).unwrap_err();
    assert_eq!(
        error.to_string(),
        "message `urgent` needs a window of 624 us, longer than its period or deadline"
    );
    let odd = [message("a", 0, 1, 997), message("b", 1, 1, 1009)];
    let error = least_jitter(&NETWORK, &odd, &Wishes::NONE).unwrap_err();
    assert_eq!(
        error,
        Infeasible::NoCommonCycle {
            message: "b".into()
        }
    );
    assert_eq!(
        power_of_two(&NETWORK, &[], &Wishes::NONE),
        Err(Infeasible::Empty)
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]
    #[test]
    fn every_plan_is_a_valid_matrix(
        drawn in prop::collection::vec((0u8..=8, prop::sample::select(vec![10, 20, 30, 40, 50, 60, 80, 100])), 1..16),
        arbitrating in 0u16..300,
        grain in prop::sample::select(vec![1u32, 100, 1000]),
    ) {
        let messages: Vec<Message> = drawn
            .iter()
            .enumerate()
            .map(|(number, (len, period))| message("m", number as u16, *len, *period))
            .collect();
        let wishes = Wishes {
            grain: Micros::micros(grain),
            arbitrating_per_mille: arbitrating,
            longest_cycle: Micros::millis(200),
            ..Wishes::NONE
        };
        for plan in [
            power_of_two(&NETWORK, &messages, &wishes),
            least_jitter(&NETWORK, &messages, &wishes),
        ].into_iter().flatten() {
            let starts = verify(&plan, &messages);
            assert_periodic(&plan, &starts);
            // Shares consist of whole windows, and are rounded down.
            prop_assert!(plan.share_per_mille(true) + 1 >= u32::from(arbitrating));
            for (index, message) in messages.iter().enumerate() {
                prop_assert!(plan.periods[index] <= message.period);
            }
        }
    }
}
