//! Microcontrollers as data: one TOML file for each, those of common ones in the command itself.
//!
//! A file says what the part's manual says, and `source` says where. `assumes` is a sentence for the report
//! about what must hold beside that.

use std::path::Path;

use serde::Deserialize;

use wcet::part::{Areas, Core, Part, bus_waits};

use crate::error::{Error, read};

/// The parts that come with the command: name and file.
const SHIPPED: [(&str, &str); 16] = [
    ("lm3s6965", include_str!("../parts/lm3s6965.toml")),
    ("nrf52832", include_str!("../parts/nrf52832.toml")),
    ("nrf52833", include_str!("../parts/nrf52833.toml")),
    ("nrf52840", include_str!("../parts/nrf52840.toml")),
    ("rp2040", include_str!("../parts/rp2040.toml")),
    ("rp2350", include_str!("../parts/rp2350.toml")),
    ("stm32f0", include_str!("../parts/stm32f0.toml")),
    ("stm32f1", include_str!("../parts/stm32f1.toml")),
    ("stm32f303", include_str!("../parts/stm32f303.toml")),
    ("stm32f401", include_str!("../parts/stm32f401.toml")),
    ("stm32f407", include_str!("../parts/stm32f407.toml")),
    ("stm32f411", include_str!("../parts/stm32f411.toml")),
    ("stm32f446", include_str!("../parts/stm32f446.toml")),
    ("stm32g0", include_str!("../parts/stm32g0.toml")),
    ("stm32g4", include_str!("../parts/stm32g4.toml")),
    ("stm32l4", include_str!("../parts/stm32l4.toml")),
];

/// Cores that are not analysed, and why.
const REFUSED: [(&str, &str); 5] = [
    (
        "cortex-m33",
        "Arm publishes no cycle counts of its instructions, so no bound could be held against a manual",
    ),
    (
        "cortex-m23",
        "Arm publishes no cycle counts of its instructions, so no bound could be held against a manual",
    ),
    (
        "cortex-m7",
        "it issues two instructions at a time through caches, which the analysis does not follow",
    ),
    (
        "cortex-m55",
        "it issues two instructions at a time through caches, which the analysis does not follow",
    ),
    (
        "cortex-m85",
        "it issues two instructions at a time through caches, which the analysis does not follow",
    ),
];

/// A part's file.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartFile {
    /// The maker's name.
    pub title: String,
    /// Its core: `cortex-m0`, `cortex-m0plus`, `cortex-m3` or `cortex-m4`.
    pub core: String,
    /// Bits of a priority that its interrupt controller has.
    pub priority_bits: u8,
    /// Cycles of a multiplication on a Cortex-M0 or Cortex-M0+: 1 or 32.
    #[serde(default = "slowest_multiply")]
    pub multiply_cycles: u8,
    /// Clock of the core after a reset, in Hz.
    pub reset_hz: u32,
    /// Highest clock of the core, in Hz.
    pub highest_hz: u32,
    /// First and last address of a peripheral that has no access to memory and takes any word as data.
    pub inert: Option<(u32, u32)>,
    /// Where the figures are from.
    pub source: String,
    /// What must hold for them beside that.
    pub assumes: Option<String>,
    /// The emulated microcontroller that runs programs for it, if there is one.
    pub emulated: Option<Emulated>,
    /// Memory of code and constants.
    pub flash: FlashFile,
    /// Memory of variables.
    pub ram: RamFile,
    /// Everything else.
    pub peripherals: PeripheralFile,
}

/// The emulated microcontrollers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Emulated {
    /// STM32F446RE.
    Stm32f446,
    /// STM32F303K8.
    Stm32f303,
}

const fn slowest_multiply() -> u8 {
    32
}

/// Memory of code and constants.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlashFile {
    /// First and last address of every place where it appears.
    pub areas: Vec<(u32, u32)>,
    /// Bytes that one read gives and the core has at hand until the next.
    pub line_bytes: u32,
    /// Highest core clock for 0, 1, 2, ... wait states, in Hz; or `waits`.
    #[serde(default)]
    pub limits_hz: Vec<u32>,
    /// Wait states at any clock.
    pub waits: Option<u32>,
    /// What the program may switch on to wait less.
    pub accelerator: Option<AcceleratorFile>,
}

/// What reads the next line of the flash ahead, and keeps lines that were used. It is counted on only if the
/// task table says that the program switches all of it on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AcceleratorFile {
    /// Lines of the cache of instructions, which replaces the line unused for longest; zero without one.
    pub instruction_lines: usize,
    /// The same of the cache of constants.
    pub constant_lines: usize,
}

