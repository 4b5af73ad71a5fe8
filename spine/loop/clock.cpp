// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/clock.hpp"

namespace lithe::loop {

void start_clock(ClockMemory& memory) { ipc::ChannelWriter<RawClock>(memory).write(RawClock::calibrate()); }

ClockKeeper::ClockKeeper(ClockMemory& memory) : writer_(memory) { ipc::ChannelReader<RawClock>(memory).read(clock_); }

void ClockKeeper::renew() {
  clock_ = clock_.resample();
  writer_.write(clock_);
}

}  // namespace lithe::loop
