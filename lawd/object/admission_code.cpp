// SPDX-License-Identifier: Apache-2.0
#include "lawd/object/admission_lines.hpp"

#include <unistd.h>

#include <array>
#include <charconv>
#include <string>

#include "lawd/run/child.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::lawd {
namespace {

constexpr const char* kGate = "instructions";
constexpr int kListingMs = 20'000;  // long, because lawd has idle priority

struct Rule {
  std::string_view mnemonic;
  bool prefix;  // and everything that begins like it
  std::string_view why;
};
constexpr std::string_view kKernel = "it enters the kernel";
constexpr std::string_view kPrivileged = "it is for the kernel only";
constexpr std::string_view kContainment = "it changes what protects the Spine from the law";
constexpr std::string_view kRandom = "it gives another answer each time: the same input must give the same output";
constexpr std::string_view kRounding = "it changes how everybody's floating point rounds or traps";
constexpr std::array kRules = std::to_array<Rule>({
#if defined(__x86_64__)
    {"syscall", false, kKernel},      {"sysenter", false, kKernel},
    {"sysexit", true, kPrivileged},   {"sysret", true, kPrivileged},
    {"int", false, kKernel},          {"into", false, kKernel},
    {"int1", false, kKernel},         {"icebp", false, kKernel},
    {"wrpkru", false, kContainment},  {"xrstor", true, kContainment},
    {"wrfsbase", true, kContainment}, {"wrgsbase", true, kContainment},
    {"lfs", false, kContainment},     {"lgs", false, kContainment},
    {"hlt", false, kPrivileged},      {"in", false, kPrivileged},
    {"out", false, kPrivileged},      {"ins", true, kPrivileged},
    {"outs", true, kPrivileged},      {"cli", false, kPrivileged},
    {"sti", false, kPrivileged},      {"rdtsc", true, kRandom},
    {"rdrand", true, kRandom},        {"rdseed", true, kRandom},
    {"rdpmc", false, kRandom},        {"ldmxcsr", false, kRounding},
    {"vldmxcsr", false, kRounding},   {"fldenv", false, kRounding},
    {"frstor", true, kRounding},      {"xbegin", true, kContainment},
    {"enclu", false, kContainment},   {"(bad)", false, "it is no instruction"},
#else
    {"svc", false, kKernel},
    {"hvc", false, kKernel},
    {"smc", false, kKernel},
    {"msr", false, kContainment},
    {"mrs", false, kRandom},  // of a counter, or a random number; a compiler reads no register this way by itself
    {"hlt", false, kPrivileged},
    {"eret", true, kPrivileged},
    {"dcps", true, kPrivileged},
    {"tlbi", true, kPrivileged},
    {"wfe", false, "it waits"},
    {"wfi", false, "it waits"},
    {"udf", false, "it is no instruction"},
#endif
});

// insert, insertps and insb all begin with "ins"; only the string forms (insb ...) access a port.
bool is_vector(std::string_view mnemonic) { return mnemonic.starts_with("insert"); }

// " 4f:\tsyscall" -> 0x4f, "syscall". False for all other lines. Prefixes written as words are skipped.
bool read_instruction(std::string_view line, std::uint64_t& offset, std::string_view& mnemonic) {
  while (!line.empty() && line.front() == ' ') line.remove_prefix(1);
  const auto [end, error] = std::from_chars(line.data(), line.data() + line.size(), offset, 16);
  line.remove_prefix(static_cast<std::size_t>(end - line.data()));
  if (error != std::errc{} || !line.starts_with(":\t")) return false;
  line.remove_prefix(2);
  for (;;) {
    const std::size_t size = std::min(line.find_first_of(" \t"), line.size());
    mnemonic = line.substr(0, size);
    const bool prefix = mnemonic == "rep" || mnemonic == "repz" || mnemonic == "repnz" || mnemonic == "lock" ||
                        mnemonic == "notrack" || mnemonic == "bnd" || mnemonic == "data16" || mnemonic == "cs" ||
                        mnemonic == "ds" || mnemonic == "es" || mnemonic == "ss" || mnemonic == "fs" ||
                        mnemonic == "gs" || mnemonic.starts_with("rex");
    if (!prefix || size >= line.size()) return true;
    line.remove_prefix(size + 1);
  }
}

// x86: fs leads to a thread's own variables. The last operand is the one that is written, but for push.
bool writes_segment(std::string_view line, std::string_view mnemonic) {
  return (line.ends_with("%fs") || line.ends_with("%gs")) && !mnemonic.starts_with("push");
}

std::size_t scan(std::string_view listing, const SourceLines& lines, Admission& out) {
  constexpr std::string_view kSection = "Disassembly of section ";
  std::string section;
  std::size_t count = 0;
  for (const std::string_view line : lines_in(listing)) {
    if (line.starts_with(kSection)) {
      section = line.substr(kSection.size());
      if (section.ends_with(':')) section.pop_back();
      continue;
    }
    std::uint64_t offset = 0;
    std::string_view mnemonic;
    if (!read_instruction(line, offset, mnemonic)) continue;
    ++count;
    const std::string_view why = writes_segment(line, mnemonic) ? kContainment : why_instruction_is_refused(mnemonic);
    if (why.empty() || out.findings.size() >= Admission::kMaxFindings) continue;
    out.refuse(kGate,
               "the law contains the instruction " + std::string(mnemonic) + ": " + std::string(why) +
                   "; write plain C++, without assembly and built-in functions of the compiler",
               lines.of(section, offset));
  }
  return count;
}

// "" when the listing is complete, else the error.
std::string why_not_listed(const Outcome& listed) {
  if (listed.clean()) return "";
  if (listed.exit_code == 127) return "objdump cannot be run (apt install binutils)";
  if (listed.timed_out) return "objdump had no time to list the law's instructions";
  return "objdump failed to list the law's instructions";
}

}  // namespace

std::string_view why_instruction_is_refused(std::string_view mnemonic) {
  for (const Rule& rule : kRules)
    if (mnemonic == rule.mnemonic || (rule.prefix && mnemonic.starts_with(rule.mnemonic) && !is_vector(mnemonic)))
      return rule.why;
  return "";
}

void check_code(const Compiled& compiled, const SourceLines& lines, Admission& out) {
  out.apply(kGate, [&]() -> std::string {
    const Outcome listed =
        run_program({"objdump", "-d", "--no-show-raw-insn", compiled.object_path}, Limits{kListingMs}, STDOUT_FILENO);
    if (listed.cut) {
      out.refuse(kGate, "the list of the law's instructions is longer than 4 MiB: shorten the law, or its names");
      return "0 instructions";
    }
    if (const std::string why = why_not_listed(listed); !why.empty()) return out.not_applied = why;
    const std::size_t count = scan(listed.output, lines, out);
    if (count == 0) return out.not_applied = "objdump names no instruction";
    return std::to_string(count) + " instructions";
  });
}

}  // namespace lithe::lawd
