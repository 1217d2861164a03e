//! The messages of the network, prepared so that the signals of millions of frames are read in
//! little time.

use serde_json::{Map, Value, json};

use network_model::{ByteOrder, Message, Network, SendType, Signal, WindowKind};

/// Identifiers of 11 bits.
const IDS: usize = 1 << 11;

/// The messages by identifier.
pub(crate) struct Decoder {
    messages: Vec<Known>,
    by_id: Vec<Option<u16>>,
}

/// A message.
pub(crate) struct Known {
    pub(crate) id: u16,
    pub(crate) name: String,
    pub(crate) sender: String,
    /// Whether it is sent when something happens. A reference of a backup master is no such message,
    /// though the network file has no period for it.
    pub(crate) is_event: bool,
    shortest: u8,
    length: u8,
    pub(crate) fields: Vec<Field>,
}

/// A signal.
#[derive(Clone, Debug)]
pub(crate) struct Field {
    pub(crate) name: String,
    pub(crate) unit: String,
    order: ByteOrder,
    /// Bits below the lowest one in the data, read as one number.
    shift: u32,
    size: u32,
    signed: bool,
    factor: f64,
    offset: f64,
    /// Decimals of a physical value.
    pub(crate) decimals: usize,
    /// Name of its value table, and the named values.
    pub(crate) table: Option<String>,
    names: Vec<(i64, String)>,
}

/// Most decimals of a value.
const MOST_DECIMALS: usize = 12;

/// Decimals of a number as it is written.
fn decimals(value: f64) -> usize {
    let text = format!("{value}");
    let places = text.split_once('.').map_or(0, |(_, places)| places.len());
    places.min(MOST_DECIMALS)
}

impl Field {
    fn new(network: &Network, signal: &Signal) -> Self {
        let size = u32::from(signal.size);
        let start = u32::from(signal.start_bit);
        let shift = match signal.byte_order {
            ByteOrder::Little => start,
            // The start bit is the highest one; read as one number, the bits after it are lower.
            ByteOrder::Big => 64_u32.saturating_sub(start / 8 * 8 + (7 - start % 8) + size),
        };
        let mut tables = network.value_tables.iter();
        let table = tables.find(|table| Some(&table.name) == signal.values.as_ref());
        let names = table.map_or(&[][..], |table| &table.values).iter();
        Self {
            name: signal.name.clone(),
            unit: signal.unit.clone(),
            order: signal.byte_order,
            shift,
            size,
            signed: signal.signed,
            factor: signal.factor,
            offset: signal.offset,
            decimals: decimals(signal.factor).max(decimals(signal.offset)),
            table: signal.values.clone(),
            names: names.map(|value| (value.raw, value.name.clone())).collect(),
        }
    }

    /// The raw number; the 64 bits of an unsigned one are read as two's complement, too.
    pub(crate) fn raw(&self, data: &[u8; 8]) -> i64 {
        let all = match self.order {
            ByteOrder::Little => u64::from_le_bytes(*data),
            ByteOrder::Big => u64::from_be_bytes(*data),
        };
        let unused = 64 - self.size.clamp(1, 64);
        let high = all.checked_shr(self.shift).unwrap_or(0) << unused;
        if self.signed {
            (high as i64) >> unused
        } else {
            (high >> unused) as i64
        }
    }

    /// The physical value, in the signal's unit.
    pub(crate) fn value(&self, data: &[u8; 8]) -> f64 {
        let raw = self.raw(data);
        let raw = if self.signed {
            raw as f64
        } else {
            raw as u64 as f64
        };
        raw * self.factor + self.offset
    }

    /// The name of the value, if the network has names for the signal and one for the value.
    pub(crate) fn named(&self, data: &[u8; 8]) -> Option<&str> {
        let raw = self.raw(data);
        let mut names = self.names.iter();
        names
            .find(|(value, _)| *value == raw)
            .map(|(_, name)| name.as_str())
    }

    /// What a script needs to read it.
    pub(crate) fn layout(&self) -> Value {
        let names = self.names.iter();
        let names: Map<String, Value> = names
            .map(|(raw, name)| (raw.to_string(), json!(name)))
            .collect();
        json!({
            "name": self.name,
            "unit": self.unit,
            "big": self.order == ByteOrder::Big,
            "shift": self.shift,
            "size": self.size,
            "signed": self.signed,
            "factor": self.factor,
            "offset": self.offset,
            "decimals": self.decimals,
            "names": names,
        })
    }

