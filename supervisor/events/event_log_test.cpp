// SPDX-License-Identifier: Apache-2.0
#include "supervisor/events/event_log.hpp"

#include <gtest/gtest.h>

#include <algorithm>

#include "spine/core/time.hpp"
#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

wire::Event event_of(wire::EventKind kind, std::uint32_t code = 0) {
  wire::Event event;
  event.t_ns = 5;
  event.kind = static_cast<std::uint32_t>(kind);
  event.code = code;
  return event;
}

class EventJsonTest : public SpineRig {
 protected:
  void SetUp() override {
    attach([this](wire::RobotInfo& info) {
      info.joint_count = 1;
      std::copy(robot_.begin(), robot_.end(), info.robot.begin());
      std::copy_n("hip", 3, info.joint_name.begin());
      info.position_max_rad[0] = 1;
    });
  }
  void TearDown() override { ipc::remove_segment(ipc::Segment<ipc::BrainMemory>::path(robot_)); }
};

TEST_F(EventJsonTest, ARollbackIsToldWithTheLawThatRunsNow) {
  wire::LawInfo law{};
  law.law_id = 3;
  std::copy_n("pd", 2, law.name.begin());
  ipc::ChannelWriter<wire::LawInfo>((*spine_)->law_info[0]).write(law);
  wire::Event event = event_of(wire::EventKind::law_rolled_back, 3);
  std::copy_n("shaking", 7, event.text.begin());
  const Json told = event_json(event, *link_);
  EXPECT_EQ(told["law"], "pd");
  EXPECT_EQ(told["text"], "shaking; law pd runs now");
  event.code = 4;
  EXPECT_TRUE(event_json(event, *link_)["law"].is_null()) << "the safe law";
  event.value = 2;
  EXPECT_FALSE(event_json(event, *link_).contains("value")) << "it is the number of steps, and was not measured";
}

TEST_F(EventJsonTest, ARollbackIsToldWithWhatToDo) {
  for (const std::string why :
       {"tracking_lost: joint hip, error 0.312 rad, allowed 0.150",
        "guard_busy: joint hip clamped in 80.1 % of ticks, allowed 80: wants 12.000 N m of 0.600",
        "pushes_away: joint hip, error 1.512 rad, allowed 0.150: wants -6.000 N m",
        "gives_no_torque: joint hip, error 1.512 rad, allowed 0.150: wants 0.000 N m",
        "guard_stopped: joint hip, velocity_limit", "chattering: joint hip, 210 Hz, swings of 0.31, allowed 0.12 N m",
        "oscillating: joint hip, 31 Hz, swings of 20.00, allowed 1.50 rad/s",
        "overran: a step took 812.0 us, allowed 300.0, 3 times in a row", "overran", "not_finite: joint hip"}) {
    wire::Event event = event_of(wire::EventKind::law_rolled_back, 3);
    std::copy(why.begin(), why.end(), event.text.begin());
    const Json told = event_json(event, *link_);
    ASSERT_TRUE(told.contains("next")) << why;
    EXPECT_NE(event_line(told).find("; next: " + told["next"].get<std::string>()), std::string::npos) << why;
  }
  wire::Event event = event_of(wire::EventKind::law_rolled_back, 3);
  EXPECT_FALSE(event_json(event, *link_).contains("next")) << "somebody asked for it";
}

TEST_F(EventJsonTest, AStopAndALawsFaultAreToldWithWhatToDo) {
  const auto next_of = [&](wire::EventKind kind, std::string_view why) {
    wire::Event event = event_of(kind);
    std::copy(why.begin(), why.end(), event.text.begin());
    return event_json(event, *link_).value("next", "");
  };
  for (std::uint32_t code = 1; wire::to_string(static_cast<wire::Fault>(code)) != "?"; ++code) {
    const auto fault = static_cast<wire::Fault>(code);
    // The first has the kind of the law's fault as its text; the others are in no event of a stop.
    if (fault == wire::Fault::law_faulted || fault == wire::Fault::estop_pressed || fault == wire::Fault::law_missing)
      continue;
    const std::string why = std::string(wire::to_string(fault)) + " at joint hip, group leg: 9.0 rad/s, allowed 2.0";
    for (const auto kind : {wire::EventKind::safe_stop, wire::EventKind::group_stopped})
      EXPECT_NE(next_of(kind, why), "") << why;
  }
  for (std::uint32_t code = 1; wire::to_string(static_cast<wire::LawFaultKind>(code)) != "?"; ++code) {
    const std::string_view kind = wire::to_string(static_cast<wire::LawFaultKind>(code));
    EXPECT_NE(next_of(wire::EventKind::law_faulted, kind), "") << kind;
    EXPECT_NE(next_of(wire::EventKind::safe_stop, kind), "") << kind;
  }
  EXPECT_EQ(next_of(wire::EventKind::armed, "velocity_limit"), "");
}

