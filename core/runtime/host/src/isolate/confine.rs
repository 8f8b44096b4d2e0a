//! Confines the process of a group, as far as the kernel can.
//!
//! Two mechanisms that need no privileges and that a process cannot undo: a seccomp filter refuses system calls,
//! Landlock refuses rights on files. Both hold for all threads that start later, so the process sets them before it
//! starts one, and before it maps a plugin.

use std::collections::BTreeMap;
use std::io;

use landlock::{
    ABI, AccessFs, CompatLevel, Compatible, PathBeneath, PathFd, Ruleset, RulesetAttr, RulesetCreatedAttr, Scope,
};
use panoscope_engine::isolation::Deny;
use seccompiler::{BpfProgram, SeccompAction, SeccompFilter};

/// Newest version of Landlock whose rights are used.
const LANDLOCK: ABI = ABI::V6;
/// Folder of the devices, which may be written: cameras, graphics, `/dev/null`.
const DEVICES: &str = "/dev";

/// Mechanisms of the running kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernel {
    /// Version of Landlock; `None` if the kernel lacks it or it is off.
    pub landlock: Option<u32>,
    /// Whether seccomp filters are available.
    pub seccomp: bool,
}

impl Kernel {
    /// Parts of `deny` that this kernel cannot enforce, as named in a graph file.
    pub fn lacks(&self, deny: Deny) -> Vec<&'static str> {
        let network = deny.network && !self.seccomp;
        let new_files = deny.new_files && self.landlock.is_none();
        Deny { network, new_files }.words().collect()
    }
}

/// Asks the running kernel.
pub fn kernel() -> Kernel {
    const VERSION_OF_LANDLOCK: libc::c_ulong = 1;
    // SAFETY: with this flag the call has no arguments and only returns the version.
    let version = unsafe {
        let none = std::ptr::null::<libc::c_void>();
        libc::syscall(libc::SYS_landlock_create_ruleset, none, 0_usize, VERSION_OF_LANDLOCK)
    };
    let mut action: u32 = libc::SECCOMP_RET_ERRNO;
    // SAFETY: only reads the action.
    let seccomp = unsafe {
        libc::syscall(libc::SYS_seccomp, libc::SECCOMP_GET_ACTION_AVAIL as libc::c_ulong, 0_usize, &raw mut action)
    };
    Kernel { landlock: u32::try_from(version).ok().filter(|version| *version > 0), seccomp: seccomp == 0 }
}

/// Confines this thread and all threads that it starts. Mechanisms that the kernel lacks are skipped; see
/// [`Kernel::lacks`].
///
/// # Errors
/// The kernel has a mechanism but refuses it.
pub(crate) fn confine(deny: Deny) -> io::Result<()> {
    let kernel = kernel();
    if deny.new_files && kernel.landlock.is_some() {
        refuse_new_files().map_err(io::Error::other)?;
    }
    if deny.network && kernel.seccomp {
        refuse_network().map_err(io::Error::other)?;
    }
    Ok(())
}

/// Denies creating, writing, truncating, moving and removing files and, where the kernel can, signals to processes
/// outside.
fn refuse_new_files() -> Result<(), landlock::RulesetError> {
    let writing = AccessFs::from_write(LANDLOCK);
    let existing = AccessFs::WriteFile | AccessFs::Truncate;
    let ruleset = Ruleset::default()
        .set_compatibility(CompatLevel::BestEffort)
        .handle_access(writing)?
        .scope(Scope::Signal | Scope::AbstractUnixSocket)?
        .create()?;
    let ruleset = match PathFd::new(DEVICES) {
        Ok(devices) => ruleset.add_rule(PathBeneath::new(devices, existing))?,
        Err(_) => ruleset,
    };
    ruleset.restrict_self().map(|_| ())
}

/// Denies all sockets except a connected pair inside the process.
fn refuse_network() -> Result<(), seccompiler::Error> {
    // An io_uring makes sockets without the system call.
    let refused = [libc::SYS_socket, libc::SYS_io_uring_setup];
    let rules: BTreeMap<_, _> = refused.into_iter().map(|call| (call, Vec::new())).collect();
    let errno = SeccompAction::Errno(libc::EACCES as u32);
    let filter = SeccompFilter::new(rules, SeccompAction::Allow, errno, std::env::consts::ARCH.try_into()?)?;
    let program: BpfProgram = filter.try_into()?;
    seccompiler::apply_filter(&program)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_kernel_lacks_is_named() {
        let both = Deny { network: true, new_files: true };
        assert_eq!(Kernel { landlock: None, seccomp: false }.lacks(both), ["network", "new_files"]);
        assert_eq!(Kernel { landlock: Some(6), seccomp: false }.lacks(both), ["network"]);
        assert!(Kernel { landlock: None, seccomp: false }.lacks(Deny::default()).is_empty());
    }

    #[test]
    fn a_thread_that_is_locked_in_opens_neither_sockets_nor_files() {
        let kernel = kernel();
        if kernel.landlock.is_none() || !kernel.seccomp {
            panoscope_testing::skipped!("this kernel has {kernel:?}");
            return;
        }
        let file = std::env::temp_dir().join(format!("panoscope-confined-{}", std::process::id()));
        std::fs::write(&file, "before").expect("a file");
        let path = file.clone();
        // Only this thread.
        let confined = std::thread::spawn(move || {
            confine(Deny { network: true, new_files: true }).expect("the kernel has both");
            assert_eq!(std::fs::read_to_string(&path).expect("readable"), "before");
            assert!(std::fs::write(&path, "after").is_err(), "an existing file");
            assert!(std::fs::write(path.with_extension("new"), "x").is_err(), "a new file");
            assert!(std::fs::remove_file(&path).is_err(), "removed");
            assert!(std::fs::OpenOptions::new().write(true).open("/dev/null").is_ok(), "devices stay");
            assert!(std::net::TcpListener::bind("127.0.0.1:0").is_err(), "a socket");
            assert!(std::os::unix::net::UnixDatagram::unbound().is_err(), "a local socket");
        });
        confined.join().expect("refused, all of it");
        assert_eq!(std::fs::read_to_string(&file).expect("readable"), "before");
        let _ = std::fs::remove_file(&file);
    }
}
