/* The wall clock of one process, to be set by a test: LD_PRELOAD this, call step_wall_clock. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdatomic.h>
#include <sys/time.h>
#include <time.h>

#define SECOND 1000000000LL

static _Atomic long long offset_ns;

void step_wall_clock(long long ns) { offset_ns += ns; }

int clock_gettime(clockid_t clock, struct timespec *out) {
  static int (*original)(clockid_t, struct timespec *);
  if (!original) original = dlsym(RTLD_NEXT, "clock_gettime");
  int failed = original(clock, out);
  if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
    long long ns = out->tv_sec * SECOND + out->tv_nsec + offset_ns;
    out->tv_sec = ns / SECOND;
    out->tv_nsec = ns % SECOND;
  }
  return failed;
}

int gettimeofday(struct timeval *restrict out, void *restrict zone) {
  struct timespec now;
  (void)zone;
  clock_gettime(CLOCK_REALTIME, &now);
  *out = (struct timeval){now.tv_sec, now.tv_nsec / 1000};
  return 0;
}

time_t time(time_t *out) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (out) *out = now.tv_sec;
  return now.tv_sec;
}
