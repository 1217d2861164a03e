//! A robot on its way along a row: pulses in, voltages out.

mod uagv;

use proptest::prelude::*;
use world::distance::{self, Fault, metres};
use world::rover::{Mount, Parameters, Side, Terrain};
use world::row_drive::{RowDrive, Setting, pulse};
use world::rows::What;
use world::scenario::{Limits, Row};
use world::time::{at, from_seconds, seconds};
use world::{Analog, SimTime, World};

const POLES: &str = "[[section]]\nkind = \"poles\"\nlength = \"30 m\"\n";

fn row(text: &str) -> Row {
    let row: Row = toml::from_str(text).unwrap();
    let limits = Limits::of(&Parameters::default(), &Mount::right());
    row.check(&limits).unwrap();
    row
}

fn setting(row: &Row) -> Setting<'_> {
    Setting {
        row,
        rover: Parameters {
            motors: Some([[1.0; 3]; 2]),
            ..Parameters::default()
        },
        mount: Mount::right(),
        terrain: Terrain::default(),
        distance: distance::Parameters::default(),
        driver_clocks: [0.0; 2],
    }
}

fn time(seconds: f64) -> SimTime {
    at(from_seconds(seconds))
}

/// Pulses for these efforts every 5 ms until `to` seconds, and none behind.
fn send(drive: &mut RowDrive, left: f64, right: f64, from: f64, to: f64) {
    let first = (from / 0.005).round() as u32;
    for i in first..(to / 0.005).round() as u32 {
        let begin = time(f64::from(i) * 0.005);
        drive.advance_to(begin);
        pulse(drive, Side::Left, begin, 1.5e-3 + left * 0.5e-3);
        pulse(drive, Side::Right, begin, 1.5e-3 + right * 0.5e-3);
    }
    drive.advance_to(time(to));
}

#[test]
fn the_limits_are_those_of_the_thesis_robot() {
    let limits = Limits::of(&Parameters::default(), &Mount::left());
    assert_eq!((limits.width, limits.sensor_beside), (0.3048, 0.152));
    assert_eq!(
        (limits.beam, limits.range),
        (core::f64::consts::FRAC_PI_4, 10.0)
    );
}

#[test]
fn pulses_drive_the_robot_along_the_row() {
    let row = row(&format!(
        "{POLES}[start]\nstation = \"1 m\"\nright = \"3 cm\"\n"
    ));
    let mut drive = RowDrive::new(&setting(&row), 1);
    send(&mut drive, 0.24, 0.24, 0.0, 5.0);
    let last = *drive.samples().last().unwrap();
    assert_eq!((seconds(last.at), drive.samples().len()), (5.0, 501));
    // 5 % of the effort is lost to friction; the lag and the second pulse's end are 132 ms.
    let speed = 2.0 * (0.24 - 0.05) / 0.95;
    assert!(
        (last.station - 1.0 - speed * (5.0 - 0.1265)).abs() < 0.01,
        "{last:?}"
    );
    assert!(
        (last.right - 0.03).abs() < 1e-9 && last.heading.abs() < 1e-9,
        "{last:?}"
    );
    assert!((last.efforts[0] - 0.24).abs() < 1e-9);
    assert_eq!(drive.touches(), []);
    assert_eq!(drive.driver(Side::Left).counts().valid, 999);
    assert!((90..=102).contains(&drive.beams().len()));
}

/// The output of a sensor changes about 33 times a second and a burst takes 201 us, so 1 in 150 of them
/// has a change in it.
#[test]
fn a_burst_in_which_the_output_changes_reads_what_is_nowhere() {
    let row = row(POLES);
    let mut drive = RowDrive::new(&setting(&row), 1);
    let (mut bursts, mut mixed) = (0, 0);
    for i in 0..4000_u32 {
        let begin = time(f64::from(i) * 0.005);
        send(&mut drive, 0.3, 0.3, seconds(begin), seconds(begin) + 0.005);
        let begin = time(f64::from(i + 1) * 0.005);
        for side in [Side::Left, Side::Right] {
            let first = drive.volts(side, begin);
            let last = drive.volts(side, time(seconds(begin) + 201.4e-6));
            let mean = drive.mean_volts(side, begin);
            bursts += 1;
            let (least, most) = (first.min(last), first.max(last));
            assert!(
                least - 1e-9 <= mean && mean <= most + 1e-9,
                "{first} {mean} {last}"
            );
            mixed += u32::from(most - least > 0.1 && least + 0.01 < mean && mean < most - 0.01);
        }
    }
    let share = f64::from(mixed) / f64::from(bursts);
    assert!((0.000_5..0.01).contains(&share), "{mixed} of {bursts}");
}

