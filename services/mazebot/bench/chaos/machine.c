/* Loaded before all other libraries, it changes the machine that a program sees: seconds are added
 * to its wall clock, and what is written to files takes as long as on a disk of some speed. Both are
 * read from a file of sixteen bytes that stays mapped, so that they change while the program runs.
 * Monotonic clocks, and waiting by them, are as they are.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

#define NS_PER_S 1000000000LL
/* Of fsync, where the disk is slow. */
#define SYNC_NS 200000000LL

struct machine {
    int64_t added_s;
    int64_t disk_bytes_s; /* 0: as fast as it is */
};

static const volatile struct machine *seen;

/* Of a function that is replaced here, the one that would have been called. */
#define TRUE(name)                                                                                 \
    static __typeof__(&name) found;                                                                \
    if (!found)                                                                                    \
    found = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

__attribute__((constructor)) static void map_file(void) {
    const char *name = getenv("MACHINE_FILE");
    int file = name ? open(name, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0)
        return;
    void *mapped = mmap(NULL, sizeof *seen, PROT_READ, MAP_SHARED, file, 0);
    close(file);
    if (mapped != MAP_FAILED)
        seen = mapped;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    TRUE(clock_gettime);
    int failed = found(clock, now);
    if (!failed && seen && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        now->tv_sec += seen->added_s;
    return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    struct timespec exact;
    (void)zone;
    int failed = clock_gettime(CLOCK_REALTIME, &exact);
    if (!failed && now) {
        now->tv_sec = exact.tv_sec;
        now->tv_usec = exact.tv_nsec / 1000;
    }
    return failed;
}

time_t time(time_t *now) {
    struct timespec exact;
    if (clock_gettime(CLOCK_REALTIME, &exact))
        return -1;
    if (now)
        *now = exact.tv_sec;
    return exact.tv_sec;
}

/* Wait as long as a slow disk would take; pipes and sockets are none. */
static void write_slowly(int file, ssize_t bytes, int64_t least_ns) {
    int before = errno;
    int64_t bytes_s = seen ? seen->disk_bytes_s : 0;
    struct stat facts;
    if (bytes_s > 0 && bytes >= 0 && !fstat(file, &facts) && S_ISREG(facts.st_mode)) {
        int64_t ns = least_ns + bytes * NS_PER_S / bytes_s;
        struct timespec left = {ns / NS_PER_S, ns % NS_PER_S};
        while (nanosleep(&left, &left) && errno == EINTR)
            ;
    }
    errno = before;
}

ssize_t write(int file, const void *data, size_t size) {
    TRUE(write);
    ssize_t written = found(file, data, size);
    write_slowly(file, written, 0);
    return written;
}

ssize_t writev(int file, const struct iovec *pieces, int count) {
    TRUE(writev);
    ssize_t written = found(file, pieces, count);
    write_slowly(file, written, 0);
    return written;
}

ssize_t pwrite(int file, const void *data, size_t size, off_t at) {
    TRUE(pwrite);
    ssize_t written = found(file, data, size, at);
    write_slowly(file, written, 0);
    return written;
}

ssize_t pwrite64(int file, const void *data, size_t size, off64_t at) {
    TRUE(pwrite64);
    ssize_t written = found(file, data, size, at);
    write_slowly(file, written, 0);
    return written;
}

int fsync(int file) {
    TRUE(fsync);
    int failed = found(file);
    write_slowly(file, failed, SYNC_NS);
    return failed;
}

int fdatasync(int file) {
    TRUE(fdatasync);
    int failed = found(file);
    write_slowly(file, failed, SYNC_NS);
    return failed;
}
