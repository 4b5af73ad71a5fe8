// SPDX-License-Identifier: Apache-2.0
// lawd: one JSON request per line on stdin, one JSON answer per line on stdout, until stdin ends.
#include <signal.h>

#include <iostream>
#include <string>

#include "lawd/service.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"

int main(int argc, char** argv) {
  if (argc > 1) {
    std::cerr << "usage: " << argv[0] << "   (no arguments: JSON lines on stdin and stdout; see lawd/README.md)\n";
    return 2;
  }
  signal(SIGPIPE, SIG_IGN);
  signal(SIGINT, SIG_IGN);  // on Ctrl-C the supervisor closes our stdin

  lithe::set_file_defaults();
  lithe::lawd::Service service(lithe::cache_dir(), lithe::arena::kHandedFd);
  bool quit = false;
  for (std::string line; !quit && std::getline(std::cin, line);) {
    if (line.empty()) continue;
    const auto reply = service.answer(line, quit);
    // Invalid UTF-8 in a source must not end the service: it is replaced.
    std::cout << reply.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) << std::endl;
    if (!std::cout) break;
  }
  return 0;
}
