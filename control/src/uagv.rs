//! The UAGV of the thesis: its settings, and the weights its gains came from.

use crate::controller::{Settings, SteeringGains};
use crate::design::{DesignError, SteeringWeights, steering_gains};
use crate::estimator::EstimatorSettings;
use crate::feedback::Limits;
use crate::guidance::GuidanceSettings;
use crate::hold::HoldSettings;
use crate::model::Geometry;
use crate::safety::Slew;
use crate::scalar::Scalar;
use crate::schedule::GainSchedule;

/// Period of the control step, s: the basic cycle (thesis 6.2.2).
pub const PERIOD: f64 = 0.1;
/// Spacing of the schedules' speeds, m/s: nine rows reach 2 m/s (thesis 5.3).
pub const SPACING: f64 = 0.25;

/// Weights of the regulator that brings the vehicle onto the path: found with
/// [`GuidanceSettings::uagv`]'s values.
pub const FIRM: SteeringWeights<f64> = SteeringWeights {
    integral: 6.0,
    cross_track: 84.0,
    heading: 25.0,
    steering_angle: 0.13,
    steering_rate: 1.0,
};

/// Weights of the regulator that keeps it there: a centimetre may cost a
/// third of a degree of steering.
pub const GENTLE: SteeringWeights<f64> = SteeringWeights {
    integral: 0.0095,
    cross_track: 0.47,
    heading: 1.28,
    steering_angle: 3.34,
    steering_rate: 1.0,
};

/// The gains for `weights` at the rear axle, in double precision.
///
/// # Errors
/// [`DesignError`] when the weights are unusable.
pub fn design(weights: &SteeringWeights<f64>) -> Result<SteeringGains<f64>, DesignError<f64>> {
    let uagv = Geometry::<f64>::uagv();
    let rear = Geometry {
        l1: 0.0,
        l2: uagv.wheelbase(),
    };
    steering_gains(&rear, weights, PERIOD, SPACING, SPACING)
}

/// Settings of the UAGV at 10 Hz and 1 m/s.
#[must_use]
pub fn settings<T: Scalar>() -> Settings<T> {
    let degrees = |value: f64| T::lit(value * core::f64::consts::PI / 180.0);
    let geometry = Geometry::<T>::uagv();
    Settings {
        estimator: EstimatorSettings::uagv(),
        limits: Limits::uagv(),
        slew: Slew {
            // From full rate one way to the other in a period.
            steering: degrees(500.0),
            // The motor's own lag is gentler.
            speed: T::lit(20.0),
        },
        firm: FIRM_GAINS.cast(),
        gentle: GENTLE_GAINS.cast(),
        guidance: GuidanceSettings::uagv(),
        hold: HoldSettings {
            begin: degrees(0.30),
            end: degrees(0.20),
            slowest: degrees(1.0),
        },
        cruise: T::one(),
        lost: T::lit(0.3),
        stale_after: T::lit(0.5),
        controlled_point: geometry.l1,
    }
}

/// [`design`] of [`FIRM`], as a build script would write it.
#[rustfmt::skip]
const FIRM_GAINS: SteeringGains<f64> = GainSchedule {
    spacing: 0.25,
    gains: [
        [2.19921604e0, 1.51042128e1, 9.11833606e0, 2.04127371e0],
        [2.19921604e0, 1.51042128e1, 9.11833606e0, 2.04127371e0],
        [2.09370681e0, 1.18559025e1, 9.45594550e0, 2.90442310e0],
        [2.01055168e0, 1.04290002e1, 9.73083500e0, 3.58569070e0],
        [1.93966821e0, 9.55357641e0, 9.94975411e0, 4.16733863e0],
        [1.87700489e0, 8.92941011e0, 1.01259398e1, 4.68239659e0],
        [1.82041420e0, 8.44513054e0, 1.02691683e1, 5.14835573e0],
        [1.76858095e0, 8.04882816e0, 1.03863879e1, 5.57591635e0],
        [1.72062381e0, 7.71260789e0, 1.04826356e1, 5.97224066e0],
    ],
};

/// [`design`] of [`GENTLE`].
#[rustfmt::skip]
const GENTLE_GAINS: SteeringGains<f64> = GainSchedule {
    spacing: 0.25,
    gains: [
        [8.74563052e-2, 1.51139255e0, 2.72407857e0, 1.97964903e0],
        [8.74563052e-2, 1.51139255e0, 2.72407857e0, 1.97964903e0],
        [8.63653854e-2, 1.10841411e0, 2.48814566e0, 2.20457205e0],
        [8.53615679e-2, 9.54723891e-1, 2.42059854e0, 2.41160615e0],
        [8.44146567e-2, 8.70635001e-1, 2.40162103e0, 2.60697046e0],
        [8.35128357e-2, 8.16112665e-1, 2.40225744e0, 2.79309768e0],
        [8.26493285e-2, 7.77016738e-1, 2.41204003e0, 2.97138223e0],
        [8.18194562e-2, 7.47048006e-1, 2.42634914e0, 3.14278663e0],
        [8.10196597e-2, 7.22963617e-1, 2.44288811e0, 3.30804273e0],
    ],
};

#[cfg(test)]
mod tests {
    use super::*;

    /// The tables in the source are what the design gives.
    #[test]
    fn tables_are_designs() {
        for (weights, table) in [(FIRM, FIRM_GAINS), (GENTLE, GENTLE_GAINS)] {
            let designed = design(&weights).expect("usable weights");
            assert_eq!(designed.spacing, table.spacing);
            for (found, known) in designed
                .gains
                .iter()
                .flatten()
                .zip(table.gains.iter().flatten())
            {
                assert!((found / known - 1.0).abs() < 1e-7, "{found} is not {known}");
            }
        }
    }
}
