//! The receiver's byte stream, decoded by the `sbp` crate.

mod uagv;

use sbp::messages::{Sbp, SbpMessage};
use world::receiver::{
    Fix, Inertial, InertialChange, Parameters, Receiver, StreamFault, StreamFaultKind, TimedByte,
    burst_seconds,
};
use world::time::seconds;
use world::units::{Angle, Length, Ppm, Ratio, Speed, Time};
use world::vehicle::{Attitude, Motion};

const LEVEL: Attitude = Attitude {
    roll: 0.0,
    pitch: 0.0,
    yaw: 0.0,
};

const STILL: Motion = Motion {
    north: 0.0,
    east: 0.0,
    height: 1.0,
    north_speed: 0.0,
    east_speed: 0.0,
    attitude: LEVEL,
};

fn parameters() -> Parameters {
    Parameters::of(uagv::vehicle().manifest().receiver.as_ref().unwrap())
}

fn exact() -> Parameters {
    Parameters {
        noise: Length::new(0.0),
        velocity_noise: Speed::new(0.0),
        latency_jitter: Time::new(0.0),
        clock: Some(Ppm::new(0.0)),
        phase: Some(Time::new(0.0)),
        ..parameters()
    }
}

fn decode(bytes: &[TimedByte]) -> Vec<Sbp> {
    let bytes: Vec<u8> = bytes.iter().map(|byte| byte.byte).collect();
    sbp::iter_messages(&bytes[..])
        .filter_map(Result::ok)
        .collect()
}

fn types(messages: &[Sbp]) -> Vec<u16> {
    messages
        .iter()
        .filter_map(|message| message.message_type())
        .collect()
}

#[test]
fn a_burst_is_what_the_thesis_measured() {
    let mut receiver = Receiver::new(exact(), Vec::new(), 0);
    let heartbeat_burst = receiver.measure(&STILL, Fix::Fixed);
    let burst = receiver.measure(&STILL, Fix::Fixed);
    assert_eq!(burst.len(), 296);
    // Thesis 6.2.4.3: "Data was sent to the microcontroller in 3.15 mS."
    assert!((burst_seconds(&exact()) - 3.15e-3).abs() < 1e-9);
    assert_eq!(heartbeat_burst.len(), 296 + 12);
    // First bit at 100 ms + 40 ms, first byte complete 10 us later.
    assert!((seconds(burst[0].at) - 0.140_010).abs() < 1e-12);
    assert_eq!(
        types(&decode(&burst)),
        [
            0x0102, 0x0103, 0x020A, 0x0209, 0x020E, 0x020D, 0x0208, 0x020C, 0x020B, 0x020F, 0x0210
        ]
    );
}

/// Away from all axes, so that no two values could be taken for each other.
const MOTION: Motion = Motion {
    north: 12.345,
    east: -6.789,
    height: 1.0,
    north_speed: 1.25,
    east_speed: -0.5,
    attitude: LEVEL,
};

/// The layouts are those of Swift Navigation's "Swift Binary Protocol specification".
#[test]
fn bursts_are_those_that_were_recorded() {
    let mut receiver = Receiver::new(parameters(), Vec::new(), 3);
    let mut recorded = String::new();
    for fix in [Fix::Fixed, Fix::Fixed, Fix::Float, Fix::Single, Fix::None] {
        recorded += &format!("{fix:?}\n");
        let bytes = receiver.measure(&MOTION, fix);
        for line in bytes.chunks(32) {
            let line: String = line.iter().map(|b| format!("{:02x}", b.byte)).collect();
            recorded += &format!("    {line}\n");
        }
    }
    insta::assert_snapshot!("bursts", recorded);
}

