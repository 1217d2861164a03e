//! The message types.

use std::fmt::Write;

use super::{
    names::{doc, pascal, screaming, snake},
    types::{Field, Integer, Quantity, counts},
};
use crate::{
    network::{Message, Network, SendType, ValueTable, WindowKind},
    signal::{Piece, Signal},
};

/// Writes the nodes, the quantities, the enumerations and the messages of a network.
pub fn messages(network: &Network) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut out, network);
    out
}

fn write_all(out: &mut String, network: &Network) -> std::fmt::Result {
    nodes(out, network)?;
    for quantity in Quantity::used(network) {
        write_quantity(out, network, quantity)?;
    }
    for table in &network.value_tables {
        write_values(out, table)?;
    }
    for message in &network.messages {
        write_message(out, network, message)?;
    }
    write_any(out, network)
}

fn nodes(out: &mut String, network: &Network) -> std::fmt::Result {
    writeln!(out, "/// A node of the network.")?;
    writeln!(
        out,
        "#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]"
    )?;
    writeln!(out, "pub enum Node {{")?;
    for node in &network.nodes {
        writeln!(out, "    /// {}", doc(&node.comment))?;
        writeln!(out, "    {},", pascal(&node.name))?;
    }
    writeln!(out, "}}\n")
}

fn write_quantity(out: &mut String, network: &Network, quantity: Quantity) -> std::fmt::Result {
    let name = quantity.name;
    let integer = quantity.integer(network).name();
    writeln!(out, "/// {}", quantity.doc)?;
    writeln!(
        out,
        "#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]"
    )?;
    writeln!(out, "pub struct {name}(pub {integer});\n")?;
    writeln!(out, "impl {name} {{")?;
    writeln!(out, "    /// Unit that [`Self::FACTOR`] is in.")?;
    writeln!(
        out,
        "    pub const UNIT: &'static str = {:?};",
        quantity.unit
    )?;
    writeln!(out, "    /// Size of one count, in `{}`.", quantity.unit)?;
    writeln!(
        out,
        "    pub const FACTOR: f32 = {:?};",
        quantity.factor as f32
    )?;
    writeln!(out, "}}\n")
}

fn write_values(out: &mut String, table: &ValueTable) -> std::fmt::Result {
    let name = &table.name;
    writeln!(
        out,
        "/// Values of the signals that the network file lists as `{name}`."
    )?;
    writeln!(
        out,
        "#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]"
    )?;
    writeln!(out, "#[repr(u8)]")?;
    writeln!(out, "pub enum {name} {{")?;
    for value in &table.values {
        writeln!(out, "    /// {} in the frame.", value.raw)?;
        writeln!(out, "    {} = {},", value.name, value.raw)?;
    }
    writeln!(out, "}}\n")?;
    writeln!(out, "impl {name} {{")?;
    writeln!(out, "    /// The value of this number, if it has one.")?;
    writeln!(out, "    pub const fn from_raw(raw: u8) -> Option<Self> {{")?;
    writeln!(out, "        match raw {{")?;
    for value in &table.values {
        writeln!(
            out,
            "            {} => Some(Self::{}),",
            value.raw, value.name
        )?;
    }
    writeln!(out, "            _ => None,\n        }}\n    }}\n")?;
    writeln!(out, "    /// The number in the frame.")?;
    writeln!(
        out,
        "    pub const fn raw(self) -> u8 {{\n        self as u8\n    }}\n"
    )?;
    writeln!(out, "    /// The name in the network file.")?;
    writeln!(out, "    pub const fn name(self) -> &'static str {{")?;
    writeln!(out, "        match self {{")?;
    for value in &table.values {
        writeln!(
            out,
            "            Self::{0} => {0:?},",
            Debugged(&value.name)
        )?;
    }
    writeln!(out, "        }}\n    }}\n}}\n")
}

/// A name that displays bare as a path and quoted with `{:?}`.
struct Debugged<'a>(&'a str);

impl std::fmt::Display for Debugged<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.0)
    }
}

impl std::fmt::Debug for Debugged<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.0)
    }
}

