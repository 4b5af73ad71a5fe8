// SPDX-License-Identifier: Apache-2.0
// As much of a Teensy and of its CAN library as the gateway's sketch uses: what it sends is kept for the test.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

inline std::uint32_t g_stub_micros = 0;
inline int g_stub_analog[64] = {};
inline bool g_stub_digital[64] = {};

inline std::uint32_t micros() { return g_stub_micros; }
inline int analogRead(std::uint8_t pin) { return g_stub_analog[pin]; }
inline int digitalRead(std::uint8_t pin) { return g_stub_digital[pin] ? 1 : 0; }
inline void analogReadResolution(unsigned) {}
inline void pinMode(std::uint8_t, int) {}
constexpr int INPUT_PULLUP = 2;

enum CAN_DEV_TABLE { CAN1, CAN3 };
enum FLEXCAN_RXQUEUE_TABLE { RX_SIZE_256 };
enum FLEXCAN_TXQUEUE_TABLE { TX_SIZE_16 };
enum FLEXCAN_CLOCK { CLK_40MHz };

struct CAN_message_t {
  std::uint32_t id = 0;
  struct {
    bool extended = false;
  } flags;
  std::uint8_t len = 8;
  std::uint8_t buf[8] = {};
  bool seq = false;
};
struct CANFD_message_t {
  std::uint32_t id = 0;
  struct {
    bool extended = false;
  } flags;
  bool brs = true, edl = true;
  std::uint8_t len = 8;
  std::uint8_t buf[64] = {};
  bool seq = false;
};
struct CANFD_timings_t {
  FLEXCAN_CLOCK clock = CLK_40MHz;
  double baudrate = 0, baudrateFD = 0, propdelay = 0, bus_length = 0, sample = 0;
};

inline std::vector<CANFD_message_t> g_stub_fd;
inline std::vector<CAN_message_t> g_stub_classic;

template <CAN_DEV_TABLE, FLEXCAN_RXQUEUE_TABLE, FLEXCAN_TXQUEUE_TABLE>
struct FlexCAN_T4FD {
  void begin() { mailbox_ = 8; }
  // Bytes of each mailbox: 8, 16, 32 or 64.
  std::uint8_t setRegions(std::uint8_t size) {
    mailbox_ = size;
    return 14;
  }
  void setBaudRate(const CANFD_timings_t&) {}
  std::uint64_t events() { return 0; }
  // As the library does: what does not fit into a mailbox is cut, and nobody is told.
  int write(const CANFD_message_t& frame) {
    g_stub_fd.push_back(frame);
    g_stub_fd.back().len = std::min(frame.len, mailbox_);
    return 1;
  }

 private:
  std::uint8_t mailbox_ = 8;
};
template <CAN_DEV_TABLE, FLEXCAN_RXQUEUE_TABLE, FLEXCAN_TXQUEUE_TABLE>
struct FlexCAN_T4 {
  void begin() {}
  std::uint64_t events() { return 0; }
  void setBaudRate(std::uint32_t) {}
  int write(const CAN_message_t& frame) {
    g_stub_classic.push_back(frame);
    return 1;
  }
};
