/* Time that passes slower, for a process that valgrind makes slower: LD_PRELOAD, SLOWNESS is the factor. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/syscall.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

enum { CLOCKS = 16 };
static const int64_t SECOND = 1000000000;
static int64_t slowness, begun[CLOCKS];

__attribute__((constructor)) static void start(void)
{
  const char *text = getenv("SLOWNESS");
  slowness = text ? atoll(text) : 1;
}

int clock_gettime(clockid_t id, struct timespec *t)
{
  int failed = syscall(SYS_clock_gettime, id, t);
  if (failed || (id != CLOCK_REALTIME && id != CLOCK_MONOTONIC))
    return failed;
  int64_t now = t->tv_sec * SECOND + t->tv_nsec;
  if (begun[id] == 0)
    begun[id] = now;
  now = begun[id] + (now - begun[id]) / slowness;
  t->tv_sec = now / SECOND;
  t->tv_nsec = now % SECOND;
  return 0;
}

int epoll_wait(int fd, struct epoll_event *events, int n, int timeout_ms)
{
  int64_t left = timeout_ms > 0 ? timeout_ms * slowness : timeout_ms;
  return syscall(SYS_epoll_pwait, fd, events, n, (int)left, NULL, _NSIG / 8);
}

int timerfd_settime(int fd, int flags, const struct itimerspec *at, struct itimerspec *was)
{
  struct itimerspec slow = {.it_value = at->it_value}; /* CLOCK_MONOTONIC, absolute, once */
  int64_t begin = begun[CLOCK_MONOTONIC], left = at->it_value.tv_sec * SECOND + at->it_value.tv_nsec - begin;
  if (left > 0 && left < INT64_MAX / slowness - begin) {
    slow.it_value.tv_sec = (begin + left * slowness) / SECOND;
    slow.it_value.tv_nsec = (begin + left * slowness) % SECOND;
  }
  return syscall(SYS_timerfd_settime, fd, flags, &slow, was);
}
