//! Answers whether every deadline holds, from RTIC sources and release images.
//!
//! [`system::Programs`] reads sources, images, the task table and the network file. With the
//! observations of emulated runs it makes a [`results::Report`], which [`report`] shows.
//!
//! ```text
//! source  -> tasks --+
//! table   -----------+-> model -----+  (transfers: of DMA, before all tasks)
//! network -> releases+              +-> node (response, sensitivity) --+-> results -> report
//! image   -> wcet, outside > execution + pends                         |
//! network -> bus (can), chains ----------------------------------------+
//! ```
//!
//! On an event-triggered bus, tasks and messages make each other late: [`event`] bounds both in turn,
//! in place of the releases and the bus of the schedule.

pub mod activations;
pub mod arbitrating;
pub mod arrivals;
pub mod assumptions;
pub mod board;
pub mod bus;
pub mod can;
pub mod chains;
pub mod event;
pub mod execution;
pub mod foreign;
pub mod model;
pub mod models;
pub mod node;
pub mod outside;
pub mod pends;
pub mod priorities;
pub mod queued;
pub mod releases;
pub mod report;
pub mod response;
pub mod results;
pub mod sensitivity;
pub mod side_by_side;
pub mod system;
pub mod table;
pub mod tasks;
pub mod transfers;
pub mod units;
