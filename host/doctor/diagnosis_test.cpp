// SPDX-License-Identifier: Apache-2.0

#include <gtest/gtest.h>

#include <algorithm>
#include <string>

#include "host/doctor/diagnosis.hpp"
#include "host/test/machines_rig.hpp"

namespace lithe::host {
namespace {

Diagnosis of(void (*put)(const FakeRoot&), std::optional<Measured> measured = std::nullopt) {
  const FakeRoot root;
  put(root);
  return diagnose(HostFiles(root.path()), kJudged, std::move(measured));
}

std::string missing(const Diagnosis& diagnosis) {
  std::string ids;
  for (const Missing& each : diagnosis.verdict.missing) ids += each.id + " ";
  return ids;
}

// A quiet core.
Measured quiet() {
  Measured seen;
  seen.cpu = kJudged;
  seen.seconds = 10;
  seen.ticks_per_s = 0.5;
  seen.device_interrupts_per_s = 0.0;
  seen.core_interrupts_per_s = 0.0;
  seen.stolen_s = 0.0;
  seen.phase_share.assign(20, 0.0);
  return seen;
}

TEST(Tier, OfAnUnpreparedMachineIsD) {
  const Diagnosis desktop = of(put_desktop);
  EXPECT_EQ(desktop.verdict.tier, Tier::d);
  EXPECT_EQ(missing(desktop), "user_tasks ");
  EXPECT_EQ(desktop.hypervisor.present, false);
}

TEST(Tier, WithAffinityOnlyIsC) {
  const Diagnosis pinned = of(put_pinned);
  EXPECT_EQ(pinned.verdict.tier, Tier::c);
  EXPECT_EQ(missing(pinned), "irq_affinity memory_lock domain_isolation ");
}

TEST(Tier, InAPartitionIsB) {
  const Diagnosis partition = of(put_partition);
  EXPECT_EQ(partition.verdict.tier, Tier::b) << missing(partition);
  EXPECT_EQ(missing(partition), "tickless rcu_callbacks governor boot_isolation ");
  EXPECT_TRUE(partition.is_isolated());
}

TEST(Tier, OfABootedIsolationIsA) {
  const Diagnosis booted = of(put_booted);
  EXPECT_EQ(booted.verdict.tier, Tier::a) << missing(booted);
  EXPECT_EQ(missing(booted), "");
}

TEST(Tier, ARealTimeSpineThatIsThrottledIsD) {
  const Diagnosis fifo = of(put_fifo);
  EXPECT_EQ(fifo.verdict.tier, Tier::d);
  EXPECT_EQ(missing(fifo), "user_tasks rt_throttling fair_server ");
  EXPECT_EQ(fifo.hypervisor.present, true);
}

TEST(Tier, AMeasurementThatSeesOtherTasksClosesGates) {
  Measured seen = quiet();
  EXPECT_EQ(of(put_booted, seen).verdict.tier, Tier::a);
  seen.switches_per_s = 1;
  EXPECT_EQ(missing(of(put_booted, seen)), "measured_switches ");
  EXPECT_EQ(of(put_booted, seen).verdict.tier, Tier::b);
  seen.switches_per_s = 50;
  EXPECT_EQ(of(put_booted, seen).verdict.tier, Tier::c);
}

TEST(Tier, AMeasurementNeverMakesItBetter) {
  EXPECT_EQ(of(put_desktop, quiet()).verdict.tier, Tier::d);
  EXPECT_EQ(of(put_pinned, quiet()).verdict.tier, Tier::c);
  EXPECT_EQ(of(put_partition, quiet()).verdict.tier, Tier::b);
}

TEST(Tier, StolenTimeThatIsUnknownOrMoreThanNoneClosesTierA) {
  Measured seen = quiet();
  seen.stolen_s = 0.01;
  EXPECT_EQ(missing(of(put_booted, seen)), "measured_steal ");
  seen.stolen_s = std::nullopt;
  EXPECT_EQ(of(put_booted, seen).verdict.tier, Tier::b);
}

TEST(Tier, ATickThatComesAllTheSameClosesTierA) {
  Measured seen = quiet();
  seen.ticks_per_s = 250;
  EXPECT_EQ(missing(of(put_booted, seen)), "tickless ");
}

TEST(Report, TellsTheTierFirstAndWhatIsMissing) {
  const std::string text = to_text(of(put_fifo), false);
  EXPECT_TRUE(text.starts_with("tier D-v: core 1 is not protected")) << text;
  EXPECT_NE(text.find("missing for tier C: user_tasks (4), rt_throttling (9), fair_server (10)"), std::string::npos);
  EXPECT_NE(text.find("\n  kernel 6."), std::string::npos) << text;
  EXPECT_EQ(text.find("irqbalance leaves"), std::string::npos);
  EXPECT_NE(text.find("lithe doctor --all lists them"), std::string::npos);
}

TEST(Report, ListsEveryItemWithAll) {
  const std::string text = to_text(of(put_booted), true);
  for (const Item& each : checklist())
    EXPECT_NE(text.find(" " + std::string(each.id) + ": "), std::string::npos) << each.id;
}

TEST(Report, InJsonHasPathAndValueOfEveryVerdict) {
  const nlohmann::json told = to_json(of(put_partition, quiet()));
  EXPECT_EQ(told["tier"], "B");
  EXPECT_EQ(told["virtual"], false);
  EXPECT_EQ(told["kernel"]["release"], "6.1.0-56-amd64");
  EXPECT_TRUE(told["kernel"]["preempt_rt"].is_null()) << "this machine does not say";
  EXPECT_EQ(told["items"].size(), 39U);
  EXPECT_EQ(told["measured"]["ticks_per_s"], 0.5);
  for (const nlohmann::json& item : told["items"]) {
    EXPECT_FALSE(item["words"].get<std::string>().empty()) << item["id"];
    EXPECT_EQ(item["fix"].get<std::string>().find('{'), std::string::npos) << item["fix"];
    const bool judged = item["state"] == "ok" || item["state"] == "warn" || item["state"] == "fail";
    EXPECT_TRUE(!judged || !item["evidence"].empty()) << item["id"];
    for (const nlohmann::json& each : item["evidence"]) EXPECT_FALSE(each["path"].get<std::string>().empty());
  }
}

TEST(Checklist, HasThirtyNineItemsInOrderWithOwnNames) {
  int number = 0;
  for (const Item& each : checklist()) {
    EXPECT_EQ(each.number, ++number);
    const auto same = [&](const Item& other) { return std::string(other.id) == each.id; };
    EXPECT_EQ(std::count_if(checklist().begin(), checklist().end(), same), 1) << each.id;
  }
  EXPECT_EQ(number, 39);
}

}  // namespace
}  // namespace lithe::host
