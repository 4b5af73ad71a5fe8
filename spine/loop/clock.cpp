// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/clock.hpp"

#include <ctime>

namespace lithe::loop {

void start_clock(ClockMemory& memory) { ipc::ChannelWriter<RawClock>(memory).write(RawClock::calibrate()); }

void keep_clock(ClockMemory& memory, const std::atomic<bool>& stop) {
  constexpr timespec kInterval{0, 50 * kNsPerMs};
  ipc::ChannelWriter<RawClock> writer(memory);
  RawClock clock;
  ipc::ChannelReader<RawClock>(memory).read(clock);
  while (!stop.load(std::memory_order_relaxed)) {
    nanosleep(&kInterval, nullptr);
    clock = clock.resample();
    writer.write(clock);
  }
}

}  // namespace lithe::loop
