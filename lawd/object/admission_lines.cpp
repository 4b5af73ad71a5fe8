// SPDX-License-Identifier: Apache-2.0
#include "lawd/object/admission_lines.hpp"

#include <unistd.h>

#include <charconv>

#include "lawd/run/files.hpp"
#include "lawd/source/admission_tokens.hpp"

namespace lithe::lawd {
namespace {

bool is_word(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_'; }

// "Law::step(...)::count" -> "count"; "(anonymous namespace)::table" -> "table"; "f()::k [clone]" -> "k".
std::string_view last_word(std::string_view name) {
  if (const auto clone = name.find(" ["); clone != std::string_view::npos) name = name.substr(0, clone);
  while (!name.empty() && !is_word(name.back())) name.remove_suffix(1);
  std::size_t from = name.size();
  while (from > 0 && is_word(name[from - 1])) --from;
  return name.substr(from);
}

}  // namespace

Outcome output_of(const std::vector<std::string>& argv, int wall_ms) {
  std::vector<char*> raw;
  for (const std::string& word : argv) raw.push_back(const_cast<char*>(word.c_str()));
  raw.push_back(nullptr);
  Limits limits;
  limits.wall_ms = wall_ms;
  return run_child(
      [&raw](int out_fd) {
        dup2(out_fd, 1);
        execvp(raw[0], raw.data());
        return 127;
      },
      limits);
}

int SourceLines::of(std::string_view section, std::uint64_t offset) const {
  char address[24];
  const auto end = std::to_chars(address, address + sizeof address, offset, 16).ptr;
  const Outcome asked = output_of(
      {"addr2line", "-i", "-e", compiled_.object_path, "-j", std::string(section), "0x" + std::string(address, end)});
  const std::string text = asked.clean() ? asked.output : "";
  for (std::size_t from = 0; from < text.size();) {
    std::size_t to = text.find('\n', from);
    if (to == std::string::npos) to = text.size();
    if (const int line = own_line(std::string_view(text).substr(from, to - from))) return line;
    from = to + 1;
  }
  return 0;
}

// Debug information has the path without its folder, the call graph with it: compare the file name only.
int SourceLines::own_line(std::string_view place) const {
  const auto file_of = [](std::string_view path) { return path.substr(path.find_last_of('/') + 1); };
  const std::string_view own = file_of(compiled_.source_path);
  const std::string_view rest = file_of(place);
  if (own.empty() || !rest.starts_with(own) || rest.size() <= own.size() || rest[own.size()] != ':') return 0;
  int line = 0;
  std::from_chars(rest.data() + own.size() + 1, rest.data() + rest.size(), line);
  return line > 0 ? line : 0;
}

int SourceLines::mentions(std::string_view name) const {
  const std::string_view word = last_word(name);
  const auto text = read_file(compiled_.source_path);
  if (word.empty() || !text) return 0;
  for (const Token& token : tokenise(*text).list) {
    if (token.kind == TokenKind::word && token.text == word) return token.line;
  }
  return 0;
}

int SourceLines::last() const {
  const auto text = read_file(compiled_.source_path);
  const Tokens tokens = tokenise(text ? *text : "");
  return tokens.list.empty() ? 1 : tokens.list.back().line;
}

}  // namespace lithe::lawd
