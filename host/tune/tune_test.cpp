// SPDX-License-Identifier: Apache-2.0
// The whole of `lithe tune` on machines made of files.
#include "host/tune/tune.hpp"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <functional>

#include "host/test/killed_rig.hpp"
#include "host/test/machine_rig.hpp"
#include "host/tune/boot/boot.hpp"
#include "host/tune/shield/shield.hpp"

namespace lithe::host {
namespace {

using Content = std::map<std::string, std::string>;

void write_grub(const FakeRoot& root) {
  root.write("/etc/debian_version", "12.5\n");
  root.write("/etc/default/grub", "GRUB_CMDLINE_LINUX=\"quiet\"\n");
}

Target target_at(const FakeRoot& root) { return {.root = root.path(), .all_cores = {0, 1, 2, 3}, .cores = {1}}; }

std::vector<Step> must(Result<TuneResult> result) {
  EXPECT_TRUE(result) << result.message();
  return result ? result->steps : std::vector<Step>{};
}

const Step* step_of(const std::vector<Step>& steps, const std::string& path) {
  const auto at = std::find_if(steps.begin(), steps.end(), [&](const Step& each) { return each.change.path == path; });
  return at == steps.end() ? nullptr : &*at;
}

class TuneTest : public ::testing::Test {
 protected:
  TuneTest() { write_board(root_); }

  std::vector<Step> apply() const { return must(tune_apply(target_, tune_plan(target_).changes)); }
  std::vector<Step> revert(bool forget = false) const { return must(tune_revert(target_, forget)); }
  std::string text(const std::string& path) const { return HostFiles(root_.path()).read(path).value; }

