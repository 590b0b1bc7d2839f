/* Bytes to solutions in C, chunk by chunk as a daemon that catches up. kernels.c is translated from the kernels. */
#include "kernels.c"
#include <string.h>

int64_t replay(const uint8_t *wire, int64_t size, int64_t chunk, int64_t period_ns, const uint8_t *begin)
{
  int64_t total = 0;
  for (size_t i = 0; i < sizeof memory / sizeof *memory; begin += memory[i++].size)
    memcpy(memory[i].at, begin, memory[i].size);
  fill = 0;
  for (int64_t at = 0; at < size; at += chunk) {
    int64_t got = size - at < chunk ? size - at : chunk;
    memcpy(RX + fill, wire + at, got);
    total += ingest(got, (at + got) * period_ns);
  }
  return total;
}
