//! Properties of the mode state machine for arbitrary sequences of inputs.

use control::mode::{Conditions, Mode, ModeMachine, Request, Source, next};
use proptest::prelude::*;

fn requests() -> impl Strategy<Value = Request> {
    prop_oneof![
        Just(Request::None),
        Just(Request::Release),
        Just(Request::Manual),
        Just(Request::Autonomous),
        Just(Request::EmergencyStop),
    ]
}

fn conditions() -> impl Strategy<Value = Conditions> {
    (
        any::<bool>(),
        prop::bool::weighted(0.1),
        prop::bool::weighted(0.1),
    )
        .prop_map(|(fixed_solution, stop_loop_open, fault)| Conditions {
            fixed_solution,
            stop_loop_open,
            fault,
        })
}

proptest! {
    #[test]
    fn histories_keep_the_rules(
        history in proptest::collection::vec((requests(), conditions()), 1..200)
    ) {
        let mut machine = ModeMachine::new();
        for (request, conditions) in history {
            let before = machine.mode();
            let after = machine.step(request, conditions);
            prop_assert_eq!(after, next(before, request, conditions));
            if after == Mode::AutonomousRun {
                prop_assert!(conditions.fixed_solution, "running without a fixed solution");
                prop_assert!(!conditions.fault && !conditions.stop_loop_open);
                prop_assert!(matches!(before, Mode::AutonomousRun | Mode::AutonomousReady));
            }
            if conditions.stop_loop_open || request == Request::EmergencyStop {
                prop_assert_eq!(after, Mode::EmergencyStop);
            }
            if before == Mode::EmergencyStop && after != Mode::EmergencyStop {
                prop_assert_eq!(after, Mode::Idle);
                prop_assert_eq!(request, Request::Release);
                prop_assert!(!conditions.stop_loop_open);
            }
            if before == Mode::Fault && !matches!(after, Mode::Fault | Mode::EmergencyStop) {
                prop_assert_eq!(after, Mode::Idle);
                prop_assert_eq!(request, Request::Release);
                prop_assert!(!conditions.fault);
            }
            if conditions.fault {
                prop_assert_eq!(after.source(), Source::Still);
            }
        }
    }
}

#[test]
fn emergency_stop_is_one_step_from_everywhere() {
    for mode in Mode::ALL {
        for fixed_solution in [false, true] {
            for fault in [false, true] {
                for stop_loop_open in [false, true] {
                    let conditions = Conditions {
                        fixed_solution,
                        stop_loop_open,
                        fault,
                    };
                    assert_eq!(
                        next(mode, Request::EmergencyStop, conditions),
                        Mode::EmergencyStop
                    );
                }
            }
        }
    }
}

#[test]
fn every_mode_is_reachable_and_manual_needs_no_fix() {
    let none = Conditions::default();
    let fixed = Conditions {
        fixed_solution: true,
        ..none
    };
    let mut machine = ModeMachine::new();
    assert_eq!(machine.mode(), Mode::Idle);
    assert_eq!(machine.step(Request::Manual, none), Mode::Manual);
    assert_eq!(
        machine.step(Request::Autonomous, none),
        Mode::AutonomousReady
    );
    assert_eq!(
        machine.step(Request::Autonomous, none),
        Mode::AutonomousReady
    );
    assert_eq!(
        machine.step(Request::Autonomous, fixed),
        Mode::AutonomousRun
    );
    assert_eq!(machine.step(Request::None, none), Mode::AutonomousReady);
    assert_eq!(
        machine.step(
            Request::None,
            Conditions {
                fault: true,
                ..fixed
            }
        ),
        Mode::Fault
    );
    assert_eq!(machine.step(Request::Manual, fixed), Mode::Fault);
    assert_eq!(machine.step(Request::Release, fixed), Mode::Idle);
}

#[test]
fn codes_are_one_to_one() {
    for code in 0..=u8::MAX {
        if let Some(mode) = Mode::from_code(code) {
            assert_eq!(mode.code(), code);
        }
    }
    for mode in Mode::ALL {
        assert_eq!(Mode::from_code(mode.code()), Some(mode));
    }
}
