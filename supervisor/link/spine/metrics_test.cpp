// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/spine/metrics.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <memory>

#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

// Core 1 is offline: its column is missing.
constexpr const char* kText =
    "            CPU0       CPU2       CPU3       \n"
    "  24:          1          0          0  IO-APIC   5-edge      ACPI:Ged\n"
    " RES:     506511     649523     338844   Rescheduling interrupts\n"
    " CAL:     500546     199213     639081   Function call interrupts\n"
    " TLB:      79493      78667     193807   TLB shootdowns\n"
    "TLBX:          1          2          3   something else\n";

TEST(CommitMetrics, FindsTheColumnOfTheSpinesCore) {
  CoreCounts counts;
  read_interrupts(kText, 2, counts);
  EXPECT_EQ(counts.interrupts[0], 78667U);
  EXPECT_EQ(counts.interrupts[1], 199213U);
  EXPECT_EQ(counts.interrupts[2], 649523U);
}

TEST(CommitMetrics, ACoreWithoutAColumnAndAFileWithoutLinesTellNothing) {
  CoreCounts counts;
  read_interrupts(kText, 1, counts);
  read_interrupts("", 0, counts);
  read_interrupts("CPU0\n TLB:", 0, counts);
  EXPECT_FALSE(counts.interrupts[0]);
  EXPECT_TRUE(counts_json({}, {})["tlb"].is_null()) << "not 0: nobody knows";
}

TEST(CommitMetrics, ReadsFaultsBehindANameThatHoldsBrackets) {
  CoreCounts counts;
  read_faults("42 (spine) 9 9) S 1 2 3 4 5 6 700 8 900 10 11", counts);
  EXPECT_EQ(counts.minor_faults, 700U);
  EXPECT_EQ(counts.major_faults, 900U);
  read_faults("nonsense", counts);
}

TEST(CommitMetrics, CountsWhatCameBetween) {
  CoreCounts before, after;
  read_interrupts(kText, 0, before);
  after = before;
  after.interrupts[0] = *before.interrupts[0] + 3;
  const Json json = counts_json(before, after);
  EXPECT_EQ(json["tlb"], 3);
  EXPECT_EQ(json["cal"], 0);
  EXPECT_TRUE(json["minor_faults"].is_null());
  EXPECT_TRUE(json["seconds"].is_null()) << "nobody looked at the clock";
}

TEST(CommitMetrics, TellsHowLongItCounted) {
  CoreCounts before = count_core(::getpid(), {});
  CoreCounts after = before;
  EXPECT_NE(before.t_ns, 0);
  after.t_ns += 250'000'000;
  EXPECT_DOUBLE_EQ(counts_json(before, after)["seconds"].get<double>(), 0.25);
}

// A Spine of 1 kHz with one joint, tick by tick.
class LookAround : public SpineRig {
 protected:
  void SetUp() override {
    attach([](wire::RobotInfo& info) {
      info.rate_hz = 1000;
      info.joint_count = 1;
      info.torque_slew_nm_s[0] = 100;
    });
  }
  // The new law of tick 501 steps by 0.05 N m and takes 777 ns.
  void run(std::uint64_t ticks) {
    ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth> ring((*spine_)->telemetry);
    auto record = std::make_unique<wire::Telemetry>();
    for (std::uint64_t tick = 1; tick <= ticks; ++tick) {
      record->tick = tick;
      record->joint_count = 1;
      record->law_ns = tick == 501 ? 777 : 50;
      record->release_jitter_ns = tick > 500 ? 2000 : 1000;
      record->handoff_ns = tick == 480 ? 9000 : 3000;
      record->missed_releases = tick >= 510 ? 4 : 1;
      record->command_torque_nm[0] = tick > 500 ? 0.05 : 0.0;
      ring.push(*record);
    }
  }
};

TEST_F(LookAround, TellsBothSidesOfACommit) {
  run(700);
  Json seen = measure_commit(*link_, 500);
  EXPECT_EQ(seen["first_call_ns"], 777);
  EXPECT_EQ(seen["lost_ticks"], 3);
  EXPECT_EQ(seen["before"]["ticks"], 51);
  EXPECT_EQ(seen["after"]["ticks"], 50);
  EXPECT_DOUBLE_EQ(seen["before"]["release_jitter"]["max_us"].get<double>(), 1.0);
  EXPECT_DOUBLE_EQ(seen["after"]["release_jitter"]["p50_us"].get<double>(), 2.0);
  EXPECT_DOUBLE_EQ(seen["before"]["handoff"]["max_us"].get<double>(), 9.0);
  EXPECT_DOUBLE_EQ(seen["after"]["largest_step_nm"].get<double>(), 0.05);
  EXPECT_DOUBLE_EQ(seen["after"]["slew_bound_nm"].get<double>(), 0.1);
  EXPECT_DOUBLE_EQ(seen["before"]["largest_step_nm"].get<double>(), 0.0);
}

TEST_F(LookAround, ACommitThatJustCameHasAShorterAfter) {
  run(505);
  EXPECT_EQ(measure_commit(*link_, 500)["after"]["ticks"], 5);
}

TEST_F(LookAround, OneThatIsLongPastHasNothingLeftToSee) {
  run(9000);
  const Json seen = measure_commit(*link_, 500);
  EXPECT_EQ(seen["after"]["ticks"], 0);
  EXPECT_TRUE(seen["first_call_ns"].is_null());
  EXPECT_TRUE(seen["lost_ticks"].is_null()) << "not 0: nobody knows";
  for (const char* side : {"before", "after"})
    for (const char* what : {"release_jitter", "handoff", "largest_step_nm", "slew_bound_nm", "step_joint"})
      EXPECT_TRUE(seen[side][what].is_null()) << side << " " << what;
}

TEST_F(LookAround, ARecordThatIsTornDoesNotHideWhatComesAfterIt) {
  run(700);
  (*spine_)->telemetry.slots[(490 - 1) % wire::spine_segment::kTelemetryDepth].record = {};
  const Json seen = measure_commit(*link_, 500);
  EXPECT_EQ(seen["before"]["ticks"], 50);
  EXPECT_EQ(seen["after"]["ticks"], 50);
}

TEST_F(LookAround, WithoutATickThereIsNothing) { EXPECT_TRUE(measure_commit(*link_, 500).is_null()); }

}  // namespace
}  // namespace lithe::control