#[test]
fn the_values_survive_the_wire() {
    let mut receiver = Receiver::new(exact(), Vec::new(), 0);
    receiver.measure(&MOTION, Fix::Fixed);
    let messages = decode(&receiver.measure(&MOTION, Fix::Fixed));
    let tow = 129_600_100;
    let mut seen = 0;
    for message in &messages {
        match message {
            Sbp::MsgGpsTime(m) => {
                assert_eq!((m.wn, m.tow, m.ns_residual, m.flags), (1887, tow, 0, 1));
            }
            Sbp::MsgUtcTime(m) => {
                // 6 March 2016 + 1.5 days - 17 leap seconds.
                assert_eq!((m.year, m.month, m.day), (2016, 3, 7));
                assert_eq!(
                    (m.hours, m.minutes, m.seconds, m.ns),
                    (11, 59, 43, 100_000_000)
                );
            }
            Sbp::MsgPosLlh(m) => {
                assert_eq!((m.tow, m.flags & 7, m.n_sats), (tow, 4, 10));
                // A degree of latitude is 111.04 km here.
                assert!(
                    (m.lat - 40.83 - 12.345 / 111_040.0).abs() < 1e-7,
                    "{}",
                    m.lat
                );
                assert!((m.lon + 96.66 + 6.789 / 84_330.0).abs() < 1e-7, "{}", m.lon);
                // The plane of the position lies 16 um above the ellipsoid there.
                assert!((m.height - 331.200_015_6).abs() < 1e-6, "{}", m.height);
            }
            Sbp::MsgBaselineNed(m) => {
                assert_eq!((m.n, m.e, m.d, m.flags & 7), (12_345, -6_789, -1_200, 4));
            }
            Sbp::MsgVelNed(m) => {
                assert_eq!(
                    (m.tow, m.n, m.e, m.d, m.flags & 7),
                    (tow, 1_250, -500, 0, 1)
                );
            }
            Sbp::MsgBaselineHeading(m) => {
                let heading = (-6.789_f64).atan2(12.345).to_degrees() + 360.0;
                assert!((f64::from(m.heading) / 1e3 - heading).abs() < 1e-3);
            }
            Sbp::MsgBaselineEcef(m) => {
                let length = f64::from(m.x).hypot(f64::from(m.y)).hypot(f64::from(m.z));
                let own = 12_345_f64.hypot(6_789.0).hypot(1_200.0);
                assert!((length - own).abs() < 2.0, "rotation keeps the length");
            }
            Sbp::MsgVelEcef(m) => {
                let length = f64::from(m.x).hypot(f64::from(m.y)).hypot(f64::from(m.z));
                assert!((length - 1_250_f64.hypot(500.0)).abs() < 2.0);
            }
            Sbp::MsgPosEcef(m) => {
                let radius = m.x.hypot(m.y).hypot(m.z);
                assert!((6.35e6..6.39e6).contains(&radius));
            }
            Sbp::MsgDops(m) => assert_eq!((m.tow, m.hdop), (tow, 80)),
            Sbp::MsgAgeCorrections(m) => assert_eq!((m.tow, m.age), (tow, 10)),
            other => panic!("{other:?} was not sent"),
        }
        seen += 1;
    }
    assert_eq!(seen, 11);
}

#[test]
fn each_fix_state_has_its_flags() {
    for (fix, position, baseline, velocity) in [
        (Fix::None, 0, 0, 0),
        (Fix::Single, 1, 0, 1),
        (Fix::Float, 3, 3, 1),
        (Fix::Fixed, 4, 4, 1),
    ] {
        let mut receiver = Receiver::new(exact(), Vec::new(), 0);
        let motion = Motion {
            north: 3.0,
            ..STILL
        };
        let mut seen = 0;
        for message in decode(&receiver.measure(&motion, fix)) {
            match message {
                Sbp::MsgPosLlh(m) => assert_eq!(m.flags & 7, position),
                Sbp::MsgBaselineNed(m) => {
                    assert_eq!(m.flags & 7, baseline);
                    assert_eq!(m.n != 0, fix.has_baseline());
                }
                Sbp::MsgVelNed(m) => assert_eq!(m.flags & 7, velocity),
                Sbp::MsgGpsTime(m) => assert_eq!(m.flags & 7, velocity),
                _ => continue,
            }
            seen += 1;
        }
        assert_eq!(seen, 4, "{fix:?}");
    }
}

