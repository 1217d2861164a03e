//! A few Thumb instructions, enough to set up peripherals and handle their interrupts.
#![allow(dead_code)] // Each test program uses a part of it.

use std::sync::Arc;
use twin::image::Image;
use twin::mcu::{Board, Mcu};
use twin::part::Part;

/// Writes Thumb instructions behind a vector table (ARMv7-M architecture manual A7.7).
pub(crate) struct Program {
    code: Vec<u8>,
}

/// Entries of the vector table.
pub(crate) const VECTORS: usize = 112;

impl Program {
    /// An empty program: all vectors lead to an endless loop, which the program's code follows.
    pub(crate) fn new() -> Self {
        let mut program = Self {
            code: vec![0; VECTORS * 4],
        };
        program.half(0xE7FE);
        for vector in 2..VECTORS {
            program.vector(vector, VECTORS * 4);
        }
        let stack = 0x2000_2000_u32;
        program.code[..4].copy_from_slice(&stack.to_le_bytes());
        let start = program.here();
        program.vector(1, start);
        program
    }

    /// Offset of the next instruction.
    pub(crate) fn here(&self) -> usize {
        self.code.len()
    }

    fn vector(&mut self, number: usize, offset: usize) {
        let address = 0x0800_0001 + offset as u32;
        self.code[4 * number..4 * number + 4].copy_from_slice(&address.to_le_bytes());
    }

    /// The handler of an exception begins here.
    pub(crate) fn handler(&mut self, number: usize) {
        let here = self.here();
        self.vector(number, here);
    }

    /// Appends a halfword.
    pub(crate) fn half(&mut self, instruction: u16) -> &mut Self {
        self.code.extend(instruction.to_le_bytes());
        self
    }

    /// MOVW and MOVT.
    pub(crate) fn constant(&mut self, register: u16, value: u32) -> &mut Self {
        for (opcode, half) in [(0xF240, value & 0xFFFF), (0xF2C0, value >> 16)] {
            let half = half as u16;
            self.half(opcode | (half >> 11 & 1) << 10 | half >> 12);
            self.half((half >> 8 & 7) << 12 | register << 8 | half & 0xFF);
        }
        self
    }

    /// Stores a constant; uses r0 and r1.
    pub(crate) fn poke(&mut self, address: u32, value: u32) -> &mut Self {
        // STR r1, [r0]
        self.constant(0, address).constant(1, value).half(0x6001)
    }

    /// Enables clocks in RCC and waits until the peripherals can be used; uses r0 and r1.
    pub(crate) fn open(&mut self, enable: u32, bits: u32) -> &mut Self {
        self.poke(enable, bits).wait_cycles(16)
    }

    /// NOPs of one cycle each.
    pub(crate) fn wait_cycles(&mut self, count: usize) -> &mut Self {
        for _ in 0..count {
            self.half(0xBF00);
        }
        self
    }

    /// Loads a word into r2; uses r0.
    pub(crate) fn peek(&mut self, address: u32) -> &mut Self {
        // LDR r2, [r0]
        self.constant(0, address).half(0x6802)
    }

    /// Loads until all bits of `mask` are set in the word; uses r0 to r3.
    pub(crate) fn wait(&mut self, address: u32, mask: u32) -> &mut Self {
        self.constant(0, address).constant(3, mask);
        // loop: LDR r2, [r0]; ANDS r2, r3; CMP r2, r3; BNE loop
        self.half(0x6802).half(0x401A).half(0x429A).half(0xD1FB)
    }

    /// Enables an interrupt in the NVIC.
    pub(crate) fn enable(&mut self, irq: u32) -> &mut Self {
        self.poke(0xE000_E100 + 4 * (irq / 32), 1 << (irq % 32))
    }

    /// Loads until no bit of `mask` is set in the word; uses r0 to r3.
    pub(crate) fn wait_clear(&mut self, address: u32, mask: u32) -> &mut Self {
        self.constant(0, address).constant(3, mask);
        // loop: LDR r2, [r0]; TST r2, r3; BNE loop
        self.half(0x6802).half(0x421A).half(0xD1FC)
    }

    /// Sleeps between interrupts.
    pub(crate) fn sleep_for_ever(&mut self) -> &mut Self {
        // loop: WFI; B loop
        self.half(0xBF30).half(0xE7FD)
    }

    /// The end of a handler.
    pub(crate) fn return_from_handler(&mut self) -> &mut Self {
        // BX LR
        self.half(0x4770)
    }

    /// The program in the flash of a part.
    pub(crate) fn image(&self, part: &'static Part) -> Arc<Image> {
        Arc::new(Image::from_code(part, &self.code).expect("the program fits"))
    }

    /// A microcontroller without a network that runs the program.
    pub(crate) fn start(&self, part: &'static Part, board: &Board) -> Mcu {
        Mcu::new(self.image(part), board, None)
    }
}
