// SPDX-License-Identifier: Apache-2.0
#include "host/tune/journal/journal.hpp"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <sstream>
#include <utility>

#include "host/read/files.hpp"
#include "host/test/machine_rig.hpp"
#include "host/test/root_rig.hpp"
#include "host/tune/journal/writer.hpp"
#include "spine/core/lookup.hpp"

namespace {

// What a power cut leaves: of each file its text when fsync() was last called for it; "" of a folder.
std::map<std::string, std::string>& on_disk() {
  static std::map<std::string, std::string> files;
  return files;
}

}  // namespace

// In the place of the C library's: in this program, the journal calls it.
extern "C" int fsync(int fd) {
  std::error_code failed;
  const auto path = std::filesystem::read_symlink("/proc/self/fd/" + std::to_string(fd), failed);
  std::ostringstream text;
  if (!std::filesystem::is_directory(path, failed)) text << std::ifstream(path).rdbuf();
  on_disk()[path] = text.str();
  return static_cast<int>(::syscall(SYS_fsync, fd));
}

namespace lithe::host {
namespace {

class JournalTest : public ::testing::Test {
 protected:
  Journal open(const std::string& boot = kFakeBoot) const {
    auto journal = Journal::open(path_, boot, true);
    EXPECT_TRUE(journal) << journal.message();
    return std::move(*journal);
  }

  static Change change(const std::string& path, const std::string& before, const std::string& after) {
    return {.item = "vmstat", .path = path, .before = before, .after = after, .why = "because"};
  }

