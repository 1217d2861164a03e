//! The controller, in the target's precision, drives whole missions with a simulated vehicle.
//!
//! The aims on a field of one hectare with passes of 3 m: on the passes a mean cross-track error
//! within 1 cm and a deviation within 2 cm; within 10 cm in the turns; sections on and off within
//! 5 cm of the ends of each pass; 99.5 % of the field covered; and nothing that ends the run.

mod common;

use common::field::{Field, mission_settings};
use common::{Conditions, Plant};
use control::controller::{Controller, Settings};
use control::dubins::Pose;
use control::feedback::Limits;
use control::mission::{
    End, Legs, Mission, MissionSettings, Outputs, Planner, Purpose, Section, Stretch, check,
};
use control::model::{Antenna, Geometry};
use control::position::Position;
use control::response::{Departure, Response, ResponseSettings, ResponseWatch};
use control::safety::Command;
use control::vehicle::{Description, degrees};

/// A section of 3 m behind the rear axle, and the time that it needs to go down and up.
const SECTION: Section<f64> = Section {
    on_delay: 0.6,
    off_delay: 0.35,
    ahead: -0.5,
};

/// Figures of a run.
#[derive(Clone, Debug, Default)]
struct Figures {
    /// Cross-track errors of the controlled point on the passes, m.
    passes: Vec<f64>,
    /// Cross-track errors of the rear axle in turns, m.
    turns: Vec<f64>,
    /// How far beyond the end of the pass each section was switched, m.
    switched: Vec<f64>,
    /// For each row across the field, at each decimetre, the places that were covered (m east).
    covered: Vec<Vec<f64>>,
    /// Time of the run, s.
    time: f64,
    /// Changes of direction.
    reversals: usize,
}

/// One hectare.
const SIDE: f64 = 100.0;
const WIDTH: f64 = 3.0;

/// A vehicle and what it is to do.
#[derive(Clone, Copy)]
struct Task {
    name: &'static str,
    vehicle: Description,
    conditions: Conditions,
    /// Speed on the passes and in the turns, m/s.
    speed: f64,
    turn_speed: f64,
    headland: f64,
    /// Whether turns may be driven backwards.
    reverse: bool,
}

impl Task {
    fn field(&self) -> Field {
        Field {
            length: SIDE,
            // 34 passes of 3 m overlap by 6 cm.
            spacing: (SIDE - WIDTH) / 33.0,
            passes: 34,
            headland: self.headland,
            speed: self.speed,
        }
    }

    /// Drives the passes of the field. The vehicle starts six metres before the first one.
    fn drive(&self, seed: u64) -> Figures {
        self.begin(seed, |mut run| {
            while !run.step() {
                assert!(run.plant.time < 10_000.0, "it never ends");
            }
            assert_eq!(run.departed, None);
            run.figures.time = run.plant.time;
            run.figures
        })
    }

    /// Lets `drive` drive them.
    fn begin<R>(&self, seed: u64, drive: impl FnOnce(Drive<'_>) -> R) -> R {
        let settings = Settings::<f32>::for_vehicle(&self.vehicle).unwrap();
        let mut wanted = mission_settings(&settings, self.turn_speed);
        wanted.turn.reverse = self.reverse;
        let field = self.field();
        let (legs, fence) = (field.legs_and_way_out::<f32>(), field.fence::<f32>());
        let plan = Legs {
            origin: Position::new(0, 0),
            legs: &legs,
            fence: &fence,
            obstacles: &[],
            end: End::Stop,
        };
        check(&plan, &wanted).unwrap();
        let mut run = Drive::new(self, settings, &plan, wanted, seed);
        run.plant.north -= 6.0;
        drive(run)
    }

    /// Compares the figures of some seeds with the aims.
    fn judge(&self, seeds: &[u64]) {
        for &seed in seeds {
            self.drive(seed)
                .judge(&format!("{}, seed {seed}", self.name));
        }
    }
}

/// A run of a mission.
struct Drive<'a> {
    plant: Plant,
    plan: &'a Legs<'a, f32>,
    planner: Planner<f32>,
    controller: Controller<f32, Stretch<f32>>,
    outputs: Outputs<f32>,
    watch: ResponseWatch<f32>,
    applied: Command<f64>,
    on: bool,
    reverse: bool,
    /// What the section has been told and not yet done, with its time.
    told: Vec<(f64, bool)>,
    /// The speed at which the drive runs whatever it is told, m/s.
    stuck: Option<f64>,
    /// What would have ended the run, with the time.
    departed: Option<(f64, Departure)>,
    figures: Figures,
}

