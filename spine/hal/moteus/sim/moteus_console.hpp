// SPDX-License-Identifier: Apache-2.0
// The console of a simulated moteus: lines of commands in, text and binary records out, a few bytes at a time.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/moteus/sim/moteus_config.hpp"

namespace lithe::hal::sim {

// The diagnostic stream: named channels of named fields, each with a schema.
namespace telemetry {
inline constexpr std::size_t kChannels = 4;  // git, firmware, servo_stats, system_info
inline constexpr std::size_t kNone = kChannels;
inline constexpr std::size_t kLongestSchema = 1024;
inline constexpr std::size_t kLongestData = 128;

// Contract: RT · pure (all of these functions)
std::string_view name(std::size_t channel) LITHE_RT;
std::size_t find(std::string_view name) LITHE_RT;  // kNone for an unknown channel

// Writes the channel's type as a binary mjlib telemetry schema, or one record of that type. Returns the length; 0 when
// it does not fit (the two constants are always enough).
std::size_t write_schema(std::size_t channel, std::span<std::uint8_t> out) LITHE_RT;
std::size_t write_data(std::size_t channel, const MoteusInside& inside, std::span<std::uint8_t> out) LITHE_RT;
}  // namespace telemetry

//   tel  stop | list | get N | schema N | fmt N 0|1 | rate N MS | text
//   conf list | enumerate [GROUP] | get X | set X V | write | load | default
//   d    stop | brake | pos P V T [OPT] | tmt P V T [OPT] | zero P V T [OPT] | within MIN MAX T [OPT] | dq D Q
//        nearest P | exact P | cfg-set-output P | recapture | req-reindex
// A command is answered by "OK" or "ERR why", except values and records, which are sent alone. Options of `d` are a
// letter and a number, in any order: p d i gain scales, f torque, t watchdog (none unless given), v a limits, s stop
// position, o c fixed voltage and current, b ignore bounds.
// Contract: RT · one thread · fixed buffers: when they are full, output is dropped and counted
class MoteusConsole {
 public:
  static constexpr std::size_t kLongestLine = 120;
  static constexpr std::size_t kCapacity = 8192;

  // Bytes from the host, in pieces of any size.
  void feed(std::span<const std::uint8_t> bytes, MoteusInside& inside) LITHE_RT;

  // Takes the next bytes for the host, at most out.size(). Returns the number.
  std::size_t fetch(std::span<std::uint8_t> out, const MoteusInside& inside) LITHE_RT;

  // Restarts, as after power-on.
  void restart() LITHE_RT { *this = MoteusConsole(); }

  std::uint64_t lost() const LITHE_RT { return lost_; }

 private:
  struct Stream {
    bool text = false;
    std::int64_t period_ns = 0;  // 0 = only on request
    std::int64_t next_ns = 0;
  };

  void serve(std::string_view line, MoteusInside& inside) LITHE_RT;
  void tel(std::string_view words, const MoteusInside& inside) LITHE_RT;
  void conf(std::string_view words, MoteusInside& inside) LITHE_RT;
  void conf_uuid(const MoteusInside& inside) LITHE_RT;
  void conf_enumerate(std::string_view group, const MoteusInside& inside) LITHE_RT;
  void conf_set(std::string_view words, MoteusInside& inside) LITHE_RT;
  void drive(std::string_view words, MoteusInside& inside) LITHE_RT;
  void drive_to(moteus::Mode mode, std::string_view words, MoteusInside& inside) LITHE_RT;
  void set_output(std::string_view verb, std::string_view words, MoteusInside& inside) LITHE_RT;
  void emit(std::size_t channel, bool schema, const MoteusInside& inside) LITHE_RT;
  void emit_text(std::size_t channel, const MoteusInside& inside) LITHE_RT;

  void put(std::uint8_t byte) LITHE_RT;
  void put(std::string_view text) LITHE_RT;
  void put_value(double value, bool integer) LITHE_RT;
  void say(std::string_view text) LITHE_RT;  // adds the line end

  std::array<char, kLongestLine> line_{};
  std::size_t length_ = 0;
  bool too_long_ = false;
  std::array<std::uint8_t, kCapacity> out_{};
  std::size_t head_ = 0;
  std::size_t tail_ = 0;
  std::uint64_t lost_ = 0;
  std::array<Stream, telemetry::kChannels> streams_{};
};

}  // namespace lithe::hal::sim
