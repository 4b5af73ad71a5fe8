// SPDX-License-Identifier: Apache-2.0
#include "spine/arena/arena.hpp"

#include <gtest/gtest.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <stddef.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstring>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "spine/core/test/emulation_rig.hpp"

namespace lithe::arena {
namespace {

// Machine code that returns `value`.
std::vector<std::byte> code_that_returns(std::uint8_t value) {
#if defined(__x86_64__)
  const std::array<std::uint8_t, 6> code = {0xb8, value, 0, 0, 0, 0xc3};  // mov eax, value; ret
#else
  const std::uint32_t mov = 0x52800000u | std::uint32_t{value} << 5;        // mov w0, #value
  std::array<std::uint8_t, 8> code = {0, 0, 0, 0, 0xc0, 0x03, 0x5f, 0xd6};  // ret
  std::memcpy(code.data(), &mov, sizeof mov);
#endif
  std::vector<std::byte> bytes(code.size());
  std::memcpy(bytes.data(), code.data(), code.size());
  return bytes;
}

int call(std::uint32_t slot) { return reinterpret_cast<int (*)()>(slot_address(slot))(); }

// The permissions of the mapping that holds `address`, as /proc/self/maps says: "r-xs".
std::string permissions(std::uint64_t address) {
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line);) {
    unsigned long long from = 0, to = 0;
    char word[8] = "";
    if (std::sscanf(line.c_str(), "%llx-%llx %7s", &from, &to, word) == 3 && from <= address && address < to)
      return word;
  }
  return "";
}

