// SPDX-License-Identifier: Apache-2.0
// What stands around a law is taken off, and lines keep their numbers; what could be C++ stays.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <string>
#include <vector>

#include "lawd/source/clean.hpp"
#include "lawd/source/help.hpp"

namespace lithe::lawd {
namespace {

const std::string kLaw =
    "#include <lithe/law.hpp>\nstruct Law {\n  struct Params { lithe::Param kp{1, 0, 2}; };\n  struct State {};\n"
    "  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u) {\n"
    "    for (std::uint32_t j = 0; j < t.joints && p.kp > 0; ++j) u.torque_nm[j] = 0;\n  }\n};\n"
    "LITHE_LAW(Law, \"test\");\n";

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
    text.replace(at, from.size(), to);
  return text;
}

// Without the lines that are empty now.
std::string packed(const std::string& text) {
  std::string out = "\n" + text;
  while (out.find("\n\n") != std::string::npos) out = replaced(out, "\n\n", "\n");
  return out.substr(out.find_first_not_of('\n'));
}

TEST(Clean, AWholeLawIsAsSent) {
  for (const std::string& text :
       {kLaw, "// A law.\n// It's simple.\n\n" + kLaw, "/*\n```\nnotes, not a fence\n```\n*/\n" + kLaw,
        "#pragma once\n#include <cmath>\n" + kLaw, kLaw + "\n// the end\n", "constexpr int kN = 3;\n" + kLaw,
        kLaw + "constexpr bool lt = true;\nconstexpr bool both = true &lt;\n", std::string(), std::string("\n\n")}) {
    Admission out;
    const Cleaned cleaned = clean_source(text, out);
    EXPECT_EQ(cleaned.text, text);
    EXPECT_TRUE(cleaned.notes.empty()) << cleaned.notes[0];
    EXPECT_TRUE(out.ok());
  }
}

TEST(Clean, AByteOrderMarkIsNoLetter) {
  Admission out;
  EXPECT_EQ(clean_source("\xEF\xBB\xBF" + kLaw, out).text, kLaw);
  EXPECT_TRUE(out.ok());
}

TEST(Clean, WhatStandsAroundItIsTakenOffAndLinesKeepTheirNumbers) {
  const std::string prose = "Sure! Here's the improved law:\n\n";
  for (const std::string& text :
       {prose + kLaw, kLaw + "\nThis law follows the setpoint.\n- It's stable\n", "# My law\n\n" + kLaw,
        prose + "```cpp\n" + kLaw + "```\nDon't forget to tune kp.\n", "```\n" + kLaw + "```", kLaw + "```\n",
        "```cpp\n" + kLaw, "~~~c++\n" + kLaw + "~~~\n", "```sh\nlithe swap x.cpp\n```\nand\n```cpp\n" + kLaw + "```\n",
        prose + replaced(replaced(replaced(kLaw, "&", "&amp;"), "<", "&lt;"), ">", "&gt;"),
        replaced(kLaw, "\"", "\xE2\x80\x9C"), replaced(kLaw, "    for", "\xC2\xA0\xC2\xA0\xC2\xA0 for"),
        replaced(prose + kLaw, "\n", "\r\n")}) {
    Admission out;
    const Cleaned cleaned = clean_source(text, out);
    EXPECT_EQ(replaced(packed(replaced(cleaned.text, "\r", "")), "\n\n", "\n"), kLaw) << text;
    EXPECT_EQ(std::count(cleaned.text.begin(), cleaned.text.end(), '\n'), std::count(text.begin(), text.end(), '\n'));
    EXPECT_FALSE(cleaned.notes.empty()) << text;
    EXPECT_TRUE(out.ok());
  }
}

TEST(Clean, SaysWhatItTookAndWhy) {
  Admission out;
  const Cleaned cleaned = clean_source("Two parts.\n```sh\nls\n```\n```cpp\n" + kLaw + "```\nBye.\n", out);
  ASSERT_EQ(cleaned.notes.size(), 1u);
  EXPECT_EQ(cleaned.notes[0],
            "the code block in lines 6 to 14 was taken, the only one with LITHE_LAW; 7 other lines were left out");
  const Cleaned after = clean_source(kLaw + "\nIt is good.\n", out);
  ASSERT_EQ(after.notes.size(), 1u);
  EXPECT_EQ(after.notes[0], "line 11: text after LITHE_LAW was left out");
}

TEST(Clean, RefusesWhenItCannotTellWhichBlockIsTheLaw) {
  Admission two, none;
  clean_source("```cpp\n" + kLaw + "```\nor\n```cpp\n" + kLaw + "```\n", two);
  ASSERT_EQ(two.findings.size(), 1u);
  EXPECT_EQ(
      two.findings[0].message,
      "2 code blocks have LITHE_LAW (lines 2 to 10, lines 14 to 22), and a swap takes one law: send the law's C++ "
      "alone");
  EXPECT_EQ(two.findings[0].line, 14);
  clean_source("```cpp\nint a;\n```\n```\nint b;\n```\n", none);
  ASSERT_EQ(none.findings.size(), 1u);
  EXPECT_NE(none.findings[0].message.find("none of the 2 code blocks has LITHE_LAW"), std::string::npos);
}

TEST(Clean, CodeInAnOddPlaceIsLeftForTheCompiler) {
  for (const std::string& text : {"int x;\nand some words\n" + kLaw, kLaw + "int late;\nand some words\n"}) {
    Admission out;
    EXPECT_EQ(clean_source(text, out).text, text);
  }
}

TEST(Clean, AnyBytesAreSafe) {
  std::mt19937 random(5);
  const std::vector<std::string> parts = {"```", "\n", "LITHE_LAW(", ")",       ";",        "&lt;", "&",  "/*", "*/",
                                          "//",  "\"", "#include",   "struct ", "\xE2\x80", "\xC2", "\r", " ",  "word"};
  for (int i = 0; i < 3000; ++i) {
    std::string text;
    for (auto n = random() % 30; n > 0; --n) text += parts[random() % parts.size()];
    Admission out;
    const Cleaned cleaned = clean_source(text, out);
    EXPECT_EQ(std::count(cleaned.text.begin(), cleaned.text.end(), '\n'), std::count(text.begin(), text.end(), '\n'));
    (void)Help(text, text).with_help("'const struct word' has no member named 'x'");
  }
}

TEST(Help, ListsTheFieldsThatExistNearestFirst) {
  const Help help(
      kLaw,
      "struct Tick {\n  double t_s = 0, dt_s = 0;\n  std::uint32_t joints = 0;\n  JointArray position_rad{}, "
      "velocity_rad_s{};\n  std::array<double, 16> sensor{};\n};\n"
      "struct Effort { JointArray torque_nm{}; void clear(int n) { a = 1; } double kp = std::sqrt(2.0); };");
  EXPECT_EQ(help.with_help("'const struct lithe::Tick' has no member named 'dt'"),
            "'const struct lithe::Tick' has no member named 'dt': Tick has dt_s, t_s, joints, sensor, position_rad, "
            "velocity_rad_s");
  const std::string said = help.with_help("'struct lithe::Effort' has no member named 'tau'");
  EXPECT_NE(said.find("Effort has torque_nm, kp"), std::string::npos) << said;
  EXPECT_NE(help.with_help("'const struct Law::Params' has no member named 'kd'").find("Params has kp"),
            std::string::npos);
  EXPECT_NE(help.with_help("'position_rad' was not declared in this scope").find("write t.position_rad in step("),
            std::string::npos);
  EXPECT_EQ(help.with_help("expected ';' before '}' token"), "expected ';' before '}' token");
}

}  // namespace
}  // namespace lithe::lawd
