// SPDX-License-Identifier: Apache-2.0
// For tests: sends frames to a simulated drive, with virtual time.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "spine/core/test/units_rig.hpp"
#include "spine/hal/moteus/sim/sim_moteus.hpp"

namespace lithe::hal::sim {
using moteus::Format;
using moteus::Kind;
using moteus::Mode;
using moteus::Subframe;
using moteus::SubframeReader;
using moteus::SubframeWriter;
namespace reg = moteus::reg;

using Writes = std::vector<std::pair<std::uint32_t, double>>;
using Registers = std::map<std::uint32_t, double>;

inline SimMoteusParams bench_motor() {
  SimMoteusParams params;
  params.id = 1;
  params.plant.inertia_kg_m2 = 1e-3;
  params.plant.viscous_nm_s_rad = 1e-3;
  return params;
}

class Bench {
 public:
  explicit Bench(const SimMoteusParams& params = bench_motor()) : drive_(params) {
    drive_.on_frame(request({}, {}, 0x0001), now_ns_, answers_);
  }

  // A frame with these writes in order (float but for the mode) and a read of each of `reads`.
  static Frame request(const Writes& writes, const std::vector<std::uint32_t>& reads, std::uint32_t id = 0x8001) {
    Frame frame;
    frame.id = id;
    frame.extended = frame.fd = frame.brs = true;
    SubframeWriter writer(frame);
    for (const auto& [number, value] : writes)
      writer.write(number == reg::kMode ? Format::int8 : Format::float32, number, std::array{value});
    for (const std::uint32_t number : reads) writer.read(Format::float32, number, 1);
    writer.pad();
    EXPECT_TRUE(writer.ok());
    return frame;
  }

  // Sends now and returns the answer's registers; empty without an answer.
  Registers exchange(const Writes& writes, const std::vector<std::uint32_t>& reads = kAll) {
    last_ = {};
    Registers registers;
    for (const Frame& frame : send(request(writes, reads))) {
      last_ = frame;
      SubframeReader reader(frame.payload());
      Subframe s;
      while (reader.next(s))
        for (std::uint32_t i = 0; s.kind == Kind::reply && i < s.count; ++i) registers[s.start + i] = s.value(i);
    }
    return registers;
  }

  std::vector<Frame> send(const Frame& frame) {
    drive_.on_frame(frame, now_ns_, answers_);
    std::vector<Frame> all;
    while (const Frame* answer = answers_.front()) {
      all.push_back(*answer);
      answers_.pop();
    }
    return all;
  }

  void wait_ms(std::int64_t ms) {
    now_ns_ += ms * kMs;
    drive_.servo().advance(now_ns_);
  }

  // Repeats the command every millisecond.
  Registers stream(const Writes& writes, int ms) {
    for (int i = 0; i < ms; ++i) {
      exchange(writes, {});
      wait_ms(1);
    }
    return exchange({});
  }

  Mode mode() { return static_cast<Mode>(static_cast<int>(exchange({}).at(reg::kMode))); }

  static inline const std::vector<std::uint32_t> kAll{reg::kMode, reg::kPosition, reg::kVelocity, reg::kTorque,
                                                      reg::kFault};
  SimMoteus& drive() { return drive_; }
  const Frame& last() const { return last_; }

 private:
  SimMoteus drive_;
  FrameQueue answers_;
  Frame last_;
  std::int64_t now_ns_ = 1'000 * kMs;
};

inline const Writes kTorque{
    {reg::kMode, 10},   {reg::kCommandPosition, kNan}, {reg::kCommandTorque, 0.05},  {reg::kKpScale, 0},
    {reg::kKdScale, 0}, {reg::kVelocityLimit, -1},     {reg::kAccelerationLimit, -1}};
inline const Writes kStop{{reg::kMode, 0}};

inline Writes with(Writes writes, std::uint32_t number, double value) {
  writes.emplace_back(number, value);
  return writes;
}

}  // namespace lithe::hal::sim