impl<'a> Drive<'a> {
    fn new(
        task: &Task,
        settings: Settings<f32>,
        plan: &'a Legs<'a, f32>,
        wanted: MissionSettings<f32>,
        seed: u64,
    ) -> Self {
        let stretch = Stretch::new(plan.origin(), wanted.pace);
        let section = Section {
            on_delay: SECTION.on_delay as f32,
            off_delay: SECTION.off_delay as f32,
            ahead: SECTION.ahead as f32,
        };
        Self {
            plant: Plant::of(task.vehicle, task.conditions, seed),
            plan,
            planner: Planner::new(wanted),
            controller: Controller::following(settings, stretch).unwrap(),
            outputs: Outputs::new([section; 8]),
            watch: ResponseWatch::new(ResponseSettings::of(&settings)),
            applied: Command {
                steering_rate: 0.0,
                speed: 0.0,
            },
            on: false,
            reverse: false,
            told: Vec::new(),
            stuck: None,
            departed: None,
            figures: Figures {
                covered: vec![Vec::new(); (SIDE * 10.0) as usize],
                ..Figures::default()
            },
        }
    }

    /// One control step, and the motion until the next. True at the end of the mission.
    fn step(&mut self) -> bool {
        let period = self.plant.vehicle.period;
        let heard = self.plant.hear();
        // As many steps as a task of low priority has time for.
        for _ in 0..10 {
            let current = self.controller.progress().segment;
            self.planner
                .feed(self.plan, self.controller.route_mut(), current);
        }
        let applied = Command {
            steering_rate: self.applied.steering_rate as f32,
            speed: self.applied.speed as f32,
        };
        let sample = heard.sample(applied, period as f32);
        let outcome = self.controller.step(&sample);
        let departure = self.watch.step(&Response::of(&sample, &outcome));
        let time = self.plant.time;
        self.departed = self.departed.or(departure.map(|what| (time, what)));
        // With the first velocities the estimate may still be poor.
        assert!(
            outcome.proposed.is_some() || time < 5.0,
            "lost after {time} s"
        );
        self.applied = Command {
            steering_rate: f64::from(outcome.command.steering_rate),
            speed: f64::from(outcome.command.speed),
        };
        let reverse = outcome.command.speed < 0.0;
        self.figures.reversals += usize::from(reverse != self.reverse);
        self.reverse = reverse;
        self.switch(outcome.tracking.speed, period);
        self.note();
        self.travel(period);
        outcome.finished
    }

    /// Tells the section when to move.
    fn switch(&mut self, speed: f32, period: f64) {
        let (stretch, progress) = (self.controller.route(), self.controller.progress());
        let before = self.outputs.state() & 1 != 0;
        let direction = if self.reverse { -1.0 } else { 1.0 };
        let switching = self
            .outputs
            .step(stretch, progress, direction * speed, period as f32);
        let now = switching.now & 1 != 0;
        let delay = |on: bool| {
            if on {
                SECTION.on_delay
            } else {
                SECTION.off_delay
            }
        };
        let time = self.plant.time;
        if now != before {
            self.told.push((time + delay(now), now));
        }
        if let Some(later) = switching.later[0] {
            self.told
                .push((time + f64::from(later) + delay(!now), !now));
        }
    }

