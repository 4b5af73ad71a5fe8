// SPDX-License-Identifier: Apache-2.0
#include "lawd/run/child.hpp"

#include <cxxabi.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <utility>

namespace lithe::lawd {
namespace {

constexpr std::size_t kMaxOutput = std::size_t{4} << 20;

void limit(__rlimit_resource resource, std::size_t amount) {
  const rlimit value{amount, amount};
  setrlimit(resource, &value);
}

double g_time_factor = 1;

// In the child.
void set_limits(const Limits& limits) {
  for (const int signal : {SIGPIPE, SIGINT, SIGTERM, SIGSEGV, SIGFPE, SIGILL, SIGBUS, SIGABRT})
    ::signal(signal, SIG_DFL);
  const int null = open("/dev/null", O_RDWR);
  for (const int fd : {0, 1, 2}) dup2(null, fd);
  limit(RLIMIT_CORE, 0);
  const auto cpu_s = static_cast<rlim_t>(limits.cpu_s);
  const rlimit cpu{cpu_s, cpu_s + 1};  // SIGXCPU comes first: it tells an endless loop from a lack of memory
  setrlimit(RLIMIT_CPU, &cpu);
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // their shadow memory needs the address space
  limit(RLIMIT_AS, limits.memory_bytes);
#endif
  limit(RLIMIT_FSIZE, limits.file_bytes);
}

}  // namespace

void set_time_factor(double factor) { g_time_factor = factor; }
double time_factor() { return g_time_factor; }

Outcome run_child(const std::function<int(int)>& body, const Limits& asked) {
  Limits limits = asked;
  limits.wall_ms = static_cast<int>(g_time_factor * asked.wall_ms);
  limits.cpu_s = std::max(1, static_cast<int>(g_time_factor * asked.cpu_s));
  const auto limited = [&](int out_fd) {
    set_limits(limits);
    return body(out_fd);
  };
  const ChildLimits ends{
      .wall_ms = limits.wall_ms, .output_bytes = kMaxOutput, .whole_group = true, .last_words = true};
  Outcome outcome{run_forked(limited, ends), false};
  outcome.starved = outcome.timed_out && outcome.cpu_ms < 0.5 * std::min(1e3 * limits.cpu_s, 1.0 * limits.wall_ms);
  if (outcome.signal == SIGXCPU) outcome.timed_out = true;
  return outcome;
}

Outcome run_program(const std::vector<std::string>& argv, const Limits& limits, int stream) {
  const auto body = [&argv, stream](int out_fd) {
    dup2(out_fd, stream);
    setenv("LC_ALL", "C", 1);  // English messages with plain quotes
    const int why = exec_program(argv);
    dprintf(2, "cannot run %s: %s\n", argv[0].c_str(), std::strerror(why));
    return 127;
  };
  return run_child(body, limits);
}

std::string starved_text(const std::string& who, const Outcome& outcome) {
  return "the machine is too busy: " + who + " got " + std::to_string(static_cast<int>(outcome.cpu_ms)) +
         " ms of the processor in " + std::to_string(static_cast<int>(outcome.wall_ms)) + " ms";
}

std::string readable(std::string_view symbol) {
  if (!symbol.starts_with("_Z")) return std::string(symbol);  // "f" alone would be read as the type float
  int status = 0;
  char* text = abi::__cxa_demangle(std::string(symbol).c_str(), nullptr, nullptr, &status);
  std::string name = status == 0 ? text : std::string(symbol);
  std::free(text);
  return name;
}

std::string signal_text(int signal) {
  constexpr std::pair<int, const char*> kTexts[] = {
      {SIGSEGV, "SIGSEGV (invalid memory access)"},     {SIGFPE, "SIGFPE (integer division by zero or overflow)"},
      {SIGILL, "SIGILL (illegal instruction)"},         {SIGBUS, "SIGBUS (misaligned or missing memory)"},
      {SIGABRT, "SIGABRT (abort or failed assertion)"}, {SIGKILL, "SIGKILL (killed, or out of memory)"}};
  for (const auto& [number, text] : kTexts)
    if (number == signal) return text;
  return "signal " + std::to_string(signal) + " (" + strsignal(signal) + ")";
}

}  // namespace lithe::lawd
