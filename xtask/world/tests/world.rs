//! The outputs of the world at the nodes' pins.

mod uagv;

use proptest::prelude::*;
use world::time::{after, at, from_seconds, seconds};
use world::{
    Analog, Device, Disturbance, Effect, Input, NodeIndex, Output, Scenario, SimDuration, SimTime,
    World,
};

fn scenario(text: &str) -> Scenario {
    uagv::scenario(text)
}

fn everything(world: &mut World) -> Vec<Output> {
    core::iter::from_fn(|| world.poll()).collect()
}

fn until(text: &str, end: f64) -> Vec<Output> {
    let mut world = World::new(&uagv::vehicle(), &scenario(text), 1);
    world.advance_to(at(from_seconds(end)));
    everything(&mut world)
}

/// Closes the relay, sends a byte at 38400 baud and returns the end of its stop bit.
fn send(world: &mut World, node: NodeIndex, byte: u8, start: f64) -> SimTime {
    let start = at(from_seconds(start));
    let end = after(start, from_seconds(10.0 / 38_400.0));
    world.relay(node, true, start);
    let device = if node == uagv::STEERING {
        Device::SteeringMotor
    } else {
        Device::DriveMotor
    };
    world.serial(node, device, byte, start, end);
    end
}

#[test]
fn a_press_bounces_and_settles() {
    let outputs = until("[[press]]\nat = \"1 s\"\nbutton = \"J\"\n", 2.0);
    let levels: Vec<(f64, bool)> = outputs
        .iter()
        .filter_map(|output| match output.what {
            Effect::Level {
                input: Input::JoystickSwitch,
                high,
                ..
            } => Some((seconds(output.at), high)),
            _ => None,
        })
        .collect();
    assert_eq!(
        levels,
        [
            (1.0, false),
            (1.0005, true),
            (1.001, false),
            (1.0015, true),
            (1.002, false),
            (1.2, true),
            (1.2005, false),
            (1.201, true),
            (1.2015, false),
            (1.202, true),
        ]
    );
}

#[test]
fn a_toggling_remote_changes_its_level_at_each_press() {
    let toggle = uagv::changed(&[("remote = \"momentary\"", "remote = \"toggle\"")]);
    let text = "[[press]]\nat = \"1 s\"\nbutton = \"C\"\n\
                [[press]]\nat = \"3 s\"\nbutton = \"C\"\n\
                [[press]]\nat = \"2 s\"\nbutton = \"J\"\nbounce = \"0 ms\"\n";
    let scenario = Scenario::parse(&toggle, "t", "t", text).unwrap();
    let mut world = World::new(&toggle, &scenario, 1);
    world.advance_to(at(from_seconds(4.0)));
    let levels: Vec<(f64, Input, bool)> = everything(&mut world)
        .iter()
        .filter_map(|output| match output.what {
            Effect::Level { input, high, .. } => Some((seconds(output.at), input, high)),
            _ => None,
        })
        .collect();
    assert_eq!(
        levels,
        [
            (1.0, Input::RemoteC, true),
            (2.0, Input::JoystickSwitch, false),
            (2.2, Input::JoystickSwitch, true),
            (3.0, Input::RemoteC, false),
        ]
    );
}

#[test]
fn the_receiver_measures_its_antenna_beside_the_centre_line() {
    let beside = uagv::changed(&[("antenna_right = \"0 m\"", "antenna_right = \"0.4 m\"")]);
    let text = "[start]\nnorth = \"3 m\"\neast = \"1 m\"\nheading = \"90 deg\"\n";
    let scenario = Scenario::parse(&beside, "t", "t", text).unwrap();
    let mut world = World::new(&beside, &scenario, 1);
    world.advance_to(at(from_seconds(0.1)));
    let antenna = world.machine().unwrap().antenna();
    // Heading east, right of the vehicle is south.
    assert!((antenna.north - 2.6).abs() < 1e-9 && (antenna.east - 1.0).abs() < 1e-9);
    assert_eq!(antenna.height, 1.0);
    // The report uses the path of the point on the centre line, not that of the antenna.
    let judged = world.states()[0];
    assert!((judged.north - 3.0).abs() < 1e-9 && (judged.east - 1.0).abs() < 1e-9);
}