    /// Notes the cross-track error.
    fn note(&mut self) {
        let (stretch, progress) = (self.controller.route(), self.controller.progress());
        let Some(piece) = stretch.piece(progress.segment) else {
            return;
        };
        let plant = &self.plant;
        let (north, east) = if piece.purpose == Purpose::Leg {
            plant.controlled()
        } else {
            (plant.north, plant.east)
        };
        let place = piece
            .segment
            .locate(north as f32, east as f32, progress.along);
        let error = f64::from(place.cross_track);
        match piece.purpose {
            Purpose::Turn | Purpose::Approach => self.figures.turns.push(error),
            // The vehicle begins beside the first pass.
            Purpose::Leg if place.along >= 0.0 => self.figures.passes.push(error),
            Purpose::Leg => {}
        }
    }

    /// Drives for a period. The section moves in it.
    fn travel(&mut self, period: f64) {
        let steps = (period / 0.001).round() as usize;
        let command = Command {
            speed: self.stuck.unwrap_or(self.applied.speed),
            ..self.applied
        };
        for _ in 0..steps {
            let before = self.plant.point(SECTION.ahead);
            self.plant.drive(command, 0.001);
            let (north, east) = self.plant.point(SECTION.ahead);
            while let Some(&(time, on)) = self.told.first()
                && time <= self.plant.time
            {
                self.told.remove(0);
                // Passes lead north and back in turn.
                let northward = self.plant.heading.cos() > 0.0;
                let border = if northward == on { 0.0 } else { SIDE };
                let beyond = north - border;
                self.figures
                    .switched
                    .push(if northward { beyond } else { -beyond });
                self.on = on;
            }
            let row = (north * 10.0).floor();
            let crossed = (before.0 * 10.0).floor() != row;
            if self.on && crossed && row >= 0.0 {
                // Driven southward, the row's other side is crossed.
                if let Some(places) = self.figures.covered.get_mut(row as usize) {
                    places.push(east);
                }
            }
        }
    }
}

impl Figures {
    fn mean(&self) -> f64 {
        self.passes.iter().sum::<f64>() / self.passes.len() as f64
    }

    fn mean_size(&self) -> f64 {
        self.passes.iter().map(|error| error.abs()).sum::<f64>() / self.passes.len() as f64
    }

    fn deviation(&self) -> f64 {
        let mean = self.mean();
        let square = self.passes.iter().map(|error| (error - mean).powi(2));
        (square.sum::<f64>() / self.passes.len() as f64).sqrt()
    }

    fn worst(errors: &[f64]) -> f64 {
        errors.iter().map(|error| error.abs()).fold(0.0, f64::max)
    }

    /// Share of the field that the section went over.
    fn coverage(&self) -> f64 {
        let (west, east) = (-WIDTH / 2.0, SIDE - WIDTH / 2.0);
        let covered: f64 = self
            .covered
            .iter()
            .map(|places| {
                let mut places = places.clone();
                places.sort_by(f64::total_cmp);
                let mut reached = west;
                let mut sum = 0.0;
                for place in places {
                    let begin = (place - WIDTH / 2.0).max(reached);
                    let end = (place + WIDTH / 2.0).min(east);
                    sum += (end - begin).max(0.0);
                    reached = reached.max(end);
                }
                sum
            })
            .sum();
        covered / self.covered.len() as f64 / (east - west)
    }

    /// Prints the figures and compares them with the aims.
    fn judge(&self, name: &str) {
        let (mean, size, deviation) = (self.mean(), self.mean_size(), self.deviation());
        let (turns, switched) = (Self::worst(&self.turns), Self::worst(&self.switched));
        println!(
            "{name}: {:.0} s, {} changes of direction; passes: mean {:.2} cm, mean size {:.2} cm, \
             deviation {:.2} cm, worst {:.1} cm; turns: worst {:.1} cm; switched {} times, worst \
             {:.1} cm; covered {:.2} %",
            self.time,
            self.reversals,
            mean * 100.0,
            size * 100.0,
            deviation * 100.0,
            Self::worst(&self.passes) * 100.0,
            turns * 100.0,
            self.switched.len(),
            switched * 100.0,
            self.coverage() * 100.0,
        );
        assert_eq!(self.switched.len(), 68, "{name}");
        assert!(
            size <= 0.01 && deviation <= 0.02,
            "{name}: {size}, {deviation}"
        );
        assert!(turns <= 0.10, "{name}: {turns} m in turns");
        assert!(switched <= 0.05, "{name}: switched {switched} m off");
        assert!(self.coverage() >= 0.995, "{name}: {}", self.coverage());
    }
}

