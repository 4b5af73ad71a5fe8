// SPDX-License-Identifier: Apache-2.0
#include "host/read/files.hpp"

#include <gtest/gtest.h>
#include <zlib.h>

#include <fstream>
#include <iterator>

#include "host/test/root_rig.hpp"

namespace lithe::host {
namespace {

constexpr const char* kPath = "/proc/config.gz";
constexpr std::size_t kMost = 100'000;

class Unpack : public ::testing::Test {
 protected:
  void pack(const std::string& text) const {
    root_.write(kPath, "");
    const gzFile file = gzopen((root_.path() + kPath).c_str(), "wb");
    EXPECT_EQ(gzwrite(file, text.data(), static_cast<unsigned>(text.size())), static_cast<int>(text.size()));
    EXPECT_EQ(gzclose(file), Z_OK);
  }
  std::string why() const {
    const auto text = read_packed(HostFiles(root_.path()), kPath, kMost);
    return text ? "it was read" : text.message();
  }

  FakeRoot root_;
};

TEST_F(Unpack, GivesTheText) {
  std::string text;
  for (int line = 0; line < 5000; ++line) text += "CONFIG_X" + std::to_string(line) + "=y\n";
  pack(text);
  const auto read = read_packed(HostFiles(root_.path()), kPath, kMost);
  ASSERT_TRUE(read) << read.message();
  EXPECT_EQ(*read, text);
}

TEST_F(Unpack, WhatIsNotWholeIsAnErrorWithTheFilesName) {
  EXPECT_EQ(why(), "/proc/config.gz: No such file or directory");
  root_.write(kPath, "CONFIG_NO_HZ_FULL=y\n");
  EXPECT_EQ(why(), "/proc/config.gz: is not packed with gzip");
  pack(std::string(kMost, 'x'));
  EXPECT_EQ(why(), "it was read");
  pack(std::string(kMost + 1, 'x'));
  EXPECT_EQ(why(), "/proc/config.gz: is too large");
}

// The twin of a whole file: no cut of it is taken for one.
TEST_F(Unpack, AFileThatIsCutShortIsNotRead) {
  pack("CONFIG_NO_HZ_FULL=y\nCONFIG_CPU_ISOLATION=y\n");
  std::ifstream file(root_.path() + kPath, std::ios::binary);
  const std::string whole(std::istreambuf_iterator<char>(file), {});
  for (std::size_t size = 0; size < whole.size(); ++size) {
    root_.write(kPath, whole.substr(0, size));
    EXPECT_NE(why(), "it was read") << size << " of " << whole.size() << " bytes";
  }
}

}  // namespace
}  // namespace lithe::host
