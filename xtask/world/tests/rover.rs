//! Compares the six-wheeled robot with closed-form solutions, and checks that only time and way
//! decide what happens to it.

use proptest::prelude::*;
use world::SimTime;
use world::rover::{Axles, Mount, Parameters, Rover, Side, State, Terrain};
use world::time::{at, from_seconds};
use world::units::{Angle, Density, Ratio};

/// Motors that are all alike, without lag or friction.
fn ideal() -> Parameters {
    Parameters {
        motors: Some([[1.0; 3]; 2]),
        lag: 0.0,
        friction: 0.0,
        ..Parameters::default()
    }
}

/// A floor on which the chassis never tips.
fn steady() -> Terrain {
    Terrain {
        tips: Density::default(),
        ..Terrain::default()
    }
}

fn time(seconds: f64) -> SimTime {
    at(from_seconds(seconds))
}

fn drive(rover: &mut Rover, left: f64, right: f64, until: f64) -> State {
    let now = rover.now();
    rover.set_effort(now, Side::Left, left);
    rover.set_effort(now, Side::Right, right);
    rover.advance_to(time(until));
    rover.state()
}

/// How much the chassis turns for a difference of both sides' speeds, rad/m, from the balance of
/// moments of four equal tyres.
fn turn_per_difference(p: &Parameters) -> f64 {
    let b = p.track / 2.0;
    let drag = (p.axle_spacing / (2.0 * b)).powi(2) * p.slip_along / p.slip_across;
    1.0 / (p.track * (1.0 + drag))
}

/// A seed whose robot begins on these axles.
fn seed(axles: Axles) -> u64 {
    let on = |seed: &u64| Rover::new(ideal(), steady(), (0.0, 0.0, 0.0), *seed).axles() == axles;
    (0..50).find(on).unwrap()
}

#[test]
fn equal_motors_drive_straight() {
    let mut rover = Rover::new(ideal(), steady(), (1.0, 2.0, 0.3), 1);
    let state = drive(&mut rover, 0.4, 0.4, 5.0);
    assert!(
        (state.x - 1.0 - 4.0 * 0.3_f64.cos()).abs() < 1e-9,
        "{state:?}"
    );
    assert!(
        (state.y - 2.0 - 4.0 * 0.3_f64.sin()).abs() < 1e-9,
        "{state:?}"
    );
    assert!((state.way - 4.0).abs() < 1e-9 && (state.speed - 0.8).abs() < 1e-12);
    assert_eq!((state.heading, state.turn), (0.3, 0.0));
}

#[test]
fn a_difference_turns_about_the_middle_of_the_axles_that_stand_on_the_ground() {
    for (axles, centre) in [(Axles::Front, 0.075), (Axles::Rear, -0.075)] {
        let mut rover = Rover::new(ideal(), steady(), (0.0, 0.0, 0.0), seed(axles));
        let state = drive(&mut rover, 0.3, -0.3, 4.0);
        let turned = 4.0 * 1.2 * turn_per_difference(&ideal());
        assert!((state.heading - turned).abs() < 1e-9, "{state:?}");
        // The left side was faster forwards: it turns right.
        assert!(turned > 2.0);
        // The centre of rotation has stayed where it was.
        let (x, y) = (
            state.x + centre * state.heading.cos(),
            state.y + centre * state.heading.sin(),
        );
        assert!((x - centre).abs() < 1e-4 && y.abs() < 1e-4, "{x} {y}");
    }
}

#[test]
fn the_wheels_reach_their_speed_with_a_lag_and_beyond_friction() {
    let parameters = Parameters {
        lag: 0.12,
        friction: 0.05,
        ..ideal()
    };
    let mut rover = Rover::new(parameters, steady(), (0.0, 0.0, 0.0), 1);
    let full = 2.0 * (0.5 - 0.05) / 0.95;
    let state = drive(&mut rover, 0.5, 0.5, 0.12);
    assert!((state.speed - full * (1.0 - (-1.0_f64).exp())).abs() < 1e-9);
    assert!((rover.wheel_speed(Side::Left) - state.speed).abs() < 1e-9);
    let state = drive(&mut rover, 0.5, 0.5, 3.0);
    assert!((state.speed - full).abs() < 1e-9);
    // The way is the speed's integral.
    assert!((state.way - full * (3.0 - 0.12 * (1.0 - (-25.0_f64).exp()))).abs() < 1e-5);
    let state = drive(&mut rover, 0.04, -0.05, 6.0);
    assert!(state.speed.abs() < 1e-9, "{state:?}");
}

