// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/fdcanusb/fdcanusb_codec.hpp"

#include <array>

#include "spine/hal/bus/serial/words.hpp"

namespace lithe::hal::fdcanusb {
namespace {

// Writes text into a buffer that may be too short.
class Out {
 public:
  explicit Out(std::span<char> buffer, std::size_t size = 0) LITHE_RT : buffer_(buffer), size_(size) {}

  void put(char c) LITHE_RT {
    fits_ = fits_ && size_ < buffer_.size();
    if (fits_) buffer_[size_++] = c;
  }
  void put(std::string_view text) LITHE_RT {
    for (const char c : text) put(c);
  }
  void hex(std::uint8_t byte) LITHE_RT {
    put(kHexDigits[byte >> 4]);
    put(kHexDigits[byte & 15]);
  }
  void hex(std::span<const std::uint8_t> bytes) LITHE_RT {
    for (const std::uint8_t byte : bytes) hex(byte);
  }
  // As many whole bytes as the number needs, at least `least`.
  void number(std::uint32_t value, unsigned least) LITHE_RT {
    for (unsigned bytes = 4; bytes > 0; --bytes)
      if (bytes <= least || value >> (8 * (bytes - 1)) != 0) hex(static_cast<std::uint8_t>(value >> (8 * (bytes - 1))));
  }
  std::string_view text() const LITHE_RT { return {buffer_.data(), size_}; }
  std::size_t length() const LITHE_RT { return fits_ ? size_ : 0; }

