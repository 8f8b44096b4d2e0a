//! Catches plugins that call `exit`, which would end the run without an error message, by defining the exit functions
//! in the program.
//!
//! [`guard_exits!`](crate::guard_exits) defines them in a program, whose build exports them
//! (`--export-dynamic-symbol`), so that the dynamic linker binds the calls of all plugins and their libraries to them.

use std::ffi::c_int;

use super::line::Line;
use super::{crash, rescue};
use crate::current_node;
use crate::log;

/// Which of C's functions was called.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExitCall {
    /// `exit`: exit handlers run.
    Exit,
    /// `_exit`, `_Exit`, `quick_exit`: they do not.
    AtOnce,
}

/// Ends the process at once. For the program itself; files have been finished.
pub fn leave(code: i32) -> ! {
    loop {
        // SAFETY: ends the process without running anything else. C's `_exit` is the guarded one here.
        unsafe { libc::syscall(libc::SYS_exit_group, code) };
    }
}

/// A guarded exit function was called. A call from a node's code, or while a graph runs, is reported, files are
/// finished and the exit status is 1. All other calls reach C's own function.
pub fn called(code: c_int, call: ExitCall) -> ! {
    // A forked child that could not start its program also ends like this.
    if !crash::is_ours() {
        go_on(code, call);
    }
    match current_node::current() {
        Some((who, _, tick)) => {
            log::flush_all(rescue::LINES);
            let mut words = Line::new();
            words.text("error: ");
            if who.node.is_empty() {
                words.text("plugin ").text(&who.file).text(" ended the program while it was loaded");
            } else {
                words.text("node `").text(&who.node).text("` (").text(&who.node_type).text(") ended the program");
                if let Some((source, seq)) = tick {
                    words.text(" at tick ").number(seq).text(" of source ").number(u64::from(source));
                }
            }
            words.text(": it called exit(").number(u64::from(code.unsigned_abs())).text(")").print();
            if !who.node.is_empty() && !who.file.is_empty() {
                words.text("  plugin: ").text(&who.file).print();
            }
            words.text("  help: a plugin must return an error instead; report this text to its author").print();
            rescue::after_crash(Some(who));
            leave(1)
        }
        None if rescue::any_engine() => {
            Line::new().text("error: a library ended the program while a graph ran: it called exit").print();
            rescue::after_crash(None);
            leave(1)
        }
        None => go_on(code, call),
    }
}

fn go_on(code: c_int, call: ExitCall) -> ! {
    if call == ExitCall::Exit {
        // SAFETY: the next definition of `exit` after the program's own is C's.
        unsafe {
            let next = libc::dlsym(libc::RTLD_NEXT, c"exit".as_ptr());
            if !next.is_null() {
                let exit: extern "C" fn(c_int) -> ! = std::mem::transmute(next);
                exit(code)
            }
        }
    }
    leave(code)
}

/// Defines C's exit functions in a program, so that plugins cannot end it unnoticed. See
/// [`ending::called`](crate::ending::called).
#[macro_export]
macro_rules! guard_exits {
    () => {
        mod guarded_exits {
            use $crate::ending::{ExitCall, called};

            #[unsafe(no_mangle)]
            extern "C" fn exit(code: std::ffi::c_int) -> ! {
                called(code, ExitCall::Exit)
            }

            #[unsafe(no_mangle)]
            extern "C" fn _exit(code: std::ffi::c_int) -> ! {
                called(code, ExitCall::AtOnce)
            }

            #[unsafe(no_mangle)]
            extern "C" fn _Exit(code: std::ffi::c_int) -> ! {
                called(code, ExitCall::AtOnce)
            }

            #[unsafe(no_mangle)]
            extern "C" fn quick_exit(code: std::ffi::c_int) -> ! {
                called(code, ExitCall::AtOnce)
            }
        }
    };
}