    /// Whether the network has names for its values.
    pub(crate) fn has_names(&self) -> bool {
        !self.names.is_empty()
    }
}

impl Known {
    fn new(network: &Network, message: &Message) -> Self {
        let fields = message.signals.iter();
        // A master that has sent no reference yet cannot say when the last one was: its first frame
        // ends with the control byte.
        let first = network_model::Reference::of(message).map(|layout| layout.control + 1);
        Self {
            id: message.id,
            name: message.name.clone(),
            sender: message.sender.clone(),
            is_event: matches!(message.send_type, SendType::Event { .. })
                && message.window.kind != WindowKind::Reference,
            shortest: first.map_or(message.shortest, |first| message.shortest.min(first)),
            length: message.length,
            fields: fields.map(|signal| Field::new(network, signal)).collect(),
        }
    }

    /// Whether the message may have so many data bytes.
    pub(crate) fn accepts(&self, bytes: usize) -> bool {
        (usize::from(self.shortest)..=usize::from(self.length)).contains(&bytes)
    }

    /// Its signal of that name.
    pub(crate) fn field(&self, name: &str) -> Option<&Field> {
        self.fields.iter().find(|field| field.name == name)
    }
}

impl Decoder {
    pub(crate) fn new(network: &Network) -> Self {
        let messages = network.messages.iter();
        let messages: Vec<Known> = messages.map(|one| Known::new(network, one)).collect();
        let mut by_id = vec![None; IDS];
        for (index, message) in messages.iter().enumerate() {
            if let Some(place) = by_id.get_mut(usize::from(message.id)) {
                *place = u16::try_from(index).ok();
            }
        }
        Self { messages, by_id }
    }

    /// All messages, in the order of the network.
    pub(crate) fn messages(&self) -> &[Known] {
        &self.messages
    }

    /// The message with this identifier.
    pub(crate) fn message(&self, id: u16) -> Option<&Known> {
        let index = (*self.by_id.get(usize::from(id))?)?;
        self.messages.get(usize::from(index))
    }

    /// The message of that name.
    pub(crate) fn named(&self, name: &str) -> Option<&Known> {
        self.messages.iter().find(|message| message.name == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_signal_of_every_vehicle_is_read_as_the_model_reads_it() {
        let workspace = crate::Workspace::find().unwrap();
        let mut state = 0x9E37_79B9_7F4A_7C15_u64;
        let mut compared = 0;
        for name in ["uagv", "row-follower", "two-boards"] {
            let vehicle = crate::vehicle::find(&workspace, name).unwrap();
            let network = vehicle.network();
            let decoder = Decoder::new(network);
            for message in &network.messages {
                let known = decoder.message(message.id).unwrap();
                for round in 0..40 {
                    // Marsaglia's xorshift, and also all zeros and all ones.
                    state ^= state << 13;
                    state ^= state >> 7;
                    state ^= state << 17;
                    let data = match round {
                        0 => [0; 8],
                        1 => [0xFF; 8],
                        _ => state.to_le_bytes(),
                    };
                    for (signal, field) in message.signals.iter().zip(&known.fields) {
                        let raw = signal.extract(&data);
                        assert_eq!(i128::from(field.raw(&data)), raw, "{}", signal.name);
                        assert_eq!(field.value(&data), signal.physical(raw), "{}", signal.name);
                        compared += 1;
                    }
                }
            }
        }
        assert!(compared > 5000, "{compared}");
    }

    #[test]
    fn the_first_reference_of_a_master_may_be_short() {
        let workspace = crate::Workspace::find().unwrap();
        let vehicle = crate::vehicle::find(&workspace, "two-boards").unwrap();
        let decoder = Decoder::new(vehicle.network());
        let accepted = |id| {
            let message = decoder.message(id).unwrap();
            (0..=8)
                .filter(|bytes| message.accepts(*bytes))
                .collect::<Vec<_>>()
        };
        assert_eq!(accepted(100), [6, 7, 8]);
        assert_eq!(accepted(300), [8]);
    }

    #[test]
    fn decimals_are_those_of_the_factor() {
        for (value, expected) in [
            (1.0, 0),
            (0.001, 3),
            (0.003_906_25, 8),
            (1e-10, 10),
            (20.0, 0),
        ] {
            assert_eq!(decimals(value), expected, "{value}");
        }
    }
}
