//! Lower priority for threads that serve people than for those that compute poses.

use nix::libc;

/// Increase in niceness (0 to 19): pictures, zips and lists are less urgent than poses. Raised, a
/// busy machine shows fewer pictures.
const STANDS_BACK: libc::c_int = 10;

/// Lowers the calling thread's priority, and takes it out of real-time scheduling if the service
/// has that. If the system refuses, the priority stays.
pub fn stand_back() {
    // SAFETY: both take numbers, and a structure that lives through the call; on Linux 0 means the
    // calling thread.
    unsafe {
        let parameters = libc::sched_param { sched_priority: 0 };
        libc::sched_setscheduler(0, libc::SCHED_BATCH, &parameters);
        libc::setpriority(libc::PRIO_PROCESS, 0, STANDS_BACK);
    }
}
