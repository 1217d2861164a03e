//! CAN response times against Davis et al. (2007) and published tables.

use schedulability::can::{ErrorRate, Message, Overloaded, frame_time, response};

fn message(name: &str, length: u64, period: u64, deadline: u64) -> Message {
    Message {
        name: name.to_owned(),
        length,
        period,
        deadline,
        jitter: 0,
    }
}

#[test]
fn second_instance_is_the_worst() {
    // Davis et al. (2007), table 2: three messages of 135 bits, 1 ms each. The earlier analysis
    // gave 3.0 ms for C.
    let set = [
        message("A", 999_945, 2_500_000, 2_500_000),
        message("B", 999_945, 3_500_000, 3_250_000),
        message("C", 999_945, 3_500_000, 3_250_000),
    ];
    let bit = 7407;
    let bounds: Vec<u64> = (0..3)
        .map(|index| response(&set, index, bit, ErrorRate::NONE).unwrap())
        .collect();
    let rounded: Vec<u64> = bounds.iter().map(|ns| (ns + 50_000) / 100_000).collect();
    assert_eq!(rounded, [20, 30, 35]);
    assert!(bounds[1] <= set[1].deadline);
    assert!(bounds[2] > set[2].deadline, "C misses its deadline");
}

#[test]
fn seventeen_messages_at_250_kbit() {
    let bit = 4_000;
    let bytes = [1, 2, 1, 2, 1, 2, 6, 1, 2, 3, 1, 4, 1, 1, 3, 1, 1];
    let periods = [
        50, 5, 5, 5, 5, 5, 10, 10, 10, 10, 50, 100, 100, 100, 1000, 1000, 1000,
    ];
    let expected = [
        720, 1020, 1280, 1580, 1840, 2140, 2520, 2780, 3080, 3420, 3680, 4020, 4280, 4540, 4800,
        5060, 5060,
    ];
    let set: Vec<Message> = bytes
        .iter()
        .zip(periods)
        .map(|(&bytes, period)| {
            message(
                "",
                frame_time(bytes, bit),
                period * 1_000_000,
                period * 1_000_000,
            )
        })
        .collect();
    for (index, expected) in expected.into_iter().enumerate() {
        assert_eq!(
            response(&set, index, bit, ErrorRate::NONE),
            Ok(expected * 1000),
            "message {index}"
        );
    }
}

#[test]
fn an_error_costs_its_flag_and_the_frame() {
    let bit = 4_000;
    let set = [message("only", frame_time(8, bit), 10_000_000, 10_000_000)];
    let clean = response(&set, 0, bit, ErrorRate::NONE).unwrap();
    let burst = ErrorRate {
        burst: 2,
        interval: 0,
    };
    assert_eq!(
        response(&set, 0, bit, burst),
        Ok(clean + 2 * (31 * bit + frame_time(8, bit)))
    );
}

#[test]
fn overload_is_refused() {
    let set = [message("a", 600, 1000, 1000), message("b", 600, 1000, 1000)];
    assert_eq!(response(&set, 1, 1, ErrorRate::NONE), Err(Overloaded));
}
