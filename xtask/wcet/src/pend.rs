//! Exceptions that a program makes pending by stores to the interrupt controller.
//!
//! These registers do that (Armv7-M Architecture Reference Manual B3.2.4, B3.2.13, B3.2.26, B3.4.5 and C1.6.5): a bit
//! of `ISPR` for an interrupt, the number in `STIR`, three bits of `ICSR` for `NMI`, `PendSV` and
//! `SysTick`, four of `SHCSR` for the faults and `SVCall`, and one of `DEMCR` for `DebugMonitor`. RTIC's `pend` and `spawn`
//! end in one of the first three. The instruction `SVC` makes `SVCall` pending without a store.
//!
//! Every store of a run of the abstract machine is looked at. If its address may be that of such a
//! register, each exception counts that the possible words make pending; if the word is unknown, all
//! of the register count. A store through an unresolved pointer counts as none: such pointers lead to
//! memory ([`UnknownStores`](super::lasting::UnknownStores)).

use super::lasting::FAR;
use super::symbols::Symbols;
use super::value::Value;

/// Interrupt set-pending registers: 32 interrupts each.
const ISPR: std::ops::Range<u32> = 0xe000_e200..0xe000_e240;
/// Interrupt control and state register.
const ICSR: u32 = 0xe000_ed04;
/// Software trigger interrupt register.
const STIR: u32 = 0xe000_ef00;

/// System handler control and state register.
const SHCSR: u32 = 0xe000_ed24;
/// Debug exception and monitor control register.
const DEMCR: u32 = 0xe000_edfc;

/// Bits of `ICSR` that make an exception pending, and its number; of `SHCSR`; of `DEMCR`.
const SYSTEM: [(u32, u16); 3] = [(31, 2), (28, 14), (26, 15)];
const SYSTEM_HANDLERS: [(u32, u16); 4] = [(13, 4), (14, 5), (12, 6), (15, SUPERVISOR_CALL)];
const MONITOR: [(u32, u16); 1] = [(17, 12)];
/// Number of `SVCall`, the exception of the instruction `SVC`.
pub(crate) const SUPERVISOR_CALL: u16 = 11;
/// Number of the first interrupt's exception.
const FIRST_INTERRUPT: u16 = 16;
/// Interrupts that `STIR` can name, at most.
const INTERRUPTS: u16 = 496;

/// Words up to which each that a store may write, and each of its addresses, is looked at.
const FEW: u64 = 512;

/// An exception that a store may make pending.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pend {
    /// Address of the store.
    pub at: u32,
    /// Number of the exception, as in the vector table: interrupt 0 is 16.
    pub exception: u16,
    /// Whether the words that the store may write are known.
    pub exact: bool,
    /// Whether it may run only before a task can.
    pub early: bool,
}

/// The exceptions that a store of the low `size` bytes of `value` to `address` may make pending, and
/// whether the words are known.
pub(crate) fn of_store(
    symbols: &Symbols,
    address: &Value,
    size: u32,
    value: &Value,
) -> Option<(Vec<u16>, bool)> {
    let (low, high) = address.range.unsigned();
    if low > STIR || high < ISPR.start {
        return None;
    }
    let places = words(symbols, address);
    if places.is_none() && high - low >= FAR {
        return None;
    }
    let words = words(symbols, value);
    let mut exceptions = Vec::new();
    for register in ISPR.step_by(4).chain([ICSR, SHCSR, DEMCR, STIR]) {
        let reaches = (register - 3..register + 4).filter(|at| at + size > register);
        let reaches = reaches.filter(|at| match &places {
            Some(places) => places.contains(at),
            None => address.range.contains(*at),
        });
        for at in reaches {
            let lane = 8 * (at.saturating_sub(register));
            match &words {
                Some(words) if at >= register => {
                    let all = words.iter().map(|word| low_bytes(*word, size) << lane);
                    exceptions.extend(all.flat_map(|word| of_word(register, word)));
                }
                _ => exceptions.extend(of_register(register)),
            }
        }
    }
    exceptions.sort_unstable();
    exceptions.dedup();
    (!exceptions.is_empty()).then_some((exceptions, words.is_some()))
}

/// The words that a value may be, if they are few.
pub(crate) fn words(symbols: &Symbols, value: &Value) -> Option<Vec<u32>> {
    symbols
        .elements(value)
        .or_else(|| (value.range.count() <= FEW).then(|| value.range.iter().collect()))
}

fn low_bytes(word: u32, size: u32) -> u32 {
    match size {
        4 => word,
        size => word & ((1 << (8 * size)) - 1),
    }
}

/// Number of the exception of an interrupt.
const fn interrupt(number: u16) -> u16 {
    FIRST_INTERRUPT + number
}

