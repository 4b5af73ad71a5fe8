// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/record.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <system_error>
#include <utility>

#include "spine/core/files.hpp"
#include "spine/core/sha256.hpp"

namespace lithe::swap {
namespace {

namespace fs = std::filesystem;

Error cannot_write(const fs::path& path) {
  return Error{
      fmt::format("cannot write {}: disk full, over a limit (ulimit -f), or read-only? The robot keeps running; this "
                  "certificate waits for room",
                  path.string())};
}

std::string read(const fs::path& path) {
  const auto text = read_regular_file(path.string(), kMaxRecordBytes);
  return text ? *text : "";
}

// One value of a line of the chain; empty when the line is cut or has no such text.
std::string string_of(const std::string& line, const char* key) {
  const Json entry = Json::parse(line, nullptr, false);
  const auto found = entry.is_object() ? entry.find(key) : entry.end();
  return found != entry.end() && found->is_string() ? found->get<std::string>() : "";
}

// Hash of the writing before the last one; empty = none.
std::string hash_before_last(const fs::path& chain, const std::string& name) {
  std::string last, before;
  std::ifstream file(chain, std::ios::binary);
  for (std::string line; std::getline(file, line);) {
    if (string_of(line, "file") == name) {
      before = std::exchange(last, string_of(line, "sha256"));
    }
  }
  return before;
}

}  // namespace

fs::path records_of(const std::string& robot) {
  const char* chosen = std::getenv("LITHE_OUT_DIR");
  return fs::absolute(chosen != nullptr ? chosen : "out") / robot / "swaps";
}

// Where an earlier run stopped.
Result<> RecordBook::open() {
  std::error_code failure;
  fs::create_directories(dir_, failure);
  if (failure) {
    return Error{
        fmt::format("cannot create {}: {}; free space there or set LITHE_OUT_DIR", dir_.string(), failure.message())};
  }
  int highest = 0;
  for (const auto& entry : fs::directory_iterator(dir_, failure)) {
    if (entry.path().extension() == ".json") {
      highest = std::max(highest, std::atoi(entry.path().stem().c_str()));
    }
  }
  next_ = std::max(highest, used_) + 1;
  return find_end();
}

Result<> RecordBook::find_end() {
  std::ifstream file(dir_ / kChain, std::ios::binary);
  std::string last;
  for (std::string line; std::getline(file, line);) {
    last = line;
    line_is_cut_ = file.eof();
  }
  last_line_ = file.is_open() && !last.empty() ? sha256_hex(last) : last_line_;
  const std::string name = string_of(last, "file");
  const std::string text = name.empty() ? "" : read(dir_ / name);
  // When the run ended between a line and its file, the file still holds the writing before; the chain then goes on
  // from that one. Any other content was not written by us.
  const std::string hash = sha256_hex(text);
  if (text.empty() || string_of(last, "sha256") == hash || hash_before_last(dir_ / kChain, name) != hash) {
    return done();
  }
  return add_line({dir_ / name, ""}, text);
}

Result<RecordBook::Page> RecordBook::write(const Json& certificate) {
  notice_removal();
  if (next_ == 0) {
    if (const auto opened = open(); !opened) {
      return opened.error();
    }
  }
  const Page page{dir_ / fmt::format("{:04}.json", next_), last_line_, folders_};
  if (const auto written = put(page, certificate); !written) {
    return written.error();
  }
  used_ = next_++;
  return page;
}

// The numbers continue and the chain starts anew, because the old chain was removed.
void RecordBook::notice_removal() {
  std::error_code failure;
  if (last_line_.empty() || fs::exists(dir_, failure) || failure) {
    return;
  }
  fs::create_directories(dir_, failure);
  if (failure) {
    return;  // reported by the write
  }
  ++folders_;
  last_line_.clear();
  line_is_cut_ = false;
  begun_anew_ = fmt::format("{} was removed while the robot ran, and was made again after certificate {:04}",
                            dir_.string(), used_);
}

// The line is written before the file. After a crash in between, verify_chain finds the file as in its last line but
// one.
Result<> RecordBook::put(const Page& page, Json certificate) {
  notice_removal();
  if (next_ == 0) {
    if (const auto opened = open(); !opened) {
      return opened;
    }
  }
  // In a folder made anew the certificate follows the last line that is there.
  certificate["previous"] = page.folder == folders_ ? page.previous : last_line_;
  const std::string text = certificate.dump(2, ' ', false, Json::error_handler_t::replace) + '\n';
  std::error_code failure;
  const fs::path draft = page.path.string() + ".draft";
  {
    std::ofstream file(draft, std::ios::binary | std::ios::trunc);
    file << text;
    file.flush();
    if (!file) {
      file.close();
      fs::remove(draft, failure);
      return cannot_write(page.path);
    }
  }
  if (const auto added = add_line(page, text); !added) {
    fs::remove(draft, failure);
    return added;
  }
  fs::rename(draft, page.path, failure);
  if (failure) {
    return Error{fmt::format("cannot rename {}: {}", draft.string(), failure.message())};
  }
  return done();
}

Result<> RecordBook::add_line(const Page& page, const std::string& text) {
  const Json entry = {{"file", page.path.filename().string()}, {"sha256", sha256_hex(text)}, {"previous", last_line_}};
  const std::string line = entry.dump();
  std::ofstream chain(dir_ / kChain, std::ios::binary | std::ios::app);
  chain << (line_is_cut_ ? "\n" : "") << line << '\n';
  chain.flush();
  if (!chain) {
    next_ = 0;  // the next write checks how much was written
    return cannot_write(dir_ / kChain);
  }
  line_is_cut_ = false;
  last_line_ = sha256_hex(line);
  return done();
}

}  // namespace lithe::swap
