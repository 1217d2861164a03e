//! The operator's display (thesis 5.2.5, 6.2.4.5).
//!
//! The thesis does not name its display's command set. So the trait [`Language`] stands for any, and
//! [`Lk204`] is that of a display that can be bought: Matrix Orbital's LK204-7T-1U, 20 characters in
//! 4 rows, with three lamps that are green or red as the thesis's values are.

use control::controller::Tracking;
use control::mode::Mode;
use control::position::Position;

use crate::convert;
use crate::peers::Named;
use crate::pilot::Reason;
use crate::text::Text;

/// Longest string of commands, bytes: the capacity of the port.
pub const CAPACITY: usize = 160;

/// Rows of the screen.
pub const ROWS: u8 = 4;
/// Characters in a row.
pub const COLUMNS: usize = 20;

/// A lamp beside the screen: green for "no error", red for "not ready" (thesis 6.2.4.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lamp {
    /// The vehicle is not stopped by its operator or by a fault.
    Mode,
    /// The node keeps the schedule of the bus, and so do all others.
    Bus,
    /// The receiver's solution is fixed.
    Fix,
}

/// A display's command set.
pub trait Language {
    /// The byte with which the display answers [`Language::finish`].
    const ANSWER: u8;
    /// Brings the display into the state that the other commands need, even if it lost its supply
    /// since the last time.
    fn prepare<const N: usize>(text: &mut Text<N>);
    /// The text that follows goes to a row, counted from 0 at the top.
    fn begin<const N: usize>(text: &mut Text<N>, row: u8);
    /// Makes a lamp green or red.
    fn lamp<const N: usize>(text: &mut Text<N>, lamp: Lamp, good: bool);
    /// Asks for an answer, which shows that the display is there.
    fn finish<const N: usize>(text: &mut Text<N>);
}

/// Matrix Orbital LK204-7T-1U on its serial port: 19 200 baud, 8N1.
///
/// Only two pages of its technical manual were at hand. They confirm the answer 0x2B to "read module
/// type" (6.9) and the two settings of the keypad's transmission (6.6). The colours of the lamps agree
/// with two published programs for this display. The other commands, what is on after power-up, and
/// the baud rate are those that the maker's manuals of its sister models agree on (LK204-25,
/// LK202-25, LK162A-4T). No display has been driven yet.
///
/// Its keypad is not used: the operator's buttons are on the remote control (thesis 5.2.5).
#[derive(Clone, Copy, Debug)]
pub struct Lk204;

/// Begins every command.
const PREFIX: u8 = 254;

impl Language for Lk204 {
    /// The module type of an LK204-7T-1U.
    const ANSWER: u8 = 0x2B;

    /// Auto scroll off, auto line wrap off, auto transmit of key presses off: they are on when the
    /// display gets its supply. A full row leaves the cursor where it does not matter, as the next
    /// command sets it: the manuals differ in whether text goes on without line wrap.
    fn prepare<const N: usize>(text: &mut Text<N>) {
        // loop-bound: 3 settings
        for setting in [82, 68, 79] {
            text.byte(PREFIX).byte(setting);
        }
    }

    /// Set cursor position: column and row count from 1.
    fn begin<const N: usize>(text: &mut Text<N>, row: u8) {
        text.byte(PREFIX).byte(71).byte(1).byte(row + 1);
    }

    /// Two general purpose outputs colour a lamp: red while the first is on and the second off
    /// (87 switches one on, 86 off), green the other way round.
    fn lamp<const N: usize>(text: &mut Text<N>, lamp: Lamp, good: bool) {
        let first = 2 * lamp as u8 + 1;
        let (red, green) = if good { (86, 87) } else { (87, 86) };
        text.byte(PREFIX).byte(red).byte(first);
        text.byte(PREFIX).byte(green).byte(first + 1);
    }

    /// Read module type.
    fn finish<const N: usize>(text: &mut Text<N>) {
        text.byte(PREFIX).byte(55);
    }
}

/// What the display shows.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// First waypoint.
    pub from: Position,
    /// Second waypoint.
    pub to: Position,
    /// Last position, mm.
    pub north: i32,
    /// Last position, mm.
    pub east: i32,
    /// Where the vehicle is relative to the line.
    pub tracking: Tracking<f32>,
    /// System time, ms.
    pub time: u32,
    /// Mode.
    pub mode: Mode,
    /// Whether the node keeps the schedule of the bus.
    pub bus: bool,
    /// Whether the solution is fixed.
    pub fixed: bool,
    /// Another node that does not do its part on the bus.
    pub trouble: Option<Named>,
    /// Why the mode was entered.
    pub reason: Reason,
}

impl View {
    /// Whether the vehicle, or the joystick, ended a run: the operator did not ask for the mode.
    const fn ended_by_vehicle(&self) -> bool {
        matches!(self.mode, Mode::Fault) || matches!(self.reason, Reason::Joystick)
    }

    /// Whether a lamp is green.
    const fn is_good(&self, lamp: Lamp) -> bool {
        match lamp {
            Lamp::Mode => !matches!(self.mode, Mode::EmergencyStop | Mode::Fault),
            Lamp::Bus => self.bus && self.trouble.is_none(),
            Lamp::Fix => self.fixed,
        }
    }
}

