// SPDX-License-Identifier: Apache-2.0
#include "lawd/core/admission.hpp"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstdlib>
#include <filesystem>
#include <random>

#include "lawd/object/admission_elf.hpp"
#include "lawd/object/admission_lines.hpp"
#include "lawd/run/dry_run.hpp"
#include "lawd/run/files.hpp"
#include "lawd/source/admission_tokens.hpp"
#include "lawd/source/admission_words.hpp"
#include "lawd/test/lawd_rig.hpp"
#include "spine/core/host/files.hpp"

namespace lithe::lawd {
namespace {

Admission source(const std::string& text) {
  Admission admission;
  admit_source(text, admission);
  return admission;
}

// The gate that refuses first, and where: "words:2"; "" = admitted.
std::string verdict(const Admission& admission) {
  if (admission.ok()) return "";
  return admission.findings[0].gate + ":" + std::to_string(admission.findings[0].line);
}

TEST(AdmissionSource, GoodLawPassesEveryGate) {
  const Admission admission = source("\xEF\xBB\xBF#include <lithe/law.hpp> // don't\n#include <cmath>\n" +
                                     LawText{.body = "const int n = 1'000; // a 'quote\n"
                                                     "if (n > 3) [[likely]] s.sum_rad = n; char c = '\\''; (void)c;"}
                                         .source());
  EXPECT_EQ(verdict(admission), "");
  EXPECT_EQ(admission.gates.size(), 5u);
}

TEST(AdmissionSource, EveryWayToIncludeSomethingElseIsRefused) {
  for (const char* text :
       {"\n#include <thread>", "\n#include \"/etc/passwd\"", "\n # /* x */ include <unistd.h>", "\n%:include <vector>",
        "\n#inc\\\nlude <vector>", "\n#define H <vector>\n#include H", "\n#include_next <cmath>", "\n#import <cmath>",
        "\n#include <lithe/../../secret.hpp>", "\n#include <Eigen/../../../etc/passwd>",
        "\n#if 0\n#include <new>\n#endif", "\n/*\n*/ #include <new>"}) {
    EXPECT_EQ(verdict(source(text)).substr(0, 9), "includes:") << text;
  }
  EXPECT_EQ(verdict(source("\n\n#include <thread>\n")), "includes:3");
}

TEST(AdmissionSource, WordsThatReachOutOfALawAreRefusedWhereverTheyHide) {
  for (const char* text : {"\nasm(\"nop\");", "\nas\\\nm(\"nop\");", "\n#define A asm\nA(\"nop\");",
                           "\n__asm__(\"nop\");", "\nextern int x;", "\nvoid f() { throw 1; }", "\nint* p = new int;",
                           "\nthread_local int x;", "\nstruct A { virtual void f(); };",
                           "\n_Pragma(\"GCC optimize(0)\")", "\n__attribute__((constructor)) void f();",
                           "\nint a = __builtin_trap();", "\nauto x = reinterpret_cast<long>(p);",
                           "\nnamespace std { }", "\nnamespace lithe { }", "\nlithe::contract::step<L>;",
                           "\nint __CONCAT(as,m);", "\nvoid f() { goto *p; }", "\n#define F __FILE_NAME__"}) {
    EXPECT_EQ(verdict(source(text)).substr(0, 6), "words:") << text;
  }
  EXPECT_EQ(verdict(source("struct A { A() = delete; };")), "");
}

TEST(AdmissionSource, PreprocessorAndAttributeTricksAreRefused) {
  for (const char* text : {"#pragma GCC optimize(\"O0\")", "#pragma GCC poison x", "#line 7 \"x\"", "# 7 \"x\"",
                           "#define A(x, y) x##y", "#define A(x, y) x%:%:y", "#define int long", "#undef LITHE_LAW",
                           "#define private public", "#ident \"x\"", "#warning x"}) {
    EXPECT_EQ(verdict(source(text)).substr(0, 13), "preprocessor:") << text;
  }
  for (const char* text : {"[[gnu::constructor]] void f();", "[ [ gnu :: section(\"x\") ] ] int x;",
                           "[[using gnu: constructor]] void f();", "<:<:gnu::ifunc(\"x\"):>:> void f();",
                           "[[clang::optnone]] void f();", "[[gnu::target(\"avx\")]] void f();"}) {
    EXPECT_EQ(verdict(source(text)).substr(0, 11), "attributes:") << text;
  }
  EXPECT_EQ(verdict(source("#pragma once\n#pragma GCC unroll 4\n[[gnu::always_inline, nodiscard]] int f();")), "");
}

TEST(AdmissionSource, TextThatTwoReadersUnderstandDifferentlyIsRefused) {
  using namespace std::string_literals;
  for (const std::string& text : {"int a;\0"s, "/* no end"s, "char* c = \"no end\n;"s, "int b = 'x\n;"s, "R\"(raw)\""s,
                                  "int \xE2\x80\xAE x;"s, "?\?=include <new>"s, "int \\u0061;"s, "int a;\rint b;"s}) {
    EXPECT_EQ(verdict(source(text)), "text:1") << text;
  }
  EXPECT_EQ(verdict(source(std::string(300 << 10, ' '))), "text:0");
}

TEST(AdmissionSource, AFileThatIsNoTextIsToldSoOnce) {
  std::string utf16 = "\xFF\xFE";
  for (const char c : std::string("// a law\nstruct A {};\n")) utf16.append({c, '\0'});
  const std::string png("\x89PNG\r\n\x1A\n\0\0\0\rIHDR\n\0\0", 20);
  for (const std::string& text : {utf16, png}) {
    const Admission refused = source(text);
    ASSERT_EQ(refused.findings.size(), 1u) << text;
    EXPECT_NE(refused.findings[0].message.find("saved as UTF-8"), std::string::npos) << refused.findings[0].message;
  }
}

TEST(AdmissionSource, BracketsAreNestedToABound) {
  const auto nested = [](std::size_t depth, const std::string& open, const std::string& close) {
    std::string text = "int x = ";
    for (std::size_t i = 0; i < depth; ++i) text += open;
    text += "1";
    for (std::size_t i = 0; i < depth; ++i) text += close;
    const Admission said = source(text + ";\n");
    return std::ranges::any_of(said.findings, [](const auto& finding) {
      return finding.message.find("nested more than 256 deep") != std::string::npos && finding.line == 1;
    });
  };
  for (const auto& [open, close] : {std::pair("(", ")"), {"{", "}"}, {"[", "]"}, {"((", ")"}}) {
    EXPECT_FALSE(nested(100, open, close)) << open;
    EXPECT_TRUE(nested(60'000, open, close)) << open;
  }
  EXPECT_FALSE(nested(256, "(", ")"));
  EXPECT_TRUE(nested(257, "(", ")"));
}

TEST(AdmissionSource, AnyBytesAreSafe) {
  std::mt19937 random(7);
  using namespace std::string_literals;
  const std::string alphabet = "#%:<>[]\\\n\"'/*?R(u8)Lx0.e+ \r\t\0\xE2\x80\xAAincludeasm"s;
  for (int i = 0; i < 3000; ++i) {
    std::string text(random() % 60, ' ');
    for (char& c : text) c = alphabet[random() % alphabet.size()];
    EXPECT_GE(source(text).gates.size(), 1u);
  }
}

class AdmissionObject : public ::testing::Test {
 protected:
  // Compiles past the rules on the source, and asks those on the object.
  Admission object(const std::string& text, const std::string& flag = "-O2") {
    const std::string file = scratch_.path() + "/law.cpp", made = scratch_.path() + "/law.o";
    EXPECT_EQ(write_file_whole(file, text), "");
    auto command = toolchain_.compile_command(file, made);
    command.push_back(flag);
    const Outcome outcome = run_program(command, Limits{});
    EXPECT_TRUE(outcome.clean()) << outcome.output;
    Admission admission;
    admit_object({made, file}, admission);
    return admission;
  }

  TestCache cache_;
  Toolchain toolchain_{find_contract_dir(), cache_.path()};
  ScratchDir scratch_{cache_.path()};
};

TEST_F(AdmissionObject, GoodLawPassesAndItsNumbersAreKept) {
  const Admission admission =
      object(LawText{.body = "u.torque_nm[0] = std::sin(t.position_rad[0]) + s.sum_rad;"}.source());
  EXPECT_EQ(verdict(admission), "");
  ASSERT_EQ(admission.gates.size(), 8u);
  EXPECT_EQ(admission.gates[1].detail, "1 names used");
  EXPECT_NE(admission.gates[6].detail, "unknown: the compiler wrote no call graph");
}

TEST_F(AdmissionObject, LibrarySortIsNoUnboundedRecursion) {
  EXPECT_EQ(verdict(object(LawText{.body = "std::array<double, 32> a = t.position_rad; std::sort(a.begin(), a.end());\n"
                                           "u.torque_nm[0] = a[3];"}
                               .source())),
            "");
}

TEST_F(AdmissionObject, MemoryOutsideStateIsNamedWithItsLine) {
  const Admission admission = object(LawText{.body = "static int counted; u.torque_nm[0] = ++counted;"}.source());
  EXPECT_EQ(verdict(admission), "memory:6");
  EXPECT_NE(admission.findings[0].message.find("counted"), std::string::npos);
  EXPECT_EQ(verdict(object("double table[3] = {1, 2, 3};\n" + LawText{.body = "table[1] += 1;"}.source())), "memory:1");
}

TEST_F(AdmissionObject, CodeAtLoadingAndThreadMemoryAreRefused) {
  EXPECT_EQ(verdict(object("__attribute__((constructor)) void early() { __builtin_trap(); }\n" + LawText{}.source())),
            "memory:0");
  EXPECT_EQ(verdict(object("thread_local int counted;\n" + LawText{.body = "u.torque_nm[0] = ++counted;"}.source())),
            "memory:1");
  EXPECT_EQ(verdict(object("__attribute__((section(\"odd\"))) const int x[3] = {3, 1, 2};\n" +
                           LawText{.body = "u.torque_nm[0] = x[t.tick % 3];"}.source())),
            "memory:0");
}

TEST_F(AdmissionObject, ForeignFunctionIsNamedAtTheLineThatCallsIt) {
  const Admission admission =
      object(LawText{.body = "\n\n  double* v = new double[t.joints]; v[0] = t.t_s; u.torque_nm[0] = v[t.joints / 2];"}
                 .source());
  EXPECT_EQ(verdict(admission), "calls:8");
  ASSERT_FALSE(admission.ok());
  EXPECT_NE(admission.findings[0].message.find("operator new"), std::string::npos);
  EXPECT_EQ(verdict(object(LawText{.body = "std::array<double, 3> a{};\n u.torque_nm[0] = a.at(t.joints);"}.source())),
            "calls:7");
}

TEST_F(AdmissionObject, StackWithoutABoundIsRefused) {
  const std::string down =
      "double down(const lithe::Tick& t, int n) { return n < 1 ? 0 : t.sensor[n % 16] * down(t, n - 1) + down(t, n - "
      "2); }\n";
  std::string recursive = LawText{.body = "u.torque_nm[0] = down(t, int(t.tick));"}.source();
  recursive.insert(recursive.find("struct Law"), down);
  EXPECT_EQ(verdict(object(recursive)), "stack:2");
  // g++ splits this one: what calls itself is a part of it, of which the compiler gives no readable name.
  std::string member = LawText{.body = "u.torque_nm[0] = fact(int(t.tick % 5));"}.source();
  member.insert(member.find("  static void"), "  static double fact(int n) { return n < 2 ? 1 : n * fact(n - 1); }\n");
  const Admission named = object(member);
  EXPECT_EQ(verdict(named), "stack:5");
  ASSERT_FALSE(named.ok());
  EXPECT_EQ(named.findings[0].message.find("Law::fact(int) calls itself"), 0u) << named.findings[0].message;
  EXPECT_EQ(verdict(object(LawText{.body = "volatile double a[9000]; a[t.tick % 9000] = 1;"}.source())).substr(0, 6),
            "stack:");
  EXPECT_EQ(verdict(object(LawText{.body = "volatile double a[t.joints]; a[t.joints - 1] = 1;"}.source())).substr(0, 6),
            "stack:");
  EXPECT_EQ(
      verdict(object(LawText{.body = "double (*volatile f)(double) = std::sin; u.torque_nm[0] = f(1);"}.source())),
      "stack:6");
}

TEST_F(AdmissionObject, DangerousInstructionIsFoundWithItsLine) {
#if defined(__x86_64__)
  EXPECT_EQ(verdict(object(LawText{.body = "\nasm volatile(\"syscall\");"}.source())), "instructions:7");
  for (const char* text : {"wrpkru", "mov %eax, %fs", "pop %fs", "mov %eax, %gs", "lfs (%rsp), %eax", "wrfsbase %rax"})
    EXPECT_EQ(verdict(object(LawText{.body = std::string("asm volatile(\"") + text + "\");"}.source())),
              "instructions:6")
        << text;
  EXPECT_EQ(verdict(object(LawText{.body = "asm volatile(\"mov %%fs, %%eax\" : : : \"eax\");"}.source())), "");
#else
  EXPECT_EQ(verdict(object(LawText{.body = "\nasm volatile(\"svc #0\");"}.source())), "instructions:7");
  EXPECT_EQ(verdict(object(LawText{.body = "asm volatile(\"mrs x0, cntvct_el0\");"}.source())), "instructions:6");
#endif
}

TEST_F(AdmissionObject, WrongDescriptorAndTooMuchOfEverythingAreRefused) {
  EXPECT_EQ(verdict(object("int f() { return 1; }")), "descriptor:1");
  EXPECT_EQ(
      verdict(object("#include <lithe/law.hpp>\nextern \"C\" __attribute__((visibility(\"default\"))) const LitheLaw "
                     "lithe_law = {};\n")),
      "descriptor:0");
  EXPECT_EQ(
      verdict(object("const double table[20000] = {1};\n" +
                     LawText{.body = "u.torque_nm[0] = ((const volatile double*)table)[t.tick % 20000];"}.source())),
      "size:0");
}

// Programs of that name, first in the PATH.
class FakeProgram {
 public:
  FakeProgram(const std::string& folder, const std::string& name, const std::string& script)
      : before_(getenv("PATH")), file_(folder + "/" + name) {
    EXPECT_EQ(write_file_whole(file_, "#!/bin/sh\n" + script), "");
    EXPECT_EQ(chmod(file_.c_str(), 0700), 0);
    setenv("PATH", (folder + ":" + before_).c_str(), 1);
  }
  ~FakeProgram() {
    setenv("PATH", before_.c_str(), 1);
    std::filesystem::remove(file_);
  }

 private:
  std::string before_, file_;
};

TEST_F(AdmissionObject, GateThatCannotBeAppliedAdmitsNothing) {
  for (const char* script : {"exit 1", "exit 127", "echo ' 0:'; kill -9 $$", "echo 'file format: unknown'"}) {
    const FakeProgram objdump(scratch_.path(), "objdump", script);
    const Admission admission = object(LawText{}.source());
    EXPECT_FALSE(admission.ok()) << script;
    EXPECT_TRUE(admission.findings.empty()) << "nothing is known against the law: " << script;
    EXPECT_FALSE(admission.gates.back().ok) << script;
  }
  EXPECT_TRUE(object(LawText{}.source()).ok());
  std::filesystem::remove(scratch_.path() + "/law.ci");
  Admission without_graph;
  admit_object({scratch_.path() + "/law.o", scratch_.path() + "/law.cpp"}, without_graph);
  EXPECT_FALSE(without_graph.ok());
  EXPECT_NE(without_graph.not_applied.find("call graph"), std::string::npos);
}

TEST_F(AdmissionObject, InstructionsBeyondTheEndOfTheListingAreNotAdmitted) {
  const FakeProgram objdump(scratch_.path(), "objdump", "head -c 5000000 /dev/zero | tr '\\0' '\\n'; exit 0");
  EXPECT_EQ(verdict(object(LawText{}.source())), "instructions:0");
}

TEST_F(AdmissionObject, DamagedObjectNeverCrashesTheReader) {
  object(LawText{}.source());
  const std::string good = *read_file(scratch_.path() + "/law.o");
  std::mt19937 random(11);
  for (int i = 0; i < 4000; ++i) {
    std::string bad = good.substr(0, i % 3 == 0 ? random() % good.size() : good.size());
    for (int k = 0; k < 4 && !bad.empty(); ++k) bad[random() % bad.size()] = static_cast<char>(random());
    std::string why;
    const auto elf = ElfObject::parse(bad, why);
    EXPECT_NE(elf.has_value(), !why.empty());
  }
}

TEST(AdmissionWords, AdviceFitsTheFunction) {
  EXPECT_TRUE(is_allowed_symbol("sin"));
  EXPECT_FALSE(is_allowed_symbol("abort"));
  EXPECT_NE(why_symbol_is_refused("malloc", "malloc").find("allocates nothing"), std::string::npos);
  EXPECT_NE(why_symbol_is_refused("printf", "printf").find("Probes"), std::string::npos);
  EXPECT_NE(why_symbol_is_refused("sinl", "sinl").find("long double"), std::string::npos);
}

TEST(AdmissionCode, VectorInsertIsNoPortInput) {
#if defined(__x86_64__)
  EXPECT_TRUE(why_instruction_is_refused("insertps").empty());
  EXPECT_FALSE(why_instruction_is_refused("insb").empty());
  EXPECT_TRUE(why_instruction_is_refused("int3").empty());
#endif
  EXPECT_TRUE(why_instruction_is_refused("add").empty());
}

// As g++ 14 compiles a loop that does nothing: its instructions have a line of the contract alone.
TEST(AdmissionLines, ALoopWithoutALineOfTheLawHasTheLineBefore) {
  const std::string loop = "for (;;) s.sum_rad = *(volatile double*)&s.sum_rad;";
  const LawText law{.body = "s.sum_rad += t.position_rad[0];\n# 1 \"/usr/include/contract.hpp\"\n" + loop};
  TestCache cache;
  Service service(cache.path());
  const nlohmann::json made = ask(
      service, {{"verb", "compile"}, {"source", law.source()}, {"joints", 2}, {"admit", false}, {"dry_run", false}});
  ASSERT_TRUE(made["ok"]) << made;
  DryRun run = dry_run(made["object"], 2);
  for (int i = 0; i < 20 && run.starved; ++i) run = dry_run(made["object"], 2);
  ASSERT_GT(run.pc_offset, 0U) << run.reason;
  EXPECT_EQ(own_place(made["object"], run.pc_offset)["line"], 6);
}

}  // namespace
}  // namespace lithe::lawd
