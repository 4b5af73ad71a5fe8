// SPDX-License-Identifier: Apache-2.0
#include "supervisor/incident/incidents.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <string>

#include "spine/core/time.hpp"
#include "spine/ipc/ring.hpp"
#include "supervisor/incident/columns.hpp"
#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

namespace fs = std::filesystem;
using wire::EventKind;

class IncidentsTest : public SpineRig {
 protected:
  void SetUp() override {
    attach([](wire::RobotInfo& info) {
      info.rate_hz = 1000;
      info.joint_count = 2;
      std::copy_n("hip", 3, info.joint_name.begin());
      std::copy_n("knee", 4, info.joint_name.begin() + 32);
    });
    fs::remove_all(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }

  // Ticks `from` to `to`, 1 ms each; the knee's angle is its tick.
  void run(std::uint64_t from, std::uint64_t to) {
    ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth> writer((*spine_)->telemetry);
    wire::Telemetry record;
    record.mode = static_cast<std::uint32_t>(wire::Mode::active);
    for (record.tick = from; record.tick <= to; ++record.tick) {
      record.release_ns = at_ns(record.tick);
      record.position_rad[1] = static_cast<double>(record.tick);
      writer.push(record);
    }
  }
  static std::int64_t at_ns(std::uint64_t tick) { return static_cast<std::int64_t>(tick) * kNsPerMs; }
  void tell(EventKind kind, std::uint64_t tick, const std::string& text = "", std::uint32_t code = 0,
            std::uint64_t request_id = 0) {
    wire::Event event;
    event.code = code;
    event.request_id = request_id;
    std::copy(text.begin(), text.end(), event.text.begin());
    event.kind = static_cast<std::uint32_t>(kind);
    event.tick = tick;
    event.t_ns = at_ns(tick);
    const Json told = event_json(event);
    log_.add(told);
    incidents_.on_event(*link_, event, event_line(told));
  }
  Json show(std::uint64_t id = 0) const { return std::get<Json>(incidents_.show(id)); }

  fs::path folder_ = fs::temp_directory_path() / ("incidents" + std::to_string(::getpid()));
  EventLog log_;
  Incidents incidents_{folder_, log_};
};

TEST_F(IncidentsTest, KeepsASecondBeforeAndAfterWithTheEventsOfThatTime) {
  run(1, 3000);
  tell(EventKind::armed, 900);  // its own incident, and too early for the next one
  incidents_.finish(*link_);
  tell(EventKind::held, 2400);
  tell(EventKind::law_faulted, 2500);
  tell(EventKind::law_rolled_back, 2500);
  incidents_.serve(*link_, at_ns(3499));
  EXPECT_EQ(read_incidents(folder_).size(), 1U) << "its time is not over";
  run(3001, 4000);
  incidents_.serve(*link_, at_ns(3501));
  const Json told = show();
  EXPECT_EQ(told["id"], 2);
  EXPECT_EQ(told["kind"], "law_faulted") << "a fault goes before a change of mode";
  EXPECT_EQ(told["tick"], 2500);
  EXPECT_EQ(told["ticks"], 2001) << "1500 to 3500";
  EXPECT_EQ(told["mode"]["before"], "active");
  ASSERT_EQ(told["joints"].size(), 2U);
  EXPECT_EQ(told["joints"][1]["name"], "knee");
  EXPECT_EQ(told["joints"][1]["position_rad"], Json::array({1500.0, 3500.0}));
  ASSERT_EQ(told["events"].size(), 3U);
  EXPECT_EQ(told["events"][2]["kind"], "law_rolled_back");
  EXPECT_TRUE(fs::exists(folder_ / told["data"].get<std::string>()));
}

TEST_F(IncidentsTest, ASpineThatTheMachineHeldBackIsWaitedForOneThatEndedIsNot) {
  run(1, 3400);
  tell(EventKind::law_faulted, 2500, "", 0, 1);
  incidents_.serve(*link_, at_ns(3600));
  EXPECT_EQ(read_incidents(folder_).size(), 0U) << "100 ms of the second after it are not there yet";
  run(3401, 3600);
  incidents_.serve(*link_, at_ns(3601));
  EXPECT_EQ(show()["ticks"], 2001) << "1500 to 3500";
  tell(EventKind::law_faulted, 3500, "", 0, 2);
  incidents_.serve(*link_, at_ns(5499));
  EXPECT_EQ(read_incidents(folder_).size(), 1U);
  incidents_.serve(*link_, at_ns(5501));
  EXPECT_EQ(show()["ticks"], 1101) << "2500 to 3600, where it ended";
}

TEST_F(IncidentsTest, AStormOfOneKindIsKeptOnceAndCounted) {
  run(1, 4000);
  for (std::uint64_t tick = 1000; tick < 2000; tick += 100) {
    tell(EventKind::plan_refused, tick);
    incidents_.finish(*link_);
  }
  const Json all = incidents_.list();
  EXPECT_EQ(all["incidents"].size(), 1U);
  EXPECT_EQ(all["skipped"], 9);
  EXPECT_FALSE(all["incidents"][0].contains("events")) << "a list is short";
  tell(EventKind::safe_stop, 2000);
  incidents_.finish(*link_);
  EXPECT_EQ(incidents_.list()["incidents"].size(), 2U) << "another kind";
  tell(EventKind::brain_stale, 2100);
  incidents_.finish(*link_);
  EXPECT_EQ(incidents_.list()["incidents"].size(), 2U) << "no reason to keep anything";
}

TEST_F(IncidentsTest, OtherFilesInItsFolderStay) {
  fs::create_directories(folder_);
  for (const char* name : {"analysis.npy", "2026_run.npy", "0001.npy"})
    std::ofstream(folder_ / name) << "of somebody, and of a kill";
  run(1, 3000);
  tell(EventKind::armed, 900);
  incidents_.finish(*link_);
  EXPECT_TRUE(fs::exists(folder_ / "analysis.npy") && fs::exists(folder_ / "2026_run.npy"));
  EXPECT_EQ(show()["id"], 1) << "what a kill left of 0001 has gone";
}

TEST_F(IncidentsTest, WaitingForTheDrivesIsNoneOtherRefusalsAre) {
  run(1, 3000);
  tell(EventKind::command_refused, 10, "", static_cast<std::uint32_t>(wire::CommandResult::refused_not_ready));
  incidents_.finish(*link_);
  EXPECT_EQ(incidents_.list()["incidents"].size(), 0U);
  tell(EventKind::command_refused, 20, "", static_cast<std::uint32_t>(wire::CommandResult::refused_outside));
  incidents_.finish(*link_);
  EXPECT_EQ(incidents_.list()["incidents"].size(), 1U);
}

TEST_F(IncidentsTest, AFaultDuringAnotherOnesSecondIsCounted) {
  run(1, 3000);
  tell(EventKind::law_faulted, 1000);
  tell(EventKind::law_rolled_back, 1000);
  EXPECT_EQ(incidents_.list()["skipped"], 0) << "of the same fault";
  tell(EventKind::held, 1200);
  EXPECT_EQ(incidents_.list()["skipped"], 0) << "no fault";
  tell(EventKind::safe_stop, 1500);
  EXPECT_EQ(incidents_.list()["skipped"], 1);
  incidents_.finish(*link_);
  EXPECT_EQ(show()["events"].size(), 4U) << "all of them are in it";
}

TEST_F(IncidentsTest, FaultsOfOtherJointsAndLawsAreKeptAtOnceAndTheSameOnceIn10S) {
  run(1, 4000);
  const auto kept = [&](EventKind kind, std::uint64_t tick, const std::string& text, std::uint64_t request_id) {
    const std::size_t before = read_incidents(folder_).size();
    tell(kind, tick, text, 3, request_id);
    incidents_.finish(*link_);
    return read_incidents(folder_).size() > before;
  };
  EXPECT_TRUE(kept(EventKind::safe_stop, 1000, "velocity_limit at joint hip: 19.3 rad/s, allowed 18.8", 0));
  EXPECT_TRUE(kept(EventKind::safe_stop, 1100, "velocity_limit at joint knee: 19.3 rad/s, allowed 18.8", 0));
  EXPECT_FALSE(kept(EventKind::safe_stop, 1200, "velocity_limit at joint hip: 20.0 rad/s, allowed 18.8", 0));
  EXPECT_TRUE(kept(EventKind::law_faulted, 1300, "bad_access", 7));
  EXPECT_TRUE(kept(EventKind::law_faulted, 1400, "bad_access", 8));
  EXPECT_FALSE(kept(EventKind::law_faulted, 1500, "bad_access", 7));
  EXPECT_TRUE(kept(EventKind::law_rolled_back, 1600, "guard_busy: joint hip clamped in 80.1 % of ticks", 0));
  EXPECT_TRUE(kept(EventKind::law_rolled_back, 1700, "guard_busy: joint knee clamped in 80.1 % of ticks", 0));
  EXPECT_FALSE(kept(EventKind::law_rolled_back, 1800, "guard_busy: joint hip clamped in 90.3 % of ticks", 9));
  EXPECT_EQ(incidents_.list()["skipped"], 3);
  EXPECT_TRUE(
      kept(EventKind::law_faulted, 1300 + static_cast<std::uint64_t>(Incidents::kPauseNs / kNsPerMs), "bad_access", 7));
}

TEST_F(IncidentsTest, ARefusedLawAndAFailedShadowAreKept) {
  run(1, 4000);
  tell(EventKind::shadow_ended, 1000, "it agrees with the active law", 1);
  incidents_.finish(*link_);
  EXPECT_TRUE(read_incidents(folder_).empty()) << "it was promoted";
  tell(EventKind::shadow_ended, 1100, "it disagrees with the active law by more than the tolerance", 0);
  incidents_.finish(*link_);
  EXPECT_EQ(show()["kind"], "shadow_ended");
  tell(EventKind::law_refused, 1200);
  incidents_.finish(*link_);
  EXPECT_EQ(show()["kind"], "law_refused");
}

TEST_F(IncidentsTest, TheOldestMakeRoomAndNumbersGoOn) {
  run(1, 100);
  for (std::uint64_t i = 0; i < Incidents::kMost + 3; ++i) {
    tell(EventKind::held, 50 + i * static_cast<std::uint64_t>(Incidents::kPauseNs / kNsPerMs));
    incidents_.finish(*link_);
  }
  const auto all = read_incidents(folder_);
  ASSERT_EQ(all.size(), Incidents::kMost);
  EXPECT_EQ(all.front()["id"], 4);
  Incidents later(folder_, log_);
  EXPECT_EQ(later.brief()["last"], Incidents::kMost + 3);
}

TEST_F(IncidentsTest, WhatAKillLeftBehindIsNotListedAndIsRemoved) {
  fs::create_directories(folder_);
  std::ofstream(folder_ / "0007.npy") << "half";
  std::ofstream(folder_ / "0008.json.part77") << "{";
  std::ofstream(folder_ / "0005.json") << "{ no json";
  std::ofstream(folder_ / "notes.txt") << "mine";
  EXPECT_TRUE(read_incidents(folder_).empty());
  run(1, 100);
  tell(EventKind::estop, 50);
  incidents_.finish(*link_);
  EXPECT_EQ(show()["id"], 6);
  EXPECT_FALSE(fs::exists(folder_ / "0007.npy"));
  EXPECT_FALSE(fs::exists(folder_ / "0008.json.part77"));
  EXPECT_TRUE(fs::exists(folder_ / "notes.txt"));
  EXPECT_EQ(std::get<Refusal>(incidents_.show(5)).code, "no_incident");
  EXPECT_EQ(std::get<Refusal>(incidents_.show(99)).code, "no_incident");
}

TEST_F(IncidentsTest, AFolderThatCannotBeWrittenIsToldAndTheNextOneIsTried) {
  std::ofstream(folder_.string()) << "a file in its place";
  run(1, 100);
  tell(EventKind::estop, 50);
  incidents_.finish(*link_);
  EXPECT_NE(incidents_.brief()["problem"].get<std::string>().find("cannot write"), std::string::npos);
  fs::remove(folder_);
  tell(EventKind::reset, 60);
  incidents_.finish(*link_);
  EXPECT_TRUE(incidents_.brief()["problem"].is_null());
  EXPECT_EQ(show()["kind"], "reset");
}

TEST(Columns, AreAFileOfNumpyWithTheJointsOfTheRobot) {
  Columns columns(3);
  wire::Telemetry record;
  columns.add(record);
  const std::string file = columns.npy();
  EXPECT_EQ(file.substr(0, 8), std::string("\x93NUMPY\x01\x00", 8));
  const std::size_t header = static_cast<unsigned char>(file[8]) + 256 * static_cast<unsigned char>(file[9]);
  EXPECT_EQ((10 + header) % 64, 0U);
  EXPECT_NE(file.find("('tick', '<u8'), ('release_ns', '<i8')"), std::string::npos) << file.substr(0, 300);
  EXPECT_NE(file.find("('position_rad', '<f8', (3,))"), std::string::npos);
  EXPECT_NE(file.find("('sensor', '<f8', (16,))"), std::string::npos);
  EXPECT_NE(file.find("'shape': (1,)"), std::string::npos);
}

}  // namespace
}  // namespace lithe::control
