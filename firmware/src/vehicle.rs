//! The part that the crates of all vehicles have in common.

/// Includes the code that the build script generates from the vehicle's `network.dbc`, and
/// defines the types that follow from it. Write it once, at the top of the vehicle's crate:
///
/// - `messages`: nodes, quantities, enumerations and messages;
/// - `matrix`: nodes, windows, releases of steps and the system matrix;
/// - `safety`: what the manifest says about stops;
/// - `WINDOWS`, `NODES`: how many there are;
/// - `EVENT_TRIGGERED`: whether the nodes send at once, without the schedule;
/// - `Stack`: the protocol stack of a node; `Link`: its link on its board;
/// - `identity`: a node in this network.
#[macro_export]
macro_rules! vehicle {
    () => {
        /// Nodes, quantities, enumerations and messages of `network.dbc`.
        ///
        /// A quantity is a whole number of its unit or of a fraction of it, as its name
        /// says; the offsets by which the frames shift some of them are taken off.
        #[allow(
            unused_parens,
            clippy::manual_range_contains,
            reason = "written by a program"
        )]
        pub mod messages {
            use ::network::{DecodeError, Message, Signal};
            use ::ttcan::{Frame, Id};

            include!(concat!(env!("OUT_DIR"), "/messages.rs"));
        }

        /// The nodes and the system matrix of `network.dbc`.
        pub mod matrix {
            use ::ttcan::{
                Event, Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window,
            };

            include!(concat!(env!("OUT_DIR"), "/matrix.rs"));
        }

        /// What `vehicle.toml` says about stops.
        pub mod safety {
            include!(concat!(env!("OUT_DIR"), "/safety.rs"));
        }

        /// Windows of the system matrix.
        pub const WINDOWS: usize = matrix::MATRIX.window_count();
        /// Nodes of the network.
        pub const NODES: usize = matrix::MATRIX.node_count();

        /// Whether the nodes send at once, without the schedule.
        pub const EVENT_TRIGGERED: bool = cfg!(event_triggered);

        /// The protocol stack of a node.
        #[cfg(not(event_triggered))]
        pub type Stack = $crate::link::Stack<WINDOWS, NODES>;

        /// The queue of a node, and what it has received.
        #[cfg(event_triggered)]
        pub type Stack = $crate::event::Stack<WINDOWS, { $crate::event::places(&matrix::MATRIX) }>;

        /// The link of a node on its board.
        #[cfg(feature = "target")]
        pub type Link = <Stack as $crate::node::Protocol>::Link;

        /// Starts the board for the bus of this vehicle. Does not return if that fails: the node
        /// records why, and starts again.
        #[cfg(feature = "target")]
        pub fn start(device: $crate::board::pac::Peripherals) -> $crate::board::Sled {
            $crate::node::start::<{ matrix::BIT_RATE }>(device)
        }

        /// `node` in the network of this vehicle.
        #[cfg(not(event_triggered))]
        pub const fn identity(node: ::ttcan::NodeId) -> $crate::link::Identity {
            $crate::link::Identity {
                schedule: matrix::SCHEDULE.view(),
                bit_rate: matrix::BIT_RATE,
                node,
                rule: $crate::leader::Rule::new(safety::BACKUP_MASTER, matrix::BASIC_CYCLE),
                free: matrix::REFERENCE_FREE,
                awaited: REQUEST,
            }
        }

        /// `node` in the network of this vehicle.
        #[cfg(event_triggered)]
        pub const fn identity(node: ::ttcan::NodeId) -> $crate::event::Identity<WINDOWS> {
            static ROUTES: [Option<$crate::event::Route>; WINDOWS] =
                $crate::event::routes(&matrix::MATRIX);
            let at = node.0 as usize;
            $crate::event::Identity {
                received: if at < NODES {
                    matrix::RECEIVED[at]
                } else {
                    &[]
                },
                routes: &ROUTES,
                basic_cycle: matrix::BASIC_CYCLE,
                node,
                awaited: REQUEST,
            }
        }

        /// The message by which a program on the bus asks for a self-test.
        const REQUEST: ::ttcan::Id =
            ::ttcan::Id::constant::<{ <messages::SelfTestRequest as ::network::Message>::ID }>();
    };
}

/// Implements the traits of [`selftest`](crate::selftest) for the reports of a vehicle's nodes and
/// for the request. All networks lay these messages out alike, or the manifest is refused. Write it
/// once, in a crate with [`vehicle!`](crate::vehicle).
#[expect(
    clippy::crate_in_macro_def,
    reason = "the messages are those of the vehicle's crate"
)]
#[macro_export]
macro_rules! self_test_messages {
    ($($report:ident),*) => {
        $(
            impl $crate::selftest::ReportMessage for crate::messages::$report {
                fn of(report: &$crate::selftest::Report) -> Self {
                    use crate::messages::CheckResult;
                    use $crate::selftest::{Check, Outcome};

                    let result = |check| match report.outcome(check) {
                        Outcome::NotDone => CheckResult::NotDone,
                        Outcome::Passed => CheckResult::Passed,
                        Outcome::Failed => CheckResult::Failed,
                    };
                    Self {
                        round: report.round,
                        reset: result(Check::Reset),
                        memory: result(Check::Memory),
                        program: result(Check::Program),
                        oscillators: result(Check::Oscillators),
                        loop_back: result(Check::LoopBack),
                        bus: result(Check::Bus),
                        reference: result(Check::Reference),
                        supply: result(Check::Supply),
                        relay: result(Check::Relay),
                        stack: result(Check::Stack),
                        clock_error: report.clock_error,
                        supply_voltage: (report.supply / 20).min(255) as u8,
                        stack_free: report.stack_free,
                    }
                }
            }
        )*

        impl $crate::selftest::RequestMessage for crate::messages::SelfTestRequest {
            fn request(&self) -> Option<$crate::selftest::Request> {
                (self.key == $crate::selftest::KEY).then_some($crate::selftest::Request {
                    round: self.round,
                    start_again: self.start_again,
                })
            }
        }
    };
}
