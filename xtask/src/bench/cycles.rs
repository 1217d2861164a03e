//! Cycles of single events on an emulated core.

use std::{fs::File, io::Read, path::Path, sync::Arc};

use object::{Object, ObjectSymbol};
use twin::{
    image::Image,
    mcu::{Board, Mcu},
    part::Part,
};

use super::{Builder, Error, Parts, Profile};
use crate::Failure;

/// The cost of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cost {
    /// The event.
    pub event: &'static str,
    /// Cycles with 8 windows.
    pub few: u64,
    /// Cycles with 512 windows.
    pub many: u64,
}

/// Events, each with the end of its function's name.
const EVENTS: [(&str, &str); 3] = [
    ("data frame received", "data"),
    ("reference received", "reference"),
    ("own window begins", "window"),
];

/// Events of the bus guardian, each with the end of its function's name.
const GUARDED: [(&str, &str); 8] = [
    ("look, all lines at rest", "rest"),
    ("look, a frame begins", "begin"),
    ("look, within a frame", "follow"),
    ("look, all lines begin", "beginall"),
    ("look, all lines driven", "followall"),
    ("next windows found", "ahead"),
    ("message received", "message"),
    ("reference received", "reference"),
];

/// The program that is measured.
const PROGRAM: &str = "the program `cycles`";
/// Address of the node in RAM.
pub(super) const PLACE: u32 = 0x2000_1000;
/// Address of the loop in which the program waits. Functions return there.
pub(super) const IDLE: u32 = 0x0800_0008;
/// Top of the stack.
const STACK: u32 = 0x2002_0000;
/// Most cycles that an event may take.
pub(super) const BUDGET: u64 = 10_000_000;

/// Measures the events.
///
/// # Errors
///
/// The program does not build, or an event did not happen.
pub fn measure(builder: &Builder, parts: Parts) -> Result<Vec<Cost>, Failure> {
    let elf = builder.program("cycles", parts, Profile::Release)?;
    let image = Image::from_elf(Part::F446, &elf).map_err(|error| Error::Image {
        program: PROGRAM,
        error,
    })?;
    Ok(costs(&elf, &Arc::new(image))?)
}

/// Cycles of the events with few and with many windows.
fn costs(elf: &[u8], image: &Arc<Image>) -> Result<Vec<Cost>, Error> {
    EVENTS
        .into_iter()
        .map(|(event, name)| {
            Ok(Cost {
                event,
                few: cost(elf, image, "few", name)?,
                many: cost(elf, image, "many", name)?,
            })
        })
        .collect()
}

/// Most bytes of a program with another stack; 128 times the flash of the F446 leave room for what helps
/// debuggers.
const LARGEST: u64 = 64 << 20;

/// Measures the events of another stack: of a program for the F446 that has the functions of this one,
/// `prepare_few_data` and so on, and waits at the same address.
///
/// # Errors
///
/// The file cannot be read, or is no such program.
pub fn foreign(path: &Path) -> Result<Vec<Cost>, Failure> {
    let measure = || {
        let mut elf = Vec::new();
        File::open(path)
            .and_then(|file| file.take(LARGEST + 1).read_to_end(&mut elf))
            .map_err(Error::Unreadable)?;
        if elf.len() as u64 > LARGEST {
            return Err(Error::Large { most: LARGEST });
        }
        let image = Image::from_elf(Part::F446, &elf).map_err(Error::NoImage)?;
        costs(&elf, &Arc::new(image))
    };
    Ok(measure().map_err(|error| Error::Elf {
        path: path.to_owned(),
        error: Box::new(error),
    })?)
}

/// Measures the halves of the bus guardian of four senders: events and their cycles.
///
/// # Errors
///
/// The program does not build, or an event did not happen.
pub fn guardian(builder: &Builder) -> Result<Vec<(&'static str, u64)>, Failure> {
    let elf = builder.program("cycles", super::EVERYTHING, Profile::Release)?;
    let image = Image::from_elf(Part::F446, &elf).map_err(|error| Error::Image {
        program: PROGRAM,
        error,
    })?;
    let image = Arc::new(image);
    GUARDED
        .into_iter()
        .map(|(event, name)| Ok((event, cost(&elf, &image, "guardian", name)?)))
        .collect()
}

/// Cycles of an event.
fn cost(elf: &[u8], image: &Arc<Image>, size: &str, event: &str) -> Result<u64, Error> {
    let mut core = Mcu::new(Arc::clone(image), &Board::default(), None);
    if !core.run_to(IDLE, BUDGET) {
        return Err(Error::NoStart { program: PROGRAM });
    }
    call(
        &mut core,
        function(elf, &format!("prepare_{size}_{event}"))?,
    )?;
    let cycles = call(&mut core, function(elf, &format!("run_{size}"))?)?;
    if core.register(0) == 1 {
        Ok(cycles)
    } else {
        Err(Error::NoEvent {
            event: event.into(),
            size: size.into(),
        })
    }
}

/// Calls a function with the node's address. Returns the cycles from its first instruction to
/// its return.
pub(super) fn call(core: &mut Mcu, address: u32) -> Result<u64, Error> {
    core.set_register(0, PLACE);
    core.set_register(13, STACK);
    core.set_register(14, IDLE | 1);
    core.set_register(15, address & !1);
    let begin = core.cycles();
    if core.run_to(IDLE, BUDGET) && !core.is_locked_up() {
        Ok(core.cycles() - begin)
    } else {
        Err(Error::NoReturn { address })
    }
}

pub(super) fn function(elf: &[u8], name: &str) -> Result<u32, Error> {
    let missing = || Error::NoFunction { name: name.into() };
    let file = object::File::parse(elf).map_err(|_| missing())?;
    let found = file.symbols().find(|symbol| {
        let symbol = symbol.name().unwrap_or_default();
        // In a mangled name of Rust, each part follows its length.
        symbol == name || symbol.contains(&format!("{}{name}", name.len()))
    });
    found
        .map(|symbol| symbol.address() as u32)
        .ok_or_else(missing)
}
