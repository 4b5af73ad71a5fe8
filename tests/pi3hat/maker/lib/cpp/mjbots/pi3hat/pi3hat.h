// SPDX-License-Identifier: Apache-2.0
// In place of the maker's library, for machines without it: the names and types that upstream.cpp uses, and a board
// that writes down what it is told and says what a test wants.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace mjbots::pi3hat {

template <typename T>
class Span {
 public:
  Span() = default;
  Span(T* data, std::size_t size) : data_(data), size_(size) {}
  std::size_t size() const { return size_; }
  T& operator[](std::size_t i) const { return data_[i]; }

 private:
  T* data_ = nullptr;
  std::size_t size_ = 0;
};

struct CanFrame {
  std::uint32_t id = 0;
  std::uint8_t data[64] = {};
  std::uint8_t size = 0;
  int bus = 0;
  bool expect_reply = false;
  std::uint8_t expected_reply_size = 0;
};

struct Quaternion {
  double w = 0, x = 0, y = 0, z = 0;
};
struct Point3D {
  double x = 0, y = 0, z = 0;
};
struct Attitude {
  Quaternion attitude;
  Point3D rate_dps;
  Point3D accel_mps2;
};

class Pi3Hat {
 public:
  struct CanConfiguration {
    int slow_bitrate = 1'000'000;
    int fast_bitrate = 5'000'000;
    bool fdcan_frame = true;
    bool bitrate_switch = true;
    bool bus_monitor = false;
  };
  struct Configuration {
    CanConfiguration can[5] = {};
  };
  struct Input {
    Span<CanFrame> tx_can;
    std::uint32_t min_tx_wait_ns = 200'000;
    std::uint32_t rx_baseline_wait_ns = 1'000'000;
    bool request_attitude = false;
    std::uint32_t force_can_check = 0;
    Span<CanFrame> rx_can;
    Attitude* attitude = nullptr;
  };
  struct Output {
    int error = 0;
    bool attitude_present = false;
    std::size_t rx_can_size = 0;
  };
  struct DeviceInfo {
    bool can_unknown_address_safe = false;
  };

  explicit Pi3Hat(const Configuration& configuration);
  Output Cycle(const Input& input);
  DeviceInfo device_info();
};

// What a test sees of the board, and what it makes it be.
struct Notes {
  Pi3Hat::Configuration configuration;
  Pi3Hat::Input input;         // of the last cycle; its spans are not to be read
  std::vector<CanFrame> sent;  // in the last cycle
  std::size_t room = 0;        // for what it received
  bool absent = false;
  bool can_unknown_address_safe = true;
  std::vector<CanFrame> arrives;  // in the next cycle
};
Notes& notes();

}  // namespace mjbots::pi3hat
