// SPDX-License-Identifier: Apache-2.0
#include "lawd/source/admission_growth.hpp"

#include <gtest/gtest.h>

#include <random>

namespace lithe::lawd {
namespace {

// The gate that refuses a text first, and where: "preprocessor:2"; "" = admitted.
std::string verdict(const std::string& text) {
  Admission admission;
  admit_source(text, admission);
  if (admission.ok()) return "";
  return admission.findings[0].gate + ":" + std::to_string(admission.findings[0].line);
}

TEST(AdmissionGrowth, MacrosThatGrowWithoutBoundAreRefused) {
  std::string bomb = "#define A0 x\n";
  for (int i = 1; i < 40; ++i) {
    const std::string last = " A" + std::to_string(i - 1);
    bomb += "#define A" + std::to_string(i) + last + last + "\n";
  }
  EXPECT_EQ(verdict(bomb + "int a = A3;\n"), "");
  EXPECT_EQ(verdict(bomb + "int a = A39;\n"), "preprocessor:41");
  std::string reversed = "#define A0 x\n";
  for (int i = 1; i < 40; ++i) {
    const std::string last = " A" + std::to_string(i - 1);
    reversed = "#define A" + std::to_string(i) + last + last + "\n" + reversed;
  }
  EXPECT_EQ(verdict(reversed + "int a = A3;\n"), "");
  EXPECT_EQ(verdict(reversed + "int a = A39;\n"), "preprocessor:41");
  EXPECT_EQ(verdict(reversed + "#if A39\n#endif\n"), "preprocessor:41");
}

TEST(AdmissionGrowth, ArgumentsMultiplyWhatMacrosMakeOfThem) {
  const std::string eight = "#define D(x) x x x x x x x x\n";
  EXPECT_EQ(verdict(eight + "int a = D(D(D(1)));\n"), "");
  EXPECT_EQ(verdict(eight + "int a = D(D(D(D(D(D(D(1)))))));\n"), "preprocessor:2");
  const std::string through = "#define D\\\n(x) E(x) E(x)\n#define E(x) F(x) F(x)\n#define F(x) x x\n";
  EXPECT_EQ(verdict(through + "int a = D(D(1));\n"), "");
  EXPECT_EQ(verdict(through + "int a = D(D(D(D(D(D(1))))));\n"), "preprocessor:5");
  EXPECT_EQ(verdict(("#define S(a, b, c) (a) + (b) + (c)\nint a = S(S(S(S(1, 2, 3), 2, 3), 2, 3), 2, 3);\n")), "");
  EXPECT_EQ(verdict("#define sin(x) std::sin(x)\n#define PI (3.14)\ndouble a = sin(sin(PI));\n"), "");
}

TEST(AdmissionGrowth, MacrosWhoseGrowthNobodyCanTellAreRefused) {
  for (const char* text : {
           "#define D(x) x x\n#define G D\nint a = G(1);",                      // a name that meets its arguments later
           "#define D(x) x x\n#define OPEN (\nint a = D OPEN 1);",              // parentheses that do likewise
           "#define D(x) x x\n#define H D(\nint a = H 1);",                     //
           "#define D(x) x x\n#define APPLY(f, x) f(x)\nint a = APPLY(D, 1);",  // a name as an argument
           "#define A B B\n#define B A A\nint a = A;",                          // a circle
           "#define S(x) #x\nconst char* a = S(1);",                            // texts grow where words do not
       }) {
    EXPECT_EQ(verdict(text).substr(0, 13), "preprocessor:") << text;
  }
  std::string deep = "int a = ";
  for (int i = 0; i < 60000; ++i) deep += "D(";
  EXPECT_EQ(verdict("#define D(x) x\n" + deep), "preprocessor:2");
}

TEST(AdmissionGrowth, AnyMacrosAreSafe) {
  std::mt19937 random(13);
  constexpr const char* kWords[] = {"#define ", "A", "B", "C", "(", ")", ",", "\n", "#if ", "defined", "x", "(x)", " "};
  for (int i = 0; i < 20000; ++i) {
    std::string text;
    for (std::size_t k = random() % 40; k > 0; --k) text += kWords[random() % std::size(kWords)];
    Admission admission;
    admit_source(text, admission);
    EXPECT_EQ(admission.gates.size(), 5u);
  }
}

}  // namespace
}  // namespace lithe::lawd
