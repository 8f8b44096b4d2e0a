/*
 * Makes input and output fail, for tests that start themselves with this library in LD_PRELOAD.
 *
 * disk_arm(), or PANOSCOPE_DISK_FAULT, names a folder and which of the operations on its files fails. Counted are opening for writing, write, fsync, ftruncate,
 * rename and unlink, in the order in which they happen. Everything else goes to the C library.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

/* From the N-th on nothing more fits: half of the first write does. What needs no room goes on. */
#define FULL 1
/* The N-th fails once with EIO; of a write nothing is done. */
#define EIO_ONCE 2
/* As EIO_ONCE, but half of the write is done. */
#define EIO_TORN 3
/* From the N-th on everything fails with EIO: the device is gone. */
#define GONE 4
/* The process is killed at the N-th. */
#define KILL 5
/* As KILL, but half of the write is done. */
#define KILL_TORN 6

enum operation { OPEN, WRITE, OTHER };

#define MOST_FILES 4096
static char folder[4096];
static atomic_int mode, countdown, fired, torn;
static atomic_char watched[MOST_FILES];

__attribute__((visibility("default"))) void disk_arm(const char *where, int how, int number) {
    strncpy(folder, where, sizeof folder - 1);
    atomic_store(&fired, 0);
    atomic_store(&torn, 0);
    atomic_store(&countdown, number);
    atomic_store(&mode, how);
}

/* A program that does not know this library is configured by the environment: "MODE NUMBER FOLDER". */
__attribute__((constructor)) static void arm_by_environment(void) {
    const char *wanted = getenv("PANOSCOPE_DISK_FAULT");
    int how = 0, number = 0, length = 0;
    if (wanted && sscanf(wanted, "%d %d %n", &how, &number, &length) == 2) {
        disk_arm(wanted + length, how, number);
    }
}

/* Answers whether the fault came. */
__attribute__((visibility("default"))) int disk_disarm(void) {
    atomic_store(&mode, 0);
    return atomic_load(&fired);
}

static int is_inside(const char *path) {
    return atomic_load(&mode) != 0 && path && strncmp(path, folder, strlen(folder)) == 0;
}

static int is_watched(int fd) {
    return atomic_load(&mode) != 0 && fd >= 0 && fd < MOST_FILES && atomic_load(&watched[fd]);
}

/* Answers the error of this operation, 0 for none, -1 for half a write. */
static int verdict(enum operation operation, size_t len) {
    const int how = atomic_load(&mode);
    const int left = atomic_fetch_sub(&countdown, 1);
    if (left > 1 || (left < 1 && how != FULL && how != GONE && !atomic_load(&torn))) {
        return 0;
    }
    if (left < 1 && how == EIO_TORN) {
        /* The rest of the write that was torn, if that is what comes. */
        atomic_store(&torn, 0);
        return operation == WRITE ? EIO : 0;
    }
    if (left < 1 && how == KILL_TORN) {
        kill(getpid(), SIGKILL);
    }
    if (how == FULL && operation == OTHER) {
        return 0;
    }
    const int first = atomic_exchange(&fired, 1) == 0;
    const int half = operation == WRITE && len > 1 && first;
    switch (how) {
    case FULL:
        return half ? -1 : ENOSPC;
    case EIO_TORN:
        atomic_store(&torn, half);
        return half ? -1 : EIO;
    case KILL_TORN:
        if (half) {
            atomic_store(&torn, 1);
            return -1;
        }
        /* fall through */
    case KILL:
        kill(getpid(), SIGKILL);
        return EIO;
    default:
        return EIO;
    }
}

#define REAL(NAME) ((__typeof__(&NAME))dlsym(RTLD_NEXT, #NAME))
#define EXPORT __attribute__((visibility("default")))

static int opened(const char *path, int fd) {
    if (fd >= 0 && fd < MOST_FILES) {
        atomic_store(&watched[fd], is_inside(path));
    }
    return fd;
}

static int may_open(const char *path, int flags) {
    if (!is_inside(path) || (flags & O_ACCMODE) == O_RDONLY) {
        return 0;
    }
    /* An existing file needs no room to be opened. */
    if (atomic_load(&mode) == FULL && access(path, F_OK) == 0) {
        return 0;
    }
    const int error = verdict(OPEN, 0);
    return error > 0 ? error : 0;
}

#define OPENS(NAME)                                        \
    EXPORT int NAME(const char *path, int flags, ...) {    \
        va_list arguments;                                 \
        va_start(arguments, flags);                        \
        const mode_t rights = va_arg(arguments, mode_t);   \
        va_end(arguments);                                 \
        const int error = may_open(path, flags);           \
        if (error) {                                       \
            errno = error;                                 \
            return -1;                                     \
        }                                                  \
        return opened(path, REAL(NAME)(path, flags, rights)); \
    }
OPENS(open)
OPENS(open64)

#define OPENS_AT(NAME)                                              \
    EXPORT int NAME(int at, const char *path, int flags, ...) {     \
        va_list arguments;                                          \
        va_start(arguments, flags);                                 \
        const mode_t rights = va_arg(arguments, mode_t);            \
        va_end(arguments);                                          \
        const int error = may_open(path, flags);                    \
        if (error) {                                                \
            errno = error;                                          \
            return -1;                                              \
        }                                                           \
        return opened(path, REAL(NAME)(at, path, flags, rights)); \
    }
OPENS_AT(openat)
OPENS_AT(openat64)

/* Whether a write stays inside the file as it is: a full disk has room for that. */
static int is_in_place(int fd, size_t len) {
    struct stat found;
    const off_t at = lseek(fd, 0, SEEK_CUR);
    return at >= 0 && fstat(fd, &found) == 0 && S_ISREG(found.st_mode) && at + (off_t)len <= found.st_size;
}

EXPORT ssize_t write(int fd, const void *bytes, size_t len) {
    const int free_of_charge = atomic_load(&mode) == FULL && is_in_place(fd, len);
    const int error = is_watched(fd) && !free_of_charge ? verdict(WRITE, len) : 0;
    if (error > 0) {
        errno = error;
        return -1;
    }
    return REAL(write)(fd, bytes, error < 0 ? len / 2 : len);
}

EXPORT ssize_t writev(int fd, const struct iovec *parts, int count) {
    if (!is_watched(fd)) {
        return REAL(writev)(fd, parts, count);
    }
    /* A short write, as the contract of writev allows. */
    for (int i = 0; i < count; i++) {
        if (parts[i].iov_len > 0) {
            return write(fd, parts[i].iov_base, parts[i].iov_len);
        }
    }
    return 0;
}

#define OTHERS(NAME, PARAMETERS, IS_OURS, ARGUMENTS)             \
    EXPORT int NAME PARAMETERS {                                 \
        const int error = (IS_OURS) ? verdict(OTHER, 0) : 0;     \
        if (error > 0) {                                         \
            errno = error;                                       \
            return -1;                                           \
        }                                                        \
        return REAL(NAME) ARGUMENTS;                             \
    }
OTHERS(fsync, (int fd), is_watched(fd), (fd))
OTHERS(ftruncate, (int fd, off_t len), is_watched(fd), (fd, len))
OTHERS(ftruncate64, (int fd, off64_t len), is_watched(fd), (fd, len))
OTHERS(rename, (const char *from, const char *to), is_inside(from), (from, to))
OTHERS(unlink, (const char *path), is_inside(path), (path))

EXPORT int close(int fd) {
    if (fd >= 0 && fd < MOST_FILES) {
        atomic_store(&watched[fd], 0);
    }
    return REAL(close)(fd);
}