/// Memory of variables.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RamFile {
    /// First and last address of each.
    pub areas: Vec<(u32, u32)>,
    /// Cycles by which other masters of the bus delay an access at most.
    pub waits: u32,
}

/// Peripherals.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PeripheralFile {
    /// Cycles of an access beyond the first; or `divider`.
    pub waits: Option<u32>,
    /// The most by which a program may divide the core's clock for the slowest bus, which is taken if the
    /// task table does not say that bus's clock.
    pub divider: Option<u32>,
    /// First and last address of peripherals on another bus, whose clock the task table may say.
    #[serde(default)]
    pub fast: Vec<(u32, u32)>,
}

/// The clocks that a program sets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Clocks {
    /// Of the core, in Hz.
    pub core_hz: u32,
    /// Of the slowest bus of peripherals that the program uses, in Hz.
    pub bus_hz: Option<u32>,
    /// Of the bus of the part's `fast` peripherals, in Hz.
    pub fast_bus_hz: Option<u32>,
    /// Wait states of the flash that the program sets, if not the fewest that its clock needs.
    pub flash_waits: Option<u32>,
    /// Whether the program switches on all that the part has to wait less for its flash.
    pub flash_accelerator: bool,
}

/// Most wait states of a flash that are accepted: far more than any part has.
const MOST_WAITS: u32 = 255;

/// The names of the parts that come with the command.
pub fn names() -> impl Iterator<Item = &'static str> {
    SHIPPED.iter().map(|(name, _)| *name)
}

/// The names of those whose programs run on an emulated microcontroller.
#[must_use]
pub fn emulated() -> Vec<&'static str> {
    let known = names().filter(|name| {
        let part = find(name, Path::new("."));
        part.is_ok_and(|part| part.emulated.is_some())
    });
    known.collect()
}

/// Finds a part that comes with the command, or reads the file of this name, from `folder` if the name is
/// relative.
///
/// # Errors
/// There is no such part, or its file is wrong.
pub fn find(name: &str, folder: &Path) -> Result<PartFile, Error> {
    if let Some((_, text)) = SHIPPED.iter().find(|(known, _)| *known == name) {
        return parse(text, name);
    }
    if !name.ends_with(".toml") {
        let known: Vec<&str> = names().collect();
        return Err(Error::input(format!(
            "there is no part {name}: accepted are {}, or the name of a file that ends in .toml",
            known.join(", ")
        )));
    }
    parse(&read(&folder.join(name))?, name)
}

fn parse(text: &str, name: &str) -> Result<PartFile, Error> {
    let wrong = |what: String| Error::input(format!("part {name}: {what}"));
    let file: PartFile = toml::from_str(text).map_err(|error| {
        let line = error.span().map(|span| text[..span.start].lines().count());
        let line = line.map_or_else(String::new, |line| format!("line {}: ", line.max(1)));
        wrong(format!("{line}{}", error.message()))
    })?;
    if !(1..=8).contains(&file.priority_bits) {
        return Err(wrong("`priority_bits` is 1 to 8".to_owned()));
    }
    if !file.flash.line_bytes.is_power_of_two() || file.flash.line_bytes < 4 {
        return Err(wrong("`line_bytes` is 4, 8, 16 or more".to_owned()));
    }
    if ![1, 32].contains(&file.multiply_cycles) {
        return Err(wrong("`multiply_cycles` is 1 or 32".to_owned()));
    }
    if file.flash.waits.is_none() == file.flash.limits_hz.is_empty() {
        return Err(wrong(
            "[flash] needs either `limits_hz` or `waits`".to_owned(),
        ));
    }
    if file.peripherals.waits.is_none() == file.peripherals.divider.is_none() {
        return Err(wrong(
            "[peripherals] needs either `waits` or `divider`".to_owned(),
        ));
    }
    let areas = [&file.flash.areas, &file.ram.areas, &file.peripherals.fast];
    for areas in areas {
        if areas.len() > Areas::MOST || areas.iter().any(|(first, last)| first > last) {
            let most = Areas::MOST;
            return Err(wrong(format!(
                "`areas` are up to {most} pairs of a first and a last address"
            )));
        }
    }
    Ok(file)
}

impl PartFile {
    /// Its core, or why the core is not analysed.
    ///
    /// # Errors
    /// The sentence about the core.
    pub fn core(&self) -> Result<Core, Error> {
        let Self { core, title, .. } = self;
        if let Some((_, why)) = REFUSED.iter().find(|(known, _)| known == core) {
            return Err(Error::input(format!(
                "the {title} has a {core}, which is not analysed: {why}"
            )));
        }
        Core::named(core).ok_or_else(|| {
            let known = Core::ALL.map(Core::name).join(", ");
            Error::input(format!(
                "part {title}: there is no core {core}: accepted are {known}"
            ))
        })
    }

