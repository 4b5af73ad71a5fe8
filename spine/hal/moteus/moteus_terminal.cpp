// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus_terminal.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <limits>
#include <string>

#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"

namespace lithe::hal::moteus {
namespace {

constexpr std::int64_t kAnswerNs = 200'000'000;
constexpr std::uint32_t kSources = 125;

void address(std::uint32_t destination, Frame& frame) {
  frame = Frame{};
  frame.id = kReplyRequested | destination;
  frame.extended = frame.fd = frame.brs = true;
}

// The words as doubles for a subframe. One bit pattern cannot be represented: that of NaN.
std::array<double, 4> uuid_words(const std::array<std::uint8_t, 16>& uuid) {
  std::array<double, 4> words{};
  for (std::size_t i = 0; i < words.size(); ++i) {
    const auto word = static_cast<std::int32_t>(little_endian(uuid.data() + 4 * i, 4));
    words[i] = word == std::numeric_limits<std::int32_t>::min() ? std::numeric_limits<double>::quiet_NaN() : word;
  }
  return words;
}

// False: not a complete answer to identify().
bool parse_identity(const Frame& said, Identity& identity) {
  Identity seen;
  bool whole = false;
  SubframeReader reader(said.payload());
  Subframe s;
  while (reader.next(s)) {
    for (std::uint32_t i = 0; s.kind == Kind::reply && i < s.count; ++i) {
      const std::uint32_t number = s.start + i;
      const std::uint32_t word = s.format == Format::int32 ? little_endian(s.data + 4 * i, 4) : s.data[i];
      whole = whole || number == reg::kRegisterMap;
      if (number == reg::kModel) seen.model = word;
      if (number == reg::kFirmware) seen.firmware = word;
      if (number == reg::kRegisterMap) seen.register_map = word;
      if (number >= reg::kSerial && number < reg::kSerial + seen.serial.size())
        seen.serial[number - reg::kSerial] = word;
      if (number == reg::kMode) seen.mode = word;
      if (number == reg::kFault) seen.fault = word;
    }
  }
  if (!whole) return false;
  identity = seen;
  return true;
}

std::string uuid_text(const std::array<std::uint8_t, 16>& uuid) {
  std::string text;
  for (std::size_t i = 0; i < uuid.size(); ++i)
    text += fmt::format("{}{:02x}", i == 4 || i == 6 || i == 8 || i == 10 ? "-" : "", uuid[i]);
  return text;
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
    device.unfit = fmt::format(
        "its firmware has register map {}, and {} is needed: flash another firmware "
        "(moteus_tool -t {} --flash)",
        is.register_map, kKnownRegisterMap, found.id);
  }
  return device;
}

void make_discovery(Frame& frame) {
  address(kBroadcast, frame);
  SubframeWriter writer(frame);
  writer.read(Format::int32, reg::kUuid, 4);
  writer.read(Format::int8, reg::kUuidMaskCapable, 1);
  writer.pad();
}

bool parse_discovery(const Frame& answer, Found& found) {
  if ((answer.id & ~0x7f00U) != 0) return false;  // an answer to source 0 has no other bits
  Found seen;
  seen.id = device_of(answer) & 0xff;
  SubframeReader reader(answer.payload());
  Subframe s;
  bool any = false;
  while (reader.next(s)) {
    any = any || s.kind == Kind::reply || s.kind == Kind::read_error;
    for (std::uint32_t i = 0; s.kind == Kind::reply && i < s.count; ++i) {
      const std::uint32_t number = s.start + i;
      if (number == reg::kUuidMaskCapable) seen.maskable = s.value(i) == 1;
      const bool word = number >= reg::kUuid && number < reg::kUuid + 4 && s.format == Format::int32;
      if (word) std::copy_n(s.data + 4 * i, 4, seen.uuid.begin() + 4 * (number - reg::kUuid));
    }
  }
  if (!any || seen.id < 1 || seen.id > 126) return false;
  found = seen;
  return true;
}

std::vector<Found> Terminal::discover(std::int64_t wait_ns) {
  std::vector<Found> all;
  Frame frame;
  make_discovery(frame);
  const std::int64_t end_ns = time_.now_ns() + wait_ns;
  bus_.begin(time_.now_ns());
  bus_.send(frame);
  bus_.flush();
  while (true) {
    Found found;
    const bool heard = bus_.receive(frame);
    if (heard && parse_discovery(frame, found)) all.push_back(found);
    if (time_.now_ns() >= end_ns) break;  // also with endless input
    if (!heard) time_.pause();
  }
  std::stable_sort(all.begin(), all.end(), [](const Found& a, const Found& b) { return a.id < b.id; });
  return all;
}

Result<Identity> Terminal::identify(const Found& who) {
  Frame frame;
  address(who.id, frame);
  SubframeWriter writer(frame);
  if (who.maskable) writer.write(Format::int32, reg::kUuidMask, uuid_words(who.uuid));
  writer.read(Format::int32, reg::kModel, 3);
  writer.read(Format::int32, reg::kSerial, 3);
  writer.read(Format::int8, reg::kMode, 1);
  writer.read(Format::int8, reg::kFault, 1);
  writer.pad();
  source_ = source_ % kSources + 1;
  frame.id |= source_ << 8;
  const std::int64_t end_ns = time_.now_ns() + kAnswerNs;
  bus_.begin(time_.now_ns());
  bus_.send(frame);
  bus_.flush();
  Identity identity;
  while (true) {
    const bool heard = bus_.receive(frame);
    // An answer to another source address belongs to an earlier question.
    const bool answers = heard && device_of(frame) == who.id && source_of(frame) == source_;
    if (answers && parse_identity(frame, identity)) return identity;
    if (time_.now_ns() >= end_ns) return Error{"drive " + std::to_string(who.id) + " does not answer"};
    if (!heard) time_.pause();
  }
}

// For `lithe bus scan`.
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
