/* Time that passes slower, for a process that valgrind makes slower: LD_PRELOAD, SLOWNESS is the factor. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { CLOCKS = 16 };
static const int64_t SECOND = 1000000000;
static int64_t slowness;

__attribute__((constructor)) static void start(void)
{
  const char *text = getenv("SLOWNESS");
  slowness = text ? atoll(text) : 1;
}

int clock_gettime(clockid_t id, struct timespec *t)
{
  static int64_t begun[CLOCKS];
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
