//! Latitude and longitude go through their frames without loss.

use network::Message;
use proptest::prelude::*;
use uagv::messages::{Degrees, Latitude, Longitude};

const DEGREE: i64 = 10_000_000_000;

proptest! {
    #[test]
    fn a_latitude_survives_its_frame(angle in -90 * DEGREE..=90 * DEGREE) {
        let sent = Latitude::from_angle(angle);
        let received = Latitude::decode(&sent.encode());
        prop_assert_eq!(received.map(|latitude| latitude.angle()), Ok(angle));
    }

    #[test]
    fn a_longitude_survives_its_frame(angle in -180 * DEGREE..=180 * DEGREE) {
        let sent = Longitude::from_angle(angle);
        let received = Longitude::decode(&sent.encode());
        prop_assert_eq!(received.map(|longitude| longitude.angle()), Ok(angle));
    }

    #[test]
    fn an_angle_off_the_globe_is_taken_as_its_edge(angle in any::<i64>()) {
        let latitude = Latitude::from_angle(angle).angle();
        prop_assert_eq!(latitude, angle.clamp(-90 * DEGREE, 90 * DEGREE));
        let longitude = Longitude::from_angle(angle).angle();
        prop_assert_eq!(longitude, angle.clamp(-180 * DEGREE, 180 * DEGREE));
    }
}

#[test]
fn between_minus_one_and_zero_degrees_the_sign_is_kept() {
    let south = Latitude::from_angle(-DEGREE / 2);
    assert_eq!((south.whole, south.negative), (Degrees(0), true));
    assert_eq!(south.angle(), -DEGREE / 2);
}

/// The logged frames of the thesis, which have no sign bit.
#[test]
fn the_logged_position_is_in_nebraska() {
    let latitude = Latitude::decode(&[0x6E, 0x23, 0xC9, 0xC2, 0x00, 0x82, 0x00]).unwrap();
    assert_eq!(latitude.angle(), 403_267_961_710);
    let longitude = Longitude::decode(&[0x13, 0x72, 0xDA, 0x27, 0x00, 0x54, 0x00]).unwrap();
    assert_eq!(longitude.angle(), -960_668_627_475);
}
