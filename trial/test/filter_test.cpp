// SPDX-License-Identifier: Apache-2.0
// What a trial must still be able to do behind the filter of its parent.
#include <gtest/gtest.h>
#include <unistd.h>

#include <memory>
#include <string>

#include "spine/core/test/emulation_rig.hpp"
#include "spine/ipc/layout.hpp"
#include "spine/ipc/segment.hpp"
#include "trial/sandbox/sandbox.hpp"
#include "trial/sections/recording.hpp"

namespace lithe::trial {
namespace {

using Spine = ipc::Segment<ipc::SpineMemory>;

TEST(Filter, LetsATrialReadTheTelemetryOfTheRobotThatRuns) {
  if (const std::string why = test::why_no_trial(); !why.empty()) GTEST_SKIP() << why;
  const std::string robot = "trial_filter_" + std::to_string(getpid());
  const auto lease = ipc::Lease::try_take(Spine::path(robot));
  ASSERT_TRUE(lease && *lease);
  auto segment = Spine::create(robot);
  ASSERT_TRUE(segment) << segment.message();
  ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth> writer((*segment)->telemetry);
  const auto record = std::make_unique<wire::Telemetry>();
  record->joint_count = 2;
  for (record->tick = 1; record->tick < 100; ++record->tick) writer.push(*record);
  const auto behind_it = [&robot] {
    if (!allow_trials_only()) _exit(2);
    _exit(Recording(robot, 0, 2, 1e-3, 2.0).size() == 99 ? 0 : 1);
  };
  EXPECT_EXIT(behind_it(), testing::ExitedWithCode(0), "");
  ipc::remove_segment(Spine::path(robot));
  unlink((Spine::path(robot) + ".lock").c_str());
}

}  // namespace
}  // namespace lithe::trial
