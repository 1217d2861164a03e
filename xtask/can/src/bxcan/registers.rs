//! Offsets, bits and reset values of bxCAN's registers (RM0390 and RM0316, "CAN registers").

/// Master control.
pub(crate) const MCR: u32 = 0x000;
/// Master status.
pub(crate) const MSR: u32 = 0x004;
/// Transmit status.
pub(crate) const TSR: u32 = 0x008;
/// Receive FIFO 0.
pub(crate) const RF0R: u32 = 0x00C;
/// Receive FIFO 1.
pub(crate) const RF1R: u32 = 0x010;
/// Interrupt enable.
pub(crate) const IER: u32 = 0x014;
/// Error status.
pub(crate) const ESR: u32 = 0x018;
/// Bit timing.
pub(crate) const BTR: u32 = 0x01C;
/// First transmit mailbox; each takes [`MAILBOX_STRIDE`] bytes.
pub(crate) const TI0R: u32 = 0x180;
/// End of the transmit mailboxes.
pub(crate) const TX_END: u32 = TI0R + 3 * MAILBOX_STRIDE;
/// Output mailbox of the first receive FIFO; each takes [`MAILBOX_STRIDE`] bytes.
pub(crate) const RI0R: u32 = 0x1B0;
/// End of the receive mailboxes.
pub(crate) const RX_END: u32 = RI0R + 2 * MAILBOX_STRIDE;
/// Bytes from one mailbox to the next.
pub(crate) const MAILBOX_STRIDE: u32 = 0x10;
/// Filter master.
pub(crate) const FMR: u32 = 0x200;
/// Filter mode.
pub(crate) const FM1R: u32 = 0x204;
/// Filter scale.
pub(crate) const FS1R: u32 = 0x20C;
/// Filter FIFO assignment.
pub(crate) const FFA1R: u32 = 0x214;
/// Filter activation.
pub(crate) const FA1R: u32 = 0x21C;
/// First register of the first filter bank; each bank has two words.
pub(crate) const F0R1: u32 = 0x240;

/// Bits of MCR.
pub(crate) mod mcr {
    pub(crate) const INRQ: u32 = 1 << 0;
    pub(crate) const SLEEP: u32 = 1 << 1;
    pub(crate) const TXFP: u32 = 1 << 2;
    pub(crate) const RFLM: u32 = 1 << 3;
    pub(crate) const NART: u32 = 1 << 4;
    pub(crate) const AWUM: u32 = 1 << 5;
    pub(crate) const ABOM: u32 = 1 << 6;
    pub(crate) const TTCM: u32 = 1 << 7;
    pub(crate) const RESET: u32 = 1 << 15;
    pub(crate) const DBF: u32 = 1 << 16;
    pub(crate) const WRITABLE: u32 = 0xFF | DBF;
    pub(crate) const AFTER_RESET: u32 = DBF | SLEEP;
}

/// Bits of MSR.
pub(crate) mod msr {
    pub(crate) const INAK: u32 = 1 << 0;
    pub(crate) const SLAK: u32 = 1 << 1;
    pub(crate) const ERRI: u32 = 1 << 2;
    pub(crate) const WKUI: u32 = 1 << 3;
    pub(crate) const SLAKI: u32 = 1 << 4;
    pub(crate) const TXM: u32 = 1 << 8;
    pub(crate) const RXM: u32 = 1 << 9;
    pub(crate) const SAMP: u32 = 1 << 10;
    pub(crate) const RX: u32 = 1 << 11;
}

/// Bits of IER.
pub(crate) mod ier {
    pub(crate) const TMEIE: u32 = 1 << 0;
    pub(crate) const FMPIE0: u32 = 1 << 1;
    pub(crate) const FFIE0: u32 = 1 << 2;
    pub(crate) const FOVIE0: u32 = 1 << 3;
    pub(crate) const FMPIE1: u32 = 1 << 4;
    pub(crate) const FFIE1: u32 = 1 << 5;
    pub(crate) const FOVIE1: u32 = 1 << 6;
    pub(crate) const EWGIE: u32 = 1 << 8;
    pub(crate) const EPVIE: u32 = 1 << 9;
    pub(crate) const BOFIE: u32 = 1 << 10;
    pub(crate) const LECIE: u32 = 1 << 11;
    pub(crate) const ERRIE: u32 = 1 << 15;
    pub(crate) const WKUIE: u32 = 1 << 16;
    pub(crate) const SLKIE: u32 = 1 << 17;
    pub(crate) const WRITABLE: u32 = 0x0003_8F7F;
}

/// Bits of ESR.
pub(crate) mod esr {
    pub(crate) const EWGF: u32 = 1 << 0;
    pub(crate) const EPVF: u32 = 1 << 1;
    pub(crate) const BOFF: u32 = 1 << 2;
    pub(crate) const LEC_SHIFT: u32 = 4;
    pub(crate) const LEC_MASK: u32 = 0b111;
    pub(crate) const TEC_SHIFT: u32 = 16;
    pub(crate) const REC_SHIFT: u32 = 24;
}

/// Bits of BTR.
pub(crate) mod btr {
    pub(crate) const LBKM: u32 = 1 << 30;
    pub(crate) const SILM: u32 = 1 << 31;
    pub(crate) const WRITABLE: u32 = 0xC37F_03FF;
    pub(crate) const AFTER_RESET: u32 = 0x0123_0000;
}

/// Bits of RF0R and RF1R.
pub(crate) mod rfr {
    pub(crate) const FULL: u32 = 1 << 3;
    pub(crate) const FOVR: u32 = 1 << 4;
    pub(crate) const RFOM: u32 = 1 << 5;
}

/// Bits of TIxR and RIxR.
pub(crate) mod ir {
    pub(crate) const TXRQ: u32 = 1 << 0;
    pub(crate) const RTR: u32 = 1 << 1;
    pub(crate) const IDE: u32 = 1 << 2;
}

/// Bits of TDTxR.
pub(crate) mod tdtr {
    pub(crate) const TGT: u32 = 1 << 8;
    pub(crate) const WRITABLE: u32 = 0xFFFF_010F;
}
