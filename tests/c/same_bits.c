/* Repeats recorded calls of kernels on this processor and compares every word: `same_bits FILE`. kernels.c and calls.c
   are written by tests/other_machines.py, which also says what FILE has. */
#include "kernels.c"
#include "calls.c" // static const struct { const char *name; int64_t (*call)(const int64_t *); } calls[]
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static FILE *file;

static int64_t number(void)
{
  int64_t value;
  if (fread(&value, sizeof value, 1, file) != 1)
    exit(2);
  return value;
}

static char *bytes(int64_t n)
{
  char *at = malloc(n + 1);
  if (at == NULL || (n && fread(at, n, 1, file) != 1))
    exit(2);
  at[n] = 0;
  return at;
}

/* mask, one byte for each byte of a record: 0 padding, 1 compared, 8 the first of a double, 9 the rest of it */
static int64_t different(const char *a, const char *b, int64_t size, const char *mask, int64_t record)
{
  int64_t n = 0;
  for (int64_t i = 0; i < size; i++) {
    char kind = mask[i % record];
    double x, y;
    if (kind == 8) {
      memcpy(&x, a + i, 8);
      memcpy(&y, b + i, 8);
      n += memcmp(&x, &y, 8) != 0 && !(x != x && y != y); // one NaN is as good as another
    } else if (kind == 1)
      n += a[i] != b[i];
  }
  return n;
}

int main(int count, char **arguments)
{
  int64_t wrong = 0, total = 0, made = 0;
  if (count != 2 || (file = fopen(arguments[1], "rb")) == NULL)
    return 2;
  for (int64_t length; (length = number()) > 0; made++) {
    char *name = bytes(length);
    int64_t words[64], n = 0, arrays = 0;
    char *memory[32], *after[32], *mask[32];
    int64_t size[32], record[32];
    for (int64_t left = number(); left > 0; left--) {
      int64_t items = number();
      if (items < 0) { // a number
        words[n++] = number();
        continue;
      }
      record[arrays] = number();
      size[arrays] = items * record[arrays];
      mask[arrays] = bytes(record[arrays]);
      memory[arrays] = bytes(size[arrays]);
      after[arrays] = bytes(size[arrays]);
      words[n++] = (int64_t)(intptr_t)memory[arrays++];
      words[n++] = items;
    }
    int64_t expected = number(), returned = 0, known = 0;
    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++)
      if (strcmp(calls[i].name, name) == 0)
        returned = calls[i].call(words), known = 1;
    int64_t bad = !known || returned != expected;
    for (int64_t i = 0; i < arrays; i++) {
      bad += different(memory[i], after[i], size[i], mask[i], record[i]);
      total += size[i];
      free(memory[i]);
      free(after[i]);
      free(mask[i]);
    }
    if (bad)
      printf("%s: call %" PRId64 " differs in %" PRId64 " words\n", name, made, bad);
    wrong += bad != 0;
    free(name);
  }
  printf("%" PRId64 " calls, %" PRId64 " bytes: %s\n", made, total, wrong ? "DIFFERENT" : "the same bits");
  return wrong != 0;
}
