// SPDX-License-Identifier: Apache-2.0
// Test fixtures of this room: a service with its own cache, and a valid law to modify.
#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <string>

#include "lawd/service.hpp"

namespace lithe::lawd {

// A temporary cache. The precompiled contract is shared by all tests of a build, because it takes a second.
class TestCache {
 public:
  TestCache() {
    namespace fs = std::filesystem;
    char name[] = "/tmp/lithe_lawd_XXXXXX";
    path_ = mkdtemp(name);
    fs::create_directories(LITHE_TEST_CONTRACT_CACHE);
    fs::create_directory_symlink(LITHE_TEST_CONTRACT_CACHE, path_ + "/contract");
  }
  ~TestCache() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TestCache(const TestCache&) = delete;
  TestCache& operator=(const TestCache&) = delete;
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

struct LawText {
  std::string params = "lithe::Param kp_nm_rad{1, 0, 2};";
  std::string state = "double sum_rad = 0;";
  std::string body = "u.torque_nm[0] = p.kp_nm_rad * t.position_rad[0];";
  std::string name = "test";

  std::string source() const {
    return "#include <lithe/law.hpp>\nstruct Law {\n  struct Params { " + params + " };\n  struct State { " + state +
           " };\n  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {\n    " + body +
           "\n  }\n};\nLITHE_LAW(Law, \"" + name + "\");\n";
  }
};

// Asked again while a busy machine gives it no processor time: that says nothing about a law.
inline nlohmann::json ask(Service& service, const nlohmann::json& request) {
  nlohmann::json reply = service.answer(request.dump());
  for (int i = 0; i < 20 && reply.value("starved", false); ++i) reply = service.answer(request.dump());
  return reply;
}

inline nlohmann::json compile(Service& service, const std::string& source, const std::string& name = "law.cpp",
                              bool admit = true, const nlohmann::json& budget_ns = nullptr) {
  nlohmann::json request = {{"id", 7},      {"verb", "compile"}, {"source", source},
                            {"name", name}, {"joints", 2},       {"admit", admit}};
  if (!budget_ns.is_null()) request["budget_ns"] = budget_ns;
  return ask(service, request);
}

class ServiceTest : public ::testing::Test {
 protected:
  nlohmann::json refused(const LawText& law, const std::string& stage) {
    const nlohmann::json reply = compile(service_, law.source());
    EXPECT_FALSE(reply["ok"]) << reply;
    EXPECT_EQ(reply.value("stage", ""), stage) << reply;
    EXPECT_FALSE(reply["diagnostics"].empty());
    return reply;
  }
  static std::string first(const nlohmann::json& reply) { return reply["diagnostics"][0]["message"]; }
  static int line(const nlohmann::json& reply) { return reply["diagnostics"][0]["line"]; }

  TestCache cache_;
  Service service_{cache_.path()};
};

}  // namespace lithe::lawd