    /// The part on these clocks.
    ///
    /// # Errors
    /// Its core is not analysed, or a clock is out of range.
    pub fn on(&self, clocks: &Clocks) -> Result<Part, Error> {
        let Clocks { core_hz, .. } = *clocks;
        let core = self.core()?;
        let wrong = |what: &str, hz: u32, highest: u32| {
            Error::input(format!(
                "`{what}` = {hz}: 1 to {highest} is accepted for the {}",
                self.title
            ))
        };
        if !(1..=self.highest_hz).contains(&core_hz) {
            return Err(wrong("core_hz", core_hz, self.highest_hz));
        }
        for (what, hz) in [
            ("bus_hz", clocks.bus_hz),
            ("fast_bus_hz", clocks.fast_bus_hz),
        ] {
            if let Some(hz) = hz.filter(|hz| !(1..=core_hz).contains(hz)) {
                return Err(wrong(what, hz, core_hz));
            }
        }
        let bus_waits_of = |hz: Option<u32>| match (hz, self.peripherals.waits) {
            (Some(hz), _) => bus_waits(core_hz, hz),
            (None, Some(waits)) => waits,
            (None, None) => 3 * self.peripherals.divider.unwrap_or(1),
        };
        let slow = bus_waits_of(clocks.bus_hz);
        let accelerator = match (clocks.flash_accelerator, self.flash.accelerator) {
            (false, _) => None,
            (true, Some(accelerator)) => Some(accelerator),
            (true, None) => {
                return Err(Error::input(format!(
                    "`flash_accelerator` = true: the file of the {} describes none; false is accepted",
                    self.title
                )));
            }
        };
        Ok(Part {
            core,
            core_hz,
            priority_bits: self.priority_bits,
            start_mask: None,
            multiply_cycles: self.multiply_cycles,
            flash: Areas::new(&self.flash.areas),
            flash_waits: self.flash_waits(clocks)?,
            line_bytes: self.flash.line_bytes,
            reads_ahead: accelerator.is_some(),
            instruction_lines: accelerator.map_or(0, |of| of.instruction_lines),
            constant_lines: accelerator.map_or(0, |of| of.constant_lines),
            ram: Areas::new(&self.ram.areas),
            ram_waits: self.ram.waits,
            peripheral_waits: slow,
            fast_peripherals: Areas::new(&self.peripherals.fast),
            fast_waits: clocks.fast_bus_hz.map_or(slow, |hz| bus_waits(core_hz, hz)),
            inert: self.inert,
        })
    }

    fn flash_waits(&self, clocks: &Clocks) -> Result<u32, Error> {
        let limits = &self.flash.limits_hz;
        let fewest = limits.iter().position(|limit| clocks.core_hz <= *limit);
        let least = match (self.flash.waits, fewest) {
            (Some(_), _) => 0,
            (None, Some(waits)) => waits as u32,
            (None, None) => {
                return Err(Error::input(format!(
                    "part {}: `limits_hz` does not reach {} Hz",
                    self.title, clocks.core_hz
                )));
            }
        };
        match clocks.flash_waits {
            Some(waits) if waits < least => Err(Error::input(format!(
                "`flash_waits` = {waits}: the {} needs {least} or more at {} Hz",
                self.title, clocks.core_hz
            ))),
            Some(waits) if waits > MOST_WAITS => Err(Error::input(format!(
                "`flash_waits` = {waits}: {least} to {MOST_WAITS} is accepted for the {}",
                self.title
            ))),
            Some(waits) => Ok(waits),
            None => Ok(self.flash.waits.unwrap_or(least)),
        }
    }
}

