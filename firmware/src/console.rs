//! Console lines (thesis 6.2.4.6): the state of a node, ten times a second, on a serial port.

use control::mode::Mode;
use sled_common::can::ErrorState;
use ttcan::{ErrorLevel, MasterState, Micros, Status, SyncState};

use crate::actuator::Refusal;
use crate::e2e::Proof;
use crate::link::{self, AnyLink, Silence};
use crate::navigation::Navigation;
use crate::peers::Named;
use crate::pilot::Reason;
use crate::sbp;
use crate::text::Text;

/// Longest line in bytes, line ending included: the line width of the boards' queue.
pub const WIDTH: usize = 128;

/// One line.
pub type Line = Text<WIDTH>;

/// The bus as one node sees it.
#[derive(Clone, Copy, Debug)]
pub struct BusView {
    /// State of the protocol.
    pub status: Status,
    /// Reference messages that were missed.
    pub missed_references: u32,
    /// Messages of other nodes that were missed.
    pub missed_messages: u32,
    /// Own windows missed: requested too late, suppressed by the error level, or destroyed on
    /// the bus. An event message that lost arbitration is not a miss, nor is the reference of a
    /// backup master.
    pub missed_windows: u32,
    /// Frames with an unknown identifier or outside their window.
    pub misplaced: u32,
    /// Error counters of the controller.
    pub errors: ErrorState,
    /// Counters of the link.
    pub link: link::Counters,
    /// Why the node sends nothing.
    pub silence: Option<Silence>,
    /// Trim of the node's RC oscillator, in steps; `None` on its external clock.
    pub trim: Option<i8>,
    /// How long a node that only listens has heard nothing.
    pub quiet: Option<Micros>,
    /// Rank of the node among the time masters.
    pub rank: Option<u8>,
    /// Whether the time of the bus is proven.
    pub time: Proof,
    /// References with a wrong tag.
    pub forged: u16,
}

impl BusView {
    /// The current state of a link.
    pub fn of(link: &impl AnyLink) -> Self {
        link.view()
    }
}

#[cfg(test)]
impl BusView {
    /// A follower's view of a bus without errors, the time master of rank `leader`.
    pub(crate) fn quiet(sync: SyncState, leader: Option<u8>) -> Self {
        Self {
            status: Status {
                sync,
                master: MasterState::Follower,
                error_level: ErrorLevel::None,
                missed_references: 0,
                cycle: 0,
                master_rank: leader,
                initial_watch: false,
                clock: ttcan::ClockState::Locked,
                reference_offset: 0,
            },
            missed_references: 0,
            missed_messages: 0,
            missed_windows: 0,
            misplaced: 0,
            errors: ErrorState::default(),
            link: link::Counters::default(),
            silence: None,
            trim: None,
            quiet: None,
            rank: None,
            time: Proof::Unasked,
            forged: 0,
        }
    }
}

/// The line about the bus.
pub fn bus(line: &mut Line, view: &BusView) {
    let status = &view.status;
    line.str("bus ");
    line.str(match status.sync {
        SyncState::Off => "off",
        SyncState::Synchronising => "sync",
        SyncState::InSchedule => "run",
        SyncState::InGap => "gap",
    });
    line.str(match status.master {
        MasterState::Off | MasterState::Follower => "",
        MasterState::Backup => " backup",
        MasterState::Current => " master",
    });
    line.str(match status.error_level {
        ErrorLevel::None => " S0",
        ErrorLevel::Warning => " S1",
        ErrorLevel::Error => " S2",
        ErrorLevel::Severe(_) => " S3",
    });
    line.str(" ref-").unsigned(view.missed_references);
    line.str(" msg-").unsigned(view.missed_messages);
    line.str(" own-").unsigned(view.missed_windows);
    line.str(" odd ").unsigned(view.misplaced);
    line.str(" tec ").unsigned(u32::from(view.errors.transmit));
    line.str(" rec ").unsigned(u32::from(view.errors.receive));
    line.str(" ovr ").unsigned(u32::from(view.link.overruns));
    line.str(" off ").unsigned(u32::from(view.link.bus_off));
    if let Some(trim) = view.trim {
        line.str(" rc ").signed(i32::from(trim));
    }
    line.str(match view.silence {
        None if view.time == Proof::Unproven => " time?",
        None => "",
        Some(Silence::Waiting) => " waits",
        Some(Silence::Away) => " away",
        Some(Silence::NoReference) => " no ref",
        Some(Silence::Trimming) => " trims",
    });
    if view.time != Proof::Unasked {
        // The line has room for three digits.
        line.str(" tag-").unsigned(u32::from(view.forged.min(999)));
    }
    line.str("\r\n");
}

/// State of an actuator node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ActuatorView {
    /// Commanded value in hundredths of its unit, such as centidegrees a second or cm/s;
    /// `None` when no command is in force.
    pub command: Option<i16>,
    /// Potentiometer, counts, where there is one.
    pub count: Option<u16>,
    /// The motor driver's byte.
    pub byte: u8,
    /// Command frames refused.
    pub refused: u16,
    /// Why the last refused frame was refused; for the log.
    pub refusal: Option<Refusal>,
}

/// The line about an actuator.
pub fn actuator(line: &mut Line, label: &str, view: &ActuatorView) {
    line.str(label);
    match view.command {
        Some(command) => line.str(" cmd ").fixed(i32::from(command), 2),
        None => line.str(" no cmd"),
    };
    if let Some(count) = view.count {
        line.str(" pot ").unsigned(u32::from(count));
    }
    line.str(" out ").unsigned(u32::from(view.byte));
    line.str(" refused ").unsigned(u32::from(view.refused));
    line.str("\r\n");
}

