// SPDX-License-Identifier: Apache-2.0
// A machine made of files: /proc, /sys, /boot below a temporary folder, which ends with the object.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

namespace lithe::host {

class FakeRoot {
 public:
  FakeRoot() {
    // In memory where that is possible: what is tested waits for the disk after every step.
    const std::string folder = ::access("/dev/shm", W_OK) == 0 ? "/dev/shm/" : ::testing::TempDir();
    std::string name = folder + "lithe-host-XXXXXX";
    path_ = ::mkdtemp(name.data()) == nullptr ? "" : name;
    EXPECT_NE(path_, "");
  }
  FakeRoot(const FakeRoot&) = delete;
  FakeRoot& operator=(const FakeRoot&) = delete;
  ~FakeRoot() {
    std::error_code ignored;
    if (!path_.empty()) std::filesystem::remove_all(path_, ignored);
  }

  const std::string& path() const { return path_; }

  // `path` as the kernel has it: "/sys/...".
  void write(const std::string& path, const std::string& text) const {
    std::filesystem::create_directories(std::filesystem::path(path_ + path).parent_path());
    std::ofstream(path_ + path) << text;
  }

 private:
  std::string path_;
};

}  // namespace lithe::host
