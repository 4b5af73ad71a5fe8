// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/device/moteus_terminal.hpp"

#include <algorithm>
#include <cmath>

#include "spine/hal/bus/words.hpp"
#include "spine/hal/device/moteus.hpp"

namespace lithe::hal::moteus {
namespace {

constexpr std::uint32_t kReplyRequested = 0x8000;
constexpr std::uint32_t kBroadcast = 0x7f;
constexpr std::uint32_t kChannel = 1;
constexpr std::size_t kPiece = 48;  // bytes of a stream in one frame, as the makers' own tools have it
constexpr std::int64_t kAnswerNs = 200'000'000;
constexpr std::int64_t kSilenceNs = 1'000'000'000;
constexpr std::int64_t kLongestNs = 30'000'000'000;  // of an answer; whole configurations take less than a second
constexpr std::uint32_t kSources = 125;

void address(std::uint32_t destination, Frame& frame) {
  frame = Frame{};
  frame.id = kReplyRequested | destination;
  frame.extended = frame.fd = frame.brs = true;
}

// The next whole line of what has come so far, and away with it. False: none yet.
bool take_line(std::string& text, std::string& line) {
  const std::size_t end = text.find_first_of("\r\n");
  if (end == std::string::npos) return false;
  line = text.substr(0, end);
  text.erase(0, end + 1);
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

// A bus on which somebody always talks must not keep us: after the end only what has arrived already, and not much.
bool Terminal::next(Wait& wait, Frame& frame) {
  while (true) {
    const bool over = time_.now_ns() >= wait.end_ns;
    if (over && wait.frames_after-- == 0) return false;
    if (bus_.receive(frame)) return true;
    if (over) return false;
    time_.pause();
  }
}

std::vector<Found> Terminal::discover(std::int64_t wait_ns) {
  std::vector<Found> all;
  Frame frame;
  make_discovery(frame);
  Wait wait{time_.now_ns() + wait_ns};
  bus_.begin(time_.now_ns());
  bus_.send(frame);
  bus_.flush();
  Found found;
  while (next(wait, frame)) {
    if (take_discovery(frame, found)) all.push_back(found);
  }
  std::stable_sort(all.begin(), all.end(), [](const Found& a, const Found& b) { return a.id < b.id; });
  return all;
}

Result<std::string> Terminal::exchange(std::uint32_t id, std::string_view piece) {
  Frame frame;
  address(id, frame);
  source_ = source_ % kSources + 1;
  frame.id |= source_ << 8;
  SubframeWriter writer(frame);
  if (piece.empty()) {
    writer.poll(kChannel, kPiece);
  } else {
    writer.client_data(kChannel, {reinterpret_cast<const std::uint8_t*>(piece.data()), piece.size()});
  }
  writer.pad();
  Wait wait{time_.now_ns() + kAnswerNs};
  bus_.begin(time_.now_ns());
  bus_.send(frame);
  bus_.flush();
  while (next(wait, frame)) {
    if (device_of(frame) != id || source_of(frame) != source_) continue;  // also what answers an earlier question
    SubframeReader reader(frame.payload());
    Subframe s;
    while (reader.next(s)) {
      if (s.kind != Kind::server_data || s.start != kChannel) continue;
      return std::string(reinterpret_cast<const char*>(s.data), s.count);
    }
  }
  return Error{"drive " + std::to_string(id) + " does not answer"};
}

Result<std::string> Terminal::ask(std::uint32_t id, std::string_view line, bool one_line) {
  // What an earlier asker did not fetch answers nothing of ours.
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
    come += *sent;  // a drive may say something already
  }
  std::string said;
  const std::int64_t end_ns = time_.now_ns() + kLongestNs;
  std::int64_t quiet_until_ns = time_.now_ns() + kSilenceNs;
  while (time_.now_ns() < std::min(quiet_until_ns, end_ns)) {
    const Result<std::string> more = exchange(id, "");
    if (!more) return more;
    if (more->empty()) time_.pause();
    if (!more->empty()) quiet_until_ns = time_.now_ns() + kSilenceNs;
    come += *more;
    for (std::string each; take_line(come, each);) {
      if (each.empty()) continue;
      if (begins(each, "ERR"))
        return Error{"drive " + std::to_string(id) + " says to '" + std::string(line) + "': " + each};
      if (each == "OK" || one_line) return each == "OK" ? said : each;
      said += each + "\n";
    }
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
