// SPDX-License-Identifier: Apache-2.0
// Splits a byte stream into lines of bounded length: the framing of all JSON sockets and pipes.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

namespace lithe::control {

inline constexpr std::size_t kMaxRequestBytes = std::size_t{1} << 20;

// Contract: one thread · holds at most `limit` bytes plus the bytes of the last feed().
class LineBuffer {
 public:
  explicit LineBuffer(std::size_t limit = kMaxRequestBytes) : limit_(limit) {}

  void feed(std::string_view bytes) { buffer_.append(bytes); }

  // The next complete line without its newline, if there is one.
  std::optional<std::string> next() {
    const std::size_t end = buffer_.find('\n', searched_);
    if (end == std::string::npos) {
      searched_ = buffer_.size();
      return std::nullopt;
    }
    std::string line = buffer_.substr(0, end);
    buffer_.erase(0, end + 1);
    searched_ = 0;
    return line;
  }

  // True once the incomplete line is longer than the limit: answer the sender and close the connection.
  bool too_long() const { return buffer_.size() > limit_; }

 private:
  std::size_t limit_;
  std::size_t searched_ = 0;
  std::string buffer_;
};

}  // namespace lithe::control
