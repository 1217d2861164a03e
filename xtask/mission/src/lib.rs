//! Mission plans on the host: what a field robot is to drive, from a field boundary or guidance lines of farm
//! tools to a file that is checked before it drives.
//!
//! ```text
//! GeoJSON, CSV, AgOpenGPS, ISOXML --read--> Drawing --field--> Plan --curve--> Chain (clothoids) --drive--> Piece
//!                                     (latitude, longitude)     |  \
//!                                                             TOML  SVG
//! ```
//!
//! - [`place`]: latitude and longitude, and the local frame that the vehicle drives in
//! - [`plan`]: the plan and its file
//! - [`read`]: readers of other tools' files
//! - [`curve`]: a drivable curve through points
//! - [`drive`]: the pieces that the firmware drives
//! - [`fence`]: fences and obstacles with few corners
//! - [`field`]: headland and swaths from a boundary
//! - [`picture`]: the plan from above, as SVG
//!
//! The crate knows no vehicle: limits such as the turning radius are given to it.

pub mod curve;
pub mod drive;
pub mod fence;
pub mod field;
pub mod picture;
pub mod place;
pub mod plan;
pub mod polygon;
pub mod read;
