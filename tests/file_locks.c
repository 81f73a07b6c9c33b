/* Preloaded to simulate another machine whose file system has no locks between machines. RE4_TEST_FLOCK=free: every lock is free, as on
 * a file system that keeps locks on one machine; RE4_TEST_FLOCK=none: there are no locks. RE4_TEST_HOSTNAME is a file with the name of
 * the machine. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>

int flock(int file, int operation) {
    const char *locks = getenv("RE4_TEST_FLOCK");
    (void)file;
    (void)operation;
    if (locks && strcmp(locks, "none") == 0) {
        errno = ENOSYS;
        return -1;
    }
    return 0;
}

int open64(const char *path, int flags, ...) {
    static int (*next)(const char *, int, ...);
    const char *name = getenv("RE4_TEST_HOSTNAME");
    mode_t mode = 0;
    if (!next)
        *(void **)&next = dlsym(RTLD_NEXT, "open64");
    if (flags & (O_CREAT | O_TMPFILE)) {
        va_list rest;
        va_start(rest, flags);
        mode = va_arg(rest, mode_t);
        va_end(rest);
    }
    return next(name && strcmp(path, "/proc/sys/kernel/hostname") == 0 ? name : path, flags, mode);
}