/// The exceptions that `word` makes pending when it is written to `register`.
fn of_word(register: u32, word: u32) -> Vec<u16> {
    let set = |bit: u32| word >> bit & 1 == 1;
    let those_set = |bits: &[(u32, u16)]| {
        let set = bits.iter().filter(|(bit, _)| set(*bit));
        set.map(|(_, exception)| *exception).collect()
    };
    match register {
        ICSR => those_set(&SYSTEM),
        SHCSR => those_set(&SYSTEM_HANDLERS),
        DEMCR => those_set(&MONITOR),
        STIR => vec![interrupt((word & 0x1ff) as u16)],
        _ => {
            let first = 8 * (register - ISPR.start);
            (0..32)
                .filter(|bit| set(*bit))
                .map(|bit| interrupt((first + bit) as u16))
                .collect()
        }
    }
}

/// The exceptions that any word makes pending when it is written to `register`.
fn of_register(register: u32) -> Vec<u16> {
    match register {
        STIR => (0..INTERRUPTS).map(interrupt).collect(),
        _ => of_word(register, u32::MAX),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Variables;
    use crate::range::Range;

    fn symbols() -> Symbols {
        Symbols::new(&Variables::default())
    }

    fn stored(address: u32, value: u32) -> Option<(Vec<u16>, bool)> {
        let (address, value) = (Value::constant(address), Value::constant(value));
        of_store(&symbols(), &address, 4, &value)
    }

    #[test]
    fn known_words_name_their_exceptions() {
        // EXTI1 of the F446 is interrupt 7, USART1 37 (RM0390 table 38).
        assert_eq!(stored(0xe000_e200, 1 << 7), Some((vec![23], true)));
        assert_eq!(stored(0xe000_e204, 1 << 5), Some((vec![53], true)));
        assert_eq!(stored(0xe000_ef00, 7), Some((vec![23], true)));
        assert_eq!(stored(0xe000_ed04, 1 << 28), Some((vec![14], true)));
        assert_eq!(stored(0xe000_ed04, 1 << 26), Some((vec![15], true)));
        assert_eq!(stored(0xe000_ed24, 1 << 15), Some((vec![11], true)));
        assert_eq!(stored(0xe000_edfc, 1 << 17), Some((vec![12], true)));
    }

    #[test]
    fn other_registers_and_clearing_bits_make_nothing_pending() {
        // Enable, clear-pending and priority registers; the bits of ICSR that clear.
        for address in [
            0xe000_e100,
            0xe000_e1fc,
            0xe000_e280,
            0xe000_e400,
            0x2000_0000,
        ] {
            assert_eq!(stored(address, u32::MAX), None, "{address:#x}");
        }
        assert_eq!(stored(0xe000_ed04, 1 << 27 | 1 << 25), None);
        assert_eq!(stored(0xe000_e200, 0), None);
    }

    #[test]
    fn an_unknown_word_may_be_any_interrupt_of_its_register() {
        let at = Value::constant(0xe000_e204);
        let all: Vec<u16> = (48..80).collect();
        assert_eq!(
            of_store(&symbols(), &at, 4, &Value::ANY),
            Some((all, false))
        );
    }

    #[test]
    fn a_register_with_an_unknown_index_may_be_any() {
        // What `NVIC::pend` computes from an unknown number.
        let at = Value::within(Range::between(0xe000_e200, 0xe000_e23f));
        let (all, exact) = of_store(&symbols(), &at, 4, &Value::ANY).unwrap();
        assert_eq!((all.first(), all.last()), (Some(&16), Some(&527)));
        assert!(!exact);
        // Each of two interrupts, by a value that is one of two words.
        let mut symbols = symbols();
        let two = symbols.one_of(vec![1 << 7, 1 << 10]).unwrap();
        let at = Value::constant(0xe000_e200);
        let both = of_store(&symbols, &at, 4, &two);
        assert_eq!(both, Some((vec![23, 26], true)));
    }

    #[test]
    fn a_pointer_to_memory_or_to_the_register_may_reach_it() {
        let mut symbols = symbols();
        let at = symbols.one_of(vec![0x2000_0000, 0xe000_e200]).unwrap();
        let value = Value::constant(1 << 7);
        assert_eq!(of_store(&symbols, &at, 4, &value), Some((vec![23], true)));
    }

    #[test]
    fn a_byte_store_reaches_the_eight_interrupts_of_its_byte() {
        let (at, value) = (Value::constant(0xe000_e201), Value::constant(0xff02));
        assert_eq!(of_store(&symbols(), &at, 1, &value), Some((vec![25], true)));
    }

    #[test]
    fn an_unresolved_pointer_makes_nothing_pending() {
        assert_eq!(of_store(&symbols(), &Value::ANY, 4, &Value::ANY), None);
    }
}
