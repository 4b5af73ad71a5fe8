// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/buses/spines.hpp"

#include <gtest/gtest.h>
#include <stdlib.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "spine/ipc/frames.hpp"
#include "spine/ipc/segment.hpp"

namespace lithe::cli {
namespace {

using Spine = ipc::Segment<ipc::SpineMemory>;
using Frames = ipc::Segment<ipc::FramesMemory>;

class SpinesTest : public ::testing::Test {
 protected:
  void SetUp() override { setenv("LITHE_SHM_PREFIX", ("spines-test-" + std::to_string(getpid())).c_str(), 1); }
  void TearDown() override {
    for (const std::string& path : {Spine::path("arm"), Frames::path("arm")}) {
      std::filesystem::remove(path);
      std::filesystem::remove(path + ".lock");
    }
  }
  // As a Spine that is started shows its buses.
  Frames start_spine(const std::vector<std::string>& buses) {
    auto frames = Frames::create("arm");
    for (std::size_t i = 0; i < buses.size(); ++i)
      std::copy(buses[i].begin(), buses[i].end(), (*frames)->buses[i].name.begin());
    return std::move(*frames);
  }
  static void show(Frames& frames, std::size_t bus, std::uint32_t id) {
    ipc::FrameRecord record{};
    record.bus = static_cast<std::uint8_t>(bus);
    record.id = id;
    ipc::RingWriter<ipc::FrameRecord, ipc::FramesMemory::kDepth>(frames->ring).push(record);
  }
};

TEST_F(SpinesTest, AMonitorFollowsItsBusByNameWhenTheFilesOrderChanges) {
  auto lease = ipc::Lease::try_take(Spine::path("arm"));
  ASSERT_TRUE(lease && lease->has_value());
  Frames first = start_spine({"left", "right"});
  const auto source = watch_spine({"arm", {}, 0, 3});  // "left"
  ASSERT_TRUE(source) << source.message();
  show(first, 0, 17);
  bus::CapturedFrame captured;
  ASSERT_TRUE((*source)->next(captured));
  EXPECT_EQ(captured.frame.id, 17u);
  EXPECT_EQ(captured.bus, 3u);
  Frames second = start_spine({"right", "left"});
  EXPECT_EQ((*source)->why_down(), "");
  show(second, 0, 18);
  show(second, 1, 19);
  ASSERT_TRUE((*source)->next(captured));
  EXPECT_EQ(captured.frame.id, 19u) << "of the bus 'left', which is now the second";
  EXPECT_FALSE((*source)->next(captured));
  Frames third = start_spine({"right"});
  EXPECT_NE((*source)->why_down().find("has no bus 'left' any more"), std::string::npos);
  show(third, 0, 20);
  EXPECT_FALSE((*source)->next(captured));
  EXPECT_EQ((*source)->errors(3), 0u);
}

}  // namespace
}  // namespace lithe::cli
