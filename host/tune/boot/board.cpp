// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/board.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <system_error>

#include "host/read/machine.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/text.hpp"
#include "spine/robot/read/reader.hpp"

namespace lithe::host {
namespace {

namespace fs = std::filesystem;
using robot::Need;
using robot::Reader;
using robot::Report;

void read_detect(const toml::table& table, Board& board, Report& report) {
  Reader detect(table, "[detect]", report);
  detect.texts("model", board.models);
  detect.texts("file", board.files);
  detect.text("cpu_flag", board.cpu_flag);
  detect.finish();
}

BootFile read_boot_file(const toml::table& table, Report& report) {
  BootFile file;
  Reader boot(table, "[[boot]]", report);
  boot.text("path", file.path, Need::required);
  boot.choice<BootFormat>("format", file.format,
                          {{"line", BootFormat::line}, {"extlinux", BootFormat::extlinux}, {"grub", BootFormat::grub}},
                          Need::required);
  boot.text("needs", file.needs);
  boot.text("without", file.without);
  boot.texts("commands", file.commands);
  boot.finish();
  return file;
}

}  // namespace

Result<Board> parse_board(std::string_view text, const std::string& path) {
  Report report(path);
  if (first_non_text(text) != std::string_view::npos) return Error{path + ": no text; save the file as plain UTF-8"};
  const toml::parse_result parsed = toml::parse(text, path);
  if (!parsed) {
    const auto& at = parsed.error().source().begin;
    report.add({at.line, at.column}, fmt::format("not TOML: {}", parsed.error().description()));
    return report.error();
  }
  Board board;
  board.name = fs::path(path).stem().string();
  Reader file(parsed.table(), "", report);
  file.text("title", board.title, Need::required);
  file.texts("notes", board.notes);
  file.texts("sources", board.sources, Need::required);
  if (const toml::table* detect = file.table("detect"); detect != nullptr) read_detect(*detect, board, report);
  for (const toml::table* boot : file.tables("boot")) board.boot.push_back(read_boot_file(*boot, report));
  file.finish();
  if (!report.empty()) return report.error();
  return board;
}

Result<std::vector<Board>> load_boards(const std::string& folder) {
  std::vector<Board> boards;
  for (const std::string& name : HostFiles().list(folder)) {
    if (!name.ends_with(".toml")) continue;
    const std::string path = folder + "/" + name;
    const Result<std::string> text = read_regular_file(path, kMaxConfigBytes);
    if (!text) return text.error();
    const Result<Board> board = parse_board(*text, path);
    if (!board) return board.error();
    boards.push_back(*board);
  }
  if (boards.empty()) return Error{folder + ": no board profile (*.toml) there; install lithe again"};
  return boards;
}

std::string boards_folder() {
  std::error_code failed;
  const std::string installed = program_dir() + "/../share/lithe/boards";
  return fs::is_directory(installed, failed) ? installed : LITHE_BOARDS_DIR;
}

FoundBoard find_board(const HostFiles& files, const std::vector<Board>& boards) {
  std::string model = files.read("/proc/device-tree/model").value;
  model = model.substr(0, model.find('\0'));  // the kernel ends it with a zero
  for (const Board& board : boards) {
    const bool is_it =
        std::ranges::any_of(board.models, [&](const std::string& start) { return model.starts_with(start); });
    if (is_it) return {&board, fmt::format("/proc/device-tree/model is \"{}\"", printable(model))};
  }
  for (const Board& board : boards) {
    if (board.cpu_flag.empty() || !has_cpu_flag(files, board.cpu_flag)) continue;
    return {&board, fmt::format("/proc/cpuinfo has the flag {}", board.cpu_flag)};
  }
  for (const Board& board : boards) {
    const auto there = std::ranges::find_if(board.files, [&](const std::string& path) { return files.has(path); });
    if (there != board.files.end()) return {&board, *there + " is there", true};
  }
  return {};
}

}  // namespace lithe::host
