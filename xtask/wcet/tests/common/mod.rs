//! The kernels, built for the target, and an emulated core to run them on.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, OnceLock};

use rsemu::core::space::{AddressSpace, RamStore, Region};
use rsemu::cpu::arm::v7m::{ArmV7m, Config};
use wcet::image::Image;
use wcet::kernels::{self, INPUT};
use wcet::part::{Areas, Core, Part, STM32_FAST, bus_waits};

const STACK: u32 = 0x2000_8000;
const FLASH: u32 = 0x0800_0000;
const RAM: u32 = 0x2000_0000;
/// Return address of the kernels. There is no code at this address.
const BACK: u32 = 0x0803_fff0;

/// A Cortex-M4 with five wait states of its flash, which loads lines of 16 bytes.
pub(crate) const PART: Part = Part {
    core: Core::CortexM4,
    core_hz: 180_000_000,
    priority_bits: 4,
    start_mask: Some(0x10),
    multiply_cycles: 1,
    flash: Areas::new(&[(0, 0x0fff_ffff), (0x1fff_0000, 0x1fff_ffff)]),
    flash_waits: 5,
    line_bytes: 16,
    reads_ahead: true,
    instruction_lines: 64,
    constant_lines: 8,
    ram: Areas::new(&[(0x2000_0000, 0x2001_ffff)]),
    ram_waits: 1,
    peripheral_waits: bus_waits(180_000_000, 45_000_000),
    fast_peripherals: STM32_FAST,
    fast_waits: bus_waits(180_000_000, 90_000_000),
    inert: None,
};

/// The same memories around a Cortex-M0+.
pub(crate) const SMALL_PART: Part = Part {
    core: Core::CortexM0Plus,
    priority_bits: 2,
    start_mask: None,
    reads_ahead: false,
    instruction_lines: 0,
    constant_lines: 0,
    ..PART
};

/// Builds the kernels for a Cortex-M4 once for all tests of a program.
pub(crate) fn image_path() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| build("thumbv7em-none-eabihf"))
}

/// Builds them for a Cortex-M0+, which has no instruction that divides.
pub(crate) fn small_image_path() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| build("thumbv6m-none-eabi"))
}

fn build(triple: &str) -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR")).join("kernels");
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("kernels");
    let status = Command::new(env!("CARGO"))
        .current_dir(&package)
        .args(["build", "--quiet", "--release", "--target", triple])
        .env("CARGO_TARGET_DIR", &target)
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        .status()
        .expect("cargo runs");
    assert!(status.success(), "the kernels do not build for {triple}");
    target.join(triple).join("release/kernels")
}

/// Address of the kernel with this name.
pub(crate) fn kernel(image: &Image, name: &str) -> u32 {
    kernels::find(image, name).unwrap_or_else(|| panic!("no kernel {name}"))
}

/// A core with the kernels in its flash.
pub(crate) struct Emulator {
    core: ArmV7m,
    ram: Arc<RamStore>,
    clean: Vec<u8>,
}

impl Emulator {
    /// A core after reset, with its floating-point unit on.
    pub(crate) fn new(image: &Image) -> Self {
        let flash = Arc::new(RamStore::new(256 * 1024));
        let ram = Arc::new(RamStore::new(64 * 1024));
        for (address, bytes) in image.contents() {
            if address >= RAM {
                ram.write_at(u64::from(address - RAM), bytes).unwrap();
            } else {
                flash.write_at(u64::from(address - FLASH), bytes).unwrap();
            }
        }
        let space = AddressSpace::new("memory", 32);
        space
            .topology()
            .map(Region::ram("flash", flash), u64::from(FLASH))
            .unwrap();
        space
            .topology()
            .map(Region::ram("ram", Arc::clone(&ram)), u64::from(RAM))
            .unwrap();
        let core = ArmV7m::new(Config::CORTEX_M4F.with_reset_vtor(FLASH));
        core.attach_space(Arc::new(space));
        core.step();
        core.with_sys(|system| system.cpacr = 0x00f0_0000);
        let mut clean = vec![0; 64 * 1024];
        ram.read_at(0, &mut clean).unwrap();
        Self { core, ram, clean }
    }

    /// Calls the function at `entry` with the address of `input`, and returns the cycles that it
    /// took. `see` is called with the address of every instruction.
    pub(crate) fn call(&self, entry: u32, input: &[u32; 64], mut see: impl FnMut(u32)) -> u64 {
        self.ram.write_at(0, &self.clean).unwrap();
        let bytes: Vec<u8> = input.iter().flat_map(|word| word.to_le_bytes()).collect();
        self.ram.write_at(u64::from(INPUT - RAM), &bytes).unwrap();
        self.core.set_reg(0, INPUT);
        self.core.set_reg(13, STACK);
        self.core.set_reg(14, BACK | 1);
        // Thumb state; the reset takes it from a vector, and there is none.
        self.core.set_xpsr(1 << 24);
        self.core.set_pc(entry);
        let mut cycles = 0;
        loop {
            let pc = self.core.pc();
            if pc == BACK {
                return cycles;
            }
            see(pc);
            cycles += self.core.step();
            assert!(
                !self.core.is_locked_up(),
                "the core locked up after {pc:#x}"
            );
            assert!(cycles < 10_000_000, "no return from {entry:#x}");
        }
    }
}
