// Models of the frame pool.

use std::collections::BTreeSet;

use shuttle::sync::{Arc, Mutex};
use shuttle::thread;

use super::memory::Memory;

const BUFFER_BYTES: usize = 1 << 26;
/// The largest frame that fits into such a buffer, with room for its end mark.
const BYTES: usize = BUFFER_BYTES - 64;

pub fn no_buffer_has_two_owners() {
    // Room for two: the third has to be refused.
    let memory = Arc::new(Memory::fresh(2 * BUFFER_BYTES as i64));
    let _ = memory.allocate(BYTES).map(|(id, _)| memory.release(id));
    let owned = Arc::new(Mutex::new(BTreeSet::new()));
    let threads: Vec<_> = (0..3)
        .map(|_| {
            let (memory, owned) = (Arc::clone(&memory), Arc::clone(&owned));
            thread::spawn(move || {
                for _ in 0..2 {
                    let Ok((id, _)) = memory.allocate(BYTES) else { continue };
                    assert!(owned.lock().expect("no panic").insert(id.offset), "two owners of {id:?}");
                    // A reader elsewhere holds it for a while.
                    memory.retain(id);
                    let (elsewhere, held) = (Arc::clone(&memory), Arc::clone(&owned));
                    let reader = thread::spawn(move || {
                        assert!(held.lock().expect("no panic").contains(&id.offset), "gone under its reader");
                        elsewhere.release(id);
                    });
                    reader.join().expect("no panic");
                    assert_eq!(memory.references(id), 1);
                    owned.lock().expect("no panic").remove(&id.offset);
                    memory.release(id);
                }
            })
        })
        .collect();
    threads.into_iter().for_each(|t| t.join().expect("no panic"));
    assert_eq!(memory.in_use_bytes(), 0, "all is given back");
}

pub fn the_last_of_several_releases_frees() {
    let memory = Arc::new(Memory::fresh(BUFFER_BYTES as i64));
    let Ok((id, _)) = memory.allocate(BYTES) else { panic!("there is room") };
    memory.retain(id);
    let threads: Vec<_> = (0..2)
        .map(|_| {
            let memory = Arc::clone(&memory);
            thread::spawn(move || memory.release(id))
        })
        .collect();
    threads.into_iter().for_each(|t| t.join().expect("no panic"));
    assert_eq!((memory.references(id), memory.in_use_bytes()), (0, 0), "all is given back");
    assert!(memory.allocate(BYTES).is_ok(), "there is room again");
}

pub fn a_buffer_that_is_gone_cannot_be_kept() {
    let memory = Arc::new(Memory::fresh(4 * BUFFER_BYTES as i64));
    let Ok((id, _)) = memory.allocate(BYTES) else { panic!("there is room") };
    // A plugin knows the name of a buffer that is given back meanwhile, and maybe handed out anew.
    let theirs = Arc::clone(&memory);
    let plugin = thread::spawn(move || {
        for _ in 0..3 {
            if theirs.retain_held(id) {
                thread::yield_now();
                assert!(theirs.references(id) > 0, "gone although it is kept");
                theirs.release(id);
            }
        }
    });
    memory.release(id);
    let mut mine = Vec::new();
    for _ in 0..3 {
        let Ok((new, _)) = memory.allocate(BYTES) else { continue };
        assert!(!mine.contains(&new), "handed out twice");
        mine.push(new);
    }
    plugin.join().expect("no panic");
    mine.into_iter().for_each(|id| memory.release(id));
    assert_eq!(memory.in_use_bytes(), 0, "all is given back");
}
