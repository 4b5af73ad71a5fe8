// SPDX-License-Identifier: Apache-2.0
// For tests: a serial device whose other end the test controls, and can unplug.
#pragma once

#include <fcntl.h>
#include <pty.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstdlib>
#include <string>
#include <string_view>
#include <thread>

#include "spine/hal/core/bus.hpp"

namespace lithe::hal::test {

// Waits until `fulfilled`, or for a long time limit. A kernel thread moves a terminal's bytes, so written bytes do not
// arrive at once.
template <class Condition>
bool await(Condition fulfilled) {
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (!fulfilled()) {
    if (std::chrono::steady_clock::now() > until) return false;
    std::this_thread::sleep_for(std::chrono::microseconds(200));
  }
  return true;
}

// The path stays the same when the device is pulled out and another one plugged in, as under /dev/serial/by-id.
// Contract: tests only
class TestPty {
 public:
  TestPty() {
    std::string directory = "/tmp/lithe-pty-XXXXXX";
    if (mkdtemp(directory.data()) == nullptr) std::abort();
    directory_ = directory;
    plug_in();
  }
  ~TestPty() {
    unplug();
    rmdir(directory_.c_str());
  }
  TestPty(const TestPty&) = delete;
  TestPty& operator=(const TestPty&) = delete;

  std::string path() const { return directory_ + "/adapter"; }
  // The path of the present device.
  const std::string& device() const { return device_; }
  // Unlinked: only device() leads to it, and a killed process leaves no file.
  void forget_path() {
    unlink(path().c_str());
    rmdir(directory_.c_str());
  }

  void plug_in() {
    int slave = -1;
    std::array<char, 64> name{};
    if (openpty(&master_, &slave, name.data(), nullptr, nullptr) != 0) std::abort();
    fcntl(master_, F_SETFL, O_NONBLOCK);
    device_ = name.data();
    if (symlink(name.data(), path().c_str()) != 0) std::abort();
    close(slave);
  }
  void unplug() {
    unlink(path().c_str());
    if (master_ >= 0) close(master_);
    master_ = -1;
  }

  // Waits while there is no room: a terminal holds about 12 KB of unread bytes.
  void say(std::string_view text) {
    while (!text.empty()) {
      const ssize_t taken = write(master_, text.data(), text.size());
      if (taken > 0) text.remove_prefix(static_cast<std::size_t>(taken));
      if (taken < 0) std::this_thread::sleep_for(std::chrono::microseconds(200));
    }
  }
  // All bytes that have arrived since the last call.
  std::string heard() {
    std::string all;
    std::array<char, 4096> part{};
    for (ssize_t size = 0; (size = read(master_, part.data(), part.size())) > 0;)
      all.append(part.data(), static_cast<std::size_t>(size));
    return all;
  }
  // The same, until the text ends with this.
  std::string heard_until(std::string_view end) {
    std::string all;
    await([&] { return (all += heard()).ends_with(end); });
    return all;
  }

 private:
  std::string directory_;
  std::string device_;
  int master_ = -1;
};

// The next frame, when it has come.
inline bool next(Bus& bus, Frame& frame) {
  return await([&] { return bus.receive(frame); });
}

inline Frame command(std::uint32_t id, std::uint8_t size) {
  Frame frame;
  frame.id = id;
  frame.size = size;
  for (std::size_t i = 0; i < size; ++i) frame.data[i] = static_cast<std::uint8_t>(id + i);
  return frame;
}

}  // namespace lithe::hal::test
