//! Memory of tensors on the CPU.

/// Keeps freed memory for later allocations instead of returning it to the system.
///
/// Every operation of a training allocates its result and frees it soon. glibc returns large blocks to the system at once, and the
/// page faults of the next allocation take a third of the time of a U-Net's training. The process keeps no more memory than it
/// needed at its peak.
pub(crate) fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    glibc::keep_freed_memory();
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[expect(unsafe_code, reason = "a setting of the C library")]
mod glibc {
    /// Blocks from this size have pages of their own, which are returned to the system.
    const OWN_PAGES: libc::c_int = 1 << 30;

    /// Free memory at the end of the heap from this size is returned to the system.
    const TRIM: libc::c_int = libc::c_int::MAX;

    pub(super) fn keep_freed_memory() {
        // SAFETY: mallopt may be called at any time. If it refuses a value, the default stays, which is only slower.
        unsafe {
            libc::mallopt(libc::M_MMAP_THRESHOLD, OWN_PAGES);
            libc::mallopt(libc::M_TRIM_THRESHOLD, TRIM);
        }
    }
}
