// SPDX-License-Identifier: Apache-2.0
#include "lawd/run/dry_run.hpp"

#include <gtest/gtest.h>

#include <string>

#include "lawd/run/child.hpp"
#include "lawd/test/lawd_rig.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;

class DryRunTest : public ::testing::Test {
 protected:
  // The object of a law that nothing has run or admitted.
  std::string object_of(const std::string& source) {
    const json made =
        ask(service_, {{"verb", "compile"}, {"source", source}, {"joints", 2}, {"admit", false}, {"dry_run", false}});
    EXPECT_TRUE(made["ok"]) << made;
    return made.value("object", "");
  }

  // Tried again while a busy machine gives it no processor time.
  static DryRun tried(const std::string& object) {
    DryRun run = dry_run(object, 2);
    for (int i = 0; i < 20 && run.starved; ++i) run = dry_run(object, 2);
    return run;
  }

  TestCache cache_;
  Service service_{cache_.path()};
};

TEST_F(DryRunTest, ALoopThatABusyMachineBreaksOffByTheClockHasItsLineToo) {
  const std::string object = object_of(LawText{.body = "for (;;) s.sum_rad = *(volatile double*)&s.sum_rad;"}.source());
  set_time_factor(0.05);  // half a second, and one of the processor
  const DryRun run = tried(object);
  set_time_factor(1);
  EXPECT_NE(run.reason.find("did not return"), std::string::npos) << run.reason;
  EXPECT_GT(run.pc_offset, 0U);
}

TEST_F(DryRunTest, AStandstillOfTheMachineIsNoTimeOfTheLaw) {
  const LawText law{.body = "static int calls = 0; if (++calls == 500) usleep(600'000);"};
  const DryRun run = tried(object_of("extern \"C\" int usleep(unsigned);\n" + law.source()));
  EXPECT_TRUE(run.ok) << run.reason;
  EXPECT_LT(run.step_ns, 600e6) << "only one of the repetitions stood still";
}

}  // namespace
}  // namespace lithe::lawd
