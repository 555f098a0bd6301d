//! Threads that work for people stand back behind those that work for poses.

use nix::libc;

/// How far, in steps of `nice` (0 to 19): pictures, zips and lists for people are less urgent than poses. Raised, a busy machine shows fewer
/// pictures.
const STANDS_BACK: libc::c_int = 10;

/// Makes the calling thread less urgent than the rest, and not a real-time one where the service is. Where the system refuses, it is as
/// urgent as before.
pub(super) fn stand_back() {
    // SAFETY: both take numbers, and a structure that lives through the call; on Linux 0 means the calling thread.
    unsafe {
        let parameters = libc::sched_param { sched_priority: 0 };
        libc::sched_setscheduler(0, libc::SCHED_BATCH, &parameters);
        libc::setpriority(libc::PRIO_PROCESS, 0, STANDS_BACK);
    }
}