/// The line about the satellite receiver; `age_ms` is the age of its last message.
pub fn receiver(
    line: &mut Line,
    navigation: &Navigation,
    age_ms: Option<u32>,
    counters: sbp::Counters,
) {
    line.str("gps ");
    line.str(match navigation.fix() {
        sbp::Fix::None => "none",
        sbp::Fix::Single => "single",
        sbp::Fix::Differential => "dgnss",
        sbp::Fix::Float => "float",
        sbp::Fix::Fixed => "fixed",
        sbp::Fix::DeadReckoning => "dr",
        sbp::Fix::Augmented => "sbas",
    });
    line.str(" sats ")
        .unsigned(u32::from(navigation.satellites()));
    match age_ms {
        Some(age) => line.str(" age ").unsigned(age),
        None => line.str(" silent"),
    };
    line.str(" epochs ").unsigned(navigation.epochs());
    line.str(" frames ").unsigned(counters.frames);
    line.str(" crc ").unsigned(counters.checksum_errors);
    line.str(" skip ").unsigned(counters.skipped);
    line.str("\r\n");
}

/// State of the controller.
#[derive(Clone, Copy, Debug)]
pub struct PilotView {
    /// Mode.
    pub mode: Mode,
    /// Why it was entered; for the log.
    pub reason: Reason,
    /// Position, north, mm.
    pub north: i32,
    /// Position, east, mm.
    pub east: i32,
    /// Cross-track error, mm.
    pub cross_track: i32,
    /// Heading error, thousandths of a degree.
    pub heading_error: i32,
    /// Whether the solution is fixed.
    pub fixed: bool,
    /// Whether the display answers.
    pub display: bool,
    /// Another node that does not do its part on the bus.
    pub trouble: Option<Named>,
}

/// The line about the vehicle, which is called `name`.
pub fn pilot(line: &mut Line, name: &str, view: &PilotView) {
    line.str(name).byte(b' ').str(view.mode.name());
    line.str(if view.fixed { " fixed" } else { " no fix" });
    line.str(" n ").fixed(view.north, 3);
    line.str(" e ").fixed(view.east, 3);
    line.str(" xte ").fixed(view.cross_track, 3);
    line.str(" psi ").fixed(view.heading_error, 3);
    if !view.display {
        line.str(" lcd?");
    }
    if view.mode == Mode::Fault {
        line.str(" by ").str(view.reason.text());
    }
    if let Some(trouble) = &view.trouble {
        line.byte(b' ');
        trouble.write(line);
    }
    line.str("\r\n");
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    #[test]
    fn the_longest_lines_fit() {
        let mut line = Line::new();
        let view = ActuatorView {
            command: Some(i16::MIN),
            count: Some(u16::MAX),
            byte: 255,
            refused: u16::MAX,
            refusal: Some(Refusal::Limits),
        };
        actuator(&mut line, "steering", &view);
        assert_eq!(
            std::str::from_utf8(line.as_bytes()).unwrap(),
            "steering cmd -327.68 pot 65535 out 255 refused 65535\r\n"
        );
        line.clear();
        let most = sbp::Counters {
            frames: u32::MAX,
            checksum_errors: u32::MAX,
            skipped: u32::MAX,
        };
        receiver(&mut line, &Navigation::new(), Some(u32::MAX), most);
        assert!(!line.is_cut());
        line.clear();
        let worst = PilotView {
            mode: Mode::Manual,
            reason: Reason::ButtonB,
            north: i32::MIN,
            east: i32::MIN,
            cross_track: i32::MIN,
            heading_error: i32::MIN,
            fixed: false,
            display: false,
            trouble: Some(Named {
                trouble: crate::peers::Trouble {
                    node: 1,
                    health: ttcan::Health::Masquerade,
                    others: 255,
                },
                name: "controller",
            }),
        };
        pilot(&mut line, "uagv", &worst);
        assert!(!line.is_cut());
    }

    #[test]
    fn the_longest_line_about_the_bus_fits() {
        let mut line = Line::new();
        let status = Status {
            sync: SyncState::InSchedule,
            master: MasterState::Current,
            error_level: ErrorLevel::Severe(ttcan::Severe::BusOff),
            missed_references: 255,
            cycle: 63,
            master_rank: Some(7),
            initial_watch: false,
            clock: ttcan::ClockState::Locked,
            reference_offset: -127,
        };
        // Even three counters at their largest values in one line are more than the vehicle's
        // lifetime brings.
        let worst = BusView {
            status,
            missed_references: 9_999_999,
            missed_messages: 99_999_999,
            missed_windows: 9_999_999,
            misplaced: 99_999_999,
            errors: ErrorState {
                transmit: 255,
                receive: 255,
                warning: true,
                passive: true,
                bus_off: true,
            },
            link: link::Counters {
                overruns: u16::MAX,
                bus_off: u16::MAX,
                ..link::Counters::default()
            },
            silence: Some(Silence::NoReference),
            trim: Some(-16),
            quiet: None,
            rank: None,
            time: Proof::Unproven,
            forged: u16::MAX,
        };
        bus(&mut line, &worst);
        assert!(!line.is_cut());
        line.clear();
        let unproven = BusView {
            silence: None,
            ..worst
        };
        bus(&mut line, &unproven);
        assert!(!line.is_cut());
    }
}
