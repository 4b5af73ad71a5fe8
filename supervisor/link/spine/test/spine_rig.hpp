// SPDX-License-Identifier: Apache-2.0
// For tests: the shared memory of a Spine that is not there, with a link to it; and a law.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "spine/ipc/segment.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

inline constexpr const char* kRestLaw =
    "#include <lithe/law.hpp>\n"
    "struct Rest {\n"
    "  struct Params { lithe::Param gain{1.0, 0.0, 2.0}; };\n"
    "  struct State { double last_rad = 0.0; };\n"
    "  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& e) {\n"
    "    s.last_rad = t.position_rad[0]; e.torque_nm[0] = -p.gain * t.velocity_rad_s[0];\n"
    "  }\n"
    "};\n"
    "LITHE_LAW(Rest, \"rest\");\n";

class SpineRig : public testing::Test {
 protected:
  ~SpineRig() override {
    ipc::remove_segment(ipc::Segment<ipc::SpineMemory>::path(robot_));
    ipc::remove_segment(ipc::Segment<ipc::ControlMemory>::path(robot_));
  }
  // First of all: makes the memory, in which the Spine tells of its robot what `describe` fills in.
  void attach(const std::function<void(wire::RobotInfo&)>& describe) {
    spine_.emplace(std::move(*ipc::Segment<ipc::SpineMemory>::create(robot_)));
    control_.emplace(std::move(*ipc::Segment<ipc::ControlMemory>::create(robot_)));
    auto info = std::make_unique<wire::RobotInfo>();
    describe(*info);
    ipc::ChannelWriter<wire::RobotInfo>((*spine_)->robot_info).write(*info);
    auto link = SpineLink::attach(robot_);
    ASSERT_TRUE(link) << link.message();
    link_.emplace(std::move(*link));
  }

  std::string robot_ = "rig" + std::to_string(::getpid());
  std::optional<ipc::Segment<ipc::SpineMemory>> spine_;
  std::optional<ipc::Segment<ipc::ControlMemory>> control_;
  std::optional<SpineLink> link_;
};

}  // namespace lithe::control