/// What a node tells on the last row besides what all do.
pub trait More {
    /// Writes it at system time `time`, ms. False, and nothing written, while others have their turn.
    fn row(&self, text: &mut Text<COLUMNS>, time: u32) -> bool;
}

impl More for () {
    #[inline(always)]
    fn row(&self, _: &mut Text<COLUMNS>, _: u32) -> bool {
        false
    }
}

/// Writes a full screen.
pub fn write<L: Language>(text: &mut Text<CAPACITY>, view: &View, more: &impl More) {
    L::prepare(text);
    // The row that names a node in trouble comes first: a screen takes 63 ms.
    let first = if view.trouble.is_some() { ROWS - 1 } else { 0 };
    // loop-bound: 4 rows
    for turn in 0..ROWS {
        let row = (turn + first) % ROWS;
        L::begin(text, row);
        let content = content(row, view, more);
        // A row is overwritten to its end; what does not fit is cut.
        // loop-bound: 20 characters
        for column in 0..COLUMNS {
            text.byte(content.as_bytes().get(column).copied().unwrap_or(b' '));
        }
    }
    // loop-bound: 3 lamps
    for lamp in [Lamp::Mode, Lamp::Bus, Lamp::Fix] {
        L::lamp(text, lamp, view.is_good(lamp));
    }
    L::finish(text);
}

/// How long the last row shows the same, ms.
pub const PAGE: u32 = 2000;

/// The text of a row. The last one changes its contents, unless there is trouble to tell, or why a run ended.
fn content(row: u8, view: &View, more: &impl More) -> Text<COLUMNS> {
    let mut text = Text::new();
    let tracking = &view.tracking;
    let tenths = |angle: f32| convert::millidegrees(angle) / 100;
    match row {
        0 => {
            text.str(view.mode.name()).str(" XTE ");
            text.fixed(convert::millimetres(tracking.cross_track), 3);
            text.str(" m");
        }
        1 => point(&mut text, "N", view.north, view.east),
        2 => {
            let heading = convert::millidegrees(tracking.heading).rem_euclid(360_000);
            text.str("H").unsigned((heading / 1000).unsigned_abs());
            text.str(" e").fixed(tenths(tracking.heading_error), 1);
            text.str(" s").fixed(tenths(tracking.steering_angle), 1);
        }
        _ => match &view.trouble {
            Some(trouble) => trouble.write(&mut text),
            None if view.ended_by_vehicle() => {
                text.str("ended: ").str(view.reason.text());
            }
            None if more.row(&mut text, view.time) => {}
            None => page(&mut text, view),
        },
    }
    text
}

/// What the last row shows in turn.
fn page(text: &mut Text<COLUMNS>, view: &View) {
    match view.time / PAGE % 5 {
        0 => {
            let speed = convert::centimetres_per_second(view.tracking.speed);
            text.str("V ").fixed(i32::from(speed), 2).str(" m/s t ");
            text.fixed((view.time / 1000).cast_signed(), 0);
        }
        1 => {
            let state = if view.bus { "in" } else { "no" };
            text.str("CAN ").str(state).str(" schedule");
        }
        2 => {
            text.str("GPS ")
                .str(if view.fixed { "fixed" } else { "no fix" });
        }
        3 => point(text, "a", view.from.north, view.from.east),
        _ => point(text, "b", view.to.north, view.to.east),
    }
}

/// A point, centimetres north and east.
fn point(text: &mut Text<COLUMNS>, label: &str, north: i32, east: i32) {
    text.str(label).fixed(north / 10, 2);
    text.str(" E").fixed(east / 10, 2);
}

/// Watches the display's answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Supervision {
    sent: u8,
    awaited: u8,
    missing: u32,
    strange: u32,
    silent_refreshes: u8,
}

/// Refreshes without a single answer after which the display counts as absent: 1 s.
const SILENT_LIMIT: u8 = 5;

impl Supervision {
    /// Notes that a string that asks for `answers` answers is about to be sent. Answers to the
    /// last string that have not come count as missing.
    pub fn sent(&mut self, answers: u8) {
        self.missing = self.missing.wrapping_add(u32::from(self.awaited));
        self.silent_refreshes = if self.awaited > 0 && self.awaited == self.sent {
            self.silent_refreshes.saturating_add(1)
        } else {
            0
        };
        self.sent = answers;
        self.awaited = answers;
    }

    /// A byte arrived from the display.
    pub fn received<L: Language>(&mut self, byte: u8) {
        if byte == L::ANSWER && self.awaited > 0 {
            self.awaited -= 1;
        } else {
            self.strange = self.strange.wrapping_add(1);
        }
    }

    /// Whether the display answers.
    pub const fn is_present(&self) -> bool {
        self.silent_refreshes < SILENT_LIMIT
    }

