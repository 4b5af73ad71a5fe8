// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/certificate/certificate_files.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <stdio.h>

#include <algorithm>
#include <map>
#include <sstream>
#include <system_error>
#include <utility>

#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/sha256.hpp"

namespace lithe::control {
namespace {

namespace fs = std::filesystem;

Error cannot_write(const fs::path& path, const std::string& why) {
  return Error{
      fmt::format("cannot write {}: {}. The robot keeps running; this certificate waits until it can be written",
                  path.string(), why)};
}

// Exchanged with the file that is there, not renamed over it: for that, ext4 writes the new file to the disk at once,
// several times a swap, and the disk's interrupts may come to the Spine's core. A power cut may spoil the certificates
// of the last seconds; their hashes show it.
std::error_code put_in_place(const fs::path& draft, const fs::path& path) {
  std::error_code failure;
  if (::renameat2(AT_FDCWD, draft.c_str(), AT_FDCWD, path.c_str(), RENAME_EXCHANGE) == 0)
    fs::remove(draft, failure);
  else  // the first one, or a file system that cannot exchange
    fs::rename(draft, path, failure);
  return failure;
}

std::string read(const fs::path& path) {
  const auto text = read_regular_file(path.string(), kMaxCertificateBytes);
  return text ? *text : "";
}

// The lines of the chain; none when there is no such file.
std::istringstream read_chain(const fs::path& path) {
  constexpr std::size_t kMostBytes = std::size_t{1} << 30;  // millions of swaps
  auto text = read_regular_file(path.string(), kMostBytes);
  return std::istringstream(text ? std::move(*text) : "");
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
  std::istringstream file = read_chain(chain);
  for (std::string line; std::getline(file, line);)
    if (string_of(line, "file") == name) before = std::exchange(last, string_of(line, "sha256"));
  return before;
}

struct Found {
  std::string hash;
  Json previous;
};

std::map<std::string, Found> read_files(const fs::path& dir) {
  std::map<std::string, Found> files;
  for (const fs::path& path : files_in(dir)) {
    if (path.extension() != ".json") continue;
    const std::string text = read(path);
    const Json certificate = Json::parse(text, nullptr, false);
    files[path.filename().string()] = {sha256_hex(text),
                                       certificate.is_object() ? certificate.value("previous", Json()) : Json()};
  }
  return files;
}

struct Writing {
  std::size_t line;
  std::string hash;
  Json previous;
};

std::size_t count_lines(const fs::path& path) {
  std::istringstream file = read_chain(path);
  std::size_t lines = 0;
  for (std::string line; std::getline(file, line);) ++lines;
  return lines;
}

std::map<std::string, std::vector<Writing>> read_lines(const fs::path& path, Chain& chain) {
  std::map<std::string, std::vector<Writing>> writings;
  std::string previous;
  std::istringstream file = read_chain(path);
  for (std::string line; std::getline(file, line);) {
    const std::size_t number = ++chain.writings;
    const Json entry = Json::parse(line, nullptr, false);
    const bool whole = entry.is_object() && entry.contains("file") && entry["file"].is_string() &&
                       entry.contains("sha256") && entry["sha256"].is_string() && entry.contains("previous");
    if (!whole) {
      ++chain.cut;
    } else {
      const std::string name = entry["file"].get<std::string>();
      if (entry["previous"] != previous) {
        chain.problems.push_back(
            {"order", name, number,
             fmt::format("{} line {}, of {}, does not follow the line before it", kChain, number, name)});
      }
      writings[name].push_back({number, entry["sha256"].get<std::string>(), entry["previous"]});
    }
    previous = sha256_hex(line);
  }
  return writings;
}

// The accepted contents of a file: its newest writing among the `known` lines that existed before the file was read, or
// any later one. A line is written before its file, so for the last known line the writing before it is accepted too.
enum class Fits { no, cut, yes };

Fits fits(const std::string& hash, const std::vector<Writing>& writings, std::size_t known) {
  const auto since = std::ranges::find_if(writings, [&](const Writing& w) { return w.line > known; });
  const auto is_it = [&](const Writing& w) { return w.hash == hash; };
  const bool new_then = since == writings.begin() || (since - 1)->line == known;
  const auto oldest = since == writings.begin() ? since : since - 1;
  if (std::any_of(oldest, writings.end(), is_it)) return Fits::yes;
  const std::string before = oldest != writings.begin() && oldest != writings.end() ? (oldest - 1)->hash : "";
  return new_then && hash == before ? Fits::cut : Fits::no;
}

}  // namespace

fs::path records_of(const std::string& robot) { return fs::absolute(out_dir()) / robot / "swaps"; }

// Where an earlier run stopped.
Result<> CertificateFiles::open() {
  std::error_code failure;
  fs::create_directories(dir_, failure);
  if (failure) {
    return Error{
        fmt::format("cannot create {}: {}; free space there or set LITHE_OUT_DIR", dir_.string(), failure.message())};
  }
  int highest = 0;
  for (const fs::path& path : files_in(dir_)) {
    const int number = leading_number<int>(path.stem().string());
    if (path.extension() == ".json") highest = std::max(highest, number);
    if (path.extension() == ".cpp" && number > 0) texts_.insert(number);
  }
  next_ = std::max(highest, used_) + 1;
  return find_end();
}

Result<> CertificateFiles::find_end() {
  std::istringstream file = read_chain(dir_ / kChain);
  std::string last;
  for (std::string line; std::getline(file, line);) {
    last = line;
    line_is_cut_ = file.eof();
  }
  last_line_ = !last.empty() ? sha256_hex(last) : last_line_;
  const std::string name = string_of(last, "file");
  const std::string text = name.empty() ? "" : read(dir_ / name);
  // When the run ended between a line and its file, the file still holds the writing before; the chain then goes on
  // from that one. Any other content was not written by us.
  const std::string hash = sha256_hex(text);
  if (text.empty() || string_of(last, "sha256") == hash || hash_before_last(dir_ / kChain, name) != hash) return done();
  return add_line({dir_ / name, ""}, text);
}

Result<CertificateFiles::Page> CertificateFiles::write(const Json& certificate, const std::string& source) {
  notice_removal();
  if (next_ == 0) {
    if (const auto opened = open(); !opened) return opened.error();
  }
  const Page page{dir_ / fmt::format("{:04}.json", next_), last_line_, folders_};
  if (!source.empty()) {
    const fs::path path = fs::path(page.path).replace_extension(".cpp");
    if (const auto why = write_file_whole(path.string(), source); !why.empty()) return cannot_write(path, why);
    texts_.insert(next_);
  }
  if (const auto written = put(page, certificate); !written) return written.error();
  used_ = next_++;
  return page;
}

void CertificateFiles::drop_old_texts(const std::set<fs::path>& needed) {
  std::size_t old = texts_.size() - std::min(texts_.size(), most_texts_);
  std::size_t removals = kMostRemovals;
  for (auto each = texts_.begin(); old > 0 && removals > 0; --old) {
    const fs::path path = dir_ / fmt::format("{:04}.cpp", *each);
    std::error_code failure;
    const bool goes = !needed.contains(path);
    if (goes) --removals;
    if (goes && (fs::remove(path, failure), !failure))
      each = texts_.erase(each);
    else
      ++each;
  }
}

// The numbers continue and the chain starts anew, because the old chain was removed.
void CertificateFiles::notice_removal() {
  std::error_code failure;
  if (last_line_.empty() || fs::exists(dir_, failure) || failure) return;
  fs::create_directories(dir_, failure);
  if (failure) return;  // reported by the write
  ++folders_;
  last_line_.clear();
  line_is_cut_ = false;
  begun_anew_ = fmt::format("{} was removed while the robot ran, and was made again after certificate {:04}",
                            dir_.string(), used_);
}

// The line is written before the file. After a crash in between, verify_chain finds the file as in its last line but
// one.
Result<> CertificateFiles::put(const Page& page, Json certificate) {
  notice_removal();
  if (next_ == 0) {
    if (const auto opened = open(); !opened) return opened;
  }
  // In a folder made anew the certificate follows the last line that is there.
  certificate["previous"] = page.folder == folders_ ? page.previous : last_line_;
  const std::string text = certificate.dump(2, ' ', false, Json::error_handler_t::replace) + '\n';
  const fs::path draft = page.path.string() + ".draft";
  if (const auto why = write_file_whole(draft.string(), text); !why.empty()) return cannot_write(page.path, why);
  if (const auto added = add_line(page, text); !added) {
    std::error_code failure;
    fs::remove(draft, failure);
    return added;
  }
  if (const auto failed = put_in_place(draft, page.path))
    return Error{fmt::format("cannot rename {}: {}", draft.string(), failed.message())};
  return done();
}

Result<> CertificateFiles::add_line(const Page& page, const std::string& text) {
  const Json entry = {{"file", page.path.filename().string()}, {"sha256", sha256_hex(text)}, {"previous", last_line_}};
  const std::string line = entry.dump();
  const auto chain = open_regular(AT_FDCWD, (dir_ / kChain).string(), O_WRONLY | O_CREAT | O_APPEND);
  if (!chain) return chain.error();
  if (const int why = write_all(chain->get(), (line_is_cut_ ? "\n" : "") + line + '\n'); why != 0) {
    next_ = 0;  // the next write checks how much was written
    return cannot_write(dir_ / kChain, reason_of(why));
  }
  line_is_cut_ = false;
  last_line_ = sha256_hex(line);
  return done();
}

void LawTexts::add(const std::string& law, const fs::path& text) {
  std::erase_if(texts_, [&](const auto& each) { return each.first == law; });
  texts_.emplace_back(law, text);
  if (texts_.size() > kMost) texts_.pop_front();
}

fs::path LawTexts::find(const std::string& law) const {
  const auto found = std::ranges::find(texts_, law, [](const auto& each) -> const std::string& { return each.first; });
  return found != texts_.end() ? found->second : fs::path();
}

void LateCertificates::hold(std::uint64_t request_id, Json certificate, const CertificateFiles::Page& page) {
  Late& late = late_[request_id];
  late.certificate = std::move(certificate);
  if (late.page.path.empty()) late.page = page;
  if (late_.size() > kMost) late_.erase(late_.begin());
}

void LateCertificates::retry(CertificateFiles& book, std::int64_t now_ns) {
  if (now_ns < next_try_ns_ || waiting() == 0) return;
  next_try_ns_ = now_ns + kPauseNs;
  for (auto& [id, late] : late_) {
    if (late.certificate.is_null()) continue;
    if (late.page.path.empty()) {
      const auto page = book.write(late.certificate);
      if (!page) return;
      late.page = *page;
    } else if (!book.rewrite(late.page, late.certificate)) {
      return;
    }
    late.certificate = nullptr;
  }
}

std::size_t LateCertificates::waiting() const {
  return static_cast<std::size_t>(
      std::ranges::count_if(late_, [](const auto& each) { return !each.second.certificate.is_null(); }));
}

Chain verify_chain(const fs::path& dir) {
  Chain chain;
  const std::size_t known = count_lines(dir / kChain);
  const std::map<std::string, Found> files = read_files(dir);
  const auto lines = read_lines(dir / kChain, chain);
  const auto problem = [&](const char* what, const std::string& file, std::size_t line, const char* words) {
    chain.problems.push_back({what, file, line, fmt::format("{} {}", file, words)});
  };
  for (const auto& [name, found] : files)
    if (!lines.contains(name)) problem("extra", name, 0, "is not in the chain");
  chain.certificates = lines.size();
  for (const auto& [name, writings] : lines) {
    const auto found = files.find(name);
    const bool there = found != files.end();
    const Fits how = fits(there ? found->second.hash : "", writings, known);
    const auto carries = [&](const Writing& w) { return w.previous == found->second.previous; };
    if (how == Fits::cut)
      ++chain.cut;
    else if (!there)
      problem("missing", name, writings.back().line, "is missing");
    else if (how == Fits::no)
      problem("changed", name, writings.back().line, "is not what was written last");
    else if (std::ranges::none_of(writings, carries))
      problem("order", name, writings.front().line, "does not carry the hash of what came before it");
  }
  return chain;
}

Json Chain::to_json() const {
  Json list = Json::array();
  for (const ChainProblem& each : problems)
    list.push_back({{"what", each.what}, {"file", each.file}, {"line", each.line}, {"text", each.text}});
  return {{"holds", problems.empty()},
          {"certificates", certificates},
          {"writings", writings},
          {"cut", cut},
          {"problems", std::move(list)}};
}

}  // namespace lithe::control
