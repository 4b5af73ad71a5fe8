// SPDX-License-Identifier: Apache-2.0
#include "spine/core/text.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <random>
#include <string>

namespace lithe {
namespace {

constexpr std::size_t kAllText = std::string_view::npos;

// Characters that a terminal, a log or a reader may misinterpret. tests/unprintable.py has the same list.
const std::string_view kUnprintable[] = {"\x1b[2J",
                                         "a\nb",
                                         "a\tb",
                                         "a\rb",
                                         std::string_view("a\0b", 3),
                                         "\x7f",
                                         "\xc2\x9b"
                                         "31m",  // C1: CSI in one character
                                         "\xe2\x80\xae"
                                         "txt.cpp",
                                         "\xe2\x81\xa6"
                                         "x",
                                         "\xd8\x9c",
                                         "\xe2\x80\x8b",
                                         "\xe2\x80\xa8",
                                         "\xef\xbb\xbf"
                                         "a",
                                         "\xc2\xad",
                                         "\xf3\xa0\x80\x81",
                                         "\xff",
                                         "\x80",
                                         "ab\xc3",
                                         "\xe2\x82z",
                                         "\xc0\xaf",
                                         "\xc1\xbf",
                                         "\xe0\x80\x80",
                                         "\xf0\x80\x80\x80",
                                         "\xed\xa0\x80",
                                         "\xf4\x90\x80\x80"};

TEST(Text, TextIsText) {
  EXPECT_EQ(first_non_text(""), kAllText);
  EXPECT_EQ(first_non_text("rate_hz = 1000\t# ok\r\n"), kAllText);
  EXPECT_EQ(first_non_text("\xC3\xA9 \xE2\x82\xAC \xF0\x9F\xA4\x96"), kAllText);
}

TEST(Text, TheFirstBrokenByteIsFound) {
  EXPECT_EQ(first_non_text("ab\xFF"), 2U);
  EXPECT_EQ(first_non_text("ab\x80"), 2U);            // continuation without a start
  EXPECT_EQ(first_non_text("ab\xC3"), 2U);            // ended by the end of the text
  EXPECT_EQ(first_non_text("\xE2\x82z"), 0U);         // ended by another character
  EXPECT_EQ(first_non_text("\xC0\xAF"), 0U);          // overlong
  EXPECT_EQ(first_non_text("\xE0\x80\x80"), 0U);      // overlong
  EXPECT_EQ(first_non_text("\xED\xA0\x80"), 0U);      // surrogate
  EXPECT_EQ(first_non_text("\xF4\x90\x80\x80"), 0U);  // beyond Unicode
  EXPECT_EQ(first_non_text(std::string_view("a\0b", 3)), 1U);
  EXPECT_EQ(first_non_text("a\x1B[0m"), 1U);
}

TEST(Text, NamesOfAllLanguagesArePrintable) {
  for (const std::string_view name :
       {"pd.cpp", "elbow-2", "a b", "Schulter_\xC3\xA4", "\xE8\x82\x98", "\xD0\xBB", "\xF0\x9F\xA4\x96", ""}) {
    EXPECT_TRUE(is_printable(name)) << name;
    EXPECT_EQ(printable(name), name);
  }
}

TEST(Text, WhatATerminalWouldActOnIsNotPrintable) {
  for (const std::string_view name : kUnprintable) EXPECT_FALSE(is_printable(name)) << printable(name);
}

TEST(Text, WrittenOutItIsPrintableAndTellsWhatItWas) {
  EXPECT_EQ(printable("a\x1b[2J"), "a\\x1b[2J");
  EXPECT_EQ(printable("\xe2\x80\xae"
                      "x\xff"),
            "\\u202ex\\xff");
  EXPECT_EQ(printable("a\tb\n"), "a\\x09b\\x0a");
  EXPECT_EQ(printable("a\tb\n\x1b", true), "a\tb\n\\x1b");
  for (const std::string_view name : kUnprintable) EXPECT_TRUE(is_printable(printable(name)));
  std::mt19937 random(7);  // NOLINT(cert-msc51-cpp): the same every time
  for (int i = 0; i < 20'000; ++i) {
    std::string bytes(random() % 12, '\0');
    for (char& c : bytes) c = static_cast<char>(random());
    ASSERT_TRUE(is_printable(printable(bytes)));
    ASSERT_EQ(is_printable(bytes), printable(bytes) == bytes);
  }
}

TEST(Text, WordsAreAsFarApartAsTheirSlipsOfThePen) {
  EXPECT_EQ(edit_distance("", "kp"), 2U);
  EXPECT_EQ(edit_distance("velocity", "velocity"), 0U);
  EXPECT_EQ(edit_distance("velocty", "velocity"), 1U) << "one is missing";
  EXPECT_EQ(edit_distance("veloctiy", "velocity"), 1U) << "two are swapped";
  EXPECT_EQ(edit_distance("velocitx", "velocity"), 1U);
  EXPECT_EQ(edit_distance("speed", "velocity"), 8U);
}

TEST(ShellWord, IsOneWordForAShellWhateverItHolds) {
  EXPECT_EQ(shell_word("/mnt/image-1"), "/mnt/image-1");
  for (const std::string text : {"", "my robot.toml", "it's", "$(id) `id` \\ \"*\"", "a;b\nc"}) {
    const std::string command = "printf %s " + shell_word(text);
    FILE* shell = popen(command.c_str(), "r");
    ASSERT_NE(shell, nullptr);
    std::array<char, 64> out{};
    const std::size_t got = std::fread(out.data(), 1, out.size(), shell);
    EXPECT_EQ(pclose(shell), 0) << command;
    EXPECT_EQ(std::string(out.data(), got), text) << command;
  }
}

}  // namespace
}  // namespace lithe
