// SPDX-License-Identifier: Apache-2.0
// What the contract says of a law that does not compile with it: which field, which line, what to write instead.
#include <gtest/gtest.h>

#include <string>

#include "lawd/test/lawd_rig.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;
using ContractTest = ServiceTest;

TEST_F(ContractTest, ContractSaysWhatIsWrongWithState) {
  for (const char* state : {"const char* text = nullptr;", "struct { double* a = nullptr; } inner;",
                            "std::array<const double*, 4> all{};"}) {
    const json reply = refused({.state = state}, "compile");
    EXPECT_EQ(first(reply).find("a State field must be"), 0u) << reply["text"];
    EXPECT_EQ(line(reply), 4);
    EXPECT_EQ(reply["diagnostics"].size(), 1u) << "what follows from it is noise: " << reply["text"];
  }
  EXPECT_NE(first(refused({.state = "double x[3];"}, "compile")).find("C array"), std::string::npos);
  EXPECT_NE(first(refused({.state = "std::array<double, 600> x{};"}, "compile")).find("4096"), std::string::npos);
  for (const char* state : {"unsigned a : 3 = 0; unsigned b : 5 = 0;", "double a = 0; alignas(64) double b = 0;"}) {
    const json reply = refused({.state = state}, "compile");
    EXPECT_NE(first(reply).find("bit field"), std::string::npos) << reply["text"];
    EXPECT_NE(first(reply).find("alignas"), std::string::npos) << reply["text"];
    EXPECT_EQ(line(reply), 4);
  }
  const std::string eigen = "#include <Eigen/Dense>\n" + LawText{.state = "Eigen::Matrix3d m;"}.source();
  EXPECT_NE(first(compile(service_, eigen)).find("Eigen::Map"), std::string::npos);
}

TEST_F(ContractTest, TooManyFieldsAreToldWhatFitsTheirStruct) {
  const auto many = [](const std::string& type, const std::string& value, int count) {
    std::string text;
    for (int i = 0; i < count; ++i) text += type + " a" + std::to_string(i) + value + "; ";
    return text;
  };
  EXPECT_TRUE(compile(service_, LawText{.params = many("lithe::Param", "{1, 0, 2}", 32), .body = ""}.source())["ok"]);
  const json params = refused({.params = many("lithe::Param", "{1, 0, 2}", 33), .body = ""}, "compile");
  EXPECT_EQ(first(params).find("Params has more than 32 fields: what is never tuned"), 0u) << params["text"];
  EXPECT_EQ(line(params), 3);
  EXPECT_NE(first(refused({.state = "std::array<std::array<double, 2>, 33> x{};"}, "compile")).find("the rows of its"),
            std::string::npos);
  EXPECT_NE(first(refused({.state = "struct { double a_longer_name_rad = 0; } in_a_struct_rad;"}, "compile"))
                .find("filter.x_rad"),
            std::string::npos);
  const json state = refused({.state = many("double", " = 0", 33), .body = ""}, "compile");
  EXPECT_EQ(first(state).find("State has more than 32 fields: keep numbers"), 0u) << state["text"];
  EXPECT_EQ(line(state), 4);
  const auto probes = [&](int count) {
    std::string text = LawText{}.source();
    text.replace(text.find("lithe::Effort& u)"), 17, "lithe::Effort& u, Probes& q)");
    return text.insert(text.find("  static void"), "  struct Probes { " + many("double", " = 0", count) + "};\n");
  };
  EXPECT_TRUE(compile(service_, probes(8))["ok"]);
  EXPECT_EQ(first(compile(service_, probes(9))).find("Probes has more than 8 fields"), 0u);
}

TEST_F(ContractTest, AnArrayInParamsIsToldToNameEachOne) {
  for (const char* params : {"std::array<lithe::Param, 3> kp{};", "lithe::JointArray kp{};"})
    EXPECT_NE(first(refused({.params = params, .body = ""}, "compile")).find("kp_0_nm_rad"), std::string::npos);
  EXPECT_NE(first(refused({.params = "lithe::Param kp[3];", .body = ""}, "compile")).find("kp_0_nm_rad"),
            std::string::npos);
}

TEST_F(ContractTest, ContractSaysWhatIsWrongWithParamsAndStep) {
  EXPECT_EQ(first(refused({.params = "double kp = 1;", .body = ""}, "compile")).find("every field of Params"), 0u);
  EXPECT_EQ(line(refused({.params = "lithe::Param kp{3, 0, 2};", .body = ""}, "compile")), 3);
  const std::string no_state = "#include <lithe/law.hpp>\nstruct L { struct Params {}; };\nLITHE_LAW(L, \"l\");\n";
  const std::string no_step =
      "#include <lithe/law.hpp>\nstruct L { struct Params {}; struct State {}; };\nLITHE_LAW(L, \"l\");\n";
  EXPECT_EQ(first(compile(service_, no_state)).find("a law needs both nested structs"), 0u);
  EXPECT_EQ(first(compile(service_, no_step)).find("a law has exactly one step()"), 0u);
}

}  // namespace
}  // namespace lithe::lawd
