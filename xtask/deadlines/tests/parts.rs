//! A part that a board of the workspace has, too, is described alike in both places.

use std::path::Path;

use deadlines::parts::{Clocks, find};
use parts::Sled;
use schedulability::board;

#[test]
fn parts_of_the_boards_are_described_alike() {
    for (name, sled) in [("stm32f446", Sled::F446), ("stm32f303", Sled::F303)] {
        let file = find(name, Path::new(".")).unwrap();
        assert_eq!(file.reset_hz, sled.part.hsi.hz);
        assert_eq!(file.highest_hz, sled.part.limits.core);
        assert_eq!(file.flash.limits_hz, sled.part.flash_access.limits_hz);
        let clocks = Clocks {
            core_hz: sled.external.core,
            bus_hz: Some(sled.external.apb1),
            fast_bus_hz: Some(sled.external.apb2),
            flash_waits: None,
            flash_accelerator: true,
        };
        let (of_file, of_board) = (file.on(&clocks).unwrap(), board::part(sled));
        // A file is for every size of a memory, and for programs that do not start by BASEPRI. It has no rates
        // of transfers by DMA, so each access to RAM waits for one.
        let alike = wcet::part::Part {
            ram: of_board.ram,
            ram_waits: of_board.ram_waits,
            start_mask: of_board.start_mask,
            multiply_cycles: of_board.multiply_cycles,
            ..of_file
        };
        assert_eq!(alike, of_board, "{name}");
        for memory in sled.part.ram {
            assert!(of_file.ram.within(memory.base, memory.end() - 1), "{name}");
        }
    }
}
