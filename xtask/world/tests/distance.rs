//! Distance sensors: voltages, edges, noise, drop-outs and faults.

use core::f64::consts::{FRAC_PI_4, SQRT_2};

use proptest::prelude::*;
use world::SimTime;
use world::distance::{DistanceSensor, Edges, FULL_SCALE, Fault, Parameters, metres, volts};
use world::rover::{Mount, State};
use world::rows::Rows;
use world::scenario::Row;
use world::time::{at, from_seconds, seconds};
use world::units::{Length, Ratio};

const BARRIERS: &str = "[[section]]\nkind = \"barriers\"\nlength = \"50 m\"\nwidth = \"1 m\"\n";

/// Distance of the barrier from an aperture of the robot in the middle.
const BARRIER: f64 = (0.5 + 0.152) * SQRT_2;

fn rows(text: &str) -> Rows {
    let row: Row = toml::from_str(text).unwrap();
    Rows::new(&row, 1)
}

fn time(seconds: f64) -> SimTime {
    at(from_seconds(seconds))
}

/// A robot in the middle.
fn at_station(x: f64) -> State {
    State {
        x,
        y: 0.0,
        heading: 0.0,
        speed: 0.0,
        sideways: 0.0,
        turn: 0.0,
        way: 0.0,
    }
}

fn quiet() -> Parameters {
    Parameters {
        noise: Length::default(),
        noise_slope: Ratio::default(),
        ..Parameters::default()
    }
}

/// Distances of many measurements from one place.
fn measure(parameters: Parameters, rows: &Rows, x: f64, count: usize) -> Vec<Option<f64>> {
    let mut sensor = DistanceSensor::new(parameters, Mount::right(), 5, 1);
    (1..=count)
        .map(|i| {
            sensor.advance_to(time(i as f64 / 33.0 + 0.05), rows, |_| at_station(x));
            sensor.measured()
        })
        .collect()
}

#[test]
fn voltages_are_those_of_the_thesis() {
    assert_eq!(volts(Some(0.2)), 0.0);
    assert_eq!(volts(Some(10.0)), FULL_SCALE);
    assert!((volts(Some(5.1)) - 5.0 / 3.0).abs() < 1e-12);
    assert_eq!((volts(Some(0.1)), volts(Some(12.0))), (0.0, FULL_SCALE));
    assert_eq!(volts(None), FULL_SCALE);
    assert!((metres(volts(Some(0.77))) - 0.77).abs() < 1e-12);
}

#[test]
fn settings_are_read_and_checked() {
    let read = |text: &str| toml::from_str::<Parameters>(text).unwrap();
    assert_eq!(read(""), Parameters::default());
    assert_eq!(read("drop_outs = \"5 %\"").check(), Ok(()));
    for (text, sentence) in [
        (
            "period = \"5 ms\"",
            "distance.period: 0.005 s is out of range, it takes 0.03 s to 1 s",
        ),
        (
            "guard = \"60 cm\"",
            "distance.guard: 0.6 m is out of range, it takes 0 m to 0.5 m",
        ),
        (
            "drop_outs = \"101 %\"",
            "distance.drop_outs: 101 % is out of range, it takes 0 % to 100 %",
        ),
    ] {
        assert_eq!(read(text).check(), Err(sentence.to_owned()));
    }
    assert!(toml::from_str::<Parameters>("colour = \"red\"").is_err());
}

#[test]
fn each_sensor_measures_the_row_of_the_other_side() {
    let rows = rows(BARRIERS);
    let shifted = State {
        y: 0.1,
        ..at_station(10.0)
    };
    for (mount, side) in [(Mount::right(), 1.0), (Mount::left(), -1.0)] {
        let mut sensor = DistanceSensor::new(quiet(), mount, 1, 0);
        assert_eq!(sensor.volts(), 0.0);
        sensor.advance_to(time(0.1), &rows, |_| shifted);
        let expected = BARRIER + side * 0.1 * SQRT_2;
        let found = metres(sensor.volts());
        // The rays at the edge of the spot are 2 mm beside its middle.
        assert!((found - expected).abs() < 1e-3, "{found} {expected}");
        let beam = sensor.beam().unwrap();
        assert!((beam.to.1 + side * 0.5).abs() < 1e-9, "{beam:?}");
    }
}

