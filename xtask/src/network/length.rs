//! How long a frame of a log occupies the bus.

use can_bus::{Frame, wire::WireFrame};
use embedded_can::Id;

/// Length of a frame in bits, from its start to the last bit of its end of frame, stuff bits included,
/// intermission not. Data frames need no memory for it, because a log may have millions of them.
pub(crate) fn frame_bits(frame: &Frame) -> u32 {
    // A time-triggered network has neither remote frames nor length codes above 8, so `ttcan` knows neither.
    data_frame(frame).map_or_else(
        || WireFrame::encode(frame).bits() as u32,
        |frame| ttcan::frame_bits(&frame),
    )
}

/// The frame as the protocol stack has it.
fn data_frame(frame: &Frame) -> Option<ttcan::Frame> {
    if frame.is_remote() || usize::from(frame.dlc()) != frame.data().len() {
        return None;
    }
    let id = match frame.id() {
        Id::Standard(id) => ttcan::Id::standard(id.as_raw()),
        Id::Extended(id) => ttcan::Id::extended(id.as_raw()),
    };
    ttcan::Frame::new(id?, frame.data()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bus model counts by itself, and so is a witness.
    #[test]
    fn lengths_are_those_of_the_frames_on_the_bus() {
        let ids = [0, 0x64, 0x7FF].into_iter().flat_map(|raw| {
            let standard = embedded_can::StandardId::new(raw).map(Id::from);
            let extended =
                embedded_can::ExtendedId::new(u32::from(raw) << 18 | 0x155).map(Id::from);
            [standard, extended].into_iter().flatten()
        });
        for id in ids {
            for byte in [0, 0x0F, 0x55, 0xFF] {
                let bytes = [byte; 8];
                let data = (0..=8).map(|len| Frame::new_data(id, &bytes[..len]));
                let others = [
                    Frame::new_remote(id, 3),
                    Frame::from_parts(id, false, 15, &bytes),
                ];
                for frame in data.chain(others) {
                    let frame = frame.expect("it is a frame");
                    let bits = WireFrame::encode(&frame).bits();
                    assert_eq!(frame_bits(&frame) as usize, bits, "{frame:?}");
                }
            }
        }
    }
}
