//! A simulated field for tests of row following: two rows of stalks with leaves
//! and gaps, a differentially steered robot, and its two distance sensors.
//!
//! The field has its own geometry, written without the crate's: rays that end at
//! the nearest of many discs.

#![allow(dead_code, reason = "each test uses some of it")]

use crate::common::Noise;
use control::calibration::{Actuator, Direction};
use control::row::{Mounting, Odds, RowController, RowDistances, RowRobot, RowSettings, Sides};

/// A stretch of one row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stretch {
    /// -1 for the left row, 1 for the right one, 0 for both.
    pub(crate) side: i32,
    pub(crate) from: f64,
    pub(crate) to: f64,
}

impl Stretch {
    fn covers(&self, side: i32, along: f64) -> bool {
        (self.side == 0 || self.side == side) && (self.from..self.to).contains(&along)
    }
}

/// What grows in a field.
#[derive(Clone, Debug)]
pub(crate) struct Crop {
    pub(crate) length: f64,
    pub(crate) half_width: f64,
    pub(crate) spacing: f64,
    pub(crate) diameter: f64,
    /// Standard deviation of the stalks beside their line, m.
    pub(crate) scatter: f64,
    /// Share of the plants that are missing.
    pub(crate) missing: f64,
    /// Leaves for a metre of row, on each face of it.
    pub(crate) leaves: f64,
    /// Leaves for a metre in the leafy stretches, on the face to the robot.
    pub(crate) thicket: f64,
    /// How far leaves reach from the line, m.
    pub(crate) overhang: f64,
    pub(crate) leafy: Vec<Stretch>,
    pub(crate) gaps: Vec<Stretch>,
    /// 1/m, positive to the right.
    pub(crate) curvature: f64,
}

impl Crop {
    /// The thesis's corn: rows 30 inches apart and 75 feet long, a plant every
    /// 8 inches.
    pub(crate) fn corn() -> Self {
        Self {
            length: 22.86,
            half_width: 0.381,
            spacing: 0.2032,
            diameter: 0.025,
            scatter: 0.015,
            missing: 0.05,
            leaves: 1.5,
            thicket: 25.0,
            overhang: 0.25,
            leafy: Vec::new(),
            gaps: Vec::new(),
            curvature: 0.0,
        }
    }

    /// Corn with leaves on one side over more than 3 m, twice, and with gaps up to
    /// 1 m on either side and on both at once.
    pub(crate) fn hard() -> Self {
        let stretch = |side, from, to| Stretch { side, from, to };
        Self {
            leafy: vec![stretch(1, 3.0, 6.5), stretch(-1, 13.0, 16.5)],
            gaps: vec![
                stretch(-1, 8.0, 9.0),
                stretch(1, 10.0, 11.0),
                stretch(0, 18.5, 19.5),
            ],
            ..Self::corn()
        }
    }

