//! Distances to the rows of a rover, from the frames of a run.

use control::row::{ConditionalHold, ScalarKalman};
use network_model::{Network, Signal};
use vehicle_model::Vehicle;
use vehicle_model::manifest::{SignalPath, ThesisLaw};
use vehicle_model::units::{LengthKind, factor};
use world::SimTime;
use world::report::{DistancePair, FrameRecord};

/// The thesis's filter of one distance, in centimetres (thesis 2.2.5.3).
struct Filter {
    hold: ConditionalHold<f64>,
    kalman: ScalarKalman<f64>,
}

impl Filter {
    fn new(law: &ThesisLaw) -> Option<Self> {
        let (least, most) = (law.least.get() * 100.0, law.most.get() * 100.0);
        Some(Self {
            hold: ConditionalHold::new(least, most).ok()?,
            kalman: ScalarKalman::new(law.process, 1.0).ok()?,
        })
    }

    fn pass(&mut self, centimetres: f64) -> f64 {
        self.kalman.step(self.hold.pass(centimetres))
    }
}

/// A signal with a distance, and what makes centimetres of it.
struct Field<'n> {
    id: u16,
    length: u8,
    signal: &'n Signal,
    centimetres: f64,
}

impl<'n> Field<'n> {
    fn find(network: &'n Network, path: &SignalPath) -> Option<Self> {
        let mut messages = network.messages.iter();
        let message = messages.find(|message| message.name == path.message)?;
        let mut signals = message.signals.iter();
        let signal = signals.find(|signal| signal.name == path.signal)?;
        Some(Self {
            id: message.id,
            length: message.length,
            signal,
            centimetres: factor::<LengthKind>(&signal.unit)? * 100.0,
        })
    }

    fn read(&self, frame: &FrameRecord) -> Option<f64> {
        let own = frame.is_message() && frame.id == self.id && frame.dlc == self.length;
        own.then(|| self.signal.physical(self.signal.extract(&frame.data)) * self.centimetres)
    }
}

/// The distances that a rover's nodes tell, filtered as the thesis does it, with the numbers of the
/// manifest. Empty if no message carries them.
pub(crate) fn pairs(vehicle: &Vehicle, frames: &[FrameRecord]) -> Vec<DistancePair> {
    filtered(vehicle, frames).unwrap_or_default()
}

fn filtered(vehicle: &Vehicle, frames: &[FrameRecord]) -> Option<Vec<DistancePair>> {
    let manifest = vehicle.manifest();
    let (rover, signals) = manifest.rover.as_ref().zip(manifest.distances.as_ref())?;
    let network = vehicle.network();
    let fields = [
        Field::find(network, &signals.left)?,
        Field::find(network, &signals.right)?,
    ];
    let mut distances = [None; 2];
    let mut pairs = Vec::new();
    for frame in frames {
        for (distance, field) in distances.iter_mut().zip(&fields) {
            *distance = field.read(frame).or(*distance);
        }
        if let [Some(left), Some(right)] = distances {
            distances = [None; 2];
            pairs.push((frame.end, left, right));
        }
    }
    Some(filter(&rover.thesis, pairs))
}

/// Pairs of a left and a right distance in centimetres, with their times, filtered as the thesis does
/// it. Empty if no filter has the numbers.
pub(crate) fn filter(
    law: &ThesisLaw,
    pairs: impl IntoIterator<Item = (SimTime, f64, f64)>,
) -> Vec<DistancePair> {
    let (Some(mut on_left), Some(mut on_right)) = (Filter::new(law), Filter::new(law)) else {
        return Vec::new();
    };
    let filtered = pairs.into_iter().map(|(at, left, right)| DistancePair {
        at,
        left: on_left.pass(left) / 100.0,
        right: on_right.pass(right) / 100.0,
    });
    filtered.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rover with the UAGV's network, in which two signals take the place of the distances.
    fn vehicle(left: &str, right: &str) -> Vehicle {
        let workspace = crate::Workspace::find().unwrap();
        let uagv = crate::vehicle::find(&workspace, "uagv").unwrap();
        let network = std::fs::read_to_string(uagv.network_file()).unwrap();
        let boards = include_str!("../../world/tests/boards_in_row/vehicle.toml");
        let manifest = format!("{boards}\n[distances]\nleft = {left:?}\nright = {right:?}\n");
        Vehicle::parse("rover", "rover".as_ref(), &manifest, &network).unwrap()
    }

    /// A frame of a message with a length in it.
    fn frame(vehicle: &Vehicle, path: &str, metres: &[(&str, f64)], at: u64) -> FrameRecord {
        let mut messages = vehicle.network().messages.iter();
        let message = messages.find(|message| message.name == path).unwrap();
        let mut data = [0; 8];
        for (name, metres) in metres {
            let mut signals = message.signals.iter();
            let signal = signals.find(|signal| signal.name == *name).unwrap();
            let unit = factor::<LengthKind>(&signal.unit).unwrap();
            let raw = (metres / unit - signal.offset) / signal.factor;
            signal.insert(&mut data, raw.round() as i128);
        }
        FrameRecord {
            id: message.id,
            dlc: message.length,
            data,
            start: SimTime::from_ticks(at),
            end: SimTime::from_ticks(at + 1),
            complete: true,
            remote: false,
        }
    }

    #[test]
    fn both_sides_of_a_frame_are_a_pair() {
        let vehicle = vehicle("Position.North", "Position.East");
        let sides = |left, right, at| {
            let metres = [("North", left), ("East", right)];
            frame(&vehicle, "Position", &metres, at)
        };
        let spoiled = FrameRecord {
            complete: false,
            ..sides(0.6, 0.6, 15)
        };
        let frames = [sides(0.9, 0.8, 10), spoiled, sides(1.3, 0.8, 20)];
        let pairs = pairs(&vehicle, &frames);
        assert_eq!(pairs.len(), 2);
        assert_eq!(pairs[0].at, SimTime::from_ticks(11));
        // The filter begins with its first sample, and 130 cm are not plausible.
        for pair in &pairs {
            assert!((pair.left - 0.9).abs() < 1e-3, "{pairs:?}");
            assert!((pair.right - 0.8).abs() < 1e-3, "{pairs:?}");
        }
    }

    #[test]
    fn two_messages_are_a_pair_when_both_have_come() {
        let vehicle = vehicle("Position.North", "LogPosition.X");
        let left = |metres, at| frame(&vehicle, "Position", &[("North", metres)], at);
        let right = |metres, at| frame(&vehicle, "LogPosition", &[("X", metres)], at);
        let frames = [
            left(0.9, 10),
            right(0.7, 20),
            left(0.9, 30),
            left(0.8, 40),
            right(0.7, 50),
        ];
        let times: Vec<u64> = pairs(&vehicle, &frames)
            .iter()
            .map(|pair| pair.at.as_ticks())
            .collect();
        assert_eq!(times, [21, 51]);
        assert_eq!(pairs(&vehicle, &frames[..1]), []);
    }
}
