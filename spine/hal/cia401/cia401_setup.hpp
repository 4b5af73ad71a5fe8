// SPDX-License-Identifier: Apache-2.0
// Set-up of a CiA 401 module: a list of SDO transfers.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/cia401/cia401.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::cia401 {

struct ModuleParams {
  std::uint32_t id = 1;  // 1 to 126
  Inputs inputs{};
  double send_every_s = 0.01;
  double heartbeat_s = 0.1;             // of the module's own
  std::int64_t stale_ns = 100'000'000;  // older values are not valid
};

// Why a module measures nothing.
enum class NotReadyKind : std::uint8_t {
  none,
  not_booted,       // no boot-up message after a reset
  no_answer,        // to an SDO request
  refused,          // an SDO request; value: the abort code
  no_module,        // object 1000h names another profile; value: what it says
  not_operational,  // it left that state by itself; value: its network state
  silent,           // no heartbeat
};

using NotReadyReason = canopen::NotReady<NotReadyKind>;

// One sentence; empty for none.
// Contract: never in an exchange's thread
std::string describe(const NotReadyReason& not_ready);

// Executes the list, one transfer at a time.
// Contract: RT but for the constructor · one thread · time is an argument
class Setup {
 public:
  explicit Setup(const ModuleParams& params);

  enum class Progress : std::uint8_t { busy, done, failed };

  void begin() LITHE_RT;
  // At most one frame. False: nothing to send now.
  bool next(std::int64_t now_ns, Frame& frame) LITHE_RT;
  // Handles an answer. False: not one to the present request.
  bool on_frame(const Frame& frame) LITHE_RT { return client_.on_frame(frame); }
  // Call after an answer, and once per exchange: a request may have timed out.
  Progress advance() LITHE_RT;
  const NotReadyReason& not_ready() const LITHE_RT { return not_ready_; }

 private:
  struct Step {
    canopen::Address address;
    std::uint32_t value;
    std::uint8_t bytes;  // 0: read, and compare the profile
    bool may_lack;       // the module need not have the object
  };
  static constexpr std::size_t kMostSteps = 48;

  void add(std::uint16_t index, std::uint8_t subindex, std::uint32_t value, std::uint8_t bytes, bool may_lack = false);
  void add_pdo(std::size_t number, const ModuleParams& params);

  canopen::SdoClient client_;
  std::array<Step, kMostSteps> steps_{};
  std::size_t count_ = 0;
  std::size_t at_ = 0;
  NotReadyReason not_ready_;
};

}  // namespace lithe::hal::cia401
