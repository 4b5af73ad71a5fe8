// SPDX-License-Identifier: Apache-2.0
// lithe-trial ROBOT.toml: one JSON request per line on stdin, one JSON answer per line on stdout, until stdin ends.
#include <signal.h>

#include <iostream>
#include <string>

#include "spine/arena/layout.hpp"
#include "spine/core/host/files.hpp"
#include "trial/zygote.hpp"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: " << argv[0] << " ROBOT.toml   (JSON lines on stdin and stdout; see trial/README.md)\n";
    return 2;
  }
  signal(SIGPIPE, SIG_IGN);
  signal(SIGINT, SIG_IGN);  // on Ctrl-C the supervisor closes our stdin

  lithe::set_file_defaults();
  auto zygote = lithe::trial::Zygote::make(argv[1], lithe::arena::kHandedFd);
  if (!zygote) {
    std::cerr << zygote.message() << "\n";
    return 2;
  }
  if (const auto walled = zygote->wall_in(); !walled)
    std::cerr << walled.message() << "; every trial asks for a filter of its own\n";
  bool quit = false;
  for (std::string line; !quit && std::getline(std::cin, line);) {
    if (line.empty()) continue;
    const auto reply = zygote->answer(line, quit);
    std::cout << reply.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) << std::endl;
    if (!std::cout) break;
  }
  return 0;
}
