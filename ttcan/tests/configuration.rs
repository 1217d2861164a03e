//! Configurations of a node that are refused.

mod support;

use support::{GPS, MATRIX, SCHEDULE, Uagv, config};
use ttcan::{ConfigError, Id, MatrixConfig, Micros, Node, NodeConfig, NodeId, SystemMatrix};

fn refusal(change: fn(&mut NodeConfig)) -> Option<ConfigError> {
    let mut config = config(GPS);
    change(&mut config);
    Uagv::new(SCHEDULE.view(), config).err()
}

#[test]
fn what_could_overflow_is_refused() {
    assert_eq!(refusal(|_| {}), None);
    assert_eq!(refusal(|config| config.drift_limit_ppm = 10_000), None);
    let drift = refusal(|config| config.drift_limit_ppm = 10_001);
    assert_eq!(drift, Some(ConfigError::Drift));
    let ticks = refusal(|config| config.ticks_per_us = 1001);
    assert_eq!(ticks, Some(ConfigError::Ticks));
}

/// At 2 kbit/s, 255 bits last 128 ms, which are 2^27 ticks of a counter with 1000 of them in a
/// microsecond.
const SLOW: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: 2000,
    basic_cycle: Micros::millis(150),
    longest_gap: Micros::micros(0),
    windows: &[],
    events: &[],
    reference: Id::constant::<96>(),
    ..*MATRIX.config()
});
ttcan::schedule!(static SLOW_SCHEDULE = SLOW);

#[test]
fn a_counter_too_fast_for_the_bit_rate_is_refused() {
    type Slow = Node<'static, 0, 2, 1>;
    let node = |ticks_per_us| {
        Slow::new(
            SLOW_SCHEDULE.view(),
            NodeConfig::new(NodeId(0), ticks_per_us),
        )
        .err()
    };
    assert_eq!(node(131), None);
    assert_eq!(node(132), Some(ConfigError::Ticks));
}
