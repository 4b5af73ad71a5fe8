// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/slcan/slcan_codec.hpp"

#include <array>
#include <utility>

#include "spine/hal/bus/serial/words.hpp"

namespace lithe::hal::slcan {
namespace {

constexpr std::array<std::uint8_t, 16> kFdSizes{0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};
constexpr std::size_t kStampDigits = 4;

struct Speed {
  std::uint32_t bitrate;
  char digit;
};
constexpr std::array<Speed, 10> kSpeeds{{{10'000, '0'},
                                         {20'000, '1'},
                                         {50'000, '2'},
                                         {100'000, '3'},
                                         {125'000, '4'},
                                         {250'000, '5'},
                                         {500'000, '6'},
                                         {750'000, '7'},
                                         {800'000, '7'},
                                         {1'000'000, '8'}}};
constexpr std::array<Speed, 2> kDataSpeeds{{{2'000'000, '2'}, {5'000'000, '5'}}};

constexpr char digit_of(std::span<const Speed> speeds, std::uint32_t bitrate) LITHE_RT {
  for (const Speed& speed : speeds)
    if (speed.bitrate == bitrate) return speed.digit;
  return '\0';
}

constexpr bool is_capital(char letter) LITHE_RT { return letter >= 'A' && letter <= 'Z'; }

constexpr bool is_one_of(char letter, std::string_view letters) LITHE_RT {
  return letters.find(letter) != std::string_view::npos;
}

constexpr std::size_t id_digits(bool extended) LITHE_RT { return extended ? 8 : 3; }

// Removes the next `size` bytes from the front of `line`, which has at least that many.
constexpr std::string_view take(std::string_view& line, std::size_t size) LITHE_RT {
  const std::string_view taken(line.data(), size);
  line.remove_prefix(size);
  return taken;
}

// CommandTicket, id and length: the common part of data and remote frames. The rest stays in `line`.
bool take_head(std::string_view& line, Frame& frame) LITHE_RT {
  const char letter = take(line, 1).front();
  frame.extended = is_capital(letter);
  frame.brs = is_one_of(letter, "bB");
  frame.fd = frame.brs || is_one_of(letter, "dD");
  const std::size_t digits = id_digits(frame.extended);
  std::uint32_t code = 0;
  if (line.size() < digits + 1 || !hex_number(take(line, digits), frame.id)) return false;
  if (!hex_number(take(line, 1), code) || (code > 8 && !frame.fd)) return false;
  frame.size = kFdSizes[code];
  return frame.id <= (frame.extended ? kLargestId : kLargestStandardId);
}

bool take_data(std::string_view& line, Frame& frame) LITHE_RT {
  const std::size_t digits = 2U * frame.size;
  return line.size() >= digits && hex_bytes(take(line, digits), std::span(frame.data).first(frame.size));
}

// An optional time stamp.
bool is_end(std::string_view rest, bool may_be_stamped) LITHE_RT {
  std::uint32_t stamp_ms = 0;
  return rest.empty() || (may_be_stamped && rest.size() == kStampDigits && hex_number(rest, stamp_ms));
}

bool parse_data_frame(std::string_view line, bool may_be_stamped, Frame& out) LITHE_RT {
  Frame frame;
  if (!take_head(line, frame) || !take_data(line, frame) || !is_end(line, may_be_stamped)) return false;
  out = frame;
  return true;
}

bool is_remote_frame(std::string_view line, bool may_be_stamped) LITHE_RT {
  Frame unused;
  return take_head(line, unused) && is_end(line, may_be_stamped);
}

template <class Word>  // Request or Answer
constexpr Word either(bool sound, Word word) LITHE_RT {
  return sound ? word : Word::malformed;
}

// State of the adapter's controller: active, warning, passive or bus-off, and its error counts.
Answer parse_state(std::string_view line) LITHE_RT {
  if (line.size() < 2) return Answer::error;
  if (line[1] == 'b') return Answer::bus_off;
  return line[1] == 'a' ? Answer::other : Answer::error;
}

// Commands that set a value: a letter and a number.
Request parse_setting(char letter, std::string_view text) LITHE_RT {
  std::uint32_t value = 0;
  if (!hex_number(text, value)) return Request::malformed;
  const bool one_digit = text.size() == 1;
  if (letter == 'S') return either(one_digit && value <= 8, Request::bitrate);
  if (letter == 's') return either(text.size() == 4, Request::bitrate);
  if (letter == 'Y') return either(one_digit && (value == 2 || value == 5), Request::data_bitrate);
  if (letter == 'Z') return either(one_digit && value <= 1, value == 1 ? Request::stamps_on : Request::stamps_off);
  if (is_one_of(letter, "AXQ")) return either(one_digit && value <= 2, Request::other);
  return either(is_one_of(letter, "mM") && ((one_digit && value <= 1) || text.size() == 8), Request::other);
}

Request parse_letter(char letter) LITHE_RT {
  constexpr std::pair<char, Request> kLetters[] = {{'O', Request::open},   {'L', Request::listen},
                                                   {'C', Request::close},  {'V', Request::version},
                                                   {'N', Request::serial}, {'F', Request::status}};
  for (const auto& [each, request] : kLetters)
    if (each == letter) return request;
  return Request::malformed;
}

}  // namespace

std::size_t format_frame(const Frame& frame, std::span<char> out) LITHE_RT {
  const std::size_t digits = id_digits(frame.extended);
  const std::size_t size = 3 + digits + 2U * frame.size;
  if (!is_can(frame) || out.size() < size) return 0;
  const std::string_view letters = frame.extended ? "TDB" : "tdb";
  char* at = out.data();
  *at++ = letters[frame.brs ? 2 : (frame.fd ? 1 : 0)];
  for (std::size_t i = digits; i > 0; --i) *at++ = kHexDigits[frame.id >> (4 * (i - 1)) & 15];
  std::size_t code = 0;
  while (kFdSizes[code] != frame.size) ++code;
  *at++ = kHexDigits[code];
  for (const std::uint8_t byte : frame.payload()) {
    *at++ = kHexDigits[byte >> 4];
    *at++ = kHexDigits[byte & 15];
  }
  *at = kDone;
  return size;
}

Answer parse_answer(std::string_view line, Frame& frame) LITHE_RT {
  if (line.ends_with(kRefused)) return Answer::refused;
  if (!line.ends_with(kDone)) return Answer::malformed;
  line.remove_suffix(1);
  if (line.empty()) return Answer::done;
  const char letter = line.front();
  if (is_one_of(letter, "tTdDbB")) return either(parse_data_frame(line, true, frame), Answer::frame);
  if (is_one_of(letter, "rR")) return either(is_remote_frame(line, true), Answer::other);
  if (is_one_of(letter, "zZ")) return either(line.size() == 1, Answer::sent);
  if (letter == 's') return parse_state(line);
  if (letter == 'e') return Answer::error;
  return either(is_one_of(letter, "VvNF"), Answer::other);
}

char bitrate_digit(std::uint32_t bitrate) LITHE_RT { return digit_of(kSpeeds, bitrate); }
char data_bitrate_digit(std::uint32_t bitrate) LITHE_RT { return digit_of(kDataSpeeds, bitrate); }

Request parse_request(std::string_view line, Frame& frame) LITHE_RT {
  if (line.empty()) return Request::malformed;
  if (is_one_of(line.front(), "tTdDbB")) return either(parse_data_frame(line, false, frame), Request::send);
  if (is_one_of(line.front(), "rR")) return either(is_remote_frame(line, false), Request::remote);
  const char letter = take(line, 1).front();
  return line.empty() ? parse_letter(letter) : parse_setting(letter, line);
}

}  // namespace lithe::hal::slcan
