// SPDX-License-Identifier: Apache-2.0
// Implements hal::SensorDevice for a CiA 401 module with digital and analog inputs.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/cia401/cia401.hpp"
#include "spine/hal/core/bus_tools.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/core/sensors.hpp"
#include "spine/robot/config.hpp"

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

// One sentence; empty for none. `lacking`: what it lacks beside that (Setup::lacking).
// Contract: never in an exchange's thread
std::string describe(const NotReadyReason& not_ready, const std::string& lacking);

// Set-up of a module: a list of SDO transfers, executed one at a time. After the first refusal it only reads on,
// to learn which other objects the module lacks.
// Contract: RT but for the constructor and lacking() · one thread, lacking() any · time is an argument
class Setup {
 public:
  explicit Setup(const ModuleParams& params);

  enum class Progress : std::uint8_t { busy, done, failed };

  // `look`: reads what it would write, and changes nothing.
  void begin(bool look = false) LITHE_RT;
  // At most one frame. False: nothing to send now.
  bool next(std::int64_t now_ns, Frame& frame) LITHE_RT;
  // Handles an answer. False: not one to the present request.
  bool on_frame(const Frame& frame) LITHE_RT { return client_.on_frame(frame); }
  // Call after an answer, and once per exchange: a request may have timed out.
  Progress advance() LITHE_RT;
  const NotReadyReason& not_ready() const LITHE_RT { return not_ready_; }
  // The steps whose objects the module lacks, a bit each; and those objects as text, but for this one.
  std::uint64_t lacks() const LITHE_RT { return lacks_; }
  std::string lacking(std::uint64_t lacks, std::uint16_t but_for) const;

 private:
  struct Step {
    canopen::Address address;
    std::uint32_t value;
    std::uint8_t bytes;  // 0: read, and compare the profile
    bool may_lack;       // the module need not have the object
  };
  static constexpr std::size_t kMostSteps = 48;  // lacks_ has 64 bits

  void add(std::uint16_t index, std::uint8_t subindex, std::uint32_t value, std::uint8_t bytes, bool may_lack = false);
  void add_pdo(std::size_t number, const ModuleParams& params);
  void bear(const Step& step, std::uint32_t why) LITHE_RT;
  void refuse(NotReadyKind kind, const Step& step, std::uint32_t value) LITHE_RT;

  canopen::SdoClient client_;
  std::array<Step, kMostSteps> steps_{};
  std::size_t count_ = 0;
  std::size_t at_ = 0;
  bool only_looks_ = false;
  std::uint64_t lacks_ = 0;
  NotReadyReason not_ready_;
};

// Resets the module, sets it up (Setup), starts it, and takes what it sends from then on. A module that boots again, or
// leaves its operational state, is set up again at once; one that is silent, or refuses its set-up, every kBootNs. Its
// inputs are not valid meanwhile. It needs no SYNC and no heartbeat of ours: it moves nothing.
// Contract: as hal::SensorDevice; why_not_ready() any thread
class Module final : public SensorDevice {
 public:
  static constexpr std::int64_t kBootNs = 5'000'000'000;
  // A heartbeat this long after a reset: the module did not receive the reset.
  static constexpr std::int64_t kResetNs = 200'000'000;
  static constexpr double kHeartbeatsToSilence = 3;

  explicit Module(const ModuleParams& params);

  bool sent(const Frame& frame) const LITHE_RT override {
    return canopen::is_canopen(frame) && canopen::node_of(frame) == params_.id;
  }
  void on_frame(const Frame& frame, std::int64_t now_ns) LITHE_RT override;
  void step(const Exchange& exchange, Bus& bus) LITHE_RT override;
  bool read(Block block, std::size_t channel, std::int64_t now_ns, double& raw) const LITHE_RT override;
  std::uint64_t malformed() const LITHE_RT override { return malformed_; }
  std::string why_not_ready() const override;

  bool running() const LITHE_RT { return stage_ == Stage::running; }

 private:
  enum class Stage : std::uint8_t { reset, await_boot_up, setup, start, running, refused };

  void on_heartbeat(const Frame& frame, std::int64_t now_ns) LITHE_RT;
  void on_inputs(std::size_t number, const Frame& frame, std::int64_t now_ns) LITHE_RT;
  void watch_anew() LITHE_RT;
  void set_up_anew() LITHE_RT;
  void judge_setup(std::int64_t now_ns) LITHE_RT;
  // Relaxed: each word is self-contained; between the two a reader may see an old list with a new reason, once. Pairs
  // with why_not_ready().
  void tell(const NotReadyReason& not_ready, std::uint64_t lacks = 0) LITHE_RT {
    lacks_.store(lacks, std::memory_order_relaxed);
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
  // Both stored by the exchange's thread, loaded by any.
  std::atomic<std::uint64_t> not_ready_{};  // NotReadyReason::packed()
  std::atomic<std::uint64_t> lacks_{};      // Setup::lacks(), of the same reason
};

// Of a robot file: what the registry's row needs of it.
std::unique_ptr<SensorDevice> make_module(const robot::DeviceConfig& device);
// Reads what the set-up would write, and changes nothing: why the module would not do; empty = nothing is known.
std::string look(const robot::RobotConfig& robot, const robot::DeviceConfig& device, const AskedBus& line);
PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& bus);

bool process_map(const robot::DeviceConfig& device, std::uint32_t id, canopen::PdoMap& map);
std::string process_value(const canopen::Mapped& mapped, std::uint32_t raw);
std::string_view object_name(std::uint16_t index);

}  // namespace lithe::hal::cia401
