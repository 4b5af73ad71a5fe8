// SPDX-License-Identifier: Apache-2.0
#include "host/tune/journal/journal.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <utility>

#include "host/read/files.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t kMostJournalBytes = std::size_t{64} << 20;

std::int64_t ticks_since_boot() {
  timespec now{};
  ::clock_gettime(CLOCK_BOOTTIME, &now);
  const long tick_hz = ::sysconf(_SC_CLK_TCK);
  return now.tv_sec * tick_hz + now.tv_nsec * tick_hz / 1'000'000'000;
}

Json json_of(const Change& change) {
  return {{"kind", kChangeKinds[static_cast<std::size_t>(change.kind)]},
          {"item", change.item},
          {"path", change.path},
          {"was_absent", change.was_absent},
          {"before", bytes_as_text(change.before)},
          {"after", bytes_as_text(change.after)},
          {"why", bytes_as_text(change.why)},
          {"reboot", change.reboot},
          {"start_time_ticks", change.start_time_ticks}};
}

// Throws on a line that is not ours.
Change change_of(const Json& json) {
  const auto* const kind = std::ranges::find(kChangeKinds, json.at("kind").get<std::string>());
  if (kind == std::end(kChangeKinds)) throw std::out_of_range("kind");
  Change change;
  change.kind = static_cast<ChangeKind>(kind - std::begin(kChangeKinds));
  change.item = json.at("item");
  change.path = json.at("path");
  change.was_absent = json.at("was_absent");
  change.before = text_as_bytes(json.at("before"));
  change.after = text_as_bytes(json.at("after"));
  change.why = text_as_bytes(json.at("why"));
  change.reboot = json.at("reboot");
  change.start_time_ticks = json.at("start_time_ticks");
  return change;
}

bool is_of_the_same(const Change& one, const Change& other) {
  return one.kind == other.kind && one.path == other.path && one.start_time_ticks == other.start_time_ticks;
}

bool is_still_this_file(int fd, const std::string& path) {
  struct stat held{}, named{};
  return ::fstat(fd, &held) == 0 && ::stat(path.c_str(), &named) == 0 && held.st_ino == named.st_ino &&
         held.st_dev == named.st_dev;
}

}  // namespace

std::string bytes_as_text(const std::string& bytes) {
  std::string text;
  for (const char each : bytes) {
    const auto byte = static_cast<unsigned char>(each);
    if (byte < 0x80) {
      text += each;
    } else {
      text += static_cast<char>(0xC0U | byte >> 6U);
      text += static_cast<char>(0x80U | (byte & 0x3FU));
    }
  }
  return text;
}

std::string text_as_bytes(const std::string& text) {
  std::string bytes;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto lead = static_cast<unsigned char>(text[i]);
    if (lead < 0x80 || i + 1 == text.size())
      bytes += text[i];
    else
      bytes += static_cast<char>((lead & 0x03U) << 6U | (static_cast<unsigned char>(text[++i]) & 0x3FU));
  }
  return bytes;
}

std::string boot_id(const std::string& root) { return HostFiles(root).read("/proc/sys/kernel/random/boot_id").value; }

Result<Journal> Journal::open(const std::string& path, const std::string& boot, bool make, StepHook hook) {
  Journal journal(path, boot, std::move(hook));
  if (const Result<> locked = journal.lock(make); !locked) return locked.error();
  if (!journal.file_) return journal;
  if (const Result<> loaded = journal.load(); !loaded) return loaded.error();
  return journal;
}

Result<> Journal::lock(bool make) {
  if (make) {
    std::error_code failed;
    std::filesystem::create_directories(std::filesystem::path(path_).parent_path(), failed);
    if (failed) return Error{fmt::format("cannot make the folder of {}: {}", path_, failed.message())};
  }
  for (;;) {
    file_ = Fd(::open(path_.c_str(), O_RDWR | O_APPEND | O_CLOEXEC | O_NOFOLLOW | (make ? O_CREAT : 0), 0600));
    if (!file_ && errno == ENOENT && !make) return done();
    if (!file_) return Error{fmt::format("cannot open the journal {}: {}", path_, std::strerror(errno))};
    if (::flock(file_.get(), LOCK_EX | LOCK_NB) != 0) {
      const int error = errno;
      file_ = Fd();
      return Error{error == EWOULDBLOCK ? fmt::format("{} is in use: another lithe tune works, or a robot with "
                                                      "--shield runs; wait for its end or stop it",
                                                      path_)
                                        : fmt::format("cannot lock the journal {}: {}", path_, std::strerror(error))};
    }
    struct stat about{};
    if (::fstat(file_.get(), &about) != 0 || about.st_uid != ::geteuid() || (about.st_mode & 022U) != 0) {
      file_ = Fd();
      return Error{
          fmt::format("{} can be written by others, so it is not replayed: see what it says, and remove it", path_)};
    }
    if (is_still_this_file(file_.get(), path_)) return done();  // else its holder removed it while we waited
  }
}