fn write_message(out: &mut String, network: &Network, message: &Message) -> std::fmt::Result {
    let name = &message.name;
    writeln!(out, "/// {}", doc(&message.comment))?;
    writeln!(out, "///")?;
    writeln!(
        out,
        "/// Identifier {} (0x{:03X}), {} data bytes, sent by `{}` {} in the {} window from {} to {} us.",
        message.id,
        message.id,
        message.length,
        message.sender,
        match message.send_type {
            SendType::Cyclic { period_ms } => format!("every {period_ms} ms"),
            SendType::Event { interval_ms } => format!("at most every {interval_ms} ms"),
        },
        match message.window.kind {
            WindowKind::Reference => "reference",
            WindowKind::Exclusive => "exclusive",
            WindowKind::Arbitrating => "arbitrating",
        },
        message.window.start_us,
        message.window.end_us(),
    )?;
    writeln!(out, "#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]")?;
    writeln!(out, "pub struct {name} {{")?;
    for signal in &message.signals {
        writeln!(out, "    /// {}", doc(&signal.comment))?;
        writeln!(out, "    ///")?;
        writeln!(out, "    /// {}", range(signal))?;
        let field = Field::of(network, signal);
        writeln!(out, "    pub {}: {},", snake(&signal.name), field.name())?;
    }
    writeln!(out, "}}\n")?;

    writeln!(out, "impl {name} {{")?;
    for signal in &message.signals {
        let (least, greatest) = counts(signal);
        writeln!(out, "    /// Signal `{}`.", signal.name)?;
        writeln!(
            out,
            "    pub const {}: Signal = Signal {{ name: {:?}, unit: {:?}, factor: {:?}, least: {least}, greatest: {greatest} }};",
            screaming(&signal.name),
            signal.name,
            signal.unit,
            signal.factor,
        )?;
    }
    writeln!(out, "}}\n")?;

    writeln!(out, "impl Message for {name} {{")?;
    writeln!(out, "    const ID: u16 = {};", message.id)?;
    writeln!(out, "    const NAME: &'static str = {name:?};")?;
    writeln!(out, "    const LENGTH: u8 = {};", message.length)?;
    writeln!(out, "    const SHORTEST: u8 = {};", message.shortest)?;
    writeln!(out, "    const FREE: u64 = {:#X};", message.free())?;
    writeln!(
        out,
        "    type Node = Node;\n    const SENDER: Node = Node::{};",
        pascal(&message.sender)
    )?;
    let signals: Vec<String> = message
        .signals
        .iter()
        .map(|signal| format!("Self::{}", screaming(&signal.name)))
        .collect();
    writeln!(
        out,
        "    const SIGNALS: &'static [Signal] = &[{}];",
        signals.join(", ")
    )?;
    writeln!(out, "    type Bytes = [u8; {}];\n", message.length)?;
    encode(out, network, message)?;
    frame(out, message)?;
    decode(out, network, message)?;
    visit(out, network, message)?;
    writeln!(out, "}}\n")
}

fn range(signal: &Signal) -> String {
    let unit = if signal.unit.is_empty() {
        String::new()
    } else {
        format!(" `{}`", signal.unit)
    };
    match signal.values {
        Some(_) => "One of its named values.".into(),
        None if signal.size == 1 => "A flag.".into(),
        None => format!("Range {} to {}{unit}.", signal.min, signal.max),
    }
}

/// The unsigned type in which a signal is put together and taken apart: wide
/// enough for the raw number and for the count.
fn work_type(signal: &Signal, field: &Field) -> Integer {
    let raw = Integer::holding(0, (1 << signal.size) - 1).bits;
    let count = match field {
        Field::Quantity(_, integer) | Field::Plain(integer) => integer.bits,
        Field::Bool | Field::Values(_) => 8,
    };
    Integer::unsigned(raw.max(count))
}