    /// The crop in a mirror.
    pub(crate) fn mirrored(&self) -> Self {
        let turn = |stretches: &[Stretch]| {
            let mirror = |stretch: &Stretch| Stretch {
                side: -stretch.side,
                ..*stretch
            };
            stretches.iter().map(mirror).collect()
        };
        Self {
            leafy: turn(&self.leafy),
            gaps: turn(&self.gaps),
            curvature: -self.curvature,
            ..self.clone()
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Disc {
    along: f64,
    x: f64,
    y: f64,
    radius: f64,
    stalk: bool,
}

/// A crop that has grown from a seed.
pub(crate) struct Field {
    pub(crate) crop: Crop,
    /// Sorted by their place along the rows.
    discs: Vec<Disc>,
}

impl Field {
    pub(crate) fn new(crop: &Crop, seed: u64) -> Self {
        let mut noise = Noise::new(seed ^ 0x0F1E_1D00);
        let mut field = Self {
            crop: crop.clone(),
            discs: Vec::new(),
        };
        for side in [-1, 1] {
            let line = f64::from(side) * crop.half_width;
            let mut along = -1.0 + crop.spacing * noise.uniform();
            while along < crop.length {
                let at = along + 0.01 * noise.normal();
                let beside = crop.scatter * noise.normal();
                let is_missing = noise.uniform() < crop.missing
                    || crop.gaps.iter().any(|gap| gap.covers(side, along));
                if !is_missing {
                    field.add(at, line + beside, crop.diameter / 2.0, true);
                }
                along += crop.spacing;
            }
            for inward in [false, true] {
                let mut along = -1.0;
                while along < crop.length {
                    let is_leafy =
                        inward && crop.leafy.iter().any(|leafy| leafy.covers(side, along));
                    let density = if is_leafy { crop.thicket } else { crop.leaves };
                    let step = -noise.uniform().ln() / density.max(0.01);
                    let reach = crop.overhang * noise.uniform();
                    let radius = 0.01 + 0.03 * noise.uniform();
                    along += step.min(0.5);
                    let grows = step < 0.5 && !crop.gaps.iter().any(|gap| gap.covers(side, along));
                    if grows && along < crop.length {
                        let towards = if inward { -reach } else { reach };
                        field.add(along, line + f64::from(side) * towards, radius, false);
                    }
                }
            }
        }
        field.discs.sort_by(|a, b| a.along.total_cmp(&b.along));
        field
    }

    fn add(&mut self, along: f64, beside: f64, radius: f64, stalk: bool) {
        let (x, y, _) = self.place(along, beside);
        self.discs.push(Disc {
            along,
            x,
            y,
            radius,
            stalk,
        });
    }

    /// Place and heading of a point `along` the middle line and `beside` it.
    pub(crate) fn place(&self, along: f64, beside: f64) -> (f64, f64, f64) {
        let bend = self.crop.curvature;
        let heading = bend * along;
        let (x, y) = if bend == 0.0 {
            (along, 0.0)
        } else {
            (heading.sin() / bend, (1.0 - heading.cos()) / bend)
        };
        (
            x - beside * heading.sin(),
            y + beside * heading.cos(),
            heading,
        )
    }

    /// Place of a point along the middle line, beside it, and the line's heading.
    pub(crate) fn locate(&self, x: f64, y: f64) -> (f64, f64, f64) {
        let bend = self.crop.curvature;
        if bend == 0.0 {
            return (x, y, 0.0);
        }
        let (across, down) = (bend * x, 1.0 - bend * y);
        let heading = across.atan2(down);
        (heading / bend, (1.0 - across.hypot(down)) / bend, heading)
    }

    fn near(&self, from: f64, to: f64) -> &[Disc] {
        let first = self.discs.partition_point(|disc| disc.along < from);
        let last = self.discs.partition_point(|disc| disc.along < to);
        &self.discs[first..last]
    }

    /// Distance along a ray to the first disc; 4 m without one.
    pub(crate) fn ray(&self, x: f64, y: f64, angle: f64) -> f64 {
        let (sine, cosine) = angle.sin_cos();
        let (along, ..) = self.locate(x, y);
        let mut nearest = 4.0_f64;
        for disc in self.near(along - 0.3, along + 2.2) {
            let (dx, dy) = (disc.x - x, disc.y - y);
            let beside = dy * cosine - dx * sine;
            let ahead = dx * cosine + dy * sine;
            // The guard in front of a sensor pushes leaves away.
            if beside.abs() < disc.radius && ahead > 0.25 {
                nearest = nearest.min(ahead - (disc.radius.powi(2) - beside.powi(2)).sqrt());
            }
        }
        nearest.max(0.0)
    }

    /// Whether a robot 0.457 m long and 0.304 m wide touches a stalk.
    fn touches(&self, x: f64, y: f64, heading: f64) -> bool {
        let (along, ..) = self.locate(x, y);
        let (sine, cosine) = heading.sin_cos();
        self.near(along - 0.4, along + 0.4)
            .iter()
            .filter(|disc| disc.stalk)
            .any(|disc| {
                let (dx, dy) = (disc.x - x, disc.y - y);
                let ahead = (dx * cosine + dy * sine).abs() - 0.2285;
                let beside = (dy * cosine - dx * sine).abs() - 0.152;
                ahead.max(0.0).hypot(beside.max(0.0)) < disc.radius
            })
    }
}

/// Conditions of a run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ground {
    /// True speed of the left and right wheels, as shares of the calibrated one.
    pub(crate) motors: (f64, f64),
    /// Mean way between clods, m.
    pub(crate) clod_way: f64,
    /// Standard deviation of the turn by a clod, rad.
    pub(crate) clod: f64,
    /// Mean distance between the wheels as it acts in a turn, m.
    pub(crate) track: f64,
    /// Time between two readings of a sensor, s.
    pub(crate) reading: f64,
    /// Standard deviation of a reading, m.
    pub(crate) noise: f64,
    /// Start: right of the middle, m, and heading, rad.
    pub(crate) start: (f64, f64),
}

impl Ground {
    pub(crate) fn rough(seed: u64) -> Self {
        let mut noise = Noise::new(seed ^ 0x6_0B0D);
        let mut vary = |by: f64| by * (2.0 * noise.uniform() - 1.0);
        Self {
            motors: (1.0 + vary(0.04), 1.0 + vary(0.04)),
            clod_way: 2.0,
            clod: 3.0_f64.to_radians(),
            track: 0.45 * (1.0 + vary(0.15)),
            reading: 0.02,
            noise: 0.005,
            start: (vary(0.04), vary(0.05)),
        }
    }
}

/// The robot in its field.
pub(crate) struct Robot<'a> {
    pub(crate) field: &'a Field,
    ground: Ground,
    noise: Noise,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) heading: f64,
    wheels: (f64, f64),
    kick: f64,
    /// Turning point ahead of the middle of the chassis, m, and slip in turns.
    centre: f64,
    slip: f64,
    next_reading: f64,
    readings: [f64; 2],
    time: f64,
    pub(crate) way: f64,
    pub(crate) touched: bool,
}

