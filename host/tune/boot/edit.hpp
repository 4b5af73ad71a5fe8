// SPDX-License-Identifier: Apache-2.0
// Words of a kernel's command line, how our flags join them, and boot files with our flags in them: files of one line,
// extlinux.conf, GRUB's. They are refused when they are not as a boot file must be: half-edited, binary, with the line
// ends of Windows. Off the tick.
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

// Flags for the kernel in GRUB's files (Debian, Ubuntu). They are added in lines of our own, after the user's; none of
// the user's lines is changed.
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
