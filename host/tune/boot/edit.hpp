// SPDX-License-Identifier: Apache-2.0
// Boot files of one line, and extlinux.conf, with our flags in them. They are refused when they are not as a boot file
// must be: half-edited, binary, with the line ends of Windows. Off the tick.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "host/tune/boot/line.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

// A boot file before and after; the same text: nothing to change.
struct Edit {
  std::string path;  // without the root
  bool was_absent = false;
  std::string before;
  std::string after;
};

// "WHERE: WHAT: nothing is written. Correct the file and plan again".
Error refusal(const std::string& where, const std::string& what);

// Text, not empty, with the line ends of Unix; else an error with the path and the line.
Result<> check_boot_text(const std::string& path, std::string_view text);

// cmdline.txt, /etc/kernel/cmdline: exactly one line, with or without a line end.
Result<Edit> edit_line(const std::string& path, const std::string& text, const std::vector<Flag>& wanted);

// extlinux.conf: only APPEND of the label that DEFAULT names.
Result<Edit> edit_extlinux(const std::string& path, const std::string& text, const std::vector<Flag>& wanted);

}  // namespace lithe::host
