/* Bytes to solutions in C, as imud.pipeline.Stream does it, chunk by chunk. kernels.c is translated from the kernels. */
#include "kernels.c"
#include <string.h>

int64_t replay(uint8_t *wire, int64_t size, int64_t chunk, int64_t period_ns, uint8_t *rx, int64_t rx_n,
               decoder_t *decoder, int64_t decoder_n, fit_t *clock, int64_t clock_n, sample_t *samples,
               int64_t samples_n, double *mount, int64_t mount_n, parameters_t *parameters, int64_t parameters_n,
               state_t *state, int64_t state_n, solution_t *solutions, int64_t solutions_n)
{
  int64_t fill = 0, total = 0;
  for (int64_t at = 0; at < size; at += chunk) {
    int64_t got = size - at < chunk ? size - at : chunk;
    memcpy(rx + fill, wire + at, got);
    int64_t n = decode(rx, rx_n, fill + got, decoder, decoder_n, samples, samples_n);
    fill = decoder->leftover;
    advance(samples, samples_n, n, (at + got) * period_ns, clock, clock_n, mount, mount_n, parameters, parameters_n,
            state, state_n, solutions, solutions_n);
    total += n;
  }
  return total;
}
