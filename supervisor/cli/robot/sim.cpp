// SPDX-License-Identifier: Apache-2.0
// `lithe sim`: starts the program lithe-sim.
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/core/talk.hpp"
#include "supervisor/core/process.hpp"

namespace lithe::cli {

[[noreturn]] void simulate(const std::vector<std::string>& words) {
  const std::string program = control::program_dir() + "/lithe-sim";
  std::vector<char*> argv{const_cast<char*>(program.c_str())};
  for (const std::string& word : words) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  ::execv(program.c_str(), argv.data());
  throw Refusal{"no_program", "cannot start " + program + ": " + std::strerror(errno), "build it: make release"};
}

}  // namespace lithe::cli
