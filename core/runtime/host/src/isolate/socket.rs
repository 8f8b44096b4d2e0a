//! The socket between host and child: messages that may carry a file descriptor.

use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd, RawFd};

/// Maximum length of a message, bytes.
const MAX_BYTES: usize = 8192;
/// Room for one file descriptor as ancillary data, aligned as the system requires.
type Control = [u64; 4];

/// Two connected sockets, closed when another program is started.
pub(crate) fn pair() -> io::Result<(OwnedFd, OwnedFd)> {
    let mut fds = [0; 2];
    let kind = libc::SOCK_SEQPACKET | libc::SOCK_CLOEXEC;
    // SAFETY: `fds` has room for the two file descriptors.
    if unsafe { libc::socketpair(libc::AF_UNIX, kind, 0, fds.as_mut_ptr()) } != 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: `socketpair` returned these file descriptors, and nothing else owns them.
    Ok(unsafe { (OwnedFd::from_raw_fd(fds[0]), OwnedFd::from_raw_fd(fds[1])) })
}

/// Sends a message, with a file descriptor.
pub(crate) fn send(socket: BorrowedFd<'_>, message: &[u8], file: Option<BorrowedFd<'_>>) -> io::Result<()> {
    if message.len() > MAX_BYTES {
        return Err(io::Error::other("the message is too long"));
    }
    let mut part = libc::iovec { iov_base: message.as_ptr().cast_mut().cast(), iov_len: message.len() };
    let mut control: Control = [0; 4];
    // SAFETY: all-zero bytes are a value of this struct.
    let mut header: libc::msghdr = unsafe { MaybeUninit::zeroed().assume_init() };
    (header.msg_iov, header.msg_iovlen) = (&raw mut part, 1);
    if let Some(file) = file {
        // SAFETY: `control` has room for a header and one file descriptor, `CMSG_SPACE` bytes at most, and is aligned.
        unsafe {
            header.msg_control = control.as_mut_ptr().cast();
            header.msg_controllen = libc::CMSG_SPACE(size_of::<RawFd>() as u32) as usize;
            let ancillary = libc::CMSG_FIRSTHDR(&raw const header);
            (*ancillary).cmsg_level = libc::SOL_SOCKET;
            (*ancillary).cmsg_type = libc::SCM_RIGHTS;
            (*ancillary).cmsg_len = libc::CMSG_LEN(size_of::<RawFd>() as u32) as usize;
            libc::CMSG_DATA(ancillary).cast::<RawFd>().write_unaligned(file.as_raw_fd());
        }
    }
    loop {
        // SAFETY: the header points to memory that lives until the call returns.
        if unsafe { libc::sendmsg(socket.as_raw_fd(), &raw const header, libc::MSG_NOSIGNAL) } >= 0 {
            return Ok(());
        }
        let error = io::Error::last_os_error();
        if error.kind() != io::ErrorKind::Interrupted {
            return Err(error);
        }
    }
}

/// Receives a message and its file descriptor. An empty message means that the other side has closed the socket.
pub(crate) fn receive(socket: BorrowedFd<'_>) -> io::Result<(Vec<u8>, Option<OwnedFd>)> {
    let mut message = vec![0; MAX_BYTES];
    let mut part = libc::iovec { iov_base: message.as_mut_ptr().cast(), iov_len: message.len() };
    let mut control: Control = [0; 4];
    // SAFETY: all-zero bytes are a value of this struct.
    let mut header: libc::msghdr = unsafe { MaybeUninit::zeroed().assume_init() };
    (header.msg_iov, header.msg_iovlen) = (&raw mut part, 1);
    (header.msg_control, header.msg_controllen) = (control.as_mut_ptr().cast(), size_of::<Control>());
    let len = loop {
        // SAFETY: the header points to memory that lives until the call returns.
        let len = unsafe { libc::recvmsg(socket.as_raw_fd(), &raw mut header, libc::MSG_CMSG_CLOEXEC) };
        if let Ok(len) = usize::try_from(len) {
            break len;
        }
        let error = io::Error::last_os_error();
        if error.kind() != io::ErrorKind::Interrupted {
            return Err(error);
        }
    };
    message.truncate(len);
    // SAFETY: the system has filled the header; it points into `control`.
    let file = unsafe {
        let ancillary = libc::CMSG_FIRSTHDR(&raw const header);
        let carries = !ancillary.is_null() && (*ancillary).cmsg_type == libc::SCM_RIGHTS;
        carries.then(|| OwnedFd::from_raw_fd(libc::CMSG_DATA(ancillary).cast::<RawFd>().read_unaligned()))
    };
    Ok((message, file))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::io::Read;
    use std::os::fd::AsFd;

    #[test]
    fn a_message_carries_a_file() {
        let (here, there) = pair().expect("sockets");
        let file = File::open("/proc/self/status").expect("a file");
        send(here.as_fd(), b"one", Some(file.as_fd())).expect("sent");
        send(here.as_fd(), b"two", None).expect("sent");
        let (message, carried) = receive(there.as_fd()).expect("received");
        assert_eq!(message, b"one");
        let mut text = String::new();
        File::from(carried.expect("a file")).read_to_string(&mut text).expect("readable");
        assert!(text.starts_with("Name:"));
        let (message, carried) = receive(there.as_fd()).expect("received");
        assert!(message == b"two" && carried.is_none());
        drop(here);
        assert!(receive(there.as_fd()).expect("the end").0.is_empty());
    }
}
