// SPDX-License-Identifier: Apache-2.0
// Words of a kernel's command line, and how our flags join them. Off the tick.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "spine/core/result.hpp"

namespace lithe::host {

// A flag to write.
struct Flag {
  std::string name;       // "nohz_full"
  std::string value;      // "1"; empty: a flag without a value
  bool isolates = false;  // one of those that only make sense together: half of them on a line is a half-edited line

  std::string text() const { return value.empty() ? name : name + "=" + value; }
};

// "isolcpus=... nohz_full=..."
std::string text_of(const std::vector<Flag>& flags);

// What separates the words of a line.
inline bool is_blank(char c) { return c == ' ' || c == '\t'; }

// A word that stands on a command line.
struct Word {
  std::string text;       // as the kernel reads it: without quotes
  std::string where;      // "/boot/firmware/cmdline.txt:1"
  std::size_t begin = 0;  // in its line
  std::size_t end = 0;

  std::string name() const;  // up to "="; to the kernel - and _ are the same in a name
};

// Split as the kernel does it: at blanks outside of double quotes. What follows the word "--" belongs to init, not to
// the kernel, and is left out. An error when a quote does not close.
Result<std::vector<Word>> words_of(std::string_view line, const std::string& where);

// The flags that are not among the words. An error when one stands there with another value or twice, or when some of
// the flags that isolate stand there and some do not.
Result<std::vector<Flag>> missing_flags(const std::vector<Word>& words, const std::vector<Flag>& wanted);

// The line with the missing flags behind its last word; every other byte stays. An error also when there is no word, or
// when the line becomes longer than kernels read.
Result<std::string> with_flags(std::string_view line, const std::vector<Flag>& wanted, const std::string& where);

}  // namespace lithe::host
