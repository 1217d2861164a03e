//! Clock frequencies within the limits of the part, at every instant.
//!
//! - The flash needs enough wait states for the core's clock (RM0390 3.4.1, RM0316 4.5.1): they are
//!   raised before the clock, and lowered after it. The F446 needs more of them below 2.7 V; the
//!   model takes those of its lowest supply there.
//! - No bus exceeds its limit (RM0390 6.2, RM0316 9.2). A prescaler takes up to 16 AHB cycles to
//!   take effect (RM0390 6.3.3), so it is written earlier than the clock is switched.
//! - The PLL's input, its oscillator and its output stay in their ranges (RM0390 6.3.2, data sheets).
//! - On the F446 the core's voltage suits its clock: voltage scale and over-drive (RM0390 5.1.3 and
//!   5.1.4).
//! - The converter's clock is within its range (data sheets).

use crate::clock::Cycles;
use crate::part::{Family, Part};

/// Cycles that a new prescaler may take until it divides (RM0390 6.3.3).
pub(crate) const PRESCALER: Cycles = 16;

const RCC_F446: u32 = 0x4002_3800;
const RCC_F303: u32 = 0x4002_1000;
const PWR_CR: u32 = 0x4000_7000;

/// A rule that the present state breaks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Breach {
    /// The register that decides it.
    pub address: u32,
    pub what: String,
    pub document: &'static str,
}

/// The dividers of the buses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Prescalers {
    /// Of the AHB clock, from the system clock.
    pub ahb: u64,
    /// Of the peripheral buses, from AHB.
    pub apb1: u64,
    pub apb2: u64,
}

impl Prescalers {
    /// For each bus the smaller divider of the two settings. While a change takes effect, the bus
    /// may run with either.
    pub(crate) fn least(self, other: Self) -> Self {
        Self {
            ahb: self.ahb.min(other.ahb),
            apb1: self.apb1.min(other.apb1),
            apb2: self.apb2.min(other.apb2),
        }
    }
}

/// The settings that decide which frequencies occur.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Settings {
    /// System clock, Hz.
    pub system: u64,
    /// Dividers in force, in the worst case.
    pub prescalers: Prescalers,
    /// RCC_CR.
    pub cr: u32,
    /// RCC_PLLCFGR of the F446; RCC_CFGR and RCC_CFGR2 of the F303.
    pub pll: [u32; 2],
    /// External clock, Hz.
    pub external: u64,
    /// FLASH_ACR.
    pub flash: u32,
    /// Supply, mV.
    pub supply: u16,
    /// PWR_CR of the F446.
    pub power: u32,
    /// The F446's over-drive switching is ready.
    pub overdriven: bool,
    /// AHB cycles in a cycle of the converter's clock, while it is enabled.
    pub converter: Option<u64>,
}

/// Frequency in MHz, for a message.
fn mhz(hz: u64) -> String {
    let text = format!("{:.3}", hz as f64 * 1e-6);
    format!("{} MHz", text.trim_end_matches('0').trim_end_matches('.'))
}

fn breach(address: u32, what: String, document: &'static str) -> Breach {
    Breach {
        address,
        what,
        document,
    }
}

/// The rules that the settings break.
pub(crate) fn check(part: &Part, settings: &Settings) -> Vec<Breach> {
    let mut found = Vec::new();
    let core = settings.system / settings.prescalers.ahb.max(1);
    flash(part, settings, core, &mut found);
    buses(part, settings, core, &mut found);
    converter(part, settings, core, &mut found);
    match part.family {
        Family::F4 => {
            if settings.cr & 1 << 24 != 0 {
                pll_f446(part, settings, &mut found);
            }
            voltage(settings, core, &mut found);
        }
        Family::F3 => {
            if settings.cr & 1 << 24 != 0 {
                pll_f303(part, settings, &mut found);
            }
        }
    }
    found
}

fn flash(part: &Part, settings: &Settings, core: u64, found: &mut Vec<Breach>) {
    let (address, states, document) = match part.family {
        Family::F4 => (0x4002_3C00, settings.flash & 0xF, "RM0390 3.4.1, table 5"),
        Family::F3 => (0x4002_2000, settings.flash & 7, "RM0316 4.5.1"),
    };
    let access = part.flash_access;
    let Some(&rated) = access.limits_hz.get(states as usize) else {
        return;
    };
    let (limit, at) = if settings.supply < access.rated_mv {
        let weak = access.weak_step_hz * (states + 1);
        let volts = f64::from(settings.supply) * 1e-3;
        (rated.min(weak), format!(" at {volts:.2} V"))
    } else {
        (rated, String::new())
    };
    if core > u64::from(limit) {
        found.push(breach(
            address,
            format!(
                "{states} wait states of the flash at a core clock of {}{at}, enough up to {}",
                mhz(core),
                mhz(limit.into())
            ),
            document,
        ));
    }
}

