// SPDX-License-Identifier: Apache-2.0
// Implements hal::SensorDevice for a CiA 401 module with digital and analog inputs.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/cia401/cia401.hpp"
#include "spine/hal/cia401/cia401_setup.hpp"
#include "spine/hal/core/sensors.hpp"

namespace lithe::hal::cia401 {

// Resets the module, sets it up (Setup), starts it, and takes what it sends from then on. A module that boots again, or
// leaves its operational state, is set up again at once; one that is silent, or refuses its set-up, every kBootNs. Its
// inputs are not valid meanwhile. It needs no SYNC and no heartbeat of ours: it moves nothing.
// Contract: as hal::SensorDevice; why_not_ready() any thread
class Module final : public SensorDevice {
 public:
  static constexpr std::int64_t kBootNs = 5'000'000'000;
  // A heartbeat this long after a reset: the module did not receive the reset.
  static constexpr std::int64_t kResetNs = 200'000'000;
  static constexpr double kBeatsToSilence = 3;

  explicit Module(const ModuleParams& params);

  bool sent(const Frame& frame) const LITHE_RT override {
    return canopen::is_canopen(frame) && canopen::node_of(frame) == params_.id;
  }
  void on_frame(const Frame& frame, std::int64_t now_ns) LITHE_RT override;
  void step(const Exchange& exchange, Bus& bus) LITHE_RT override;
  bool read(Block block, std::size_t channel, std::int64_t now_ns, double& raw) const LITHE_RT override;
  std::uint64_t malformed() const LITHE_RT override { return malformed_; }
  std::string why_not_ready() const override {
    return describe(NotReadyReason::unpacked(not_ready_.load(std::memory_order_relaxed)));
  }

  bool running() const LITHE_RT { return stage_ == Stage::running; }

 private:
  enum class Stage : std::uint8_t { reset, await_boot_up, setup, start, running, refused };

  void on_heartbeat(const Frame& frame, std::int64_t now_ns) LITHE_RT;
  void on_inputs(std::size_t number, const Frame& frame, std::int64_t now_ns) LITHE_RT;
  void watch_anew() LITHE_RT;
  void set_up_anew() LITHE_RT;
  void judge_setup(std::int64_t now_ns) LITHE_RT;
  // Relaxed: the word is self-contained. Pairs with why_not_ready().
  void tell(const NotReadyReason& not_ready) LITHE_RT {
    not_ready_.store(not_ready.packed(), std::memory_order_relaxed);
  }

  ModuleParams params_;
  std::array<canopen::PdoMap, kPdos> maps_;
  Setup setup_;
  canopen::HeartbeatConsumer heartbeat_;
  Stage stage_ = Stage::reset;
  std::int64_t since_ns_ = 0;  // of the reset, or of the refusal
  std::array<std::int64_t, kPdos> taken_ns_{};
  std::array<bool, kPdos> valid_{};
  std::array<std::uint8_t, kDigital / 8> digital_{};
  std::array<std::int16_t, kAnalog> analog_{};
  std::uint64_t malformed_ = 0;
  std::atomic<std::uint64_t> not_ready_{};  // NotReadyReason::packed(); stored by the exchange's thread, loaded by any
};

}  // namespace lithe::hal::cia401