 private:
  std::span<char> buffer_;
  std::size_t size_;
  bool fits_ = true;
};

bool parse_id(std::string_view text, std::uint32_t& id) LITHE_RT { return hex_number(text, id) && id <= kLargestId; }

bool parse_data(std::string_view text, Frame& frame) LITHE_RT {
  if (text.size() % 2 != 0 || text.size() > 2 * kMaxPayload) return false;
  frame.size = static_cast<std::uint8_t>(text.size() / 2);
  return hex_bytes(text, std::span(frame.data).first(frame.size));
}

// `summed`: the line had a valid checksum. Removing it also removed the spaces before it, and so an empty last field.
bool parse_received(std::string_view rest, bool summed, Line& out) LITHE_RT {
  Frame& frame = out.frame;
  frame = Frame{};
  if (!summed && rest.find(' ') == std::string_view::npos) return false;
  if (!parse_id(next_field(rest), frame.id) || !parse_data(next_field(rest), frame)) return false;
  frame.extended = frame.id > kLargestStandardId;
  frame.fd = frame.size > 8;
  out.kind = Line::Kind::received;
  while (!rest.empty()) {
    const std::string_view flag = next_field(rest);
    if (flag == "E" || flag == "e") frame.extended = flag == "E";
    if (flag == "B" || flag == "b") frame.brs = flag == "B";
    if (flag == "F" || flag == "f") frame.fd = flag == "F";
    if (flag == "R") out.kind = Line::Kind::other;
  }
  frame.brs = frame.brs && frame.fd;
  return is_can(frame);
}

const char* parse_flags(std::string_view flags, Request& out) LITHE_RT {
  for (const char flag : flags) {
    if (std::string_view("BbFfRr").find(flag) == std::string_view::npos) return "unknown flag";
    if (flag == 'B' || flag == 'b') out.frame.brs = flag == 'B';
    if (flag == 'F' || flag == 'f') out.frame.fd = flag == 'F';
    if (flag == 'R' || flag == 'r') out.kind = flag == 'R' ? Request::Kind::remote : Request::Kind::send;
  }
  return nullptr;
}

// Checks in the firmware's order, so that the same error is reported first.
const char* parse_send(std::string_view command, std::string_view rest, Request& out) LITHE_RT {
  const std::string_view id = next_word(rest);
  const std::string_view data = next_word(rest);
  if (data.empty()) return "insufficient options";
  out.kind = Request::Kind::send;
  if (const char* wrong = parse_flags(rest, out)) return wrong;
  Frame& frame = out.frame;
  if (!parse_id(id, frame.id)) return "bad id";
  if (data.size() % 2 != 0 || data.size() > 2 * kMaxPayload) return "data invalid length";
  if (!parse_data(data, frame)) return "invalid data";
  frame.extended = command == "ext" || (command == "send" && frame.id > kLargestStandardId);
  if (!frame.extended && frame.id > kLargestStandardId) return "bad id";
  if (!frame.fd && frame.size > 8) return "data invalid length";
  frame.brs = frame.brs && frame.fd;
  while (frame.size < fd_size(frame.size)) frame.data[frame.size++] = 0;  // padded as by the CAN controller
  return nullptr;
}

}  // namespace

std::uint8_t crc8(std::string_view text) LITHE_RT {
  constexpr std::array<std::uint8_t, 16> kNibbles{0x00, 0x97, 0xb9, 0x2e, 0xe5, 0x72, 0x5c, 0xcb,
                                                  0x5d, 0xca, 0xe4, 0x73, 0xb8, 0x2f, 0x01, 0x96};
  unsigned sum = 0;
  for (const char c : text) {
    const auto byte = static_cast<std::uint8_t>(c);
    sum = kNibbles[(sum >> 4 ^ byte >> 4) & 15] ^ (sum << 4 & 0xff);
    sum = kNibbles[(sum >> 4 ^ byte) & 15] ^ (sum << 4 & 0xff);
  }
  return static_cast<std::uint8_t>(sum);
}

Sum strip_sum(std::string_view& line) LITHE_RT {
  constexpr std::size_t kLength = 3;  // *XX
  if (line.size() < kLength || line[line.size() - kLength] != '*') return Sum::absent;
  const int high = hex_digit(line[line.size() - 2]);
  const int low = hex_digit(line[line.size() - 1]);
  if (high < 0 || low < 0) return Sum::absent;
  line.remove_suffix(kLength);
  const bool right = crc8(line) == (high << 4 | low);
  while (!line.empty() && line.back() == ' ') line.remove_suffix(1);
  return right ? Sum::right : Sum::wrong;
}

std::size_t append_sum(std::span<char> out, std::size_t size) LITHE_RT {
  if (size >= out.size()) return 0;
  Out text(out, size);
  text.put(' ');
  const std::uint8_t sum = crc8(text.text());
  text.put('*');
  text.hex(sum);
  return text.length();
}

std::size_t format_send(const Frame& frame, bool checksum, std::span<char> out) LITHE_RT {
  const std::span<const std::uint8_t> data = frame.payload();
  if (data.empty() || !is_can(frame)) return 0;
  Out line(out);
  line.put(frame.extended && frame.id <= kLargestStandardId ? "can ext " : "can send ");
  line.number(frame.id, 2);
  line.put(' ');
  line.hex(data);
  line.put(frame.brs ? " B" : " b");
  line.put(frame.fd ? 'F' : 'f');
  std::size_t length = line.length();
  if (checksum && length > 0) length = append_sum(out, length);
  if (length == 0 || length == out.size()) return 0;
  out[length] = '\n';
  return length + 1;
}

bool parse_line(std::string_view line, bool want_checksum, Line& out) LITHE_RT {
  if (line.size() > kLongestLine) return false;
  const Sum sum = strip_sum(line);
  out.sum = sum;
  if (sum == Sum::wrong || (sum == Sum::absent && want_checksum)) return false;
  out.text = line;
  if (begins(line, "rcv ")) {
    line.remove_prefix(4);
    return parse_received(line, sum == Sum::right, out);
  }
  out.kind = Line::Kind::other;
  if (line == "OK") out.kind = Line::Kind::ok;
  if (line == "ERR" || begins(line, "ERR ")) {
    out.kind = Line::Kind::error;
    out.text.remove_prefix(line.size() == 3 ? 3 : 4);
  }
  return true;
}

const char* parse_request(std::string_view line, const Defaults& defaults, Request& out) LITHE_RT {
  using enum Request::Kind;
  out = Request{};
  out.frame.fd = defaults.fd;
  out.frame.brs = defaults.brs;
  if (line.size() > kLongestLine) return "unknown command";
  const std::string_view group = next_word(line);
  if (group.empty()) return nullptr;
  if (group == "conf") {
    out.kind = conf;
    out.text = line;
    return nullptr;
  }
  if (group != "can") return "unknown command";
  const std::string_view command = next_word(line);
  if (command == "send" || command == "std" || command == "ext") return parse_send(command, line, out);
  if (command == "on") out.kind = on;
  if (command == "off") out.kind = off;
  if (command == "status") out.kind = status;
  if (command == "config") out.kind = config;
  return out.kind == nothing ? "unknown subcommand" : nullptr;
}

std::size_t format_received(const Frame& frame, std::span<char> out) LITHE_RT {
  Out line(out);
  line.put("rcv ");
  line.number(frame.id, 1);
  line.put(' ');
  line.hex(frame.payload());
  line.put(frame.extended ? " E" : " e");
  line.put(frame.brs ? " B" : " b");
  line.put(frame.fd ? " F" : " f");
  line.put(" r x-1");
  return line.length();
}

}  // namespace lithe::hal::fdcanusb