  FakeRoot root_;
  std::string path_ = root_.path() + "/run/lithe/tune.journal";
};

TEST_F(JournalTest, EveryByteComesBackAndIsText) {
  std::string all;
  for (int byte = 0; byte < 256; ++byte) all += static_cast<char>(byte);
  EXPECT_EQ(text_as_bytes(bytes_as_text(all)), all);
  EXPECT_EQ(bytes_as_text("\xff"), "\xc3\xbf");
}

TEST_F(JournalTest, WhatWasBegunIsThereAfterReopening) {
  {
    Journal journal = open();
    const auto number = journal.begin(change("/proc/sys/vm/stat_interval", "1\xff", "10"));
    ASSERT_TRUE(number);
    ASSERT_TRUE(journal.finish(*number, 0, "10"));
  }
  const Journal journal = open();
  ASSERT_EQ(journal.entries().size(), 1u);
  EXPECT_EQ(journal.entries()[0].change.before, "1\xff");
  EXPECT_EQ(journal.entries()[0].change.item, "vmstat");
}

TEST_F(JournalTest, APowerCutLeavesTheEntryOfEachChangeThatBegan) {
  on_disk().clear();
  Journal journal = open();
  const Change file{.kind = ChangeKind::file, .path = "/etc/lithe.conf", .was_absent = true, .after = "quiet"};
  std::filesystem::create_directories(root_.path() + "/etc");
  int steps = 0;
  const Writer writer(root_.path(), [&] {
    ++steps;
    EXPECT_TRUE(has_text(on_disk()[path_], R"("path":"/etc/lithe.conf")")) << "step " << steps;
    EXPECT_TRUE(on_disk().contains(std::filesystem::path(path_).parent_path())) << "nor has the journal a name there";
  });
  const auto done = apply(journal, writer, {file});
  ASSERT_TRUE(done && done->front().well());
  EXPECT_GE(steps, 4);
  EXPECT_EQ(std::erase_if(on_disk(), [](const auto& each) { return each.second == "quiet"; }), 1U)
      << "the text is on disk before the file has its name";
  EXPECT_FALSE(on_disk().contains(root_.path() + "/etc/lithe.conf")) << "not only after it";
  EXPECT_TRUE(on_disk().contains(root_.path() + "/etc")) << "the name is on disk";
}

TEST_F(JournalTest, AFailedChangeLeavesNothingToUndo) {
  {
    Journal journal = open();
    ASSERT_TRUE(journal.finish(*journal.begin(change("/a", "1", "2")), EIO, ""));
  }
  EXPECT_TRUE(open().entries().empty());
}

TEST_F(JournalTest, TheFirstValueBeforeIsKept) {
  Journal journal = open();
  ASSERT_TRUE(journal.begin(change("/a", "first", "ours")));
  ASSERT_TRUE(journal.begin(change("/a", "theirs", "ours too")));
  ASSERT_EQ(journal.entries().size(), 1u);
  EXPECT_EQ(journal.entries()[0].change.before, "first");
  EXPECT_EQ(journal.entries()[0].ours, (std::vector<std::string>{"ours", "ours too"}));
}

TEST_F(JournalTest, AFileThatSomebodyEditedInBetweenComesBackAsThat) {
  const auto text = [](bool was_absent, const std::string& before, const std::string& after) {
    return Change{.kind = ChangeKind::file, .path = "/a", .was_absent = was_absent, .before = before, .after = after};
  };
  {
    Journal journal = open();
    ASSERT_TRUE(journal.begin(text(false, "first", "first, ours")));
    ASSERT_TRUE(journal.begin(text(false, "first, ours", "first, ours too")));
    EXPECT_EQ(journal.entries()[0].change.before, "first");
    ASSERT_TRUE(journal.begin(text(false, "theirs", "theirs, ours")));
    EXPECT_EQ(journal.entries()[0].change.before, "theirs");
    ASSERT_TRUE(journal.begin(text(true, "", "ours")));
  }
  EXPECT_TRUE(open().entries()[0].change.was_absent) << "removed in between, and read anew";
}

TEST_F(JournalTest, AFullDiskHoldsUpNoRevert) {
  const std::string paths[] = {"/proc/sys/a", "/proc/sys/b", "/proc/sys/c"};
  {
    Journal journal = open();
    for (const std::string& path : paths) {
      root_.write(path, "2\n");
      ASSERT_TRUE(journal.finish(*journal.begin(change(path, "1", "2")), 0, "2"));
    }
  }
  const auto size = static_cast<rlim_t>(std::filesystem::file_size(path_));
  const pid_t child = ::fork();
  if (child == 0) {
    ::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{size, size};
    ::setrlimit(RLIMIT_FSIZE, &limit);
    Journal journal = open();
    ::_exit(revert(journal, Writer(root_.path())) ? 1 : 0);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  EXPECT_EQ(WEXITSTATUS(status), 0) << "it must say that the journal could not be written";
  for (const std::string& path : paths) EXPECT_EQ(HostFiles(root_.path()).read(path).value, "1") << path;
  Journal journal = open();
  ASSERT_TRUE(revert(journal, Writer(root_.path())));
  EXPECT_FALSE(std::filesystem::exists(path_));
}

TEST_F(JournalTest, ALineThatFoundNoSpaceIsNotGluedToTheNext) {
  ASSERT_TRUE(open().begin(change("/a", "1", "2")));
  const auto size = static_cast<rlim_t>(std::filesystem::file_size(path_));
  const pid_t child = ::fork();
  if (child == 0) {
    ::signal(SIGXFSZ, SIG_IGN);
    Journal journal = open();
    rlimit limit{};
    ::getrlimit(RLIMIT_FSIZE, &limit);
    const rlim_t before = std::exchange(limit.rlim_cur, size + 20);
    ::setrlimit(RLIMIT_FSIZE, &limit);
    const bool refused = !journal.begin(change("/b", "1", "2"));
    limit.rlim_cur = before;
    ::setrlimit(RLIMIT_FSIZE, &limit);
    ::_exit(refused && journal.begin(change("/c", "1", "2")) ? 0 : 1);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  EXPECT_EQ(WEXITSTATUS(status), 0);
  const Journal journal = open();
  EXPECT_EQ(journal.unreadable_lines(), 0u);
  ASSERT_EQ(journal.entries().size(), 2u);
  EXPECT_EQ(journal.entries()[1].change.path, "/c");
}

TEST_F(JournalTest, ATornLastLineIsIgnoredAndCutOff) {
  {
    ASSERT_TRUE(open().begin(change("/a", "1", "2")));
  }
  std::ofstream(path_, std::ios::app) << R"({"number": 2, "boot": "1111)";
  {
    Journal journal = open();
    EXPECT_EQ(journal.entries().size(), 1u);
    EXPECT_EQ(journal.unreadable_lines(), 0u);
    ASSERT_TRUE(journal.begin(change("/b", "1", "2")));
  }
  const Journal again = open();
  EXPECT_EQ(again.entries().size(), 2u) << "the next line must not be glued to the torn one";
  EXPECT_EQ(again.unreadable_lines(), 0u);
}

TEST_F(JournalTest, AJournalTornAtEveryByteKeepsItsWholeLines) {
  {
    Journal journal = open();
    ASSERT_TRUE(journal.begin(change("/a", "1", "2")));
    ASSERT_TRUE(journal.begin(change("/b", "1", "2")));
  }
  std::ifstream file(path_);
  const std::string whole(std::istreambuf_iterator<char>(file), {});
  const std::size_t first = whole.find('\n') + 1;
  for (std::size_t size = 0; size <= whole.size(); ++size) {
    std::ofstream(path_, std::ios::trunc) << whole.substr(0, size);
    const std::size_t lines = (size >= first ? 1u : 0u) + (size == whole.size() ? 1u : 0u);
    ASSERT_EQ(open().entries().size(), lines) << "cut at byte " << size;
  }
}

TEST_F(JournalTest, ALineThatIsNoneOfOursIsCounted) {
  std::filesystem::create_directories(root_.path() + "/run/lithe");
  std::ofstream(path_) << "what?\n{\"number\": 1, \"change\": {}}\n[]\n{}\n";
  {
    ASSERT_TRUE(open().begin(change("/a", "1", "2")));
  }
  Journal journal = open();
  EXPECT_EQ(journal.unreadable_lines(), 4u);
  ASSERT_EQ(journal.entries().size(), 1u);
  ASSERT_TRUE(journal.drop(journal.entries()[0].number, "for the test"));
  journal.remove();
  EXPECT_TRUE(std::filesystem::exists(path_)) << "it is the only record of what those lines say";
}

TEST_F(JournalTest, OneThatOthersMayWriteIsNotReplayed) {
  {
    ASSERT_TRUE(open().begin(change("/a", "1", "2")));
  }
  ASSERT_EQ(::chmod(path_.c_str(), 0666), 0);
  const auto opened = Journal::open(path_, kFakeBoot, false);
  ASSERT_FALSE(opened);
  EXPECT_NE(opened.message().find("can be written by others"), std::string::npos) << opened.message();
}

TEST_F(JournalTest, ALinkThatLeadsOutOfAnImageIsNotFollowed) {
  const FakeRoot outside;
  std::filesystem::create_directories(root_.path() + "/etc");
  std::filesystem::create_symlink(outside.path(), root_.path() + "/etc/sysctl.d");
  const Writer writer(root_.path());
  Change change{.kind = ChangeKind::file, .item = "sysctl", .path = "/etc/sysctl.d/lithe.conf"};
  EXPECT_EQ(writer.set(change, {.value = "x"}), ELOOP);
  change.path = "/../" + outside.path().substr(outside.path().rfind('/') + 1) + "/lithe.conf";
  EXPECT_EQ(writer.set(change, {.value = "x"}), ELOOP);
  EXPECT_FALSE(std::filesystem::exists(outside.path() + "/lithe.conf"));
}

TEST_F(JournalTest, AnotherBootsEntriesAreVoid) {
  {
    ASSERT_TRUE(open("yesterday").begin(change("/a", "1", "2")));
  }
  EXPECT_TRUE(open().entries().empty());
  EXPECT_EQ(open("yesterday").entries().size(), 1u);
}

TEST_F(JournalTest, ASecondProcessIsRefused) {
  const Journal held = open();
  const auto second = Journal::open(path_, kFakeBoot, true);
  ASSERT_FALSE(second);
  EXPECT_NE(second.message().find("in use"), std::string::npos) << second.message();
}

TEST_F(JournalTest, AnAbsentJournalIsEmptyAndIsNotMade) {
  const auto journal = Journal::open(path_, kFakeBoot, false);
  ASSERT_TRUE(journal);
  EXPECT_TRUE(journal->entries().empty());
  EXPECT_FALSE(std::filesystem::exists(root_.path() + "/run"));
}

TEST_F(JournalTest, ItIsRemovedOnlyWhenNothingIsLeftInIt) {
  Journal journal = open();
  const auto number = journal.begin(change("/a", "1", "2"));
  journal.remove();
  EXPECT_TRUE(std::filesystem::exists(path_));
  ASSERT_TRUE(journal.drop(*number, "undone"));
  journal.remove();
  EXPECT_FALSE(std::filesystem::exists(path_));
}

}  // namespace
}  // namespace lithe::host
