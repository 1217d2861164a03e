//! The local frame against PROJ's tangent plane (`data/oracle.py` wrote the numbers).

use mission::place::{Frame, Geodetic, Local, Origin};

#[test]
fn the_frame_is_the_tangent_plane_of_proj() {
    let table = include_str!("data/projection.csv");
    let mut count = 0;
    for row in table.lines().skip(1) {
        let values: Vec<f64> = row.split(',').map(|field| field.parse().unwrap()).collect();
        let [
            latitude,
            longitude,
            height,
            to_latitude,
            to_longitude,
            north,
            east,
        ] = values[..]
        else {
            panic!("{row}");
        };
        let place = Geodetic {
            latitude,
            longitude,
        };
        let frame = Frame::new(Origin { place, height });
        let there = Geodetic {
            latitude: to_latitude,
            longitude: to_longitude,
        };
        let found = frame.local(there);
        // The file has places to 0.1 um and the thirteenth decimal of a degree.
        assert!(
            found.distance(Local::new(north, east)) < 3e-7,
            "{row}: {found:?}"
        );
        let back = frame.geodetic(Local::new(north, east));
        assert!(
            (back.latitude - to_latitude).abs() < 1e-11,
            "{row}: {back:?}"
        );
        assert!(
            (back.longitude - to_longitude).abs() < 1e-11,
            "{row}: {back:?}"
        );
        count += 1;
    }
    assert_eq!(count, 80);
}

#[test]
fn the_errors_that_the_module_states() {
    let at = |height| {
        Frame::new(Origin {
            place: Geodetic {
                latitude: 40.83,
                longitude: -96.66,
            },
            height,
        })
    };
    // Without its height, Nebraska's places are 52 mm too near over 1 km.
    let place = at(330.0).geodetic(Local::new(1000.0, 0.0));
    let low = at(0.0).local(place);
    assert!((1000.0 - low.north - 0.052).abs() < 0.001, "{low:?}");
}
