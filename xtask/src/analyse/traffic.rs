//! Frames by identifier: counts and periods.

use std::collections::BTreeMap;

use can_bus::Frame;
use embedded_can::Id;

use super::{
    figures::{MessageFigures, RemoteFigures, UnknownFigures, rounded},
    series::Spread,
};
use crate::network::decode::Decoder;

/// Frames of one identifier.
#[derive(Default, Clone)]
struct Tally {
    /// Data frames.
    frames: u64,
    /// Remote frames. Any node may ask for a message, so they are none of its sender's.
    remote: u64,
    /// Data frames whose length is none of the message's.
    wrong_length: u64,
    last: Option<i64>,
    /// Time between two of them, seconds.
    periods: Spread,
}

/// Counts all frames.
pub(super) struct Traffic {
    standard: Vec<Tally>,
    extended: BTreeMap<u32, Tally>,
}

impl Traffic {
    pub(super) fn new() -> Self {
        Self {
            standard: vec![Tally::default(); 1 << 11],
            extended: BTreeMap::new(),
        }
    }

    /// Counts a frame; true if it is a data frame of a message of the network, with a length that
    /// the message may have.
    pub(super) fn count(&mut self, decoder: &Decoder, at: i64, frame: &Frame) -> bool {
        let (tally, known) = match frame.id() {
            Id::Standard(id) => {
                let id = id.as_raw();
                (&mut self.standard[usize::from(id)], decoder.message(id))
            }
            Id::Extended(id) => (self.extended.entry(id.as_raw()).or_default(), None),
        };
        if frame.is_remote() {
            tally.remote += 1;
            return false;
        }
        tally.frames += 1;
        if let Some(last) = tally.last
            && at >= last
        {
            tally.periods.add((at - last) as f64 * 1e-9);
        }
        tally.last = Some(at);
        let Some(known) = known else {
            return false;
        };
        let whole = known.accepts(frame.data().len());
        tally.wrong_length += u64::from(!whole);
        whole
    }

    /// All frames.
    pub(super) fn frames(&self) -> u64 {
        let all = self.standard.iter().chain(self.extended.values());
        all.map(|tally| tally.frames + tally.remote).sum()
    }

    /// Remote frames.
    pub(super) fn remote(&self) -> u64 {
        let all = self.standard.iter().chain(self.extended.values());
        all.map(|tally| tally.remote).sum()
    }

    /// The figures of the network's messages that were seen.
    pub(super) fn messages(&self, decoder: &Decoder) -> Vec<MessageFigures> {
        let seen = self.standard.iter().enumerate();
        seen.filter(|(_, tally)| tally.frames > 0)
            .filter_map(|(id, tally)| Some((decoder.message(u16::try_from(id).ok()?)?, tally)))
            .map(|(known, tally)| {
                let ms = |seconds: Option<f64>| seconds.map(|seconds| rounded(seconds * 1e3, 4));
                MessageFigures {
                    id: known.id,
                    message: known.name.clone(),
                    sender: known.sender.clone(),
                    frames: tally.frames,
                    wrong_length: tally.wrong_length,
                    mean_period_ms: ms(tally.periods.mean()),
                    least_period_ms: ms(tally.periods.least()),
                    greatest_period_ms: ms(tally.periods.greatest()),
                }
            })
            .collect()
    }

    /// Identifiers that no message of the network has.
    pub(super) fn unknown(&self, decoder: &Decoder) -> Vec<UnknownFigures> {
        let standard = self.standard.iter().enumerate().filter_map(|(id, tally)| {
            let id = u16::try_from(id).ok()?;
            let unknown = decoder.message(id).is_none() && tally.frames > 0;
            unknown.then(|| UnknownFigures {
                id: u32::from(id),
                extended: false,
                frames: tally.frames,
            })
        });
        let extended = self.extended.iter().filter(|(_, tally)| tally.frames > 0);
        let extended = extended.map(|(id, tally)| UnknownFigures {
            id: *id,
            extended: true,
            frames: tally.frames,
        });
        standard.chain(extended).collect()
    }

    /// Identifiers that remote frames asked for.
    pub(super) fn asked(&self, decoder: &Decoder) -> Vec<RemoteFigures> {
        let standard = self.standard.iter().enumerate().filter_map(|(id, tally)| {
            let id = u16::try_from(id).ok()?;
            let message = decoder.message(id).map(|known| known.name.clone());
            Some((u32::from(id), false, message, tally.remote))
        });
        let extended = self.extended.iter();
        let extended = extended.map(|(id, tally)| (*id, true, None, tally.remote));
        let asked = standard.chain(extended).filter(|asked| asked.3 > 0);
        asked
            .map(|(id, extended, message, frames)| RemoteFigures {
                id,
                extended,
                message,
                frames,
            })
            .collect()
    }
}
