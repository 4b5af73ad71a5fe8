// SPDX-License-Identifier: Apache-2.0
// `lithe law show` and `lithe law verify`: certificates on disk. No robot needs to run.
#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <system_error>
#include <utility>
#include <variant>
#include <vector>

#include "spine/core/host/files.hpp"
#include "spine/core/text.hpp"
#include "supervisor/cli/act.hpp"
#include "supervisor/cli/show.hpp"
#include "supervisor/cli/talk.hpp"
#include "supervisor/swap/record.hpp"

namespace lithe::cli {
namespace {

namespace fs = std::filesystem;

Refusal no_certificates(const fs::path& folder) {
  return {"no_certificates", fmt::format("there are no certificates in {}", folder.string()),
          "each swap leaves one; say where: --robot NAME, or --folder DIR"};
}

// The one robot that has left certificates below the working directory (or $LITHE_OUT_DIR).
std::variant<fs::path, Refusal> only_folder() {
  const fs::path all = swap::records_of("any").parent_path().parent_path();
  std::vector<std::string> robots;
  std::error_code failure;
  for (const auto& entry : fs::directory_iterator(all, failure)) {
    if (fs::is_directory(entry.path() / "swaps", failure)) {
      robots.push_back(entry.path().filename().string());
    }
  }
  if (robots.size() == 1) {
    return swap::records_of(robots.front());
  }
  if (robots.empty()) {
    return no_certificates(all);
  }
  return Refusal{"several_robots", fmt::format("several robots have left certificates in {}", all.string()),
                 "say which: --robot NAME"};
}

// The folder of the command line, else that of the running robot's supervisor, else out/ below the working directory.
std::variant<fs::path, Refusal> find_folder(const Context& context, const std::string& folder) {
  if (!folder.empty()) {
    return fs::path(folder);
  }
  const Answer answer = ask(context, "status", Json::object());
  if (const Json* status = std::get_if<Json>(&answer); status != nullptr && status->contains("records")) {
    return fs::path((*status)["records"].get<std::string>());
  }
  if (const auto* refusal = std::get_if<Refusal>(&answer); refusal != nullptr && refusal->code == "several_robots") {
    return *refusal;
  }
  return context.robot.empty() ? only_folder() : swap::records_of(context.robot);
}

// Newest first.
std::vector<fs::path> pages(const fs::path& folder) {
  std::vector<fs::path> found;
  std::error_code failure;
  for (const auto& entry : fs::directory_iterator(folder, failure)) {
    if (entry.path().extension() == ".json") {
      found.push_back(entry.path());
    }
  }
  const auto number = [](const fs::path& path) { return std::atol(path.stem().c_str()); };
  std::sort(found.begin(), found.end(), [&](const fs::path& a, const fs::path& b) { return number(a) > number(b); });
  return found;
}

Json read(const fs::path& path) {
  const auto text = read_regular_file(path.string(), swap::kMaxRecordBytes);
  return Json::parse(text ? *text : "", nullptr, false);
}

bool all_digits(const std::string& word) {
  return !word.empty() && std::all_of(word.begin(), word.end(), [](unsigned char c) { return std::isdigit(c) != 0; });
}

// `which`: last, a number, or a law: its own name, or its source file's with or without .cpp.
bool means(const std::string& which, const fs::path& page, const Json& certificate) {
  if (all_digits(which)) {
    return std::atol(which.c_str()) == std::atol(page.stem().c_str());
  }
  const auto is = [&](const char* key) {
    const Json value = certificate.is_object() ? certificate.value(key, Json()) : Json();
    return value.is_string() && (value == which || value == which + ".cpp");
  };
  return is("law") || is("source");
}

std::optional<std::pair<fs::path, Json>> find_page(const fs::path& folder, const std::string& which) {
  for (const fs::path& page : pages(folder)) {
    if (which == "last" || (all_digits(which) && means(which, page, Json()))) {
      return std::pair(page, read(page));
    }
    if (!all_digits(which)) {
      Json certificate = read(page);
      if (means(which, page, certificate)) {
        return std::pair(page, std::move(certificate));
      }
    }
  }
  return std::nullopt;
}

}  // namespace

int law_show(const Context& context, const std::string& which, const std::string& folder_word) {
  const auto folder = find_folder(context, folder_word);
  if (const auto* refusal = std::get_if<Refusal>(&folder)) {
    return refuse(context, *refusal);
  }
  const auto& place = std::get<fs::path>(folder);
  const auto found = find_page(place, which);
  if (!found) {
    const bool none = pages(place).empty();
    return refuse(context, none ? no_certificates(place)
                                : Refusal{"no_certificates",
                                          fmt::format("no certificate in {} is of '{}'", place.string(), which),
                                          "say last, a number, or the name of a law"});
  }
  const auto& [page, certificate] = *found;
  if (!certificate.is_object()) {
    return refuse(context, {"bad_certificate", fmt::format("{} is not a certificate", page.string()),
                            "see what else was changed: lithe law verify"});
  }
  return finish(context, certificate,
                [&page = page](const Json& shown) { print_certificate(printable(page.filename().string()), shown); });
}

int law_verify(const Context& context, const std::string& folder_word) {
  const auto folder = find_folder(context, folder_word);
  if (const auto* refusal = std::get_if<Refusal>(&folder)) {
    return refuse(context, *refusal);
  }
  const auto& place = std::get<fs::path>(folder);
  const swap::Chain chain = swap::verify_chain(place);
  if (chain.writings == 0 && chain.problems.empty()) {
    return refuse(context, no_certificates(place));
  }
  Json result = {{"folder", fs::absolute(place).string()}};
  result.update(chain.to_json());
  const int code = finish(context, result, print_chain);
  return code != 0 || chain.problems.empty() ? code : 1;
}

}  // namespace lithe::cli
