// SPDX-License-Identifier: Apache-2.0
// What people write: a thread at 1 kHz that sleeps with clock_nanosleep until each release; not pinned, usual priority.
// Nothing of LITHE is in it. Each line of standard input is a number of cycles; the answer is a line of JSON with the
// wake-up latency of each cycle [ns]. A release that has passed is not skipped: its latency shows how late it was.
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { kMostCycles = 1000000, kPeriodNs = 1000000 };

static int64_t now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * INT64_C(1000000000) + now.tv_nsec;
}

int main(void) {
  static int64_t late_ns[kMostCycles];
  long cycles = 0;
  puts("\"ready\"");
  fflush(stdout);
  while (scanf("%ld", &cycles) == 1 && cycles > 0 && cycles <= kMostCycles) {
    int64_t release_ns = now_ns();
    for (long i = 0; i < cycles; ++i) {
      release_ns += kPeriodNs;
      const struct timespec until = {release_ns / 1000000000, release_ns % 1000000000};
      clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
      late_ns[i] = now_ns() - release_ns;
    }
    for (long i = 0; i < cycles; ++i) printf("%c%lld", i == 0 ? '[' : ',', (long long)late_ns[i]);
    puts("]");
    fflush(stdout);
  }
  return 0;
}