/// Time between two steps, s.
pub(crate) const STEP: f64 = 0.005;
/// Speed of the wheels at full effort and dead band, as calibrated.
pub(crate) const FULL_SPEED: f64 = 1.6;
pub(crate) const DEAD_BAND: f64 = 0.04;

impl<'a> Robot<'a> {
    pub(crate) fn new(field: &'a Field, ground: Ground, seed: u64) -> Self {
        let (x, y, heading) = field.place(0.0, ground.start.0);
        Self {
            field,
            ground,
            noise: Noise::new(seed ^ 0x0B07),
            x,
            y,
            heading: heading + ground.start.1,
            wheels: (0.0, 0.0),
            kick: 0.0,
            centre: 0.0,
            slip: 1.0,
            next_reading: 0.0,
            readings: [1.5; 2],
            time: 0.0,
            way: 0.0,
            touched: false,
        }
    }

    /// Distances to the left and the right row as the bus carries them: whole
    /// centimetres up to 1.50 m; here in metres.
    pub(crate) fn distances(&mut self) -> (f64, f64) {
        if self.time >= self.next_reading {
            self.next_reading += self.ground.reading;
            for (reading, mounted) in self.readings.iter_mut().zip([0.152, -0.152]) {
                let (sine, cosine) = self.heading.sin_cos();
                let angle = self.heading - std::f64::consts::FRAC_PI_4 * f64::signum(mounted);
                // The spot of light is 6 mm wide; the sensor takes its mean.
                let mut sum = 0.0;
                for spot in [-0.003, 0.0, 0.003] {
                    let (ahead, beside) = (0.2545, mounted + spot);
                    let x = self.x + ahead * cosine - beside * sine;
                    let y = self.y + ahead * sine + beside * cosine;
                    sum += self.field.ray(x, y, angle);
                }
                let measured = sum / 3.0 + self.ground.noise * self.noise.normal();
                *reading = (measured * 100.0).round().clamp(0.0, 150.0) / 100.0;
            }
        }
        (self.readings[0], self.readings[1])
    }

    /// Drives a step with efforts of the left and the right motors.
    pub(crate) fn drive(&mut self, left: f64, right: f64) {
        let speed = |effort: f64, share: f64| {
            let beyond = (effort.abs() - DEAD_BAND).max(0.0) / (1.0 - DEAD_BAND);
            beyond * FULL_SPEED * share * effort.signum()
        };
        let follow = STEP / 0.1;
        let Ground { motors, track, .. } = self.ground;
        self.wheels.0 += (speed(left, motors.0) - self.wheels.0) * follow;
        self.wheels.1 += (speed(right, motors.1) - self.wheels.1) * follow;
        let ahead = (self.wheels.0 + self.wheels.1) / 2.0 * 0.97 * STEP;
        let way = ahead.abs();
        if self.noise.uniform() < way / self.ground.clod_way {
            self.kick += self.ground.clod * self.noise.normal();
        }
        // The six wheels turn about the front or the rear pair of axles.
        if self.noise.uniform() < way / 0.5 {
            self.centre = if self.noise.uniform() < 0.5 {
                0.07
            } else {
                -0.07
            };
            self.slip = 1.0 + 0.15 * (2.0 * self.noise.uniform() - 1.0);
        }
        // A clod acts over about 5 cm.
        let kicked = self.kick * (way / 0.05).min(1.0);
        self.kick -= kicked;
        let turned = (self.wheels.0 - self.wheels.1) / (track * self.slip) * STEP + kicked;
        let (sine, cosine) = self.heading.sin_cos();
        self.x += ahead * cosine + self.centre * turned * sine;
        self.y += ahead * sine - self.centre * turned * cosine;
        self.heading += turned;
        self.way += way;
        self.time += STEP;
        self.touched |= self.field.touches(self.x, self.y, self.heading);
    }

