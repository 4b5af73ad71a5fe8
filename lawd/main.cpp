// SPDX-License-Identifier: Apache-2.0
// lawd: one JSON request per line on stdin, one JSON answer per line on stdout, until stdin ends.
#include <signal.h>

#include <charconv>
#include <iostream>
#include <string>
#include <string_view>
#include <system_error>

#include "lawd/run/child.hpp"
#include "lawd/service.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"

int main(int argc, char** argv) {
  constexpr double kUsualS = lithe::lawd::Limits{}.cpu_s;
  double compile_s = kUsualS;
  const std::string_view word = argc == 2 ? argv[1] : "";
  const auto read = std::from_chars(word.data(), word.data() + word.size(), compile_s);
  const bool is_number = read.ec == std::errc() && read.ptr == word.data() + word.size();
  if (argc > 2 || (argc == 2 && !(is_number && compile_s >= 1 && compile_s <= 600))) {
    std::cerr
        << "usage: " << argv[0]
        << " [SECONDS]   (that the compiler may take, 1 to 600; JSON lines on stdin and stdout; see lawd/README.md)\n";
    return 2;
  }
  lithe::lawd::set_time_factor(compile_s / kUsualS);
  signal(SIGPIPE, SIG_IGN);
  signal(SIGINT, SIG_IGN);  // on Ctrl-C the supervisor closes our stdin

  lithe::set_file_defaults();
  lithe::lawd::Service service(lithe::cache_dir(), lithe::arena::kHandedFd);
  for (std::string line; std::getline(std::cin, line);) {
    if (line.empty()) continue;
    const auto reply = service.answer(line);
    // Invalid UTF-8 in a source must not end the service: it is replaced.
    std::cout << reply.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) << std::endl;
    if (!std::cout) break;
  }
  return 0;
}
