// SPDX-License-Identifier: Apache-2.0
#include "supervisor/serve/status.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>

#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

// Law 3, committed with kp = 4, after law 2; the values of the running one are `kp` now.
class StatusTest : public SpineRig {
 protected:
  void SetUp() override {
    attach([](wire::RobotInfo& info) { info.joint_count = 1; });
    for (const std::uint32_t id : {2U, 3U}) {
      wire::LawInfo law;
      law.law_id = id;
      law.name = {'p', 'd'};
      law.param_count = 1;
      std::copy_n("kp", 2, law.param_name.begin());
      law.param_value[0] = 4;
      law.param_max[0] = 100;
      ipc::ChannelWriter<wire::LawInfo>((*spine_)->law_info[id]).write(law);
    }
    auto record = std::make_unique<wire::Telemetry>();
    record->tick = 1;
    record->law_id = 3;
    ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth>((*spine_)->telemetry).push(*record);
  }
  void set(double kp) {
    wire::Params live;
    live.law_id = 3;
    live.count = 1;
    live.value[0] = kp;
    ipc::ChannelWriter<wire::Params>((*spine_)->params).write(live);
  }
};

TEST_F(StatusTest, TheRunningLawsParametersAreThoseOfNowBesideThoseOfItsCommit) {
  set(8);
  EXPECT_EQ(status_json(*link_, {})["params"], (Json{{"kp", 8.0}}));
  const Json resident = resident_json(*link_);
  ASSERT_EQ(resident.size(), 2U);
  EXPECT_EQ(resident[0]["params"][0]["value"], 4.0) << "the other law's are not these";
  EXPECT_EQ(resident[1]["params"][0]["value"], 8.0);
  EXPECT_EQ(resident[1]["params"][0]["at_commit"], 4.0);
  set(4);
  EXPECT_FALSE(resident_json(*link_)[1]["params"][0].contains("at_commit")) << "they are the same";
}

}  // namespace
}  // namespace lithe::control
