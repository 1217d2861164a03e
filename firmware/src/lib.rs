//! What the nodes of the vehicle share. The four applications in `src/bin` compose it.

#![no_std]

#[cfg(all(feature = "f303", feature = "f446"))]
compile_error!("an image is for one part: choose the feature `f303` or `f446`, not both");

#[cfg(feature = "f303")]
pub use sled_f303 as board;
#[cfg(feature = "f446")]
pub use sled_f446 as board;

#[cfg(feature = "target")]
pub mod fault;
