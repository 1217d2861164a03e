//! The estimator in the form of the textbook: whole matrices, every angle computed where it is
//! needed, Joseph's form of the update. The library's estimator must agree with it.

use control::estimator::{EstimatorSettings, Observation};
use control::position::{Position, Velocity};
use control::scalar::wrap_angle;
use nalgebra::{SMatrix, SVector};

type Vector = SVector<f64, 6>;
type Matrix = SMatrix<f64, 6, 6>;

/// The filter. The states are north, east, heading, steering angle, heading bias and steering
/// bias.
pub(crate) struct Matrices {
    settings: EstimatorSettings<f64>,
    pub(crate) state: Vector,
    pub(crate) covariance: Matrix,
    pub(crate) speed: f64,
    pub(crate) effectiveness: f64,
    effectiveness_variance: f64,
    drive: f64,
    drive_variance: f64,
    /// The commanded speed behind the drive's lag.
    driven: f64,
    /// The same behind a longer one.
    lasting: f64,
    stray_speed: f64,
    /// The speed that the last velocity told, plausible or not.
    last_size: f64,
    /// The speed that an update showed, and the commanded one.
    measured: Option<[f64; 2]>,
    /// By how much each prediction changed steering angle and speed, the newest first.
    past: Vec<[f64; 2]>,
    pub(crate) ready: bool,
    outliers: u8,
}

/// How the antenna's measurements follow from the state now: the pose at their time.
struct Then {
    way: f64,
    turn: f64,
    heading: f64,
    steering: f64,
    gain: f64,
}

impl Matrices {
    pub(crate) fn new(settings: EstimatorSettings<f64>) -> Self {
        let noise = &settings.noise;
        let variances = [
            0.0,
            0.0,
            0.0,
            0.25,
            noise.first_heading_bias.powi(2),
            noise.first_steering_bias.powi(2),
        ];
        Self {
            settings,
            state: Vector::zeros(),
            covariance: Matrix::from_diagonal(&Vector::from(variances)),
            speed: 0.0,
            effectiveness: 1.0,
            effectiveness_variance: 0.09,
            drive: 1.0,
            drive_variance: 0.04,
            driven: 0.0,
            lasting: 0.0,
            stray_speed: 0.0,
            measured: None,
            last_size: 0.0,
            past: Vec::new(),
            ready: false,
            outliers: 0,
        }
    }

    pub(crate) fn step(&mut self, seen: &Observation<f64>) {
        self.predict(seen);
        if let Some(angle) = seen.steering_angle {
            self.see_steering(angle, seen.steering_rate * seen.dt);
        }
        self.see_gps(seen);
        self.state[2] = wrap_angle(self.state[2]);
        self.state[4] = self.state[4].clamp(-0.35, 0.35);
        self.state[5] = self.state[5].clamp(-0.35, 0.35);
    }

    fn is_moving(&self) -> bool {
        self.speed.abs() > self.settings.standstill
    }

    /// Turn over `way` while the steering turns by `turned` about `angle`, and its derivative.
    fn turn(&self, way: f64, angle: f64, turned: f64) -> (f64, f64) {
        let length = self.settings.geometry.wheelbase();
        let curvature_change = turned / angle.cos().powi(2) / length;
        let slip = self.settings.rear_slip * self.speed * self.speed.abs() * curvature_change;
        (
            way * angle.tan() / length - slip,
            way / angle.cos().powi(2) / length,
        )
    }

    /// What noise and a steering bias of five times the expected size do not explain of the drive's gain.
    pub(crate) fn drive(&self) -> f64 {
        let right = self.settings.antenna.right / self.settings.geometry.wheelbase();
        let explained = 5.0 * right.abs() * self.settings.noise.first_steering_bias + 0.02;
        let found = self.drive - 1.0;
        let size = (2.0 * (found.abs() - explained)).clamp(0.0, found.abs());
        1.0 + size.copysign(found)
    }