#[test]
fn only_the_motors_of_the_axles_on_the_ground_drive() {
    let parameters = Parameters {
        motors: Some([[1.2, 1.0, 0.8], [1.0, 1.0, 1.0]]),
        ..ideal()
    };
    let gain = turn_per_difference(&parameters);
    for (axles, left) in [(Axles::Front, 1.1), (Axles::Rear, 0.9)] {
        let mut rover = Rover::new(parameters.clone(), steady(), (0.0, 0.0, 0.0), seed(axles));
        let state = drive(&mut rover, 0.5, 0.5, 1.0);
        assert!(
            (state.turn - (left - 1.0) * gain).abs() < 1e-9,
            "{axles:?} {state:?}"
        );
        assert!((state.speed - (left + 1.0) / 2.0).abs() < 1e-9);
    }
}

#[test]
fn a_slope_pulls_down_and_turns_against_the_axles_that_stand() {
    let slope = 5_f64.to_radians();
    let terrain = Terrain {
        slope: Angle::new(slope),
        ..steady()
    };
    let p = ideal();
    for (axles, centre) in [(Axles::Front, 0.075), (Axles::Rear, -0.075)] {
        let mut rover = Rover::new(p.clone(), terrain.clone(), (0.0, 0.0, 0.0), seed(axles));
        let state = drive(&mut rover, 0.4, 0.4, 0.001);
        let load = slope.sin() * 0.8;
        let resistance =
            (p.track / 2.0).powi(2) / p.slip_along + p.axle_spacing.powi(2) / (4.0 * p.slip_across);
        assert!(
            (state.turn + load * centre / resistance).abs() < 1e-4,
            "{state:?}"
        );
        // The wheels as a whole drift down by their slip angle.
        let drift = state.sideways + centre * state.turn;
        assert!((drift - load * p.slip_across).abs() < 1e-4, "{state:?}");
    }
}

#[test]
fn clods_and_tips_come_as_often_as_they_should() {
    let terrain = Terrain {
        clods: Density::new(2.0),
        slip_spread: Ratio::new(0.05),
        ..Terrain::default()
    };
    let mut rover = Rover::new(ideal(), terrain, (0.0, 0.0, 0.0), 3);
    rover.set_effort(time(0.0), Side::Left, 0.5);
    rover.set_effort(time(0.0), Side::Right, 0.5);
    let mut tips = 0;
    let mut before = rover.axles();
    for step in 1..=40_000 {
        rover.advance_to(time(f64::from(step) * 0.01));
        tips += usize::from(rover.axles() != before);
        before = rover.axles();
    }
    // 800 clods and 800 tips on 400 m: four standard deviations, and two tips within 1 cm are none.
    assert!((685..=915).contains(&rover.clods()), "{}", rover.clods());
    assert!((660..=915).contains(&tips), "{tips}");
    let state = rover.state();
    assert!((state.way - 400.0).abs() < 3.0, "{state:?}");
    assert!(state.heading.abs() > 0.05, "{state:?}");
}

#[test]
fn motors_differ_by_seed_as_much_as_they_should() {
    let speeds = |seed| {
        Rover::new(Parameters::default(), steady(), (0.0, 0.0, 0.0), seed)
            .full_speeds()
            .concat()
    };
    assert_eq!(speeds(1), speeds(1));
    assert_ne!(speeds(1), speeds(2));
    let all: Vec<f64> = (0..300).flat_map(speeds).collect();
    let mean = all.iter().sum::<f64>() / 1800.0;
    let spread = (all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 1800.0).sqrt();
    // Four standard errors.
    assert!((mean - 2.0).abs() < 0.012, "{mean}");
    assert!((spread - 0.12).abs() < 0.008, "{spread}");
}

