// SPDX-License-Identifier: Apache-2.0
// Shows passing frames as text, and statistics of each bus.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/bus_tools.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/robot/config.hpp"
#include "supervisor/bus/plan/plan.hpp"
#include "supervisor/bus/scan/place.hpp"

namespace lithe::bus {

struct CapturedFrame {
  std::int64_t time_ns = 0;      // CLOCK_MONOTONIC
  std::size_t bus = 0;           // index into the robot's buses
  std::optional<bool> outbound;  // to a device; none: only the frame itself can tell
  hal::Frame frame;
};

// A source of frames.
// Contract: not RT · one thread
class FrameSource {
 public:
  FrameSource() = default;
  FrameSource(const FrameSource&) = delete;
  FrameSource& operator=(const FrameSource&) = delete;
  virtual ~FrameSource() = default;
  // The next frame; false = none now.
  virtual bool next(CapturedFrame& captured) = 0;
  // Reopens buses, about once a second. Returns why a bus delivers no frames; empty = all work.
  virtual std::string why_down() { return ""; }
  // Number of frames that were lost because they came too fast.
  virtual std::uint64_t lost() const { return 0; }
  // Number of error frames, refusals of the adapter, and invalid lines or frames on one bus.
  virtual std::uint64_t errors(std::size_t /*bus*/) const { return 0; }
};

// Opens buses itself and sends nothing on them. It has a serial adapter or a board to itself; a CAN interface is
// shared.
class BusListener final : public FrameSource {
 public:
  // The error names the bus that cannot be opened, and the next step.
  static Result<std::unique_ptr<BusListener>> open(const Choice& choice, const std::vector<std::size_t>& buses);
  bool next(CapturedFrame& captured) override;
  std::string why_down() override;
  std::uint64_t lost() const override;
  std::uint64_t errors(std::size_t bus) const override;

 private:
  struct ListenedBus {
    std::size_t number;
    std::unique_ptr<hal::Bus> bus;
  };
  std::vector<ListenedBus> buses_;
  std::size_t turn_ = 0;
};

struct MonitorOptions {
  bool json{false};                    // a line for each frame is a JSON object
  bool raw = false;                    // with the bytes
  std::uint64_t count = 0;             // frames to show; 0 = no end
  double seconds = 0;                  // to watch; 0 = no end
  std::vector<std::string> devices{};  // show these alone, by name or id; the statistics count all
};

// Contract: pure · one thread
class Monitor {
 public:
  Monitor(const Choice& choice, const MonitorOptions& options, std::int64_t start_ns);

  // The message for a requested device that does not exist; empty = all exist.
  std::string complaint() const;
  // The line for this frame; empty when it is filtered out.
  std::optional<std::string> see(const CapturedFrame& captured);
  bool finished(std::int64_t now_ns) const;
  // Statistics since the start. Load: the exact bits of every frame, at the bit rates of the file.
  Json statistics(const FrameSource& source, std::int64_t now_ns) const;

 private:
  struct Tally {
    std::uint64_t out = 0, in = 0;
    std::int64_t busy_ns = 0;
  };
  std::string name_of(std::size_t bus, std::optional<std::uint32_t> device) const;
  bool shows(const std::string& name, std::optional<std::uint32_t> device) const;

  const Choice& choice_;
  MonitorOptions options_;
  std::int64_t start_ns_;
  std::uint64_t shown_ = 0;
  std::vector<Tally> tallies_;              // by bus
  std::vector<robot::Protocol> protocols_;  // by bus
};

std::string statistics_text(const Json& statistics);

// Shows frames until the limits are reached or `stop` returns true; then prints the statistics. `say` gets whole lines,
// `warn` each new error of the source. Returns 0, or 1 when no frame was received.
int watch(FrameSource& source, Monitor& monitor, const MonitorOptions& options, const std::function<bool()>& stop,
          const std::function<void(const std::string&)>& say, const std::function<void(const std::string&)>& warn);

// Decoded by the protocol of the bus; frames of a kind of its own (a gateway) are recognised on every bus. Process
// data is decoded by LITHE's own PDO mapping; for a node that is not in the file it is shown as bytes.
// Contract: any frame is safe
hal::FrameText decode(const hal::Frame& frame, robot::Protocol protocol, const robot::RobotConfig& robot,
                      std::size_t bus);

}  // namespace lithe::bus