    fn learn_drive(&mut self, measured: f64, commanded: f64) {
        if self.driven.abs() > self.settings.standstill {
            let changing = (2.0 * (commanded - self.lasting)).powi(2);
            let noise = self.settings.noise.velocity.powi(2) + 0.05_f64.powi(2) + changing;
            let spread = self.driven.powi(2) * self.drive_variance + noise;
            let gain = self.driven * self.drive_variance / spread;
            self.drive += gain * (measured - self.drive * self.driven);
            self.drive = self.drive.clamp(0.3, 1.5);
            self.drive_variance *= 1.0 - gain * self.driven;
            self.drive_variance += 2e-5;
        }
    }

    fn predict(&mut self, seen: &Observation<f64>) {
        let (dt, noise) = (seen.dt, self.settings.noise);
        if let Some([measured, commanded]) = self.measured.take() {
            self.learn_drive(measured, commanded);
        }
        let before = self.speed;
        let share = dt / (dt + self.settings.drive_lag);
        self.speed += (seen.speed * self.drive() - self.speed) * share;
        self.driven += (seen.speed - self.driven) * share;
        let steady = 3.0 * self.settings.drive_lag + 0.5;
        self.lasting += (seen.speed - self.lasting) * dt / (dt + steady);
        let way = (before + self.speed) / 2.0 * dt;
        let turned = seen.steering_rate * self.effectiveness * dt;
        self.past.insert(0, [turned, self.speed - before]);
        let (turn, gain) = self.turn(way, self.state[3] + turned / 2.0, turned);
        let middle = self.state[2] + turn / 2.0;
        self.state += Vector::from([
            way * middle.cos(),
            way * middle.sin(),
            turn,
            turned,
            0.0,
            0.0,
        ]);
        let mut f = Matrix::identity();
        f[(0, 2)] = -way * middle.sin();
        f[(0, 3)] = f[(0, 2)] * gain / 2.0;
        f[(1, 2)] = way * middle.cos();
        f[(1, 3)] = f[(1, 2)] * gain / 2.0;
        f[(2, 3)] = gain;
        let moving = f64::from(u8::from(self.is_moving()));
        let q = Vector::from([
            noise.slip.powi(2) * moving,
            noise.slip.powi(2) * moving,
            noise.heading.powi(2) * moving,
            noise.actuator.powi(2) + (noise.actuator_share * turned).powi(2) / dt,
            noise.heading_bias.powi(2) * moving,
            noise.steering_bias.powi(2) * moving,
        ]);
        self.covariance = f * self.covariance * f.transpose() + Matrix::from_diagonal(&(q * dt));
        let astray = self.stray_speed * (dt * moving + self.settings.gps_delay);
        let along = Vector::from([middle.cos(), middle.sin(), 0.0, 0.0, 0.0, 0.0]) * astray;
        self.covariance += along * along.transpose();
    }

