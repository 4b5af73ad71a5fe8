// SPDX-License-Identifier: Apache-2.0
// A tap sees what passes while somebody watches, and the bus is the same with and without it.
#include "spine/hal/core/tap.hpp"

#include <gtest/gtest.h>

#include <cstdint>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::hal {
namespace {

class Watcher final : public FrameTap {
 public:
  bool wanted(std::int64_t) LITHE_RT override { return watches; }
  void saw(std::uint32_t bus, bool outbound, const Frame& frame) LITHE_RT override {
    ++(outbound ? out : in)[bus % 3];
    last = frame;
  }
  void counted(std::uint32_t bus, const BusStatistics& statistics) LITHE_RT override {
    received[bus % 3] = statistics.received;
  }

  bool watches = true;
  std::uint64_t out[3]{}, in[3]{}, received[3]{};
  Frame last;
};

TEST(Tap, SeesEveryFrameOfEveryBusByItsNumberAndAllocatesNothing) {
  const auto config = robot::load_robot(LITHE_ROBOTS "/frankenstein.toml");
  ASSERT_TRUE(config) << config.message();
  Watcher watcher;
  auto with = sim::open_actuators(*config, &watcher);
  auto without = sim::open_actuators(*config);
  ASSERT_TRUE(with && without);
  ActuatorCommand command;
  ActuatorState seen, unseen;
  const auto tick = [&](std::int64_t from, std::int64_t to) {
    for (std::int64_t i = from; i < to; ++i) {
      (*with)->cycle(command, seen, i * 1'000'000);
      (*without)->cycle(command, unseen, i * 1'000'000);
    }
  };
  tick(1, 3);
  {
    const NoAllocScope scope;
    tick(3, 129);
  }
  EXPECT_EQ(watcher.out[0], 3U * 128) << "three drives";
  EXPECT_EQ(watcher.in[0], 3U * 128);
  EXPECT_GT(watcher.out[2], 128U) << "SYNC at least";
  EXPECT_GT(watcher.received[0], 0U);
  EXPECT_EQ(seen.position_rad, unseen.position_rad);
  EXPECT_EQ(seen.status, unseen.status);
  watcher.watches = false;
  const std::uint64_t before = watcher.out[0];
  tick(129, 140);
  EXPECT_EQ(watcher.out[0], before);
}

}  // namespace
}  // namespace lithe::hal