fn buses(part: &Part, settings: &Settings, core: u64, found: &mut Vec<Breach>) {
    let (address, document) = match part.family {
        Family::F4 => (RCC_F446 + 0x08, "RM0390 6.2 and 6.3.3"),
        Family::F3 => (RCC_F303 + 0x04, "RM0316 9.2 and 9.4.2"),
    };
    let limits = part.limits;
    let Prescalers { apb1, apb2, .. } = settings.prescalers;
    for (bus, hz, limit) in [
        ("AHB", core, limits.core),
        ("APB1", core / apb1.max(1), limits.apb1),
        ("APB2", core / apb2.max(1), limits.apb2),
    ] {
        if hz > u64::from(limit) {
            let limit = mhz(limit.into());
            let what = format!("{bus} can run at {}, at most {limit} allowed", mhz(hz));
            found.push(breach(address, what, document));
        }
    }
}

fn range(
    found: &mut Vec<Breach>,
    address: u32,
    name: &str,
    hz: u64,
    limits: (u64, u64),
    document: &'static str,
) {
    let (low, high) = limits;
    if hz < low || hz > high {
        let what = format!("{name} {}, allowed {} to {}", mhz(hz), mhz(low), mhz(high));
        found.push(breach(address, what, document));
    }
}

const MHZ: u64 = 1_000_000;

fn pll_f446(part: &Part, settings: &Settings, found: &mut Vec<Breach>) {
    const DOCUMENT: &str = "RM0390 6.3.2";
    let address = RCC_F446 + 0x04;
    let [pll, _] = settings.pll;
    let m = u64::from(pll & 0x3F);
    let n = u64::from(pll >> 6 & 0x1FF);
    let p = 2 * (u64::from(pll >> 16 & 3) + 1);
    let q = pll >> 24 & 0xF;
    let r = pll >> 28 & 7;
    if m < 2 || !(50..=432).contains(&n) || q < 2 || r < 2 {
        let what = format!("PLL with M {m}, N {n}, Q {q}, R {r}; M, Q and R from 2, N 50 to 432");
        found.push(breach(address, what, DOCUMENT));
        return;
    }
    let source = if pll & 1 << 22 != 0 {
        settings.external
    } else {
        u64::from(part.hsi.hz)
    };
    if source == 0 {
        // Nothing comes in, so the PLL does not lock.
        return;
    }
    let vco = source * n / m;
    let mut within = |name, hz, limits| range(found, address, name, hz, limits, DOCUMENT);
    within("PLL input", source / m, (MHZ, 2 * MHZ));
    within("PLL oscillator", vco, (100 * MHZ, 432 * MHZ));
    within("PLL output", vco / p, (0, 180 * MHZ));
}

fn pll_f303(part: &Part, settings: &Settings, found: &mut Vec<Breach>) {
    const DOCUMENT: &str = "DS9866 6.3.9, PLL characteristics";
    let address = RCC_F303 + 0x04;
    let [cfgr, cfgr2] = settings.pll;
    let factor = (u64::from(cfgr >> 18 & 0xF) + 2).min(16);
    let input = if cfgr & 1 << 16 != 0 {
        settings.external / (u64::from(cfgr2 & 0xF) + 1)
    } else {
        u64::from(part.hsi.hz) / 2
    };
    if input == 0 {
        return;
    }
    let mut within = |name, hz, limits| range(found, address, name, hz, limits, DOCUMENT);
    within("PLL input", input, (MHZ, 24 * MHZ));
    within("PLL output", input * factor, (16 * MHZ, 72 * MHZ));
}

/// The core's clock that the voltage allows. While the PLL is off, scale 3 is in force whatever
/// VOS says.
fn voltage(settings: &Settings, core: u64, found: &mut Vec<Breach>) {
    let scale = match settings.power >> 14 & 3 {
        _ if settings.cr & 1 << 24 == 0 => 3,
        0b11 => 1,
        0b10 => 2,
        _ => 3,
    };
    let limit = match (scale, settings.overdriven) {
        (1, true) => 180,
        (1, false) | (2, true) => 168,
        (2, false) => 144,
        _ => 120,
    };
    if core > limit * MHZ {
        let drive = if settings.overdriven {
            "with"
        } else {
            "without"
        };
        let what = format!(
            "voltage scale {scale} {drive} over-drive at a core clock of {}, enough up to {limit} MHz",
            mhz(core)
        );
        found.push(breach(PWR_CR, what, "RM0390 5.1.3 and 5.1.4"));
    }
}

fn converter(part: &Part, settings: &Settings, core: u64, found: &mut Vec<Breach>) {
    let Some(divider) = settings.converter else {
        return;
    };
    let hz = core / divider.max(1);
    let (address, limits, document) = match part.family {
        Family::F4 => (
            0x4001_2304,
            (600_000, 36 * MHZ),
            "DS10693 6.3.24, ADC characteristics",
        ),
        Family::F3 => (
            0x5000_0308,
            (140_000, 72 * MHZ),
            "DS9866 6.3.18, ADC characteristics",
        ),
    };
    range(found, address, "converter clock", hz, limits, document);
}

#[cfg(test)]
mod tests {
    use super::{Prescalers, Settings, check};
    use crate::part::Part;

