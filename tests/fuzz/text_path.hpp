// SPDX-License-Identifier: Apache-2.0
// Adapters that speak in lines: any bytes, cut anywhere, through a terminal into the real bus, against a plain reading
// of the same bytes in one piece; and from the host's side into the simulated adapter.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus/serial/sim_adapter.hpp"
#include "spine/hal/bus/serial/text_bus.hpp"
#include "spine/hal/bus/test/pty_rig.hpp"
#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {

// What lines amount to.
struct Told {
  std::vector<hal::Frame> frames;
  std::uint64_t acknowledged = 0;
  std::uint64_t errors = 0;
  std::uint64_t malformed = 0;
  std::uint64_t ignored = 0;
  std::uint64_t noticed = 0;  // errors without a line of their own
  bool bus_off = false;       // and nothing behind it is read

  std::uint64_t lines() const { return frames.size() + acknowledged + errors + malformed + ignored; }
};

// Calls `line` with each line of the text, its end with it. What has no end is no line.
inline void each_line(std::string_view text, std::string_view ends, const std::function<void(std::string_view)>& line) {
  for (std::size_t at = text.find_first_of(ends); at != std::string_view::npos; at = text.find_first_of(ends)) {
    line(text.substr(0, at + 1));
    text.remove_prefix(at + 1);
  }
}

inline constexpr std::size_t kLongestBusLine = 256;  // with its end; what is longer is malformed
inline constexpr std::chrono::seconds kPatience(5);  // with a line that is lost; libFuzzer takes 10 s for a hang
inline constexpr std::size_t kMostText = 3000;       // a terminal holds 4096 bytes, and nobody reads while it is filled

// A new one after a bus that did not read to the end: what it left must not reach the next.
inline hal::test::TestPty& pty(bool anew = false) {
  static std::unique_ptr<hal::test::TestPty> one;
  if (one == nullptr || anew) {
    one = std::make_unique<hal::test::TestPty>();
    one->forget_path();  // a program that is refuted ends where it stands, and would leave it behind
  }
  return *one;
}

// `text` ends in the end of a line.
inline void through_terminal(hal::TextBus& bus, std::string_view text, Input& cuts, const Told& expected) {
  const hal::BusStatistics& count = bus.statistics();
  std::vector<hal::Frame> frames;
  hal::Frame frame;
  const auto lines = [&] {
    return count.received + bus.acknowledged() + count.errors + count.malformed + count.ignored;
  };
  const std::uint64_t counted = expected.lines() + expected.noticed;
  const auto take = [&] {
    while (bus.receive(frame)) frames.push_back(frame);
  };
  bus.begin(0);
  while (!text.empty()) {
    // The rest at once: a write to a terminal takes longer than reading a line.
    const std::size_t size = cuts.empty() ? text.size() : std::min<std::size_t>(1 + cuts.byte() * 4U, text.size());
    pty().say(text.substr(0, size));
    text.remove_prefix(size);
    take();
  }
  const auto until = std::chrono::steady_clock::now() + kPatience;
  while (lines() < counted && std::chrono::steady_clock::now() < until) take();
  take();
  require(lines() == counted, "every line that came over the terminal is counted once");
  require(count.malformed == expected.malformed, "lines without sense are counted as such");
  require(count.errors == expected.errors + expected.noticed, "refusals of the adapter are counted as such");
  require(count.ignored == expected.ignored, "lines that nobody waits for are counted as such");
  require(frames.size() == expected.frames.size() &&
              std::equal(frames.begin(), frames.end(), expected.frames.begin(), same),
          "the frames of the terminal are those of the lines");
}

// A device that says again what it hears.
class Echo final : public hal::BusNode {
 public:
  void on_frame(const hal::Frame& frame, std::int64_t /*now_ns*/, hal::FrameQueue& answers) LITHE_RT override {
    ++heard_;
    sane_ = sane_ && hal::is_can(frame);
    answers.push(frame);
  }
  std::size_t heard() const { return heard_; }
  bool sane() const { return sane_; }

 private:
  std::size_t heard_ = 0;
  bool sane_ = true;
};

// All that the simulated adapter says to these bytes.
inline std::string adapter_says(hal::sim::SimAdapter& adapter, std::string_view text, Input& cuts) {
  std::string out;
  Echo echo;
  adapter.attach(echo);
  std::int64_t now_ns = 1'000'000'000;
  while (!text.empty()) {
    const std::size_t size = std::min<std::size_t>(1 + cuts.byte(), text.size());
    adapter.feed(text.substr(0, size), now_ns, out);
    text.remove_prefix(size);
    adapter.idle(now_ns += 1'000'000, out);
  }
  require(echo.sane(), "what an adapter puts on the bus is a frame that CAN has");
  return out;
}

}  // namespace lithe::fuzz