#[test]
fn solutions_come_at_ten_hertz_of_gps_time() {
    let parameters = Parameters {
        clock: Some(Ppm::new(100.0)),
        phase: Some(Time::new(0.037)),
        ..exact()
    };
    let mut receiver = Receiver::new(parameters, Vec::new(), 0);
    let mut epochs = Vec::new();
    for i in 0..40 {
        epochs.push(seconds(receiver.next_epoch()));
        let fix = if (10..20).contains(&i) {
            Fix::None
        } else {
            Fix::Fixed
        };
        receiver.measure(&STILL, fix);
    }
    assert!((epochs[9] - 0.937).abs() < 1e-9, "steered to GPS time");
    // A clock that is fast by 100 ppm gains 10 us per period without satellites.
    assert!(
        (epochs[20] - (2.037 - 100e-6)).abs() < 2e-9,
        "{}",
        epochs[20]
    );
    assert!((epochs[21] - 2.137).abs() < 1e-9, "steered again");
}

#[test]
fn an_inertial_sensor_tells_that_it_knows_nothing_or_tells_nothing() {
    let change = |at, state| InertialChange {
        at: Time::new(at),
        state,
    };
    let changes = [
        change(2.0, Inertial::Valid),
        change(0.5, Inertial::Silent),
        change(1.0, Inertial::Invalid),
    ];
    let parameters = Parameters {
        inertial: true,
        phase: Some(Time::new(0.05)),
        ..exact()
    };
    let with = |changes: &[InertialChange]| {
        let mut receiver = Receiver::new(parameters.clone(), Vec::new(), 0).with_inertial(changes);
        let epochs = (0..25).map(|_| {
            let messages = decode(&receiver.measure(&STILL, Fix::Fixed));
            let mut orientations = messages.into_iter().filter_map(|message| match message {
                Sbp::MsgOrientEuler(m) => Some((m.flags, m.roll, m.pitch)),
                _ => None,
            });
            let first = orientations.next();
            assert_eq!(orientations.next(), None);
            first
        });
        epochs.collect::<Vec<_>>()
    };
    let (always, seen) = (with(&[]), with(&changes));
    assert!(always.iter().all(|it| it.is_some_and(|it| it.0 != 0)));
    assert_eq!((&seen[..5], &seen[20..]), (&always[..5], &always[20..]));
    assert_eq!(seen[5..10], [None; 5]);
    assert_eq!(seen[10..20], [Some((0, 0, 0)); 10]);
}

#[test]
fn the_bytes_follow_the_receivers_own_clock() {
    let parameters = Parameters {
        clock: Some(Ppm::new(-100.0)),
        ..exact()
    };
    let mut receiver = Receiver::new(parameters, Vec::new(), 0);
    let burst = receiver.measure(&STILL, Fix::Fixed);
    let first = seconds(burst[1].at) - seconds(burst[0].at);
    assert!((first - 10e-6 * 1.0001).abs() < 2e-11, "{first}");
}

#[test]
fn noise_has_the_stated_size_and_no_mean() {
    let parameters = Parameters {
        noise: Length::new(0.01),
        velocity_noise: Speed::new(0.02),
        ..exact()
    };
    let mut receiver = Receiver::new(parameters, Vec::new(), 5);
    let (mut east, mut speed) = (Vec::new(), Vec::new());
    for _ in 0..1000 {
        for message in decode(&receiver.measure(&STILL, Fix::Fixed)) {
            match message {
                Sbp::MsgBaselineNed(m) => east.push(f64::from(m.e)),
                Sbp::MsgVelNed(m) => speed.push(f64::from(m.n)),
                _ => {}
            }
        }
    }
    let moments = |values: &[f64]| {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        (mean, variance.sqrt())
    };
    // Four standard errors: 4 x 10/sqrt(1000) = 1.3 mm of the mean, 4 x 10/sqrt(2000) of the
    // deviation.
    let (mean, deviation) = moments(&east);
    assert!(
        mean.abs() < 1.3 && (deviation - 10.0).abs() < 0.9,
        "{mean} {deviation}"
    );
    let (mean, deviation) = moments(&speed);
    assert!(
        mean.abs() < 2.6 && (deviation - 20.0).abs() < 1.8,
        "{mean} {deviation}"
    );
}

