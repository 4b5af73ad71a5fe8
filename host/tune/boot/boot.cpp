// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/boot.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <filesystem>
#include <system_error>

#include "host/read/words.hpp"
#include "host/tune/boot/board.hpp"
#include "host/tune/boot/edit.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/text.hpp"

namespace lithe::host {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMostBootBytes = std::size_t{64} << 10;

// Each once.
template <class T>
std::vector<T> ascending(std::vector<T> list) {
  std::ranges::sort(list);
  list.erase(std::unique(list.begin(), list.end()), list.end());
  return list;
}

Result<> check_cores(const BootCores& cores) {
  if (cores.isolated.empty()) return Error{"no core to isolate: a machine with one core keeps it for everything"};
  if (cores.housekeeping < 0) return Error{"no housekeeping core: the kernel needs one that is not isolated"};
  for (const int core : cores.isolated)
    if (core < 0) return Error{fmt::format("{} is no core", core)};
  if (contains(cores.isolated, cores.housekeeping))
    return Error{fmt::format("core {} cannot be isolated: it is the one for everything else", cores.housekeeping)};
  for (const int core : cores.tickless)
    if (!contains(cores.isolated, core)) return Error{fmt::format("core {} is to be tickless, but not isolated", core)};
  return done();
}

// A boot file's exact bytes. Not through a link: below a root it may lead out of it, and it may be another file at
// boot.
Result<std::string> read_boot(const HostFiles& files, const std::string& path) {
  std::error_code ignored;
  if (fs::is_symlink(files.root() + path, ignored))
    return Error{fmt::format("{} is a symbolic link: nothing is written. Replace it by the file it means", path)};
  Result<std::string> text = read_regular_file(files.root() + path, kMostBootBytes);
  if (text) return text;
  const bool denied = files.read(path).error == EACCES;
  return Error{text.message() + ": nothing is written. " +
               (denied ? "Plan again as root" : "Correct the file and plan again")};
}

Result<> check_writable(const HostFiles& files, const std::string& path) {
  if (::access((files.root() + path).c_str(), W_OK) == 0 || errno != EROFS) return done();  // root may write the rest
  return Error{
      fmt::format("{} is on a file system mounted read-only: nothing is written. `sudo mount -o remount,rw` its mount "
                  "point (`findmnt --target {}`) and plan again",
                  path, files.root() + path)};
}

Result<Edit> edit_grub_files(const HostFiles& files, const std::string& path, const std::vector<Flag>& wanted) {
  std::vector<std::string> paths = {path};
  for (const std::string& name : files.list(kGrubFolder))
    if (name.ends_with(".cfg")) paths.push_back(fmt::format("{}/{}", kGrubFolder, name));
  std::vector<GrubFile> texts;
  for (const std::string& each : paths) {
    const Result<std::string> text = read_boot(files, each);
    if (!text) return text.error();
    texts.push_back({each, *text});
  }
  std::error_code ignored;
  return edit_grub(texts, fs::is_directory(files.root() + kGrubFolder, ignored), wanted);
}

Result<Edit> edit_boot_file(const HostFiles& files, const BootFile& boot, const std::vector<Flag>& wanted) {
  if (boot.format == BootFormat::grub) return edit_grub_files(files, boot.path, wanted);
  const Result<std::string> text = read_boot(files, boot.path);
  if (!text) return text.error();
  return boot.format == BootFormat::line ? edit_line(boot.path, *text, wanted)
                                         : edit_extlinux(boot.path, *text, wanted);
}

// Why a boot file does not count; empty: it does.
std::string why_not(const HostFiles& files, const BootFile& boot) {
  if (!files.has(boot.path)) return "not there";
  if (!boot.needs.empty() && !files.has(boot.needs))
    return fmt::format("there, but {} is not: another system's", boot.needs);
  if (!boot.without.empty() && files.has(boot.without))
    return fmt::format("there, but {} is, too: which of them boots is not known", boot.without);
  return "";
}

std::string by_hand(const HostFiles& files, const std::vector<Flag>& flags) {
  const bool has_grubby = files.has("/usr/sbin/grubby") || files.has("/usr/bin/grubby");
  const std::string how =
      has_grubby ? fmt::format(" (here: `sudo grubby --update-kernel=ALL --args=\"{}\"`)", text_of(flags)) : "";
  return fmt::format("Add this to the kernel's command line by hand{}, boot again, and ask `lithe doctor`: {}", how,
                     text_of(flags));
}

Error no_board(const HostFiles& files, const std::vector<Board>& boards, const std::vector<Flag>& flags) {
  const Reading model = files.read("/proc/device-tree/model");
  std::vector<std::string> looked;
  for (const Board& board : boards) looked.insert(looked.end(), board.files.begin(), board.files.end());
  return Error{fmt::format("unknown board: /proc/device-tree/model {}, and none of these files is there: {}. {}",
                           model.known()
                               ? fmt::format("is \"{}\"", printable(model.value.substr(0, model.value.find('\0'))))
                               : std::string(std::strerror(model.error)),
                           fmt::join(ascending(looked), ", "), by_hand(files, flags))};
}

Error no_boot_file(const HostFiles& files, const FoundBoard& found, const std::vector<Flag>& flags) {
  std::vector<std::string> reasons;
  for (const BootFile& boot : found.board->boot)
    reasons.push_back(fmt::format("{} ({})", boot.path, why_not(files, boot)));
  return Error{
      fmt::format("board {} ({}): no boot file that lithe can edit; looked for {}. If the boot partition is not "
                  "mounted, mount it and plan again. {}",
                  found.board->name, found.because, fmt::join(reasons, ", "), by_hand(files, flags))};
}

std::vector<std::string> notes_of(const FoundBoard& found, const KernelFlags& kernel) {
  std::vector<std::string> notes = kernel.notes;
  if (found.by_file) {
    notes.push_back(
        fmt::format("taken for board {} because {}; the model itself is not in its profile or cannot be read",
                    found.board->name, found.because));
  }
  notes.insert(notes.end(), found.board->notes.begin(), found.board->notes.end());
  return notes;
}

// Of an image it is not known: true.
bool is_booted_with(const HostFiles& files, const std::vector<Flag>& flags) {
  const Reading line = files.read("/proc/cmdline");
  return !line.known() ||
         std::ranges::all_of(flags, [&](const Flag& flag) { return has_word(line.value, flag.text()); });
}

// For a shell of this machine.
std::vector<std::string> commands_of(const HostFiles& files, const BootFile& boot) {
  std::vector<std::string> commands = boot.commands;
  if (files.image())
    for (std::string& each : commands) each = fmt::format("chroot {} {}", shell_word(files.root()), each);
  return commands;
}

const BootFile* boot_file_of(const HostFiles& files, const Board& board) {
  const auto boot =
      std::ranges::find_if(board.boot, [&](const BootFile& each) { return why_not(files, each).empty(); });
  return boot == board.boot.end() ? nullptr : &*boot;
}

}  // namespace

