/* Lets calls of libc that change files below a folder fail, or kill the process; to be preloaded.
 *
 * By fail_call: the n-th call. Of a write that fails for want of room, half reaches the disk.
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
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

static struct shared { /* by this process and those that it forks */
    atomic_long calls;
    char failed[4200];
} *shared;
static char folder[4096];
static long failing; /* number of the call, from 1 on; 0 none */
static int failure;  /* errno; 0 kills */

__attribute__((constructor)) static void begin(void)
{
    shared = mmap(NULL, sizeof *shared, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
}

void fail_call(const char *below, long n, int number)
{
    shared->calls = 0;
    shared->failed[0] = 0;
    failing = n;
    failure = number;
    snprintf(folder, sizeof folder, "%s", below);
}

long counted_calls(void) { return shared->calls; }
const char *failed_call(void) { return shared->failed; }

static int fails_at(const char *what, const char *path)
{
    size_t n = strlen(folder);
    if (n == 0 || strncmp(path, folder, n) != 0)
        return 0;
    long call = atomic_fetch_add(&shared->calls, 1) + 1;
    if (call != failing)
        return 0;
    snprintf(shared->failed, sizeof shared->failed, "%s %s", what, path);
    if (failure == 0)
        kill(getpid(), SIGKILL);
    errno = failure;
    return 1;
}

static void place_of(int fd, char *path, size_t size)
{
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, size - 1);
    path[n < 0 ? 0 : n] = 0;
}

static int fails(const char *what, int fd)
{
    char path[4096];
    if (folder[0] == 0)
        return 0;
    int before = errno;
    place_of(fd, path, sizeof path);
    errno = before;
    return fails_at(what, path);
}

static int fails_in(const char *what, int fd, const char *name)
{
    char place[4096] = "", path[8300];
    if (folder[0] == 0 || name == NULL)
        return 0;
    if (name[0] == '/')
        return fails_at(what, name);
    int before = errno;
    if (fd == AT_FDCWD)
        place[0] = getcwd(place, sizeof place) ? place[0] : 0;
    else
        place_of(fd, place, sizeof place);
    errno = before;
    snprintf(path, sizeof path, "%s/%s", place, name);
    return fails_at(what, path);
}

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) \
        real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)
#define OF_FD(type, name, what, parameters, types, ...) \
    type name parameters \
    { \
        REAL(type, #name, types); \
        return fails(what, fd) ? -1 : real(__VA_ARGS__); \
    }
#define OF_NAME(name, what, parameters, types, in, path, ...) \
    int name parameters \
    { \
        REAL(int, #name, types); \
        return fails_in(what, in, path) ? -1 : real(__VA_ARGS__); \
    }
#define TYPES(...) __VA_ARGS__

ssize_t write(int fd, const void *data, size_t n)
{
    REAL(ssize_t, "write", int, const void *, size_t);
    if (!fails("write", fd))
        return real(fd, data, n);
    if (failure == ENOSPC)
        (void)!real(fd, data, n / 2);
    errno = failure;
    return -1;
}

OF_FD(ssize_t, pwrite, "write", (int fd, const void *data, size_t n, off_t at), TYPES(int, const void *, size_t, off_t), fd, data, n, at)
OF_FD(ssize_t, pwrite64, "write", (int fd, const void *data, size_t n, off64_t at), TYPES(int, const void *, size_t, off64_t), fd, data, n, at)
OF_FD(int, fsync, "sync", (int fd), TYPES(int), fd)
OF_FD(int, fdatasync, "sync", (int fd), TYPES(int), fd)
OF_FD(int, ftruncate, "truncate", (int fd, off_t n), TYPES(int, off_t), fd, n)
OF_FD(int, ftruncate64, "truncate", (int fd, off64_t n), TYPES(int, off64_t), fd, n)
OF_NAME(rename, "rename", (const char *a, const char *b), TYPES(const char *, const char *), AT_FDCWD, b, a, b)
OF_NAME(renameat, "rename", (int f, const char *a, int g, const char *b), TYPES(int, const char *, int, const char *), g, b, f, a, g, b)
OF_NAME(link, "link", (const char *a, const char *b), TYPES(const char *, const char *), AT_FDCWD, b, a, b)
OF_NAME(linkat, "link", (int f, const char *a, int g, const char *b, int h), TYPES(int, const char *, int, const char *, int), g, b, f, a, g, b, h)
OF_NAME(unlink, "unlink", (const char *a), TYPES(const char *), AT_FDCWD, a, a)
OF_NAME(unlinkat, "unlink", (int f, const char *a, int g), TYPES(int, const char *, int), f, a, f, a, g)
OF_NAME(rmdir, "rmdir", (const char *a), TYPES(const char *), AT_FDCWD, a, a)
OF_NAME(mkdir, "mkdir", (const char *a, mode_t m), TYPES(const char *, mode_t), AT_FDCWD, a, a, m)
OF_NAME(mkdirat, "mkdir", (int f, const char *a, mode_t m), TYPES(int, const char *, mode_t), f, a, f, a, m)
OF_NAME(chmod, "chmod", (const char *a, mode_t m), TYPES(const char *, mode_t), AT_FDCWD, a, a, m)
OF_NAME(fchmodat, "chmod", (int f, const char *a, mode_t m, int g), TYPES(int, const char *, mode_t, int), f, a, f, a, m, g)
OF_NAME(truncate, "truncate", (const char *a, off_t n), TYPES(const char *, off_t), AT_FDCWD, a, a, n)
OF_NAME(truncate64, "truncate", (const char *a, off64_t n), TYPES(const char *, off64_t), AT_FDCWD, a, a, n)

#define OPEN(name, parameters, types, in, ...) \
    int name parameters \
    { \
        REAL(int, #name, types, int, ...); \
        mode_t mode = 0; \
        if (flags & (O_CREAT | __O_TMPFILE)) { \
            va_list more; \
            va_start(more, flags); \
            mode = va_arg(more, mode_t); \
            va_end(more); \
        } \
        if ((flags & (O_CREAT | O_WRONLY | O_RDWR | O_TRUNC)) && fails_in("open", in, path)) \
            return -1; \
        return real(__VA_ARGS__, flags, mode); \
    }
OPEN(open, (const char *path, int flags, ...), TYPES(const char *), AT_FDCWD, path)
OPEN(open64, (const char *path, int flags, ...), TYPES(const char *), AT_FDCWD, path)
OPEN(openat, (int f, const char *path, int flags, ...), TYPES(int, const char *), f, f, path)
OPEN(openat64, (int f, const char *path, int flags, ...), TYPES(int, const char *), f, f, path)
