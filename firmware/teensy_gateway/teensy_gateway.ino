// SPDX-License-Identifier: Apache-2.0
// Reference sensor gateway for a Teensy 4.1: sixteen analog and sixteen digital inputs onto a CAN bus.
// The frames are described in spine/hal/gateway/gateway.hpp.
#include <FlexCAN_T4.h>

namespace {

constexpr uint32_t kNode = 9;             // 1 to 126, as `id` in robot.toml
constexpr bool kFd = true;                // CAN FD on CAN3; false: classic CAN, two channels per frame
constexpr uint32_t kFramePeriodUs = 500;  // analog and digital in turn: each block every millisecond (FD)

constexpr int32_t kMostLateUs = 4 * static_cast<int32_t>(kFramePeriodUs);

constexpr uint32_t kIdBase = 0x10400000;
constexpr uint32_t kAnalog = 0, kDigital = 1;
constexpr int kChannels = 16;
// All analog inputs but 22 and 23, which are CAN1.
constexpr uint8_t kAnalogPins[kChannels] = {14, 15, 16, 17, 18, 19, 20, 21, 24, 25, 26, 27, 38, 39, 40, 41};
constexpr uint8_t kDigitalPins[kChannels] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 28, 29, 32};
constexpr int kRailLow = 4, kRailHigh = 4091;  // of 12 bits: a reading at a rail means a broken wire
constexpr int16_t kInvalid = -32768;

FlexCAN_T4FD<CAN3, RX_SIZE_256, TX_SIZE_16> g_fd;
FlexCAN_T4<CAN1, RX_SIZE_256, TX_SIZE_16> g_classic;
uint8_t g_sequence = 0;
uint32_t g_turn = 0;
uint32_t g_next_us = 0;

void put(uint8_t* at, uint16_t word) {
  at[0] = static_cast<uint8_t>(word);
  at[1] = static_cast<uint8_t>(word >> 8);
}

int16_t analog(int channel) {
  const int raw = analogRead(kAnalogPins[channel]);
  return raw < kRailLow || raw > kRailHigh ? kInvalid : static_cast<int16_t>(raw);
}

// Header and channels from `first` on; returns the bytes used.
uint8_t fill(uint8_t* data, uint32_t block, uint8_t first, int channels) {
  data[0] = ++g_sequence;
  data[1] = first;
  put(data + 2, static_cast<uint16_t>(micros() / 100));
  if (block == kDigital) {
    uint16_t values = 0;
    for (int i = 0; i < kChannels; ++i) values |= static_cast<uint16_t>(digitalRead(kDigitalPins[i]) ? 1u << i : 0u);
    put(data + 4, values);
    put(data + 6, 0xffff);  // all valid: an input with a pull-up always has a value
    return 8;
  }
  for (int i = 0; i < channels; ++i) put(data + 4 + 2 * i, static_cast<uint16_t>(analog(first + i)));
  return static_cast<uint8_t>(4 + 2 * channels);
}

void send_fd() {
  CANFD_message_t frame;
  const uint32_t block = g_turn++ % 2;
  frame.id = kIdBase | kNode << 8 | block;
  frame.flags.extended = true;
  frame.brs = true;
  frame.edl = true;
  const uint8_t used = fill(frame.buf, block, 0, kChannels);
  frame.seq = true;                // one mailbox: frames are sent in the order of their sequence
  frame.len = used <= 8 ? 8 : 48;  // lengths that CAN FD permits
  for (uint8_t at = used; at + 1 < frame.len; at += 2) put(frame.buf + at, static_cast<uint16_t>(kInvalid));
  g_fd.write(frame);
}

void send_classic() {
  CAN_message_t frame;
  const uint32_t turn = g_turn++ % (kChannels / 2 + 1);
  const uint32_t block = turn == kChannels / 2 ? kDigital : kAnalog;
  frame.id = kIdBase | kNode << 8 | block;
  frame.flags.extended = true;
  frame.seq = true;
  frame.len = fill(frame.buf, block, block == kDigital ? 0 : static_cast<uint8_t>(2 * turn), 2);
  g_classic.write(frame);
}

}  // namespace

void setup() {
  analogReadResolution(12);
  for (uint8_t pin : kDigitalPins) pinMode(pin, INPUT_PULLUP);
  if (kFd) {
    g_fd.begin();
    g_fd.setRegions(64);  // bytes of a mailbox: 8 after begin(); longer frames would be cut
    CANFD_timings_t timing;
    timing.clock = CLK_40MHz;
    timing.baudrate = 1000000;
    timing.baudrateFD = 5000000;
    timing.propdelay = 190;
    timing.bus_length = 1;
    timing.sample = 66;
    g_fd.setBaudRate(timing);
  } else {
    g_classic.begin();
    g_classic.setBaudRate(1000000);
  }
  g_next_us = micros();
}

void loop() {
  kFd ? g_fd.events() : g_classic.events();  // sends frames that found the mailbox busy
  const int32_t late_us = static_cast<int32_t>(micros() - g_next_us);
  if (late_us < 0) return;
  if (late_us > kMostLateUs) g_next_us = micros();  // missed frames are not sent later
  g_next_us += kFramePeriodUs;
  kFd ? send_fd() : send_classic();
}
