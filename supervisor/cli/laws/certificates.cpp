// SPDX-License-Identifier: Apache-2.0
// `lithe law show` and `lithe law verify`: certificates on disk. No robot needs to run.
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <optional>
#include <system_error>
#include <utility>
#include <variant>
#include <vector>

#include "spine/core/host/files.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/text.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/laws/show.hpp"
#include "supervisor/swap/certificate/certificate_files.hpp"

namespace lithe::cli {
namespace {

namespace fs = std::filesystem;

Refusal no_certificates(const fs::path& folder) {
  std::error_code failure;
  return {"no_certificates",
          fmt::format("there {} {}", fs::is_directory(folder, failure) ? "are no certificates in" : "is no folder",
                      folder.string()),
          "each swap leaves one; say where: --robot NAME, or --folder DIR"};
}

// The one robot that has left certificates below the working directory (or $LITHE_OUT_DIR).
fs::path only_folder() {
  const fs::path all = control::records_of("any").parent_path().parent_path();
  std::vector<std::string> robots;
  std::error_code failure;
  for (const fs::path& path : files_in(all))
    if (fs::is_directory(path / "swaps", failure)) robots.push_back(path.filename().string());
  if (robots.size() == 1) return control::records_of(robots.front());
  if (robots.empty()) throw no_certificates(all);
  throw Refusal{"several_robots", fmt::format("several robots have left certificates in {}", all.string()),
                "say which: --robot NAME"};
}

// The folder of the command line, else that of the running robot's supervisor, else out/ below the working directory.
fs::path find_folder(const Context& context, const std::string& folder) {
  if (!folder.empty()) return fs::path(folder);
  Answer answer = try_ask(context, "status", Json::object());
  if (const Json* status = std::get_if<Json>(&answer); status != nullptr && status->contains("records"))
    return fs::path((*status)["records"].get<std::string>());
  if (auto* refusal = std::get_if<Refusal>(&answer); refusal != nullptr && refusal->code == "several_robots")
    throw std::move(*refusal);
  return context.robot.empty() ? only_folder() : control::records_of(context.robot);
}

// Newest first.
std::vector<fs::path> pages(const fs::path& folder) {
  std::vector<fs::path> found = files_in(folder);
  std::erase_if(found, [](const fs::path& path) { return path.extension() != ".json"; });
  const auto number = [](const fs::path& path) { return leading_number<long>(path.stem().string()); };
  std::ranges::sort(found, [&](const fs::path& a, const fs::path& b) { return number(a) > number(b); });
  return found;
}

Json read(const fs::path& path) {
  const auto text = read_regular_file(path.string(), control::kMaxCertificateBytes);
  return Json::parse(text ? *text : "", nullptr, false);
}

// `which`: last, a number, or a law: its own name, or its source file's with or without .cpp.
bool means(const std::string& which, const fs::path& page, const Json& certificate) {
  if (which == "last") return true;
  if (const auto number = whole_number<unsigned long>(which))
    return number == whole_number<unsigned long>(page.stem().string());
  const auto is = [&](const char* key) {
    const Json value = certificate.is_object() ? certificate.value(key, Json()) : Json();
    return value.is_string() && (value == which || value == which + ".cpp");
  };
  return is("law") || is("source");
}

std::optional<std::pair<fs::path, Json>> find_page(const fs::path& folder, const std::string& which) {
  for (const fs::path& page : pages(folder)) {
    Json certificate = read(page);
    if (means(which, page, certificate)) return std::pair(page, std::move(certificate));
  }
  return std::nullopt;
}

}  // namespace

int law_show(const Context& context, const std::string& which, const std::string& folder_word, bool source) {
  const fs::path folder = find_folder(context, folder_word);
  const auto found = find_page(folder, which);
  if (!found && pages(folder).empty()) throw no_certificates(folder);
  if (!found) {
    throw Refusal{"no_certificates", fmt::format("no certificate in {} is of '{}'", folder.string(), which),
                  fmt::format("say last, a number up to {}, or the name of a law",
                              leading_number<long>(pages(folder).front().stem().string()))};
  }
  const auto& [page, certificate] = *found;
  if (!certificate.is_object()) {
    throw Refusal{"bad_certificate", fmt::format("{} is not a certificate", page.string()),
                  "see what else was changed: lithe law verify"};
  }
  if (source) {
    const fs::path path = fs::path(page).replace_extension(".cpp");
    const auto text = read_regular_file(path.string(), control::kMaxCertificateBytes);
    if (!text) {
      throw Refusal{"no_source",
                    fmt::format("cannot read {}: the texts of the newest {} swaps are kept, and those of laws that are "
                                "loaded or ran since the supervisor started",
                                path.string(), control::CertificateFiles::kMostTexts),
                    "lithe law show has its name and hash"};
    }
    return finish(context, {{"source", *text}}, [&text](const Json&) {
      fmt::print("{}", ::isatty(STDOUT_FILENO) == 1 ? printable(*text, true) : *text);
    });
  }
  return finish(context, certificate,
                [&page = page](const Json& shown) { print_certificate(printable(page.filename().string()), shown); });
}

int law_verify(const Context& context, const std::string& folder_word) {
  const fs::path folder = find_folder(context, folder_word);
  const control::Chain chain = control::verify_chain(folder);
  if (chain.writings == 0 && chain.problems.empty()) throw no_certificates(folder);
  Json result = {{"folder", fs::absolute(folder).string()}};
  result.update(chain.to_json());
  finish(context, result, print_chain);
  return chain.problems.empty() ? 0 : 1;
}

}  // namespace lithe::cli
