//! Where the network file has what a planner needs.

use std::time::Duration;

use control::demand::Demand;
use firmware::e2e::{CHECK, COUNTER};
use network_model::{Message, Network, Reference, Signal, Window, WindowKind, worst_case_bits};
use vehicle_model::Vehicle;

use super::{Error, Lead, Report, Slot};

/// The messages.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    references: Vec<(Message, Signal)>,
    command: Message,
    curvature: Signal,
    speed: Signal,
    mask: u64,
    report: Option<Message>,
    /// The messages with the starts of a session, and their numbers, in the order of their places.
    starts: Vec<(Message, Signal)>,
    lead: String,
    network: Network,
}

impl Layout {
    pub(crate) fn of(vehicle: &Vehicle) -> Result<Self, Error> {
        let name = || vehicle.name().to_owned();
        let missing = || Error::NoPlanner { vehicle: name() };
        let network = vehicle.network();
        let planner = vehicle.manifest().leading_planner().ok_or_else(missing)?;
        let find = |name: &str| network.messages.iter().find(|one| one.name == name);
        let command = find(&planner.command).ok_or_else(missing)?;
        let signal = |name| signal(command, name).cloned().ok_or_else(missing);
        let references = network.messages.iter();
        let references = references.filter(|one| one.window.kind == WindowKind::Reference);
        let references: Vec<_> = references
            .filter_map(|one| Some((one.clone(), self::signal(one, "SystemTime")?.clone())))
            .collect();
        if references.is_empty() {
            return Err(Error::NoTime { vehicle: name() });
        }
        Ok(Self {
            references,
            curvature: signal("Curvature")?,
            speed: signal("Speed")?,
            mask: mask(command),
            command: command.clone(),
            starts: starts(vehicle),
            report: find(&planner.lead.message).cloned(),
            lead: planner.lead.signal.clone(),
            network: network.clone(),
        })
    }

    pub(crate) fn command_id(&self) -> u16 {
        self.command.id
    }

    /// The bits that carry a tag, D0 least significant.
    pub(crate) fn mask(&self) -> u64 {
        self.mask
    }

    /// The place of a node in the session, and the number of its start.
    pub(crate) fn start(&self, id: u16, data: &[u8]) -> Option<(usize, u32)> {
        let mut starts = self.starts.iter().enumerate();
        let (place, (message, number)) = starts.find(|(_, (one, _))| one.id == id)?;
        let whole = data.len() >= usize::from(message.length);
        let number = u32::try_from(number.extract(data)).ok()?;
        whole.then_some((place, number))
    }

    /// The system time (ms) of a reference message, and when a command may be sent in the basic cycle that it
    /// begins, if it has the command's window.
    pub(crate) fn begin(&self, id: u16, data: &[u8]) -> Option<(u32, Option<Slot>)> {
        let mut references = self.references.iter();
        let (reference, time) = references.find(|(one, _)| one.id == id)?;
        if data.len() < usize::from(reference.shortest) {
            return None;
        }
        let time = u32::try_from(time.extract(data)).ok()?;
        let count = Reference::of(reference)
            .and_then(|layout| data.get(usize::from(layout.control)).copied())
            .map_or(0, |control| control & 0x3F);
        let mut windows = self.command.windows();
        let own = windows.find(|window| count % window.repeat.max(1) == window.offset);
        Some((time, own.map(|window| self.slot(time, reference, &window))))
    }

    fn slot(&self, time: u32, reference: &Message, window: &Window) -> Slot {
        let frame = |message: &Message| self.network.bits_to_us(worst_case_bits(message.length));
        let uncertain = self.network.sync_uncertainty_us;
        // The window counts from the start of the reference, whose length depends on its data.
        let before = frame(&self.command) + frame(reference) + uncertain;
        let micros = |us: u32| Duration::from_micros(us.into());
        let earliest = window.start_us + uncertain;
        Slot {
            time: Duration::from_millis(time.into()),
            earliest: micros(earliest),
            latest: micros(window.end_us().saturating_sub(before).max(earliest)),
        }
    }

    /// The data of a command, without its protection.
    pub(crate) fn command(&self, demand: Demand<f64>) -> [u8; 8] {
        let mut data = [0; 8];
        put(&self.curvature, demand.curvature, 1.0, &mut data);
        put(&self.speed, demand.speed, metres(&self.speed), &mut data);
        data
    }

    pub(crate) fn report(&self, id: u16, data: &[u8]) -> Option<Report> {
        let message = self.report.as_ref().filter(|message| message.id == id)?;
        if data.len() < usize::from(message.shortest) {
            return None;
        }
        let number = |name: &str| signal(message, name).map(|it| it.extract(data));
        let physical = |name: &str| signal(message, name).map(|it| it.physical(it.extract(data)));
        let speed = signal(message, "Speed");
        Some(Report {
            lead: match self.named(message, data)? {
                "Path" => Lead::Path,
                "Planner" => Lead::Planner,
                _ => Lead::Nobody,
            },
            refused: number("Refused").map_or(0, |count| count as u8),
            age: Duration::from_secs_f64(physical("Age").unwrap_or(0.0).max(0.0) * 1e-3),
            demand: Demand {
                curvature: physical("Curvature").unwrap_or(0.0),
                speed: physical("Speed").unwrap_or(0.0) * speed.map_or(1.0, metres),
            },
        })
    }

    /// The name of who leads.
    fn named(&self, message: &Message, data: &[u8]) -> Option<&str> {
        let lead = signal(message, &self.lead)?;
        let table = lead.values.as_ref()?;
        let mut tables = self.network.value_tables.iter();
        let values = &tables.find(|one| one.name == *table)?.values;
        let raw = lead.extract(data);
        let mut named = values.iter();
        let value = named.find(|value| i128::from(value.raw) == raw)?;
        Some(&value.name)
    }
}

/// Where the nodes of a session tell their starts.
fn starts(vehicle: &Vehicle) -> Vec<(Message, Signal)> {
    let sessions = vehicle.manifest().sessions.as_ref();
    let sessions = sessions.filter(|sessions| sessions.enabled);
    let paths = sessions.into_iter().flat_map(|sessions| &sessions.starts);
    let all = paths.filter_map(|path| {
        let mut messages = vehicle.network().messages.iter();
        let message = messages.find(|one| one.name == path.message)?;
        Some((message.clone(), signal(message, &path.signal)?.clone()))
    });
    all.collect()
}

fn signal<'m>(message: &'m Message, name: &str) -> Option<&'m Signal> {
    message.signals.iter().find(|signal| signal.name == name)
}

/// Metres per second in the unit of a speed.
fn metres(signal: &Signal) -> f64 {
    match signal.unit.as_str() {
        "mm/s" => 1e-3,
        "cm/s" => 1e-2,
        _ => 1.0,
    }
}

/// Puts a value in SI units into its signal, or the nearest one that is in range.
fn put(signal: &Signal, value: f64, unit: f64, data: &mut [u8; 8]) {
    let (least, most) = signal.count_range().unwrap_or_else(|| signal.raw_range());
    let count = (value / unit / signal.factor).round() as i128;
    signal.insert(data, count.clamp(least, most));
}

/// The bytes of the protection, and the bits of no signal.
fn mask(message: &Message) -> u64 {
    let mut used = [0; 8];
    for signal in &message.signals {
        signal.insert(&mut used, -1);
    }
    !u64::from_le_bytes(used) | 0xFF << (8 * COUNTER) | 0xFF << (8 * CHECK)
}
