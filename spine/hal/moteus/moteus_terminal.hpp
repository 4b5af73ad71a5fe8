// SPDX-License-Identifier: Apache-2.0
// Finds moteus drives and reads who they are, through any bus. Not while a robot runs on it.
#pragma once

#include <array>
#include <compare>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/bus_tools.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"

namespace lithe::hal::moteus {

struct Found {
  std::uint32_t id = 0;
  std::array<std::uint8_t, 16> uuid{};  // all zero: firmware that has none
  bool maskable = false;                // can be addressed by its UUID when another drive has the same id

  auto operator<=>(const Found&) const = default;  // by id first
};

// The register map that LITHE uses (register 102h); another number may mean other registers.
inline constexpr std::uint32_t kKnownRegisterMap = 5;

// Identity of a drive; read-only.
struct Identity {
  std::uint32_t model = 0;
  std::uint32_t firmware = 0;  // 0x010203 = 1.2.3
  std::uint32_t register_map = 0;
  std::array<std::uint32_t, 3> serial{};
  std::uint32_t mode = 0;
  std::uint32_t fault = 0;
};

// Text for one drive. Without an identity: `why_unknown`.
FoundDevice describe(const Found& found, const std::optional<Identity>& identity, const std::string& why_unknown = "");

// The frames; pure.
void make_discovery(Frame& frame);                        // to all, all answer
bool parse_discovery(const Frame& answer, Found& found);  // false: not an answer to it

// Contract: not RT: waits, but always returns within a time limit · one thread, which alone uses the bus
class Terminal {
 public:
  Terminal(Bus& bus, Time time) : bus_(bus), time_(std::move(time)) {}

  // All drives that answer in time, in order of their ids; two with the same id are both listed.
  std::vector<Found> discover(std::int64_t wait_ns = 100'000'000);

  // Reads its identity. Of two drives with one id only this one is asked, if its firmware supports it
  // (Found::maskable).
  Result<Identity> identify(const Found& who);

 private:
  Bus& bus_;
  Time time_;
  std::uint32_t source_ = 0;  // our address; changes with each question, to recognise late answers
};

}  // namespace lithe::hal::moteus