    fn see_steering(&mut self, angle: f64, asked: f64) {
        let noise = self.settings.noise.steering;
        let innovation = angle - self.state[3] - self.state[5];
        if asked.abs() > 5.0 * noise {
            let spread = asked.powi(2) * self.effectiveness_variance + 8.0 * noise.powi(2);
            let gain = asked * self.effectiveness_variance / spread;
            self.effectiveness = (self.effectiveness + gain * innovation).clamp(0.3, 1.5);
            self.effectiveness_variance *= 1.0 - gain * asked;
            self.effectiveness_variance += 4e-4;
        }
        let row = Vector::from([0.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
        self.correct(&row, innovation, noise.powi(2));
    }

    fn see_gps(&mut self, seen: &Observation<f64>) {
        let course = seen.velocity.and_then(|it| self.see_speed(it, seen));
        if !self.ready {
            if let (Some(position), Some(course)) = (seen.position, course) {
                self.start(position, course, seen);
            }
            return;
        }
        if let Some(position) = seen.position {
            if self.see_position(position, seen) {
                self.outliers = 0;
            } else {
                self.outliers += 1;
                if self.outliers >= 5 {
                    self.ready = false;
                    self.outliers = 0;
                    if let Some(course) = course {
                        self.start(position, course, seen);
                    }
                    return;
                }
            }
        }
        if let Some(course) = course {
            self.see_course(course, seen);
        }
    }

    /// Angle by which the antenna's course leads the rear axle's.
    fn lead(&self, steering: f64) -> f64 {
        let tangent = steering.tan();
        let forward = self.settings.geometry.wheelbase() - self.settings.antenna.right * tangent;
        (self.settings.geometry.l1 * tangent).atan2(forward)
    }

    /// Course and its variance, if the vehicle is fast enough.
    fn see_speed(&mut self, velocity: Velocity, seen: &Observation<f64>) -> Option<(f64, f64)> {
        let (north, east) = velocity.metres_per_second::<f64>();
        let size = north.hypot(east);
        let surely = 2.0 * self.settings.standstill;
        let told =
            self.driven.abs().min(self.lasting.abs()) > surely && self.driven * self.lasting > 0.0;
        let direction = if told { self.driven } else { self.speed };
        let sign = if direction < 0.0 { -1.0 } else { 1.0 };
        let length = self.settings.geometry.wheelbase();
        let [[turned, _], [gained, _]] = self.since(seen.dt);
        let then = self.state[3] - turned;
        let inside = self.settings.antenna.right * then.tan() / length;
        let real = size * self.lead(then).cos() / (1.0 - inside);
        let before = std::mem::replace(&mut self.last_size, real);
        let leap = |from: f64| (real - from.abs()).abs() > 3.0;
        if leap(self.speed) && leap(before) || real > 50.0 {
            return None;
        }
        let measured = sign * real;
        self.measured = Some([measured + gained, seen.speed]);
        let error = measured - (self.speed - gained);
        let explained = 2.0 * self.settings.noise.velocity + 0.05;
        self.stray_speed = error - error.clamp(-explained, explained);
        self.speed += error * 0.4 + self.stray_speed * 0.5;
        (size > self.settings.standstill && self.is_moving()).then(|| {
            let course = (sign * east).atan2(sign * north);
            (course, (self.settings.noise.velocity / size).powi(2))
        })
    }

    /// By how much steering angle and speed have changed since the data were measured, and the
    /// integral of what was still to come over that time.
    fn since(&self, dt: f64) -> [[f64; 2]; 2] {
        let delay = self.settings.gps_delay;
        [0, 1].map(|which| {
            let changes = self.past.iter().map(|step| step[which]);
            // Before the first step nothing moved.
            let changes = changes.chain(std::iter::repeat_n(0.0, 3));
            let (mut sum, mut moment) = (0.0, 0.0);
            for (number, change) in changes.enumerate() {
                let share = (delay / dt - number as f64).clamp(0.0, 1.0);
                moment += (sum + share * change / 2.0) * share * dt;
                sum += share * change;
            }
            [sum, moment]
        })
    }

    fn then(&self, seen: &Observation<f64>) -> Then {
        let delay = self.settings.gps_delay;
        let [[turned, moment], [_, short]] = self.since(seen.dt);
        let way = self.speed * delay - short;
        let middle = if delay > 0.0 { moment / delay } else { 0.0 };
        let (turn, gain) = self.turn(way, self.state[3] - middle, turned);
        Then {
            way,
            turn,
            heading: self.state[2] - turn,
            steering: self.state[3] - turned,
            gain,
        }
    }

    fn start(
        &mut self,
        position: Position,
        (course, variance): (f64, f64),
        seen: &Observation<f64>,
    ) {
        let then = self.then(seen);
        let heading = course - self.lead(then.steering) - self.state[4];
        let place = axle(&self.settings, position, heading);
        let middle = heading + then.turn / 2.0;
        self.state[0] = place.0 + then.way * middle.cos();
        self.state[1] = place.1 + then.way * middle.sin();
        self.state[2] = wrap_angle(heading + then.turn);
        let (l1, right) = (self.settings.geometry.l1, self.settings.antenna.right);
        let (sine, cosine) = heading.sin_cos();
        let lever = [-l1 * sine - right * cosine, l1 * cosine - right * sine];
        let back = [then.way * middle.sin(), -then.way * middle.cos()];
        // The errors of the new states as those of the old ones.
        let mut errors = Matrix::identity();
        let lead = l1 / self.settings.geometry.wheelbase() - then.gain;
        let heading_row = Vector::from([0.0, 0.0, 0.0, -lead, -1.0, 0.0]);
        errors.set_row(2, &heading_row.transpose());
        let mut of_course = Vector::zeros();
        of_course[2] = 1.0;
        for axis in [0, 1] {
            let of_heading = lever[axis] + back[axis];
            let mut row = heading_row * -of_heading;
            row[3] += (lever[axis] + back[axis] / 2.0) * then.gain;
            errors.set_row(axis, &row.transpose());
            of_course[axis] = -of_heading;
        }
        self.covariance = errors * self.covariance * errors.transpose()
            + of_course * variance * of_course.transpose();
        let curved = (l1.powi(2) + right.powi(2)) * self.covariance[(2, 2)].powi(2) / 2.0;
        let place = self.settings.noise.position.powi(2) + curved;
        self.covariance[(0, 0)] += place;
        self.covariance[(1, 1)] += place;
        self.ready = true;
    }

    fn see_position(&mut self, position: Position, seen: &Observation<f64>) -> bool {
        let then = self.then(seen);
        let middle = then.heading + then.turn / 2.0;
        let axle = axle(&self.settings, position, then.heading);
        let innovations = SVector::<f64, 2>::new(
            axle.0 + then.way * middle.cos() - self.state[0],
            axle.1 + then.way * middle.sin() - self.state[1],
        );
        // Derivatives of the measured position with respect to the angle of the lever and to that
        // of the way back.
        let (l1, right) = (self.settings.geometry.l1, self.settings.antenna.right);
        let (sine, cosine) = then.heading.sin_cos();
        let lever = (-l1 * sine - right * cosine, l1 * cosine - right * sine);
        let back = (then.way * middle.sin(), -then.way * middle.cos());
        let rows = [
            Vector::from([
                1.0,
                0.0,
                lever.0 + back.0,
                -(lever.0 + back.0 / 2.0) * then.gain,
                0.0,
                0.0,
            ]),
            Vector::from([
                0.0,
                1.0,
                lever.1 + back.1,
                -(lever.1 + back.1 / 2.0) * then.gain,
                0.0,
                0.0,
            ]),
        ];
        let variance = self.settings.noise.position.powi(2);
        for (row, innovation) in rows.iter().zip(&innovations) {
            let spread = row.dot(&(self.covariance * row)) + variance;
            if innovation.powi(2) > 25.0 * spread {
                return false;
            }
        }
        let before = self.state;
        self.correct(&rows[0], innovations[0], variance);
        let moved = rows[1].dot(&(self.state - before));
        self.correct(&rows[1], innovations[1] - moved, variance);
        true
    }

    fn see_course(&mut self, (course, variance): (f64, f64), seen: &Observation<f64>) {
        let then = self.then(seen);
        let expected = then.heading + self.lead(then.steering) + self.state[4];
        let lead = self.settings.geometry.l1 / self.settings.geometry.wheelbase();
        let row = Vector::from([0.0, 0.0, 1.0, lead - then.gain, 1.0, 0.0]);
        let innovation = wrap_angle(course - expected);
        let spread = row.dot(&(self.covariance * row)) + variance;
        if innovation.powi(2) <= 25.0 * spread {
            self.correct(&row, innovation, variance);
        }
    }

    fn correct(&mut self, row: &Vector, innovation: f64, variance: f64) {
        let spread = row.dot(&(self.covariance * row)) + variance;
        let mut gain = self.covariance * row / spread;
        if !self.is_moving() {
            gain[4] = 0.0;
            gain[5] = 0.0;
        }
        self.state += gain * innovation;
        let rest = Matrix::identity() - gain * row.transpose();
        self.covariance =
            rest * self.covariance * rest.transpose() + gain * variance * gain.transpose();
    }
}

/// The rear axle's place, m, while the antenna is at `position` (of a frame with the origin zero)
/// and the vehicle heads for `heading`.
fn axle(settings: &EstimatorSettings<f64>, position: Position, heading: f64) -> (f64, f64) {
    let (north, east) = position.metres_from::<f64>(Position::new(0, 0));
    let (l1, right) = (settings.geometry.l1, settings.antenna.right);
    let (sine, cosine) = heading.sin_cos();
    (
        north - (l1 * cosine - right * sine),
        east - (l1 * sine + right * cosine),
    )
}
