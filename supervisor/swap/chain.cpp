// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/chain.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <fstream>
#include <map>
#include <system_error>
#include <utility>

#include "spine/core/files.hpp"
#include "spine/core/sha256.hpp"
#include "supervisor/swap/record.hpp"

namespace lithe::swap {
namespace {

namespace fs = std::filesystem;

std::string read(const fs::path& path) {
  const auto text = read_regular_file(path.string(), kMaxRecordBytes);
  return text ? *text : "";
}

struct Found {
  std::string hash;
  Json previous;
};

std::map<std::string, Found> read_files(const fs::path& dir) {
  std::map<std::string, Found> files;
  std::error_code failure;
  for (const auto& entry : fs::directory_iterator(dir, failure)) {
    if (entry.path().extension() == ".json") {
      const std::string text = read(entry.path());
      const Json certificate = Json::parse(text, nullptr, false);
      files[entry.path().filename().string()] = {
          sha256_hex(text), certificate.is_object() ? certificate.value("previous", Json()) : Json()};
    }
  }
  return files;
}

struct Writing {
  std::size_t line;
  std::string hash;
  Json previous;
};

std::size_t count_lines(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::size_t lines = 0;
  for (std::string line; std::getline(file, line);) {
    ++lines;
  }
  return lines;
}

std::map<std::string, std::vector<Writing>> read_lines(const fs::path& path, Chain& chain) {
  std::map<std::string, std::vector<Writing>> writings;
  std::string previous;
  std::ifstream file(path, std::ios::binary);
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
  const auto since = std::find_if(writings.begin(), writings.end(), [&](const Writing& w) { return w.line > known; });
  const auto is_it = [&](const Writing& w) { return w.hash == hash; };
  const bool new_then = since == writings.begin() || (since - 1)->line == known;
  const auto oldest = since == writings.begin() ? since : since - 1;
  if (std::any_of(oldest, writings.end(), is_it)) {
    return Fits::yes;
  }
  const std::string before = oldest != writings.begin() && oldest != writings.end() ? (oldest - 1)->hash : "";
  return new_then && hash == before ? Fits::cut : Fits::no;
}

}  // namespace

Chain verify_chain(const fs::path& dir) {
  Chain chain;
  const std::size_t known = count_lines(dir / kChain);
  const std::map<std::string, Found> files = read_files(dir);
  const auto lines = read_lines(dir / kChain, chain);
  const auto problem = [&](const char* what, const std::string& file, std::size_t line, const char* words) {
    chain.problems.push_back({what, file, line, fmt::format("{} {}", file, words)});
  };
  for (const auto& [name, found] : files) {
    if (!lines.contains(name)) {
      problem("extra", name, 0, "is not in the chain");
    }
  }
  chain.certificates = lines.size();
  for (const auto& [name, writings] : lines) {
    const auto found = files.find(name);
    const bool there = found != files.end();
    const Fits how = fits(there ? found->second.hash : "", writings, known);
    const auto carries = [&](const Writing& w) { return w.previous == found->second.previous; };
    if (how == Fits::cut) {
      ++chain.cut;
    } else if (!there) {
      problem("missing", name, writings.back().line, "is missing");
    } else if (how == Fits::no) {
      problem("changed", name, writings.back().line, "is not what was written last");
    } else if (std::none_of(writings.begin(), writings.end(), carries)) {
      problem("order", name, writings.front().line, "does not carry the hash of what came before it");
    }
  }
  return chain;
}

Json Chain::to_json() const {
  Json list = Json::array();
  for (const ChainProblem& each : problems) {
    list.push_back({{"what", each.what}, {"file", each.file}, {"line", each.line}, {"text", each.text}});
  }
  return {{"holds", problems.empty()},
          {"certificates", certificates},
          {"writings", writings},
          {"cut", cut},
          {"problems", std::move(list)}};
}

}  // namespace lithe::swap
