// SPDX-License-Identifier: Apache-2.0
#include "spine/contain/memory/constants.hpp"

#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include "spine/contain/core.hpp"
#include "spine/contain/fault_barrier.hpp"

namespace lithe::contain {
namespace {

constexpr std::size_t kOddBytes = 301;  // not a whole number of words

TEST(Constants, EveryBitThatChangesIsFoundAndNamed) {
  std::array<unsigned char, kOddBytes> block{};
  for (std::size_t bit = 0; bit < 8 * block.size(); ++bit) {
    Constants constants;
    ASSERT_TRUE(constants.watch("the block", block.data(), block.size()));
    ASSERT_EQ(constants.look(), nullptr);
    block[bit / 8] ^= static_cast<unsigned char>(1u << bit % 8);
    ASSERT_STREQ(constants.look(), "the block") << bit;
    block[bit / 8] ^= static_cast<unsigned char>(1u << bit % 8);
    ASSERT_STREQ(constants.damaged(), "the block") << "once damaged, always damaged";
  }
}

// The broken twin: a sum does not see two words that changed places, nor one bit that moved.
TEST(Constants, ASumWouldMissWhatTheHashSees) {
  const auto sum = [](const std::array<std::uint64_t, 8>& words) {
    std::uint64_t all = 0;
    for (const std::uint64_t word : words) all += word;
    return all;
  };
  std::array<std::uint64_t, 8> words{1, 2, 3, 4, 5, 6, 7, 8};
  Constants constants;
  ASSERT_TRUE(constants.watch("words", words.data(), sizeof words));
  const std::uint64_t before = sum(words);
  std::swap(words[2], words[5]);
  EXPECT_EQ(sum(words), before);
  EXPECT_STREQ(constants.look(), "words");
}

TEST(Constants, TheFirstThatWasFoundIsNamed) {
  std::array<int, 3> first{}, second{};
  Constants constants;
  ASSERT_TRUE(constants.watch("first", first.data(), sizeof first));
  ASSERT_TRUE(constants.watch("second", second.data(), sizeof second));
  second[1] = 1;
  EXPECT_STREQ(constants.look(), "second");
  first[1] = 1;
  EXPECT_STREQ(constants.look(), "second");
}

TEST(Constants, WhatIsForgottenMayChange) {
  std::array<int, 3> block{};
  Constants constants;
  ASSERT_TRUE(constants.watch("block", block.data(), sizeof block));
  constants.forget(block.data());
  block[0] = 1;
  EXPECT_EQ(constants.look(), nullptr);
}

TEST(Constants, AFullListSaysSoAndNamesWhatIsNotWatched) {
  std::array<int, kMaxConstants + 1> blocks{};
  Constants constants;
  for (std::size_t i = 0; i < kMaxConstants; ++i) ASSERT_TRUE(constants.watch("one", &blocks[i], sizeof blocks[i]));
  const Result<> refused = constants.watch("one too many", &blocks[kMaxConstants], sizeof blocks[0]);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.message().find("one too many"), std::string::npos);
}

TEST(Constants, ACanaryIsWatchedAsLongAsItLives) {
  Constants constants;
  auto canary = std::make_unique<Canary>(constants, "a stack");
  EXPECT_EQ(constants.look(), nullptr);
  auto* words = reinterpret_cast<volatile std::uint64_t*>(canary.get());
  words[sizeof(Canary) / sizeof *words - 1] = 0;
  EXPECT_STREQ(constants.look(), "a stack");
  Constants others;
  canary = std::make_unique<Canary>(others, "another");
  canary.reset();
  EXPECT_EQ(others.look(), nullptr);
}

TEST(Constants, TheWayBackFromALawIsWatchedAsLongAsItsBarrierLives) {
  Constants constants;
  ASSERT_TRUE(install_handlers());
  {
    Result<FaultBarrier> barrier = FaultBarrier::open();
    ASSERT_TRUE(barrier && barrier->watch_entrance(constants));
    EXPECT_EQ(constants.look(), nullptr);
  }
  EXPECT_EQ(constants.look(), nullptr) << "it was empty when the FaultBarrier had gone";
  Result<FaultBarrier> barrier = FaultBarrier::open();
  ASSERT_TRUE(barrier && barrier->watch_entrance(constants));
  entrance().key.closed ^= 2;  // as a wild write would
  EXPECT_STREQ(constants.look(), "how a thread comes back from a law");
  entrance().key.closed ^= 2;
}

TEST(Constants, ThreadsMayComeAndGoWhileTheyAreLookedAt) {
  Constants constants;
  std::atomic<bool> stop{false};
  std::thread looker([&] {
    while (!stop.load()) EXPECT_EQ(constants.look(), nullptr);
  });
  for (int i = 0; i < 100; ++i) std::thread([&] { const Canary canary(constants, "a short life"); }).join();
  stop.store(true);
  looker.join();
  EXPECT_EQ(constants.damaged(), nullptr);
}

}  // namespace
}  // namespace lithe::contain