TEST_F(EventJsonTest, WhatTheWatchSeesIsToldWithWhatToDo) {
  const auto told = [&](wire::LawFaultKind kind, std::string_view why) {
    wire::Event event = event_of(wire::EventKind::law_suspected, static_cast<std::uint32_t>(kind));
    std::copy(why.begin(), why.end(), event.text.begin());
    return event_json(event, *link_);
  };
  const Json law =
      told(wire::LawFaultKind::pushes_away, "pushes_away: joint hip, error 1.512 rad, allowed 0.150: wants -6.000 N m");
  EXPECT_EQ((Json{law["reason"], law["joint"], law["value"], law["limit"]}), (Json{"pushes_away", "hip", 1.512, 0.15}));
  EXPECT_EQ(law["next"], next_step("pushes_away"));
  const Json load = told(wire::LawFaultKind::tracking_lost,
                         "tracking_lost: joint hip, error 0.412 rad, allowed 0.150: wants 0.41 N m towards it");
  EXPECT_EQ((Json{load["joint"], load["value"], load["limit"]}), (Json{"hip", 0.412, 0.15}));
  EXPECT_NE(load["next"].get<std::string>().find("a load, an obstacle"), std::string::npos) << load;
}

TEST_F(EventJsonTest, AStopHasJointValueAndLimitAsFields) {
  const auto told = [&](std::string_view why) {
    wire::Event event = event_of(wire::EventKind::safe_stop);
    event.value = 3;  // that of a group's stop is the index of its joint
    std::copy(why.begin(), why.end(), event.text.begin());
    const Json all = event_json(event, *link_);
    return Json{all.value("joint", Json()), all.value("value", Json()), all.value("limit", Json())};
  };
  EXPECT_EQ(told("velocity_limit at joint hip: 19.3 rad/s, allowed 18.8"), (Json{"hip", 19.3, 18.8}));
  EXPECT_EQ(told("velocity_limit at joint hip, group leg: -19.3 rad/s, allowed 18.8"), (Json{"hip", -19.3, 18.8}));
  EXPECT_EQ(told("position_limit at joint hip: 2.613 rad, allowed -2.520 to 2.500"), (Json{"hip", 2.613, 2.5}));
  EXPECT_EQ(told("position_limit at joint hip: -2.613 rad, allowed -2.520 to 2.500"), (Json{"hip", -2.613, -2.52}));
  EXPECT_EQ(told("sample_stale: 3 ticks in a row without a new sample, allowed 2"), (Json{nullptr, 3.0, 2.0}));
  EXPECT_EQ(told("oscillating: joint hip, 31 Hz, swings of 20.00, allowed 1.50 rad/s"), (Json{"hip", 20.0, 1.5}));
  EXPECT_EQ(told("guard_busy: joint hip clamped in 80.1 % of ticks, allowed 80: wants 12.000 N m of 0.600"),
            (Json{"hip", 80.1, 80.0}));
  EXPECT_EQ(told("drive_lost at joint hip"), (Json{"hip", nullptr, nullptr}));
  EXPECT_EQ(told("not_finite: joint hippo, torque_nm"), (Json{nullptr, nullptr, nullptr})) << "no joint of this robot";
  const std::string cut = "velocity_limit at joint hip, group " + std::string(37, 'g') + ": 19.3 rad/s, allowed 1";
  EXPECT_EQ(told(cut), (Json{"hip", nullptr, nullptr})) << "the limit may have had more digits";
}

TEST_F(EventJsonTest, ARefusedPlanHasJointValueAndLimitWhateverPlanCameSince) {
  wire::Event event =
      event_of(wire::EventKind::plan_refused, static_cast<std::uint32_t>(wire::PlanReject::position_limit));
  const std::string_view text = "position_limit at joint hip, waypoint 1: 1.500 rad, allowed 0.000 to 1.000";
  std::copy(text.begin(), text.end(), event.text.begin());
  const Json told = event_json(event, *link_);
  EXPECT_EQ(told["text"], text);
  EXPECT_EQ((Json{told["joint"], told["value"], told["limit"]}), (Json{"hip", 1.5, 1.0}));
  EXPECT_FALSE(told.contains("next"));
}

