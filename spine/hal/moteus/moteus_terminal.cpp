// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus_terminal.hpp"

#include <algorithm>
#include <limits>

#include "spine/hal/bus/serial/words.hpp"
#include "spine/hal/moteus/moteus.hpp"

namespace lithe::hal::moteus {
namespace {

constexpr std::uint32_t kReplyRequested = 0x8000;
constexpr std::uint32_t kBroadcast = 0x7f;
constexpr std::uint32_t kChannel = 1;
constexpr std::size_t kPiece = 48;  // stream bytes per frame, as in the maker's tools
constexpr std::int64_t kAnswerNs = 200'000'000;
constexpr std::int64_t kSilenceNs = 1'000'000'000;
constexpr std::int64_t kLongestNs = 30'000'000'000;  // of an answer; a full configuration takes less than a second
constexpr std::uint32_t kSources = 125;

void address(std::uint32_t destination, Frame& frame) {
  frame = Frame{};
  frame.id = kReplyRequested | destination;
  frame.extended = frame.fd = frame.brs = true;
}

// Takes the next complete line from the input. False: none yet.
bool take_line(std::string& text, std::string& line) {
  const std::size_t end = text.find_first_of("\r\n");
  if (end == std::string::npos) return false;
  line = text.substr(0, end);
  text.erase(0, end + 1);
  return true;
}

std::uint32_t word_at(const std::uint8_t* bytes) {
  std::uint32_t word = 0;
  for (std::size_t i = 0; i < 4; ++i) word |= std::uint32_t{bytes[i]} << (8 * i);
  return word;
}

// The words as doubles for a subframe. One bit pattern cannot be represented: that of NaN.
std::array<double, 4> uuid_words(const std::array<std::uint8_t, 16>& uuid) {
  std::array<double, 4> words{};
  for (std::size_t i = 0; i < words.size(); ++i) {
    const auto word = static_cast<std::int32_t>(word_at(uuid.data() + 4 * i));
    words[i] = word == std::numeric_limits<std::int32_t>::min() ? std::numeric_limits<double>::quiet_NaN() : word;
  }
  return words;
}

// False: not a complete answer to identify().
bool take_identity(const Frame& said, Identity& identity) {
  Identity seen;
  bool whole = false;
  SubframeReader reader(said.payload());
  Subframe s;
  while (reader.next(s)) {
    for (std::uint32_t i = 0; s.kind == Kind::reply && i < s.count; ++i) {
      const std::uint32_t number = s.start + i;
      const std::uint32_t word = s.format == Format::int32 ? word_at(s.data + 4 * i) : s.data[i];
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

}  // namespace

void make_discovery(Frame& frame) {
  address(kBroadcast, frame);
  SubframeWriter writer(frame);
  writer.read(Format::int32, reg::kUuid, 4);
  writer.read(Format::int8, reg::kUuidMaskCapable, 1);
  writer.pad();
}

bool take_discovery(const Frame& answer, Found& found) {
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
    if (heard && take_discovery(frame, found)) all.push_back(found);
    if (time_.now_ns() >= end_ns) break;  // also with endless input
    if (!heard) time_.pause();
  }
  std::stable_sort(all.begin(), all.end(), [](const Found& a, const Found& b) { return a.id < b.id; });
  return all;
}

Result<> Terminal::await(std::uint32_t id, const Frame& question, const std::function<bool(const Frame&)>& is_it) {
  source_ = source_ % kSources + 1;
  Frame frame = question;
  frame.id |= source_ << 8;
  const std::int64_t end_ns = time_.now_ns() + kAnswerNs;
  bus_.begin(time_.now_ns());
  bus_.send(frame);
  bus_.flush();
  while (true) {
    const bool heard = bus_.receive(frame);
    // An answer to another source address belongs to an earlier question.
    if (heard && device_of(frame) == id && source_of(frame) == source_ && is_it(frame)) return done();
    if (time_.now_ns() >= end_ns) return Error{"drive " + std::to_string(id) + " does not answer"};
    if (!heard) time_.pause();
  }
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
  Identity identity;
  const Result<> answered =
      await(who.id, frame, [&identity](const Frame& said) { return take_identity(said, identity); });
  return answered ? Result<Identity>(identity) : answered.error();
}

Result<std::string> Terminal::exchange(std::uint32_t id, std::string_view piece) {
  Frame frame;
  address(id, frame);
  SubframeWriter writer(frame);
  if (piece.empty()) {
    writer.poll(kChannel, kPiece);
  } else {
    writer.client_data(kChannel, {reinterpret_cast<const std::uint8_t*>(piece.data()), piece.size()});
  }
  writer.pad();
  std::string text;
  const Result<> answered = await(id, frame, [&text](const Frame& said) {
    SubframeReader reader(said.payload());
    Subframe s;
    while (reader.next(s)) {
      if (s.kind != Kind::server_data || s.start != kChannel) continue;
      text.assign(reinterpret_cast<const char*>(s.data), s.count);
      return true;
    }
    return false;
  });
  return answered ? Result<std::string>(text) : answered.error();
}

Result<std::string> Terminal::ask(std::uint32_t id, std::string_view line, bool one_line) {
  // Discards output that an earlier client did not read.
  constexpr int kMostOld = 1000;
  for (int i = 0;; ++i) {
    const Result<std::string> old = exchange(id, "");
    if (!old) return old;
    if (old->empty()) break;
    if (i == kMostOld) return Error{"drive " + std::to_string(id) + " does not stop talking; send it 'tel stop'"};
  }
  std::string text = std::string(line) + "\n";
  std::string come;
  for (std::size_t at = 0; at < text.size(); at += kPiece) {
    const Result<std::string> sent = exchange(id, std::string_view(text).substr(at, kPiece));
    if (!sent) return sent;
    come += *sent;  // a drive may answer at once
  }
  std::string said;
  const std::int64_t end_ns = time_.now_ns() + kLongestNs;
  std::int64_t quiet_until_ns = time_.now_ns() + kSilenceNs;
  while (time_.now_ns() < std::min(quiet_until_ns, end_ns)) {
    for (std::string each; take_line(come, each);) {
      if (each.empty()) continue;
      if (begins(each, "ERR"))
        return Error{"drive " + std::to_string(id) + " answers to '" + std::string(line) + "': " + each};
      if (each == "OK" || one_line) return each == "OK" ? said : each;
      said += each + "\n";
    }
    const Result<std::string> more = exchange(id, "");
    if (!more) return more;
    if (more->empty()) time_.pause();
    if (!more->empty()) quiet_until_ns = time_.now_ns() + kSilenceNs;
    come += *more;
  }
  return Error{"drive " + std::to_string(id) + " does not finish its answer to '" + std::string(line) + "'"};
}

Result<std::string> Terminal::command(std::uint32_t id, std::string_view line) { return ask(id, line, false); }

Result<std::string> Terminal::setting(std::uint32_t id, std::string_view name) {
  return ask(id, "conf get " + std::string(name), true);
}

Result<> Terminal::set(std::uint32_t id, std::string_view name, std::string_view value) {
  const Result<std::string> done_so = ask(id, "conf set " + std::string(name) + " " + std::string(value), false);
  return done_so ? done() : Result<>(done_so.error());
}

}  // namespace lithe::hal::moteus