#[test]
fn a_heading_bias_turns_the_velocity() {
    let parameters = Parameters {
        heading_bias: Angle::degrees(1.0),
        ..exact()
    };
    let mut receiver = Receiver::new(parameters, Vec::new(), 0);
    let motion = Motion {
        north_speed: 2.0,
        ..STILL
    };
    let messages = decode(&receiver.measure(&motion, Fix::Fixed));
    let velocity = messages.iter().find_map(|message| match message {
        Sbp::MsgVelNed(m) => Some((m.n, m.e)),
        _ => None,
    });
    // 2 m/s x (cos, sin) of 1 degree.
    assert_eq!(velocity, Some((2_000, 35)));
}

fn fault(kind: StreamFaultKind, rate: f64) -> StreamFault {
    StreamFault {
        from: Time::new(0.05),
        until: Some(Time::new(0.25)),
        fault: kind,
        rate: Ratio::new(rate),
    }
}

/// Messages and bytes of the bursts at 0, 100, 200 and 300 ms; the second and third are damaged.
fn damaged(kind: StreamFaultKind, rate: f64) -> Vec<(usize, usize)> {
    let mut receiver = Receiver::new(exact(), vec![fault(kind, rate)], 9);
    (0..4)
        .map(|_| {
            let bytes = receiver.measure(&STILL, Fix::Fixed);
            (decode(&bytes).len(), bytes.len())
        })
        .collect()
}

#[test]
fn silence_sends_nothing() {
    assert_eq!(
        damaged(StreamFaultKind::Silence, 1.0),
        [(12, 308), (0, 0), (0, 0), (11, 296)]
    );
}

#[test]
fn flipped_bits_fail_the_check() {
    let bursts = damaged(StreamFaultKind::Flip, 0.2);
    assert_eq!((bursts[0], bursts[3]), ((12, 308), (11, 296)));
    assert_eq!((bursts[1].1, bursts[2].1), (296, 296));
    assert!(
        bursts[1].0 < 3,
        "a fifth of all bytes are wrong: {bursts:?}"
    );
}

#[test]
fn truncated_frames_are_short() {
    let bursts = damaged(StreamFaultKind::Truncate, 1.0);
    assert!((1..296).contains(&bursts[1].1), "{bursts:?}");
    assert_eq!(bursts[1].0, 0);
}

#[test]
fn wrong_lengths_have_a_right_check_value() {
    let mut receiver = Receiver::new(exact(), vec![fault(StreamFaultKind::Length, 1.0)], 9);
    receiver.measure(&STILL, Fix::Fixed);
    let bytes: Vec<u8> = receiver
        .measure(&STILL, Fix::Fixed)
        .iter()
        .map(|byte| byte.byte)
        .collect();
    // The first frame is GPS time, 19 bytes.
    assert_ne!(bytes[5], 11);
    let crc = crc::Crc::<u16>::new(&crc::CRC_16_XMODEM);
    assert_eq!(crc.checksum(&bytes[1..17]).to_le_bytes(), bytes[17..19]);
}

#[test]
fn a_flood_leaves_no_pause() {
    let mut receiver = Receiver::new(exact(), vec![fault(StreamFaultKind::Flood, 1.0)], 9);
    receiver.measure(&STILL, Fix::Fixed);
    let flood = receiver.measure(&STILL, Fix::Fixed);
    let next = receiver.measure(&STILL, Fix::Fixed);
    // 100 ms at 10 us a byte, less eleven gaps of 19 us.
    assert_eq!(flood.len(), 10_000 - 11 * 2 + 1);
    let pause = seconds(next[0].at) - seconds(flood.last().unwrap().at);
    assert!((10e-6..20.1e-6).contains(&pause), "{pause}");
    assert_eq!(types(&decode(&next))[..2], [0x0102, 0x0103]);
}

