//! A few Thumb instructions, enough to set up peripherals and handle their interrupts.
#![allow(dead_code)] // Each test program uses a part of it.

use std::sync::Arc;
use twin::image::Image;
use twin::mcu::{Board, Mcu};
use twin::part::Part;
use vehicle_model::Vehicle;

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

/// Boards with the devices of a rover, as in the world's tests.
pub(crate) fn vehicle() -> Vehicle {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../firmware/vehicles/uagv");
    let uagv = Vehicle::read(folder.as_ref()).unwrap();
    let network = std::fs::read_to_string(uagv.network_file()).unwrap();
    let manifest = include_str!("../../../world/tests/boards_in_row/vehicle.toml");
    Vehicle::parse("rover", "rover".as_ref(), manifest, &network).unwrap()
}

/// A program as an ELF file with one segment (System V ABI, chapters 4 and 5).
pub(crate) fn elf(program: &Program, part: &'static Part) -> Vec<u8> {
    let flash = program.image(part);
    let flash = flash.flash();
    let mut file = b"\x7FELF\x01\x01\x01\0\0\0\0\0\0\0\0\0".to_vec();
    let word = |file: &mut Vec<u8>, words: &[u32]| {
        file.extend(words.iter().flat_map(|word| word.to_le_bytes()));
    };
    let base = part.flash.base;
    // Executable for ARM; entry; program headers at 52; flags; sizes and counts.
    word(&mut file, &[2 | 40 << 16, 1, base, 52, 0, 0x0500_0000]);
    word(&mut file, &[52 | 32 << 16, 1 | 40 << 16, 0]);
    let size = flash.len() as u32;
    word(&mut file, &[1, 84, base, base, size, size, 5, 4]);
    file.extend(flash);
    file
}
