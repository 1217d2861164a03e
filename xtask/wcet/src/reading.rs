//! What a job reads from a device.

/// The word that a register of a device gives in a job.
///
/// A receive interrupt reads an identifier, for example, and which of its paths a job takes depends on it: the jobs
/// for an identifier have a bound of their own. When the job releases the mailbox, the next frame moves
/// up, so nothing is known of the register behind such a store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reading {
    /// Address of the register, which is read as a word.
    pub register: u32,
    /// The word.
    pub word: u32,
    /// Address of the register, and the bits in it, that change the first one if a store sets one of them.
    pub until: (u32, u32),
}
