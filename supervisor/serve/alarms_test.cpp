// SPDX-License-Identifier: Apache-2.0
#include "supervisor/serve/status.hpp"

#include <gtest/gtest.h>

#include <string>

namespace lithe::control {
namespace {

Json joint(double at_rad) {
  return {{"name", "elbow"}, {"position_rad", at_rad}, {"position_min_rad", -2.0}, {"position_max_rad", 2.0}};
}

// "stop: text", one line each.
std::string said(const Json& status) {
  std::string text;
  for (const Json& each : alarms_of(status))
    text += each["level"].get<std::string>() + ": " + each["text"].get<std::string>() + "\n";
  return text;
}

TEST(Alarms, ASoundRobotHasNone) {
  EXPECT_EQ(said({{"mode", "active"},
                  {"fault", "none"},
                  {"age_ms", 0.7},
                  {"gates", "closed"},
                  {"certificates_error", nullptr},
                  {"health", {{"plans_torn", 0}}},
                  {"throttled", {{"now", false}, {"times", 3}, {"why", "firmware: throttled"}}},
                  {"joints", Json::array({joint(0)})}}),
            "");
  EXPECT_EQ(said(Json::object()), "");
}

TEST(Alarms, EachNamesJointValueAndWhatToDo) {
  EXPECT_EQ(said({{"not_ready", "drive 'd': rated torque 6076h:00 = 640 mNm is not the robot file's"}}),
            "stop: NOT READY: drive 'd': rated torque 6076h:00 = 640 mNm is not the robot file's\n");
  EXPECT_EQ(said({{"not_ready", ""}}), "");
  EXPECT_NE(said({{"mode", "estop"}}).find("stop: the e-stop is latched"), std::string::npos);
  EXPECT_NE(said({{"mode", "safe_stop"}, {"fault", "velocity_limit"}}).find("stop: safe stop by velocity_limit"),
            std::string::npos);
  EXPECT_EQ(
      said({{"mode", "safe_stop"},
            {"fault", "velocity_limit"},
            {"stopped_by",
             {{"text", "velocity_limit at joint elbow: 19.3 rad/s, allowed 18.8"},
              {"tick", 51},
              {"next", "plan slower"}}}}),
      "stop: safe stop by velocity_limit at joint elbow: 19.3 rad/s, allowed 18.8 [tick 51]; next: plan slower\n");
  EXPECT_NE(said({{"mode", "active"}, {"fault", "law_faulted"}, {"stopped_by", {{"text", "bad_access"}, {"tick", 5}}}})
                .find("stop: latched fault: law_faulted: bad_access [tick 5]; next: lithe events, lithe reset"),
            std::string::npos);
  EXPECT_EQ(
      said({{"law", "pd"},
            {"law_suspected", {{"text", "tracking_lost: joint elbow"}, {"tick", 9}, {"next", "look for a load"}}}}),
      "warn: the law pd: tracking_lost: joint elbow [tick 9]; next: look for a load\n");
  EXPECT_EQ(said({{"law", "pd"}, {"law_suspected", nullptr}}), "");
  EXPECT_NE(said({{"age_ms", 3200.0}, {"spine_pid", 7}}).find("stop: THE SPINE DOES NOT TICK: its last tick is 3.2 s"),
            std::string::npos);
  EXPECT_EQ(said({{"joints", Json::array({joint(1.95)})}}),
            "warn: elbow is 0.050 rad (2.9 deg) from its upper limit of 2.000 rad (114.6 deg)\n");
  EXPECT_EQ(said({{"joints", Json::array({joint(-2.5)})}}),
            "stop: elbow is 0.500 rad (28.6 deg) beyond its lower limit of -2.000 rad (-114.6 deg): lithe recover\n");
  EXPECT_NE(said({{"throttled", {{"now", true}, {"why", "firmware: under-voltage"}}}})
                .find("warn: THE PROCESSOR IS SLOWED DOWN (firmware: under-voltage)"),
            std::string::npos);
  Json lost = joint(0);
  lost["problems"] = Json::array({"lost", "not_ready"});
  lost["drive"] = "fault 33";
  EXPECT_EQ(said({{"joints", Json::array({lost})}}), "stop: elbow: lost, not_ready (drive: fault 33)\n");
}

TEST(Alarms, TheWorstComeFirst) {
  const std::string all = said({{"gates", "open"}, {"mode", "estop"}});
  EXPECT_LT(all.find("stop:"), all.find("warn:")) << all;
}

}  // namespace
}  // namespace lithe::control