#[test]
fn the_output_changes_at_the_sensors_rate_only() {
    let rows = rows(BARRIERS);
    let mut sensor = DistanceSensor::new(Parameters::default(), Mount::right(), 1, 0);
    let mut changes = 0;
    let mut before = sensor.volts();
    for i in 1..=20_000 {
        sensor.advance_to(time(f64::from(i) * 1e-3), &rows, |_| at_station(10.0));
        changes += usize::from(sensor.volts() != before);
        before = sensor.volts();
    }
    assert!((658..=660).contains(&changes), "{changes}");
}

#[test]
fn noise_grows_with_the_distance_and_differs_between_sensors() {
    let spread = |text: &str, slope: f64| {
        let parameters = Parameters {
            noise: Length::new(0.003),
            noise_slope: Ratio::new(slope),
            ..Parameters::default()
        };
        let all = measure(parameters, &rows(text), 10.0, 4000);
        let all: Vec<f64> = all.into_iter().flatten().collect();
        let mean = all.iter().sum::<f64>() / 4000.0;
        (all.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / 4000.0).sqrt()
    };
    let wide = BARRIERS.replace("1 m", "5 m");
    let far = (2.5 + 0.152) * SQRT_2;
    for (text, distance) in [(BARRIERS, BARRIER), (&wide, far)] {
        let expected = 0.003 + 0.002 * distance;
        let found = spread(text, 0.002);
        // Four standard errors of a standard deviation of 4000 values.
        assert!((found / expected - 1.0).abs() < 0.045, "{found} {expected}");
    }
    let rows = rows(BARRIERS);
    let noise = |number| {
        let mut sensor = DistanceSensor::new(Parameters::default(), Mount::right(), 1, number);
        sensor.advance_to(time(1.0), &rows, |_| at_station(10.0));
        sensor.measured()
    };
    assert_ne!(noise(0), noise(1));
}

#[test]
fn light_that_nothing_sends_back_counts_for_nothing() {
    let text = "[[section]]\nkind = \"barriers\"\nlength = \"5 m\"\nwidth = \"1 m\"\n";
    let rows = rows(text);
    // The aperture is where the beam's middle meets the barrier exactly at its end, 5 m.
    let aperture = 5.0 - 0.652 - Mount::right().ahead;
    let all: Vec<Option<f64>> = (-8..=8)
        .map(|i| measure(quiet(), &rows, aperture + f64::from(i) * 0.5e-3, 1)[0])
        .collect();
    // Light that nothing sends back counts for nothing.
    assert!(
        all.iter().flatten().all(|d| (d - BARRIER).abs() < 0.004),
        "{all:?}"
    );
    assert_eq!((all[0].is_some(), all[16]), (true, None));
}

/// How many measurements along the edge of a weed before a barrier give the distance of the weed, one
/// between the two, and that of the barrier.
fn along_an_edge(edges: Edges) -> (usize, usize, usize) {
    let weed = "[[section]]\nkind = \"barriers\"\nlength = \"10 m\"\nwidth = \"1 m\"\n\
                [[weed]]\nat = \"5 m\"\nright = \"-30 cm\"\ndiameter = \"10 cm\"\n";
    let parameters = Parameters { edges, ..quiet() };
    let rows = rows(weed);
    // The beam passes the middle of the weed at 5 cm, plus or minus the spot. It touches it 59 cm from
    // the aperture.
    let graze = 5.0 - 0.3 - 0.152 + 0.05 * SQRT_2 - Mount::right().ahead;
    let (mut between, mut near, mut far) = (0, 0, 0);
    for i in -8..=8 {
        match measure(parameters.clone(), &rows, graze + f64::from(i) * 1e-3, 1)[0] {
            Some(d) if d < 0.6 => near += 1,
            Some(d) if d > 0.9 => far += 1,
            Some(_) => between += 1,
            None => panic!("there is a barrier behind"),
        }
    }
    (near, between, far)
}

#[test]
fn a_spot_on_an_edge_gives_the_brightest_distance_or_the_mean() {
    let (near, between, far) = along_an_edge(Edges::Mean);
    assert!(
        near >= 2 && far >= 2 && between >= 2,
        "{near} {between} {far}"
    );
    let (near, between, far) = along_an_edge(Edges::Brightest);
    assert!(near >= 4 && far >= 4, "{near} {between} {far}");
    assert_eq!(between, 0);
}

