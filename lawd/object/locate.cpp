// SPDX-License-Identifier: Apache-2.0
#include "lawd/object/locate.hpp"

#include <fmt/format.h>

#include <cstdlib>
#include <sstream>

#include "lawd/compile/toolchain.hpp"
#include "lawd/object/admission_lines.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;

// Lines of the contract and of the library are skipped: the law's author did not write them.
bool is_library(const std::string& path) {
  return path.starts_with(find_contract_dir()) || path.starts_with("/usr/include/") || path.starts_with("/usr/lib/");
}

json unknown(const std::string& why) { return {{"ok", false}, {"stage", "locate"}, {"text", why}}; }

}  // namespace

// addr2line -f, innermost first: a line with the function, one with "path:line". The first line of the law is used.
json own_place(const std::string& program, std::uint64_t address) {
  const Outcome told = output_of({"addr2line", "-i", "-f", "-C", "-e", program, fmt::format("{:#x}", address)});
  if (!told.clean()) return unknown("addr2line does not run: install binutils");
  std::istringstream lines(told.output);
  for (std::string function, place; std::getline(lines, function) && std::getline(lines, place);) {
    const auto colon = place.rfind(':');
    if (colon == std::string::npos || is_library(place)) continue;
    if (const int line = std::atoi(place.c_str() + colon + 1); line > 0) {
      return {{"ok", true}, {"line", line}, {"function", function.substr(0, function.find('('))}};
    }
  }
  return unknown("no line of the law is known for this place");
}

}  // namespace lithe::lawd