    /// Place along the rows, and right of their middle, m.
    pub(crate) fn at(&self) -> (f64, f64) {
        let (along, beside, _) = self.field.locate(self.x, self.y);
        (along, beside)
    }
}

/// Record of a run.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Run {
    /// Mean of the offset's magnitude within the rows, m.
    pub(crate) mean: f64,
    pub(crate) largest: f64,
    pub(crate) touched: bool,
    /// Where the robot was at the end of the run, along the rows, m.
    pub(crate) end: f64,
    /// Share of the time before the end of the rows in which it stood.
    pub(crate) stood: f64,
}

/// Lets `law` drive through a field: from the distances to the left and the
/// right row to the efforts of the left and the right motors.
pub(crate) fn run(
    field: &Field,
    ground: Ground,
    seed: u64,
    seconds: f64,
    mut law: impl FnMut(f64, f64, &Robot<'_>) -> (f64, f64),
) -> Run {
    let mut robot = Robot::new(field, ground, seed);
    let mut run = Run::default();
    let mut counted = 0.0;
    let mut stood = 0.0;
    for _ in 0..(seconds / STEP) as usize {
        let (left, right) = robot.distances();
        let (left, right) = law(left, right, &robot);
        robot.drive(left, right);
        let (along, beside) = robot.at();
        run.end = along;
        if along < field.crop.length {
            counted += 1.0;
            run.mean += beside.abs();
            run.largest = run.largest.max(beside.abs());
            if left == 0.0 && right == 0.0 {
                stood += 1.0;
            }
        }
        run.touched |= robot.touched;
        if run.touched {
            break;
        }
    }
    run.mean /= counted;
    run.stood = stood / counted;
    run
}

/// The simulated robot as its description has it: with motors that are alike.
pub(crate) fn robot(cruise: f64) -> RowRobot {
    let direction = Direction {
        dead_band: DEAD_BAND,
        full_rate: FULL_SPEED,
    };
    let motor = Actuator {
        positive: direction,
        negative: direction,
    };
    RowRobot {
        mounting: Mounting {
            ahead: 0.2545,
            beside: 0.152,
            angle: std::f64::consts::FRAC_PI_4,
        },
        least: 0.22,
        open: 1.45,
        track: 0.45,
        lag: 0.1,
        motors: Sides {
            left: motor,
            right: motor,
        },
        cruise,
        width: 0.762,
        tolerance: 0.04,
        stalk: 0.025,
        gap: 1.0,
    }
}

/// Settings for this field. It is leafier than the one that the settings are fitted
/// to, with leaves behind the rows too, but no next row, and its ground turns the
/// robot less.
pub(crate) fn settings_of(robot: &RowRobot) -> RowSettings<f32> {
    let mut settings = RowSettings::for_robot(robot).unwrap();
    settings.estimator.readings.clear = Odds {
        stalk: 0.65,
        near: 0.6,
        far: 0.5,
    };
    settings.estimator.readings.leafy = Odds {
        stalk: 0.1,
        near: 3.0,
        far: 0.3,
    };
    settings.estimator.rows.spacing = 0.0;
    settings.estimator.motion.heading_walk = 0.05;
    settings.estimator.motion.turn_error = 0.2;
    settings.estimator.readings.agreement = 0.035;
    settings.estimator.readings.run = (robot.stalk as f32 + 0.016) * 1.414;
    settings.estimator.readings.surface = 0.2;
    settings.estimator.readings.leaf_way = 0.25;
    settings.estimator.motion.curvature = 0.07;
    settings.estimator.motion.curvature_way = 10.0;
    settings.law.settling = 0.3;
    settings
}

/// Lets Furrow drive through a field until it has stood at its end for a while.
pub(crate) fn furrow(field: &Field, ground: Ground, speed: f64, seed: u64) -> Run {
    furrow_of(&robot(speed), field, ground, seed)
}

/// The same for any robot.
pub(crate) fn furrow_of(robot: &RowRobot, field: &Field, ground: Ground, seed: u64) -> Run {
    let settings = settings_of(robot);
    let mut controller = RowController::<f32>::new(settings).unwrap();
    let seconds = (field.crop.length + 4.0) / robot.cruise * 1.3;
    run(field, ground, seed, seconds, |left, right, _| {
        let distances = RowDistances {
            left: left as f32,
            right: right as f32,
        };
        let efforts = controller.step(&distances, true, STEP as f32).efforts;
        (f64::from(efforts.left), f64::from(efforts.right))
    })
}
