//! The part that the crates of all vehicles have in common.

/// Includes the code that the build script generates from the vehicle's `network.dbc`, and
/// defines the types that follow from it. Write it once, at the top of the vehicle's crate:
///
/// - `messages`: nodes, quantities, enumerations and messages;
/// - `matrix`: nodes, windows, releases of steps and the system matrix;
/// - `safety`: what the manifest says about stops;
/// - `WINDOWS`, `NODES`: how many there are;
/// - `Stack`: the protocol stack of a node; `Link`: its link on its board;
/// - `identity`: a node in this network.
#[macro_export]
macro_rules! vehicle {
    () => {
        /// Nodes, quantities, enumerations and messages of `network.dbc`.
        ///
        /// A quantity is a whole number of its unit or of a fraction of it, as its name
        /// says; the offsets by which the frames shift some of them are taken off.
        #[allow(unused_parens, reason = "written by a program")]
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

        /// The protocol stack of a node.
        pub type Stack = $crate::link::Stack<WINDOWS, NODES>;

        /// The link of a node on its board.
        #[cfg(feature = "target")]
        pub type Link = $crate::node::BoardLink<WINDOWS, NODES>;

        #[cfg(feature = "target")]
        const _: () = assert!(
            matrix::BIT_RATE == $crate::board::BIT_RATE,
            "the boards' bit timing is that of the network"
        );

        /// `node` in the network of this vehicle.
        pub const fn identity(node: ::ttcan::NodeId) -> $crate::link::Identity {
            $crate::link::Identity {
                schedule: matrix::SCHEDULE.view(),
                node,
                rule: $crate::leader::Rule::new(safety::BACKUP_MASTER, matrix::BASIC_CYCLE),
            }
        }
    };
}
