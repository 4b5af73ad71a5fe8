// SPDX-License-Identifier: Apache-2.0
#include "trial/verdict.hpp"

#include <signal.h>

#include <cstdio>
#include <cstring>

namespace lithe::trial {
namespace {

std::string crash_text(const Report& report, const Limits& limits) {
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
      std::snprintf(words, sizeof words,
                    "it did not come to an end in the trial's %d ms of the processor: look for a loop without a bound, "
                    "or far too "
                    "much work",
                    limits.cpu_ms);
      break;
    default:
      std::snprintf(words, sizeof words, "it was ended by signal %d", crash.signal);
  }
  return std::string(words) + " (" + text_of(report.doing) + ")";
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
  if (outcome.signal == SIGKILL) {
    return "it used more than a trial has: " + std::to_string(limits.memory_bytes >> 20) + " MiB of memory, " +
           std::to_string(limits.cpu_ms) + " ms of the processor";
  }
  if (outcome.signal != 0) return "it was ended by signal " + std::to_string(outcome.signal);
  return "it ended its process (exit code " + std::to_string(outcome.exit_code) + "): a law may not call exit";
}

}  // namespace

Verdict judge(const Outcome& outcome, const Limits& limits) {
  Verdict verdict;
  const bool whole = is_report(outcome.output, verdict.report);
  if (!whole) verdict.report = {};
  if (!outcome.started) {
    verdict.unable = true;
    verdict.reason = "this system gives the trial no process";
    return verdict;
  }
  // Stopped before it got half of its processor time: no evidence against the law.
  verdict.starved = outcome.timed_out && outcome.cpu_ms < 0.5 * limits.cpu_ms;
  if (verdict.starved) {
    verdict.reason = "the board is too busy: the trial got " + std::to_string(static_cast<int>(outcome.cpu_ms)) +
                     " ms of the processor in " + std::to_string(static_cast<int>(outcome.wall_ms)) + " ms; try again";
    return verdict;
  }
  if (!whole) {
    verdict.out_of_time = outcome.timed_out;
    verdict.reason = death_text(outcome, limits);
    return verdict;
  }
  const Report& report = verdict.report;
  if (report.crash.signal != 0) {
    if (report.crash.pc > report.image_base) verdict.pc_offset = report.crash.pc - report.image_base;
    verdict.out_of_time = report.crash.signal == SIGPROF;
    verdict.reason = crash_text(report, limits);
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
