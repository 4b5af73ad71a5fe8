// SPDX-License-Identifier: Apache-2.0
#include "spine/step/mode.hpp"

#include <gtest/gtest.h>

namespace lithe::step {
namespace {

using wire::CommandKind;
using wire::CommandResult;
using wire::Fault;
using wire::Mode;

constexpr Conditions kReady{.has_law = true, .sample_fresh = true, .estop_pressed = false};

ModeMachine armed() {
  ModeMachine machine;
  EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::done);
  return machine;
}

TEST(ModeMachine, AJointThatMustBeHomedKeepsTheRobotFromBeingArmed) {
  ModeMachine machine;
  Conditions conditions = kReady;
  conditions.homed = false;
  EXPECT_EQ(machine.apply(CommandKind::arm, conditions), CommandResult::refused_not_homed);
  EXPECT_EQ(machine.mode(), Mode::disarmed);
  EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::done);
}

TEST(ModeMachine, AJointOutsideItsLimitsIsNotArmedAndRecoverIsTheWay) {
  ModeMachine machine;
  Conditions outside = kReady;
  outside.inside = false;
  EXPECT_EQ(machine.apply(CommandKind::arm, outside), CommandResult::refused_outside);
  EXPECT_EQ(machine.apply(CommandKind::recover, outside), CommandResult::done);
  EXPECT_TRUE(machine.energised());
  EXPECT_FALSE(machine.law_runs());
  EXPECT_EQ(machine.apply(CommandKind::arm, outside), CommandResult::refused_outside);
  EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::done);
  EXPECT_EQ(machine.apply(CommandKind::recover, kReady), CommandResult::refused_mode) << "a law runs";
}

TEST(ModeMachine, AResetReachesADriveThatFailedWhileItWasOff) {
  ModeMachine machine;
  EXPECT_EQ(machine.apply(CommandKind::reset, kReady), CommandResult::refused_mode);
  Conditions faulty = kReady;
  faulty.sample_fresh = false;
  faulty.drive_fault = true;
  EXPECT_EQ(machine.apply(CommandKind::arm, faulty), CommandResult::refused_not_ready);
  EXPECT_EQ(machine.apply(CommandKind::recover, faulty), CommandResult::refused_not_ready);
  EXPECT_EQ(machine.apply(CommandKind::reset, faulty), CommandResult::done);
  ModeMachine moves = armed();
  EXPECT_EQ(moves.apply(CommandKind::reset, faulty), CommandResult::refused_mode);
  EXPECT_EQ(moves.mode(), Mode::active);
}

TEST(ModeMachine, DamagedMemoryIsNoStateToMoveIn) {
  ModeMachine machine = armed();
  Conditions damaged = kReady;
  damaged.memory_whole = false;
  EXPECT_TRUE(machine.fail(Fault::memory_damaged));
  EXPECT_EQ(machine.apply(CommandKind::arm, damaged), CommandResult::refused_damaged);
  EXPECT_EQ(machine.apply(CommandKind::recover, damaged), CommandResult::refused_damaged);
  EXPECT_EQ(machine.apply(CommandKind::reset, damaged), CommandResult::done) << "the drives off, and no fault latched";
  EXPECT_EQ(machine.apply(CommandKind::arm, damaged), CommandResult::refused_damaged);
  EXPECT_EQ(machine.mode(), Mode::disarmed);
}

TEST(ModeMachine, RecoverLeavesOnlySafeStopsThatItIsTheWayOutOf) {
  for (const Fault fault : {Fault::position_limit, Fault::velocity_limit, Fault::recover_failed}) {
    ModeMachine machine = armed();
    machine.fail(fault);
    EXPECT_EQ(machine.apply(CommandKind::recover, kReady), CommandResult::done);
    EXPECT_EQ(machine.fault(), Fault::none);
    EXPECT_TRUE(machine.fail(Fault::drive_lost));
    EXPECT_EQ(machine.mode(), Mode::safe_stop);
    EXPECT_EQ(machine.apply(CommandKind::recover, kReady), CommandResult::refused_fault);
  }
  ModeMachine machine = armed();
  machine.press_estop();
  EXPECT_EQ(machine.apply(CommandKind::recover, kReady), CommandResult::refused_estop);
}

TEST(ModeMachine, StartsWithNothingDriven) {
  const ModeMachine machine;
  EXPECT_EQ(machine.mode(), Mode::disarmed);
  EXPECT_FALSE(machine.energised());
}

TEST(ModeMachine, ArmingNeedsALawASampleAndAReleasedEstop) {
  ModeMachine machine;
  Conditions conditions = kReady;
  conditions.has_law = false;
  EXPECT_EQ(machine.apply(CommandKind::arm, conditions), CommandResult::refused_law);
  conditions = kReady;
  conditions.sample_fresh = false;
  EXPECT_EQ(machine.apply(CommandKind::arm, conditions), CommandResult::refused_not_ready);
  conditions = kReady;
  conditions.estop_pressed = true;
  EXPECT_EQ(machine.apply(CommandKind::arm, conditions), CommandResult::refused_estop);
  EXPECT_EQ(machine.mode(), Mode::disarmed);
}

