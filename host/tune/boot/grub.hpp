// SPDX-License-Identifier: Apache-2.0
// Flags for the kernel in GRUB's files (Debian, Ubuntu). They are added in lines of our own, after the user's; none of
// the user's lines is changed.
// Off the tick.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "host/tune/boot/edit.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

inline constexpr const char* kGrubFolder = "/etc/default/grub.d";
inline constexpr const char* kOurGrubFile = "/etc/default/grub.d/99-lithe.cfg";

struct GrubFile {
  std::string path;
  std::string text;
};

// `files`: /etc/default/grub first, then those of the folder that end in ".cfg" in the order of their names, ours among
// them if it is there. Our lines go to a file of their own if there is a folder, else to the end of /etc/default/grub.
// An error also when our lines are there and not whole, or when a later line drops what they set.
Result<Edit> edit_grub(const std::vector<GrubFile>& files, bool has_folder, const std::vector<Flag>& wanted);

// What one line of shell assigns to the variable at its start, and whether it is complete.
struct ShellLine {
  bool is_whole = true;  // quotes close, and it does not go on in the next line
  std::string variable;  // empty: it assigns nothing
  std::string value;
};
ShellLine read_shell_line(std::string_view line);

}  // namespace lithe::host