/// A tractor: a wheelbase of 2.5 m and 40 degrees of steering, at 3 m/s.
const TRACTOR: Description = Description {
    geometry: Geometry { l1: 1.0, l2: 1.5 },
    antenna: Antenna {
        right: 0.0,
        height: 0.0,
    },
    limits: Limits {
        steering_angle: degrees(40.0),
        steering_rate: degrees(25.0),
        speed: 3.5,
    },
    cruise: 3.0,
    weights: None,
    ..common::example::VEHICLE
};

/// Level ground.
fn level() -> Conditions {
    Conditions {
        offset: 0.1,
        ..Conditions::default()
    }
}

fn at_one() -> Task {
    Task {
        name: "1 m/s",
        vehicle: common::example::VEHICLE,
        conditions: level(),
        speed: 1.0,
        turn_speed: 1.0,
        headland: 9.0,
        reverse: true,
    }
}

fn at_two() -> Task {
    Task {
        name: "2 m/s",
        speed: 2.0,
        turn_speed: 1.2,
        ..at_one()
    }
}

fn tractor() -> Task {
    Task {
        name: "tractor at 3 m/s",
        vehicle: TRACTOR,
        speed: 3.0,
        turn_speed: 1.5,
        headland: 14.0,
        ..at_one()
    }
}

#[test]
fn a_hectare_at_one_metre_a_second() {
    at_one().judge(&[1, 2]);
}

#[test]
fn a_hectare_at_two_metres_a_second() {
    at_two().judge(&[1, 2]);
}

#[test]
fn a_hectare_with_a_tractor_at_three_metres_a_second() {
    tractor().judge(&[1, 2]);
}

/// A slope of 3 degrees, misaligned sensors, and a steering of 70 % of its rate.
#[test]
fn a_hectare_on_a_slope() {
    let conditions = Conditions {
        offset: 0.1,
        ..Conditions::loaded()
    };
    for task in [at_two(), tractor()] {
        let name = match task.name {
            "2 m/s" => "2 m/s, loaded",
            _ => "tractor, loaded",
        };
        let loaded = Task {
            name,
            conditions,
            ..task
        };
        loaded.judge(&[1]);
    }
}

/// Omega turns.
#[test]
fn a_hectare_without_reverse() {
    let forward = Task {
        name: "2 m/s, forward only",
        reverse: false,
        ..at_two()
    };
    let figures = forward.drive(1);
    figures.judge(forward.name);
    assert_eq!(figures.reversals, 0);
}

