// SPDX-License-Identifier: Apache-2.0
// Boards as data: host/boards/*.toml. Off the tick.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "host/read/files.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

enum class BootFormat : std::uint8_t {
  line,      // the whole file is one line
  extlinux,  // APPEND of the default label
  grub,      // /etc/default/grub of Debian and Ubuntu
};

// A boot file counts when it is there, `needs` is there (if given) and `without` is not (if given).
struct BootFile {
  std::string path;
  BootFormat format = BootFormat::line;
  std::string needs;
  std::string without;
  std::vector<std::string> commands;  // put a change in force
};

struct Board {
  std::string name;  // of its file, without ".toml"
  std::string title;
  std::vector<std::string> models;   // how /proc/device-tree/model begins
  std::vector<std::string> files;    // one of them is there: for an image that does not run
  std::string cpu_flag;              // among the flags of /proc/cpuinfo
  std::vector<BootFile> boot;        // the first that counts is the one
  std::vector<std::string> notes;    // sentences
  std::vector<std::string> sources;  // where each fact can be looked up: URLs
};

// One file; `path` is for messages and the board's name. The error names every mistake with its line.
Result<Board> parse_board(std::string_view text, const std::string& path);

// All *.toml of a folder, sorted by name. An error if one is wrong, or there is none.
Result<std::vector<Board>> load_boards(const std::string& folder);

// Beside the installed program, else in the source tree.
std::string boards_folder();

struct FoundBoard {
  const Board* board = nullptr;  // null: none of them
  std::string because;           // "/proc/device-tree/model is \"Raspberry Pi 5 Model B\""
  bool by_file = false;          // by a file alone: the model may be another one
};

// By model, else by the flag of the processor, else by files. `boards` must outlive the result.
FoundBoard find_board(const HostFiles& files, const std::vector<Board>& boards);

}  // namespace lithe::host
