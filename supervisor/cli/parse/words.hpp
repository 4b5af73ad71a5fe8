// SPDX-License-Identifier: Apache-2.0
// The one table of the command line: every verb with its arguments, options and help. It parses, and from it come
// `--help`, `lithe help`, the hint at a wrong verb, completion, the man page and docs/reference/cli.md (reference.cpp).
#pragma once

#include <CLI/CLI.hpp>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "supervisor/cli/core/act.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/run/supervisor.hpp"

namespace lithe::cli {

// The parsed command line.
struct CommandLine {
  Context context;
  control::RunOptions run;
  std::string law;
  std::string name;
  std::string folder;
  std::string which = "last";
  bool source = false;  // the law's text instead of its certificate
  std::vector<std::string> params;
  std::map<std::string, double> terms;  // of a swap, by the names of the verb's arguments
  bool no_promote = false;              // its shadow is only measured
  bool now = false;                     // disarm without braking
  bool all_the_same = false;            // arm a law that has stopped the robot
  std::uint64_t since = 0;
  bool follow = false;
  std::string file;
  bus::PlanOptions plan;
  bus::Words bus_words;
  bus::ScanOptions scan;
  bus::MonitorOptions monitor;
  Motion motion;
  DoctorOptions doctor;
  TuneWords tune;
  std::vector<std::string> about;  // the verb that help is wanted for
  std::string form;                // of the help: empty, or markdown, man, bash, zsh
  int turns = 0;
  int steps = 1;
  int code = 0;  // exit code of the verb
};

// Adds all verbs to `app`; the parsed verb acts on `words`. Both must exist until parsing has ended.
void add_words(CLI::App& app, CommandLine& words);

// Help texts of the verbs, made from the parser's own table (words.hpp).

// "lithe 0.1.0, layout 1f00..."; programs of one layout share memory.
std::string version_text();

// Help for one verb ("law", "check") or for all: as --help prints it, or as markdown, man, bash or zsh.
std::variant<std::string, control::Refusal> help_text(const CLI::App& app, const std::vector<std::string>& verb,
                                                      const std::string& form);

// The first unknown verb or option, with the nearest known one. Empty when all are known.
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
