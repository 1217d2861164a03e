//! Every constant of the vehicle and of its nodes, with unit, source and arithmetic.

use control::calibration::{Actuator, Direction, Potentiometer};
use control::position::Position;
use fugit::MillisDurationU32;
use ttcan::Micros;

pub use crate::vehicle::VEHICLE;

/// One degree in radians.
const DEGREE: f32 = core::f32::consts::PI / 180.0;

/// First waypoint of the run (thesis 7.3), mm north and east of the base station.
pub const WAYPOINT_A: Position = Position::new(0, 0);
/// Second waypoint: a 243 m line due north (thesis 7.3).
pub const WAYPOINT_B: Position = Position::new(243_000, 0);

/// Largest steering angle, rad: 25 degrees to each side (thesis 5.3).
pub const STEERING_ANGLE_LIMIT: f32 = 25.0 * DEGREE;
/// Largest steering rate, rad/s: 25 degrees a second (thesis 5.3).
pub const STEERING_RATE_LIMIT: f32 = 25.0 * DEGREE;
/// Largest speed, m/s (thesis 5.3).
pub const SPEED_LIMIT: f32 = 2.0;

// POTENTIOMETER and STEERING_ACTUATOR, from `vehicle.toml`, and SETTINGS, the controller's,
// derived from `VEHICLE`.
include!(concat!(env!("OUT_DIR"), "/vehicle.rs"));

/// How far ahead of the end stops the steering node begins to slow its actuator: it never
/// asks for a rate that would reach the stop sooner than in this time, s.
pub const END_STOP_HORIZON: f32 = 0.05;

/// The drive motor on its motor driver: 2 m/s at full effort, dead band 5 %.
pub const DRIVE_MOTOR: Actuator<f32> = Actuator {
    positive: Direction {
        dead_band: 0.05,
        full_rate: SPEED_LIMIT,
    },
    negative: Direction {
        dead_band: 0.05,
        full_rate: SPEED_LIMIT,
    },
};

/// Largest growth of the drive speed, m/s each second. Slowing down is never delayed.
pub const DRIVE_SLEW: f32 = 2.0;

/// Which way the motor driver's byte 255 turns. The maker's manual contradicts itself, so it
/// is configuration: true means forward.
pub const FULL_BYTE_IS_FORWARD: bool = true;

/// Basic periods that the reference or the command may be missing before an actuator stops
/// (thesis 6.2.4.4).
pub const MISSED_PERIODS: u32 = 2;

/// After the end of a command frame, the time when the second frame after it is overdue: two
/// periods, the difference in length between the shortest and the longest 8-byte frame (24
/// bits, 96 us), and 100 us for the jitter of both starts.
pub const COMMAND_TIMEOUT: Micros =
    Micros::micros(MISSED_PERIODS * network::matrix::BASIC_CYCLE.ticks() + 96 + 100);

/// Age at which a sample of the potentiometer cannot be believed any more: ten of its
/// periods of 5 ms.
pub const SAMPLE_TIMEOUT: Micros = Micros::millis(50);

/// Longest time that one step of the drive's slew makes up for: two of its periods.
pub const LONGEST_SLEW_STEP: Micros = Micros::millis(20);

/// Cycle time at which the control step is released: the last sensor window begins at 6 ms;
/// its frame of two bytes takes at most 75 bits or 300 us and starts within 64 us (the
/// transmit enable window). The command's window begins at 7 ms: 600 us are left.
pub const CONTROL_RELEASE: Micros = Micros::micros(6_400);

/// How long a node that had to leave the bus stays away before it joins again: two basic
/// cycles, so that the others see it gone.
pub const REJOIN_PAUSE: Micros = Micros::millis(200);

/// Longest silence of the satellite receiver: two and a half of its periods. After that its
/// fix does not count any more.
pub const RECEIVER_TIMEOUT: Micros = Micros::millis(250);

/// How long the gps node waits for the receiver's first burst before it begins the schedule
/// without it: five of its periods.
pub const RECEIVER_PATIENCE: MillisDurationU32 = MillisDurationU32::millis(500);

/// How long before a reference the receiver's burst shall end: room for the jitter of the
/// burst's beginning and length, which the windows of the same cycle must not overtake.
pub const BURST_LEAD: Micros = Micros::millis(5);

/// Age of the receiver's data at the control step: 40 ms from its measurement to the first
/// byte (inferred), 3.15 ms of burst (thesis 6.2.4.3), then [`BURST_LEAD`] until the reference
/// and [`CONTROL_RELEASE`] until the step.
pub const RECEIVER_AGE: Micros =
    Micros::micros(40_000 + 3_150 + BURST_LEAD.ticks() + CONTROL_RELEASE.ticks());

/// Steps that may go without a position while the reference says that the solution is fixed: a
/// single frame that was lost on the bus does not end a run, the second one does, as two
/// missed periods stop the motors (thesis 6.2.4.4).
pub const POSITION_PATIENCE: u8 = 2;

/// How long the backup master waits for a sign of the gps node, which waits for its
/// receiver, before it begins the schedule itself.
pub const MASTER_PATIENCE: MillisDurationU32 = MillisDurationU32::millis(1000);

/// Speed below which the velocity vector says nothing about the heading, mm/s: ten times the
/// receiver's noise of 20 mm/s.
pub const HEADING_SPEED: u32 = 200;

/// Joystick: counts from the centre that do nothing, 4 % of its way.
pub const JOYSTICK_DEAD_ZONE: u16 = 80;
/// Joystick: count at rest, the middle of the 12-bit range.
pub const JOYSTICK_CENTRE: u16 = 2048;

/// Nominal time of the watchdog of a node that drives nothing: five basic cycles; its
/// oscillator may be off by a factor of two.
pub const WATCHDOG_F446: MillisDurationU32 = MillisDurationU32::millis(500);
/// The same of an actuator node: five steps of the housekeeping, which feeds it. Its
/// oscillator is between 30 and 50 kHz (data sheet), so a stalled core is reset, and its
/// motor off, 40 to 67 ms after its last meal.
pub const WATCHDOG_F303: MillisDurationU32 = MillisDurationU32::millis(50);

/// Period of the console lines (thesis 6.2.4.6).
pub const CONSOLE_PERIOD: MillisDurationU32 = MillisDurationU32::millis(100);

/// Period of the housekeeping: bus recovery, watchdog, status.
pub const HOUSEKEEPING_PERIOD: MillisDurationU32 = MillisDurationU32::millis(10);

/// How long an event message may wait for its window: ten basic cycles.
pub const EVENT_LIFETIME: Micros = Micros::secs(1);

/// Rate error between two crystals that the schedule follows, ppm: two of 50 ppm, doubled.
pub const DRIFT_LIMIT_PPM: u16 = 200;
/// The same for a node on its RC oscillator, which is good for about 1 %.
pub const DRIFT_LIMIT_PPM_INTERNAL: u16 = 10_000;
