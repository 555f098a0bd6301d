//! Memory that a session has freed, given back to the system.

/// Gives freed memory back. The allocator keeps what threads have freed, scattered between what is still used, and a daemon that reads its
/// config again and again would seem to grow: each session's threads have other places for it.
pub fn give_back() {
    // SAFETY: it takes a number and touches only memory that is free.
    #[cfg(target_env = "gnu")]
    unsafe {
        nix::libc::malloc_trim(0);
    }
}
