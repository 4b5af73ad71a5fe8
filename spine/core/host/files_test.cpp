// SPDX-License-Identifier: Apache-2.0
#include "spine/core/host/files.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <fstream>
#include <iterator>

namespace lithe {
namespace {

namespace fs = std::filesystem;

class FilesTest : public ::testing::Test {
 protected:
  FilesTest() { fs::create_directory(dir_); }
  ~FilesTest() override { fs::remove_all(dir_); }
  std::string in(const std::string& name) const { return dir_ + "/" + name; }
  static std::string why(const std::string& path) {
    const auto text = read_regular_file(path, 100);
    return text ? "was read" : text.message();
  }

  std::string dir_ = "/tmp/lithe-files-" + std::to_string(getpid());
};

TEST_F(FilesTest, AFileIsReadWholeUpToItsLimit) {
  for (const std::size_t size : {std::size_t{0}, std::size_t{1}, std::size_t{100}, std::size_t{200'000}}) {
    std::ofstream(in("law.cpp"), std::ios::binary) << std::string(size, 'x');
    const auto text = read_regular_file(in("law.cpp"), std::max<std::size_t>(size, 1));
    ASSERT_TRUE(text) << text.message();
    EXPECT_EQ(text->size(), size);
  }
  std::ofstream(in("law.cpp"), std::ios::binary) << std::string(101, 'x');
  EXPECT_EQ(why(in("law.cpp")), in("law.cpp") + ": is larger than 100 bytes");
}

// Opened to be written, cut or read: what a link names is never touched, and a pipe is never waited for.
TEST_F(FilesTest, OnlyARegularFileIsOpened) {
  std::ofstream(in("victim")) << "precious";
  fs::create_symlink(in("victim"), in("link"));
  fs::create_directory(in("folder"));
  ASSERT_EQ(mkfifo(in("pipe").c_str(), 0600), 0);
  const Fd folder(open(dir_.c_str(), O_RDONLY | O_DIRECTORY));
  for (const int flags : {O_RDONLY, O_WRONLY, O_WRONLY | O_CREAT | O_TRUNC, O_WRONLY | O_CREAT | O_APPEND, O_RDWR}) {
    for (const auto& [name, told] : {std::pair("link", "link: is a symbolic link, not a file"),
                                     {"pipe", "pipe: is a device, a pipe or a socket, not a file"},
                                     {"folder", "folder: "}}) {
      const auto file = open_regular(folder.get(), name, flags);
      ASSERT_FALSE(file) << name << flags;
      EXPECT_TRUE(file.message().starts_with(told)) << file.message();
    }
  }
  EXPECT_EQ(why(in("victim")), "was read");
  EXPECT_EQ(fs::file_size(in("victim")), 8U);
  EXPECT_TRUE(open_regular(folder.get(), "fresh", O_WRONLY | O_CREAT));
  EXPECT_TRUE(fs::exists(in("fresh")));
  fs::create_symlink(in("victim"), in("law.part" + std::to_string(getpid())));
  EXPECT_EQ(write_file_whole(in("law"), "x"), "") << "the link in the draft's place is gone";
  EXPECT_EQ(fs::file_size(in("victim")), 8U);
}

TEST_F(FilesTest, AFolderThatOthersCanFillIsNotUsed) {
  const auto refusal = [](const std::string& path) {
    const auto folder = open_own_folder(path, "LITHE_RUN_DIR");
    return folder ? (*folder ? "taken" : "absent") : folder.message();
  };
  const std::string own = in("own");
  EXPECT_EQ(refusal(own), "absent");
  fs::create_directory(own);
  for (const mode_t mode : {0700, 0750, 0770, 02770}) {
    ASSERT_EQ(chmod(own.c_str(), mode), 0);
    EXPECT_EQ(refusal(own), "taken") << mode;
  }
  for (const mode_t mode : {0777, 01777, 0702}) {
    ASSERT_EQ(chmod(own.c_str(), mode), 0);
    EXPECT_NE(refusal(own).find("close it (chmod o-w " + own + ")"), std::string::npos) << refusal(own);
  }
  ASSERT_EQ(chmod(own.c_str(), 0700), 0);
  fs::create_symlink(own, in("link"));
  EXPECT_NE(refusal(in("link")).find("it is a symbolic link of "), std::string::npos) << refusal(in("link"));
  std::ofstream(in("file")) << "x";
  EXPECT_NE(refusal(in("file")).find("it is no folder of "), std::string::npos) << refusal(in("file"));
  if (geteuid() != 0) GTEST_SKIP() << "only root can give a folder away";
  constexpr uid_t kMallory = 54321;
  if (chown(own.c_str(), kMallory, kMallory) != 0)
    GTEST_SKIP() << "this root may give it to nobody else: it is one in a user namespace";
  EXPECT_EQ(refusal(own), own +
                              ": is not used: it is a folder of uid 54321 (mode 0700), and others could put files "
                              "there; remove it, or set LITHE_RUN_DIR to a folder of your own");
}

TEST_F(FilesTest, AFileIsReplacedWholeAndKeepsItsMode) {
  EXPECT_EQ(write_file_whole(in("law.cpp"), "old"), "");
  ASSERT_EQ(chmod(in("law.cpp").c_str(), 0604), 0);
  EXPECT_EQ(write_file_whole(in("law.cpp"), std::string(200'000, 'x')), "");
  struct stat about{};
  ASSERT_EQ(stat(in("law.cpp").c_str(), &about), 0);
  EXPECT_EQ(about.st_mode & 07777, 0604U);
  EXPECT_EQ(about.st_size, 200'000);
  fs::create_directory(in("folder"));
  EXPECT_EQ(write_file_whole(in("folder"), "x"), "Is a directory") << "and leaves nothing beside it";
  EXPECT_EQ(std::distance(fs::directory_iterator(dir_), {}), 2);
}

TEST_F(FilesTest, WhatIsNoFileIsNamedAndNotRead) {
  ASSERT_EQ(mkfifo(in("pipe").c_str(), 0600), 0);
  EXPECT_EQ(why(dir_), dir_ + ": is a directory, not a file");
  EXPECT_EQ(why("/dev/zero"), "/dev/zero: is a device, a pipe or a socket, not a file");
  EXPECT_EQ(why(in("pipe")), in("pipe") + ": is a device, a pipe or a socket, not a file");
  EXPECT_EQ(why(in("absent")), in("absent") + ": No such file or directory");
  EXPECT_NE(why("/proc/self/mem"), "was read");
  EXPECT_NE(why("/proc/self/smaps"), "was read") << "a file whose size is given as 0 and that has more than the limit";
}

TEST_F(FilesTest, WhatIsLeftBehindIsNotForEverybody) {
  const mode_t before = umask(0022);
  set_file_defaults();
  fs::create_directory(in("sub"));
  std::ofstream(in("sub/certificate.json")) << "{}";
  const mode_t now = umask(0077);
  set_file_defaults();
  const mode_t strict = umask(before);
  EXPECT_EQ(now, 0027u);
  EXPECT_EQ(strict, 0077u) << "a stricter one stays";
  struct stat about{};
  ASSERT_EQ(stat(in("sub").c_str(), &about), 0);
  EXPECT_EQ(about.st_mode & 0777u, 0750u);
  ASSERT_EQ(stat(in("sub/certificate.json").c_str(), &about), 0);
  EXPECT_EQ(about.st_mode & 0777u, 0640u);
}

TEST_F(FilesTest, AWriteBeyondTheLimitIsAnErrorAndNoSignal) {
  EXPECT_EXIT(
      {
        rlimit limit{};
        limit.rlim_cur = limit.rlim_max = 10;
        setrlimit(RLIMIT_FSIZE, &limit);
        set_file_defaults();
        const int fd = open(in("large").c_str(), O_WRONLY | O_CREAT, 0600);
        const bool first = write(fd, "0123456789abcdef", 16) == 10;
        const bool second = write(fd, "x", 1) < 0 && errno == EFBIG;
        _exit(first && second ? 0 : 1);
      },
      testing::ExitedWithCode(0), "");
}

}  // namespace
}  // namespace lithe