fn encode(out: &mut String, network: &Network, message: &Message) -> std::fmt::Result {
    writeln!(out, "    fn encode(&self) -> Self::Bytes {{")?;
    let mut bytes = vec![Vec::new(); usize::from(message.length)];
    for signal in &message.signals {
        let field = Field::of(network, signal);
        let work = work_type(signal, &field);
        let name = snake(&signal.name);
        let value = match &field {
            Field::Bool => format!("self.{name} as u8"),
            Field::Values(_) => cast(&format!("self.{name}.raw()"), 8, work),
            Field::Quantity(_, integer) => {
                limited(signal, &format!("self.{name}.0"), *integer, work)
            }
            Field::Plain(integer) => limited(signal, &format!("self.{name}"), *integer, work),
        };
        writeln!(out, "        let {name} = {value};")?;
        for piece in signal.pieces() {
            if let Some(byte) = bytes.get_mut(usize::from(piece.byte)) {
                byte.push(byte_of(&name, work, signal, piece));
            }
        }
    }
    let bytes: Vec<String> = bytes
        .into_iter()
        .map(|parts| {
            if parts.is_empty() {
                "0".into()
            } else {
                parts.join(" | ")
            }
        })
        .collect();
    writeln!(out, "        [{}]\n    }}\n", bytes.join(", "))
}

fn frame(out: &mut String, message: &Message) -> std::fmt::Result {
    let length = usize::from(message.length);
    let names: Vec<String> = (0..length).map(|byte| format!("b{byte}")).collect();
    let mut padded = names.clone();
    padded.resize(8, "0".into());
    writeln!(out, "    fn frame(&self) -> Frame {{")?;
    writeln!(out, "        let [{}] = self.encode();", names.join(", "))?;
    writeln!(
        out,
        "        Frame::from_parts(Id::constant::<{}>(), {length}, [{}])\n    }}\n",
        message.id,
        padded.join(", ")
    )
}

/// The raw number of a count, kept within the limits of the signal.
fn limited(signal: &Signal, count: &str, integer: Integer, work: Integer) -> String {
    let (least, greatest) = counts(signal);
    let mut value = count.to_owned();
    if least > integer.least() || greatest < integer.greatest() {
        value = if least <= integer.least() {
            format!("{value}.min({greatest})")
        } else if greatest >= integer.greatest() {
            format!("{value}.max({least})")
        } else {
            format!("{value}.clamp({least}, {greatest})")
        };
    }
    if integer != work {
        value = format!("({value} as {})", work.name());
    }
    match signal.offset_counts().unwrap_or(0) {
        0 => value,
        offset => format!("{value}.wrapping_sub({})", modular(offset, work)),
    }
}

fn cast(value: &str, bits: u8, work: Integer) -> String {
    if bits == work.bits {
        value.to_owned()
    } else {
        format!("{value} as {}", work.name())
    }
}

/// A number in the arithmetic modulo the width of an unsigned type.
fn modular(number: i128, work: Integer) -> String {
    format!("{}_{}", number.rem_euclid(1 << work.bits), work.name())
}

/// A piece of a raw number at its place in its byte.
fn byte_of(name: &str, work: Integer, signal: &Signal, piece: Piece) -> String {
    let mut value = name.to_owned();
    if piece.raw_bit > 0 {
        value = format!("({value} >> {})", piece.raw_bit);
    }
    if work.bits > 8 {
        value = format!("({value} as u8)");
    }
    if piece.bits < 8 && !(signal.size == 1 && work.bits == 8) {
        value = format!("({value} & {:#04x})", (1_u16 << piece.bits) - 1);
    }
    if piece.bit > 0 {
        value = format!("({value} << {})", piece.bit);
    }
    value
}

