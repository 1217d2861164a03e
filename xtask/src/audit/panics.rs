//! Finds panics that are reachable and texts of panics that are in the image.

use wcet::{graph::is_panic, image::Image};

use super::calls::Calls;

/// Where an accepted panic is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Written in a source file whose path holds this.
    Source(&'static str),
    /// In the function of this name.
    Function(&'static str),
}

/// A panic that an image may contain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Allowed {
    /// Where it is.
    pub place: Place,
    /// Why it may stay.
    pub reason: &'static str,
}

/// The panics that a node's program may contain. Each has the same effect: the actuator is
/// stopped, the cause is recorded, the node resets.
pub const ALLOWED: [Allowed; 6] = [
    Allowed {
        place: Place::Function("HardFault"),
        reason: "a bus fault, an undefined instruction, an overflow of the stack",
    },
    Allowed {
        place: Place::Function("DefaultHandler"),
        reason: "an interrupt that no task is bound to",
    },
    Allowed {
        place: Place::Function("NonMaskableInt"),
        reason: "the external clock failed",
    },
    Allowed {
        place: Place::Function("PVD"),
        reason: "the supply is too low for the core's clock",
    },
    Allowed {
        place: Place::Function("Reset"),
        reason: "traps behind `main`, which does not return",
    },
    Allowed {
        place: Place::Source("defmt-rtt"),
        reason: "the logger refuses to be entered again by the task that is in it: only the start and the console task log, numbers only, and no number logs",
    },
];

/// Functions that only the formatting of panics uses.
const FORMATTING: [&str; 4] = [
    "core::fmt::",
    "core::num::fmt::",
    "core::str::count",
    "<core::panic::",
];

/// Parts of panic messages. Each message also contains a place in a source file.
const MESSAGES: [&[u8]; 7] = [
    b".rs",
    b"panicked",
    b"index out of bounds",
    b"called `",
    b"attempt to ",
    b"out of range for",
    b"unreachable code",
];

/// Findings in an image, one sentence each.
pub(super) fn complaints(image: &Image, calls: &Calls) -> Vec<String> {
    let mut complaints = Vec::new();
    for (function, body) in calls.bodies() {
        let name = image.name(function);
        if ends_program(&name) {
            continue;
        }
        let panics = body.calls.iter().filter_map(|call| {
            let callee = image.name(call.callee?);
            ends_program(&callee).then_some((call.at, format!("may call {callee}")))
        });
        let traps = body.traps.iter().map(|&at| (at, "may trap".to_owned()));
        for (at, what) in panics.chain(traps) {
            if !is_allowed(image, &name, at) {
                complaints.push(format!("{} {what}", image.describe(at)));
            }
        }
    }
    let formatting = image
        .functions()
        .find(|(_, function)| FORMATTING.iter().any(|part| function.name.contains(part)));
    if let Some((_, function)) = formatting {
        complaints.push(format!(
            "it holds the formatting of messages: {}",
            function.name
        ));
    }
    for (start, bytes) in image.contents() {
        if let Some((at, text)) = message(bytes) {
            complaints.push(format!(
                "it holds the message of a panic at {:#010x}: {text:?}",
                start + at as u32
            ));
        }
    }
    complaints
}

/// True for a function that panics, and for one that every panic calls.
fn ends_program(name: &str) -> bool {
    is_panic(name) || name.contains("rust_begin_unwind")
}

fn is_allowed(image: &Image, function: &str, at: u32) -> bool {
    let places = image.places(at);
    ALLOWED.iter().any(|allowed| match allowed.place {
        Place::Function(name) => function == name,
        Place::Source(part) => places.iter().any(|place| place.file.contains(part)),
    })
}

/// The first panic text in the constants, and its address.
fn message(bytes: &[u8]) -> Option<(usize, String)> {
    let printable = |byte: u8| (0x20..0x7F).contains(&byte);
    let mut from = 0;
    for run in bytes.split_inclusive(|&byte| !printable(byte)) {
        let holds = |part: &&[u8]| run.windows(part.len()).any(|window| window == *part);
        // Code can look like three letters by chance, but not with eight more beside them.
        if run.len() > 8 && MESSAGES.iter().any(holds) {
            return Some((from, String::from_utf8_lossy(run).trim_end().to_owned()));
        }
        from += run.len();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::message;

    #[test]
    fn messages_are_told_from_other_text() {
        let found = |text: &[u8]| message(text).map(|(at, _)| at);
        assert_eq!(found(b"\x01\x02src/pilot.rs\x00"), Some(2));
        assert_eq!(found(b"\x00attempt to divide by zero\x00"), Some(1));
        assert_eq!(found(b"no fix\x00out of schedule\x00"), None);
        assert_eq!(found(b"\xF0\xB5.rs\x00\x01"), None);
    }
}
