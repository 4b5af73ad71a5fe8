// SPDX-License-Identifier: Apache-2.0
// Mistakes that people make on their first day with laws: what they are told, in which line, and what to write instead.
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "lawd/test/lawd_rig.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;

constexpr const char* kHead =
    "#include <lithe/law.hpp>\nstruct Law {\n  struct Params { lithe::Param kp_nm_rad{1, 0, 2}; };\n";
constexpr const char* kState = "  struct State {};\n";
constexpr const char* kStep =
    "  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u) {\n"
    "    u.torque_nm[0] = p.kp_nm_rad * t.position_rad[0];\n  }\n};\n";
constexpr const char* kEnd = "LITHE_LAW(Law, \"test\");\n";

std::string law(const std::string& state = kState, const std::string& step = kStep, const std::string& end = kEnd) {
  return kHead + state + step + end;
}

struct Mistake {
  const char* what;
  std::string source;
  int line;  // that the first diagnostic names
  std::vector<std::string> says;
};

std::vector<Mistake> mistakes() {
  const std::string step = kStep;
  const auto with_step = [&](const std::string& from, const std::string& to) {
    std::string changed = step;
    changed.replace(changed.find(from), from.size(), to);
    return law(kState, changed);
  };
  return {
      {"nothing at all", " ", 1, {"the file holds no code", "LITHE_LAW(Type, \"name\")", "laws/pd.cpp"}},
      {"only a comment", "// soon\n", 1, {"the file holds no code"}},
      {"prose before the code", "Sure! Here's the law:\n\n" + law(), 1, {"'Sure' begins no C++ file", "// comments"}},
      {"prose after the code", law() + "\nThis law follows the setpoint.\n", 11, {"'This' after LITHE_LAW is no C++"}},
      {"a code fence", "```cpp\n" + law() + "```\n", 1, {"a code fence (```) is not C++", "C++ alone"}},
      {"a fence at the end", law() + "```\n", 10, {"a code fence (```)"}},
      {"std::vector",
       with_step("u.torque", "std::vector<double> x;\n    u.torque"),
       6,
       {"std::vector: a law allocates nothing", "std::array"}},
      {"printf",
       with_step("u.torque", "printf(\"%f\", t.t_s);\n    u.torque"),
       6,
       {"printf: a law prints nothing", "Probes"}},
      {"no LITHE_LAW", law(kState, kStep, ""), 8, {"exports no law", "end it with LITHE_LAW(Type, \"name\");"}},
      {"using namespace std",
       "#include <lithe/law.hpp>\nusing namespace std;\n" + law().substr(25),
       2,
       {"using namespace std", "remove the line", "std::sin"}},
      {"using namespace lithe",
       "#include <lithe/law.hpp>\nusing namespace lithe;\n" + law().substr(25),
       2,
       {"using namespace lithe", "lithe::Tick"}},
      {"opens std", law() + "namespace std { int x(); }\n", 10, {"nothing may be added to namespace std"}},
      {"the step instead of the law",
       law(kState, kStep, "LITHE_LAW(&Law::step, \"test\");\n"),
       9,
       {"LITHE_LAW takes the law's struct, then its name: LITHE_LAW(Law, \"name\");"}},
      {"the name first",
       law(kState, kStep, "LITHE_LAW(\"test\", Law);\n"),
       9,
       {"takes the law's struct, then its name"}},
      {"no name", law(kState, kStep, "LITHE_LAW(Law);\n"), 9, {"takes the law's struct, then its name"}},
      {"another struct",
       law(kState, kStep, "LITHE_LAW(Lwa, \"test\");\n"),
       9,
       {"'Lwa' was not declared in this scope", "takes the law's struct"}},
      {"a step that is not static",
       with_step("static void", "void"),
       5,
       {"exactly one step, static and returning void"}},
      {"no State", law(""), 4, {"'State' has not been declared"}},
      {"a semicolon forgotten", law(kState, step.substr(0, step.size() - 2) + "\n"), 8, {"expected ';' after struct"}},
      {"a word mistyped", with_step("position_rad", "positoin_rad"), 6, {"'positoin_rad'", "position_rad"}},
      {"a variable with a short name",
       law() + "void (*f)(const lithe::Tick&, const Law::Params&, Law::State&, lithe::Effort&) "
               "= &Law::step;\n",
       10,
       {"f is a variable outside State", "move it to State"}},
  };
}

TEST(Mistakes, EachNamesItsLineAndWhatToWriteInstead) {
  const TestCache cache;
  Service service(cache.path());
  for (const Mistake& each : mistakes()) {
    const json reply = compile(service, each.source);
    ASSERT_FALSE(reply.value("ok", true)) << each.what;
    ASSERT_FALSE(reply["diagnostics"].empty()) << each.what << ": " << reply;
    const json& first = reply["diagnostics"][0];
    EXPECT_EQ(first["line"], each.line) << each.what << ": " << first;
    for (const std::string& part : each.says) {
      EXPECT_NE(first["message"].get<std::string>().find(part), std::string::npos)
          << each.what << ": " << first["message"];
    }
    EXPECT_EQ(reply["text"].get<std::string>().find("<expression error>"), std::string::npos) << each.what;
  }
}

}  // namespace
}  // namespace lithe::lawd
