// SPDX-License-Identifier: Apache-2.0
#include "lawd/object/admission_lines.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <sstream>
#include <vector>

#include "lawd/compile/toolchain.hpp"
#include "lawd/core/admission.hpp"
#include "lawd/run/child.hpp"
#include "lawd/run/files.hpp"
#include "lawd/source/admission_tokens.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::lawd {
namespace {

bool in_name(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_'; }

// "Law::step(...)::count" -> "count"; "(anonymous namespace)::table" -> "table"; "f()::k [clone]" -> "k".
std::string_view last_word(std::string_view name) {
  if (const auto clone = name.find(" ["); clone != std::string_view::npos) name = name.substr(0, clone);
  while (!name.empty() && !in_name(name.back())) name.remove_suffix(1);
  std::size_t from = name.size();
  while (from > 0 && in_name(name[from - 1])) --from;
  return name.substr(from);
}

// Lines of the contract and of the library are skipped: the law's author did not write them.
bool is_library(const std::string& path) {
  return path.starts_with(find_contract_dir()) || path.starts_with("/usr/include/") || path.starts_with("/usr/lib/") ||
         path.find("/include/c++/") != std::string::npos;  // of a compiler somewhere else
}

}  // namespace

// addr2line -a -f: of each address a line with it, then pairs of lines, innermost first: the function, and "path:line".
// The first line of the law is used. A compiler may give an instruction a line of the contract alone (g++ 14: the jump
// of a loop that does nothing), so the addresses before it are looked at, too, the nearest first.
nlohmann::json own_place(const std::string& program, std::uint64_t address, std::string_view section) {
  constexpr std::uint64_t kBytesBefore = 32;
  std::vector<std::string> command = {"addr2line", "-a", "-i", "-f", "-C", "-e", program};
  if (!section.empty()) command.insert(command.end(), {"-j", std::string(section)});
  for (std::uint64_t back = 0; back <= std::min(address, kBytesBefore); ++back)
    command.push_back(fmt::format("{:#x}", address - back));
  const Outcome told = run_program(command, Limits{5'000}, STDOUT_FILENO);
  if (!told.clean()) return refuse("locate", "addr2line does not run: install binutils");
  std::istringstream lines(told.output);
  for (std::string function, place; std::getline(lines, function);) {
    if (function.starts_with("0x") || !std::getline(lines, place)) continue;
    const auto colon = place.rfind(':');
    if (colon == std::string::npos || is_library(place)) continue;
    if (const int line = leading_number<int>(std::string_view(place).substr(colon + 1)); line > 0)
      return {{"ok", true}, {"line", line}, {"function", function.substr(0, function.find('('))}};
  }
  return refuse("locate", "no line of the law is known for this place");
}

int SourceLines::of(std::string_view section, std::uint64_t offset) const {
  return own_place(compiled_.object_path, offset, section).value("line", 0);
}

// Debug information has the path without its folder, the call graph with it: compare the file name only.
int SourceLines::own_line(std::string_view place) const {
  const auto file_of = [](std::string_view path) { return path.substr(path.find_last_of('/') + 1); };
  const std::string_view own = file_of(compiled_.source_path);
  const std::string_view rest = file_of(place);
  if (own.empty() || !rest.starts_with(own) || rest.size() <= own.size() || rest[own.size()] != ':') return 0;
  return std::max(leading_number<int>(rest.substr(own.size() + 1)), 0);
}

int SourceLines::mentions(std::string_view name) const {
  const std::string_view word = last_word(name);
  const auto text = read_file(compiled_.source_path);
  if (word.empty() || !text) return 0;
  for (const Token& token : tokenise(*text).list)
    if (token.kind == TokenKind::word && token.text == word) return token.line;
  return 0;
}

int SourceLines::last() const {
  const auto text = read_file(compiled_.source_path);
  const Tokens tokens = tokenise(text ? *text : "");
  return tokens.list.empty() ? 1 : tokens.list.back().line;
}

}  // namespace lithe::lawd
