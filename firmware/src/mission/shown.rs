//! What the operator sees of a mission, on the last row of the display.

use super::upload::Reason;
use crate::display::{COLUMNS, More, PAGE};
use crate::text::Text;

/// What is known of the mission, and what the vehicle does of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stage {
    /// It is being checked.
    #[default]
    Checking,
    /// The next run drives it.
    Ready,
    /// A run drives it.
    Driving,
    /// The run is paused.
    Paused,
    /// It has been driven to its end.
    Finished,
    /// It cannot be driven, or there is no way on from a leg.
    Refused(Reason),
}

/// A mission on the display.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shown {
    /// Its number; 0 if a debug probe wrote it, or if it is the line of the waypoints.
    pub number: u16,
    /// What is known of it.
    pub stage: Stage,
    /// The leg, counted from 0, or the one at fault.
    pub leg: u16,
    /// Number of legs.
    pub legs: u16,
    /// Why the last request from the bus was refused, if it was.
    pub request: Option<Reason>,
}

impl More for Shown {
    /// The mission has every third turn, and all while it is paused or cannot be driven. A refusal of a request has
    /// every third one, too.
    fn row(&self, text: &mut Text<COLUMNS>, time: u32) -> bool {
        let turn = time / PAGE % 3;
        let waits = matches!(self.stage, Stage::Paused | Stage::Refused(_));
        match self.request {
            Some(reason) if turn == 1 => {
                text.str("refused: ").str(reason.short());
                return true;
            }
            _ if turn != 0 && !waits => return false,
            _ => {}
        }
        text.str("M").unsigned(self.number.into()).str(" ");
        match self.stage {
            Stage::Refused(reason) => {
                text.str("no ").unsigned((self.leg + 1).into());
                text.str(" ").str(reason.short());
                return true;
            }
            Stage::Checking => text.str("check"),
            Stage::Ready => text.str("ready"),
            Stage::Driving => text.str("leg"),
            Stage::Paused => text.str("paused"),
            Stage::Finished => text.str("done"),
        };
        text.str(" ").unsigned((self.leg + 1).into());
        text.str("/").unsigned(self.legs.into());
        true
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::string::String;

    use super::*;

    /// The row in three turns.
    fn rows(shown: &Shown) -> [Option<String>; 3] {
        [0, 1, 2].map(|turn| {
            let mut text = Text::new();
            let told = shown.row(&mut text, turn * PAGE + 1);
            told.then(|| String::from_utf8(text.as_bytes().to_vec()).unwrap())
        })
    }

    #[test]
    fn the_operator_sees_number_state_and_leg() {
        let shown = |stage, request| Shown {
            number: 65_535,
            stage,
            leg: 4094,
            legs: 4095,
            request,
        };
        let some = |row: &str| Some(row.into());
        assert_eq!(
            rows(&shown(Stage::Driving, None)),
            [some("M65535 leg 4095/4095"), None, None]
        );
        let refused = Some(Reason::NotPaused);
        assert_eq!(
            rows(&shown(Stage::Ready, refused)),
            [
                some("M65535 ready 4095/40"),
                some("refused: not paused"),
                None
            ]
        );
        let paused = Shown {
            number: 3,
            stage: Stage::Paused,
            leg: 11,
            legs: 34,
            request: None,
        };
        assert_eq!(rows(&paused), ["M3 paused 12/34"; 3].map(some));
        let stage = Stage::Refused(Reason::Curvature);
        assert_eq!(
            rows(&Shown { stage, ..paused }),
            ["M3 no 12 curvature"; 3].map(some)
        );
    }
}
