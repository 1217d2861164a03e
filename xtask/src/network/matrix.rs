//! The windows, taken from the network file.

use std::iter;

use network_model::{Condition, Message, Network, SendType, Signal, ValueTable};
use twin::Outcome;
use vehicle_model::{Device, Vehicle, manifest::ModeSignal};
use world::{
    Scenario, SimDuration,
    report::{Due, FrameRecord, ModeChange, Run, Window, WindowKind},
};

use crate::sim::bus::Log;

/// The system matrix in the form that the report needs.
pub(crate) struct Matrix {
    network: Network,
    /// The signal that carries the mode; `None` when the vehicle has none.
    mode: Option<ModeSignal>,
    /// The signal that says what guides the vehicle; `None` if rows never do.
    guide: Option<ModeSignal>,
    /// In the order of the messages.
    pub windows: Vec<Window>,
}

impl Matrix {
    /// The matrix of a vehicle. Messages of nodes that send at once are like those of an arbitrating
    /// window: they come at any time. There is no reference.
    pub(crate) fn new(vehicle: &Vehicle) -> Self {
        let network = vehicle.network().clone().with_late_messages();
        let mut all: Vec<Window> = network.messages.iter().flat_map(windows).collect();
        let cycle = u64::from(network.basic_cycle_us.max(1));
        let period = vehicle.receiver_period_us().unwrap_or(cycle);
        let receiver = vehicle.node_of(Device::SatelliteReceiver);
        let receiver = receiver.map(|node| vehicle.node(node).name.as_str());
        for window in &mut all {
            if receiver == Some(&window.sender) {
                let cycles = u16::try_from(period.div_ceil(cycle)).unwrap_or(u16::MAX);
                window.due = measured(window, cycles);
            }
        }
        if vehicle.is_event_triggered() {
            all.retain(|window| window.kind != WindowKind::Reference);
            for window in &mut all {
                window.kind = WindowKind::Arbitrating;
                window.due = Due::Sometimes;
            }
        }
        Self {
            windows: all,
            mode: vehicle.manifest().mode.clone(),
            guide: vehicle.manifest().guide_signal().map(|guide| ModeSignal {
                message: guide.message.clone(),
                signal: guide.signal.clone(),
                // No mode of its own.
                autonomous: String::new(),
            }),
            network,
        }
    }

