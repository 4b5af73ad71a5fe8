// SPDX-License-Identifier: Apache-2.0
#include "trial/verdict.hpp"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstring>

extern char** environ;

namespace lithe::trial {
namespace {

// The first "file.cpp:line" that addr2line knows for an address, looking through what was inlined; "" = none. Headers
// of the contract are not what the author wants to hear of.
std::string line_of(const std::string& object, std::uint64_t address) {
  int ends[2];
  if (object.empty() || pipe2(ends, O_CLOEXEC) != 0) return "";
  char place[32];
  std::snprintf(place, sizeof place, "0x%llx", static_cast<unsigned long long>(address));
  const std::array<const char*, 6> words = {"addr2line", "-i", "-e", object.c_str(), place, nullptr};
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, ends[1], 1);
  posix_spawn_file_actions_addopen(&actions, 2, "/dev/null", O_WRONLY, 0);
  pid_t pid = 0;
  const int failed = posix_spawnp(&pid, words[0], &actions, nullptr, const_cast<char**>(words.data()), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(ends[1]);
  std::string text;
  std::array<char, 1024> buffer;
  for (pollfd wait{ends[0], POLLIN, 0}; failed == 0 && poll(&wait, 1, 2000) > 0;) {
    const ssize_t got = read(ends[0], buffer.data(), buffer.size());
    if (got <= 0 || text.size() > 65536) break;
    text.append(buffer.data(), static_cast<std::size_t>(got));
  }
  close(ends[0]);
  if (failed == 0) {
    kill(pid, SIGKILL);
    waitpid(pid, nullptr, 0);
  }
  for (std::size_t from = 0; from < text.size();) {
    const std::size_t to = std::min(text.find('\n', from), text.size());
    const std::string line = text.substr(from, to - from);
    const std::size_t name = line.find_last_of('/') + 1, number = line.find(".cpp:");
    if (number != std::string::npos && line.find(":?") == std::string::npos) {
      return line.substr(name, line.find(' ') == std::string::npos ? std::string::npos : line.find(' ') - name);
    }
    from = to + 1;
  }
  return "";
}

std::string crash_text(const Report& report, const std::string& where) {
  const Crash& crash = report.crash;
  char words[160];
  switch (crash.signal) {
    case SIGSEGV:
      std::snprintf(words, sizeof words, "it touched memory that is not its own (SIGSEGV at 0x%llx)",
                    static_cast<unsigned long long>(crash.address));
      break;
    case SIGBUS:
      std::snprintf(words, sizeof words, "it touched memory that is not there (SIGBUS)");
      break;
    case SIGFPE:
      std::snprintf(words, sizeof words, "an integer division by zero, or one that overflows (SIGFPE)");
      break;
    case SIGILL:
    case SIGTRAP:
      std::snprintf(words, sizeof words,
                    "an instruction that ends the program: a failed check, or a function without "
                    "a return (%s)",
                    crash.signal == SIGILL ? "SIGILL" : "SIGTRAP");
      break;
    case SIGABRT:
      std::snprintf(words, sizeof words, "it aborted");
      break;
    case SIGSYS:
      std::snprintf(words, sizeof words, "it made system call %d: a law may only compute", crash.system_call);
      break;
    case SIGPROF:
      std::snprintf(
          words, sizeof words,
          "it did not come to an end in the trial's time: look for a loop without a bound, or far too much work");
      break;
    default:
      std::snprintf(words, sizeof words, "it was ended by signal %d", crash.signal);
  }
  return std::string(words) + " (" + text_of(report.doing) + (where.empty() ? "" : ", " + where) + ")";
}

bool is_report(const std::string& bytes, Report& report) {
  if (bytes.size() != sizeof report) return false;
  std::memcpy(&report, bytes.data(), sizeof report);
  return report.magic == Report::kMagic && report.section < kSections;
}

std::string death_text(const Outcome& outcome, const Limits& limits) {
  if (outcome.timed_out) {
    return "the trial did not end in " + std::to_string(limits.wall_ms) + " ms: look for a loop without a bound";
  }
  if (outcome.signal == SIGKILL) return "it used more memory or time than a trial has";
  if (outcome.signal != 0) return "it was ended by signal " + std::to_string(outcome.signal);
  return "it ended its process (exit code " + std::to_string(outcome.exit_code) + "): a law may not call exit";
}

}  // namespace

Verdict judge(const Outcome& outcome, const Limits& limits, const std::string& object, bool pc_is_absolute) {
  Verdict verdict;
  const bool whole = is_report(outcome.output, verdict.report);
  if (!whole) verdict.report = {};
  if (!outcome.started) {
    verdict.unable = true;
    verdict.reason = "this system gives the trial no process";
    return verdict;
  }
  // Broken off before it had half of the processor time it was promised: that says nothing about the law.
  verdict.starved = outcome.timed_out && outcome.cpu_ms < 0.5 * limits.cpu_ms;
  if (verdict.starved) {
    verdict.reason = "the board is too busy: the trial got " + std::to_string(static_cast<int>(outcome.cpu_ms)) +
                     " ms of the processor in " + std::to_string(static_cast<int>(outcome.wall_ms)) + " ms; try again";
    return verdict;
  }
  if (!whole) {
    verdict.reason = death_text(outcome, limits);
    return verdict;
  }
  const Report& report = verdict.report;
  if (report.crash.signal != 0) {
    verdict.where = line_of(object, report.crash.pc - (pc_is_absolute ? 0 : report.object_base));
    verdict.reason = crash_text(report, verdict.where);
  } else if (report.refused[0] != '\0') {
    verdict.unable = report.unable != 0;
    verdict.reason = text_of(report.refused);
  } else if (report.ended == 0 || outcome.signal != 0 || outcome.exit_code != 0) {
    verdict.reason = death_text(outcome, limits);
  }
  verdict.ok = verdict.reason.empty();
  return verdict;
}

}  // namespace lithe::trial