TEST(EventLog, HandsOutEachEventOnceByCursor) {
  EventLog log;
  for (int i = 0; i < 3; ++i) log.add({{"kind", "armed"}});
  const Json first = log.since(0, 2);
  EXPECT_EQ(first["events"].size(), 2U);
  EXPECT_EQ(first["cursor"], 2);
  const Json second = log.since(2, 10);
  ASSERT_EQ(second["events"].size(), 1U);
  EXPECT_EQ(second["events"][0]["cursor"], 3);
  EXPECT_TRUE(log.since(3, 10)["events"].empty());
}

TEST(EventLog, ACursorFromAnotherLifeIsNoReasonToFail) {
  EventLog log;
  EXPECT_TRUE(log.since(77, 10)["events"].empty());
  log.add({{"kind", "armed"}});
  EXPECT_TRUE(log.since(~std::uint64_t{0}, 10)["events"].empty());
}

TEST(EventLog, SaysHowManyAnOldCursorHasLost) {
  EventLog log;
  for (std::size_t i = 0; i < EventLog::kDepth + 10; ++i) log.add({{"kind", "armed"}});
  const Json all = log.since(0, EventLog::kDepth);
  EXPECT_EQ(all["lost"], 10);
  EXPECT_EQ(all["events"][0]["cursor"], 11);
}

TEST(EventLog, KeepsTheLastStopUntilTheReset) {
  EventLog log;
  EXPECT_TRUE(log.last_stop().is_null());
  log.add({{"kind", "safe_stop"}, {"text", "drive_lost at joint hip"}});
  log.add({{"kind", "held"}});
  EXPECT_EQ(log.last_stop()["text"], "drive_lost at joint hip");
  log.add({{"kind", "reset"}});
  EXPECT_TRUE(log.last_stop().is_null());
}

// A law is not to blame for what a joint did while the computer stood still.
TEST(EventLog, AStopAfterTheComputerStoodStillNamesIt) {
  const std::int64_t late_ns = 5 * kNsPerS;
  const std::string advice = "give the law less gain";
  const auto next_of = [&](std::int64_t t_ns, const char* text, int skipped) {
    EventLog log;
    log.add({{"kind", "deadline_missed"}, {"t_ns", late_ns}, {"code", skipped}});
    log.add({{"kind", "safe_stop"}, {"t_ns", t_ns}, {"text", text}, {"next", advice}});
    EXPECT_EQ(log.since(0, 2)["events"][1]["next"], log.last_stop()["next"]) << "the alarm has the same words";
    return log.last_stop()["next"].get<std::string>();
  };
  const std::string soon = next_of(late_ns + kNsPerS, "velocity_limit at joint hip", 20);
  EXPECT_TRUE(soon.starts_with(advice + "; within the 2 s before, the computer stood still")) << soon;
  EXPECT_EQ(next_of(late_ns + kNsPerS, "velocity_limit at joint hip", 1), advice)
      << "that comes within any 2 s of a busy computer";
  EXPECT_EQ(next_of(late_ns + 2 * kNsPerS, "velocity_limit at joint hip", 20), advice);
  EXPECT_EQ(next_of(late_ns + kNsPerS, "drive_lost at joint hip", 20), advice);
  EXPECT_EQ(next_of(late_ns + kNsPerS, "deadline_missed", 20), advice) << "it says so itself";
}

TEST(EventJson, PutsTheCodeIntoTheWordsOfItsKind) {
  EXPECT_EQ(event_json(event_of(wire::EventKind::fault, 4))["reason"], "velocity_limit");
  EXPECT_EQ(event_json(event_of(wire::EventKind::law_refused, 3))["reason"], "abi_mismatch");
  EXPECT_FALSE(event_json(event_of(wire::EventKind::law_committed, 3)).contains("reason"));
}

TEST(EventJson, TextWithoutItsEndStaysInsideTheField) {
  wire::Event event = event_of(wire::EventKind::armed);
  event.text.fill('x');
  EXPECT_EQ(event_json(event)["text"].get<std::string>().size(), event.text.size());
}

TEST(NoiseFilter, SumsUpWhatComesTooOftenAndPassesTheRest) {
  NoiseFilter noise;
  const wire::Event late = event_of(wire::EventKind::sample_late);
  EXPECT_TRUE(noise.passes(late, 0));
  EXPECT_FALSE(noise.passes(late, 1));
  EXPECT_FALSE(noise.passes(late, 2));
  EXPECT_TRUE(noise.passes(event_of(wire::EventKind::fault), 3));
  EXPECT_TRUE(noise.summaries(4).empty());
  const auto summaries = noise.summaries(NoiseFilter::kWindowNs);
  ASSERT_EQ(summaries.size(), 1U);
  EXPECT_EQ(summaries[0].count, 2U);
  EXPECT_TRUE(noise.passes(late, NoiseFilter::kWindowNs + 1));
}

}  // namespace
}  // namespace lithe::control
