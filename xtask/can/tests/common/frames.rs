//! Any frame, for the formats that write frames down.

use can_bus::Frame;
use embedded_can::{ExtendedId, Id, StandardId};
use proptest::prelude::*;

/// Data and remote frames of both kinds of identifier, with up to eight bytes.
pub(crate) fn any_frame() -> impl Strategy<Value = Frame> {
    let id = prop_oneof![
        (0..=0x7FF_u16).prop_map(|raw| StandardId::new(raw).map(Id::Standard).expect("in range")),
        (0..=0x1FFF_FFFF_u32)
            .prop_map(|raw| ExtendedId::new(raw).map(Id::Extended).expect("in range")),
    ];
    let content = prop_oneof![
        3 => prop::collection::vec(any::<u8>(), 0..=8).prop_map(Ok),
        1 => (0..=8_u8).prop_map(Err),
    ];
    (id, content).prop_map(|(id, content)| {
        match content {
            Ok(data) => Frame::new_data(id, &data),
            Err(dlc) => Frame::new_remote(id, dlc),
        }
        .expect("within the limits")
    })
}
