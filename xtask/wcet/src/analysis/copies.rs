//! Functions that copy or fill memory: how many bytes they write, and where.

use crate::extent::Extent;
use crate::lasting::reach;
use crate::register::{Register, RegisterSet};
use crate::runtime;
use crate::state::{Registers, State};

use super::run::{Frame, Run};

/// Bytes of one copy up to which its length bounds its loops.
const MAX_COPY: u64 = 4096;

/// What has to be restored when a function that copies or fills memory returns.
pub(super) struct Copy {
    /// The bytes that the callers were to write.
    outer: Option<Option<Extent>>,
    /// The registers on entry, if the function only writes what it is called to write.
    saved: Option<Registers>,
}

impl Run<'_, '_> {
    /// The most bytes that the function at `entry` writes, if it copies, fills or encodes memory
    /// and the number bounds its loops.
    pub(super) fn most_bytes(&self, entry: u32, state: &State) -> Option<u64> {
        let image = self.program.image;
        let register = runtime::length_register(image, entry)?;
        let bytes = u64::from(state.registers[register].range.unsigned().1);
        let bytes = match self.frames.last() {
            // A memcpy wrapper cannot pass its callee a larger length than it was given.
            Some(Frame {
                bytes: Some(outer), ..
            }) => bytes.min(*outer),
            Some(frame) => {
                let most = runtime::most_copied(image, frame.function);
                most.map_or(bytes, |most| bytes.min(most))
            }
            None => bytes,
        };
        Some(bytes).filter(|bytes| *bytes <= MAX_COPY)
    }

    /// Notes where the function at `entry` writes, if it copies or fills memory.
    pub(super) fn begin_copy(&mut self, entry: u32, state: &State) -> Copy {
        let memory = &mut self.executor.memory;
        let outer = memory.target;
        let length = runtime::destination_length(self.program.image, entry);
        if let (None, Some(length)) = (outer, length) {
            // Such a function writes the bytes that it is called to write and nothing else.
            let most = state.registers[length].range.unsigned().1.max(1);
            let to = reach(&self.executor.symbols, &state.registers[Register::R0], most);
            memory.target = Some(to);
        }
        Copy {
            outer,
            saved: length.map(|_| state.registers),
        }
    }

    /// Ends what [`Self::begin_copy`] began.
    ///
    /// The function's own stores go through pointers that are unknown in its loops, so the
    /// machine may have lost the registers that it saved on the stack. By the calling
    /// convention it returns with the same values in them.
    pub(super) fn end_copy(&mut self, copy: Copy, returned: Option<&mut State>) {
        self.executor.memory.target = copy.outer;
        if let (Some(state), Some(saved)) = (returned, copy.saved) {
            for register in RegisterSet::PRESERVED.iter() {
                state.registers[register] = saved[register];
            }
        }
    }
}