fn decode(out: &mut String, network: &Network, message: &Message) -> std::fmt::Result {
    let used: Vec<bool> = (0..message.length)
        .map(|byte| {
            let mut pieces = message.signals.iter().flat_map(Signal::pieces);
            pieces.any(|piece| piece.byte == byte)
        })
        .collect();
    let pattern: Vec<String> = used
        .iter()
        .take(usize::from(message.shortest))
        .enumerate()
        .map(|(byte, used)| {
            if *used {
                format!("d{byte}")
            } else {
                "_".into()
            }
        })
        .collect();
    let pattern = pattern.join(", ");
    writeln!(
        out,
        "    fn decode(data: &[u8]) -> Result<Self, DecodeError> {{"
    )?;
    if message.shortest == message.length {
        writeln!(out, "        let &[{pattern}] = data else {{")?;
        writeln!(
            out,
            "            return Err(DecodeError::Length);\n        }};"
        )?;
    } else {
        writeln!(
            out,
            "        let &[{pattern}, ref rest @ ..] = data else {{"
        )?;
        writeln!(
            out,
            "            return Err(DecodeError::Length);\n        }};"
        )?;
        let spare = message.length - message.shortest;
        writeln!(out, "        if rest.len() > {spare} {{")?;
        writeln!(
            out,
            "            return Err(DecodeError::Length);\n        }}"
        )?;
        for byte in message.shortest..message.length {
            if used.get(usize::from(byte)) == Some(&true) {
                let get = match byte - message.shortest {
                    0 => "first()".into(),
                    index => format!("get({index})"),
                };
                writeln!(
                    out,
                    "        let d{byte} = rest.{get}.copied().unwrap_or(0);"
                )?;
            }
        }
    }
    for signal in &message.signals {
        decode_signal(out, network, signal)?;
    }
    let fields: Vec<String> = message.signals.iter().map(|s| snake(&s.name)).collect();
    writeln!(
        out,
        "        Ok(Self {{ {} }})\n    }}\n",
        fields.join(", ")
    )
}

fn decode_signal(out: &mut String, network: &Network, signal: &Signal) -> std::fmt::Result {
    let field = Field::of(network, signal);
    let work = work_type(signal, &field);
    let name = snake(&signal.name);
    let signed = Integer {
        signed: true,
        ..work
    };
    let parts: Vec<String> = signal
        .pieces()
        .into_iter()
        .map(|piece| part(piece, work))
        .collect();
    let mut raw = parts.join(" | ");
    if signal.signed {
        raw = match work.bits - signal.size {
            0 => format!("({raw}) as {}", signed.name()),
            spare => format!("((({raw}) << {spare}) as {}) >> {spare}", signed.name()),
        };
    }
    writeln!(out, "        let {name} = {raw};")?;
    if field == Field::Bool {
        return writeln!(out, "        let {name} = {name} != 0;");
    }
    let error = format!(
        "Err(DecodeError::Range(&Self::{}))",
        screaming(&signal.name)
    );
    if let Field::Values(table) = &field {
        writeln!(
            out,
            "        let Some({name}) = {table}::from_raw({name}) else {{"
        )?;
        return writeln!(out, "            return {error};\n        }};");
    }

    let offset = signal.offset_counts().unwrap_or(0);
    let (least, greatest) = counts(signal);
    let (raw_least, raw_greatest) = signal.raw_range();
    let mut outside = Vec::new();
    if least - offset > raw_least {
        outside.push(format!("{name} < {}", least - offset));
    }
    if greatest - offset < raw_greatest {
        outside.push(format!("{name} > {}", greatest - offset));
    }
    if !outside.is_empty() {
        writeln!(out, "        if {} {{", outside.join(" || "))?;
        writeln!(out, "            return {error};\n        }}")?;
    }
    let mut value = name.clone();
    let mut has = if signal.signed { signed } else { work };
    if offset != 0 {
        if signal.signed {
            value = format!("({value} as {})", work.name());
            has = work;
        }
        value = format!("{value}.wrapping_add({})", modular(offset, work));
    }
    let (open, integer, close) = match &field {
        Field::Quantity(newtype, integer) => (format!("{newtype}("), *integer, ")"),
        Field::Plain(integer) => (String::new(), *integer, ""),
        Field::Bool | Field::Values(_) => return Ok(()),
    };
    if has != integer {
        value = format!("{value} as {}", integer.name());
    }
    if open.is_empty() && value == name {
        return Ok(());
    }
    writeln!(out, "        let {name} = {open}{value}{close};")
}

