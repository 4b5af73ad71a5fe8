// SPDX-License-Identifier: Apache-2.0
// Help texts of the verbs, made from the parser's own table (words.hpp).
#pragma once

#include <CLI/CLI.hpp>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "supervisor/core/answer.hpp"

namespace lithe::cli {

// "lithe 0.1.0, layout 1f00..."; programs of one layout share memory.
std::string version_text();

// Help for one verb ("law", "check") or for all: as --help prints it, or as markdown, man, bash or zsh.
std::variant<std::string, control::Refusal> help_text(const CLI::App& app, const std::vector<std::string>& verb,
                                                      const std::string& form);

// The first unknown verb, with the nearest known one. Empty when all verbs are known.
std::optional<control::Refusal> wrong_verb(const CLI::App& app, const std::vector<std::string>& words);

// " law check": the verb in these words; empty when there is none.
std::string verb_of(const CLI::App& app, const std::vector<std::string>& words);

// Before anything is parsed.
bool asks_for_json(const std::vector<std::string>& words);

// One verb that acts, or a group of them.
struct Verb {
  std::string name;  // "law check"; empty: `lithe` itself
  const CLI::App* app;
};
std::vector<Verb> all_verbs(const CLI::App& app);

// How an argument or option is written and what it is.
struct Argument {
  std::string words;               // "LAW", "--follow, -f", "--in TIME"
  std::vector<std::string> flags;  // "--follow", "-f"; empty: positional
  std::string type;                // "TIME", "LAW"; empty: takes no value
  std::string about;
  bool required = false;
};
std::vector<Argument> arguments_of(const CLI::App& verb);
// True when its value is a file.
bool is_file(const Argument& argument);

std::string to_bash(const CLI::App& app);
std::string to_zsh(const CLI::App& app);

}  // namespace lithe::cli
