// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/swap_words.hpp"

#include <gtest/gtest.h>

namespace lithe::control {
namespace {

using swap::Json;

TEST(SwapWords, TheCertificateNamesTheObjectThatIsTriedAndTheOneThatIsPlaced) {
  const Json facts =
      facts_of({{"ok", true}, {"object_sha256", "aa"}, {"placeable_sha256", "bb"}, {"hash", "cc"}, {"gates", {1, 2}}});
  EXPECT_EQ(facts, (Json{{"object_sha256", "aa"}, {"placeable_sha256", "bb"}, {"gates", {1, 2}}}));
}

TEST(SwapWords, AParameterIsHeldToTheNewLawsRange) {
  const Json law = {{"params", {{{"name", "kp"}, {"min", 0.0}, {"max", 2.0}}}}};
  EXPECT_FALSE(wrong_param({{"kp", 2.0}}, law));
  EXPECT_EQ(wrong_param({{"kp", 2.1}}, law)->code, "refused_range");
  EXPECT_EQ(wrong_param({{"kp", "much"}}, law)->code, "refused_range");
  EXPECT_EQ(wrong_param({{"kd", 1.0}}, law)->code, "unknown_param");
}

TEST(SwapWords, TheLoadersOwnWordsComeFirst) {
  EXPECT_EQ(stage_refusal(wire::StageResult::abi_mismatch, "an old contract").message, "an old contract");
  EXPECT_EQ(stage_refusal(wire::StageResult::busy, "").code, "busy");
  EXPECT_NE(stage_refusal(wire::StageResult::busy, "").next.find("try again"), std::string::npos);
}

}  // namespace
}  // namespace lithe::control
