//! A debugger on a microcontroller, as far as a program that is tested notices it: it answers the
//! semihosting calls of `embedded-test` (Arm, "Semihosting for AArch32 and AArch64", 2025Q1).
//!
//! A call is `BKPT 0xAB` with the operation in r0 and its parameter in r1. The debugger halts the
//! core, answers in r0 and lets it continue behind the instruction.

use crate::mcu::Mcu;

/// The instruction `BKPT 0xAB`.
pub(crate) const CALL: u16 = 0xBEAB;

/// Debug halting control and status register, and its bit C_DEBUGEN (ARMv7-M manual C1.6.2).
pub(crate) const CONTROL: u32 = 0xE000_EDF0;
pub(crate) const ENABLED: u32 = 1 << 0;

/// Target, base and offset of an instruction `LDR Rt, [Rn, #offset]` (encoding T1, ARMv7-M manual
/// A7.7.43).
pub(crate) fn load(code: u16) -> Option<(u8, u8, u32)> {
    let register = |shift: u32| (code >> shift & 7) as u8;
    let offset = 4 * u32::from(code >> 6 & 0x1F);
    (code >> 11 == 0b01101).then_some((register(0), register(3), offset))
}

const GET_COMMAND_LINE: u32 = 0x15;
const EXIT: u32 = 0x18;
const EXIT_EXTENDED: u32 = 0x20;
/// The reason of an orderly end (ADP_Stopped_ApplicationExit).
const APPLICATION_EXIT: u32 = 0x2_0026;
/// What r0 holds after a call that failed.
const FAILED: u32 = u32::MAX;

/// How a program under the debugger ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ended {
    /// It said so, with this status; 0 is success.
    Exit(u32),
    /// It asked for its command line a second time: it has started again.
    Restarted,
    /// It made a call that no test makes.
    Unknown {
        /// The operation.
        operation: u32,
    },
}

/// The debugger's side of a program's run.
#[derive(Clone, Debug)]
pub(crate) struct Debugger {
    command_line: String,
    served: bool,
    pub(crate) ended: Option<Ended>,
}

impl Debugger {
    pub(crate) fn new(command_line: &str) -> Self {
        Self {
            command_line: command_line.to_owned(),
            served: false,
            ended: None,
        }
    }

    /// Answers a call; the result is for r0. The core stays halted once the program has ended.
    pub(crate) fn answer(&mut self, mcu: &mut Mcu, operation: u32, parameter: u32) -> u32 {
        match operation {
            GET_COMMAND_LINE if self.served => {
                self.ended = Some(Ended::Restarted);
                FAILED
            }
            GET_COMMAND_LINE => {
                self.served = true;
                match self.write_command_line(mcu, parameter) {
                    Some(()) => 0,
                    None => FAILED,
                }
            }
            EXIT => {
                let status = u32::from(parameter != APPLICATION_EXIT);
                self.ended = Some(Ended::Exit(status));
                0
            }
            EXIT_EXTENDED => {
                let reason = word(mcu, parameter);
                let status = match (reason, word(mcu, parameter.wrapping_add(4))) {
                    (Some(APPLICATION_EXIT), Some(status)) => status,
                    _ => 1,
                };
                self.ended = Some(Ended::Exit(status));
                0
            }
            operation => {
                self.ended = Some(Ended::Unknown { operation });
                FAILED
            }
        }
    }

    /// Writes the command line where the program wants it: the parameter points to the address of a
    /// buffer and the size of it, which becomes the length of the text.
    fn write_command_line(&self, mcu: &mut Mcu, block: u32) -> Option<()> {
        let buffer = word(mcu, block)?;
        let size = word(mcu, block.wrapping_add(4))?;
        let length = u32::try_from(self.command_line.len()).ok()?;
        let mut text = self.command_line.clone().into_bytes();
        text.push(0);
        let fits = length < size && mcu.set_memory(buffer, &text);
        (fits && mcu.set_memory(block.wrapping_add(4), &length.to_le_bytes())).then_some(())
    }
}

fn word(mcu: &Mcu, address: u32) -> Option<u32> {
    let bytes = mcu.memory(address, 4)?;
    Some(u32::from_le_bytes(bytes.try_into().ok()?))
}
