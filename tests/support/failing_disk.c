/* Lets writes and syncs of files below $FAILING_FOLDER fail with EIO, as libfiu says: points disk/write, disk/sync.
 *
 * libfiu's own fiu_posix_preload.so cannot be used with programs of many threads that load libraries: it looks up
 * functions at their first call, mmap's within the loader among them, and waits there for the loader's lock for ever.
 */
#define _GNU_SOURCE
#define FIU_ENABLE 1 /* without it the header makes nothing fail */
#include <dlfcn.h>
#include <errno.h>
#include <fiu-control.h>
#include <fiu.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static ssize_t (*real_write)(int, const void *, size_t);
static ssize_t (*real_pwrite)(int, const void *, size_t, off_t);
static int (*real_fsync)(int);
static int (*real_fdatasync)(int);
static const char *folder;

__attribute__((constructor)) static void find(void)
{
    real_write = dlsym(RTLD_NEXT, "write");
    real_pwrite = dlsym(RTLD_NEXT, "pwrite");
    real_fsync = dlsym(RTLD_NEXT, "fsync");
    real_fdatasync = dlsym(RTLD_NEXT, "fdatasync");
    folder = getenv("FAILING_FOLDER");
    const char *seed = getenv("FAILING_SEED");
    if (seed)
        fiu_set_prng_seed((unsigned)atoi(seed));
}

static int fails(int fd, const char *point)
{
    char link[64], path[4096];
    if (!folder)
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path);
    size_t begin = strlen(folder);
    if (n < (ssize_t)begin || memcmp(path, folder, begin) != 0 || !fiu_fail(point))
        return 0;
    errno = EIO;
    return 1;
}

ssize_t write(int fd, const void *data, size_t n)
{
    return fails(fd, "disk/write") ? -1 : real_write(fd, data, n);
}

ssize_t pwrite(int fd, const void *data, size_t n, off_t at)
{
    return fails(fd, "disk/write") ? -1 : real_pwrite(fd, data, n, at);
}

int fsync(int fd)
{
    return fails(fd, "disk/sync") ? -1 : real_fsync(fd);
}

int fdatasync(int fd)
{
    return fails(fd, "disk/sync") ? -1 : real_fdatasync(fd);
}
