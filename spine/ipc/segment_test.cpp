// SPDX-License-Identifier: Apache-2.0
#include "spine/ipc/segment.hpp"

#include <fcntl.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>

#include "spine/ipc/test/halfway_rig.hpp"

namespace lithe::ipc {
namespace {

constexpr int kNobodyElse = 2;  // exit code of a child that could not become another user

using Brain = Segment<BrainMemory>;

class SegmentTest : public ::testing::Test {
 protected:
  void SetUp() override { setenv("LITHE_SHM_PREFIX", ("segment-test-" + std::to_string(getpid())).c_str(), 1); }
  void TearDown() override {
    for (const char* end : {"", ".lock"}) unlink((segment_path() + end).c_str());
  }
  static std::string segment_path() { return Brain::path("arm"); }
  static std::string refusal() {
    const auto attached = Brain::attach("arm", Access::read);
    return attached ? "" : attached.message();
  }
};

// Replaces one line of the schema text in a mapped segment, and the hash with it.
void change_schema(BrainMemory& memory, std::string_view from, std::string_view to) {
  auto* text = reinterpret_cast<char*>(&memory) + memory.header.schema_offset;
  const std::string_view schema(text, memory.header.schema_bytes);
  ASSERT_EQ(from.size(), to.size());
  const std::size_t at = schema.find(from);
  ASSERT_NE(at, std::string_view::npos);
  std::memcpy(text + at, to.data(), to.size());
  memory.header.layout_hash ^= 1;
}

TEST_F(SegmentTest, WhatOneWritesTheOtherReads) {
  auto writer = Brain::create("arm");
  ASSERT_TRUE(writer) << writer.message();
  auto reader = Brain::attach("arm", Access::read);
  ASSERT_TRUE(reader) << reader.message();
  wire::Plan plan;
  plan.plan_id = 42;
  ChannelWriter<wire::Plan>((*writer)->plan).write(plan);
  wire::Plan seen;
  ASSERT_TRUE(ChannelReader<wire::Plan>((*reader)->plan).read(seen));
  EXPECT_EQ(seen.plan_id, 42u);
}

TEST_F(SegmentTest, FreshSegmentIsZeroPrivateToItsGroupAndLeavesNoTemporaryFile) {
  auto segment = Brain::create("arm");
  ASSERT_TRUE(segment) << segment.message();
  struct stat status{};
  ASSERT_EQ(stat(segment_path().c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777u, 0660u);
  EXPECT_EQ((*segment)->plan.latest, 0u);
  EXPECT_EQ((*segment)->estop.value, 0u);
  EXPECT_EQ((*segment)->header.layout_hash, wire::kLayoutHash);
  EXPECT_FALSE(std::filesystem::exists(segment_path() + "." + std::to_string(getpid())));
}

TEST_F(SegmentTest, StaleSegmentOfACrashedRunIsReplaced) {
  test::in_child([] {
    auto lease = Lease::try_take(Brain::path("arm"));
    auto segment = Brain::create("arm");
    sign_in((*segment)->header, 1);
    (*segment)->estop.value = 1;
    test::kill_self();
  });
  ASSERT_TRUE(std::filesystem::exists(segment_path()));
  auto lease = Lease::try_take(segment_path());
  ASSERT_TRUE(lease) << lease.message();
  EXPECT_TRUE(lease->has_value()) << "the kernel frees the lease when its holder is killed";
  auto segment = Brain::create("arm");
  ASSERT_TRUE(segment) << segment.message();
  EXPECT_EQ((*segment)->estop.value, 0u);
}

TEST_F(SegmentTest, OnlyOneMayHoldTheLease) {
  EXPECT_FALSE(Lease::is_held(segment_path()));
  {
    auto first = Lease::try_take(segment_path());
    ASSERT_TRUE(first && first->has_value());
    EXPECT_TRUE(Lease::is_held(segment_path()));
    auto second = Lease::try_take(segment_path());
    ASSERT_TRUE(second) << second.message();
    EXPECT_FALSE(second->has_value());
  }
  EXPECT_FALSE(Lease::is_held(segment_path()));
}

TEST_F(SegmentTest, WhoLooksKeepsNobodyFromTakingTheLease) {
  ASSERT_TRUE(Lease::try_take(segment_path()));  // its file exists
  std::atomic<bool> done{false};
  std::thread looker([&] {
    while (!done) {
      Lease::is_held(segment_path());
      usleep(50);  // a real caller does other things too
    }
  });
  int refused = 0;
  for (int i = 0; i < 200; ++i) {
    const auto taken = Lease::try_take(segment_path());
    refused += taken && taken->has_value() ? 0 : 1;
  }
  done = true;
  looker.join();
  EXPECT_EQ(refused, 0);
}

TEST_F(SegmentTest, TwoWhoLookDoNotTakeEachOtherForTheHolder) {
  ASSERT_TRUE(Lease::try_take(segment_path()));
  const int other = open((segment_path() + ".lock").c_str(), O_RDWR | O_CLOEXEC);
  ASSERT_EQ(flock(other, LOCK_SH | LOCK_NB), 0) << "as is_held() does";
  EXPECT_FALSE(Lease::is_held(segment_path()));
  close(other);
}

// A pipe in the place of a lock or a segment: nobody waits for its other end, and nothing is taken for a robot.
TEST_F(SegmentTest, APipeInTheirPlaceIsNotWaitedFor) {
  ASSERT_EQ(mkfifo(segment_path().c_str(), 0600), 0);
  ASSERT_EQ(mkfifo((segment_path() + ".lock").c_str(), 0600), 0);
  EXPECT_FALSE(Lease::is_held(segment_path()));
  EXPECT_NE(refusal().find("too short for a LITHE segment"), std::string::npos) << refusal();
}

TEST_F(SegmentTest, WhatAnotherUserLeftIsSaidToBeTheirs) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can leave it for another user";
  auto segment = Brain::create("arm");
  ASSERT_TRUE(segment && Lease::try_take(segment_path()));
  ASSERT_EQ(chmod(segment_path().c_str(), 0600) | chmod((segment_path() + ".lock").c_str(), 0600), 0);
  const pid_t child = fork();
  if (child == 0) {
    constexpr uid_t kNobody = 65534;
    if (setgroups(0, nullptr) != 0 || setgid(kNobody) != 0 || setuid(kNobody) != 0) _exit(kNobodyElse);
    const auto whose = [](const std::string& message) {
      return message.find("belongs to root, whose robot has or had this name: let root stop it") != std::string::npos;
    };
    const auto lease = Lease::try_take(segment_path());
    const auto fresh = Brain::create("arm");
    _exit(!lease && whose(lease.message()) && !fresh && whose(fresh.message()) && whose(refusal()) ? 0 : 1);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  if (WEXITSTATUS(status) == kNobodyElse) GTEST_SKIP() << "no right to become another user";
  EXPECT_EQ(status, 0);
}

TEST_F(SegmentTest, WhoMayNotLookIsNotToldThatNobodyIsThere) {
  if (geteuid() != 0) {
    auto lease = Lease::try_take(segment_path());
    ASSERT_TRUE(lease && lease->has_value());
    ASSERT_EQ(chmod((segment_path() + ".lock").c_str(), 0), 0);
    EXPECT_TRUE(Lease::is_held(segment_path()));
    return;
  }
  auto lease = Lease::try_take(segment_path());
  ASSERT_TRUE(lease && lease->has_value());
  const pid_t somebody = fork();
  if (somebody == 0) {
    const bool left = setgroups(0, nullptr) == 0 && setgid(65534) == 0 && setuid(65534) == 0;
    _exit(!left ? kNobodyElse : Lease::is_held(segment_path()) ? 0 : 1);
  }
  int status = 0;
  ASSERT_EQ(waitpid(somebody, &status, 0), somebody);
  if (WEXITSTATUS(status) == kNobodyElse) GTEST_SKIP() << "this root may be nobody else: it is one in a user namespace";
  EXPECT_EQ(status, 0);
}

// A process of another user that sees all processes of the machine can tell that the owner has crashed.
TEST_F(SegmentTest, FilesOfACrashedRootAreNobodys) {
  char space[64] = {};
  const bool sees_all = readlink("/proc/self/ns/pid", space, sizeof space - 1) > 0 &&
                        std::string(space) == "pid:[4026531836]" && std::ifstream("/proc/locks").good();
  if (geteuid() != 0 || !sees_all) GTEST_SKIP() << "needs root outside of containers";
  {
    ASSERT_TRUE(Lease::try_take(segment_path()));
  }
  const pid_t somebody = fork();
  if (somebody == 0) {
    const bool left = setgroups(0, nullptr) == 0 && setgid(65534) == 0 && setuid(65534) == 0;
    _exit(!left ? kNobodyElse : !Lease::is_held(segment_path()) ? 0 : 1);
  }
  int status = 0;
  ASSERT_EQ(waitpid(somebody, &status, 0), somebody);
  if (WEXITSTATUS(status) == kNobodyElse) GTEST_SKIP() << "this root may be nobody else: it is one in a user namespace";
  EXPECT_EQ(status, 0);
}

TEST_F(SegmentTest, SigningInSaysWhoWritesAndCountsTheWriters) {
  auto segment = Brain::create("arm");
  ASSERT_TRUE(segment) << segment.message();
  sign_in((*segment)->header, 7);
  sign_in((*segment)->header, 8);
  EXPECT_EQ((*segment)->header.epoch, 2u);
  EXPECT_EQ((*segment)->header.writer_pid, static_cast<std::uint64_t>(getpid()));
  EXPECT_EQ((*segment)->header.heartbeat_ns, 8);
}

TEST_F(SegmentTest, AbsentSegmentIsRefusedWithWhatToDo) {
  EXPECT_NE(refusal().find("lithe run ROBOT.toml"), std::string::npos) << refusal();
}

TEST_F(SegmentTest, ForeignOrShortFileIsRefused) {
  std::ofstream(segment_path()) << "short";
  EXPECT_NE(refusal().find("too short"), std::string::npos) << refusal();
  std::ofstream(segment_path()) << std::string(sizeof(BrainMemory) + 4096, 'x');
  EXPECT_NE(refusal().find("not a LITHE segment"), std::string::npos) << refusal();
  auto segment = Brain::create("arm");
  ASSERT_TRUE(segment) << segment.message();
  ASSERT_EQ(truncate(segment_path().c_str(), 4096), 0);
  EXPECT_NE(refusal().find("shorter than its layout"), std::string::npos) << refusal();
}

TEST_F(SegmentTest, AnotherLayoutIsRefusedFieldByField) {
  auto segment = Brain::create("arm");
  ASSERT_TRUE(segment) << segment.message();
  change_schema(**segment, "Plan.t_ns:int64[16]:24:128:ns", "Plan.t_ns:int64[16]:24:128:us");
  const std::string text = refusal();
  EXPECT_NE(text.find("here  Plan.t_ns:int64[16]:24:128:ns"), std::string::npos) << text;
  EXPECT_NE(text.find("there Plan.t_ns:int64[16]:24:128:us"), std::string::npos) << text;
  EXPECT_EQ(text.find("Plan.plan_id"), std::string::npos) << "fields that agree are not listed";
}

TEST_F(SegmentTest, SchemaTextOutsideTheSegmentIsRefused) {
  auto segment = Brain::create("arm");
  ASSERT_TRUE(segment) << segment.message();
  (*segment)->header.layout_hash ^= 1;
  for (const std::uint64_t offset : {std::uint64_t{1} << 40, ~std::uint64_t{0} - 4}) {
    (*segment)->header.schema_offset = offset;
    EXPECT_NE(refusal().find("outside the segment"), std::string::npos) << refusal();
  }
}

TEST(SchemaDifference, GrowthAtTheEndPasses) {
  EXPECT_EQ(schema_difference("abi:1\nA.x:uint64[1]:0:8:-\n", "abi:1\nA.x:uint64[1]:0:8:-\nB.y:uint64[1]:0:8:-\n"), "");
}

TEST(SchemaDifference, MissingFieldAndOtherAbiAreTold) {
  EXPECT_EQ(schema_difference("abi:1\nA.x:uint64[1]:0:8:-\n", "abi:1\n"),
            "  here  A.x:uint64[1]:0:8:-\n  there (absent)\n");
  EXPECT_EQ(schema_difference("abi:1\n", "abi:2\n"), "  here  abi:1\n  there abi:2\n");
}

}  // namespace
}  // namespace lithe::ipc