Result<> Journal::load() {
  const Result<std::string> text = read_regular_file(path_, kMostJournalBytes);
  if (!text) return text.error();
  std::size_t at = 0;
  for (std::size_t end = 0; (end = text->find('\n', at)) != std::string::npos; at = end + 1)
    take(text->substr(at, end - at));
  // The torn line goes away, or the next one would be glued to it.
  if (at < text->size() && ::ftruncate(file_.get(), static_cast<off_t>(at)) != 0)
    return Error{fmt::format("cannot cut the unfinished last line of {}: {}", path_, std::strerror(errno))};
  return done();
}

void Journal::take(const std::string& line) {
  try {
    const Json json = Json::parse(line);
    const std::uint64_t number = json.at("number");
    last_ = std::max(last_, number);
    if (json.contains("change")) {
      Entry entry{.number = number, .change = change_of(json["change"]), .at_ticks = json.at("at_ticks")};
      undone_.erase(entry.change.item);
      if (json.at("boot") == boot_) merge(std::move(entry));
      return;
    }
    const auto entry = std::ranges::find_if(entries_, [&](const Entry& each) { return each.number == number; });
    if (entry == entries_.end()) return;
    if (json.value("dropped", "") == kUndone) undone_.insert(entry->change.item);
    if (json.value("done", false))
      entry->ours.push_back(text_as_bytes(json.at("after")));
    else if (json.contains("dropped") || entry->ours.size() == 1)
      entries_.erase(entry);  // undone; or the only attempt failed
  } catch (const std::exception&) {
    ++unreadable_;
  }
}

void Journal::merge(Entry entry) {
  entry.ours = {entry.change.after};
  for (Entry& each : entries_) {
    if (!is_of_the_same(each.change, entry.change)) continue;
    each.number = entry.number;
    each.ours.push_back(entry.change.after);
    // A person has edited the file meanwhile: that text comes back.
    if (entry.change.kind == ChangeKind::file && !contains(each.ours, entry.change.before)) each.change = entry.change;
    return;
  }
  entries_.push_back(std::move(entry));
}

Result<std::uint64_t> Journal::begin(const Change& change) {
  Entry entry{.number = last_ + 1, .change = change, .at_ticks = ticks_since_boot()};
  const Json line = {
      {"number", entry.number}, {"boot", boot_}, {"at_ticks", entry.at_ticks}, {"change", json_of(change)}};
  if (const Result<> written = append(line.dump(), true); !written) return written.error();
  last_ = entry.number;
  undone_.erase(change.item);
  merge(std::move(entry));
  return last_;
}

Result<> Journal::finish(std::uint64_t number, int error, const std::string& after) {
  Json line = {{"number", number}, {"done", error == 0}};
  line[error == 0 ? "after" : "error"] = error == 0 ? bytes_as_text(after) : std::strerror(error);
  const std::string text = line.dump();
  take(text);
  return append(text, false);
}

Result<> Journal::drop(std::uint64_t number, const std::string& why) {
  const std::string text = Json{{"number", number}, {"dropped", why}}.dump();
  take(text);
  return append(text, false);
}

Result<> Journal::append(const std::string& line, bool to_disk) {
  steps_.step();
  const off_t size = ::lseek(file_.get(), 0, SEEK_END);
  const bool first = size == 0;
  int error = write_all(file_.get(), line + "\n");
  // A full disk took a part of it: the next line must not be glued to that.
  if (error != 0 && size >= 0) (void)!::ftruncate(file_.get(), size);
  if (to_disk && error == 0) {
    steps_.step();
    error = ::fsync(file_.get()) == 0 ? 0 : errno;
    if (first) sync_folder_of(path_);
  }
  if (error == 0) return done();
  return Error{fmt::format("cannot write the journal {}: {}", path_, std::strerror(error))};
}

void Journal::remove(bool unreadable_too) {
  if (!file_ || !entries_.empty() || (unreadable_ > 0 && !unreadable_too))
    return;  // the only record of what those lines say
  steps_.step();
  ::unlink(path_.c_str());
  sync_folder_of(path_);
  file_ = Fd();
}

}  // namespace lithe::host
