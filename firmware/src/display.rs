//! The operator's display (thesis 5.2.5, 6.2.4.5).
//!
//! The thesis does not name the display's command set, so the trait [`Language`] stands for it.
//! Every value that can be good or bad is green or red, as on the vehicle.

use control::controller::Tracking;
use control::mode::Mode;
use control::position::Position;

use crate::convert;
use crate::text::Text;

/// Longest string of commands, bytes: the capacity of the port.
pub const CAPACITY: usize = 898;

/// The byte with which the display acknowledges a command.
pub const ACKNOWLEDGE: u8 = 0x55;

/// A colour of the fonts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colour {
    /// Values without a good and a bad state.
    White,
    /// "No error" (thesis 6.2.4.5).
    Green,
    /// "Not ready" (thesis 6.2.4.5).
    Red,
}

/// A display's command set.
pub trait Language {
    /// Begins a text in a row, counted from 0 at the top.
    fn begin<const N: usize>(text: &mut Text<N>, row: u8, colour: Colour);
    /// Ends it; the display acknowledges the command.
    fn end<const N: usize>(text: &mut Text<N>);
}

/// A readable command set: the row as two digits, a letter for the colour, the text, a carriage
/// return.
#[derive(Clone, Copy, Debug)]
pub struct Plain;

impl Language for Plain {
    fn begin<const N: usize>(text: &mut Text<N>, row: u8, colour: Colour) {
        text.byte(b'0' + row / 10 % 10).byte(b'0' + row % 10);
        text.byte(match colour {
            Colour::White => b'W',
            Colour::Green => b'G',
            Colour::Red => b'R',
        });
    }

    fn end<const N: usize>(text: &mut Text<N>) {
        text.byte(b'\r');
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
}

/// Rows of a full screen; one command each.
pub const ROWS: u8 = 12;

/// Writes all rows.
pub fn write<L: Language>(text: &mut Text<CAPACITY>, view: &View) {
    for row in 0..ROWS {
        write_row::<L>(text, row, view);
    }
}

/// Writes one row; rows from [`ROWS`] on do not exist.
#[expect(clippy::too_many_lines, reason = "one short arm for each row")]
pub fn write_row<L: Language>(text: &mut Text<CAPACITY>, row: u8, view: &View) {
    let good = |good| if good { Colour::Green } else { Colour::Red };
    let tracking = &view.tracking;
    let mut begin = |colour, label: &str| {
        L::begin(text, row, colour);
        text.str(label);
    };
    let value = match row {
        0 => {
            begin(Colour::White, "Wa   ");
            Value::Point(view.from.north, view.from.east)
        }
        1 => {
            begin(Colour::White, "Wb   ");
            Value::Point(view.to.north, view.to.east)
        }
        2 => {
            begin(good(view.fixed), "NE   ");
            Value::Point(view.north, view.east)
        }
        3 => {
            begin(Colour::White, "XTE  ");
            Value::Number(convert::millimetres(tracking.cross_track), 3, " m")
        }
        4 => {
            begin(Colour::White, "Hdg  ");
            let tenths = convert::millidegrees(tracking.heading).rem_euclid(360_000) / 100;
            Value::Number(tenths, 1, " deg")
        }
        5 => {
            begin(Colour::White, "Err  ");
            let tenths = convert::millidegrees(tracking.heading_error) / 100;
            Value::Number(tenths, 1, " deg")
        }
        6 => {
            begin(Colour::White, "V    ");
            Value::Number(
                i32::from(convert::centimetres_per_second(tracking.speed)),
                2,
                " m/s",
            )
        }
        7 => {
            begin(Colour::White, "Str  ");
            let tenths = convert::millidegrees(tracking.steering_angle) / 100;
            Value::Number(tenths, 1, " deg")
        }
        8 => {
            begin(Colour::White, "Time ");
            Value::Number((view.time / 100).cast_signed(), 1, " s")
        }
        9 => {
            let stopped = matches!(view.mode, Mode::EmergencyStop | Mode::Fault);
            begin(good(!stopped), "Mode ");
            Value::Word(view.mode.name())
        }
        10 => {
            begin(good(view.bus), "CAN  ");
            Value::Word(if view.bus {
                "in schedule"
            } else {
                "no schedule"
            })
        }
        11 => {
            begin(good(view.fixed), "GPS  ");
            Value::Word(if view.fixed { "fixed" } else { "no fix" })
        }
        _ => return,
    };
    match value {
        Value::Point(north, east) => {
            text.fixed(north, 3).byte(b' ').fixed(east, 3);
        }
        Value::Number(number, decimals, unit) => {
            text.fixed(number, decimals).str(unit);
        }
        Value::Word(word) => {
            text.str(word);
        }
    }
    L::end(text);
}

enum Value {
    /// Two lengths, mm.
    Point(i32, i32),
    /// A number, its decimals, its unit.
    Number(i32, u8, &'static str),
    Word(&'static str),
}

/// Watches the display's acknowledges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Supervision {
    sent: u8,
    awaited: u8,
    missing: u32,
    strange: u32,
    silent_refreshes: u8,
}

/// Refreshes without a single acknowledge after which the display counts as absent: 1 s.
const SILENT_LIMIT: u8 = 5;

impl Supervision {
    /// Notes that a string of `commands` commands is about to be sent. Commands of the last
    /// string that are still unacknowledged count as missing.
    pub fn sent(&mut self, commands: u8) {
        self.missing = self.missing.wrapping_add(u32::from(self.awaited));
        self.silent_refreshes = if self.awaited > 0 && self.awaited == self.sent {
            self.silent_refreshes.saturating_add(1)
        } else {
            0
        };
        self.sent = commands;
        self.awaited = commands;
    }