    /// Answers that never came, and bytes that were no answer; both wrap.
    pub const fn counts(&self) -> (u32, u32) {
        (self.missing, self.strange)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::peers::Trouble;
    use proptest::prelude::*;
    use std::string::String;
    use std::vec::Vec;

    fn view() -> View {
        View {
            from: Position::new(0, 0),
            to: Position::new(243_000, 0),
            north: 12_345,
            east: -678,
            tracking: Tracking {
                segment: 0,
                along: 12.0,
                cross_track: -0.027,
                heading: -0.1,
                heading_error: 0.05,
                steering_angle: -0.2,
                speed: 1.004,
            },
            time: 123_456,
            mode: Mode::AutonomousRun,
            bus: true,
            fixed: false,
            trouble: None,
            reason: Reason::ButtonC,
        }
    }

    /// The string of commands.
    fn commands(view: &View) -> Vec<u8> {
        let mut text = Text::new();
        write::<Lk204>(&mut text, view, &());
        assert!(!text.is_cut());
        text.as_bytes().to_vec()
    }

    /// The four rows.
    fn shown(view: &View) -> Vec<String> {
        let row = |row| content(row, view, &()).as_bytes().to_vec();
        (0..ROWS)
            .map(|at| String::from_utf8(row(at)).unwrap())
            .collect()
    }

    #[test]
    fn every_field_of_the_thesis_is_shown() {
        assert_eq!(
            shown(&view()),
            [
                "run XTE -0.027 m",
                "N12.34 E-0.67",
                "H354 e2.8 s-11.4",
                "CAN in schedule"
            ]
        );
        let last = |time| shown(&View { time, ..view() }).pop().unwrap();
        assert_eq!(
            [0, 4000, 6000, 8000].map(last),
            [
                "V 1.00 m/s t 0",
                "GPS no fix",
                "a0.00 E0.00",
                "b243.00 E0.00"
            ]
        );
    }

    #[test]
    fn the_commands_are_those_of_the_manual() {
        let sent = commands(&view());
        assert_eq!(sent[..6], [254, 82, 254, 68, 254, 79]);
        assert_eq!(sent[6..10], [254, 71, 1, 1]);
        assert_eq!(&sent[10..30], b"run XTE -0.027 m    ");
        assert_eq!(sent[30..34], [254, 71, 1, 2]);
        // Mode green, bus green, fix red.
        assert_eq!(
            sent[102..],
            [
                254, 86, 1, 254, 87, 2, 254, 86, 3, 254, 87, 4, 254, 87, 5, 254, 86, 6, 254, 55
            ]
        );
    }

    #[test]
    fn a_node_in_trouble_is_named_at_once_and_makes_the_bus_red() {
        let names = ["gps", "controller", "steering", "drive"];
        for (node, health, others, row) in [
            (2, ttcan::Health::Masquerade, 0, "steering masquerade"),
            (2, ttcan::Health::Masquerade, 2, "steering masquerade "),
            (3, ttcan::Health::Dead, 1, "drive dead +1"),
        ] {
            let trouble = Trouble {
                node,
                health,
                others,
            };
            let view = View {
                trouble: Some(trouble.named(&names)),
                ..view()
            };
            assert_eq!(shown(&view)[3], row);
            let sent = commands(&view);
            assert_eq!(sent[6..10], [254, 71, 1, 4]);
            assert_eq!(sent[108..114], [254, 87, 3, 254, 86, 4]);
        }
    }

    #[test]
    fn why_the_vehicle_ended_a_run_stays_in_the_last_row() {
        let ended = |mode, reason| {
            let view = View {
                mode,
                reason,
                ..view()
            };
            shown(&view).pop().unwrap()
        };
        assert_eq!(
            ended(Mode::Fault, Reason::NodeFault),
            "ended: potentiometer"
        );
        assert_eq!(ended(Mode::Fault, Reason::OffPath), "ended: off the path");
        assert_eq!(
            ended(Mode::AutonomousReady, Reason::Joystick),
            "ended: joystick"
        );
        assert_eq!(
            ended(Mode::AutonomousReady, Reason::FixLost),
            "CAN in schedule"
        );
    }

    proptest! {
        #[test]
        fn whatever_is_shown_has_one_length(
            north: i32, east: i32, x: f32, heading: f32, error: f32, speed: f32, steering: f32, time: u32,
        ) {
            let view = View {
                from: Position::new(i32::MIN, i32::MIN),
                to: Position::new(i32::MIN, i32::MAX),
                north, east, time,
                tracking: Tracking {
                    segment: 0, along: 0.0, cross_track: x, heading, heading_error: error, steering_angle: steering, speed,
                },
                ..view()
            };
            prop_assert_eq!(commands(&view).len(), 122);
        }
    }

    #[test]
    fn a_display_that_never_answers_is_absent_after_a_second_and_back_at_once() {
        let mut watch = Supervision::default();
        watch.sent(1);
        for _ in 0..4 {
            watch.sent(1);
            assert!(watch.is_present());
        }
        watch.sent(1);
        assert!(!watch.is_present());
        assert_eq!(watch.counts(), (5, 0));
        watch.received::<Lk204>(0x2B);
        watch.received::<Lk204>(0xAA);
        watch.sent(1);
        assert!(watch.is_present());
        assert_eq!(watch.counts(), (5, 1));
    }
}
