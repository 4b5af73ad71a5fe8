// SPDX-License-Identifier: Apache-2.0
#include "trial/verdict.hpp"

#include <fmt/format.h>
#include <signal.h>

#include <algorithm>
#include <cstring>
#include <ranges>

namespace lithe::trial {
namespace {

std::string crash_cause(const Crash& crash, const Limits& limits) {
  if (crash.signal == SIGSEGV)
    return fmt::format("it touched memory that is not its own (SIGSEGV at {:#x})", crash.address);
  if (crash.signal == SIGBUS) return "it touched memory that is not there (SIGBUS)";
  if (crash.signal == SIGFPE) return "an integer division by zero, or one that overflows (SIGFPE)";
  if (crash.signal == SIGILL || crash.signal == SIGTRAP) {
    return fmt::format("an instruction that ends the program: a failed check, or a function without a return ({})",
                       crash.signal == SIGILL ? "SIGILL" : "SIGTRAP");
  }
  if (crash.signal == SIGABRT) return "it aborted";
  if (crash.signal == SIGSYS) return fmt::format("it made system call {}: a law may only compute", crash.system_call);
  if (crash.signal != SIGPROF) return fmt::format("it was ended by signal {}", crash.signal);
  return fmt::format(
      "it did not come to an end in the trial's {} ms of the processor: look for a loop without a bound, "
      "or far too much work",
      limits.cpu_ms);
}

bool is_report(const std::string& bytes, Report& report) {
  if (bytes.size() != sizeof report) return false;
  std::memcpy(&report, bytes.data(), sizeof report);
  return report.magic == Report::kMagic && report.section < kSections;
}

std::string death_text(const Outcome& outcome, const Limits& limits) {
  if (outcome.timed_out)
    return fmt::format("the trial did not end in {} ms: look for a loop without a bound", limits.wall_ms);
  if (outcome.signal == SIGKILL) {
    return fmt::format("it used more than a trial has: {} MiB of memory, {} ms of the processor",
                       limits.memory_bytes >> 20, limits.cpu_ms);
  }
  if (outcome.signal != 0) return "it was ended by signal " + std::to_string(outcome.signal);
  return "it ended its process (exit code " + std::to_string(outcome.exit_code) + "): a law may not call exit";
}

}  // namespace

Verdict verdict_of(const Outcome& outcome, const Limits& limits) {
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
    verdict.reason =
        fmt::format("the board is too busy: the trial got {:.0f} ms of the processor in {:.0f} ms; try again",
                    outcome.cpu_ms, outcome.wall_ms);
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
    verdict.reason = fmt::format("{} ({})", crash_cause(report.crash, limits), text_of(report.doing));
  } else if (report.refused[0] != '\0') {
    verdict.unable = report.unable != 0;
    verdict.reason = text_of(report.refused);
    if (report.invalid_pc > report.image_base) verdict.pc_offset = report.invalid_pc - report.image_base;
  } else if (report.ended == 0 || outcome.signal != 0 || outcome.exit_code != 0) {
    verdict.reason = death_text(outcome, limits);
  } else if (!std::ranges::all_of(report.progress | std::views::drop(1), &Progress::done)) {
    verdict.reason = "the trial ended before all of its parts were done, and did not say why";
  }
  verdict.ok = verdict.reason.empty();
  return verdict;
}

}  // namespace lithe::trial