/// A piece of a byte at its place in the raw number.
fn part(piece: Piece, work: Integer) -> String {
    let mut value = format!("d{}", piece.byte);
    if piece.bit > 0 {
        value = format!("({value} >> {})", piece.bit);
    }
    if piece.bit + piece.bits < 8 {
        value = format!("({value} & {:#04x})", (1_u16 << piece.bits) - 1);
    }
    if work.bits > 8 {
        value = format!("({value} as {})", work.name());
    }
    if piece.raw_bit > 0 {
        value = format!("({value} << {})", piece.raw_bit);
    }
    value
}

fn visit(out: &mut String, network: &Network, message: &Message) -> std::fmt::Result {
    writeln!(
        out,
        "    fn visit(&self, visitor: &mut dyn FnMut(&'static Signal, i64)) {{"
    )?;
    for signal in &message.signals {
        let name = snake(&signal.name);
        let count = match Field::of(network, signal) {
            Field::Bool => format!("i64::from(self.{name})"),
            Field::Values(_) => format!("i64::from(self.{name}.raw())"),
            Field::Quantity(_, integer) => wide(&format!("self.{name}.0"), integer),
            Field::Plain(integer) => wide(&format!("self.{name}"), integer),
        };
        writeln!(
            out,
            "        visitor(&Self::{}, {count});",
            screaming(&signal.name)
        )?;
    }
    writeln!(out, "    }}")
}

fn wide(value: &str, integer: Integer) -> String {
    match (integer.signed, integer.bits) {
        (true, 64) => value.to_owned(),
        (false, 64) => format!("{value} as i64"),
        _ => format!("i64::from({value})"),
    }
}

fn write_any(out: &mut String, network: &Network) -> std::fmt::Result {
    writeln!(
        out,
        "/// Any message of the network, told apart by its identifier."
    )?;
    writeln!(out, "#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]")?;
    writeln!(out, "pub enum AnyMessage {{")?;
    for message in &network.messages {
        writeln!(out, "    /// Identifier {}.", message.id)?;
        writeln!(out, "    {0}({0}),", message.name)?;
    }
    writeln!(out, "}}\n")?;
    writeln!(out, "impl AnyMessage {{")?;
    writeln!(out, "    /// Reads a message of the network.")?;
    writeln!(out, "    ///")?;
    writeln!(out, "    /// # Errors")?;
    writeln!(out, "    ///")?;
    writeln!(
        out,
        "    /// The identifier is none of the network's, or the data are not those of its message."
    )?;
    writeln!(
        out,
        "    pub fn decode(id: u16, data: &[u8]) -> Result<Self, DecodeError> {{"
    )?;
    writeln!(out, "        match id {{")?;
    for message in &network.messages {
        writeln!(
            out,
            "            {1} => {0}::decode(data).map(Self::{0}),",
            message.name, message.id
        )?;
    }
    writeln!(
        out,
        "            _ => Err(DecodeError::Identifier),\n        }}\n    }}\n"
    )?;
    each(
        out,
        network,
        "The identifier.",
        "id(&self) -> u16",
        |name| format!("Self::{name}(_) => {name}::ID"),
    )?;
    each(
        out,
        network,
        "The name in the network file.",
        "name(&self) -> &'static str",
        |name| format!("Self::{name}(_) => {name}::NAME"),
    )?;
    each(
        out,
        network,
        "Shows each signal and its count, as [`Message::visit`] does.",
        "visit(&self, visitor: &mut dyn FnMut(&'static Signal, i64))",
        |name| format!("Self::{name}(message) => message.visit(visitor)"),
    )?;
    writeln!(out, "}}")
}

fn each(
    out: &mut String,
    network: &Network,
    doc: &str,
    signature: &str,
    arm: impl Fn(&str) -> String,
) -> std::fmt::Result {
    writeln!(out, "    /// {doc}")?;
    writeln!(out, "    pub fn {signature} {{\n        match self {{")?;
    for message in &network.messages {
        writeln!(out, "            {},", arm(&message.name))?;
    }
    writeln!(out, "        }}\n    }}\n")
}