/// The list of the parts, as text.
#[must_use]
pub fn list() -> String {
    let mut text = String::new();
    for (name, file) in SHIPPED {
        let Ok(part) = parse(file, name) else {
            continue;
        };
        let about = match part.core() {
            Ok(core) => format!(
                "{}, up to {} MHz; {}",
                core.name(),
                f64::from(part.highest_hz) / 1e6,
                part.source
            ),
            Err(why) => format!("refused: {why}"),
        };
        text.push_str(&format!("{name:<12}{}: {about}\n", part.title));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::{Clocks, SHIPPED, find, list, parse};
    use std::path::Path;

    #[test]
    fn every_part_is_read_and_has_a_source() {
        for (name, text) in SHIPPED {
            let part = parse(text, name).unwrap();
            assert!(part.source.len() > 20, "{name}");
            let clocks = Clocks {
                core_hz: part.highest_hz,
                ..Clocks::default()
            };
            match part.core() {
                Ok(core) => assert_eq!(part.on(&clocks).unwrap().core, core),
                Err(_) => assert_eq!(name, "rp2350"),
            }
        }
        assert_eq!(list().lines().count(), SHIPPED.len());
    }

    #[test]
    fn wait_states_follow_the_clock() {
        let part = find("stm32f411", Path::new(".")).unwrap();
        let waits = |core_hz, flash_waits| {
            let clocks = Clocks {
                core_hz,
                flash_waits,
                ..Clocks::default()
            };
            part.on(&clocks).map(|part| part.flash_waits)
        };
        assert_eq!(waits(16_000_000, None), Ok(0));
        assert_eq!(waits(64_000_000, None), Ok(1));
        assert_eq!(waits(64_000_001, None), Ok(2));
        assert_eq!(waits(100_000_000, Some(5)), Ok(5));
        let few = waits(100_000_000, Some(2)).unwrap_err().to_string();
        assert_eq!(
            few,
            "`flash_waits` = 2: the STM32F411 needs 3 or more at 100000000 Hz"
        );
        let many = waits(100_000_000, Some(256)).unwrap_err().to_string();
        assert_eq!(
            many,
            "`flash_waits` = 256: 3 to 255 is accepted for the STM32F411"
        );
        let fast = waits(101_000_000, None).unwrap_err().to_string();
        assert_eq!(
            fast,
            "`core_hz` = 101000000: 1 to 100000000 is accepted for the STM32F411"
        );
    }

    #[test]
    fn an_accelerator_is_counted_on_only_where_the_program_switches_it_on() {
        let lines = |part, flash_accelerator| {
            let clocks = Clocks {
                core_hz: 64_000_000,
                flash_accelerator,
                ..Clocks::default()
            };
            let part = find(part, Path::new(".")).unwrap().on(&clocks);
            part.map(|part| {
                let lines = (part.instruction_lines, part.constant_lines);
                (part.reads_ahead, lines)
            })
        };
        assert_eq!(lines("stm32f446", false), Ok((false, (0, 0))));
        assert_eq!(lines("stm32f446", true), Ok((true, (64, 8))));
        assert_eq!(lines("stm32f303", true), Ok((true, (0, 0))));
        assert_eq!(
            lines("nrf52840", true).unwrap_err().to_string(),
            "`flash_accelerator` = true: the file of the nRF52840 describes none; false is accepted"
        );
    }

    #[test]
    fn a_bus_without_a_clock_counts_as_the_slowest() {
        let part = find("stm32f401", Path::new(".")).unwrap();
        let waits = |bus_hz, fast_bus_hz| {
            let clocks = Clocks {
                core_hz: 84_000_000,
                bus_hz,
                fast_bus_hz,
                ..Clocks::default()
            };
            let part = part.on(&clocks).unwrap();
            (part.peripheral_waits, part.fast_waits)
        };
        assert_eq!(waits(None, None), (48, 48));
        assert_eq!(waits(Some(42_000_000), None), (6, 6));
        assert_eq!(waits(Some(42_000_000), Some(84_000_000)), (6, 3));
    }

    #[test]
    fn a_core_without_published_cycles_is_refused() {
        let part = find("rp2350", Path::new(".")).unwrap();
        assert_eq!(
            part.core().unwrap_err().to_string(),
            "the RP2350 has a cortex-m33, which is not analysed: Arm publishes no cycle counts of its \
             instructions, so no bound could be held against a manual"
        );
    }

    #[test]
    fn a_wrong_part_has_its_sentence() {
        let none = find("stm32h7", Path::new(".")).unwrap_err().to_string();
        assert!(
            none.starts_with("there is no part stm32h7: accepted are lm3s6965, "),
            "{none}"
        );
        let text = include_str!("../parts/stm32f1.toml");
        for (from, to, sentence) in [
            (
                "line_bytes = 8",
                "line_bytes = 6",
                "part x: `line_bytes` is 4, 8, 16 or more",
            ),
            (
                "priority_bits = 4",
                "priority_bits = 9",
                "part x: `priority_bits` is 1 to 8",
            ),
            (
                "divider = 16",
                "",
                "part x: [peripherals] needs either `waits` or `divider`",
            ),
            (
                "[flash]",
                "[flash]\nwaits = 1",
                "part x: [flash] needs either `limits_hz` or `waits`",
            ),
        ] {
            let error = parse(&text.replacen(from, to, 1), "x").unwrap_err();
            assert_eq!(error.to_string(), sentence);
        }
    }
}