TEST(ModeMachine, TheEstopDampsWhatHadTorqueAndLeavesTheRestOff) {
  ModeMachine limp;
  EXPECT_TRUE(limp.press_estop());
  EXPECT_FALSE(limp.damps());
  ModeMachine machine = armed();
  EXPECT_FALSE(machine.damps());
  machine.press_estop();
  machine.press_estop();
  EXPECT_TRUE(machine.damps());
  machine.apply(CommandKind::reset, kReady);
  EXPECT_FALSE(machine.damps());
  machine.press_estop();
  EXPECT_FALSE(machine.damps()) << "off since the reset";
}

TEST(ModeMachine, HoldKeepsTheLawAndArmResumes) {
  ModeMachine machine = armed();
  EXPECT_EQ(machine.apply(CommandKind::hold, kReady), CommandResult::done);
  EXPECT_EQ(machine.mode(), Mode::hold);
  EXPECT_TRUE(machine.law_runs());
  EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::done);
  EXPECT_EQ(machine.mode(), Mode::active);
}

TEST(ModeMachine, AFaultIsLatchedUntilAReset) {
  ModeMachine machine = armed();
  EXPECT_TRUE(machine.fail(Fault::law_not_finite));
  EXPECT_FALSE(machine.fail(Fault::velocity_limit)) << "the first cause stays";
  EXPECT_EQ(machine.mode(), Mode::safe_stop);
  EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::refused_fault);
  EXPECT_EQ(machine.apply(CommandKind::hold, kReady), CommandResult::refused_mode);
  EXPECT_EQ(machine.apply(CommandKind::disarm, kReady), CommandResult::done);
  EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::refused_fault) << "disarming is not a reset";
  EXPECT_EQ(machine.fault(), Fault::law_not_finite);
  EXPECT_EQ(machine.apply(CommandKind::reset, kReady), CommandResult::done);
  EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::done);
}

TEST(ModeMachine, AFaultOfAPartIsLatchedAndTheRestGoesOnUntilAReset) {
  ModeMachine machine = armed();
  machine.fail_in_part(Fault::drive_lost);
  machine.fail_in_part(Fault::drive_fault);
  EXPECT_EQ(machine.fault(), Fault::drive_lost) << "the first cause stays";
  EXPECT_EQ(machine.mode(), Mode::active);
  EXPECT_EQ(machine.apply(CommandKind::hold, kReady), CommandResult::done);
  EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::done) << "the rest may move again";
  EXPECT_EQ(machine.apply(CommandKind::disarm, kReady), CommandResult::done);
  EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::refused_fault);
  EXPECT_EQ(machine.apply(CommandKind::reset, kReady), CommandResult::done);
  EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::done);
  machine.fail_in_part(Fault::drive_lost);
  EXPECT_EQ(machine.apply(CommandKind::reset, kReady), CommandResult::done);
  EXPECT_EQ(machine.mode(), Mode::disarmed) << "a reset never leads straight into motion";
}

TEST(ModeMachine, TheEstopWinsFromEveryModeAndNeedsAResetToLeave) {
  for (const CommandKind before : {CommandKind::none, CommandKind::hold, CommandKind::disarm}) {
    ModeMachine machine = armed();
    machine.apply(before, kReady);
    EXPECT_TRUE(machine.press_estop());
    EXPECT_FALSE(machine.energised());
    EXPECT_EQ(machine.apply(CommandKind::arm, kReady), CommandResult::refused_estop);
    EXPECT_EQ(machine.apply(CommandKind::disarm, kReady), CommandResult::refused_estop);
    Conditions pressed = kReady;
    pressed.estop_pressed = true;
    EXPECT_EQ(machine.apply(CommandKind::reset, pressed), CommandResult::refused_estop);
    EXPECT_EQ(machine.apply(CommandKind::reset, kReady), CommandResult::done);
    EXPECT_EQ(machine.mode(), Mode::disarmed) << "a reset never leads straight into motion";
  }
}

TEST(ModeMachine, NothingIsFaultyWhileNothingIsDriven) {
  ModeMachine machine;
  EXPECT_FALSE(machine.fail(Fault::sample_stale));
  EXPECT_EQ(machine.fault(), Fault::none);
  EXPECT_EQ(machine.apply(CommandKind::reset, kReady), CommandResult::refused_mode);
}

TEST(ModeMachine, RefusesWhatItDoesNotKnow) {
  ModeMachine machine;
  EXPECT_EQ(machine.apply(static_cast<CommandKind>(4711), kReady), CommandResult::refused_unknown);
}

}  // namespace
}  // namespace lithe::step
