// SPDX-License-Identifier: Apache-2.0
// For tests: simulated kernel information (/sys) about a serial device on USB.
#pragma once

#include <sys/stat.h>
#include <sys/sysmacros.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

namespace lithe::hal::test {

// Contract: tests only
class FakeSys {
 public:
  FakeSys() {
    std::string directory = "/tmp/lithe-sys-XXXXXX";
    if (mkdtemp(directory.data()) == nullptr) std::abort();
    root_ = directory;
  }
  ~FakeSys() { std::filesystem::remove_all(root_); }
  FakeSys(const FakeSys&) = delete;
  FakeSys& operator=(const FakeSys&) = delete;

  std::string path() const { return root_; }

  // Makes the device at `path` the port of this adapter, in this USB socket.
  void plug(const std::string& path, const std::string& vendor, const std::string& product, const std::string& serial,
            const std::string& socket = "1-1") {
    const std::filesystem::path adapter = root_ / "devices" / socket;
    const std::filesystem::path interface = adapter / (socket + ":1.0");
    std::filesystem::create_directories(interface / "tty/ttyACM0");
    std::ofstream(adapter / "idVendor") << vendor << "\n";
    std::ofstream(adapter / "idProduct") << product << "\n";
    std::filesystem::remove(adapter / "serial");
    if (!serial.empty()) std::ofstream(adapter / "serial") << serial << "\n";
    point(path, interface);
  }
  // Makes it a UART of the board.
  void solder(const std::string& path) {
    const std::filesystem::path place = root_ / "devices/platform/fe201000.serial";
    std::filesystem::create_directories(place);
    point(path, place);
  }

 private:
  void point(const std::string& path, const std::filesystem::path& at) {
    struct stat node{};
    if (stat(path.c_str(), &node) != 0) std::abort();
    const std::string number = std::to_string(major(node.st_rdev)) + ":" + std::to_string(minor(node.st_rdev));
    const std::filesystem::path port = root_ / "dev/char" / number;
    std::filesystem::remove_all(port);
    std::filesystem::create_directories(port);
    std::filesystem::create_symlink(at, port / "device");
  }

  std::filesystem::path root_;
};

}  // namespace lithe::hal::test