  FakeRoot root_;
  Target target_ = target_at(root_);
};

TEST_F(TuneTest, ApplyMakesThePlanAndRevertGivesBackEveryByte) {
  const Content before = content_of(root_);
  const std::vector<Step> made = apply();
  EXPECT_TRUE(std::all_of(made.begin(), made.end(), [](const Step& each) { return each.outcome == Outcome::done; }));
  EXPECT_EQ(text("/proc/irq/24/smp_affinity_list"), "0,2-3");
  EXPECT_NE(text("/etc/security/limits.d/lithe.conf").find("@lithe - nice -20"), std::string::npos);
  EXPECT_EQ(text("/etc/security/limits.d/lithe.conf").find('*'), std::string::npos) << "not every user";
  EXPECT_NE(content_of(root_), before);
  EXPECT_EQ(revert().size(), made.size());
  // The huge pages' file is the kernel's own: a plain file does not grow its brackets again.
  root_.write("/sys/kernel/mm/transparent_hugepage/enabled", "[always] madvise never\n");
  EXPECT_EQ(content_of(root_), before);
}

TEST_F(TuneTest, ABoardThatDoesNotBootIsRevertedFromAnotherComputer) {
  write_grub(root_);
  const auto lasting = [&] {
    Content files = content_of(root_);
    std::erase_if(files, [](const auto& each) { return !each.first.starts_with("/etc/"); });
    return files;
  };
  const Content before = lasting();
  apply();
  ASSERT_NE(text("/etc/default/grub.d/99-lithe.cfg") + text("/etc/default/grub"), before.at("/etc/default/grub"));
  target_.image = true;
  revert();
  EXPECT_EQ(lasting(), before);
  EXPECT_TRUE(revert().empty()) << "its journal is gone";
}

TEST_F(TuneTest, ASecondApplyChangesNothingAndKeepsTheFirstValue) {
  apply();
  const Content tuned = content_of(root_);
  EXPECT_TRUE(apply().empty());
  EXPECT_EQ(content_of(root_), tuned);
  root_.write("/proc/sys/vm/stat_interval", "3\n");  // and somebody else changes it in between
  EXPECT_EQ(apply().size(), 1u);
  revert();
  EXPECT_EQ(text("/proc/sys/vm/stat_interval"), "1");
}

TEST_F(TuneTest, RevertWithoutApplyDoesNothing) {
  const Content before = content_of(root_);
  EXPECT_TRUE(revert().empty());
  EXPECT_EQ(content_of(root_), before);
  EXPECT_FALSE(std::filesystem::exists(root_.path() + "/run"));
}

TEST_F(TuneTest, WhatSomebodyElseChangedStaysAndIsNamed) {
  apply();
  root_.write("/proc/irq/24/smp_affinity_list", "2\n");
  root_.write("/etc/sysctl.d/90-lithe.conf", "edited\n");
  const std::vector<Step> undone = revert();
  ASSERT_NE(step_of(undone, "/proc/irq/24/smp_affinity_list"), nullptr);
  EXPECT_EQ(step_of(undone, "/proc/irq/24/smp_affinity_list")->why(), "somebody else changed it to 2");
  EXPECT_EQ(step_of(undone, "/etc/sysctl.d/90-lithe.conf")->outcome, Outcome::foreign);
  EXPECT_EQ(text("/proc/irq/24/smp_affinity_list"), "2");
  EXPECT_EQ(text("/etc/sysctl.d/90-lithe.conf"), "edited");
  EXPECT_EQ(revert().size(), 2u) << "they stay in the journal";
  EXPECT_EQ(revert(true).size(), 2u);
  EXPECT_TRUE(revert().empty()) << "--force drops them";
  EXPECT_EQ(text("/etc/sysctl.d/90-lithe.conf"), "edited");
}

TEST_F(TuneTest, AFilesModeStays) {
  root_.write("/etc/sysctl.d/90-lithe.conf", "old\n");
  const std::string path = root_.path() + "/etc/sysctl.d/90-lithe.conf";
  ::chmod(path.c_str(), 0604);
  const Content before = content_of(root_);
  apply();
  struct stat about{};
  ::stat(path.c_str(), &about);
  EXPECT_EQ(about.st_mode & 07777U, 0604U);
  EXPECT_NE(text("/etc/sysctl.d/90-lithe.conf"), "old");
  revert();
  EXPECT_EQ(content_of(root_).at("/etc/sysctl.d/90-lithe.conf"), before.at("/etc/sysctl.d/90-lithe.conf"));
}

TEST_F(TuneTest, ASymbolicLinkIsNotReplaced) {
  root_.write("/etc/real.conf", "real\n");
  std::filesystem::create_symlink("../real.conf", root_.path() + "/etc/sysctl.d/90-lithe.conf");
  const std::vector<Step> made = apply();
  ASSERT_NE(step_of(made, "/etc/sysctl.d/90-lithe.conf"), nullptr);
  EXPECT_EQ(step_of(made, "/etc/sysctl.d/90-lithe.conf")->outcome, Outcome::refused);
  EXPECT_TRUE(std::filesystem::is_symlink(root_.path() + "/etc/sysctl.d/90-lithe.conf"));
  EXPECT_EQ(text("/etc/real.conf"), "real");
}

TEST_F(TuneTest, AnImageGetsItsFilesAndNoSetting) {
  target_.image = true;
  const std::vector<Step> made = apply();
  EXPECT_EQ(made.size(), 2u);
  EXPECT_EQ(text("/proc/irq/24/smp_affinity_list"), "0-3");
  EXPECT_FALSE(std::filesystem::exists(root_.path() + "/run"));
  EXPECT_EQ(revert().size(), 2u);
}

TEST_F(TuneTest, ABootVoidsTheSettingsAndKeepsTheFiles) {
  apply();
  root_.write("/proc/sys/kernel/random/boot_id", "another\n");
  const std::vector<Step> undone = revert();
  EXPECT_EQ(undone.size(), 2u);
  EXPECT_EQ(text("/proc/sys/vm/stat_interval"), "10") << "the new boot's value is nobody's";
  EXPECT_FALSE(std::filesystem::exists(root_.path() + "/etc/sysctl.d/90-lithe.conf"));
}

TEST_F(TuneTest, AVanishedInterruptIsNoTrouble) {
  apply();
  std::filesystem::remove_all(root_.path() + "/proc/irq/24");
  const std::vector<Step> undone = revert();
  EXPECT_EQ(step_of(undone, "/proc/irq/24/smp_affinity_list")->outcome, Outcome::gone);
  EXPECT_TRUE(revert().empty());
}

TEST(TuneOutcome, AnInterruptThatNobodyMayMoveIsNoTrouble) {
  const Change interrupt{.item = "irq_affinity", .path = "/proc/irq/0/smp_affinity_list"};
  for (const int error : {EIO, EPERM}) {
    Step step{.change = interrupt, .outcome = outcome_of(interrupt, error), .error = error};
    EXPECT_EQ(step.outcome, Outcome::fixed) << error;
    EXPECT_TRUE(step.well());
  }
  EXPECT_EQ(outcome_of(interrupt, EACCES), Outcome::refused) << "missing rights stay an error";
  EXPECT_EQ(outcome_of({.item = "governor"}, EIO), Outcome::refused);
  EXPECT_EQ(outcome_of(interrupt, 0), Outcome::done);
}

TEST_F(TuneTest, TheSpinesCoreLosesTheTickWhereverItStands) {
  write_grub(root_);
  root_.write("/proc/sys/kernel/osrelease", "6.1.0\n");
  root_.write("/boot/config-6.1.0", "CONFIG_CPU_ISOLATION=y\nCONFIG_NO_HZ_FULL=y\nCONFIG_RCU_NOCB_CPU=y\n");
  target_.cores = {1, 3};
  const auto line = [&] {
    for (const Change& each : tune_plan(target_).changes)
      if (each.item == kBootItem) return each.after;
    return std::string();
  };
  const std::string first = line();
  target_.spine = 3;
  ASSERT_NE(first.find("nohz_full=1 "), std::string::npos) << first;
  EXPECT_NE(line().find("nohz_full=3 "), std::string::npos) << line();
}

TEST_F(TuneTest, ARevertTellsItsCommandAlsoWhenTheBootFileIsRefusedNow) {
  write_grub(root_);
  root_.write("/etc/default/grub.d/50-mine.cfg", "\n");
  const auto made = tune_apply(target_, tune_plan(target_).changes);
  ASSERT_TRUE(made && made->well()) << made.message();
  EXPECT_EQ(made->notes, std::vector<std::string>{"the boot line is in force after a reboot"});
  root_.write("/etc/default/grub", "GRUB_CMDLINE_LINUX=\"isolcpus=2\"\n");
  ASSERT_FALSE(tune_plan(target_).not_done.empty()) << "a flag of ours with another value";
  const auto undone = tune_revert(target_, false);
  ASSERT_TRUE(undone && undone->well()) << undone.message();
  EXPECT_EQ(undone->commands, std::vector<std::string>{"update-grub"});
  EXPECT_EQ(undone->notes.size(), 1u) << "the values of sysctl.d stay; no core is isolated yet";
  write_grub(root_);
  ASSERT_TRUE(tune_apply(target_, tune_plan(target_).changes));
  root_.write("/sys/devices/system/cpu/isolated", "1\n");  // booted with it
  EXPECT_EQ(tune_revert(target_, false)->notes.size(), 2u) << "and the isolated core stays";
}

TEST_F(TuneTest, AReadOnlyDiskIsFoundBeforeAnythingIsChanged) {
  root_.write("/var/lib/lithe", "a file, so no folder can be made there");
  const Content before = content_of(root_);
  EXPECT_FALSE(tune_apply(target_, tune_plan(target_).changes));
  EXPECT_EQ(content_of(root_), before);
}

TEST_F(TuneTest, AJournalWithLinesThatCannotBeReadIsNotDone) {
  for (const char* journal : {kRunJournal, kLastingJournal, kShieldJournal}) {
    apply();
    std::ofstream(root_.path() + journal, std::ios::app) << "?\n";
    ::chmod((root_.path() + journal).c_str(), 0600);
    const auto undone = tune_revert(target_, false);
    ASSERT_TRUE(undone) << undone.message();
    EXPECT_FALSE(undone->well());
    EXPECT_TRUE(std::ranges::any_of(undone->notes, [&](const std::string& note) {
      return note.find(journal + std::string(": 1 lines cannot be read")) != std::string::npos;
    })) << journal;
    EXPECT_TRUE(tune_revert(target_, true)->well()) << "given up";
    EXPECT_FALSE(std::filesystem::exists(root_.path() + journal));
  }
}

TEST_F(TuneTest, AStalePlanDoesNotOverwrite) {
  const std::vector<Change> changes = tune_plan(target_).changes;
  root_.write("/proc/sys/vm/stat_interval", "7\n");
  const std::vector<Step> made = must(tune_apply(target_, changes));
  EXPECT_EQ(step_of(made, "/proc/sys/vm/stat_interval")->outcome, Outcome::foreign);
  EXPECT_EQ(text("/proc/sys/vm/stat_interval"), "7");
}

// The brackets are the kernel's: without them a plain file comes back to the byte.
void write_plain_board(const FakeRoot& root) {
  write_board(root);
  root.write("/sys/kernel/mm/transparent_hugepage/enabled", "always\n");
  for (int i = 40; i < 70; ++i) root.write("/proc/irq/" + std::to_string(i) + "/smp_affinity_list", "0-3\n");
  root.write("/etc/sysctl.d/90-lithe.conf", std::string("old \xff bytes\n", 12));
  write_grub(root);
}

TEST(TuneKills, AnApplyKilledBeforeAnySystemCallIsUndoneToTheByte) {
  int kills = 0;
  for (bool killed = true; killed; kills += killed ? 1 : 0) {
    const FakeRoot root;
    write_plain_board(root);
    const Content before = content_of(root);
    const Target target = target_at(root);
    const std::vector<Change> changes = tune_plan(target).changes;
    killed = killed_at(kills + 1, [&](const StepHook& hook) { (void)tune_apply(target, changes, hook); });
    const auto undone = tune_revert(target, false);
    ASSERT_TRUE(undone && undone->well()) << "killed before system call " << kills + 1;
    ASSERT_EQ(content_of(root), before) << "killed before system call " << kills + 1;
  }
  std::printf("%d kills of apply\n", kills);
  EXPECT_GT(kills, 130);
}

// A disk that is full: no file, the journal among them, grows beyond so many bytes. The kernel's own files are shorter.
TEST(TuneFullDisk, ApplySaysSoAndWhatItMadeIsUndoneToTheByte) {
  constexpr rlim_t kLeastBytes = 64, kMoreBytes = 97;
  int full = 0;
  for (bool fits = false; !fits; full += fits ? 0 : 1) {
    const FakeRoot root;
    write_plain_board(root);
    const Content before = content_of(root);
    const Target target = target_at(root);
    const std::vector<Change> changes = tune_plan(target).changes;
    const rlim_t most = kLeastBytes + kMoreBytes * static_cast<rlim_t>(full);
    const pid_t child = ::fork();
    if (child == 0) {
      ::signal(SIGXFSZ, SIG_IGN);
      const rlimit limit{most, most};
      ::setrlimit(RLIMIT_FSIZE, &limit);
      const Result<TuneResult> made = tune_apply(target, changes);
      ::_exit(made && made->well() ? 0 : 1);
    }
    int status = 0;
    ::waitpid(child, &status, 0);
    ASSERT_TRUE(WIFEXITED(status));
    fits = WEXITSTATUS(status) == 0;
    if (fits) ASSERT_TRUE(tune_plan(target).changes.empty()) << "it was said to be complete";
    ASSERT_LT(full, 2000);
    const auto undone = tune_revert(target, false);
    ASSERT_TRUE(undone && undone->well()) << most << " bytes";
    ASSERT_EQ(content_of(root), before) << most << " bytes";
  }
  std::printf("%d full disks\n", full);
  EXPECT_GT(full, 20);
}

TEST(TuneKills, ARevertKilledBeforeAnySystemCallIsFinishedByTheNext) {
  int kills = 0;
  for (bool killed = true; killed; kills += killed ? 1 : 0) {
    const FakeRoot root;
    write_plain_board(root);
    const Content before = content_of(root);
    const Target target = target_at(root);
    must(tune_apply(target, tune_plan(target).changes));
    killed = killed_at(kills + 1, [&](const StepHook& hook) { (void)tune_revert(target, false, hook); });
    const auto next = tune_revert(target, false);
    ASSERT_TRUE(next) << next.message();
    ASSERT_EQ(content_of(root), before) << "killed before system call " << kills + 1;
    // The killed one could not tell it.
    const std::vector<std::string> told{killed ? std::vector<std::string>{"update-grub"} : std::vector<std::string>{}};
    ASSERT_EQ(next->commands, told) << "killed before system call " << kills + 1;
  }
  std::printf("%d kills of revert\n", kills);
  EXPECT_GT(kills, 70);
}

TEST(TuneKills, AnApplyKilledTwiceKeepsTheFirstValues) {
  int kills = 0;
  for (bool killed = true; killed; kills += 3) {
    const FakeRoot root;
    write_plain_board(root);
    const Content before = content_of(root);
    const Target target = target_at(root);
    const auto work = [&](const StepHook& hook) { (void)tune_apply(target, tune_plan(target).changes, hook); };
    killed = killed_at(kills + 1, work);
    killed_at(kills / 2 + 1, work);
    must(tune_revert(target, false));
    ASSERT_EQ(content_of(root), before) << "killed before system call " << kills + 1;
  }
  EXPECT_GT(kills, 100);
}

TEST(TuneProperty, AnyMachineIsTunedOnceAndComesBack) {
  constexpr int kMachines = 200;
  for (int seed = 0; seed < kMachines; ++seed) {
    std::mt19937 random(static_cast<unsigned>(seed));
    const FakeRoot root;
    write_some_board(root, random);
    const Content before = content_of(root);
    const Target target = target_at(root);
    const std::vector<Step> made = must(tune_apply(target, tune_plan(target).changes));
    ASSERT_TRUE(tune_plan(target).changes.empty()) << "seed " << seed;
    // Somebody else changes some of it.
    Content theirs;
    for (const Step& each : made)
      if (each.change.kind == ChangeKind::setting && random() % 8 == 0) theirs[each.change.path] = "12345";
    for (const auto& [path, value] : theirs) root.write(path, value);
    const std::vector<Step> undone = must(tune_revert(target, false));
    for (const Step& each : undone)
      ASSERT_EQ(each.outcome == Outcome::foreign, theirs.contains(each.change.path)) << "seed " << seed;
    Content after = content_of(root), wanted = before;
    for (const auto& [path, value] : theirs) wanted[path] = after[path];
    const std::string pages = "/sys/kernel/mm/transparent_hugepage/enabled";
    wanted.erase(pages);  // its brackets are the kernel's own
    after.erase(pages);
    ASSERT_EQ(after, wanted) << "seed " << seed;
  }
}

}  // namespace
}  // namespace lithe::host