    /// What a run of the vehicle recorded, in the form that the report needs: without tasks, and without what a rover, rows
    /// or a mission add.
    pub(crate) fn run<'a>(
        &'a self,
        scenario: &'a Scenario,
        nodes: &'a [String],
        seed: u64,
        outcome: &'a Outcome,
        (log, modes): (&'a Log, &'a [ModeChange]),
    ) -> Run<'a> {
        Run {
            scenario,
            nodes,
            seed,
            duration: SimDuration::from_ticks(outcome.duration.as_ticks()),
            states: outcome.world.states(),
            efforts: outcome.world.efforts(),
            frames: &log.frames,
            windows: &self.windows,
            cycle_count_byte: self.cycle_count_byte(),
            basic_cycle: self.basic_cycle(),
            bit_time: self.bit_time(),
            modes,
            tasks: &[],
            rover: None,
            crop: None,
            mission: None,
        }
    }

    /// Length of the basic cycle.
    pub(crate) fn basic_cycle(&self) -> SimDuration {
        micros(self.network.basic_cycle_us)
    }

    /// Length of a bit.
    pub(crate) fn bit_time(&self) -> SimDuration {
        SimDuration::from_ticks(1_000_000_000_000 / u64::from(self.network.bit_rate))
    }

    /// The byte of the reference messages that counts the basic cycles.
    pub(crate) fn cycle_count_byte(&self) -> usize {
        let mut messages = self.network.messages.iter();
        let layout = messages.find_map(network_model::Reference::of);
        layout.map_or(0, |layout| usize::from(layout.control))
    }

    /// The changes of the vehicle's mode, read from the message that carries it.
    pub(crate) fn modes(&self, frames: &[FrameRecord]) -> Vec<ModeChange> {
        self.mode
            .as_ref()
            .map_or_else(Vec::new, |signal| self.changes(frames, signal))
    }

    /// The names of the vehicle's modes; none if it has no modes.
    pub(crate) fn mode_names(&self) -> Vec<String> {
        let table = self.mode.as_ref().and_then(|mode| {
            let mut messages = self.network.messages.iter();
            let message = messages.find(|message| message.name == mode.message)?;
            Some(self.signal(message, &mode.signal)?.1)
        });
        let values = table.into_iter().flat_map(|table| &table.values);
        values.map(|value| value.name.clone()).collect()
    }

    /// A signal of a message, with the names of its values.
    fn signal<'m>(
        &'m self,
        message: &'m Message,
        name: &str,
    ) -> Option<(&'m Signal, &'m ValueTable)> {
        let mut signals = message.signals.iter();
        let signal = signals.find(|one| one.name == name)?;
        let mut tables = self.network.value_tables.iter();
        let table = tables.find(|table| Some(&table.name) == signal.values.as_ref())?;
        Some((signal, table))
    }

    /// The changes of what guides the vehicle, if rows may do so.
    pub(crate) fn guides(&self, frames: &[FrameRecord]) -> Vec<ModeChange> {
        self.guide
            .as_ref()
            .map_or_else(Vec::new, |signal| self.changes(frames, signal))
    }

    /// The changes of a signal with names for its values.
    fn changes(&self, frames: &[FrameRecord], signal: &ModeSignal) -> Vec<ModeChange> {
        let mut modes: Vec<ModeChange> = Vec::new();
        for frame in frames.iter().filter(|frame| frame.is_message()) {
            let Some(mode) = self.value(frame, signal) else {
                continue;
            };
            if modes.last().is_none_or(|last| last.mode != mode) {
                modes.push(ModeChange {
                    at: frame.end,
                    autonomous: signal.autonomous == mode,
                    mode,
                });
            }
        }
        modes
    }

    /// The value of a signal that a frame carries, if it carries it.
    fn value(&self, frame: &FrameRecord, mode: &ModeSignal) -> Option<String> {
        let message = self.network.message(frame.id)?;
        (message.name == mode.message).then(|| self.named(frame, &mode.signal))?
    }

    /// The name of the message with this identifier.
    pub(crate) fn message(&self, id: u16) -> Option<&str> {
        self.network
            .message(id)
            .map(|message| message.name.as_str())
    }

    /// Whether the message with this identifier comes again and again, on whatever bus.
    pub(crate) fn is_cyclic(&self, id: u16) -> bool {
        let message = self.network.message(id);
        message.is_some_and(|message| matches!(message.send_type, SendType::Cyclic { .. }))
    }

    /// The name of the value that a frame carries in a signal, if it has this signal and names for it.
    pub(crate) fn named(&self, frame: &FrameRecord, signal: &str) -> Option<String> {
        let message = self.network.message(frame.id)?;
        if frame.dlc != message.length {
            return None;
        }
        let (signal, table) = self.signal(message, signal)?;
        let raw = signal.extract(&frame.data);
        let value = table
            .values
            .iter()
            .find(|value| i128::from(value.raw) == raw);
        Some(value.map_or_else(|| format!("mode {raw}"), |value| value.name.clone()))
    }
}

/// Share of a basic cycle by which references may be closer or further apart than planned.
const APART: i64 = 50;

/// Whether two references are as far apart as the schedule says, or a multiple of it because some are
/// missing, ns. Frames that waited in a queue until somebody read them are stamped one directly after the
/// other: windows cannot be judged by such references.
pub(crate) fn are_in_order(apart: i64, basic_cycle: i64, tolerance: i64) -> bool {
    let cycles = (apart + basic_cycle / 2) / basic_cycle.max(1);
    let deviation = (apart - cycles * basic_cycle).abs();
    cycles > 0 && deviation <= basic_cycle / APART + tolerance
}

/// When the message of a window is due whose sender has the satellite receiver, which measures in one of so many basic
/// cycles.
fn measured(window: &Window, cycles: u16) -> Due {
    match window.due {
        Due::Always if cycles > 1 && window.kind == WindowKind::Exclusive => Due::OneOf(cycles),
        Due::WhileFixed(_) => Due::WhileFixed(cycles.max(1)),
        due => due,
    }
}