#[test]
fn idle_levels_are_those_of_the_wiring() {
    let world = World::new(&uagv::vehicle(), &scenario(""), 1);
    for input in Input::ALL {
        assert_eq!(
            world.level(input),
            input == Input::JoystickSwitch,
            "{input:?}"
        );
    }
}

#[test]
fn the_stop_loop_is_high_when_open() {
    let mut world = World::new(
        &uagv::vehicle(),
        &scenario("[[stop_loop]]\nat = \"1 s\"\nopen = true\n"),
        1,
    );
    world.advance_to(at(from_seconds(1.0)));
    assert!(world.level(Input::StopLoop));
}

#[test]
fn resets_and_bus_events_come_at_their_times() {
    let text = r#"
        [[reset]]
        node = "drive"
        at = "100 ms"
        until = "300 ms"
        [[bus]]
        what = "frame"
        at = "10 ms"
        id = 7
        data = [1, 2]
        every = "100 ms"
        until = "200 ms"
        [[bus]]
        what = "corrupt"
        at = "50 ms"
        id = 300
        count = 2
        [[bus]]
        what = "dominant"
        at = "60 ms"
        hold = "1 ms"
        [[bus]]
        what = "dominant"
        at = "70 ms"
        id = 7
        hold = "1 ms"
    "#;
    let outputs = until(text, 1.0);
    let foreign: Vec<(u64, Effect)> = outputs
        .into_iter()
        .filter(|output| !matches!(output.what, Effect::Byte { .. }))
        .map(|output| (output.at.as_ticks() / 1_000_000_000, output.what))
        .collect();
    let frame = Disturbance::Frame {
        id: 7,
        data: [1, 2, 0, 0, 0, 0, 0, 0],
        dlc: 2,
    };
    let corrupt = Disturbance::CorruptNext {
        id: Some(300),
        count: 2,
    };
    let hold = SimDuration::from_ticks(1_000_000_000);
    assert_eq!(
        foreign,
        [
            (10, Effect::Bus(frame.clone())),
            (50, Effect::Bus(corrupt)),
            (60, Effect::Bus(Disturbance::Dominant { id: None, hold })),
            (70, Effect::Bus(Disturbance::Dominant { id: Some(7), hold })),
            (
                100,
                Effect::Reset {
                    node: uagv::DRIVE,
                    held: true
                }
            ),
            (110, Effect::Bus(frame)),
            (
                300,
                Effect::Reset {
                    node: uagv::DRIVE,
                    held: false
                }
            ),
        ]
    );
}

#[test]
fn clocks_are_drawn_or_given() {
    let text = "[nodes.gps]\ncrystal = \"12.5 ppm\"\n[nodes.drive]\nexternal = false\n";
    let world = World::new(&uagv::vehicle(), &scenario(text), 3);
    assert_eq!(world.crystal_ppm(uagv::GPS), 12.5);
    assert!(world.external_clock(uagv::GPS) && !world.external_clock(uagv::DRIVE));
    let drawn: Vec<f64> = uagv::ALL.map(|node| world.crystal_ppm(node)).to_vec();
    assert!(drawn.iter().all(|ppm| ppm.abs() <= 50.0), "{drawn:?}");
    assert!(drawn[1] != drawn[2] && drawn[2] != drawn[3]);
    assert!(world.internal_ppm(uagv::DRIVE).abs() <= 10_000.0);
    assert_ne!(
        World::new(&uagv::vehicle(), &scenario(text), 4).crystal_ppm(uagv::DRIVE),
        drawn[3]
    );
}