#[test]
fn leaves_are_no_nearer_than_the_guard() {
    let text = format!(
        "{BARRIERS}[[leaves]]\nfrom = \"0 m\"\nto = \"50 m\"\ndensity = \"100 /m\"\nreach = \"1 m\"\n"
    );
    let rows = rows(&text);
    let mut least = f64::INFINITY;
    let mut held = 0;
    for i in 0..400 {
        let found = measure(quiet(), &rows, 3.0 + f64::from(i) * 0.1, 1)[0].unwrap();
        least = least.min(found);
        held += usize::from((found - 0.2).abs() < 1e-9);
    }
    assert!(least >= 0.2 - 1e-12 && held > 20, "{least} {held}");
}

#[test]
fn drop_outs_and_free_space_give_full_scale() {
    let rows = rows(BARRIERS);
    let parameters = Parameters {
        drop_outs: Ratio::new(0.1),
        ..quiet()
    };
    let lost = measure(parameters, &rows, 10.0, 4000);
    let lost = lost.iter().filter(|found| found.is_none()).count();
    // Four standard deviations.
    assert!((324..=476).contains(&lost), "{lost}");
    let mut sensor = DistanceSensor::new(quiet(), Mount::left(), 1, 0);
    sensor.advance_to(time(0.1), &rows, |_| at_station(60.0));
    assert_eq!((sensor.measured(), sensor.volts()), (None, FULL_SCALE));
}

#[test]
fn faults_hide_the_distance() {
    let rows = rows(BARRIERS);
    let mut sensor = DistanceSensor::new(Parameters::default(), Mount::left(), 1, 0);
    sensor.advance_to(time(0.1), &rows, |_| at_station(10.0));
    let before = sensor.volts();
    assert!((metres(before) - BARRIER).abs() < 0.02);
    for (fault, volts) in [
        (Fault::Open, 0.0),
        (Fault::ShortedToGround, 0.0),
        (Fault::ShortedToSupply, 3.6),
        (Fault::Frozen, before),
    ] {
        sensor.set_fault(Some(fault));
        assert_eq!(sensor.volts(), volts);
    }
    sensor.advance_to(time(0.5), &rows, |_| at_station(60.0));
    assert_eq!(sensor.volts(), before);
    sensor.set_fault(None);
    sensor.advance_to(time(0.6), &rows, |_| at_station(60.0));
    assert_eq!(sensor.volts(), FULL_SCALE);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn the_callers_times_change_nothing(seed: u64, mut cuts in prop::collection::vec(0.0..2.0_f64, 0..30)) {
        let text = "[[section]]\nkind = \"stalks\"\nlength = \"20 m\"\n";
        let row: Row = toml::from_str(text).unwrap();
        let rows = Rows::new(&row, seed);
        let state = |when: SimTime| at_station(2.0 + 0.8 * seconds(when));
        let new = || DistanceSensor::new(Parameters::default(), Mount::right(), seed, 1);
        let (mut whole, mut cut) = (new(), new());
        cuts.sort_by(f64::total_cmp);
        for when in cuts {
            cut.advance_to(time(when), &rows, state);
        }
        cut.advance_to(time(2.0), &rows, state);
        whole.advance_to(time(2.0), &rows, state);
        prop_assert_eq!(cut.volts(), whole.volts());
        prop_assert_eq!(cut.measured(), whole.measured());
        prop_assert_eq!(cut.beam(), whole.beam());
        prop_assert_eq!(cut.next_look(), whole.next_look());
    }

    #[test]
    fn any_heading_and_place_gives_a_voltage_in_range(
        seed: u64,
        x in -5.0..60.0_f64,
        y in -3.0..3.0_f64,
        heading in -4.0..4.0_f64,
    ) {
        let rows = rows(BARRIERS);
        let state = State { y, heading, ..at_station(x) };
        let mut sensor = DistanceSensor::new(Parameters::default(), Mount::left(), seed, 0);
        sensor.advance_to(time(0.2), &rows, |_| state);
        prop_assert!((0.0..=FULL_SCALE).contains(&sensor.volts()));
    }
}

#[test]
fn the_beam_of_the_picture_is_that_of_the_mount() {
    let rows = rows(BARRIERS);
    let mut sensor = DistanceSensor::new(quiet(), Mount::left(), 1, 0);
    assert_eq!(sensor.beam(), None);
    let state = State {
        heading: 0.2,
        ..at_station(10.0)
    };
    sensor.advance_to(time(0.2), &rows, |_| state);
    let beam = sensor.beam().unwrap();
    let direction = (beam.to.1 - beam.from.1).atan2(beam.to.0 - beam.from.0);
    assert!((direction - FRAC_PI_4 - 0.2).abs() < 1e-9);
}