    /// The F446 at 180 MHz, as its sled runs it.
    fn f446() -> Settings {
        Settings {
            system: 180_000_000,
            prescalers: Prescalers {
                ahb: 1,
                apb1: 4,
                apb2: 2,
            },
            cr: 1 << 24,
            pll: [4 | 180 << 6 | 1 << 22 | 8 << 24 | 2 << 28, 0],
            external: 8_000_000,
            flash: 5,
            supply: 3_300,
            power: 0xC000,
            overdriven: true,
            converter: Some(8),
        }
    }

    /// The F303 at 72 MHz, as its sled runs it.
    fn f303() -> Settings {
        Settings {
            system: 72_000_000,
            prescalers: Prescalers {
                ahb: 1,
                apb1: 2,
                apb2: 1,
            },
            cr: 1 << 24,
            pll: [7 << 18 | 1 << 16, 0],
            external: 8_000_000,
            flash: 2,
            supply: 3_300,
            power: 0,
            overdriven: false,
            converter: Some(2),
        }
    }

    fn one(part: &Part, settings: &Settings) -> String {
        let found = check(part, settings);
        let [breach] = &found[..] else {
            panic!("one breach: {found:?}");
        };
        breach.what.clone()
    }

    #[test]
    fn the_sleds_clocks_are_within_all_limits() {
        assert_eq!(check(Part::F446, &f446()), []);
        assert_eq!(check(Part::F303, &f303()), []);
    }

    #[test]
    fn too_few_wait_states_are_found() {
        let slow = Settings { flash: 4, ..f446() };
        assert!(one(Part::F446, &slow).starts_with("4 wait states"));
        let none = Settings { flash: 0, ..f303() };
        assert!(one(Part::F303, &none).contains("72 MHz, enough up to 24 MHz"));
    }

    #[test]
    fn a_low_supply_needs_more_wait_states_or_a_slower_clock() {
        let low = |supply| Settings { supply, ..f446() };
        assert_eq!(check(Part::F446, &low(2_700)), []);
        let text = one(Part::F446, &low(2_690));
        assert!(
            text.ends_with("180 MHz at 2.69 V, enough up to 120 MHz"),
            "{text}"
        );
        let slow = Settings {
            system: 16_000_000,
            flash: 0,
            converter: None,
            ..low(1_800)
        };
        assert_eq!(check(Part::F446, &slow), []);
        let low = Settings {
            supply: 1_900,
            ..f303()
        };
        assert_eq!(check(Part::F303, &low), []);
    }

    #[test]
    fn each_bus_has_its_limit() {
        let with = |apb1, apb2| Prescalers { ahb: 1, apb1, apb2 };
        let fast = Settings {
            prescalers: with(2, 2),
            ..f446()
        };
        assert!(one(Part::F446, &fast).starts_with("APB1 can run at 90 MHz"));
        let fast = Settings {
            prescalers: with(4, 1),
            converter: None,
            ..f446()
        };
        assert!(one(Part::F446, &fast).starts_with("APB2 can run at 180 MHz"));
        let fast = Settings {
            prescalers: with(1, 1),
            ..f303()
        };
        assert!(one(Part::F303, &fast).starts_with("APB1 can run at 72 MHz"));
    }

    #[test]
    fn the_pll_has_its_ranges() {
        let pll = |m: u32, n: u32, p: u32| Settings {
            pll: [m | n << 6 | p << 16 | 1 << 22 | 8 << 24 | 2 << 28, 0],
            ..f446()
        };
        assert!(one(Part::F446, &pll(3, 135, 0)).starts_with("PLL input 2.667 MHz"));
        assert!(one(Part::F446, &pll(4, 217, 1)).starts_with("PLL oscillator 434 MHz"));
        assert!(one(Part::F446, &pll(4, 182, 0)).starts_with("PLL output 182 MHz"));
        assert!(one(Part::F446, &pll(1, 60, 0)).starts_with("PLL with M 1"));
        let times = |factor: u32| Settings {
            pll: [(factor - 2) << 18 | 1 << 16, 0],
            ..f303()
        };
        assert!(one(Part::F303, &times(10)).starts_with("PLL output 80 MHz"));
        let divided = Settings {
            pll: [7 << 18 | 1 << 16, 9],
            ..f303()
        };
        let found = check(Part::F303, &divided);
        assert_eq!(found.len(), 2, "input and output: {found:?}");
    }

    #[test]
    fn the_voltage_suits_the_clock() {
        let plain = Settings {
            overdriven: false,
            ..f446()
        };
        assert!(one(Part::F446, &plain).ends_with("enough up to 168 MHz"));
        let low = Settings {
            power: 0x4000,
            ..f446()
        };
        assert!(one(Part::F446, &low).starts_with("voltage scale 3 with over-drive"));
    }

    #[test]
    fn the_converter_has_its_range() {
        let fast = Settings {
            converter: Some(4),
            ..f446()
        };
        assert!(one(Part::F446, &fast).starts_with("converter clock 45 MHz"));
    }
}
