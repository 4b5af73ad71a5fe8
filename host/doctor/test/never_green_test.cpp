// SPDX-License-Identifier: Apache-2.0
// Over every file and folder of every fake machine: what cannot be read never makes an item, or the tier, better than
// it was.
#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "host/doctor/diagnosis.hpp"
#include "host/test/machines_rig.hpp"

namespace lithe::host {
namespace {

namespace fs = std::filesystem;

struct Machine {
  const char* name;
  void (*put)(const FakeRoot& root);
};

class NeverGreen : public ::testing::TestWithParam<Machine> {};

// A reading that is gone may make an item unknown, and otherwise only worse.
bool is_no_better(State before, State after) {
  const std::map<State, int> goodness = {
      {State::fail, 0}, {State::warn, 1}, {State::unknown, 2}, {State::not_applicable, 3}, {State::ok, 4}};
  return after == State::unknown || goodness.at(after) <= goodness.at(before);
}

std::vector<std::string> files_of(const FakeRoot& root) {
  std::vector<std::string> paths;
  for (const auto& each : fs::recursive_directory_iterator(root.path()))
    if (each.is_regular_file()) paths.push_back(each.path().string());
  return paths;
}

std::vector<std::string> folders_of(const FakeRoot& root) {
  std::vector<std::string> paths;
  for (const auto& each : fs::recursive_directory_iterator(root.path()))
    if (each.is_directory()) paths.push_back(each.path().string());
  return paths;
}

void compare(const Diagnosis& before, const Diagnosis& after, const std::string& how) {
  for (std::size_t i = 0; i < before.findings.size(); ++i) {
    const State was = before.findings[i].state, is = after.findings[i].state;
    EXPECT_TRUE(is_no_better(was, is)) << how << ": " << checklist()[i].id << " was " << word(was) << ", is "
                                       << word(is) << " (" << after.findings[i].words << ")";
  }
  EXPECT_GE(after.verdict.tier, before.verdict.tier) << how;
  EXPECT_TRUE(before.hypervisor.present == false || after.hypervisor.present != false) << how;
}

TEST_P(NeverGreen, AFileThatIsRemovedOrUnreadableMakesNothingBetter) {
  const FakeRoot root;
  GetParam().put(root);
  const HostFiles files(root.path());
  const Diagnosis before = diagnose(files, kJudged);
  const std::vector<std::string> paths = files_of(root);
  ASSERT_GT(paths.size(), 50U);
  for (const std::string& path : paths) {
    const std::string kept = path + ".kept";
    fs::rename(path, kept);
    compare(before, diagnose(files, kJudged), "without " + path.substr(root.path().size()));
    fs::create_symlink(path, path);  // a link to itself: an error that is not "absent", for root, too
    compare(before, diagnose(files, kJudged), "unreadable " + path.substr(root.path().size()));
    fs::remove(path);
    fs::rename(kept, path);
  }
}

TEST_P(NeverGreen, AFolderThatCannotBeListedMakesNothingBetter) {
  const FakeRoot root;
  GetParam().put(root);
  const HostFiles files(root.path());
  const Diagnosis before = diagnose(files, kJudged);
  const std::vector<std::string> paths = folders_of(root);
  ASSERT_GT(paths.size(), 50U);
  const std::string kept = root.path() + ".kept";  // outside: a group beside its place would be found there
  for (const std::string& path : paths) {
    fs::rename(path, kept);
    fs::create_symlink(path, path);
    compare(before, diagnose(files, kJudged), "unreadable " + path.substr(root.path().size()));
    fs::remove(path);
    fs::rename(kept, path);
  }
}

INSTANTIATE_TEST_SUITE_P(Machines, NeverGreen,
                         ::testing::Values(Machine{"desktop", put_desktop}, Machine{"pinned", put_pinned},
                                           Machine{"partition", put_partition}, Machine{"booted", put_booted},
                                           Machine{"pi", put_pi}, Machine{"fifo", put_fifo}),
                         [](const auto& each) { return std::string(each.param.name); });

TEST(NeverGreenTwin, TheComparisonFindsAVerdictThatGotBetter) {
  EXPECT_FALSE(is_no_better(State::fail, State::ok));
  EXPECT_FALSE(is_no_better(State::fail, State::warn));
  EXPECT_FALSE(is_no_better(State::warn, State::not_applicable));
  EXPECT_FALSE(is_no_better(State::unknown, State::ok));
  EXPECT_TRUE(is_no_better(State::fail, State::unknown));
  EXPECT_TRUE(is_no_better(State::ok, State::warn));
}

TEST(NeverGreen, OfAnEmptyMachineNothingIsInOrder) {
  const FakeRoot root;
  const Diagnosis diagnosis = diagnose(HostFiles(root.path()), kJudged);
  EXPECT_EQ(diagnosis.verdict.tier, Tier::d);
  EXPECT_EQ(diagnosis.hypervisor.present, std::nullopt);
  for (std::size_t i = 0; i < diagnosis.findings.size(); ++i)
    EXPECT_NE(diagnosis.findings[i].state, State::ok) << checklist()[i].id;
}

}  // namespace
}  // namespace lithe::host
