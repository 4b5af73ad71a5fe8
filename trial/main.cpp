// SPDX-License-Identifier: Apache-2.0
// lithe-trial ROBOT.toml [--steps]: one JSON request per line on stdin, one JSON answer per line on stdout, until stdin
// ends. --steps: episodes for programs that learn, instead of trials.
#include <signal.h>

#include <iostream>
#include <string>
#include <string_view>

#include "spine/arena/layout.hpp"
#include "spine/core/host/files.hpp"
#include "trial/steps.hpp"
#include "trial/zygote.hpp"

namespace {

using lithe::trial::Steps;
using lithe::trial::Zygote;

template <class Service>
int serve(Service& service) {
  for (std::string line; std::getline(std::cin, line);) {
    if (line.empty()) continue;
    const auto reply = service.answer(line);
    std::cout << reply.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) << std::endl;
    if (!std::cout) break;
  }
  return 0;
}

int fail(const std::string& why) {
  std::cerr << why << "\n";
  return 2;
}

}  // namespace

int main(int argc, char** argv) {
  const bool steps = argc == 3 && std::string_view(argv[2]) == "--steps";
  if (argc != 2 && !steps) {
    std::cerr << "usage: " << argv[0] << " ROBOT.toml [--steps]   (JSON lines on stdin and stdout; trial/README.md)\n";
    return 2;
  }
  signal(SIGPIPE, SIG_IGN);
  signal(SIGINT, SIG_IGN);  // on Ctrl-C the program that asks closes our stdin
  lithe::set_file_defaults();
  if (steps) {
    std::ios::sync_with_stdio(false);
    auto made = Steps::make(argv[1]);
    return made ? serve(**made) : fail(made.message());
  }
  auto zygote = Zygote::make(argv[1], lithe::arena::kHandedFd);
  if (!zygote) return fail(zygote.message());
  if (const auto filtered = zygote->install_filter(); !filtered)
    std::cerr << filtered.message() << "; every trial asks for a filter of its own\n";
  return serve(*zygote);
}
