// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/late.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

#include "supervisor/swap/chain.hpp"

namespace lithe::swap {
namespace {

namespace fs = std::filesystem;

// A folder that cannot be made, until its way is clear.
class LateTest : public testing::Test {
 protected:
  LateTest()
      : way_(fs::temp_directory_path() / ("lithe-late-" + std::to_string(::getpid()) + "-" +
                                          testing::UnitTest::GetInstance()->current_test_info()->name())),
        book_(way_ / "swaps") {
    std::ofstream(way_) << "in the way";
  }
  ~LateTest() override { fs::remove_all(way_); }
  std::string verdict(const char* file) const {
    std::ifstream stream(way_ / "swaps" / file);
    const Json certificate = Json::parse(stream, nullptr, false);
    return certificate.is_object() ? certificate.value("verdict", "") : "";
  }

  fs::path way_;
  RecordBook book_;
  LateRecords late_;
};

TEST_F(LateTest, WritesTheNewestTextOnceThereIsRoomAndKeepsTheChain) {
  late_.hold(7, {{"verdict", "submitted"}});
  late_.hold(8, {{"verdict", "refused"}});
  late_.retry(book_, 1);
  EXPECT_EQ(late_.waiting(), 2U);
  late_.hold(7, {{"verdict", "committed"}});
  fs::remove(way_);
  late_.retry(book_, 2);
  EXPECT_EQ(late_.waiting(), 2U) << "not every millisecond";
  late_.retry(book_, 1 + LateRecords::kPauseNs);
  EXPECT_EQ(late_.waiting(), 0U);
  EXPECT_EQ(verdict("0001.json"), "committed");
  EXPECT_EQ(verdict("0002.json"), "refused");
  late_.hold(7, {{"verdict", "confirmed"}});
  late_.retry(book_, 1 + 2 * LateRecords::kPauseNs);
  EXPECT_EQ(verdict("0001.json"), "confirmed") << "the same file";
  const Chain chain = verify_chain(way_ / "swaps");
  EXPECT_TRUE(chain.problems.empty());
  EXPECT_EQ(chain.certificates, 2U);
}

TEST_F(LateTest, HoldsABoundedNumberAndTheNewestOfThem) {
  for (std::uint64_t id = 1; id <= LateRecords::kMost + 5; ++id) {
    late_.hold(id, {{"verdict", std::to_string(id)}});
  }
  EXPECT_EQ(late_.waiting(), LateRecords::kMost);
  fs::remove(way_);
  late_.retry(book_, 1);
  EXPECT_EQ(verdict("0001.json"), "6");
}

}  // namespace
}  // namespace lithe::swap