// Runs `body` in a child process; its return value is the exit code.
template <class Body>
int in_child(Body body) {
  const pid_t pid = fork();
  if (pid == 0) _exit(body());
  int status = 0;
  waitpid(pid, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

class ArenaTest : public testing::Test {
 protected:
  void SetUp() override {
    Result<int> memory = make_memory();
    ASSERT_TRUE(memory) << memory.message();
    fd_ = *memory;
    Result<Writer> writer = Writer::attach(fd_);
    if (!writer) GTEST_SKIP() << writer.message();
    writer_ = std::make_unique<Writer>(std::move(*writer));
  }
  void TearDown() override { close(fd_); }

  int fd_ = -1;
  std::unique_ptr<Writer> writer_;
};

TEST_F(ArenaTest, PlacedCodeRunsAndIsReplacedInPlace) {
  for (std::uint32_t slot = 1; slot <= kSlots; ++slot)
    ASSERT_TRUE(writer_->place(slot, code_that_returns(static_cast<std::uint8_t>(slot))));
  for (std::uint32_t slot = 1; slot <= kSlots; ++slot) EXPECT_EQ(call(slot), static_cast<int>(slot));
  if (const std::string why = test::why_code_stays_old(); !why.empty()) GTEST_SKIP() << why;
  ASSERT_TRUE(writer_->place(3, code_that_returns(77)));
  EXPECT_EQ(call(3), 77);
  EXPECT_EQ(call(4), 4);
}

TEST_F(ArenaTest, RestOfASlotIsClearedAndItsNeighboursAreNot) {
  writer_->place(2, std::vector<std::byte>(kSlotBytes, std::byte{0xaa}));
  writer_->place(3, std::vector<std::byte>(kSlotBytes, std::byte{0xbb}));
  writer_->place(2, code_that_returns(1));
  const auto* bytes = reinterpret_cast<const unsigned char*>(slot_address(2));
  EXPECT_EQ(std::count(bytes + 16, bytes + kSlotBytes, 0), kSlotBytes - 16);
  EXPECT_EQ(bytes[kSlotBytes], 0xbb);
}

TEST_F(ArenaTest, OnlyRealSlotsAndFittingImagesAreTaken) {
  EXPECT_FALSE(writer_->place(0, code_that_returns(1)));
  EXPECT_FALSE(writer_->place(kSlots + 1, code_that_returns(1)));
  EXPECT_FALSE(writer_->place(1, std::vector<std::byte>(kSlotBytes + 1)));
}

TEST_F(ArenaTest, WhereLawsRunNothingIsWritableAndNothingCanBecomeSo) {
  EXPECT_EQ(permissions(kBase), "r-xs");
  EXPECT_EQ(permissions(kBase + kBytes - 1), "r-xs");
  EXPECT_EQ(permissions(kStubs), "r-xs");
  void* code = reinterpret_cast<void*>(kBase);
  EXPECT_NE(mprotect(code, kBytes, PROT_READ | PROT_WRITE), 0) << "a law could patch another one";
}

TEST_F(ArenaTest, ChildInheritsTheCodeButNotTheRightToWriteIt) {
  writer_->place(1, code_that_returns(42));
  EXPECT_EQ(in_child([] { return call(1); }), 42);
  const std::string kept = test::why_children_keep_memory();
  if (!kept.empty()) GTEST_SKIP() << kept;
  EXPECT_NE(in_child([&] { return writer_->place(1, code_that_returns(13)) ? 0 : 1; }), 0);
  EXPECT_EQ(call(1), 42);
}

TEST_F(ArenaTest, ReadOnlyDescriptorGivesCodeButNoWriter) {
  const int fd = dup(fd_);
  ASSERT_TRUE(make_read_only(fd));
  EXPECT_TRUE(is_memory(fd));
  EXPECT_EQ(mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0), MAP_FAILED);
  EXPECT_LT(write(fd, "x", 1), 0);
  close(fd);
}

TEST_F(ArenaTest, SizeCanNeverChange) {
  EXPECT_NE(ftruncate(fd_, 0), 0) << "the tick would die of SIGBUS";
  EXPECT_NE(ftruncate(fd_, kBytes * 2), 0);
}

TEST_F(ArenaTest, SecondArenaInAProcessSaysThatTheAddressIsTaken) {
  const Result<Arena> second = Arena::attach_exec(fd_);
  ASSERT_FALSE(second);
  EXPECT_NE(second.message().find("taken"), std::string::npos) << second.message();
}

TEST(ArenaMemory, AdopterFindsTheArenaOfAProcessThatKeepsItReadOnly) {
  Result<int> memory = make_memory();
  ASSERT_TRUE(memory);
  int ready[2], stop[2];
  ASSERT_EQ(pipe(ready) | pipe(stop), 0);
  const pid_t pid = fork();
  if (pid == 0) {
    dup2(*memory, kHandedFd);
    const bool kept = static_cast<bool>(make_read_only(kHandedFd));
    char byte = kept ? 'y' : 'n';
    if (write(ready[1], &byte, 1) != 1 || read(stop[0], &byte, 1) < 0) _exit(1);
    _exit(0);
  }
  char byte = 'n';
  ASSERT_EQ(read(ready[0], &byte, 1), 1);
  EXPECT_EQ(byte, 'y');
  Result<int> found = memory_of(pid);
  ASSERT_TRUE(found) << found.message();
  EXPECT_EQ(pwrite(*found, "law", 3, 0), 3);
  char seen[4] = "";
  EXPECT_EQ(pread(*memory, seen, 3, 0), 3);
  EXPECT_STREQ(seen, "law") << "the same memory, and writable";
  EXPECT_EQ(write(stop[1], "", 1), 1);
  waitpid(pid, nullptr, 0);
  for (const int fd : {*memory, *found, ready[0], ready[1], stop[0], stop[1]}) close(fd);
}

TEST(ArenaMemory, WhatIsNoArenaIsRefused) {
  const int other = static_cast<int>(syscall(SYS_memfd_create, "something", 0));
  EXPECT_FALSE(is_memory(other));
  EXPECT_FALSE(is_memory(-1));
  EXPECT_FALSE(Arena::attach_exec(other));
  EXPECT_FALSE(memory_of(getpid())) << "descriptor 3 of a test is something else";
  close(other);
}

// A kernel or container that allows no executable mapping.
bool refuse_exec_mappings() {
  const sock_filter program[] = {
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, nr)),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_mmap, 0, 3),
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, args[2])),
      BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, PROT_EXEC, 0, 1),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | EACCES),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
  };
  const sock_fprog filter{static_cast<unsigned short>(std::size(program)), const_cast<sock_filter*>(program)};
  return prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 && prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &filter) == 0;
}

TEST(ArenaMemory, RefusedExecutableMappingsAreAnErrorInWordsAndLeaveNothing) {
  Result<int> memory = make_memory();
  ASSERT_TRUE(memory);
  enum { told = 0, no_filter, attached, wrong_words, left_behind };
  const int verdict = in_child([&]() -> int {
    if (!refuse_exec_mappings()) return no_filter;
    const Result<Arena> arena = Arena::attach_exec(*memory);
    if (arena) return attached;
    if (arena.message().find("for execution") == std::string::npos) return wrong_words;
    return permissions(kBase).empty() && permissions(kStubs).empty() ? told : left_behind;
  });
  close(*memory);
  if (verdict == no_filter) GTEST_SKIP() << "this system has no seccomp filters";
  EXPECT_EQ(verdict, told);
}

}  // namespace
}  // namespace lithe::arena
