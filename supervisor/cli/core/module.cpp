// SPDX-License-Identifier: Apache-2.0
// `lithe agent`, `mcp`, `evolve`, `identify`, `incident plot`: modules of the Python package.
#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>

#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/core/talk.hpp"
#include "supervisor/core/process.hpp"

namespace lithe::cli {
namespace {

// Whether this interpreter is there and has the package.
bool has_package(const std::string& python) {
  constexpr const char* kLook = "import importlib.util as u; raise SystemExit(u.find_spec('lithe') is None)";
  const pid_t child = ::fork();
  if (child == 0) {
    const int null = ::open("/dev/null", O_RDWR);
    for (const int fd : {0, 1, 2}) ::dup2(null, fd);
    ::execlp(python.c_str(), python.c_str(), "-c", kLook, nullptr);
    ::_exit(127);
  }
  int status = 0;
  return child > 0 && ::waitpid(child, &status, 0) == child && status == 0;
}

}  // namespace

[[noreturn]] void run_module(const std::string& module, const std::vector<std::string>& words) {
  const std::string venv = std::filesystem::path(control::program_dir() + "/../../../.venv").lexically_normal();
  for (const std::string& python : {venv + "/bin/python", std::string("python3")}) {
    if (!has_package(python)) continue;
    std::vector<std::string> all{python, "-m", module};
    all.insert(all.end(), words.begin(), words.end());
    std::vector<char*> argv;
    for (std::string& word : all) argv.push_back(word.data());
    argv.push_back(nullptr);
    ::execvp(argv[0], argv.data());
  }
  throw Refusal{"no_python", module + " needs a Python with the package lithe: neither " + venv + " nor python3 has it",
                "make it: tools/setup; or activate the environment that has it"};
}

}  // namespace lithe::cli