/// The windows of a message.
fn windows(message: &Message) -> impl Iterator<Item = Window> {
    let all = iter::once(&message.window).chain(&message.further);
    all.map(|window| Window {
        id: message.id,
        message: message.name.clone(),
        sender: message.sender.clone(),
        start: micros(window.start_us),
        length: micros(window.length_us),
        repeat: window.repeat,
        offset: window.offset,
        kind: match window.kind {
            network_model::WindowKind::Reference => WindowKind::Reference,
            network_model::WindowKind::Exclusive => WindowKind::Exclusive,
            network_model::WindowKind::Arbitrating => WindowKind::Arbitrating,
        },
        due: match (message.send_type, message.condition) {
            (SendType::Event { .. }, _) => Due::Sometimes,
            (SendType::Cyclic { .. }, Condition::Always) => Due::Always,
            (SendType::Cyclic { .. }, Condition::WhileFixed) => Due::WhileFixed(1),
        },
    })
}

fn micros(us: u32) -> SimDuration {
    SimDuration::from_ticks(u64::from(us) * 1_000_000)
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle_model::{Overrides, Protocol};
    use world::SimTime;

    fn matrix() -> Matrix {
        let workspace = crate::Workspace::find().unwrap();
        Matrix::new(&crate::vehicle::find(&workspace, "uagv").unwrap())
    }

    #[test]
    fn the_windows_are_those_of_the_network_file() {
        let matrix = matrix();
        let window = |id| matrix.windows.iter().find(|w| w.id == id).unwrap();
        assert_eq!(window(100).kind, WindowKind::Reference);
        assert_eq!(window(300).start, micros(7000));
        assert_eq!(window(300).due, Due::Always);
        assert_eq!(window(200).due, Due::WhileFixed(1));
        assert_eq!(window(501).due, Due::Sometimes);
        assert_eq!(matrix.bit_time(), SimDuration::from_ticks(4_000_000));
        assert_eq!(matrix.basic_cycle(), micros(100_000));
    }

    #[test]
    fn a_receiver_of_one_hertz_fills_one_of_ten_windows() {
        let workspace = crate::Workspace::find().unwrap();
        let due = |period: &str| {
            let set = Overrides::parse(&format!("receiver.period={period}")).unwrap();
            let vehicle = crate::vehicle::with(&workspace, "uagv", &set).unwrap();
            let windows = Matrix::new(&vehicle).windows;
            let of = |id| windows.iter().find(|window| window.id == id).unwrap().due;
            [200, 201, 300, 206, 100].map(of)
        };
        let others = [Due::Always; 3];
        let with = |first: [Due; 2]| [&first[..], &others].concat();
        assert_eq!(due("1 s")[..], with([Due::WhileFixed(10), Due::OneOf(10)]));
        assert_eq!(due("200 ms")[..], with([Due::WhileFixed(2), Due::OneOf(2)]));
        assert_eq!(due("100 ms")[..], with([Due::WhileFixed(1), Due::Always]));
    }

    #[test]
    fn nodes_that_send_at_once_have_no_windows_to_keep_to() {
        let workspace = crate::Workspace::find().unwrap();
        let event = Overrides::default().on(Protocol::EventTriggered);
        let vehicle = crate::vehicle::with(&workspace, "two-boards", &event).unwrap();
        let windows = Matrix::new(&vehicle).windows;
        let ids: Vec<u16> = windows.iter().map(|window| window.id).collect();
        assert!(ids.contains(&300) && !ids.contains(&100), "{ids:?}");
        let free = |window: &Window| {
            (window.kind, window.due) == (WindowKind::Arbitrating, Due::Sometimes)
        };
        assert!(windows.iter().all(free));
    }

    #[test]
    fn modes_are_read_from_the_commands() {
        let command = |at: u64, mode: u8, complete: bool| FrameRecord {
            remote: false,
            id: 300,
            dlc: 8,
            data: [0, 0, 0, 0, mode, 0, 0, 0],
            start: SimTime::from_ticks(at),
            end: SimTime::from_ticks(at + 1),
            complete,
        };
        let frames = [
            command(10, 0, true),
            command(20, 0, true),
            command(30, 3, false),
            command(40, 3, true),
            command(50, 7, true),
        ];
        let modes = matrix().modes(&frames);
        let seen: Vec<_> = modes
            .iter()
            .map(|m| (m.at.as_ticks(), m.mode.as_str(), m.autonomous))
            .collect();
        assert_eq!(
            seen,
            [
                (11, "Idle", false),
                (41, "AutonomousRun", true),
                (51, "mode 7", false)
            ]
        );
    }
}