#[test]
fn motor_bytes_move_the_vehicle() {
    let mut world = World::new(&uagv::vehicle(), &scenario(""), 1);
    let sent = send(&mut world, uagv::STEERING, 255, 0.5);
    send(&mut world, uagv::DRIVE, 127, 0.5);
    world.advance_to(at(from_seconds(1.0)));
    // 25 deg/s from the end of the byte on.
    let steering = world.machine().unwrap().state().steering.to_degrees();
    // The driver's clock may be off by 1 %: 2.6 us of a byte.
    assert!(
        (steering - 25.0 * (1.0 - seconds(sent))).abs() < 1e-4,
        "{steering}"
    );
    let efforts: Vec<(NodeIndex, u8, f64)> = world
        .efforts()
        .iter()
        .map(|change| (change.node, change.byte, change.effort))
        .collect();
    assert_eq!(
        efforts,
        [(uagv::STEERING, 255, 1.0), (uagv::DRIVE, 127, 0.0)]
    );
    assert_eq!(world.states().len(), 101);
}

/// 127 at the rate that a divider for 72 MHz gives at 8 MHz.
#[test]
fn a_stop_at_a_ninth_of_the_rate_is_full_reverse() {
    let mut world = World::new(&uagv::vehicle(), &scenario(""), 1);
    let start = at(from_seconds(0.1));
    let end = after(start, from_seconds(10.0 / (38_400.0 / 9.0)));
    world.relay(uagv::DRIVE, true, start);
    world.serial(uagv::DRIVE, Device::DriveMotor, 127, start, end);
    world.advance_to(at(from_seconds(1.0)));
    assert_eq!(world.effort(uagv::DRIVE), -1.0);
    assert_eq!(world.counters().motor_garbled, 2);
    assert!(
        world
            .garbles()
            .iter()
            .all(|g| g.byte == Some(0) && g.closed)
    );
}

#[test]
fn bytes_are_known_before_their_start_bits() {
    let text = "[receiver]\nphase = \"0 s\"\nlatency_jitter = \"0 s\"\nclock = \"0 ppm\"\nframe_gap = \"0 s\"\n";
    let mut world = World::new(&uagv::vehicle(), &scenario(text), 1);
    world.advance_to(at(from_seconds(0.030)));
    assert_eq!(world.bytes(at(from_seconds(0.0399))), []);
    // Bytes of 10 us from 40 ms on: the start bits of the first three are not after 40.02 ms.
    let ends = |bytes: Vec<Output>| {
        bytes
            .iter()
            .map(|byte| seconds(byte.at))
            .collect::<Vec<_>>()
    };
    let first = ends(world.bytes(at(from_seconds(0.040_02))));
    assert_eq!(first.len(), 3);
    assert!((first[0] - 0.040_01).abs() < 1e-9 && (first[2] - 0.040_03).abs() < 1e-9);
    let next = ends(world.bytes(at(from_seconds(0.040_03))));
    assert!(next.len() == 1 && (next[0] - 0.040_04).abs() < 1e-9);
}

#[test]
fn the_display_answers_after_its_delay() {
    let mut world = World::new(
        &uagv::vehicle(),
        &scenario("[lcd]\ndelay = \"250 us\"\n"),
        1,
    );
    let bit = 1.0 / 19_200.0;
    let mut start = 0.010;
    for byte in b"\xFER\xFED\xFEG\x01\x01hello\xFE7" {
        let (from, to) = (from_seconds(start), from_seconds(start + 10.0 * bit));
        world.serial(uagv::CONTROLLER, Device::Display, *byte, at(from), at(to));
        start += 10.0 * bit;
    }
    world.advance_to(at(from_seconds(0.1)));
    let answers: Vec<f64> = everything(&mut world)
        .iter()
        .filter_map(|output| match output.what {
            Effect::Byte {
                device: Device::Display,
                byte: 0x2B,
                ..
            } => Some(seconds(output.at)),
            _ => None,
        })
        .collect();
    assert_eq!(answers.len(), 1);
    // A byte takes 520 us, twice as long as its execution.
    assert!((answers[0] - (start + 0.25e-3 + 10.0 * bit)).abs() < 1e-9);
    assert!(
        world.lcd_text().starts_with("hello\n"),
        "{}",
        world.lcd_text()
    );
    assert_eq!(world.counters().lcd_refused, 0);
}

