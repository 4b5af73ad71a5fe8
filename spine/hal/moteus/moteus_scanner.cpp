// SPDX-License-Identifier: Apache-2.0
// Finds moteus drives for `lithe bus scan`.
#include <fmt/format.h>

#include <algorithm>
#include <iterator>

#include "spine/hal/moteus/moteus_terminal.hpp"
#include "spine/hal/moteus/moteus_type.hpp"

namespace lithe::hal::moteus {
namespace {

// The question is sent twice, so that one lost frame does not make a drive missing. Two drives may give equal answers:
// as many of them count as came in both rounds, or one (an answer to the first question may come in the second round).
std::vector<Found> discover_twice(Terminal& terminal) {
  std::vector<Found> first = terminal.discover();
  std::vector<Found> again = terminal.discover();
  std::sort(first.begin(), first.end());
  std::sort(again.begin(), again.end());
  std::vector<Found> all;
  std::set_intersection(first.begin(), first.end(), again.begin(), again.end(), std::back_inserter(all));
  for (const std::vector<Found>* round : {&first, &again}) {
    for (const Found& one : *round)
      if (!std::binary_search(all.begin(), all.end(), one))
        all.insert(std::upper_bound(all.begin(), all.end(), one), one);
  }
  return all;
}

class MoteusScanner final : public Scanner {
 public:
  // A moteus sends only answers. So a frame of that form is a question or an answer of another program.
  std::string on_frame(const Frame& frame) override {
    constexpr std::uint32_t kReplyRequested = 0x8000;
    constexpr std::uint32_t kAddresses = 0xffff;  // of an id: source and destination; the rest is a prefix
    if (!frame.fd) return "";
    const std::uint32_t source = frame.id >> 8 & 0x7f;
    if ((frame.id & kReplyRequested) != 0) return fmt::format("a command from address {}", source);
    return frame.id > kAddresses ? "" : fmt::format("a frame from address {} that we did not ask for", source);
  }

  std::string ask(const AskedBus& line) override {
    Terminal terminal(line.bus, line.time);
    for (const Found& found : discover_twice(terminal)) {
      const Result<Identity> identity = terminal.identify(found);
      found_.push_back(identity ? describe(found, *identity) : describe(found, std::nullopt, identity.message()));
    }
    return "";
  }

  std::vector<FoundDevice> found(bool /*asked*/) const override {
    std::vector<FoundDevice> all = found_;
    for (FoundDevice& device : all) {
      const auto same_id = [&](const FoundDevice& other) { return other.id == device.id; };
      if (std::count_if(all.begin(), all.end(), same_id) < 2) continue;
      device.twice = fmt::format(
          "several drives have id {}: leave one of them on the bus, give it an id of its own "
          "(moteus_tool -t {} --console: conf set id.id N, conf write), then plug in the next",
          device.id, device.id);
    }
    return all;
  }

 private:
  std::vector<FoundDevice> found_;
};

}  // namespace

std::unique_ptr<Scanner> make_scanner() { return std::make_unique<MoteusScanner>(); }

}  // namespace lithe::hal::moteus
