/* A daemon in C of the same function as imud's, for comparison: a port's bytes in, every state out to whoever connects.
 *
 * daemon TTY SOCKET MEMORY; MEMORY is a file with all that decoder, clock and filter begin with, as raw bytes.
 * One wait, one read and one send for each client per wake-up, nothing allocated in the loop. */
#define _GNU_SOURCE
#include "kernels.c"
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { READ = 4096, CLIENTS = 16 };

typedef __typeof__(*SOLUTIONS) solution_t;

struct message {
  char magic[4];
  uint16_t version, size;
  uint64_t seq;
  int64_t utc_offset_ns;
  solution_t state;
};

static int clients[CLIENTS], connected;

static void fail(const char *what)
{
  perror(what);
  exit(1);
}

static void load(const char *path)
{
  FILE *file = fopen(path, "rb");
  if (!file)
    fail(path);
  for (size_t i = 0; i < sizeof memory / sizeof *memory; i++)
    if (fread(memory[i].at, 1, memory[i].size, file) != memory[i].size)
      fail(path);
  fclose(file);
}

static int64_t now_ns(clockid_t id)
{
  struct timespec t;
  clock_gettime(id, &t);
  return t.tv_sec * INT64_C(1000000000) + t.tv_nsec;
}

static int open_port(const char *path)
{
  struct termios line;
  int fd = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK);
  if (fd < 0 || tcgetattr(fd, &line))
    fail(path);
  cfmakeraw(&line);
  tcsetattr(fd, TCSANOW, &line);
  return fd;
}

static int listen_at(const char *path)
{
  struct sockaddr_un address = {.sun_family = AF_UNIX};
  strncpy(address.sun_path, path, sizeof address.sun_path - 1);
  int fd = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
  if (fd < 0 || bind(fd, (struct sockaddr *)&address, sizeof address) || listen(fd, 8))
    fail(path);
  return fd;
}

static void publish(int64_t n, uint64_t seq)
{
  struct message message = {.magic = "IMUD", .version = 1, .size = sizeof message};
  message.utc_offset_ns = now_ns(CLOCK_REALTIME) - now_ns(CLOCK_MONOTONIC);
  for (int64_t k = 0; k < n; k++) {
    message.seq = seq - n + 1 + k;
    message.state = SOLUTIONS[k];
    for (int c = 0; c < connected; c++)
      if (send(clients[c], &message, sizeof message, MSG_DONTWAIT | MSG_NOSIGNAL) < 0 && errno != EAGAIN) {
        close(clients[c]);
        clients[c--] = clients[--connected];
      }
  }
}

int main(int argc, char **argv)
{
  if (argc != 4)
    return 64;
  load(argv[3]);
  int port = open_port(argv[1]), listener = listen_at(argv[2]), poll = epoll_create1(0);
  struct epoll_event event = {.events = EPOLLIN, .data.fd = port}, events[8];
  epoll_ctl(poll, EPOLL_CTL_ADD, port, &event);
  event.data.fd = listener;
  epoll_ctl(poll, EPOLL_CTL_ADD, listener, &event);
  uint64_t seq = 0;
  for (;;) {
    int ready = epoll_wait(poll, events, 8, 20);
    int64_t arrival_ns = now_ns(CLOCK_MONOTONIC);
    for (int i = 0; i < ready; i++) {
      if (events[i].data.fd == listener) {
        int client = accept(listener, NULL, NULL);
        if (client >= 0 && connected < CLIENTS)
          clients[connected++] = client;
        continue;
      }
      ssize_t got = read(port, RX + fill, READ);
      if (got <= 0)
        return 0;
      int64_t n = ingest(got, arrival_ns);
      seq += n;
      if (n)
        publish(n, seq);
    }
  }
}
