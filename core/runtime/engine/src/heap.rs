//! How the C library's heap grows in a program that runs for hours.
#![allow(unsafe_code)]

/// Allocations of this size or more are mapped and given back one by one.
const MAPPED_BYTES: i32 = 256 << 10;
/// Maximum of that size in glibc.
const MAX_MAPPED_BYTES: i32 = 32 << 20;

/// Keeps large blocks out of the heap for the life of the process. A program calls it first thing in `main`.
///
/// glibc raises the limit for mapped blocks to the largest block that was ever freed. From then on frames and tables
/// lie between small blocks, and memory that nodes free on reopening returns to the system late or never. Measured with
/// the surgeon's preset, edited twice a second: 20 MB growth in three minutes, none with a fixed limit.
pub fn keep_large_blocks_apart() {
    set(Some(MAPPED_BYTES), MAPPED_BYTES);
}

/// The opposite of [`keep_large_blocks_apart`]: keeps blocks of up to 32 MiB, the maximum of glibc, in the heap, and
/// eight of them free at its end. For a process that only forwards frames, where each frame would otherwise fault in
/// new pages.
pub fn keep_large_blocks() {
    set(Some(MAX_MAPPED_BYTES), 8 * MAX_MAPPED_BYTES);
}

/// Keeps this much free memory at the end of the heap instead of giving it back. A window allocates and frees tens of
/// blocks below the limit for mapped ones in every frame; with a large graph in view it spent a quarter of its time on
/// pages that were returned and faulted in again.
///
/// Call it after [`keep_large_blocks_apart`].
pub fn keep_free(bytes: usize) {
    set(None, i32::try_from(bytes).unwrap_or(i32::MAX));
}

/// Sets from which size on blocks are mapped, where it is given, and how much memory may stay free at the end of the
/// heap.
fn set(mapped_bytes: Option<i32>, free_bytes: i32) {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: sets numbers of the allocator, under its own lock.
    unsafe {
        if let Some(bytes) = mapped_bytes {
            libc::mallopt(libc::M_MMAP_THRESHOLD, bytes);
        }
        libc::mallopt(libc::M_TRIM_THRESHOLD, free_bytes);
    }
    #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
    let _ = (mapped_bytes, free_bytes);
}

#[cfg(all(test, target_os = "linux", target_env = "gnu"))]
mod tests {
    /// Bytes in mapped blocks.
    fn mapped() -> usize {
        // SAFETY: only reads the allocator's counters.
        unsafe { libc::mallinfo2().hblkhd }
    }

    #[test]
    fn a_block_is_mapped_after_a_larger_one_was_freed() {
        super::keep_large_blocks_apart();
        drop(core::hint::black_box(vec![1u8; 16 << 20]));
        let is_mapped = || {
            let before = mapped();
            let block = core::hint::black_box(vec![1u8; 4 << 20]);
            mapped() >= before + block.len()
        };
        // Other tests of this process allocate and free meanwhile.
        assert!((0..50).any(|_| is_mapped()), "the block lies in the heap");
    }
}
