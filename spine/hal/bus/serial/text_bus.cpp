// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/serial/text_bus.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <span>

namespace lithe::hal {
namespace {

constexpr int kBusOff = ENETDOWN;  // one of the reasons for reopening an adapter
constexpr const char* kBusOffAdvice =
    "bus-off, the adapter's controller saw too many errors; check wires, termination and bit rates; it is opened again";

}  // namespace

Result<> TextBus::open() {
  if (const Result<> opened = port_.open(); !opened) return opened.error();
  const std::string words = greeting();
  if (words.empty()) return done();
  const Moved moved = port_.write(words);
  if (moved.bytes == words.size()) return done();
  port_.close();
  return Error{port_.path() + ": the adapter takes no commands; unplug it and plug it in again"};
}

void TextBus::say(std::string_view text) {
  drop_overtaken();
  flush();
  if (link_.up() && out_from_ == out_to_) port_.write(text);
}

void TextBus::add(std::string_view line) LITHE_RT {
  if (!link_.up() || line.size() > kOutbound - out_to_) return;
  std::copy(line.begin(), line.end(), out_.data() + out_to_);
  out_to_ += line.size();
  ++statistics_.sent;
}

void TextBus::service() {
  if (link_.lost() == 0) return;
  const Result<> opened = open();
  not_reopened_ = opened ? "" : opened.message();
  if (opened) link_.give_back();
}

std::string TextBus::why_down() const {
  const int error = link_.lost();
  if (error == 0) return "";
  if (!not_reopened_.empty()) return not_reopened_;
  if (error == kBusOff) return port_.path() + ": " + kBusOffAdvice;
  return port_.path() + ": the adapter went away (" + std::strerror(error) +
         "); it is opened again as soon as it is back";
}

void TextBus::begin(std::int64_t /*now_ns*/) LITHE_RT {
  if (link_.regained()) {
    ++statistics_.reopened;
    out_from_ = out_to_ = in_from_ = in_to_ = line_size_ = 0;
    half_gone_ = too_long_ = mute_ = false;
    forget();
  }
  drop_overtaken();
}

// Commands that waited a whole exchange are outdated and dropped. A line that was partly sent must be finished: its
// beginning together with the next line could be a different, valid command.
void TextBus::drop_overtaken() LITHE_RT {
  const char* const unsent = out_.data() + out_from_;
  const char* const all = out_.data() + out_to_;
  // The end of a partly sent line is in the buffer, because format() writes complete lines.
  const auto ends_a_line = [this](char c) LITHE_RT { return is_end(c); };
  const char* keep = half_gone_ ? std::find_if(unsent, all, ends_a_line) + 1 : unsent;
  const auto dropped = static_cast<std::uint64_t>(std::count_if(keep, all, ends_a_line));
  statistics_.refused += dropped;
  statistics_.sent -= dropped;
  out_to_ = static_cast<std::size_t>(std::copy(unsent, keep, out_.data()) - out_.data());
  out_from_ = 0;
}

bool TextBus::send(const Frame& frame) LITHE_RT {
  const std::size_t size = link_.up() && !mute_ ? format(frame, std::span(out_).last(kOutbound - out_to_)) : 0;
  if (size == 0) {
    ++statistics_.refused;
    return false;
  }
  out_to_ += size;
  ++statistics_.sent;
  return true;
}

void TextBus::flush() LITHE_RT {
  if (!link_.up() || out_from_ == out_to_) return;
  const Moved moved = port_.write(std::span(out_.data() + out_from_, out_to_ - out_from_));
  if (moved.error != 0) {
    link_.lose(moved.error);
    return;
  }
  if (moved.bytes == 0) return;
  out_from_ += moved.bytes;
  half_gone_ = !is_end(out_[out_from_ - 1]);
  if (out_from_ == out_to_) out_from_ = out_to_ = 0;
}

bool TextBus::receive(Frame& frame) LITHE_RT {
  if (!link_.up()) return false;
  if (next_frame(frame)) return true;
  if (!link_.up()) return false;
  fill();  // once: endless input without frames must not block the exchange
  if (next_frame(frame)) return true;
  flush();  // the device may have room again
  return false;
}

void TextBus::fill() LITHE_RT {
  const Moved moved = port_.read(in_);
  if (moved.error != 0) link_.lose(moved.error);
  in_from_ = 0;
  in_to_ = moved.bytes;
}

bool TextBus::next_frame(Frame& frame) LITHE_RT {
  while (in_from_ < in_to_ && link_.up()) {
    if (!take(in_[in_from_++], frame)) continue;
    ++statistics_.received;
    return true;
  }
  return false;
}

// Adds one byte. True: it completed a line with a frame.
bool TextBus::take(char c, Frame& frame) LITHE_RT {
  if (line_size_ == kLongestLine) too_long_ = true;
  if (!too_long_) line_[line_size_++] = c;
  if (!is_end(c)) return false;
  const Said said = too_long_ ? Said::malformed : parse({line_.data(), line_size_}, frame);
  too_long_ = false;
  line_size_ = 0;
  if (said == Said::acknowledged) ++acknowledged_;
  if (said == Said::refused || said == Said::bus_off) ++statistics_.errors;
  if (said == Said::bus_off) link_.lose(kBusOff);
  if (said == Said::malformed) ++statistics_.malformed;
  if (said == Said::nothing) ++statistics_.ignored;
  return said == Said::frame;
}

}  // namespace lithe::hal
