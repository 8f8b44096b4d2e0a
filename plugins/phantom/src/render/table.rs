//! Large tables whose memory is returned to the system when they are dropped.

use std::ops::{Deref, DerefMut};

/// Values of a scene. The pages of a dropped table are released at once, whichever heap owns them.
///
/// glibc keeps a freed block of up to 32 MiB in the arena of the thread that allocated it (`M_MMAP_THRESHOLD` in mallopt(3)), and `malloc_trim` does
/// not release the end of such an arena. A program can set the threshold; a plugin in a Python process cannot: there, each arena in which a scene was
/// opened kept 36 MB.
#[derive(Clone, Debug, PartialEq)]
pub struct Table<T: Copy>(Vec<T>);

impl<T: Copy> From<Vec<T>> for Table<T> {
    fn from(values: Vec<T>) -> Self {
        Self(values)
    }
}

impl<T: Copy> FromIterator<T> for Table<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        Self(values.into_iter().collect())
    }
}

impl<T: Copy> Deref for Table<T> {
    type Target = Vec<T>;

    fn deref(&self) -> &Vec<T> {
        &self.0
    }
}

impl<T: Copy> DerefMut for Table<T> {
    fn deref_mut(&mut self) -> &mut Vec<T> {
        &mut self.0
    }
}

impl<T: Copy> Drop for Table<T> {
    fn drop(&mut self) {
        self.0.clear();
        release_pages(self.0.spare_capacity_mut());
    }
}

/// Releases the whole pages in memory that holds no values. They read as zero afterwards.
fn release_pages<T>(unused: &mut [std::mem::MaybeUninit<T>]) {
    // SAFETY: only asks for a number.
    let page_bytes = usize::try_from(unsafe { libc::sysconf(libc::_SC_PAGESIZE) }).unwrap_or(4096);
    let range = unused.as_mut_ptr_range();
    let (start, end) =
        ((range.start as usize).next_multiple_of(page_bytes), range.end as usize / page_bytes * page_bytes);
    if start < end {
        let skipped_bytes = start - range.start as usize;
        // SAFETY: whole pages inside one allocation of the heap, which is private anonymous memory. The caller's exclusive borrow says that
        // nothing else uses them, and `MaybeUninit` that no value in them is read. A refusal leaves them as they are.
        unsafe { libc::madvise(range.start.cast::<u8>().add(skipped_bytes).cast(), end - start, libc::MADV_DONTNEED) };
    }
}

#[cfg(all(test, target_os = "linux", target_env = "gnu"))]
mod tests {
    use super::*;

    const BYTES: usize = 16 << 20;

    /// Number of resident pages from `start` on; 0 if nothing is mapped.
    fn resident_pages(start: usize) -> usize {
        let start = start.next_multiple_of(4096);
        let mut pages = vec![0u8; BYTES / 4096 - 1];
        // SAFETY: `pages` has a byte for each page; the call reads no memory in the range.
        match unsafe { libc::mincore(start as *mut _, pages.len() * 4096, pages.as_mut_ptr()) } {
            0 => pages.iter().filter(|page| **page & 1 == 1).count(),
            _ => 0,
        }
    }

    #[test]
    fn a_dropped_table_leaves_no_pages_in_the_arena_of_its_thread() {
        // From now on the heap keeps blocks of this size.
        drop(std::hint::black_box(vec![1u8; 30 << 20]));
        std::thread::spawn(|| {
            let kept = std::hint::black_box(vec![1u8; BYTES]);
            let start = kept.as_ptr() as usize;
            drop(kept);
            assert!(resident_pages(start) > 1000, "the heap gives freed blocks back: this test shows nothing");
            let table = std::hint::black_box(Table::from(vec![1u64; BYTES / 8]));
            let start = table.as_ptr() as usize;
            assert!(resident_pages(start) > 1000);
            drop(table);
            assert!(resident_pages(start) < 16);
        })
        .join()
        .unwrap();
    }
}
