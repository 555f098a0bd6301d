//! Returns memory freed by a session to the system.

/// Returns freed memory to the system. The allocator keeps memory that threads have freed,
/// scattered between used blocks. Each session's threads use other arenas, so a daemon that reloads
/// its config again and again would seem to grow.
pub fn give_back() {
    // SAFETY: it takes a number and touches only memory that is free.
    #[cfg(target_env = "gnu")]
    unsafe {
        nix::libc::malloc_trim(0);
    }
}
