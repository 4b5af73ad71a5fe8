// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus_scanner.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <iterator>

#include "spine/hal/moteus/moteus_faults.hpp"

namespace lithe::hal::moteus {
namespace {

std::string uuid_text(const std::array<std::uint8_t, 16>& uuid) {
  std::string text;
  for (std::size_t i = 0; i < uuid.size(); ++i) {
    text += fmt::format("{}{:02x}", i == 4 || i == 6 || i == 8 || i == 10 ? "-" : "", uuid[i]);
  }
  return text;
}

// The question is sent twice, so that one lost frame does not make a drive missing. Two drives may give equal answers: as
// many of them count as came in both rounds, or one (an answer to the first question may come in the second round).
std::vector<Found> discover_twice(Terminal& terminal) {
  std::vector<Found> first = terminal.discover();
  std::vector<Found> again = terminal.discover();
  std::sort(first.begin(), first.end());
  std::sort(again.begin(), again.end());
  std::vector<Found> all;
  std::set_intersection(first.begin(), first.end(), again.begin(), again.end(), std::back_inserter(all));
  for (const std::vector<Found>* round : {&first, &again}) {
    for (const Found& one : *round) {
      if (!std::binary_search(all.begin(), all.end(), one)) all.insert(std::upper_bound(all.begin(), all.end(), one), one);
    }
  }
  return all;
}

}  // namespace

FoundDevice describe(const Found& found, const std::optional<Identity>& identity, const std::string& why_unknown) {
  FoundDevice device{.id = found.id, .what = why_unknown};
  if (!identity) return device;
  const Identity& is = *identity;
  device.what = fmt::format("firmware {}.{}.{}, register map {}, serial {:08x}{:08x}{:08x}, ", is.firmware >> 16,
                            is.firmware >> 8 & 0xff, is.firmware & 0xff, is.register_map, is.serial[0], is.serial[1],
                            is.serial[2]);
  const bool has_uuid = found.uuid != std::array<std::uint8_t, 16>{};
  device.what += has_uuid ? "uuid " + uuid_text(found.uuid) : "no uuid";
  device.what += fmt::format(", {}", mode_name(static_cast<Mode>(is.mode & 0xff)));
  if (is.fault != 0) device.what += fmt::format(", {} ({})", fault_name(is.fault), is.fault);
  if (is.register_map != kKnownRegisterMap) {
    device.unfit = fmt::format("its firmware has register map {}, and {} is needed: flash another firmware "
                               "(moteus_tool -t {} --flash)",
                               is.register_map, kKnownRegisterMap, found.id);
  }
  return device;
}

namespace {

class MoteusScanner final : public Scanner {
 public:
  std::string on_frame(const Frame& frame) override;
  std::string ask(const AskedBus& line) override;
  std::vector<FoundDevice> found(bool asked) const override;

 private:
  std::vector<FoundDevice> found_;
};

// A moteus sends only answers. So a frame of that form is a question or an answer of another program.
std::string MoteusScanner::on_frame(const Frame& frame) {
  constexpr std::uint32_t kReplyRequested = 0x8000;
  constexpr std::uint32_t kAddresses = 0xffff;  // of an id: source and destination; the rest is a prefix
  if (!frame.fd) return "";
  const std::uint32_t source = frame.id >> 8 & 0x7f;
  if ((frame.id & kReplyRequested) != 0) return fmt::format("a command from address {}", source);
  return frame.id > kAddresses ? "" : fmt::format("a frame from address {} that we did not ask for", source);
}

std::string MoteusScanner::ask(const AskedBus& line) {
  Terminal terminal(line.bus, line.time);
  for (const Found& found : discover_twice(terminal)) {
    const Result<Identity> identity = terminal.identify(found);
    found_.push_back(identity ? describe(found, *identity) : describe(found, std::nullopt, identity.message()));
  }
  return "";
}

std::vector<FoundDevice> MoteusScanner::found(bool /*asked*/) const {
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

}  // namespace

std::unique_ptr<Scanner> make_scanner() { return std::make_unique<MoteusScanner>(); }

}  // namespace lithe::hal::moteus
