//! What CAN_TSR says of the three mailboxes of bxCAN (RM0390 30.9.2).

use ttcan::TransmitOutcome;

/// Where the status of each mailbox begins.
const MAILBOXES: [u32; 3] = [0, 8, 16];
/// The status of a mailbox: request completed, sent, arbitration lost, error, abort requested.
const RQCP: u32 = 1 << 0;
const TXOK: u32 = 1 << 1;
const ALST: u32 = 1 << 2;
const TERR: u32 = 1 << 3;
const ABRQ: u32 = 1 << 7;

/// Withdraws what is in any of them: ones request, and an empty mailbox ignores it.
pub(crate) const ABORT: u32 = ABRQ << MAILBOXES[0] | ABRQ << MAILBOXES[1] | ABRQ << MAILBOXES[2];

/// How the transmission of a mailbox has ended, and the word that acknowledges it: ones clear, the other flags keep their
/// state.
pub(crate) fn outcome(status: u32) -> Option<(TransmitOutcome, u32)> {
    let ended = |mailbox: &u32| status >> mailbox & RQCP != 0;
    let mailbox = MAILBOXES.into_iter().find(ended)?;
    let has = |flag: u32| status >> mailbox & flag != 0;
    let outcome = if has(TXOK) {
        TransmitOutcome::Sent
    } else if has(ALST) {
        TransmitOutcome::ArbitrationLost
    } else if has(TERR) {
        TransmitOutcome::Error
    } else {
        TransmitOutcome::Aborted
    };
    Some((outcome, RQCP << mailbox))
}
