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
    assert_eq!(burst.to_string(), "2 disturbed frames");
    assert_eq!(
        response(&set, 0, bit, burst),
        Ok(clean + 2 * (31 * bit + frame_time(8, bit)))
    );
}

#[test]
fn a_rate_is_a_burst_in_any_interval() {
    let rate: ErrorRate = "2/100ms".parse().unwrap();
    assert_eq!(rate, ErrorRate::every(2, 100));
    let ms = 1_000_000;
    let counts = [1, 100 * ms, 100 * ms + 1, 250 * ms].map(|window| rate.errors(window));
    assert_eq!(counts, [2, 2, 4, 6]);
    assert_eq!(rate.to_string(), "2 disturbed frames in any 100 ms");
    assert_eq!("none".parse(), Ok(ErrorRate::NONE));
    assert_eq!(ErrorRate::NONE.errors(u64::MAX), 0);
    assert_eq!(ErrorRate::NONE.to_string(), "no disturbed frame");
    for wrong in [
        "",
        "2",
        "2/100",
        "0/100ms",
        "33/100ms",
        "2/0ms",
        "2/3600001ms",
        "-1/5ms",
    ] {
        let said = wrong.parse::<ErrorRate>().unwrap_err();
        assert!(
            said.contains("N/Mms or none is accepted"),
            "{wrong}: {said}"
        );
    }
}

#[test]
fn errors_cost_one_repetition_each_as_the_formula_says() {
    // Davis et al. (2007), section 6, worked out by hand for two messages of 540 us at 250 kbit/s: each
    // disturbed frame costs 31 bits and the longest frame.
    let bit = 4_000;
    let length = frame_time(8, bit);
    let set = [
        message("A", length, 100_000_000, 100_000_000),
        message("B", length, 100_000_000, 100_000_000),
    ];
    for burst in 0..5 {
        let errors = ErrorRate::every(burst, 100);
        let each = burst * (31 * bit + length);
        for index in 0..2 {
            let found = response(&set, index, bit, errors);
            assert_eq!(found, Ok(2 * length + each), "{index} with {burst}");
        }
    }
    // With ten milliseconds between the bursts, a second burst falls into the time that twenty frames
    // take.
    let slow = [
        message("A", 5_000_000, 100_000_000, 0),
        message("B", 5_000_000, 100_000_000, 0),
    ];
    let found = response(&slow, 1, bit, ErrorRate::every(1, 10));
    let clean = 2 * 5_000_000;
    let each = 31 * bit + 5_000_000;
    // Errors in 10 ms: 1; in 15.1 ms: 2; in 20.2 ms: 3; in 25.4 ms: 3.
    assert_eq!(found, Ok(clean + 3 * each));
}

#[test]
fn overload_is_refused() {
    let set = [message("a", 600, 1000, 1000), message("b", 600, 1000, 1000)];
    assert_eq!(response(&set, 1, 1, ErrorRate::NONE), Err(Overloaded));
}
