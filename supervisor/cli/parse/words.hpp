// SPDX-License-Identifier: Apache-2.0
// The one table of the command line: every verb with its arguments, options and help. It parses, and from it come
// `--help`, `lithe help`, the hint at a wrong verb, completion, the man page and docs/reference/cli.md (reference.hpp).
#pragma once

#include <CLI/CLI.hpp>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "supervisor/cli/core/act.hpp"
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

}  // namespace lithe::cli
