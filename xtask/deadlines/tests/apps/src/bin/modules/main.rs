//! Several files: the application is in one module, the bodies of its tasks are in another.

#![no_std]
#![no_main]

mod firmware;
mod tasks;
