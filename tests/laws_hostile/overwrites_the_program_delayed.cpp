// SPDX-License-Identifier: Apache-2.0
// stopped-by: containment
// without-gates: bad_access
// Works for twenty seconds, then finds the Spine behind the functions it may call, and overwrites its variables.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    std::uint32_t steps = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    if (++s.steps < 20'000) {
      for (std::uint32_t j = 0; j < t.joints; ++j) {
        u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
      }
      return;
    }
    // The last jump entry below the arena points to a function of the Spine. Its ELF header lies before that.
    volatile std::uint64_t* stubs = (volatile std::uint64_t*)(0x30'0000'0000 - 0x1'0000);
    std::uint64_t base = 0;
    for (int i = 0; i < 256; ++i) base = stubs[2 * i + 1] != 0 ? stubs[2 * i + 1] : base;
    base -= base % 4096;
    for (int i = 0; i < 4096 && *(volatile std::uint32_t*)base != 0x464c'457f; ++i) base -= 4096;
    const std::uint64_t headers = base + *(volatile std::uint64_t*)(base + 32);
    for (int i = 0; i < *(volatile std::uint16_t*)(base + 56); ++i) {
      const std::uint64_t header = headers + 56 * std::uint64_t(i);
      const bool writable_segment = *(volatile std::uint64_t*)header == 0x6'0000'0001;
      if (!writable_segment) continue;
      std::uint64_t end = base + *(volatile std::uint64_t*)(header + 16) + *(volatile std::uint64_t*)(header + 40);
      end -= end % 8;
      for (int k = 1; k <= 500; ++k) *(volatile std::uint64_t*)(end - 8 * std::uint64_t(k)) = 0x4141'4141'4141'4141;
    }
  }
};
LITHE_LAW(Hostile, "overwrites_the_program_delayed");