/// Drives until `begins` is true, and then with a drive that runs at `speed` (m/s) until the run ends, for 20 s at most. Returns
/// how long it took and why, and the way, m.
fn stuck(
    speed: f64,
    begins: impl Fn(&Drive<'_>) -> bool,
    then: impl Fn(&mut Drive<'_>),
) -> Option<(f64, Departure, f64)> {
    at_one().begin(1, |mut run| {
        while !begins(&run) {
            assert!(!run.step() && run.departed.is_none());
        }
        let (begin, north, east) = (run.plant.time, run.plant.north, run.plant.east);
        run.stuck = Some(if run.reverse { -speed } else { speed });
        then(&mut run);
        while run.departed.is_none() && run.plant.time < begin + 20.0 {
            run.step();
        }
        let way = (run.plant.north - north).hypot(run.plant.east - east);
        run.departed.map(|(time, what)| (time - begin, what, way))
    })
}

/// A pause takes the command back to rest, whatever the vehicle does.
#[test]
fn a_drive_that_does_not_slow_ends_a_paused_run() {
    for speed in [0.3, 0.5, 0.8, 1.0] {
        let pause = |run: &mut Drive<'_>| run.controller.route_mut().pause();
        let ended = stuck(speed, |run| run.plant.time > 30.0, pause);
        println!("{speed}: {ended:?}");
        let (time, what, _) = ended.unwrap();
        assert_eq!(what, Departure::Speed, "{speed} m/s");
        assert!(time < 7.0, "{speed} m/s: {time} s");
    }
}

/// Where the direction changes, a drive that goes on leads beyond the end of the path's piece.
#[test]
fn a_drive_that_does_not_turn_back_ends_the_run() {
    let before_change = |run: &Drive<'_>| {
        let (stretch, progress) = (run.controller.route(), run.controller.progress());
        let pieces = [progress.segment, progress.segment + 1].map(|it| stretch.piece(it));
        match pieces {
            [Some(piece), Some(next)] => {
                piece.reverse != next.reverse && piece.segment.length - progress.along < 0.5
            }
            _ => false,
        }
    };
    for speed in [0.3, 0.4, 0.49] {
        let ended = stuck(speed, before_change, |_| ());
        println!("{speed}: {ended:?}");
        let (_, what, way) = ended.unwrap();
        assert!(
            matches!(what, Departure::Speed | Departure::Path),
            "{what:?}"
        );
        // Half a metre to the end, one beyond it, half a second, and the age of the data.
        assert!(way < 1.5 + 0.75 * speed + 0.1, "{speed} m/s: {way} m");
    }
}

/// A pause stops the vehicle gently and switches the section off; afterwards the pass goes on.
#[test]
fn a_pause_in_a_pass() {
    let task = at_one();
    let settings = Settings::<f32>::for_vehicle(&task.vehicle).unwrap();
    let wanted = mission_settings(&settings, task.turn_speed);
    let field = Field {
        passes: 1,
        length: 40.0,
        ..task.field()
    };
    let legs = field.legs_and_way_out::<f32>();
    let plan = Legs {
        origin: Position::new(0, 0),
        legs: &legs,
        fence: &[],
        obstacles: &[],
        end: End::Stop,
    };
    let mut run = Drive::new(&task, settings, &plan, wanted, 5);
    run.plant.north -= 6.0;
    while run.plant.north < 20.0 {
        assert!(!run.step());
    }
    assert!(run.on && run.plant.speed > 0.9);
    run.controller.route_mut().pause();
    let (paused, wheels) = (run.plant.north, run.plant.steering);
    for _ in 0..100 {
        assert!(!run.step());
    }
    let way = run.plant.north - paused;
    // 1 m at 0.5 m/s^2, and the lag of the drive.
    assert!((0.8..1.8).contains(&way), "{way} m until it stood");
    assert!(!run.on && run.plant.speed < 0.01);
    assert!((run.plant.steering - wheels).abs() < 0.05);
    run.controller.route_mut().resume();
    while !run.step() {
        assert!(run.plant.time < 200.0, "it never ends");
    }
    let figures = &run.figures;
    assert_eq!(figures.switched.len(), 4);
    assert!(Figures::worst(&figures.passes) < 0.05);
}

/// Drives a random vehicle over four passes with headland turns between them, at a speed in the turns
/// at which its clothoids turn by at most half a radian. Returns the figures, and what would have
/// ended the run.
fn random(seed: u64) -> (Figures, Option<(f64, Departure)>) {
    let vehicle = common::random(&mut common::Noise::new(seed + 1));
    let settings = Settings::<f32>::for_vehicle(&vehicle).unwrap();
    let limits = settings.guidance.limits;
    let wheelbase = vehicle.geometry.wheelbase();
    let curvature = (f64::from(limits.steering_angle) * 0.8).tan() / wheelbase;
    let rate = f64::from(limits.steering_rate) * 0.8;
    let task = Task {
        name: "random",
        vehicle,
        speed: vehicle.cruise,
        turn_speed: vehicle.cruise.min(rate / (wheelbase * curvature.powi(2))),
        reverse: seed.is_multiple_of(2),
        ..at_one()
    };
    let field = Field {
        passes: 4,
        length: 60.0,
        ..task.field()
    };
    let mut wanted = mission_settings(&settings, task.turn_speed);
    wanted.turn.reverse = task.reverse;
    let legs = field.legs_and_way_out::<f32>();
    let plan = Legs {
        origin: Position::new(0, 0),
        legs: &legs,
        fence: &[],
        obstacles: &[],
        end: End::Stop,
    };
    check(&plan, &wanted).unwrap();
    let mut run = Drive::new(&task, settings, &plan, wanted, seed);
    // So far before the first pass that the estimator knows its biases there.
    run.plant.north -= 6.0 + 8.0 * vehicle.cruise;
    while !run.step() {
        assert!(run.plant.time < 10_000.0, "seed {seed}: it never ends");
    }
    (run.figures, run.departed)
}

/// Compares the figures of random vehicles with aims of their own. The watch judges a speed by that of
/// the antenna, so it is asked only where the antenna is less than one and a half wheelbases ahead.
fn judge_random(seeds: std::ops::Range<u64>) {
    let (mut passes, mut turns) = (0.0_f64, 0.0_f64);
    for seed in seeds {
        let (figures, departed) = random(seed);
        let (size, worst) = (figures.mean_size(), Figures::worst(&figures.turns));
        (passes, turns) = (passes.max(size), turns.max(worst));
        assert!(
            size < 0.02 && worst < 0.15,
            "seed {seed}: {size} m, {worst} m"
        );
        let vehicle = common::random(&mut common::Noise::new(seed + 1));
        let near = vehicle.geometry.l1 < 1.5 * vehicle.geometry.wheelbase();
        assert!(!near || departed.is_none(), "seed {seed}: {departed:?}");
    }
    println!(
        "random vehicles: mean size on passes {:.2} cm at most, {:.1} cm in turns",
        passes * 100.0,
        turns * 100.0
    );
}

#[test]
fn any_sound_vehicle_drives_a_mission() {
    judge_random(0..40);
}

#[test]
#[ignore = "more vehicles of the test above, about a minute"]
fn more_vehicles_drive_a_mission() {
    judge_random(40..400);
}

/// From anywhere in the field the vehicle drives to a pass and goes on there.
#[test]
fn a_pass_is_approached() {
    let task = at_one();
    let settings = Settings::<f32>::for_vehicle(&task.vehicle).unwrap();
    let wanted = mission_settings(&settings, task.turn_speed);
    let field = Field {
        passes: 4,
        length: 40.0,
        ..task.field()
    };
    let (legs, fence) = (field.legs_and_way_out::<f32>(), field.fence::<f32>());
    let plan = Legs {
        origin: Position::new(0, 0),
        legs: &legs,
        fence: &fence,
        obstacles: &[],
        end: End::Stop,
    };
    for (seed, north, east, heading) in [
        (1, 20.0, 0.0, 0.5),
        (2, 30.0, 8.0, -2.0),
        (3, 12.0, 10.0, 3.0),
        (4, 5.0, 4.0, -1.5),
    ] {
        let mut run = Drive::new(&task, settings, &plan, wanted, seed);
        (run.plant.north, run.plant.east, run.plant.heading) = (north, east, heading);
        // The heading is known once the vehicle has moved two metres ahead.
        let from = Pose {
            north: (north + 2.0 * heading.cos()) as f32,
            east: (east + 2.0 * heading.sin()) as f32,
            heading: heading as f32,
        };
        // The third pass, 15 m from its beginning.
        run.planner = Planner::approaching(wanted, &plan, (2, 15.0), from).unwrap();
        while !run.step() {
            assert!(run.plant.time < 400.0, "it never ends");
        }
        let (passes, turns) = (&run.figures.passes, &run.figures.turns);
        let worst = (Figures::worst(passes), Figures::worst(turns));
        println!(
            "seed {seed}: {:.1} cm on passes, {:.1} cm before",
            worst.0 * 100.0,
            worst.1 * 100.0
        );
        assert!(worst.0 < 0.05 && worst.1 < 0.15, "{worst:?}");
        // On for the rest of the third pass, and for the fourth.
        assert_eq!(run.figures.switched.len(), 4);
        let rows = &run.figures.covered;
        assert_eq!((rows[140].len(), rows[200].len()), (1, 2));
    }
}

#[test]
#[ignore = "more seeds of the first three tests, about 20 s"]
fn hectares_of_more_seeds() {
    for task in [at_one(), at_two(), tractor()] {
        task.judge(&[3, 4, 5, 6, 7]);
    }
}
