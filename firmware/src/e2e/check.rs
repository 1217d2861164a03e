//! Check value of nodes without a key: it finds faults, not forgeries.

/// CRC-8H2F: polynomial 0x2F, initial value and final exclusive-or 0xFF, not reflected.
const TABLE: [u8; 16] = {
    let mut table = [0; 16];
    let mut nibble = 0;
    while nibble < 16 {
        let mut value = (nibble as u8) << 4;
        let mut bit = 0;
        while bit < 4 {
            value = if value & 0x80 != 0 {
                value << 1 ^ 0x2F
            } else {
                value << 1
            };
            bit += 1;
        }
        table[nibble] = value;
        nibble += 1;
    }
    table
};

/// The check value so far is in the low eight bits. What is shifted out of them stays above, which
/// is cheaper than to remove it each time.
#[inline]
fn update(crc: u32, byte: u8) -> u32 {
    let nibble = |crc: u32| crc << 4 ^ u32::from(TABLE[(crc >> 4 & 0xF) as usize]);
    nibble(nibble(crc ^ u32::from(byte)))
}

/// The check value of a frame: over the identifier and the system time of its basic cycle
/// (ms, as the reference carries it), low bytes first, and D0..D6.
pub fn check_value(id: u16, time: u32, data: &[u8; 8]) -> u8 {
    let crc = id.to_le_bytes().into_iter().fold(0xFF, update);
    let crc = time.to_le_bytes().into_iter().fold(crc, update);
    let [covered @ .., _] = data;
    covered.iter().fold(crc, |crc, &byte| update(crc, byte)) as u8 ^ 0xFF
}

#[cfg(test)]
mod tests {
    use super::update;

    /// AUTOSAR_SWS_CRCLibrary, 8-bit 0x2F: check values of the published test patterns.
    #[test]
    fn the_crc_gives_autosar_s_check_values() {
        let crc =
            |bytes: &[u8]| bytes.iter().fold(0xFF, |crc, &byte| update(crc, byte)) as u8 ^ 0xFF;
        assert_eq!(crc(b"123456789"), 0xDF);
        assert_eq!(crc(&[0, 0, 0, 0]), 0x12);
        assert_eq!(crc(&[0xF2, 0x01, 0x83]), 0xC2);
        assert_eq!(crc(&[0x0F, 0xAA, 0x00, 0x55]), 0xC6);
        assert_eq!(crc(&[0x00, 0xFF, 0x55, 0x11]), 0x77);
        assert_eq!(
            crc(&[0x33, 0x22, 0x55, 0xAA, 0xBB, 0xCC, 0xDD, 0xEE, 0xFF]),
            0x11
        );
        assert_eq!(crc(&[0x92, 0x6B, 0x55]), 0x33);
        assert_eq!(crc(&[0xFF, 0xFF, 0xFF, 0xFF]), 0x6C);
    }
}
