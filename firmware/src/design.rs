//! The constants that the nodes of all vehicles share, with unit, source and arithmetic.
//!
//! The numbers of one machine are in its vehicle's manifest, those of a board in `parts`.

use fugit::MillisDurationU32;
use ttcan::Micros;

/// Braking horizon at the end stops, s: the steering node never asks for a rate that would
/// reach an end stop sooner than this.
pub const END_STOP_HORIZON: f32 = 0.05;

/// Age above which a sample of the potentiometer is stale: ten of its periods of 5 ms.
pub const SAMPLE_TIMEOUT: Micros = Micros::millis(50);

/// Longest time that one step of the drive's slew-rate limiter covers: two of its periods.
pub const LONGEST_SLEW_STEP: Micros = Micros::millis(20);

/// How long a node that had to leave the bus stays away before it joins again: two basic
/// cycles, so that the other nodes notice its absence.
pub const REJOIN_PAUSE: Micros = Micros::millis(200);

/// Least time from the end of a command to the next command that an actuator node obeys. It bounds how
/// often the tasks of the bus pend the actuator's task because of a bus that comes and goes: the
/// task table counts on it.
pub const END_PAUSE: Micros = Micros::millis(2);

/// Longest silence of a satellite receiver that measures every `period`: two and a half of its
/// periods. After that its fix is no longer valid.
pub const fn receiver_timeout(period: Micros) -> Micros {
    Micros::micros(period.ticks() * 5 / 2)
}

/// How long the receiver's node waits for the first burst before it begins the schedule without
/// it. The receiver measures every `period`; the node waits five of them.
pub const fn receiver_patience(period: Micros) -> MillisDurationU32 {
    MillisDurationU32::millis(period.ticks() * 5 / 1000)
}

/// Positions that may be missing while the reference says that the solution is fixed. One frame
/// lost on the bus does not end a run; the second one does, as two missed periods stop the motors
/// (thesis 6.2.4.4).
pub const POSITION_PATIENCE: u8 = 2;

/// Longest time without a fixed solution that a run goes on by dead reckoning, s, while velocities
/// still come. Corrections from the base station are often late by less.
pub const BRIDGED: f32 = 1.0;

/// Time from the start of a reference until its node has taken it: the longest frame, 540 us at
/// the boards' 250 kbit/s, its interrupt, and clocks that differ over two basic cycles.
pub const REFERENCE_ARRIVAL: Micros = Micros::micros(700);

/// How long the backup master waits for a frame of the gps node before it begins the schedule
/// itself. The gps node may still be waiting for its receiver.
pub const MASTER_PATIENCE: MillisDurationU32 = MillisDurationU32::millis(1000);

/// Speed below which the velocity vector does not show the heading, mm/s: ten times the
/// receiver's noise of 20 mm/s.
pub const HEADING_SPEED: u32 = 200;

/// Joystick: dead zone on each side of the centre, counts; 4 % of its travel.
pub const JOYSTICK_DEAD_ZONE: u16 = 80;
/// Joystick: count at rest, the middle of the 12-bit range.
pub const JOYSTICK_CENTRE: u16 = 2048;

/// Nominal timeout of the watchdog of a node that drives no motor: five basic cycles. Its
/// oscillator may be off by a factor of two.
pub const WATCHDOG_F446: MillisDurationU32 = MillisDurationU32::millis(500);
/// The same for an actuator node: five steps of the housekeeping, which feeds it. Its
/// oscillator runs at 30 to 50 kHz (data sheet). So a core that hangs is reset, and its motor
/// switched off, 40 to 67 ms after the watchdog was last fed.
pub const WATCHDOG_F303: MillisDurationU32 = MillisDurationU32::millis(50);

/// Period of the console lines (thesis 6.2.4.6).
pub const CONSOLE_PERIOD: MillisDurationU32 = MillisDurationU32::millis(100);

/// Period of the housekeeping: bus recovery, watchdog, status.
pub const HOUSEKEEPING_PERIOD: MillisDurationU32 = MillisDurationU32::millis(10);

/// How long an event message may wait for its window: ten basic cycles.
pub const EVENT_LIFETIME: Micros = Micros::secs(1);

/// Rate difference between two crystals that the schedule tolerates, ppm: two crystals of
/// 50 ppm, doubled.
pub const DRIFT_LIMIT_PPM: u16 = 200;
/// The same for a node on its RC oscillator, which is accurate to about 1 %.
pub const DRIFT_LIMIT_PPM_INTERNAL: u16 = 10_000;