#[test]
fn without_pulses_it_stands_still_after_a_tenth_of_a_second() {
    let row = row(POLES);
    let mut drive = RowDrive::new(&setting(&row), 1);
    send(&mut drive, 0.5, 0.5, 0.0, 1.0);
    assert!((drive.efforts()[1] - 0.5).abs() < 1e-9);
    // The last pulse begins at 995 ms and ends 1.75 ms later.
    drive.advance_to(time(1.0967));
    assert!((drive.efforts()[0] - 0.5).abs() < 1e-9);
    drive.advance_to(time(1.0968));
    assert_eq!(drive.efforts(), [0.0; 2]);
    drive.advance_to(time(4.0));
    let state = drive.state_at(time(4.0));
    assert!(state.speed.abs() < 1e-9, "{state:?}");
}

#[test]
fn it_turns_into_the_row_and_says_what_it_touches() {
    let row = row(POLES);
    let mut drive = RowDrive::new(&setting(&row), 1);
    send(&mut drive, 0.4, 0.25, 0.0, 3.0);
    let contact = drive.contact().unwrap();
    assert_eq!(contact.contact.what, What::Pole);
    assert!(contact.contact.y > 0.3, "{contact:?}");
    assert!(
        contact.chassis.touches(
            drive
                .rows()
                .shapes()
                .iter()
                .find(|shape| shape.from == (contact.contact.x, contact.contact.y))
                .unwrap()
        )
    );
    // It was found at the first record with it.
    let before = drive
        .samples()
        .iter()
        .rfind(|sample| sample.at < contact.at);
    let before = drive.rover().footprint(&before.unwrap().state);
    assert_eq!(drive.rows().contact(&before), None);
    // Poles stand closer than the robot is long: it touches them without a pause.
    assert_eq!(drive.touches().len(), 1);
}

#[test]
fn a_contact_ends_when_the_robot_touches_nothing() {
    let weed = |at| format!("[[weed]]\nat = \"{at} m\"\nright = \"0 m\"\ndiameter = \"5 cm\"\n");
    let row = row(&format!("{POLES}{}{}", weed(2), weed(3)));
    let mut drive = RowDrive::new(&setting(&row), 1);
    send(&mut drive, 0.5, 0.5, 0.0, 4.0);
    let stations: Vec<f64> = drive.touches().iter().map(|touch| touch.station).collect();
    // The front edge is 22.9 cm ahead, and a weed reaches 2.5 cm towards it.
    let expected = [2.0 - 0.2536, 3.0 - 0.2536];
    assert_eq!(stations.len(), 2, "{stations:?}");
    for (found, expected) in stations.iter().zip(expected) {
        // A record is 1 cm on.
        assert!((0.0..0.012).contains(&(found - expected)), "{stations:?}");
    }
}

#[test]
fn each_sensor_is_read_at_its_side_and_can_fail() {
    let text = "[[section]]\nkind = \"barriers\"\nlength = \"30 m\"\nwidth = \"1 m\"\n\
                [start]\nstation = \"2 m\"\nright = \"10 cm\"\n";
    let row = row(text);
    let mut drive = RowDrive::new(&setting(&row), 4);
    drive.advance_to(time(0.2));
    let read = |drive: &RowDrive, side| metres(drive.volts(side, time(0.2)));
    // The right row is 20 cm nearer; the sensor on the left sees it.
    let (left, right) = (read(&drive, Side::Left), read(&drive, Side::Right));
    assert!(
        (right - left - 0.2 * core::f64::consts::SQRT_2).abs() < 0.03,
        "{left} {right}"
    );
    drive.set_fault(Side::Left, Some(Fault::Open));
    assert_eq!(drive.volts(Side::Left, time(0.2)), 0.0);
    assert!(drive.volts(Side::Right, time(0.2)) > 0.1);
}

