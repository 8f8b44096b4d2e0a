//! How the C library's heap grows in a program that runs for hours.
#![allow(unsafe_code)]

/// Allocations of this size or more are mapped and given back one by one.
const MAPPED_BYTES: i32 = 256 << 10;
/// The largest such size that glibc takes.
const MAX_MAPPED_BYTES: i32 = 32 << 20;

/// Keeps large blocks out of the heap for the life of the process. A program calls it first thing in `main`.
///
/// glibc raises the limit for mapped blocks to the largest block that was ever freed. From then on pictures and tables lie between small blocks,
/// and what nodes free when they are opened again goes back to the system late or never: the surgeon's preset, edited twice a second, grew by
/// 20 MB in three minutes, and not at all with a fixed limit.
pub fn keep_large_blocks_apart() {
    set(Some(MAPPED_BYTES), MAPPED_BYTES);
}

/// The opposite: keeps blocks of up to 32 MiB, the most that glibc allows, in the heap, and eight of them free at its end. For a process that does nothing
/// but pass pictures on: each of them would otherwise pay for new pages.
pub fn keep_large_blocks() {
    set(Some(MAX_MAPPED_BYTES), 8 * MAX_MAPPED_BYTES);
}

/// Keeps this much free memory at the end of the heap instead of giving it back. A window fills and empties tens of blocks below the limit for
/// mapped ones with every frame: with a large graph in view a quarter of its time went into pages that were given back and asked for again.
///
/// Call it after [`keep_large_blocks_apart`].
pub fn keep_free(bytes: usize) {
    set(None, i32::try_from(bytes).unwrap_or(i32::MAX));
}

/// Sets from which size on blocks are mapped, where it is given, and how much memory may stay free at the end of the heap.
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
