// SPDX-License-Identifier: Apache-2.0
// `lithe agent`, `mcp`, `evolve`, `identify`, `incident plot`: modules of the Python package; `lithe sim`: lithe-sim.
#include <fcntl.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>

#include "spine/core/host/child.hpp"
#include "spine/core/host/paths.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/core/talk.hpp"

namespace lithe::cli {
namespace {

// Whether this interpreter is there and has the package.
bool has_package(const std::string& python) {
  constexpr const char* kLook = "import importlib.util as u; raise SystemExit(u.find_spec('lithe') is None)";
  const auto look = [&python](int) {
    const int null = ::open("/dev/null", O_RDWR);
    for (const int fd : {0, 1, 2}) ::dup2(null, fd);
    return exec_program({python, "-c", kLook});
  };
  const ChildEnd end = run_forked(look, {.wall_ms = 60'000, .output_bytes = 0});
  return end.started && end.signal == 0 && end.exit_code == 0;
}

}  // namespace

[[noreturn]] void run_module(const std::string& module, const std::vector<std::string>& words) {
  const std::string venv = std::filesystem::path(program_dir() + "/../../../.venv").lexically_normal();
  for (const std::string& python : {venv + "/bin/python", std::string("python3")}) {
    if (!has_package(python)) continue;
    std::vector<std::string> all{python, "-m", module};
    all.insert(all.end(), words.begin(), words.end());
    (void)exec_program(all);
  }
  throw Refusal{"no_python", module + " needs a Python with the package lithe: neither " + venv + " nor python3 has it",
                "make it: tools/setup; or activate the environment that has it"};
}

[[noreturn]] void simulate(const std::vector<std::string>& words) {
  const std::string program = program_dir() + "/lithe-sim";
  std::vector<std::string> argv = words;
  argv.insert(argv.begin(), program);
  const int why = exec_program(argv);
  throw Refusal{"no_program", "cannot start " + program + ": " + std::strerror(why), "build it: make release"};
}

}  // namespace lithe::cli