#[test]
fn preambles_fill_the_pause_and_leave_the_frames() {
    let mut receiver = Receiver::new(exact(), vec![fault(StreamFaultKind::Preambles, 1.0)], 9);
    receiver.measure(&STILL, Fix::Fixed);
    let burst = receiver.measure(&STILL, Fix::Fixed);
    assert_eq!(burst.len(), 10_000 - 11 * 2 + 1);
    let mut whole = Receiver::new(exact(), Vec::new(), 9);
    whole.measure(&STILL, Fix::Fixed);
    let frames = whole.measure(&STILL, Fix::Fixed).len();
    assert!(burst[frames..].iter().all(|it| it.byte == 0x55));
    assert_eq!(decode(&burst).len(), decode(&burst[..frames]).len());
}

#[test]
fn bytes_never_run_backwards() {
    let faults = vec![
        fault(StreamFaultKind::Flood, 1.0),
        fault(StreamFaultKind::Truncate, 0.5),
    ];
    let mut receiver = Receiver::new(parameters(), faults, 4);
    let mut last = world::SimTime::from_ticks(0);
    for _ in 0..10 {
        for byte in receiver.measure(&STILL, Fix::Fixed) {
            assert!(byte.at > last);
            last = byte.at;
        }
    }
}

/// The layout is that of MSG_ORIENT_EULER, 0x0221.
#[test]
fn an_inertial_sensor_adds_roll_and_pitch_to_a_burst() {
    let motion = Motion {
        attitude: Attitude {
            roll: 0.1,
            pitch: -0.05,
            yaw: 3.5,
        },
        ..STILL
    };
    let with = |noise: f64| Parameters {
        inertial: true,
        tilt_noise: Angle::degrees(noise),
        roll_error: Angle::degrees(0.5),
        pitch_error: Angle::degrees(-0.25),
        ..exact()
    };
    let orientation = |receiver: &mut Receiver| {
        decode(&receiver.measure(&motion, Fix::Fixed))
            .into_iter()
            .find_map(|message| match message {
                Sbp::MsgOrientEuler(m) => Some(m),
                _ => None,
            })
            .unwrap()
    };
    let mut receiver = Receiver::new(with(0.0), Vec::new(), 0);
    let first = orientation(&mut receiver);
    // Radians in microdegrees, and the constant errors.
    assert_eq!(
        (first.roll, first.pitch),
        (5_729_578 + 500_000, -2_864_789 - 250_000)
    );
    assert_eq!(first.yaw, 200_535_228 - 360_000_000);
    assert_eq!((first.tow, first.flags & 7), (129_600_000, 1));
    // It is one frame of 37 bytes more than without the sensor; the others stay.
    let (mut other, mut plain) = (
        Receiver::new(with(0.0), Vec::new(), 0),
        Receiver::new(exact(), Vec::new(), 0),
    );
    for _ in 0..3 {
        let bytes = |all: Vec<TimedByte>| all.into_iter().map(|b| b.byte).collect::<Vec<_>>();
        let (more, less) = (
            other.measure(&motion, Fix::Fixed),
            plain.measure(&motion, Fix::Fixed),
        );
        assert_eq!(more.len(), less.len() + 37);
        assert!(bytes(more).starts_with(&bytes(less)[..296]));
    }
    // 37 bytes of 10 us and one more pause, (3150 - 2960) us / 10.
    let longer = burst_seconds(&with(0.0)) - burst_seconds(&exact());
    assert!((longer - 389e-6).abs() < 1e-9, "{longer}");
    let mut receiver = Receiver::new(with(0.2), Vec::new(), 0);
    let noise = |angle: i32, mean: i32| f64::from(angle - mean) * 1e-6;
    let count = 2000;
    let mut square = 0.0;
    for _ in 0..count {
        let seen = orientation(&mut receiver);
        square += noise(seen.roll, first.roll).powi(2) + noise(seen.pitch, first.pitch).powi(2);
    }
    let deviation = (square / f64::from(2 * count)).sqrt();
    assert!((deviation - 0.2).abs() < 0.01, "{deviation} degrees");
}
