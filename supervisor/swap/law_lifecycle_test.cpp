// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/law_lifecycle.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <string_view>

#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

using wire::EventKind;

class LawLifecycleTest : public SpineRig {
 protected:
  void SetUp() override {
    attach([](wire::RobotInfo& info) {
      info.rate_hz = 1000;
      info.joint_count = 1;
      std::copy_n("elbow", 5, info.joint_name.begin());
      info.torque_max_nm[0] = 2;
    });
    lifecycle_.emplace(
        *link_,
        [this](const SwapState& each, const CertificateFiles::Page&) { kept_[each.request_id()] = each.certificate(); },
        [this](const SwapState&, std::uint32_t offset, LawLifecycle::Found found) {
          asked_.push_back(offset);
          answers_.push_back(std::move(found));
        },
        [this](const SwapState& each, const std::string& sentence) { explained_[each.request_id()] = sentence; });
  }

  // A law committed at tick 10 times its id; its request is 100 + its id.
  void commit(std::uint32_t law_id, double probation_s = 1.0) {
    SwapRequest request{"x.cpp", "text"};
    request.terms.probation_s = probation_s;
    SwapState swap(100 + law_id, request, 1);
    swap.mark_started(1);
    swap.mark_compiled({}, 2);
    for (const Stage each : {Stage::admitted, Stage::placed, Stage::tried, Stage::staged}) swap.mark(each, "", 3);
    swap.mark_committed(10 * law_id, law_id, 4);
    lifecycle_->follow(std::move(swap), {}, {}, 4);
  }
  void tell(EventKind kind, std::uint64_t request_id, std::uint32_t code, std::uint64_t tick = 99,
            std::string_view text = "") {
    wire::Event event;
    std::copy(text.begin(), text.end(), event.text.begin());
    event.kind = static_cast<std::uint32_t>(kind);
    event.request_id = request_id;
    event.code = code;
    event.tick = tick;
    event.t_ns = 50;
    lifecycle_->on_event(event);
  }
  void fault(std::uint32_t law_id, std::uint32_t to_law_id, wire::LawFaultKind kind, std::uint64_t tick) {
    write_fault(law_id, to_law_id, kind, tick);
    tell(EventKind::law_faulted, 100 + law_id, static_cast<std::uint32_t>(kind), tick);
  }
  void write_fault(std::uint32_t law_id, std::uint32_t to_law_id, wire::LawFaultKind kind, std::uint64_t tick) {
    wire::LawFault record{};
    record.tick = tick;
    record.request_id = 100 + law_id;
    record.law_id = law_id;
    record.to_law_id = to_law_id;
    record.took_ns = 4200;
    record.pc_offset = pc_offset_;
    record.kind = static_cast<std::uint32_t>(kind);
    ipc::RingWriter<wire::LawFault, wire::spine_segment::kLawFaultsDepth>((*spine_)->law_faults).push(record);
  }
  // A tick in which the law pushed with stiffness_nm_rad times the position of its joint.
  void record(std::uint64_t tick, std::uint32_t law_id, double q_rad, double v_rad_s, double stiffness_nm_rad) {
    auto record = std::make_unique<wire::Telemetry>();
    record->tick = tick;
    record->law_id = law_id;
    record->mode = static_cast<std::uint32_t>(wire::Mode::active);
    record->position_rad[0] = q_rad;
    record->velocity_rad_s[0] = v_rad_s;
    record->command_torque_nm[0] = stiffness_nm_rad * q_rad;
    ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth>((*spine_)->telemetry).push(*record);
  }
  std::string verdict(std::uint32_t law_id) { return kept_[100 + law_id].value("verdict", "none"); }

  std::map<std::uint64_t, Json> kept_;  // by request
  std::uint32_t pc_offset_ = 0;         // of the next faults
  std::vector<std::uint32_t> asked_;    // where these offsets are
  std::vector<LawLifecycle::Found> answers_;
  std::map<std::uint64_t, std::string> explained_;
  std::optional<LawLifecycle> lifecycle_;
};

TEST_F(LawLifecycleTest, AtRestALawIsUnprovenAndStillOnProbation) {
  commit(1);
  tell(EventKind::law_unproven, 101, 1);
  EXPECT_EQ(verdict(1), "unproven");
  commit(2);
  EXPECT_EQ(kept_[101]["probation"], "cut short by request 102");
  tell(EventKind::law_retired, 101, 1);
  EXPECT_EQ(verdict(1), "unproven") << "what became of it, not that it is gone";
}

