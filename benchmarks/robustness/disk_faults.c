/* A disk quota and a wall clock that a file controls, for one process: preloaded by disk_faults.py.
 *
 * FAULT_UNDER   folder whose files have the quota
 * FAULT_QUOTA   file with the number of bytes that may still be written; no quota while it is missing
 * FAULT_CLOCK   file with the seconds by which the wall clock is wrong; right while it is missing
 *
 * A kernel without quota formats refuses nothing, and the machine's clock is everybody's: both are
 * answered here as the kernel would.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static atomic_llong written;

/* Read the number in the file that an environment variable names; 0 if there is none. */
static int number_in(const char *variable, long long *number)
{
    char text[32];
    const char *path = getenv(variable);
    int file = path ? (int)syscall(SYS_openat, AT_FDCWD, path, O_RDONLY | O_CLOEXEC) : -1;
    ssize_t length;
    if (file < 0)
        return 0;
    length = read(file, text, sizeof text - 1);
    close(file);
    if (length <= 0)
        return 0;
    text[length] = 0;
    *number = atoll(text);
    return 1;
}

static int is_under(int file)
{
    char link[32], path[4096];
    const char *folder = getenv("FAULT_UNDER");
    ssize_t length;
    if (!folder)
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    length = readlink(link, path, sizeof path - 1);
    return length > 0 && !strncmp(path, folder, strlen(folder));
}

static int is_refused(int file, size_t count)
{
    long long allowed;
    if (!is_under(file) || !number_in("FAULT_QUOTA", &allowed))
        return 0;
    return atomic_fetch_add(&written, (long long)count) + (long long)count > allowed;
}

ssize_t write(int file, const void *bytes, size_t count)
{
    if (is_refused(file, count)) {
        errno = EDQUOT;
        return -1;
    }
    return syscall(SYS_write, file, bytes, count);
}

/* The C library's own, which writes without calling the function above: numpy uses it. */
size_t fwrite(const void *bytes, size_t size, size_t count, FILE *stream)
{
    size_t done;
    if (is_refused(fileno(stream), size * count)) {
        errno = EDQUOT;
        return 0;
    }
    flockfile(stream);
    done = fwrite_unlocked(bytes, size, count, stream);
    funlockfile(stream);
    return done;
}

static long long offset_s(void)
{
    long long offset = 0;
    int before = errno;
    number_in("FAULT_CLOCK", &offset);
    errno = before;
    return offset;
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    int result = (int)syscall(SYS_clock_gettime, clock, now);
    if (!result && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        now->tv_sec += offset_s();
    return result;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
    struct timespec exact;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &exact);
    now->tv_sec = exact.tv_sec;
    now->tv_usec = exact.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *result)
{
    struct timespec exact;
    clock_gettime(CLOCK_REALTIME, &exact);
    if (result)
        *result = exact.tv_sec;
    return exact.tv_sec;
}
