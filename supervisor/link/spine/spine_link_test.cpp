// SPDX-License-Identifier: Apache-2.0
// With the segments of a Spine that is not there.
#include "supervisor/link/spine/spine_link.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <optional>
#include <thread>

#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

using wire::EventKind;

class SpineLinkTest : public SpineRig {
 protected:
  void SetUp() override {
    attach([](wire::RobotInfo&) {});
  }
  static wire::Event event(EventKind kind, std::int64_t t_ns) {
    wire::Event made;
    made.kind = static_cast<std::uint32_t>(kind);
    made.t_ns = t_ns;
    return made;
  }
};

TEST_F(SpineLinkTest, MergesBothRingsByTime) {
  ipc::RingWriter<wire::Event, wire::spine_segment::kEventsTickDepth> tick((*spine_)->events_tick);
  ipc::RingWriter<wire::Event, wire::spine_segment::kEventsLoaderDepth> loader((*spine_)->events_loader);
  tick.push(event(EventKind::law_committed, 2));
  loader.push(event(EventKind::law_staged, 1));
  loader.push(event(EventKind::law_retired, 3));
  const auto seen = link_->drain_events();
  ASSERT_EQ(seen.size(), 3U);
  EXPECT_EQ(seen[0].t_ns, 1);
  EXPECT_EQ(seen[1].t_ns, 2);
  EXPECT_EQ(seen[2].t_ns, 3);
  EXPECT_TRUE(link_->drain_events().empty());
}

TEST_F(SpineLinkTest, TheLastWordOfASpineIsTheLastAndNoOther) {
  ipc::RingWriter<wire::Event, wire::spine_segment::kEventsTickDepth> tick((*spine_)->events_tick);
  EXPECT_EQ(link_->confirmed_off(), std::nullopt) << "it died without a word";
  tick.push(event(EventKind::disarmed, 1));
  EXPECT_EQ(link_->confirmed_off(), std::nullopt) << "by command: it ran on";
  wire::Event last = event(EventKind::disarmed, 2);
  last.code = 2;
  tick.push(last);
  EXPECT_EQ(link_->confirmed_off(), false);
  last.code = 1;
  tick.push(last);
  EXPECT_EQ(link_->confirmed_off(), true);
  tick.push(event(EventKind::armed, 3));
  EXPECT_EQ(link_->confirmed_off(), std::nullopt);
}

// A Spine that rolls laws back and lets them go, as fast as it can, a ring's depth at most ahead of its reader.
TEST_F(SpineLinkTest, NoLawIsSeenRetiredBeforeItsRollback) {
  constexpr std::int64_t kLaws = 200'000;
  std::atomic<std::int64_t> retired{0};
  std::thread writer([&] {
    ipc::RingWriter<wire::Event, wire::spine_segment::kEventsTickDepth> tick((*spine_)->events_tick);
    ipc::RingWriter<wire::Event, wire::spine_segment::kEventsLoaderDepth> loader((*spine_)->events_loader);
    for (std::int64_t law = 1; law <= kLaws; ++law) {
      while (law - retired > 30) std::this_thread::yield();
      tick.push(event(EventKind::law_rolled_back, 2 * law));
      loader.push(event(EventKind::law_retired, 2 * law + 1));
    }
  });
  std::int64_t rolled_back = 0;
  std::int64_t too_early = 0;
  while (retired < kLaws) {
    for (const wire::Event& each : link_->drain_events()) {
      if (each.kind == static_cast<std::uint32_t>(EventKind::law_retired)) {
        too_early += rolled_back < each.t_ns - 1 ? 1 : 0;
        retired = each.t_ns / 2;
      } else {
        rolled_back = each.t_ns;
      }
    }
  }
  writer.join();
  EXPECT_EQ(too_early, 0);
  EXPECT_EQ(link_->lost_events(), 0U);
}

}  // namespace
}  // namespace lithe::control