TEST_F(LawLifecycleTest, ALawIsNotBlamedForItsParametersWhenAPersonTakesItAwayLater) {
  commit(1);
  commit(2);
  fault(2, 2, wire::LawFaultKind::oscillating, 110);  // only its parameters went back
  tell(EventKind::law_rolled_back, 101, 1);
  EXPECT_EQ(kept_[102]["rolled_back"]["why"], "asked for");
}

TEST_F(LawLifecycleTest, ComparesOldLawAndNewPerJoint) {
  commit(2);
  for (std::uint64_t tick = 1; tick <= 40; ++tick) record(tick, tick <= 20 ? 1 : 2, tick <= 20 ? 0.2 : -0.1, 0, 0);
  for (std::uint64_t tick = 700; tick <= 710; ++tick) record(tick, 2, 0.01, 0, 0);  // the window is 20 to 1020
  lifecycle_->serve(500'000'000);
  EXPECT_FALSE(kept_[102].contains("control")) << "its probation is not over";
  lifecycle_->serve(2'000'000'000);
  const Json& control = kept_[102]["control"];
  EXPECT_EQ(control["before"]["ticks"], 20);
  EXPECT_EQ(control["after"]["ticks"], 31);
  const Json& joint = control["joints"][0];
  EXPECT_EQ(joint["joint"], "elbow");
  EXPECT_DOUBLE_EQ(joint["before"]["rms_error_rad"].get<double>(), 0.2);
  EXPECT_NEAR(joint["after"]["rms_error_rad"].get<double>(), std::sqrt((20 * 0.01 + 11 * 1e-4) / 31), 1e-5);
  EXPECT_DOUBLE_EQ(joint["late_rms_error_rad"].get<double>(), 0.01) << "of the last third, without the pull-in";
  EXPECT_DOUBLE_EQ(lifecycle_->score_of(2)["late_rms_error_rad"]["elbow"].get<double>(), 0.01);
  EXPECT_TRUE(joint["predicted_rms_error_rad"].is_null()) << "it had no trial";
  EXPECT_EQ(summary_of(kept_[102])["rms_error_rad"]["elbow"], (Json{0.2, joint["after"]["rms_error_rad"]}));
}

TEST_F(LawLifecycleTest, ASwingIsExplainedWithItsFrequency) {
  commit(1);
  commit(2);
  for (std::uint64_t tick = 1; tick <= 120; ++tick) {
    const double phase = 0.2 * static_cast<double>(tick);
    record(tick, tick <= 20 ? 1 : 2, 0.1 * std::sin(phase), 20 * std::cos(phase), -4);
  }
  fault(2, 1, wire::LawFaultKind::oscillating, 110);
  tell(EventKind::law_rolled_back, 101, 1, 110, "oscillating: joint elbow, 31 Hz, swings of 20.00, allowed 1.50 rad/s");
  EXPECT_NE(kept_[102]["rolled_back"]["next"].get<std::string>().find("too little damping for its swing of 31.0 Hz"),
            std::string::npos)
      << kept_[102]["rolled_back"];
}

// A joint whose torque grows with its error, to the other side.
TEST_F(LawLifecycleTest, ARollbackSaysWhatTheJointDid) {
  commit(1);
  commit(2);
  for (std::uint64_t tick = 1; tick <= 120; ++tick) {
    const double s = static_cast<double>(tick) * 1e-3;
    record(tick, tick <= 20 ? 1 : 2, 3 * s * s, 6 * s + 0.1 * std::sin(400 * s), 4);
  }
  fault(2, 1, wire::LawFaultKind::tracking_lost, 110);
  tell(EventKind::law_rolled_back, 101, 1, 110, "tracking_lost: joint elbow, error 0.312 rad, allowed 0.150");
  EXPECT_EQ(verdict(2), "rolled_back");
  EXPECT_NE(kept_[102]["rolled_back"]["next"].get<std::string>().find("its torque grows with its position"),
            std::string::npos)
      << kept_[102]["rolled_back"];
  EXPECT_EQ(explained_[102], kept_[102]["rolled_back"]["next"].get<std::string>())
      << "who follows the events is told, too";
  const Json score = lifecycle_->score_of(2);
  EXPECT_EQ(score["verdict"], "rolled_back");
  EXPECT_GT(score["rms_error_rad"]["elbow"], 0.01);
  EXPECT_EQ(lifecycle_->score_of(1)["rms_error_rad"], Json()) << "nothing was measured of it yet";
  EXPECT_TRUE(lifecycle_->score_of(9).is_null());
}

// It was confirmed and measured long before: what its last second shows counts.
TEST_F(LawLifecycleTest, ALawThatTurnsBadLaterIsExplainedByItsLastSecond) {
  commit(1);
  commit(2);
  for (std::uint64_t tick = 20; tick <= 3000; ++tick) {
    const double s = 1e-3 * static_cast<double>(tick % 2000);
    if (tick < 2000)
      record(tick, 2, 0.01 * std::sin(9 * s), 0.09 * std::cos(9 * s), -4);
    else
      record(tick, 2, 3 * s * s, 6 * s + 0.1 * std::sin(400 * s), 4);
    if (tick == 1900) lifecycle_->serve(10'000'000'000);
  }
  ASSERT_TRUE(kept_[102].contains("control"));
  EXPECT_FALSE(kept_[102]["control"].contains("seen"));
  tell(EventKind::law_confirmed, 102, 2);
  const std::string why = "pushes_away: joint elbow, error 0.312 rad, allowed 0.150: wants 1.200 N m";
  tell(EventKind::law_suspected, 102, static_cast<std::uint32_t>(wire::LawFaultKind::pushes_away), 2500, why);
  EXPECT_EQ(kept_[102]["suspected"], (Json{{"tick", 2500}, {"why", why}}));
  EXPECT_EQ(verdict(2), "confirmed") << "so far";
  fault(2, 1, wire::LawFaultKind::pushes_away, 3000);
  tell(EventKind::law_rolled_back, 102, 1, 3000, why);
  EXPECT_EQ(verdict(2), "rolled_back");
  EXPECT_EQ(kept_[102]["rolled_back"]["why"], why);
  EXPECT_NE(kept_[102]["rolled_back"]["next"].get<std::string>().find("its torque grows with its position"),
            std::string::npos)
      << kept_[102]["rolled_back"];
  EXPECT_EQ(kept_[102]["rolled_back"]["seen"][0], kept_[102]["rolled_back"]["next"]);
}

TEST_F(LawLifecycleTest, ConfirmsAndRetires) {
  commit(1);
  tell(EventKind::law_confirmed, 101, 1);
  EXPECT_EQ(verdict(1), "confirmed");
  tell(EventKind::law_retired, 101, 1);
  EXPECT_EQ(kept_[101]["stage"], "retired");
  EXPECT_EQ(verdict(1), "confirmed");
  kept_.clear();
  tell(EventKind::law_confirmed, 101, 1);
  EXPECT_TRUE(kept_.empty()) << "it is gone";
}

TEST_F(LawLifecycleTest, AFaultIsNamedWhenTheLawBeforeTakesOver) {
  commit(1);
  commit(2);
  wire::LawInfo law{};
  law.law_id = 1;
  std::copy_n("pd", 2, law.name.begin());
  ipc::ChannelWriter<wire::LawInfo>((*spine_)->law_info[0]).write(law);
  fault(2, 1, wire::LawFaultKind::bad_access, 25);
  tell(EventKind::law_rolled_back, 101, 1, 25);
  EXPECT_EQ(kept_[102]["rolled_back"]["law"], "pd") << "which runs now";
  EXPECT_EQ(verdict(2), "rolled_back");
  EXPECT_EQ(kept_[102]["fault"]["kind"], "bad_access");
  EXPECT_EQ(kept_[102]["fault"]["to_law_id"], 1);
  EXPECT_EQ(kept_[102]["rolled_back"]["ticks_after_commit"], 5);
  EXPECT_EQ(kept_[102]["rolled_back"]["why"], "bad_access");
  EXPECT_NE(verdict(1), "rolled_back");
}

TEST_F(LawLifecycleTest, WhatEndedAProbationIsToldWithWhatToDo) {
  constexpr std::string_view kWhy =
      "guard_busy: joint hip clamped in 80.1 % of ticks, allowed 80: wants 12.000 N m of 0.600";
  commit(1);
  commit(2);
  write_fault(2, 1, wire::LawFaultKind::guard_busy, 25);
  tell(EventKind::law_faulted, 102, static_cast<std::uint32_t>(wire::LawFaultKind::guard_busy), 25, kWhy);
  tell(EventKind::law_rolled_back, 101, 1, 25, kWhy);
  EXPECT_EQ(kept_[102]["rolled_back"]["why"], std::string(kWhy));
  EXPECT_NE(kept_[102]["rolled_back"]["next"].get<std::string>().find("command less at this joint"), std::string::npos);
  write_fault(1, 0, wire::LawFaultKind::overran, 35);
  tell(EventKind::law_faulted, 101, static_cast<std::uint32_t>(wire::LawFaultKind::overran), 35,
       "overran: ended after 812.0 us, allowed 300.0");
  EXPECT_EQ(kept_[101]["rolled_back"]["why"],
            "overran: ended after 812.0 us, allowed 300.0; no law took over: the safe law");
  EXPECT_NE(kept_[101]["rolled_back"]["next"].get<std::string>().find("shorter"), std::string::npos);
}

TEST_F(LawLifecycleTest, ALawThatRunsAgainAfterItsStopIsJudgedAgain) {
  commit(1);
  write_fault(1, 0, wire::LawFaultKind::overran, 35);
  tell(EventKind::law_faulted, 101, static_cast<std::uint32_t>(wire::LawFaultKind::overran), 35);
  ASSERT_EQ(verdict(1), "rolled_back");
  tell(EventKind::law_unproven, 101, 1, 99);
  EXPECT_EQ(verdict(1), "unproven");
  tell(EventKind::law_confirmed, 101, 1, 999);
  EXPECT_EQ(verdict(1), "confirmed");
  EXPECT_FALSE(kept_[101]["rolled_back"]["why"].empty()) << "what happened before stays there";
}

TEST_F(LawLifecycleTest, TwoFaultsInOneTickAreBothNamedBeforeEitherEventIsRead) {
  commit(1);
  commit(2);
  write_fault(2, 1, wire::LawFaultKind::bad_access, 25);
  write_fault(1, 0, wire::LawFaultKind::overran, 25);
  tell(EventKind::law_faulted, 777, 1, 24);  // of a law of an earlier supervisor: takes nothing along
  tell(EventKind::law_faulted, 102, static_cast<std::uint32_t>(wire::LawFaultKind::bad_access), 25);
  tell(EventKind::law_rolled_back, 101, 1, 25);
  tell(EventKind::law_faulted, 101, static_cast<std::uint32_t>(wire::LawFaultKind::overran), 25);
  EXPECT_EQ(kept_[102]["fault"]["kind"], "bad_access");
  EXPECT_EQ(kept_[101]["fault"]["kind"], "overran");
  EXPECT_EQ(kept_[101]["fault"]["to_law_id"], 0);
  EXPECT_EQ(verdict(2), "rolled_back");
  EXPECT_EQ(verdict(1), "rolled_back") << "nobody tells more of the safe law";
}

TEST_F(LawLifecycleTest, ARecordWhoseEventWasLostIsNotTakenForALaterFault) {
  commit(1);
  commit(2);
  write_fault(2, 1, wire::LawFaultKind::overran, 25);
  fault(2, 1, wire::LawFaultKind::bad_access, 99);
  tell(EventKind::law_rolled_back, 101, 1, 99);
  EXPECT_EQ(kept_[102]["fault"]["tick"], 99);
}

TEST_F(LawLifecycleTest, AFaultWhoseRecordWasLostIsStillNamed) {
  commit(1);
  tell(EventKind::law_faulted, 101, static_cast<std::uint32_t>(wire::LawFaultKind::overran), 25);
  EXPECT_EQ(kept_[101]["fault"]["kind"], "overran");
  EXPECT_EQ(kept_[101]["fault"]["record_lost"], true);
}

TEST_F(LawLifecycleTest, WithoutALawBeforeItTheSafeLawTakesOver) {
  commit(1);
  fault(1, 0, wire::LawFaultKind::overran, 30);
  EXPECT_EQ(verdict(1), "rolled_back");
  EXPECT_NE(kept_[101]["rolled_back"]["why"].get<std::string>().find("safe law"), std::string::npos);
}

TEST_F(LawLifecycleTest, ARollbackOverSeveralLawsTakesAllOfThemOut) {
  for (std::uint32_t law = 1; law <= 4; ++law) commit(law);
  tell(EventKind::law_rolled_back, 9999, 2, 77);
  EXPECT_EQ(verdict(4), "rolled_back");
  EXPECT_EQ(verdict(3), "rolled_back");
  EXPECT_EQ(kept_[103]["rolled_back"]["why"], "asked for");
  EXPECT_NE(verdict(2), "rolled_back");
  commit(5);
  tell(EventKind::law_rolled_back, 9998, 2, 88);
  EXPECT_EQ(verdict(5), "rolled_back");
}

TEST_F(LawLifecycleTest, ARollbackToALawOfAnEarlierSupervisorTakesOutTheNewestOnly) {
  commit(8);
  commit(9);
  tell(EventKind::law_rolled_back, 1, 7, 100);
  EXPECT_EQ(verdict(9), "rolled_back");
  EXPECT_NE(verdict(8), "rolled_back");
}

TEST_F(LawLifecycleTest, AnotherCommitEndsAProbation) {
  commit(1);
  commit(2);
  EXPECT_NE(kept_[101]["probation"].get<std::string>().find("102"), std::string::npos);
  EXPECT_EQ(verdict(1), "committed");
}

TEST_F(LawLifecycleTest, MeasuresOnceWhenItIsTimeOrWhenAnotherLawIsOnItsWay) {
  for (std::uint64_t tick = 1; tick < 100; ++tick) record(tick, 0, 0, 0, 0);
  commit(1, 0);
  lifecycle_->serve(5);
  EXPECT_TRUE(kept_.empty());
  lifecycle_->measure_all();
  EXPECT_TRUE(kept_[101].contains("measured")) << "another law comes";
  EXPECT_EQ(kept_[101]["measured"]["core"]["seconds"], nullptr) << "this one was not counted before";
  commit(2, 0);
  lifecycle_->serve(4 + LawLifecycle::kMeasureAfterNs);
  EXPECT_TRUE(kept_[102].contains("measured"));
  kept_.clear();
  lifecycle_->serve(5 + LawLifecycle::kMeasureAfterNs);
  EXPECT_TRUE(kept_.empty());
}

TEST_F(LawLifecycleTest, WhenTheRobotStopsEveryLawIsRetiredWithTheReason) {
  commit(1);
  commit(2);
  lifecycle_->end("the robot is being stopped", 60);
  EXPECT_EQ(kept_[101]["stage"], "retired");
  EXPECT_EQ(kept_[102]["reasons"]["retired"], "the robot is being stopped");
}

TEST_F(LawLifecycleTest, TheLineOfAFaultIsToldWhenItIsKnownAlsoOfALawThatIsGoneByThen) {
  commit(1);
  commit(2);
  pc_offset_ = 77;
  fault(2, 1, wire::LawFaultKind::bad_access, 25);
  tell(EventKind::law_rolled_back, 101, 1, 25);
  tell(EventKind::law_retired, 102, 2);
  ASSERT_EQ(asked_, std::vector<std::uint32_t>{77});
  EXPECT_FALSE(kept_[102]["fault"].contains("where"));
  answers_.front()({{"where", "x.cpp:12"}, {"function", "Law::step"}});
  EXPECT_EQ(kept_[102]["fault"]["where"], "x.cpp:12");
  EXPECT_EQ(kept_[102]["fault"]["kind"], "bad_access");
  EXPECT_EQ(kept_[102]["stage"], "retired");
  ASSERT_EQ(lifecycle_->faults().size(), 1u);
  EXPECT_EQ(lifecycle_->faults()[0]["where"], "x.cpp:12");
  EXPECT_EQ(lifecycle_->faults()[0]["request_id"], 102);
  kept_.clear();
  answers_.front()({{"where", "x.cpp:13"}});
  EXPECT_TRUE(kept_.empty()) << "it is gone";
}

TEST_F(LawLifecycleTest, TheLineOfAnOutputThatIsNotFiniteIsAskedForWithoutAnAddress) {
  commit(1);
  fault(1, 7, wire::LawFaultKind::not_finite, 25);
  ASSERT_EQ(asked_, std::vector<std::uint32_t>{0});
  answers_.front()({{"where", "x.cpp:9"}, {"function", "Law::step"}});
  EXPECT_EQ(kept_[101]["fault"]["where"], "x.cpp:9");
}

TEST_F(LawLifecycleTest, AFaultOutsideTheLawsCodeOrWithoutAnAnswerKeepsWhatIsKnown) {
  commit(1);
  fault(1, 7, wire::LawFaultKind::bad_access, 25);
  EXPECT_TRUE(asked_.empty());
  pc_offset_ = 5;
  fault(1, 7, wire::LawFaultKind::overran, 26);
  answers_.at(0)(nullptr);
  EXPECT_EQ(lifecycle_->faults().size(), 2u);
  for (std::uint64_t tick = 100; tick < 120; ++tick) fault(1, 7, wire::LawFaultKind::overran, tick);
  EXPECT_EQ(lifecycle_->faults().size(), LawLifecycle::kFaultsKept);
  EXPECT_EQ(lifecycle_->faults().back()["tick"], 119);
  lifecycle_->end("the robot is being stopped", 60);
  answers_.at(5)({{"where", "x.cpp:1"}});  // too late: nobody minds
}

}  // namespace
}  // namespace lithe::control