#[test]
fn a_world_with_a_drive_couples_with_it() {
    let row = row(POLES);
    let setting = setting(&row);
    let scenario = uagv::scenario("");
    let new = || World::new(&uagv::vehicle(), &scenario, 1);
    let mut world = new().with_drive(RowDrive::new(&setting, 7));
    let mut alone = RowDrive::new(&setting, 7);
    let mut couplings = 0;
    for i in 0..200 {
        let begin = time(f64::from(i) * 0.005);
        while world.next_coupling() <= begin {
            // Nothing reads the robot before the time that the world names.
            let next = world.next_coupling();
            assert!(alone.next_coupling() >= next);
            world.advance_to(next);
            alone.advance_to(next);
            couplings += 1;
        }
        for side in [Side::Left, Side::Right] {
            pulse(&mut alone, side, begin, 1.65e-3);
            world.servo_edge(side, begin, true);
            world.servo_edge(side, begin + from_seconds(1.65e-3), false);
        }
    }
    world.advance_to(time(1.0));
    alone.advance_to(time(1.0));
    assert_eq!(world.drive().unwrap().samples(), alone.samples());
    // About 100 records, and 100 looks of either sensor.
    assert!((290..=305).contains(&couplings), "{couplings}");
    let last = alone.samples().last().unwrap();
    assert!(last.state.speed > 0.4, "{last:?}");

    for side in [Side::Left, Side::Right] {
        let count = f64::from(world.adc(Analog::Distance(side), time(1.0)));
        let volts = alone.volts(side, time(1.0));
        assert!(
            (count / 4095.0 * 3.3 - volts.min(3.3)).abs() < 5e-3,
            "{count} {volts}"
        );
        assert_eq!(
            count,
            f64::from(world.adc(Analog::Distance(side), time(1.0)))
        );
    }
    let short = Some(Fault::ShortedToGround);
    world.drive_mut().unwrap().set_fault(Side::Left, short);
    assert!(world.adc(Analog::Distance(Side::Left), time(1.0)) < 6);

    let mut without = new();
    without.servo_edge(Side::Left, time(0.5), true);
    assert_eq!(without.adc(Analog::Distance(Side::Left), time(0.5)), 0);
    assert!(without.drive().is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn neither_the_callers_steps_nor_readings_change_the_drive(
        seed: u64,
        mut cuts in prop::collection::vec(0.0..1.5_f64, 0..40),
        efforts in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64), 1..20),
        faults in prop::collection::vec((0.0..1.5_f64, any::<bool>(), 0_usize..6), 0..6),
    ) {
        let row = row("[[section]]\nkind = \"stalks\"\nlength = \"30 m\"\n");
        let setting = Setting { terrain: Terrain::field(), ..setting(&row) };
        let (mut whole, mut cut) = (RowDrive::new(&setting, seed), RowDrive::new(&setting, seed));
        for (at, left, kind) in faults {
            let side = if left { Side::Left } else { Side::Right };
            let fault = [
                None,
                Some(Fault::Open),
                Some(Fault::ShortedToGround),
                Some(Fault::ShortedToSupply),
                Some(Fault::Frozen),
                Some(Fault::Blind),
            ][kind];
            for drive in [&mut whole, &mut cut] {
                drive.plan_fault(time(at), side, fault);
            }
        }
        cuts.sort_by(f64::total_cmp);
        let mut begin = 0.0;
        for (i, (left, right)) in efforts.iter().enumerate() {
            // With the longest of these periods the drivers switch off.
            begin += [0.005, 0.02, 0.09, 0.15][i % 4];
            for cut_at in cuts.iter().filter(|at| **at < begin) {
                cut.advance_to(time(*cut_at));
                let _ = cut.volts(Side::Left, time(cut_at + 0.05));
            }
            for drive in [&mut whole, &mut cut] {
                drive.advance_to(time(begin));
                pulse(drive, Side::Left, time(begin), 1.5e-3 + left * 0.5e-3);
                pulse(drive, Side::Right, time(begin), 1.5e-3 + right * 0.5e-3);
            }
        }
        let end = time(3.0);
        // A prediction takes the efforts as they are; they stay so until a driver switches off.
        let read = |drive: &RowDrive| {
            [Side::Left, Side::Right].map(|side| drive.volts(side, time(begin + 0.045)))
        };
        let foreseen = read(&cut);
        let stays = cut.efforts() != [0.0; 2];
        cut.advance_to(time(begin + 0.045));
        if stays {
            prop_assert_eq!(foreseen, read(&cut));
        }
        whole.advance_to(end);
        cut.advance_to(end);
        prop_assert_eq!(whole.samples(), cut.samples());
        prop_assert_eq!(whole.beams(), cut.beams());
        prop_assert_eq!(whole.touches(), cut.touches());
    }
}
