//! Random plans.

use mission::place::{Geodetic, Local, Origin};
use mission::plan::{End, Join, Leg, Outputs, Plan, Shape};
use proptest::prelude::*;

fn places() -> impl Strategy<Value = Local> {
    (-500.0_f64..500.0, -500.0_f64..500.0).prop_map(|(north, east)| Local::new(north, east))
}

fn legs() -> impl Strategy<Value = Leg> {
    let line = (places(), places()).prop_map(|(from, to)| Shape::Line { from, to });
    let curve = prop::collection::vec(places(), 2..20).prop_map(|points| Shape::Curve { points });
    let outputs = any::<u8>().prop_map(Outputs);
    (
        prop_oneof![line, curve],
        1e-3_f64..10.0,
        any::<bool>(),
        outputs,
    )
        .prop_map(|(shape, speed, reverse, outputs)| Leg {
            shape,
            speed,
            reverse,
            outputs,
            join: Join::Turn,
        })
}

/// Plans that pass their check, nearly always; some legs continue the one before.
pub(crate) fn plans() -> impl Strategy<Value = Plan> {
    let origin = (-89.0_f64..89.0, -180.0_f64..180.0, -500.0_f64..9000.0).prop_map(
        |(latitude, longitude, height)| Origin {
            place: Geodetic {
                latitude,
                longitude,
            },
            height,
        },
    );
    let legs = prop::collection::vec((legs(), any::<bool>()), 1..8);
    let around = (any::<bool>(), 0..3_u8);
    ("[^\\p{Cc}]{1,64}", origin, legs, around).prop_map(
        |(name, origin, legs, (fenced, obstacles))| {
            let mut chained: Vec<Leg> = Vec::new();
            for (mut leg, continues) in legs {
                if let (true, Some(before)) = (continues, chained.last()) {
                    let begin = before.shape.ends().1;
                    leg.join = Join::Continue;
                    match &mut leg.shape {
                        Shape::Line { from, .. } => *from = begin,
                        Shape::Curve { points } => points[0] = begin,
                    }
                }
                chained.push(leg);
            }
            let corner = |north, east| Local::new(north, east);
            let obstacle = vec![corner(700.0, 0.0), corner(702.0, 0.0), corner(701.0, 1.5)];
            let fence = vec![
                corner(-501.0, -500.5),
                corner(500.1, -500.0),
                corner(500.0, 500.0),
                corner(-500.0, 500.0),
            ];
            Plan {
                name,
                origin,
                width: fenced.then_some(0.1 + 3.0),
                fence: if fenced { fence } else { Vec::new() },
                obstacles: vec![obstacle; usize::from(obstacles)],
                legs: chained,
                end: End::Stop,
            }
        },
    )
}