    /// A byte arrived from the display.
    pub fn received(&mut self, byte: u8) {
        if byte == ACKNOWLEDGE && self.awaited > 0 {
            self.awaited -= 1;
        } else {
            self.strange = self.strange.wrapping_add(1);
        }
    }

    /// Whether the display answers.
    pub const fn is_present(&self) -> bool {
        self.silent_refreshes < SILENT_LIMIT
    }

    /// Commands that were never acknowledged, and bytes that were no acknowledgement; both
    /// wrap.
    pub const fn counts(&self) -> (u32, u32) {
        (self.missing, self.strange)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::string::String;

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
        }
    }

    fn shown(view: &View) -> String {
        let mut text = Text::new();
        write::<Plain>(&mut text, view);
        assert!(!text.is_cut());
        String::from_utf8(text.as_bytes().to_vec()).unwrap()
    }

    #[test]
    fn every_field_of_the_thesis_is_shown() {
        assert_eq!(
            shown(&view()).replace('\r', "\n"),
            "00WWa   0.000 0.000\n\
             01WWb   243.000 0.000\n\
             02RNE   12.345 -0.678\n\
             03WXTE  -0.027 m\n\
             04WHdg  354.2 deg\n\
             05WErr  2.8 deg\n\
             06WV    1.00 m/s\n\
             07WStr  -11.4 deg\n\
             08WTime 123.4 s\n\
             09GMode run\n\
             10GCAN  in schedule\n\
             11RGPS  no fix\n"
        );
    }

    proptest! {
        #[test]
        fn whatever_is_shown_fits(
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
            let text = shown(&view);
            prop_assert_eq!(text.matches('\r').count(), usize::from(ROWS));
        }
    }

    #[test]
    fn a_display_that_never_answers_is_absent_after_a_second_and_back_at_once() {
        let mut watch = Supervision::default();
        watch.sent(ROWS);
        for _ in 0..4 {
            watch.sent(ROWS);
            assert!(watch.is_present());
        }
        watch.sent(ROWS);
        assert!(!watch.is_present());
        assert_eq!(watch.counts(), (60, 0));
        watch.received(ACKNOWLEDGE);
        watch.received(0xAA);
        watch.sent(ROWS);
        assert!(watch.is_present());
        assert_eq!(watch.counts(), (71, 1));
    }
}
