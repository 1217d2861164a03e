//! Roll and pitch between the receiver and the law, where they are measured.
#![cfg(tilt)]

use firmware::navigation::{Station, Step};
use firmware::pilot::Inputs;
use network::Message;
use uagv::design::TILT_AGE;
use uagv::matrix::{CONTROLLER, GPS, MATRIX, window};
use uagv::messages::{Tilt, TiltState};
use uagv::tilt::{News, Watch};
use uagv::{Pilot, Uagv};

use control::position::{Position, Velocity};
use firmware::machine::Machine as _;
use ttcan::{Micros, WindowKind};

/// A frame 0x0221 of the receiver, microdegrees.
fn frame(roll: i32, pitch: i32, flags: u8) -> Vec<u8> {
    let mut frame = vec![0x55, 0x21, 0x02, 1, 0, 29];
    frame.extend(7_u32.to_le_bytes());
    frame.extend([roll, pitch, 0].map(i32::to_le_bytes).concat());
    frame.extend([0; 12]);
    frame.push(flags);
    let checksum = firmware::sbp::crc16(0, &frame[1..]);
    frame.extend(checksum.to_le_bytes());
    frame
}

/// What the gps node makes of the receiver's bytes.
fn news(bytes: &[u8]) -> Option<Option<[u8; 8]>> {
    let (mut station, mut news) = (Station::new(), News::default());
    for bytes in bytes.chunks(firmware::sbp::LOT) {
        station.take(bytes.iter().copied());
        while station.step_showing(0, |_| {}, |frame| news.see(frame)) == Step::More {}
    }
    news.data()
}

#[test]
fn what_the_receiver_says_goes_to_message_203() {
    // 10 and -5 degrees are 0.17453 and -0.08727 rad: 1745 and -873.
    let data = news(&frame(10_000_000, -5_000_000, 1)).unwrap().unwrap();
    assert_eq!(data, [0xD1, 0x06, 0x97, 0xFC, 0, 0, 0, 0]);
    let message = Tilt::decode(&data[..4]).unwrap();
    assert_eq!((message.roll, message.pitch), (1745, -873));
    // The sensor does not know them; they are beyond half a radian, or beyond the message.
    assert_eq!(news(&frame(10_000_000, -5_000_000, 0)), Some(None));
    assert_eq!(news(&frame(0, 29_000_000, 1)), Some(None));
    assert_eq!(news(&frame(i32::MIN, 0, 1)), Some(None));
    assert_eq!(news(&[0x55; 40]), None);
}

#[test]
fn roll_and_pitch_come_in_front_of_the_command_and_the_heading_behind_it() {
    let windows = MATRIX.config().windows;
    let sender = |position: usize| match windows[position].kind {
        WindowKind::Exclusive {
            id, len, sender, ..
        } => (id.raw(), len, sender),
        _ => panic!("not exclusive"),
    };
    assert_eq!(sender(window::TILT), (203, 4, GPS));
    assert_eq!(sender(window::TILT_STATE), (457, 2, CONTROLLER));
    assert_eq!(sender(window::HEADING), (202, 4, GPS));
    assert_eq!(windows[window::TILT].start, Micros::millis(5));
    assert!(windows[window::HEADING].start > windows[window::COMMAND].start);
}

/// `cantools/vectors.py` wrote the frames.
#[test]
fn the_generated_code_reads_and_writes_what_cantools_does() {
    fn check<M: Message>(data: &[u8], raw: &[i64], physical: &[f64]) {
        let message = M::decode(data).expect("within the limits");
        assert_eq!(message.encode().as_ref(), data);
        let (mut counts, mut values) = (Vec::new(), Vec::new());
        message.visit(&mut |signal, count| {
            counts.push(count);
            values.push(count as f64 * signal.factor);
        });
        assert_eq!(counts, raw);
        for (ours, theirs) in values.iter().zip(physical) {
            assert!((ours - theirs).abs() < 1e-9, "{ours} {theirs}");
        }
    }
    let mut seen = 0;
    for line in include_str!("data/cantools_tilt.txt").lines() {
        let mut words = line.split_whitespace();
        let (id, hex) = (words.next().unwrap(), words.next().unwrap());
        let byte = |at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
        let data: Vec<u8> = (0..hex.len()).step_by(2).map(byte).collect();
        let (raw, physical): (Vec<i64>, Vec<f64>) = words
            .map(|word| word.split_once('=').unwrap())
            .map(|(raw, value)| (raw.parse::<i64>().unwrap(), value.parse::<f64>().unwrap()))
            .unzip();
        match id {
            "203" => check::<Tilt>(&data, &raw, &physical),
            _ => check::<TiltState>(&data, &raw, &physical),
        }
        seen += 1;
    }
    assert_eq!(seen, 2 * 12);
}

fn inputs() -> Inputs {
    Inputs {
        position: Some(Position::new(1000, 1000)),
        velocity: Some(Velocity::new(0, 0)),
        pot: Some(2048),
        fixed: true,
        in_schedule: true,
        may_move: true,
        ..Inputs::default()
    }
}

#[test]
fn the_law_knows_the_place_of_the_antenna_until_roll_and_pitch_lapse() {
    let (mut pilot, mut watch) = (Pilot::new().unwrap(), Watch::new());
    let mut step = |roll: Option<i16>| {
        let seen = roll.map(|roll| Tilt { roll, pitch: 0 });
        watch.step(&mut pilot, &mut inputs(), seen);
        watch.state()
    };
    let state = |measured, lapses| TiltState { measured, lapses };
    assert_eq!(step(None), state(false, 0));
    assert_eq!(step(Some(1745)), state(true, 0));
    let steps = (TILT_AGE / Uagv::PERIOD).round() as u32;
    for _ in 1..steps {
        assert_eq!(step(None), state(true, 0));
    }
    // Rounding decides whether the age is reached one step earlier or later.
    step(None);
    assert_eq!(step(None), state(false, 1));
    assert_eq!(step(Some(-1745)), state(true, 1));
}

/// While a vehicle drives north and rolls to its right, its antenna moves east but the vehicle does not.
#[test]
fn the_swing_of_the_antenna_is_no_velocity() {
    let (mut pilot, mut watch) = (Pilot::new().unwrap(), Watch::new());
    let height = 1.0;
    let mut north = 0.0;
    // Northwards at 1 m/s, so that the heading is known, and then with a roll that changes.
    for number in 0..60 {
        let roll = if number < 40 {
            0.0
        } else {
            0.01 * f64::from(number - 40)
        };
        let rolls = if number <= 40 { 0.0 } else { 0.1 };
        let east = height * f64::sin(roll);
        north += 0.1;
        let mut inputs = Inputs {
            position: Some(Position::new((north * 1e3) as i32, (east * 1e3) as i32)),
            velocity: Some(Velocity::new(1000, (rolls * height * 1e3) as i32)),
            ..inputs()
        };
        let seen = Tilt {
            roll: (roll * 1e4).round() as i16,
            pitch: 0,
        };
        watch.step(&mut pilot, &mut inputs, Some(seen));
        let _ = pilot.step(&inputs, &firmware::buttons::Buttons::default());
        pilot.predict();
        if number > 42 {
            let velocity = inputs.velocity.unwrap();
            assert!(velocity.east.abs() < 20, "{number}: {velocity:?}");
        }
    }
    let estimate = pilot.law().estimator().estimate();
    assert!(estimate.east.abs() < 0.02, "{estimate:?}");
}