#[test]
fn a_terrain_is_read_and_checked() {
    let read = |text: &str| toml::from_str::<Terrain>(text).unwrap();
    assert_eq!(read(""), Terrain::default());
    let field = "slope = \"2 deg\"\nslip = \"10 %\"\nslip_spread = \"5 %\"\nclods = \"0.5 /m\"";
    assert_eq!(read(field), Terrain::field());
    assert_eq!(read(field).check(), Ok(()));
    for (text, sentence) in [
        (
            "slope = \"31 deg\"",
            "terrain.slope: 31 deg is out of range, it takes 0 deg to 30 deg",
        ),
        (
            "slip = \"91 %\"",
            "terrain.slip: 91 % is out of range, it takes 0 % to 90 %",
        ),
        (
            "clods = \"-1 /m\"",
            "terrain.clods: -1 /m is out of range, it takes 0 /m to 20 /m",
        ),
        (
            "slip_length = \"0 m\"",
            "terrain.slip_length: 0 m is out of range, it takes 0.01 m to 100 m",
        ),
        (
            "clod_shift = \"1 m\"",
            "terrain.clod_shift: 1 m is out of range, it takes 0 m to 0.2 m",
        ),
    ] {
        assert_eq!(read(text).check(), Err(sentence.to_owned()));
    }
    assert!(toml::from_str::<Terrain>("mud = true").is_err());
}

#[test]
fn the_sensors_look_across_the_middle_and_cross_seven_inches_ahead() {
    let state = Rover::new(ideal(), steady(), (3.0, 1.0, 0.5), 1).state();
    for mount in [Mount::left(), Mount::right()] {
        let (x, y, heading) = mount.beam(&state);
        let reach = 0.152 * core::f64::consts::SQRT_2;
        let (x, y) = (x + reach * heading.cos(), y + reach * heading.sin());
        let ahead = 0.2286 + 7.0 * 0.0254;
        assert!((x - 3.0 - ahead * 0.5_f64.cos()).abs() < 5e-4, "{x}");
        assert!((y - 1.0 - ahead * 0.5_f64.sin()).abs() < 5e-4, "{y}");
    }
    assert!(Mount::right().right > 0.0 && Mount::right().yaw < 0.0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn neither_the_callers_steps_nor_looks_change_the_motion(
        seed: u64,
        commands in prop::collection::vec((0.0..0.2_f64, -1.0..1.0_f64, any::<bool>()), 1..12),
        cuts in prop::collection::vec(0.0..1.5_f64, 0..40),
    ) {
        let terrain = Terrain { clods: Density::new(3.0), tips: Density::new(10.0), ..Terrain::field() };
        let new = || Rover::new(Parameters::default(), terrain.clone(), (0.0, 0.0, 0.2), seed);
        let (mut whole, mut cut) = (new(), new());
        let mut at = 0.0;
        for (gap, effort, left) in commands {
            at += gap;
            let side = if left { Side::Left } else { Side::Right };
            // One is told everything in advance, the other when the time has come.
            whole.set_effort(time(at), side, effort);
            let mut looks: Vec<f64> = cuts.iter().copied().filter(|cut| *cut < at).collect();
            looks.sort_by(f64::total_cmp);
            for look in looks {
                cut.advance_to(time(look));
                let _ = cut.state_at(time(look + 0.01));
            }
            cut.advance_to(time(at));
            cut.set_effort(time(at), side, effort);
        }
        let end = time(at + 0.3337);
        let foreseen = cut.state_at(end);
        whole.advance_to(end);
        cut.advance_to(end);
        prop_assert_eq!(whole.state(), cut.state());
        prop_assert_eq!(foreseen, cut.state());
    }

    #[test]
    fn no_effort_moves_it_faster_than_its_motors(
        seed: u64,
        left in -1.5..1.5_f64,
        right in -1.5..1.5_f64,
        span in 0.01..2.0_f64,
    ) {
        let mut rover = Rover::new(Parameters::default(), Terrain::default(), (0.0, 0.0, 0.0), seed);
        let state = drive(&mut rover, left, right, span);
        let most = rover.full_speeds().concat().into_iter().fold(0.0, f64::max);
        prop_assert!(state.speed.abs() <= most);
        prop_assert!(state.turn.abs() <= 2.0 * most / rover.parameters().track);
        prop_assert!(state.x.hypot(state.y) <= (most + 0.075 * state.turn.abs().max(16.0)) * span);
    }
}
