// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/cores/cpu_plan.hpp"

#include <gtest/gtest.h>

namespace lithe::robot {
namespace {

using Cpus = std::vector<int>;

MachineCores machine(const Cpus& cpus, const Cpus& isolated = {}) {
  MachineCores cores;
  cores.online = cores.granted = cpus;
  cores.isolated.boot = isolated;
  for (const int cpu : cpus)
    if (cores.isolated.how(cpu) == Isolation::none) cores.affinity.push_back(cpu);
  return cores;
}

// housekeeping, Spine, Brain, Transport
Cpus roles(const CpuPlan& plan) { return {plan.housekeeping, plan.spine, plan.brain, plan.transport}; }

RobotConfig robot_on(BusKind bus = BusKind::loop) {
  RobotConfig robot;
  robot.path = "r.toml";
  robot.buses.resize(1);
  robot.buses[0].kind = bus;
  return robot;
}

std::string refusal(const RobotConfig& robot, const MachineCores& cores) {
  const Result<CpuPlan> plan = plan_cpus(robot, cores);
  return plan ? "was planned" : plan.message();
}

bool mentions(const std::vector<std::string>& sentences, const std::string& words) {
  for (const std::string& sentence : sentences)
    if (sentence.find(words) != std::string::npos) return true;
  return false;
}

TEST(CpuPlan, FoldsFourRolesOntoFewerCores) {
  EXPECT_EQ(roles(fold_cpus(machine({0, 1, 2, 3}))), (Cpus{0, 1, 2, 3}));
  EXPECT_EQ(roles(fold_cpus(machine({0, 1, 2, 3, 4, 5}))), (Cpus{0, 1, 2, 3}));
  EXPECT_EQ(roles(fold_cpus(machine({0, 1, 2}))), (Cpus{0, 1, 0, 2}));
  const CpuPlan two = fold_cpus(machine({4, 5}));
  EXPECT_EQ(roles(two), (Cpus{4, 5, 4, 5}));
  EXPECT_TRUE(two.transport_inline);
  EXPECT_FALSE(two.spine_shares);
  EXPECT_TRUE(fold_cpus(machine({7})).spine_shares);
  EXPECT_EQ(roles(fold_cpus(machine({7}))), (Cpus{7, 7, 7, 7}));
}

// The affinity is {0} there: a process that does not ask for more has one core for everything.
TEST(CpuPlan, AMachineBootedWithIsolcpusGivesTheSpineAnIsolatedCore) {
  const CpuPlan plan = fold_cpus(machine({0, 1, 2, 3}, {1, 2, 3}));
  EXPECT_EQ(roles(plan), (Cpus{0, 1, 2, 3}));
  EXPECT_FALSE(plan.spine_shares);
  EXPECT_FALSE(plan.transport_inline);
}

TEST(CpuPlan, IsolatedCoresGoToTheSpineAndThenToTheTransport) {
  EXPECT_EQ(roles(fold_cpus(machine({0, 1, 2, 3}, {3}))), (Cpus{0, 3, 1, 2}));
  EXPECT_EQ(roles(fold_cpus(machine({0, 1, 2, 3}, {2, 3}))), (Cpus{0, 2, 1, 3}));
  EXPECT_EQ(roles(fold_cpus(machine({0, 1, 2, 3}, {1, 3}))), (Cpus{0, 1, 2, 3}));
  EXPECT_EQ(roles(fold_cpus(machine({0, 1, 2}, {1, 2}))), (Cpus{0, 1, 0, 2}));
  EXPECT_EQ(roles(fold_cpus(machine({0, 1}, {1}))), (Cpus{0, 1, 0, 1}));
  MachineCores partition = machine({2, 3});
  partition.isolated.cpuset = {2, 3};  // all cores of this process
  EXPECT_EQ(roles(fold_cpus(partition)), (Cpus{2, 3, 2, 3}));
}

TEST(CpuPlan, ANamedCoreIsKeptForItsRole) {
  SpineConfig wanted;
  wanted.cpu_spine = 3;
  EXPECT_EQ(roles(fold_cpus(machine({0, 1, 2, 3}), wanted)), (Cpus{0, 3, 1, 2}));
  wanted.cpu_spine = 0;
  const CpuPlan plan = fold_cpus(machine({0, 1}), wanted);
  EXPECT_EQ(roles(plan), (Cpus{1, 0, 1, 0}));
  EXPECT_FALSE(plan.spine_shares);
  wanted.cpu_housekeeping = 0;
  EXPECT_TRUE(fold_cpus(machine({0, 1, 2, 3}), wanted).spine_shares);
}

TEST(CpuPlan, AnIsolatedCoreMayBeNamedWhateverTheAffinity) {
  RobotConfig robot = robot_on();
  robot.spine.cpu_spine = 1;
  const MachineCores cores = machine({0, 1, 2, 3}, {1, 2, 3});
  const Result<CpuPlan> plan = plan_cpus(robot, cores);
  ASSERT_TRUE(plan) << plan.message();
  EXPECT_EQ(plan->spine, 1);
  EXPECT_EQ(why_spine(1, false, robot.spine, cores.isolated), "the robot file names it");
}

TEST(CpuPlan, ACoreThatCannotBeHadIsNamedWithTheReason) {
  RobotConfig robot = robot_on();
  robot.spine.cpu_spine = 999;
  EXPECT_EQ(refusal(robot, machine({0, 1})),
            "r.toml: spine.cpu_spine = 999, but this machine has cores 0-1; name one of 0-1, or leave it out to let "
            "the program choose");
  robot.spine.cpu_spine = 2;
  MachineCores cores = machine({0, 1, 2, 3});
  cores.granted = cores.affinity = {0, 1};
  EXPECT_NE(refusal(robot, cores).find("cpuset of this process has cores 0-1"), std::string::npos);
  cores = machine({0, 1, 2, 3});
  cores.affinity = {0};
  EXPECT_NE(refusal(robot, cores).find("was started on cores 0 (taskset?)"), std::string::npos);
}

TEST(CpuPlan, HardwareIsNeverServedByTheThreadThatTicks) {
  const Result<CpuPlan> plan = plan_cpus(robot_on(BusKind::socketcan), machine({0, 1}));
  ASSERT_TRUE(plan) << plan.message();
  EXPECT_FALSE(plan->transport_inline);
  EXPECT_EQ(plan->transport, 0);
  EXPECT_FALSE(plan->spine_shares);
  RobotConfig asked = robot_on(BusKind::socketcan);
  asked.spine.transport = TransportPlace::inlined;
  EXPECT_NE(refusal(asked, machine({0, 1})).find("for simulated buses only"), std::string::npos);
}

// What a shield keeps free and what `lithe tune` sets up is what the Spine's plan takes, [spine] transport included.
TEST(CpuPlan, ARobotsOwnCoresAreTheSpinesAndThoseOfATransportThatSharesNone) {
  const auto own = [](const RobotConfig& robot, const Cpus& cpus) {
    return own_cores(*plan_cpus(robot, machine(cpus)));
  };
  RobotConfig robot = robot_on();
  EXPECT_EQ(own(robot, {0, 1, 2, 3}), (Cpus{1, 3}));
  EXPECT_EQ(own(robot, {0, 1, 2}), (Cpus{1, 2}));
  EXPECT_EQ(own(robot, {0, 1}), Cpus{1});
  EXPECT_EQ(own(robot, {0}), Cpus{});
  robot.spine.transport = TransportPlace::inlined;
  EXPECT_EQ(own(robot, {0, 1, 2, 3}), Cpus{1}) << "the Transport is in the tick: its core is everybody's";
  robot.spine.transport = TransportPlace::automatic;
  robot.spine.cpu_transport = 2;
  robot.spine.cpu_brain = 2;
  EXPECT_EQ(own(robot, {0, 1, 2, 3}), Cpus{1}) << "the Brain runs on the Transport's core";
  EXPECT_EQ(own(robot_on(BusKind::socketcan), {0, 1}), Cpus{1}) << "the Transport is on the housekeeping core";
}

TEST(CpuPlan, OneCoreOfATwoCoreMachineIsCalledOne) {
  MachineCores cores = machine({0, 1});
  cores.affinity = {1};
  const auto costs = costs_of(fold_cpus(cores), {}, cores);
  EXPECT_TRUE(mentions(costs, "this process may use 1 of this machine's 2 cores"));
  EXPECT_TRUE(mentions(costs, "the Spine shares core 1: it sleeps"));
  EXPECT_TRUE(mentions(costs, "no core is left for the Transport"));
  EXPECT_TRUE(mentions(costs_of(fold_cpus(machine({0})), {}, machine({0})), "this machine has 1 core,"));
  const MachineCores four = machine({0, 1, 2, 3}, {1, 2, 3});
  EXPECT_TRUE(costs_of(fold_cpus(four), {}, four).empty());
}

TEST(CpuPlan, SaysHowACoreIsIsolatedAndWhyItIsTheSpines) {
  MachineCores cores = machine({0, 1, 2, 3}, {1, 2, 3});
  cores.isolated.tickless = {1};
  EXPECT_EQ(isolation_words(cores.isolated, 1), "isolated at boot (isolcpus), no timer tick (nohz_full)");
  EXPECT_EQ(isolation_words(cores.isolated, 2), "isolated at boot (isolcpus)");
  EXPECT_EQ(isolation_words(cores.isolated, 0),
            "not isolated, other programs may run there; isolated are 1-3: spine.cpu_spine can name one");
  EXPECT_EQ(isolation_words({}, 0), "not isolated, other programs may run there");
  EXPECT_EQ(isolation_words({.boot = {}, .cpuset = {2}, .tickless = {}}, 2),
            "isolated by its cpuset (a partition of cgroup v2)");
  EXPECT_EQ(why_spine(1, false, {}, cores.isolated), "isolated cores come first");
  EXPECT_EQ(why_spine(1, false, {}, {}), "nothing else of LITHE runs there");
  EXPECT_EQ(why_spine(0, true, {}, {}), "no other core is left");
}

}  // namespace
}  // namespace lithe::robot