Result<BootPlan> boot_plan(const HostFiles& files, const BootCores& wanted) {
  const BootCores cores{ascending(wanted.isolated), ascending(wanted.tickless), wanted.housekeeping};
  if (const Result<> good = check_cores(cores); !good) return good.error();
  const Result<std::vector<Board>> boards = load_boards(boards_folder());
  if (!boards) return boards.error();
  const Result<KernelFlags> kernel = flags_for(read_kernel(files), cores);
  if (!kernel) return kernel.error();
  const FoundBoard found = find_board(files, *boards);
  if (found.board == nullptr) return no_board(files, *boards, kernel->flags);
  const BootFile* boot = boot_file_of(files, *found.board);
  if (boot == nullptr) return no_boot_file(files, found, kernel->flags);
  const Result<Edit> edit = edit_boot_file(files, *boot, kernel->flags);
  if (!edit) return edit.error();

  BootPlan plan{.board = found.board->name, .changes = {}, .commands = {}, .notes = notes_of(found, *kernel)};
  if (edit->before == edit->after) {
    if (!is_booted_with(files, kernel->flags) && !boot->commands.empty()) {
      plan.commands = commands_of(files, *boot);
      plan.notes.push_back(edit->path + " has the flags, and this boot has not: run the commands, then reboot");
    }
    return plan;
  }
  if (const Result<> good = check_writable(files, edit->was_absent ? kGrubFolder : edit->path); !good)
    return good.error();
  plan.changes.push_back(
      {.kind = ChangeKind::file,
       .item = kBootItem,
       .path = edit->path,
       .was_absent = edit->was_absent,
       .before = edit->before,
       .after = edit->after,
       .why = fmt::format("from boot on, the kernel keeps cores {} free for the robot", cpu_list(cores.isolated)),
       .reboot = true});
  plan.commands = commands_of(files, *boot);
  return plan;
}

std::vector<std::string> boot_commands(const HostFiles& files) {
  const Result<std::vector<Board>> boards = load_boards(boards_folder());
  if (!boards) return {};
  const FoundBoard found = find_board(files, *boards);
  const BootFile* boot = found.board == nullptr ? nullptr : boot_file_of(files, *found.board);
  return boot == nullptr ? std::vector<std::string>{} : commands_of(files, *boot);
}

}  // namespace lithe::host
