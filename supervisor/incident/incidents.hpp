// SPDX-License-Identifier: Apache-2.0
// The flight recorder: telemetry and events around everything that stops the robot, replaces its law, changes its mode
// or is refused in the tick, as files in out/<robot>/incidents.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "spine/wire/wire.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/events/event_log.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

// $LITHE_OUT_DIR/<robot>/incidents, else out/<robot>/incidents below the working directory; absolute.
std::filesystem::path incidents_of(const std::string& robot);

// Summaries of the incidents in a folder, oldest first. A file that is no incident is left out.
std::vector<Json> read_incidents(const std::filesystem::path& folder);

// An incident NNNN is NNNN.npy (telemetry, one row per tick) and NNNN.json (the summary), which appears last and whole.
// The newest kMost are kept, and at most kMostBytes.
// Contract: one thread · one write of 2 s of seven joints takes a few milliseconds.
class Incidents {
 public:
  static constexpr std::size_t kMost = 30;
  static constexpr std::uintmax_t kMostBytes = 64'000'000;
  static constexpr std::int64_t kHalfNs = 1'000'000'000;  // before and after; less at rates whose ring holds less
  static constexpr std::int64_t kLateNs = 1'000'000'000;  // at most so much longer is waited for ticks that come late
  // Between two incidents of the same kind; of faults: of the same law and joint.
  static constexpr std::int64_t kPauseNs = 10'000'000'000;

  // `log` has the events, also those of the supervisor.
  Incidents(std::filesystem::path folder, const EventLog& log) : folder_(std::move(folder)), log_(log) {}

  void on_event(const SpineLink& spine, const wire::Event& event, const std::string& line);
  // Writes the open incident once its time is over.
  void serve(const SpineLink& spine, std::int64_t now_ns);
  // The Spine has ended: writes the open incident with what there is.
  void finish(const SpineLink& spine);

  // {"folder", "problem", "skipped", "incidents": [...]}: without the events of each.
  Json list() const;
  // The whole summary of one; `id` 0 = the newest.
  std::variant<Json, Refusal> show(std::uint64_t id) const;
  // {"folder", "last", "problem"} for status.
  Json brief() const;

 private:
  struct Open {
    wire::Event event;
    std::string line;
    std::int64_t half_ns;
  };

  struct Seen;

  void write(const SpineLink& spine);
  Json summary(const SpineLink& spine, const Seen& seen) const;
  Json law(const SpineLink& spine, std::uint32_t law_id) const;
  void make_room(std::uintmax_t fresh_bytes) const;

  std::filesystem::path folder_;
  const EventLog& log_;
  std::optional<Open> open_;
  std::map<std::string, std::int64_t> last_ns_;  // of the last kPauseNs, by what happened
  std::map<std::uint32_t, Json> laws_;           // those committed last: the Spine forgets one that it has replaced
  std::uint64_t skipped_ = 0, last_id_ = 0;
  std::string problem_;
};

}  // namespace lithe::control
