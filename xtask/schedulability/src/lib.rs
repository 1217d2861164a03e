//! Answers whether every deadline holds, from RTIC sources and release images.

pub mod can;
pub mod response;
pub mod wcet;