#[test]
fn the_joystick_reads_from_its_script() {
    let text = "[[joystick]]\nat = \"1 s\"\nright = \"-100 %\"\nforward = \"50 %\"\n";
    let mut world = World::new(&uagv::vehicle(), &scenario(text), 1);
    let near = |reading: u16, expected: f64| (f64::from(reading) - expected).abs() <= 10.0;
    assert!(near(
        world.adc(Analog::JoystickX, at(from_seconds(0.9))),
        2048.0
    ));
    assert!(near(
        world.adc(Analog::JoystickX, at(from_seconds(1.0))),
        1.0
    ));
    assert!(near(
        world.adc(Analog::JoystickY, at(from_seconds(5.0))),
        2048.0 + 1023.5
    ));
}

#[test]
fn a_reading_repeats() {
    let mut world = World::new(
        &uagv::vehicle(),
        &scenario("[vehicle]\npot_noise = \"20 counts\"\n"),
        1,
    );
    let when = |i: u32| at(from_seconds(f64::from(i) * 5e-3));
    let first: Vec<u16> = (0..200)
        .map(|i| world.adc(Analog::SteeringPot, when(i)))
        .collect();
    let again: Vec<u16> = (0..200)
        .map(|i| world.adc(Analog::SteeringPot, when(i)))
        .collect();
    assert_eq!(first, again);
    let mean = first.iter().map(|reading| f64::from(*reading)).sum::<f64>() / 200.0;
    // Four standard errors of 20 counts over 200 readings.
    assert!((mean - 2048.0).abs() < 5.7, "{mean}");
    assert!(first.iter().any(|reading| reading.abs_diff(2048) > 20));
}

#[test]
fn the_fix_follows_the_scenario() {
    let world = World::new(&uagv::vehicle(), &uagv::find("gps-lost"), 1);
    let fix = |time: f64| world.fix(at(from_seconds(time))).name();
    assert_eq!(
        [fix(0.0), fix(19.99), fix(20.0), fix(40.0)],
        ["fixed", "fixed", "single", "fixed"]
    );
}

/// The outputs of a run that is advanced to the given times in turn.
fn stepped(steps: &[f64], seed: u64) -> (Vec<Output>, Vec<u16>, String) {
    let mut world = World::new(&uagv::vehicle(), &uagv::find("straight-line"), seed);
    let commands = [
        (0.11, uagv::DRIVE, 200),
        (0.333, uagv::STEERING, 20),
        (0.8, uagv::STEERING, 127),
    ];
    for (start, node, byte) in commands {
        send(&mut world, node, byte, start);
    }
    let mut outputs = Vec::new();
    for step in steps {
        world.advance_to(at(from_seconds(*step)));
        outputs.extend(everything(&mut world));
        // Reading must not change the outputs.
        world.adc(Analog::SteeringPot, after(world.now(), from_seconds(0.001)));
    }
    world.advance_to(at(from_seconds(1.5)));
    outputs.extend(everything(&mut world));
    let pot = world.adc(Analog::SteeringPot, at(from_seconds(1.5)));
    (outputs, vec![pot], format!("{:?}", world.states()))
}

#[test]
fn seeds_differ() {
    assert_eq!(stepped(&[], 1), stepped(&[], 1));
    assert_ne!(stepped(&[], 1).0, stepped(&[], 2).0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn the_way_of_stepping_changes_nothing(
        steps in prop::collection::vec(0.0_f64..1.5, 0..40),
    ) {
        let mut steps = steps;
        steps.sort_by(f64::total_cmp);
        let (outputs, readings, states) = stepped(&steps, 1);
        prop_assert!(outputs.windows(2).all(|pair| pair[0].at <= pair[1].at), "in order of time");
        prop_assert_eq!((outputs, readings, states), stepped(&[], 1));
    }

    #[test]
    fn no_event_comes_before_it_is_announced(step in 0.001_f64..0.05) {
        let mut world = World::new(&uagv::vehicle(), &uagv::find("straight-line"), 1);
        let mut time = 0.0;
        while time < 1.2 {
            let announced = world.next_event().unwrap();
            time += step;
            world.advance_to(at(from_seconds(time)));
            let first = world.poll().map(|output| output.at);
            prop_assert!(first.is_none_or(|first| first >= announced));
            everything(&mut world);
        }
    }
}
