//! Answers whether every deadline holds, from RTIC sources and release images.
//!
//! [`system::run`] takes sources, images, the task table and the network file
//! and returns a [`system::Report`]; [`report`] shows it.

pub mod can;
pub mod priorities;
pub mod report;
pub mod response;
pub mod stack;
pub mod system;
pub mod table;
pub mod tasks;
pub mod wcet;
