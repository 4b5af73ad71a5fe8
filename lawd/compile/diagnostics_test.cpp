// SPDX-License-Identifier: Apache-2.0
#include "lawd/compile/diagnostics.hpp"

#include <gtest/gtest.h>

namespace lithe::lawd {
namespace {

Sources law() {
  return {.path = "/scratch/law.cpp",
          .name = "law.cpp",
          .text = "one\nint x = y;\n",
          .contract_dir = "/contract",
          .with_help = {}};
}

std::string array(const std::string& file, const std::string& between) {
  return "[{\"kind\": \"error\"," + between + "\"message\": \"'y' was not declared\"," + between +
         "\"locations\": [{\"caret\": {\"file\": \"" + file + "\", \"line\": 2, \"column\": 9}}]}]\n";
}

// g++ 12 prints an array on one line, g++ 14 over several.
TEST(Diagnostics, AreReadOverOneLineAndOverMany) {
  for (const std::string between : {" ", "\n  ", "\n\n"}) {
    const Diagnostics seen = read_diagnostics(array("/scratch/law.cpp", between), law());
    ASSERT_EQ(seen.list.size(), 1U) << seen.text;
    EXPECT_EQ(seen.list[0]["line"], 2);
    EXPECT_EQ(seen.list[0]["text"], "int x = y;");
  }
}

// A bracket that ends a line inside of an array does not end the array, and two arrays are two.
TEST(Diagnostics, SeveralArraysAndOtherLinesAreKeptApart) {
  const std::string nested =
      "[{\"kind\": \"error\", \"children\": [\n]\n, \"message\": \"first\", \"locations\": []}]\n";
  const Diagnostics seen = read_diagnostics("a line\n" + nested + array("/scratch/law.cpp", "\n"), law());
  ASSERT_EQ(seen.list.size(), 2U) << seen.text;
  EXPECT_EQ(seen.list[0]["message"], "first");
  EXPECT_EQ(read_diagnostics("cc1plus: out of memory\n\n", law()).text, "cc1plus: out of memory\n");
}

TEST(Diagnostics, TextOfAnotherFileIsNeverQuotedNotEvenOfAnArrayWithoutAnEnd) {
  const std::string whole = array("/home/someone/secret", "\n");
  EXPECT_EQ(read_diagnostics(whole, law()).text.find("'y'"), std::string::npos);
  for (std::size_t length = 0; length + 2 < whole.size(); ++length)
    EXPECT_EQ(read_diagnostics(whole.substr(0, length), law()).text.find("'y'"), std::string::npos) << length;
}

}  // namespace
}  // namespace lithe::lawd
